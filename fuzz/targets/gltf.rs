//! glTF as text or binary. Text that holds a NUL becomes a binary file: JSON before it, the binary chunk behind it,
//! so that mutations need not keep the lengths in the container right.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_fuzz::{catch_in_readers, check_scene, folder, names_file, put, scenes, watch};
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = folder();
    put(&folder.join("b.bin"), &(0..96u8).collect::<Vec<_>>());
    image::RgbImage::from_fn(3, 2, |x, y| image::Rgb([x as u8 * 90, y as u8 * 200, 7]))
        .save(folder.join("t.png"))
        .expect("t.png");
    folder
});

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let file = match bytes.iter().position(|&b| b == 0) {
            Some(end) if !bytes.starts_with(b"glTF") => Cow::Owned(scenes::binary(&bytes[..end], &bytes[end + 1..])),
            _ => Cow::Borrowed(bytes),
        };
        put(&FOLDER.join("input.gltf"), &file);
        match scenes::model(&FOLDER, "input.gltf") {
            Ok(scene) => {
                check_scene(&scene);
                scenes::in_motion(&FOLDER, "input.gltf");
            }
            Err(error) => names_file(error, &["input.gltf", "cannot use texture"]),
        }
    })
);
