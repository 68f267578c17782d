//! Names in files: where they lead.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::reach::{Reach, plain_name};
use renderflow_fuzz::watch;
use std::path::{Component, Path};

/// That a name leads into one of `folders`, and means the same when it is read again.
fn check(reach: &Reach, name: &str, folders: &[&str]) {
    match reach.resolve(name) {
        Ok(path) => {
            assert!(folders.iter().any(|folder| path.starts_with(folder)), "{name:?} leads to {path:?}");
            assert!(path.components().all(|part| part != Component::ParentDir), "{name:?} leads to {path:?}");
            let again = path.to_str().expect("made of text");
            // A path from the root may be longer than a name may be.
            if again.len() <= name.len() {
                assert_eq!(reach.resolve(again), Ok(path.clone()), "{name:?}");
            }
        }
        Err(reason) => assert!(reason.len() < 2500 && !reason.contains(char::is_control), "{reason:?}"),
    }
}

fuzz_target!(|bytes: &[u8]| watch(|| {
    let Ok(name) = std::str::from_utf8(bytes) else { return };
    let folder = Reach::folder("/data/set");
    check(&folder, name, &["/data/set"]);
    check(&folder.clone().allow(["/models", "/data/set/../maps"]), name, &["/data/set", "/models", "/data/maps"]);
    check(&folder.at(Path::new("/other/file.json")), name, &["/other"]);
    match plain_name(name) {
        Ok(plain) => {
            assert_eq!(folder.resolve(plain), Ok(Path::new("/data/set").join(name)), "a plain name stays beside its file")
        }
        Err(reason) => assert!(reason.len() < 2500 && !reason.contains(char::is_control), "{reason:?}"),
    }
}));
