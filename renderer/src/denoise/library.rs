//! Finds the shared library of Intel Open Image Denoise while the program runs, so that one program works with it and without.

use std::env::{self, consts};
use std::error::Error;
use std::ffi::{c_char, c_int, c_void};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Names the library, or a folder that holds it. No other place is searched then.
pub const VARIABLE: &str = "RENDERFLOW_OIDN";

/// A device of OIDN, opaque.
#[repr(C)]
pub(super) struct Device([u8; 0]);

/// A filter of OIDN, opaque.
#[repr(C)]
pub(super) struct Filter([u8; 0]);

/// A buffer of OIDN, opaque.
#[repr(C)]
pub(super) struct Buffer([u8; 0]);

/// Returns whether the filter goes on.
pub(super) type Monitor = unsafe extern "C" fn(*mut c_void, f64) -> bool;

/// Values of the enums of `oidn.h` (version 2).
pub(super) const DEVICE_CPU: c_int = 1;
pub(super) const FORMAT_FLOAT3: c_int = 3;
pub(super) const QUALITY_FAST: c_int = 4;
pub(super) const QUALITY_HIGH: c_int = 6;
pub(super) const ERROR_NONE: c_int = 0;
pub(super) const ERROR_CANCELLED: c_int = 6;

/// Declares the table of functions: the name in the table, the name in the library, the arguments and the result.
macro_rules! functions {
    ($($field:ident: $symbol:literal ($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The functions of the library, with the signatures of `oidn.h`.
        pub(super) struct Oidn {
            $(pub(super) $field: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
            /// Where it was found.
            path: PathBuf,
        }

        impl Oidn {
            fn load(path: &Path) -> Result<Self, libloading::Error> {
                // SAFETY: the library is OIDN by its name, and what it does as it is loaded has no preconditions.
                let library = unsafe { libloading::Library::new(path) }?;
                let loaded = Self {
                    $(
                        // SAFETY: the type is that of the function in `oidn.h` of version 2, whose interface is stable.
                        $field: *unsafe { library.get(concat!($symbol, "\0").as_bytes()) }?,
                    )*
                    path: path.to_owned(),
                };
                // The functions stay valid because the library is never unloaded.
                std::mem::forget(library);
                Ok(loaded)
            }
        }
    };
}

functions! {
    new_device: "oidnNewDevice" (c_int) -> *mut Device;
    set_device_bool: "oidnSetDeviceBool" (*mut Device, *const c_char, bool);
    set_device_int: "oidnSetDeviceInt" (*mut Device, *const c_char, c_int);
    get_device_int: "oidnGetDeviceInt" (*mut Device, *const c_char) -> c_int;
    commit_device: "oidnCommitDevice" (*mut Device);
    get_device_error: "oidnGetDeviceError" (*mut Device, *mut *const c_char) -> c_int;
    release_device: "oidnReleaseDevice" (*mut Device);
    new_buffer: "oidnNewBuffer" (*mut Device, usize) -> *mut Buffer;
    write_buffer: "oidnWriteBuffer" (*mut Buffer, usize, usize, *const c_void);
    read_buffer: "oidnReadBuffer" (*mut Buffer, usize, usize, *mut c_void);
    release_buffer: "oidnReleaseBuffer" (*mut Buffer);
    new_filter: "oidnNewFilter" (*mut Device, *const c_char) -> *mut Filter;
    set_filter_image: "oidnSetFilterImage" (*mut Filter, *const c_char, *mut Buffer, c_int, usize, usize, usize, usize, usize);
    set_filter_bool: "oidnSetFilterBool" (*mut Filter, *const c_char, bool);
    set_filter_int: "oidnSetFilterInt" (*mut Filter, *const c_char, c_int);
    set_filter_monitor: "oidnSetFilterProgressMonitorFunction" (*mut Filter, Option<Monitor>, *mut c_void);
    commit_filter: "oidnCommitFilter" (*mut Filter);
    execute_filter: "oidnExecuteFilter" (*mut Filter);
    release_filter: "oidnReleaseFilter" (*mut Filter);
}

impl Oidn {
    /// The library, which is loaded once for the program.
    ///
    /// # Errors
    /// Why it cannot be loaded.
    pub fn get() -> Result<&'static Self, &'static str> {
        static LOADED: OnceLock<Result<Oidn, String>> = OnceLock::new();
        LOADED.get_or_init(Self::search).as_ref().map_err(String::as_str)
    }

    /// Where the library was found.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn search() -> Result<Self, String> {
        if let Some(named) = env::var_os(VARIABLE).filter(|value| !value.is_empty()) {
            let mut path = PathBuf::from(named);
            if path.is_dir() {
                path.push(file_name());
            }
            return Self::load(&path).map_err(|error| format!("{VARIABLE} names {}: {}", path.display(), reason(&error)));
        }
        let mut reasons = Vec::new();
        let beside = env::current_exe().map(|program| places(&program)).unwrap_or_default();
        for path in beside.iter().filter(|path| path.is_file()) {
            match Self::load(path) {
                Ok(loaded) => return Ok(loaded),
                Err(error) => reasons.push(format!("{}: {}", path.display(), reason(&error))),
            }
        }
        // The loader of the system searches its own folders.
        Self::load(Path::new(file_name())).map_err(|error| {
            reasons.push(reason(&error));
            reasons.join("; ")
        })
    }
}

/// What the loader of the system says.
fn reason(error: &libloading::Error) -> String {
    error.source().map_or_else(|| error.to_string(), ToString::to_string)
}

/// Files beside the program where the library may be: in an archive of a release, in an installation, and where `make oidn` puts
/// it, seen from `target/release` and from `target/release/deps`. OIDN's libraries find each other in a folder called `lib` only.
fn places(program: &Path) -> Vec<PathBuf> {
    let Some(folder) = program.parent() else { return Vec::new() };
    let fetched = Path::new(".oidn/pyoidn/oidn/lib");
    let mut places = vec![folder.join("lib"), folder.join("../lib/renderflow/lib")];
    places.extend(folder.ancestors().skip(2).take(2).map(|root| root.join(fetched)));
    places.into_iter().map(|place| place.join(file_name())).collect()
}

/// What the library of version 2 is called on this system.
fn file_name() -> &'static str {
    match consts::OS {
        "windows" => "OpenImageDenoise.dll",
        "macos" => "libOpenImageDenoise.2.dylib",
        _ => "libOpenImageDenoise.so.2",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_is_searched_beside_the_program() {
        let places = places(Path::new("/opt/renderflow/target/release/renderflow"));
        let expected = [
            "/opt/renderflow/target/release/lib",
            "/opt/renderflow/target/release/../lib/renderflow/lib",
            "/opt/renderflow/.oidn/pyoidn/oidn/lib",
            "/opt/.oidn/pyoidn/oidn/lib",
        ];
        assert_eq!(places, expected.map(|place| Path::new(place).join(file_name())));
    }

    #[test]
    fn a_file_that_is_no_library_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(file_name());
        std::fs::write(&path, "no library").unwrap();
        assert!(Oidn::load(&path).is_err());
        assert!(Oidn::load(&folder.path().join("absent")).is_err());
    }
}
