//! PNG, JPEG and WebP as colour, data and normal maps.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, check_scene, folder, names_file, put, scenes, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(folder);

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        put(&FOLDER.join("input.png"), bytes);
        match scenes::textures(&FOLDER, "input.png") {
            Ok(scene) => check_scene(&scene),
            Err(error) => names_file(error, &["input.png"]),
        }
    })
);
