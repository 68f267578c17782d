//! PLY as text or binary.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, check_scene, folder, names_file, put, scenes, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        put(&FOLDER.join("input.ply"), bytes);
        match scenes::model(&FOLDER, "input.ply") {
            Ok(scene) => check_scene(&scene),
            Err(error) => names_file(error, &["input.ply"]),
        }
    })
);
