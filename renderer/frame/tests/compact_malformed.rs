//! Damaged and hostile compact files: an error that names file and place, within bounded memory.

mod common;

use renderflow_frame::compact::{self, Keep};
use renderflow_frame::{Frame, Image};
use serde_json::{Value, json};
use std::path::Path;

const NAME: &str = "frame.rff";

fn encode(frame: &Frame) -> Vec<u8> {
    compact::encode_with(Path::new(NAME), frame, Keep::All).unwrap().0
}

fn error(bytes: &[u8]) -> String {
    let Err(error) = compact::decode(Path::new(NAME), bytes) else { panic!("a damaged file was accepted") };
    let error = error.to_string();
    let reason = error.strip_prefix("frame.rff: ").unwrap_or_else(|| panic!("no file in {error}"));
    let places = ["header", "layer", "byte", "cut short", "no compact frame", "frame format", "cannot be in"];
    assert!(places.iter().any(|place| reason.contains(place)), "no place in {error}");
    error
}

#[test]
fn every_truncation() {
    let bytes = encode(&common::frame(12, 9));
    for length in 0..bytes.len() {
        error(&bytes[..length]);
    }
    error(&[&bytes[..], &[7]].concat());
}

/// Checksums see every flipped bit, but for those that zstd's format leaves unused: they change nothing.
#[test]
fn every_flipped_bit() {
    let frame = common::frame(12, 9);
    let bytes = encode(&frame);
    let whole = compact::decode(Path::new(NAME), &bytes).unwrap();
    let mut unseen = 0;
    for at in 0..bytes.len() {
        for bit in 0..8 {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1 << bit;
            match compact::decode(Path::new(NAME), &damaged) {
                Ok(frame) => {
                    assert_eq!(frame, whole, "bit {bit} of byte {at}");
                    unseen += 1;
                }
                Err(_) => drop(error(&damaged)),
            }
        }
    }
    assert!(100 * unseen < 8 * bytes.len(), "{unseen} of {} bits do not matter", 8 * bytes.len());
}

/// The file with another header, its checksum right.
fn with_header(bytes: &[u8], change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let length = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    let mut header = serde_json::from_slice(&zstd::decode_all(&bytes[16..16 + length]).unwrap()).unwrap();
    change(&mut header);
    let json = serde_json::to_vec(&header).unwrap();
    let stored = zstd::encode_all(&json[..], 3).unwrap();
    let lengths = [stored.len() as u32, json.len() as u32].map(u32::to_le_bytes).concat();
    [&bytes[..8], &lengths, &stored, &bytes[16 + length..]].concat()
}

#[test]
fn headers_that_lie() {
    let bytes = encode(&common::frame(12, 9));
    assert!(compact::decode(Path::new(NAME), &with_header(&bytes, |_| {})).is_ok());
    let layers = header_layers(&bytes);
    let cases: Vec<(&str, Value, &str)> = vec![
        ("/width", json!(13), "layer beauty"),
        ("/width", json!(0), "0 x 9 is outside"),
        ("/width", json!(1u64 << 62), "is outside"),
        ("/height", json!(65536), "cannot be in"),
        ("/info/exposure", json!(null), "found null where a number is needed"),
        ("/info/exposure", json!(1e300), "a number too large"),
        ("/info/camera/fl_x", json!(1e300), "a number too large"),
        ("/conventions", json!("{\"format\": 9}"), "frame format 9"),
        ("/layers/0/name", json!("colour"), "/layers/0: no layer is called"),
        ("/layers/1/name", json!("beauty"), "a second layer beauty"),
        ("/layers/0/encoding", json!("u8"), "layer beauty cannot be"),
        ("/layers/0/encoding", json!("unit8"), "layer beauty"),
        ("/layers/0/components", json!(["R", "G"]), "layer beauty cannot be"),
        ("/layers/1/offset", json!(0), "layer alpha starts at 0"),
        ("/layers/1/bytes", json!(u64::MAX), "layer alpha has"),
        ("/layers/1/bytes", json!(0), "cannot be in 0"),
        ("/layers", json!([]), "layer alpha is missing"),
    ];
    for (pointer, value, wanted) in cases {
        let damaged = with_header(&bytes, |header| *header.pointer_mut(pointer).unwrap() = value);
        let error = error(&damaged);
        assert!(error.contains(wanted), "{pointer}: {error}");
    }
    let depth = layers.iter().position(|name| name == "depth").unwrap();
    for (key, value) in [("lowest", json!(0)), ("lowest", json!(0x7f80_0000u32)), ("step", json!(0)), ("step", json!(u32::MAX))] {
        let damaged = with_header(&bytes, |header| header["layers"][depth][key] = value);
        assert!(error(&damaged).contains("layer depth"), "{key}");
    }
    let damaged = with_header(&bytes, |header| drop(header["layers"][depth].as_object_mut().unwrap().remove("step")));
    assert!(error(&damaged).contains("layer depth"));
}

fn header_layers(bytes: &[u8]) -> Vec<String> {
    let length = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    let header: Value = serde_json::from_slice(&zstd::decode_all(&bytes[16..16 + length]).unwrap()).unwrap();
    header["layers"].as_array().unwrap().iter().map(|l| l["name"].as_str().unwrap().to_owned()).collect()
}

/// Infinities that a block holds although its checksum is right.
#[test]
fn blocks_with_infinities() {
    let bytes = encode(&common::frame(12, 9));
    // A half frame of infinities in place of the beauty, which comes first.
    let length = u32::from_le_bytes(bytes[8..12].try_into().unwrap()) as usize;
    let infinities = zstd::encode_all(&[vec![0u8; 108], vec![0x7c; 108]].concat().repeat(3)[..], 3).unwrap();
    let mut old = 0;
    let damaged = with_header(&bytes, |header| {
        old = header["layers"][0]["bytes"].as_u64().unwrap() as usize;
        header["layers"][0]["bytes"] = infinities.len().into();
        header["layers"][0]["delta"] = false.into();
        let shift = infinities.len() as i64 - old as i64;
        for layer in header["layers"].as_array_mut().unwrap().iter_mut().skip(1) {
            layer["offset"] = (layer["offset"].as_i64().unwrap() + shift).into();
        }
    });
    let header = damaged.len() - (bytes.len() - 16 - length);
    let damaged = [&damaged[..header], &infinities, &damaged[header + old..]].concat();
    assert!(error(&damaged).contains("layer beauty") && error(&damaged).contains("NaN or infinite"));
}

/// A picture of one colour compresses ten thousand times; its file must be believed all the same, and one that claims more must
/// not.
#[test]
fn pictures_of_one_colour() {
    let blank = |width, height| Frame {
        width,
        height,
        beauty: Some(Image::filled(width, height, [0.5; 3])),
        alpha: Image::filled(width, height, 0.0),
        albedo: Image::filled(width, height, [0.0; 3]),
        normal: Image::filled(width, height, [0.0; 3]),
        depth: Image::filled(width, height, f32::INFINITY),
        material: Image::filled(width, height, [0.0; 3]),
        object_id: Image::filled(width, height, 0),
        material_id: Image::filled(width, height, 0),
        ..Frame::default()
    };
    for size in [64, 3000] {
        let frame = blank(size, size);
        let bytes = encode(&frame);
        // (Not assert_eq: nobody wants to read nine million pixels.)
        assert!(compact::decode(Path::new(NAME), &bytes).unwrap() == frame, "{size}");
        // The larger one is believed for the zeros at its end alone.
        let cut = &bytes[..bytes.len() - 100];
        let reason = if size == 64 { "cut short" } else { "cannot be in" };
        assert!(cut[cut.len() - 50..].iter().all(|b| *b == 0) == (size > 64) && error(cut).contains(reason));
    }
    let bytes = encode(&blank(64, 64));
    let huge = with_header(&bytes, |header| (header["width"], header["height"]) = (json!(16384), json!(16384)));
    assert!(error(&huge).contains("cannot be in"));
}
