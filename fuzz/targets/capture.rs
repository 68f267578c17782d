//! Cameras of `transforms.json` as nerfstudio and instant-ngp write them, around a scene.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, check_scene, folder, names_file, put, scenes, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        put(&FOLDER.join("transforms.json"), bytes);
        match scenes::capture(&FOLDER, "transforms.json") {
            Ok(scene) => check_scene(&scene),
            Err(error) => names_file(error, &["transforms.json"]),
        }
    })
);
