//! The OIDN binding: a device, a filter that is kept between pictures, and their buffers.

use super::library::{self, Oidn};
use super::{DenoiseError, Options, Quality};
use renderflow_frame::image::Rgb;
use std::ffi::{CStr, c_int, c_void};
use std::mem::size_of;
use std::num::NonZero;
use std::ptr::{self, NonNull};
use std::sync::atomic::{AtomicBool, Ordering};

const PIXEL: usize = size_of::<[f32; 3]>();

/// Pixels beyond which buffers and network are given back after each picture: gigabytes, beside which making them again is
/// nothing.
const LARGEST_KEPT: usize = 2048 * 2048;

/// Tells OIDN whether to go on: until the `AtomicBool` behind `user` is set.
unsafe extern "C" fn goes_on(user: *mut c_void, _: f64) -> bool {
    // SAFETY: `Filter::run` alone hands this function to OIDN, with a pointer to an `AtomicBool` that lives while the filter
    // runs.
    let cancel = unsafe { &*user.cast::<AtomicBool>() };
    !cancel.load(Ordering::Relaxed)
}

/// An OIDN device with the filter last used.
pub(super) struct Filter {
    device: Device,
    options: Options,
    ready: Option<Ready>,
}

/// A filter and its buffers for one size and set of guides.
struct Ready {
    api: &'static Oidn,
    signature: Signature,
    filter: NonNull<library::Filter>,
    /// Colour, output, then albedo and normal where used.
    buffers: Vec<Buffer>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
struct Signature {
    width: usize,
    height: usize,
    albedo: bool,
    normal: bool,
}

struct Device {
    api: &'static Oidn,
    handle: NonNull<library::Device>,
}

struct Buffer {
    api: &'static Oidn,
    handle: NonNull<library::Buffer>,
    bytes: usize,
}

// SAFETY: OIDN locks the device inside each call, and nothing it owns is bound to the thread that made it
// (OIDN documentation, "Thread safety" and "Device").
unsafe impl Send for Filter {}

impl Filter {
    pub fn new(options: Options) -> Result<Self, DenoiseError> {
        let api = Oidn::get().map_err(DenoiseError::NotFound)?;
        // SAFETY: no preconditions; a failure returns null, which `NonNull` catches.
        let handle = unsafe { (api.new_device)(library::DEVICE_CPU) };
        let handle = NonNull::new(handle).ok_or_else(|| last_error_without_device(api))?;
        let device = Device { api, handle };
        // Pinned threads would compete with rayon's for the same cores.
        // SAFETY: the device is alive and not committed yet; the name is a C string.
        unsafe { (api.set_device_bool)(device.handle.as_ptr(), c"setAffinity".as_ptr(), false) };
        // Left alone, OIDN takes a thread for each core, however few the program has.
        let threads = rayon::current_num_threads();
        if threads < std::thread::available_parallelism().map_or(1, NonZero::get) {
            let threads = c_int::try_from(threads).unwrap_or(c_int::MAX);
            // SAFETY: as above.
            unsafe { (api.set_device_int)(device.handle.as_ptr(), c"numThreads".as_ptr(), threads) };
        }
        // SAFETY: the device is alive.
        unsafe { (api.commit_device)(device.handle.as_ptr()) };
        device.check()?;
        // SAFETY: the device is alive and the name is a C string.
        let version = unsafe { (api.get_device_int)(device.handle.as_ptr(), c"versionMajor".as_ptr()) };
        if version != 2 {
            return Err(DenoiseError::Version(version));
        }
        Ok(Self { device, options, ready: None })
    }

    /// Number of threads of the device.
    #[cfg(test)]
    pub fn threads(&self) -> c_int {
        // SAFETY: the device is alive and the name is a C string.
        unsafe { (self.device.api.get_device_int)(self.device.handle.as_ptr(), c"numThreads".as_ptr()) }
    }

    /// Values are finite, guides of the picture's size. The pictures are given back once OIDN has them.
    pub fn run(
        &mut self,
        color: Rgb,
        albedo: Option<Rgb>,
        normal: Option<Rgb>,
        cancel: &AtomicBool,
    ) -> Result<Rgb, DenoiseError> {
        let signature =
            Signature { width: color.width, height: color.height, albedo: albedo.is_some(), normal: normal.is_some() };
        let ready = match self.ready.take().filter(|ready| ready.signature == signature) {
            Some(ready) => ready,
            None => Ready::new(&self.device, self.options, signature)?,
        };
        let ready = self.ready.insert(ready);
        let mut buffers = ready.buffers.iter();
        let mut next = || buffers.next().ok_or_else(|| DenoiseError::Oidn("a buffer is missing".into()));
        let (input, output) = (next()?, next()?);
        for (buffer, picture) in [(Some(input), Some(color)), (None, albedo), (None, normal)] {
            if let Some(picture) = picture {
                buffer.map_or_else(&mut next, Ok)?.write(&picture.pixels);
            }
        }
        // OIDN asks the monitor while it works, from this thread or its own.
        let user = ptr::from_ref(cancel).cast_mut().cast::<c_void>();
        // SAFETY: the filter is alive; `goes_on` reads an `AtomicBool` behind `user`, which outlives the call of the filter, and
        // the monitor is taken away after it.
        unsafe { (ready.api.set_filter_monitor)(ready.filter.as_ptr(), Some(goes_on), user) };
        // SAFETY: the filter is committed and its buffers live in `ready`.
        unsafe { (ready.api.execute_filter)(ready.filter.as_ptr()) };
        // SAFETY: the filter is alive; no function means no monitor.
        unsafe { (ready.api.set_filter_monitor)(ready.filter.as_ptr(), None, ptr::null_mut()) };
        self.device.check()?;
        let mut denoised = Rgb::filled(signature.width, signature.height, [0.0; 3]);
        output.read(&mut denoised.pixels);
        self.device.check()?;
        if signature.width * signature.height > LARGEST_KEPT {
            self.ready = None;
        }
        Ok(denoised)
    }
}

impl Ready {
    fn new(device: &Device, options: Options, signature: Signature) -> Result<Self, DenoiseError> {
        let api = device.api;
        // SAFETY: the device is alive and committed, the name is a C string.
        let filter = unsafe { (api.new_filter)(device.handle.as_ptr(), c"RT".as_ptr()) };
        let Some(filter) = NonNull::new(filter) else {
            device.check()?;
            return Err(DenoiseError::Oidn("the filter could not be made".into()));
        };
        let mut ready = Self { api, signature, filter, buffers: Vec::with_capacity(4) };
        ready.attach(device, c"color")?;
        ready.attach(device, c"output")?;
        if signature.albedo {
            ready.attach(device, c"albedo")?;
        }
        if signature.normal {
            ready.attach(device, c"normal")?;
        }
        let quality = match options.quality {
            Quality::Fast => library::QUALITY_FAST,
            Quality::High => library::QUALITY_HIGH,
        };
        let filter = filter.as_ptr();
        // SAFETY: the filter is alive, names are C strings, and the buffers attached outlive it (see `Drop`).
        unsafe {
            (api.set_filter_bool)(filter, c"hdr".as_ptr(), true);
            (api.set_filter_bool)(filter, c"cleanAux".as_ptr(), options.clean_guides && signature.albedo);
            (api.set_filter_int)(filter, c"quality".as_ptr(), quality);
            (api.commit_filter)(filter);
        }
        device.check()?;
        Ok(ready)
    }

    /// Makes a buffer for one picture and names it to the filter.
    fn attach(&mut self, device: &Device, name: &CStr) -> Result<(), DenoiseError> {
        let Signature { width, height, .. } = self.signature;
        let buffer = Buffer::new(device, width * height * PIXEL)?;
        // SAFETY: filter and buffer are alive; `width * height` pixels of three floats fill the buffer exactly; strides of 0
        // mean densely packed.
        unsafe {
            (self.api.set_filter_image)(
                self.filter.as_ptr(),
                name.as_ptr(),
                buffer.handle.as_ptr(),
                library::FORMAT_FLOAT3,
                width,
                height,
                0,
                0,
                0,
            );
        }
        self.buffers.push(buffer);
        device.check()
    }
}

impl Device {
    /// The error pending on the device, if any; reading it clears it.
    fn check(&self) -> Result<(), DenoiseError> {
        read_error(self.api, self.handle.as_ptr())
    }
}

impl Buffer {
    fn new(device: &Device, bytes: usize) -> Result<Self, DenoiseError> {
        // SAFETY: the device is alive and committed; a failure returns null.
        let handle = unsafe { (device.api.new_buffer)(device.handle.as_ptr(), bytes) };
        match NonNull::new(handle) {
            Some(handle) => Ok(Self { api: device.api, handle, bytes }),
            None => {
                device.check()?;
                Err(DenoiseError::Oidn(format!("no memory for {bytes} bytes")))
            }
        }
    }

    fn write(&self, pixels: &[[f32; 3]]) {
        assert_eq!(size_of_val(pixels), self.bytes, "picture and buffer differ in size");
        // SAFETY: the buffer is alive and, as just checked, of the size of `pixels`, which OIDN only reads.
        unsafe { (self.api.write_buffer)(self.handle.as_ptr(), 0, self.bytes, pixels.as_ptr().cast::<c_void>()) };
    }

    fn read(&self, pixels: &mut [[f32; 3]]) {
        assert_eq!(size_of_val(pixels), self.bytes, "picture and buffer differ in size");
        // SAFETY: the buffer is alive and, as just checked, of the size of `pixels`; any bit pattern is a float.
        unsafe { (self.api.read_buffer)(self.handle.as_ptr(), 0, self.bytes, pixels.as_mut_ptr().cast::<c_void>()) };
    }
}

fn last_error_without_device(api: &Oidn) -> DenoiseError {
    read_error(api, ptr::null_mut()).err().unwrap_or_else(|| DenoiseError::Oidn("no CPU device".into()))
}

/// Null reads the error of this thread, which is where failures to make a device end up.
fn read_error(api: &Oidn, device: *mut library::Device) -> Result<(), DenoiseError> {
    let mut message = ptr::null();
    // SAFETY: `device` is alive or null, both of which OIDN accepts; `message` is a valid place for a pointer.
    let code = unsafe { (api.get_device_error)(device, &mut message) };
    if code == library::ERROR_NONE {
        return Ok(());
    }
    if code == library::ERROR_CANCELLED {
        return Err(DenoiseError::Cancelled);
    }
    let text = if message.is_null() {
        format!("error {code}")
    } else {
        // SAFETY: OIDN returned a C string that stays valid until the next call on this thread; it is copied here.
        unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
    };
    Err(DenoiseError::Oidn(text))
}

impl Drop for Ready {
    fn drop(&mut self) {
        // SAFETY: the handle is ours and released once. The buffers follow; OIDN counts references.
        unsafe { (self.api.release_filter)(self.filter.as_ptr()) };
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: the handle is ours and released once.
        unsafe { (self.api.release_buffer)(self.handle.as_ptr()) };
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: the handle is ours and released once; OIDN keeps the device alive while a filter or buffer refers to it.
        unsafe { (self.api.release_device)(self.handle.as_ptr()) };
    }
}
