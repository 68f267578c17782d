//! OBJ with its MTL: the bytes up to the first NUL are the OBJ file, the rest is `m.mtl`; `t.png` and `t.jpg` stand beside them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, check_scene, folder, names_file, put, scenes, watch};
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = folder();
    image::RgbImage::from_fn(3, 2, |x, y| image::Rgb([x as u8 * 90, y as u8 * 200, 7]))
        .save(folder.join("t.png"))
        .expect("t.png");
    folder
});

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let (obj, mtl) = match bytes.iter().position(|&b| b == 0) {
            Some(end) => (&bytes[..end], &bytes[end + 1..]),
            None => (bytes, &b""[..]),
        };
        put(&FOLDER.join("input.obj"), obj);
        put(&FOLDER.join("m.mtl"), mtl);
        match scenes::model(&FOLDER, "input.obj") {
            Ok(scene) => check_scene(&scene),
            Err(error) => names_file(error, &["input.obj", "m.mtl", "cannot use texture"]),
        }
    })
);
