//! Compact frames.
#![no_main]

use libfuzzer_sys::fuzz_target;
use renderflow_frame::compact::{self, Keep};
use renderflow_frame::{Frame, frame_file};
use renderflow_fuzz::{names_file, watch};
use std::path::Path;

/// What training and evaluation rely on in a frame that was accepted.
fn check(frame: &Frame) {
    let pixels = frame.width * frame.height;
    assert!(frame.depth.pixels.len() == pixels && frame.object_id.pixels.len() == pixels);
    assert!(frame.depth.pixels.iter().all(|d| !d.is_nan() && *d > f32::NEG_INFINITY));
    let pictures = [Some(&frame.albedo), Some(&frame.normal), Some(&frame.material), frame.beauty.as_ref(), frame.raw.as_ref()];
    for picture in pictures.into_iter().flatten() {
        assert!(picture.pixels.len() == pixels && picture.pixels.iter().flatten().all(|v| v.is_finite()));
    }
}

fuzz_target!(|bytes: &[u8]| watch(|| {
    let name = Path::new("input.rff");
    match compact::decode(name, bytes) {
        Ok(frame) => {
            check(&frame);
            // What was accepted can be written again, and comes back; the writer refuses NaN and wrong sizes in any channel.
            // (Not where its copies would break the fuzzer's limit of memory.)
            if frame.width * frame.height <= 1 << 20 {
                let (again, _) = compact::encode_with(name, &frame, Keep::All).expect("an accepted frame can be written");
                check(&compact::decode(name, &again).expect("a written frame can be read"));
            }
            compact::decode_layers(name, bytes, &["depth", "normal"]).expect("a part of an accepted frame can be read");
        }
        Err(error) => names_file(error, &["input.rff"]),
    }
    // Other bytes go to OpenEXR's reader.
    if bytes.starts_with(&compact::SIGNATURE) {
        assert_eq!(frame_file::info(name, bytes).is_ok(), compact::decode_layers(name, bytes, &[]).is_ok());
    }
    // Checksums stop most inputs: the same bytes as the blocks of a file whose header and checksums are right go further.
    unchecked(bytes);
}));

/// Takes the input apart into the header and blocks of a file that says of itself what the input says, so that mutations reach
/// what lies behind the checksums.
fn unchecked(bytes: &[u8]) {
    let Some((lengths, rest)) = bytes.split_at_checked(4) else { return };
    let header = u16::from_le_bytes([lengths[0], lengths[1]]) as usize;
    let Some((json, blocks)) = rest.split_at_checked(header) else { return };
    let Ok(stored) = zstd::bulk::compress(json, 1) else { return };
    let lengths = [1, stored.len() as u32, json.len() as u32].map(u32::to_le_bytes).concat();
    let file = [&compact::SIGNATURE[..], &lengths, &stored, blocks].concat();
    match compact::decode(Path::new("input.rff"), &file) {
        Ok(frame) => check(&frame),
        Err(error) => names_file(error, &["input.rff"]),
    }
}
