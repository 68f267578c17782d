//! Radiance RGBE.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::hdr;
use renderflow_fuzz::{catch_in_readers, names_file, watch};
use std::path::Path;

fuzz_target!(
    init: catch_in_readers(),
    |bytes: &[u8]| watch(|| {
        let name = Path::new("input.hdr");
        match hdr::decode(name, bytes) {
            Ok(loaded) => {
                let map = loaded.map;
                assert_eq!(map.pixels.len(), map.width * map.height);
                assert!(map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
                // Written and read again it is the same picture: encoding finds the exponents back.
                let again = hdr::decode(name, &hdr::encode(&map)).expect("an encoded map can be read").map;
                let once_more = hdr::decode(name, &hdr::encode(&again)).expect("an encoded map can be read").map;
                assert!(again == once_more);
            }
            Err(error) => names_file(error, &["input.hdr"]),
        }
    })
);
