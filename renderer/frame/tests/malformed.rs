//! Damaged and hostile OpenEXR files: every reader answers with a value or an error that names the file, within bounded memory
//! and time.

mod common;

use renderflow_frame::{exr, hdr};
use std::path::Path;

/// Every reader on one file held in memory; errors must name it.
fn read_all_ways(name: &Path, bytes: &[u8]) {
    let check = |error: renderflow_frame::Error| assert!(error.to_string().starts_with(name.to_str().unwrap()), "{error}");
    match exr::decode(name, bytes) {
        Ok(frame) => assert_eq!(frame.depth.pixels.len(), frame.width * frame.height),
        Err(error) => check(error),
    }
    match exr::decode_rgb(name, bytes) {
        Ok(picture) => assert_eq!(picture.pixels.len(), picture.width * picture.height),
        Err(error) => check(error),
    }
    match hdr::decode(name, bytes) {
        Ok(loaded) => assert!(loaded.map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0)),
        Err(error) => check(error),
    }
}

#[test]
fn files_of_the_openexr_project_damaged_ones_included() {
    let Some(folder) = common::asset("exr") else { return };
    let files = common::files(&folder);
    assert!(files.len() > 20);
    for path in files {
        let bytes = std::fs::read(&path).unwrap();
        read_all_ways(&path, &bytes);
    }
}

#[test]
fn truncated_frames() {
    let (bytes, _) = exr::encode(Path::new("frame.exr"), &common::frame(20, 20)).unwrap();
    for length in (0..bytes.len()).step_by(11) {
        let error = exr::decode(Path::new("frame.exr"), &bytes[..length]).expect_err("a truncated frame was accepted");
        assert!(error.to_string().starts_with("frame.exr: "), "{error}");
    }
}

/// Bytes changed at random, in the header more often than elsewhere.
#[test]
fn mutated_frames() {
    let (bytes, _) = exr::encode(Path::new("frame.exr"), &common::frame(20, 20)).unwrap();
    let header = bytes.windows(10).position(|w| w == b"worldToNDC").unwrap();
    let mut state = 7u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for round in 0..1500 {
        let mut damaged = bytes.clone();
        for _ in 0..1 + random(4) {
            let at = random(if round % 3 > 0 { header } else { damaged.len() });
            damaged[at] = [0, 1, 0x7f, 0x80, 0xff, random(256) as u8][random(6)];
        }
        read_all_ways(Path::new("frame.exr"), &damaged);
    }
}

/// A header that promises a huge picture must be refused before memory is asked for.
#[test]
fn sizes_are_checked_before_allocation() {
    let (bytes, _) = exr::encode(Path::new("frame.exr"), &common::frame(20, 20)).unwrap();
    let at = |name: &str| bytes.windows(name.len()).position(|w| w == name.as_bytes()).unwrap() + name.len() + 4;
    let (data, display) = (at("dataWindow\0box2i\0"), at("displayWindow\0box2i\0"));
    for (right, bottom) in [(99_999, 19), (19, 99_999), (60_000, 60_000), (16_000, 16_000), (1 << 29, 1 << 29)] {
        let mut huge = bytes.clone();
        for window in [data, display] {
            huge[window + 8..window + 12].copy_from_slice(&i32::to_le_bytes(right));
            huge[window + 12..window + 16].copy_from_slice(&i32::to_le_bytes(bottom));
        }
        let error = exr::decode(Path::new("frame.exr"), &huge).expect_err("a hollow file was accepted").to_string();
        // The reasons of this crate's own check, which stands before any decoding.
        assert!(error.contains("is outside") || error.contains("cannot be in"), "{error}");
    }
}

/// A refusal says where in the file it is: the byte, and the attribute that it belongs to.
#[test]
fn damage_has_a_place() {
    let (bytes, _) = exr::encode(Path::new("frame.exr"), &common::frame(20, 20)).unwrap();
    let error = |bytes: &[u8]| exr::decode(Path::new("frame.exr"), bytes).unwrap_err().to_string();
    let attribute = bytes.windows(11).position(|w| w == b"dataWindow\0").unwrap();
    let cut = error(&bytes[..attribute + 25]);
    assert!(cut.contains(&format!("byte {}, attribute \"dataWindow\": ", attribute + 25)), "{cut}");
    assert!(error(&bytes[..6]).contains("byte 6, in the header: "), "{}", error(&bytes[..6]));
    assert!(error(b"plain text, no picture").contains("no OpenEXR signature"));
    let pixels = error(&bytes[..bytes.len() - 1]);
    assert!(pixels.contains("behind the first header: "), "{pixels}");
    // The windows of a picture that covers a part of its frame.
    let display = bytes.windows(20).position(|w| w == b"displayWindow\0box2i\0").unwrap() + 24;
    let mut part = bytes.clone();
    part[display + 8..display + 12].copy_from_slice(&99_i32.to_le_bytes());
    let said = exr::decode_rgb(Path::new("frame.exr"), &part).unwrap_err().to_string();
    assert!(said.contains("its dataWindow, 20 x 20 from (0, 0), is not its displayWindow, 100 x 20 from (0, 0)"), "{said}");
}
