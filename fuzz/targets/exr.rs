//! OpenEXR: frames, pictures and environment maps.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::{exr, hdr};
use renderflow_fuzz::{catch_in_readers, names_file, watch};
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let name = Path::new("input.exr");
        match exr::decode(name, bytes) {
            Ok(frame) => {
                let pixels = frame.width * frame.height;
                assert_eq!(frame.depth.pixels.len(), pixels);
                // What was accepted can be written again: the writer refuses NaN and wrong sizes in any channel.
                exr::encode(name, &frame).expect("an accepted frame can be written");
            }
            Err(error) => names_file(error, &["input.exr"]),
        }
        match exr::decode_rgb(name, bytes) {
            Ok(picture) => assert_eq!(picture.pixels.len(), picture.width * picture.height),
            Err(error) => names_file(error, &["input.exr"]),
        }
        match hdr::decode(name, bytes) {
            Ok(loaded) => assert!(loaded.map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0)),
            Err(error) => names_file(error, &["input.exr"]),
        }
    })
);
