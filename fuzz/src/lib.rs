//! What the fuzz targets share.

use renderflow_frame::reach;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::cell::RefCell;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::Once;

#[cfg(feature = "scenes")]
mod check;
#[cfg(feature = "scenes")]
pub mod scenes;

#[cfg(feature = "scenes")]
pub use check::check_scene;

thread_local! {
    static LAST_PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Makes panics silent until they leave the target: readers that catch a library's panics by design would else end the run,
/// because libfuzzer-sys aborts inside the panic hook. What leaves the target still ends it.
pub fn catch_in_readers() {
    std::panic::set_hook(Box::new(|info| LAST_PANIC.with(|last| *last.borrow_mut() = info.to_string())));
}

/// Makes this thread all of rayon's pool. A pool of its own would be woken for every piece of work, which takes longer than
/// most pieces.
fn work_here() {
    static DONE: Once = Once::new();
    DONE.call_once(|| {
        // Somebody who has made a pool before keeps it.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global();
    });
}

/// Runs a target; a panic that leaves it is printed and ends the process, for the fuzzer to see.
pub fn watch(target: impl FnOnce()) {
    work_here();
    if std::panic::catch_unwind(std::panic::AssertUnwindSafe(target)).is_err() {
        LAST_PANIC.with(|last| eprintln!("{}", last.borrow()));
        std::process::abort();
    }
}

/// Folder for inputs of loaders that take paths: `RENDERFLOW_FUZZ_DIR` (best in memory), else one of this process.
pub fn folder() -> PathBuf {
    let folder = match std::env::var_os("RENDERFLOW_FUZZ_DIR") {
        Some(folder) => PathBuf::from(folder),
        None => std::env::temp_dir().join(format!("renderflow-fuzz-{}", std::process::id())),
    };
    std::fs::create_dir_all(&folder).expect("the folder for inputs can be made");
    folder
}

/// Writes an input.
pub fn put(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("an input can be written");
}

/// An error must say which file it is about: one of `names`.
pub fn names_file(error: impl std::fmt::Display, names: &[&str]) {
    let message = error.to_string();
    assert!(names.iter().any(|name| message.contains(name)), "the message names none of {names:?}: {message}");
}

/// A name that was accepted for a file beside the one that says it must lead nowhere else.
pub fn plain(name: &str) {
    if let Err(reason) = reach::plain_name(name) {
        panic!("accepted: {reason}");
    }
}

/// What was accepted, written as JSON and read again, must be the same. Infinities, which JSON cannot hold, are found so as well.
pub fn same_again<T: Serialize + DeserializeOwned + PartialEq + Debug>(value: &T) {
    let json = serde_json::to_string(value).expect("what was accepted can be written");
    match serde_json::from_str::<T>(&json) {
        Ok(again) => assert_eq!(again, *value, "read again it is something else"),
        Err(error) => panic!("read again it is refused: {error}: {json}"),
    }
}

/// The parts of an input that stands for several files: what lies between NULs, at most `N`, the last one with the rest.
pub fn parts<const N: usize>(bytes: &[u8]) -> [&[u8]; N] {
    let mut parts = bytes.splitn(N, |&byte| byte == 0);
    std::array::from_fn(|_| parts.next().unwrap_or_default())
}

/// The text of a file as readers see it; `None` for bytes that are no text.
pub fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}
