//! Embree's ray queries, loaded at run time: the rate to beat in `renderflow-bench kernels`.
//!
//! Only what that needs is declared, after the public headers of Embree 4 (and 3, whose queries take a context in another place).
//! All of the package's unsafe code is here.

use anyhow::{Context, Result, bail, ensure};
use glam::Vec3A;
use libloading::Library;
use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::path::Path;
use std::sync::atomic::{AtomicIsize, Ordering};

type Device = *mut c_void;
type SceneHandle = *mut c_void;
type Geometry = *mut c_void;

/// `RTCRay`.
#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RtcRay {
    org: [f32; 3],
    tnear: f32,
    dir: [f32; 3],
    time: f32,
    tfar: f32,
    mask: u32,
    id: u32,
    flags: u32,
}

/// `RTCHit`; `inst_prim_id` is there since 4.3.2 where instance arrays are compiled in, and left alone otherwise.
#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RtcHit {
    ng: [f32; 3],
    u: f32,
    v: f32,
    prim_id: u32,
    geom_id: u32,
    inst_id: u32,
    inst_prim_id: u32,
}

/// `RTCRayHit`.
#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RtcRayHit {
    ray: RtcRay,
    hit: RtcHit,
}

/// `RTCRayHit16`: as above, sixteen of each.
#[repr(C, align(64))]
struct RtcRayHit16 {
    org: [[f32; 16]; 3],
    tnear: [f32; 16],
    dir: [[f32; 16]; 3],
    time: [f32; 16],
    tfar: [f32; 16],
    mask: [u32; 16],
    id: [u32; 16],
    flags: [u32; 16],
    ng: [[f32; 16]; 3],
    u: [f32; 16],
    v: [f32; 16],
    prim_id: [u32; 16],
    geom_id: [u32; 16],
    inst_id: [u32; 16],
    inst_prim_id: [u32; 16],
}

/// The sixteen lanes of a packet that hold a ray: -1, or 0.
#[repr(C, align(64))]
struct Valid([c_int; 16]);

/// `RTCIntersectArguments` of Embree 4, with room at the end for what a build may add.
#[repr(C)]
struct Arguments {
    flags: u32,
    feature_mask: u32,
    context: *mut c_void,
    filter: *mut c_void,
    intersect: *mut c_void,
    rest: [u64; 2],
}

/// `RTCIntersectContext` of Embree 3, which writes to it.
#[repr(C)]
struct Context3 {
    flags: u32,
    filter: *mut c_void,
    inst_id: u32,
    rest: [u64; 2],
}

const INVALID: u32 = u32::MAX;
const QUALITY_HIGH: c_int = 2;
const FLAG_ROBUST: c_int = 1 << 2;
const TRIANGLES: c_int = 0;
const BUFFER_INDEX: c_int = 0;
const BUFFER_VERTEX: c_int = 1;
const UINT3: c_int = 0x5003;
const FLOAT3: c_int = 0x9003;
const PROPERTY_VERSION: c_int = 0;
/// `RTC_RAY_QUERY_FLAG_COHERENT`, Embree 4.
const COHERENT_4: u32 = 1 << 16;
/// `RTC_INTERSECT_CONTEXT_FLAG_COHERENT`, Embree 3.
const COHERENT_3: u32 = 1;

type Memory = extern "C" fn(*mut c_void, isize, bool) -> bool;

/// The functions that both versions have alike.
struct Common {
    device_error: unsafe extern "C" fn(Device) -> c_int,
    release_device: unsafe extern "C" fn(Device),
    new_scene: unsafe extern "C" fn(Device) -> SceneHandle,
    release_scene: unsafe extern "C" fn(SceneHandle),
    scene_quality: unsafe extern "C" fn(SceneHandle, c_int),
    scene_flags: unsafe extern "C" fn(SceneHandle, c_int),
    commit_scene: unsafe extern "C" fn(SceneHandle),
    new_geometry: unsafe extern "C" fn(Device, c_int) -> Geometry,
    release_geometry: unsafe extern "C" fn(Geometry),
    geometry_quality: unsafe extern "C" fn(Geometry, c_int),
    commit_geometry: unsafe extern "C" fn(Geometry),
    attach: unsafe extern "C" fn(SceneHandle, Geometry) -> c_uint,
    share: unsafe extern "C" fn(Geometry, c_int, c_uint, c_int, *const c_void, usize, usize, usize),
}

type Single = unsafe extern "C" fn(SceneHandle, *mut c_void, *mut c_void);
type Packet = unsafe extern "C" fn(*const c_int, SceneHandle, *mut c_void, *mut c_void);

/// The queries. Version 3 takes (scene, context, rays), version 4 (scene, rays, arguments).
struct Queries {
    closest: Single,
    occluded: Single,
    closest16: Packet,
}

/// A loaded Embree with a device.
pub struct Embree {
    common: Common,
    queries: Queries,
    device: Device,
    /// Major, minor, patch.
    version: [u32; 3],
    /// Bytes the device holds; Embree keeps its address.
    memory: Box<AtomicIsize>,
    // Last: unloaded after everything that came from it is gone.
    _library: Library,
}

/// A committed scene of one triangle mesh.
pub struct Scene<'a> {
    embree: &'a Embree,
    handle: SceneHandle,
    // Shared with Embree as long as the scene lives.
    _vertices: Vec<[f32; 3]>,
    _triangles: Vec<[u32; 3]>,
}

extern "C" fn count_memory(total: *mut c_void, bytes: isize, _post: bool) -> bool {
    // SAFETY: `total` is the box registered with this function, which outlives the device.
    let total = unsafe { &*total.cast::<AtomicIsize>() };
    total.fetch_add(bytes, Ordering::Relaxed);
    true
}

/// A function of the library by its name.
///
/// # Safety
/// `T` must be the function's type.
unsafe fn function<T: Copy>(library: &Library, name: &CStr) -> Result<T> {
    // SAFETY: by this function's own contract.
    let symbol = unsafe { library.get::<T>(name.to_bytes_with_nul()) };
    Ok(*symbol.with_context(|| format!("no {}", name.to_string_lossy()))?)
}

impl Embree {
    /// Loads the shared library at `path` (or found by that name where the system looks) and opens a device.
    ///
    /// # Errors
    /// When it cannot be loaded, is not Embree 3 or 4, or opens no device.
    pub fn open(path: &Path) -> Result<Self> {
        // SAFETY: running a library's initialisers is as safe as the library; the user named this one.
        let library = unsafe { Library::new(path) }.with_context(|| path.display().to_string())?;
        Self::with(library).with_context(|| path.display().to_string())
    }

    fn with(library: Library) -> Result<Self> {
        // SAFETY: the types are those of Embree's headers; the functions below have not changed from version 3 to 4.
        let (new_device, property, monitor, common) = unsafe {
            let new_device: unsafe extern "C" fn(*const c_char) -> Device = function(&library, c"rtcNewDevice")?;
            let property: unsafe extern "C" fn(Device, c_int) -> isize = function(&library, c"rtcGetDeviceProperty")?;
            let monitor: unsafe extern "C" fn(Device, Memory, *mut c_void) =
                function(&library, c"rtcSetDeviceMemoryMonitorFunction")?;
            let common = Common {
                device_error: function(&library, c"rtcGetDeviceError")?,
                release_device: function(&library, c"rtcReleaseDevice")?,
                new_scene: function(&library, c"rtcNewScene")?,
                release_scene: function(&library, c"rtcReleaseScene")?,
                scene_quality: function(&library, c"rtcSetSceneBuildQuality")?,
                scene_flags: function(&library, c"rtcSetSceneFlags")?,
                commit_scene: function(&library, c"rtcCommitScene")?,
                new_geometry: function(&library, c"rtcNewGeometry")?,
                release_geometry: function(&library, c"rtcReleaseGeometry")?,
                geometry_quality: function(&library, c"rtcSetGeometryBuildQuality")?,
                commit_geometry: function(&library, c"rtcCommitGeometry")?,
                attach: function(&library, c"rtcAttachGeometry")?,
                share: function(&library, c"rtcSetSharedGeometryBuffer")?,
            };
            (new_device, property, monitor, common)
        };
        // SAFETY: both versions' queries take three (four) pointers; which is which is decided where they are called.
        let queries = unsafe {
            Queries {
                closest: function(&library, c"rtcIntersect1")?,
                occluded: function(&library, c"rtcOccluded1")?,
                closest16: function(&library, c"rtcIntersect16")?,
            }
        };
        // SAFETY: no configuration is allowed.
        let device = unsafe { new_device(std::ptr::null()) };
        ensure!(!device.is_null(), "no device");
        let memory = Box::new(AtomicIsize::new(0));
        // SAFETY: the device was just made; the callback's argument lives as long as `Self`, which releases the device first.
        let version = unsafe {
            monitor(device, count_memory, (&raw const *memory).cast_mut().cast());
            property(device, PROPERTY_VERSION)
        };
        let number = u32::try_from(version).unwrap_or(0);
        let version = [number / 10_000, number / 100 % 100, number % 100];
        let embree = Self { common, queries, device, version, memory, _library: library };
        ensure!(matches!(version[0], 3 | 4), "version {} is neither 3 nor 4", embree.version());
        Ok(embree)
    }

    /// As in `4.4.0`.
    pub fn version(&self) -> String {
        self.version.map(|v| v.to_string()).join(".")
    }

    /// Builds a scene at high quality (with spatial splits); `robust` avoids optimisations that let rays through between
    /// triangles.
    ///
    /// # Errors
    /// When Embree reports one.
    pub fn scene(&self, triangles: &[[Vec3A; 3]], robust: bool) -> Result<Scene<'_>> {
        let count = u32::try_from(3 * triangles.len()).context("too many triangles")?;
        // One corner more than there are: Embree reads 16 bytes for each.
        let padding = std::iter::once([0.0; 3]);
        let vertices: Vec<[f32; 3]> = triangles.iter().flatten().map(|v| v.to_array()).chain(padding).collect();
        let indices: Vec<[u32; 3]> = (0..count / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let c = &self.common;
        // SAFETY: handles are used while alive and released once; the buffers have the stated sizes and live as long as the
        // scene.
        unsafe {
            let handle = (c.new_scene)(self.device);
            let scene = Scene { embree: self, handle, _vertices: vertices, _triangles: indices };
            (c.scene_quality)(handle, QUALITY_HIGH);
            (c.scene_flags)(handle, if robust { FLAG_ROBUST } else { 0 });
            let geometry = (c.new_geometry)(self.device, TRIANGLES);
            (c.geometry_quality)(geometry, QUALITY_HIGH);
            let (vertices, indices) = (&scene._vertices, &scene._triangles);
            (c.share)(geometry, BUFFER_VERTEX, 0, FLOAT3, vertices.as_ptr().cast(), 0, 12, count as usize);
            (c.share)(geometry, BUFFER_INDEX, 0, UINT3, indices.as_ptr().cast(), 0, 12, indices.len());
            (c.commit_geometry)(geometry);
            (c.attach)(handle, geometry);
            (c.release_geometry)(geometry);
            (c.commit_scene)(handle);
            match (c.device_error)(self.device) {
                0 => Ok(scene),
                code => bail!("error {code} of Embree while building"),
            }
        }
    }

    /// Bytes Embree holds at the moment, for all scenes together; the vertices and indices shared with it are not counted.
    pub fn memory(&self) -> usize {
        self.memory.load(Ordering::Relaxed).max(0) as usize
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        // SAFETY: made by this library, released once; scenes borrow `self`, so none is left.
        unsafe { (self.common.release_device)(self.device) };
    }
}

impl Drop for Scene<'_> {
    fn drop(&mut self) {
        // SAFETY: made by this library, released once.
        unsafe { (self.embree.common.release_scene)(self.handle) };
    }
}

fn ray(origin: Vec3A, direction: Vec3A) -> RtcRay {
    RtcRay {
        org: origin.to_array(),
        tnear: 0.0,
        dir: direction.to_array(),
        time: 0.0,
        tfar: f32::INFINITY,
        mask: u32::MAX,
        id: 0,
        flags: 0,
    }
}

impl Scene<'_> {
    /// Calls a query on one ray in the way of the version. `rays` must point to what the query takes.
    #[inline]
    fn single(&self, query: Single, rays: *mut c_void) {
        if self.embree.version[0] >= 4 {
            // SAFETY: the scene is committed; absent arguments are the defaults.
            unsafe { query(self.handle, rays, std::ptr::null_mut()) };
        } else {
            let mut context = Context3 { flags: 0, filter: std::ptr::null_mut(), inst_id: INVALID, rest: [0; 2] };
            // SAFETY: as above; the context is initialised as `rtcInitIntersectContext` does.
            unsafe { query(self.handle, (&raw mut context).cast(), rays) };
        }
    }

    /// Whether, and where (metres), `direction` from `origin` first meets a triangle.
    #[inline]
    pub fn closest(&self, origin: Vec3A, direction: Vec3A) -> Option<f32> {
        let hit =
            RtcHit { ng: [0.0; 3], u: 0.0, v: 0.0, prim_id: INVALID, geom_id: INVALID, inst_id: INVALID, inst_prim_id: INVALID };
        let mut query = RtcRayHit { ray: ray(origin, direction), hit };
        self.single(self.embree.queries.closest, (&raw mut query).cast());
        (query.hit.geom_id != INVALID).then_some(query.ray.tfar)
    }

    /// Whether any triangle stands in the way.
    #[inline]
    pub fn occluded(&self, origin: Vec3A, direction: Vec3A) -> bool {
        let mut query = ray(origin, direction);
        self.single(self.embree.queries.occluded, (&raw mut query).cast());
        query.tfar < 0.0
    }

    /// As [`Self::closest`] for up to sixteen rays (origin, direction) at once, said to be coherent or not: a bit for each that
    /// hits.
    pub fn closest16(&self, rays: &[[Vec3A; 2]], coherent: bool) -> u16 {
        let rays = &rays[..rays.len().min(16)];
        let mut valid = Valid([0; 16]);
        let mut query = RtcRayHit16 {
            org: [[0.0; 16]; 3],
            tnear: [0.0; 16],
            dir: [[0.0; 16]; 3],
            time: [0.0; 16],
            tfar: [f32::INFINITY; 16],
            mask: [u32::MAX; 16],
            id: [0; 16],
            flags: [0; 16],
            ng: [[0.0; 16]; 3],
            u: [0.0; 16],
            v: [0.0; 16],
            prim_id: [INVALID; 16],
            geom_id: [INVALID; 16],
            inst_id: [INVALID; 16],
            inst_prim_id: [INVALID; 16],
        };
        for (lane, [origin, direction]) in rays.iter().enumerate() {
            valid.0[lane] = -1;
            for axis in 0..3 {
                query.org[axis][lane] = origin[axis];
                query.dir[axis][lane] = direction[axis];
            }
        }
        let (closest16, rays) = (self.embree.queries.closest16, (&raw mut query).cast());
        if self.embree.version[0] >= 4 {
            let flags = if coherent { COHERENT_4 } else { 0 };
            let none = std::ptr::null_mut();
            let mut arguments =
                Arguments { flags, feature_mask: u32::MAX, context: none, filter: none, intersect: none, rest: [0; 2] };
            // SAFETY: the scene is committed; mask and packet are aligned and sized as the header says; the arguments are
            // initialised as `rtcInitIntersectArguments` does.
            unsafe { closest16(valid.0.as_ptr(), self.handle, rays, (&raw mut arguments).cast()) };
        } else {
            let flags = if coherent { COHERENT_3 } else { 0 };
            let mut context = Context3 { flags, filter: std::ptr::null_mut(), inst_id: INVALID, rest: [0; 2] };
            // SAFETY: as above, with the context in the place where version 3 takes it.
            unsafe { closest16(valid.0.as_ptr(), self.handle, (&raw mut context).cast(), rays) };
        }
        (0..16).fold(0, |bits, lane| bits | u16::from(valid.0[lane] != 0 && query.geom_id[lane] != INVALID) << lane)
    }
}
