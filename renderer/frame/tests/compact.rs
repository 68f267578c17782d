//! Compact frame files: what comes back is within the stated precision, and damaged files are refused.

mod common;

use glam::{DVec3, Vec3};
use half::f16;
use renderflow_frame::color::linear_to_srgb;
use renderflow_frame::compact::{self, Keep};
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Frame, exr};
use std::path::Path;

const NAME: &str = "frame.rff";

fn encode(frame: &Frame) -> (Vec<u8>, compact::Loss) {
    compact::encode(Path::new(NAME), frame).unwrap()
}

fn decode(bytes: &[u8]) -> Result<Frame, String> {
    compact::decode(Path::new(NAME), bytes).map_err(|e| e.to_string())
}

fn random(state: &mut u64) -> f32 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 40) as f32 / (1 << 24) as f32
}

/// A frame whose every value is random, within the ranges of the table.
fn noise(width: usize, height: usize) -> Frame {
    let state = &mut 5u64;
    let mut frame = common::frame(width, height);
    let unit = |state: &mut u64| Image::from_fn(width, height, |_, _| [0; 3].map(|_| random(state)));
    (frame.albedo, frame.material) = (unit(state), unit(state));
    frame.beauty = Some(unit(state).map(|p| p.map(|v| (20.0 * (v - 0.5)).exp())));
    frame.alpha = Image::from_fn(width, height, |_, _| random(state));
    for i in 0..width * height {
        let hit = random(state) > 0.2;
        let normal = Vec3::from_array([0; 3].map(|_| random(state) - 0.5)).normalize_or_zero();
        frame.normal.pixels[i] = if hit { normal.to_array() } else { [0.0; 3] };
        frame.depth.pixels[i] = if hit { 0.3 * (7.0 * random(state)).exp() } else { f32::INFINITY };
        frame.motion.as_mut().unwrap().pixels[i] = [300.0 * (random(state) - 0.5), random(state)];
    }
    frame
}

fn half(image: &Rgb) -> Rgb {
    image.map(|p| p.map(|v| f16::from_f32(v).to_f32()))
}

fn half2(image: &Image<[f32; 2]>) -> Image<[f32; 2]> {
    image.map(|p| p.map(|v| f16::from_f32(v).to_f32()))
}

/// Largest difference of two pictures after `f`.
fn difference(a: &[f32], b: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(&a, &b)| (f(a) - f(b)).abs()).fold(0.0, f32::max)
}

/// Degrees between two unit vectors, precise for small angles.
fn degrees(a: [f32; 3], b: [f32; 3]) -> f64 {
    let [a, b] = [a, b].map(|v| DVec3::from_array(v.map(f64::from)));
    a.cross(b).length().atan2(a.dot(b)).to_degrees()
}

#[test]
fn every_layer_keeps_the_precision_it_states() {
    for frame in [noise(1, 1), noise(31, 17), noise(160, 90), common::frame(64, 40)] {
        let (bytes, loss) = encode(&frame);
        let read = decode(&bytes).unwrap();
        assert_eq!((loss.clamped, &read.info), (0, &frame.info));
        // No worse than OpenEXR's halves.
        assert_eq!(read.beauty, frame.beauty.as_ref().map(half));
        assert_eq!(read.irradiance, frame.irradiance.as_ref().map(half));
        assert_eq!(read.motion, frame.motion.as_ref().map(half2));
        assert_eq!(read.motion_prev, frame.motion_prev.as_ref().map(half2));
        assert_eq!((&read.object_id, &read.material_id), (&frame.object_id, &frame.material_id));
        let (unit, linear) = (0.5 / 255.0 + 1e-6, |v| v);
        assert!(difference(&read.alpha.pixels, &frame.alpha.pixels, linear) <= unit);
        assert!(difference(read.material.pixels.as_flattened(), frame.material.pixels.as_flattened(), linear) <= unit);
        let (now, then) = (read.albedo.pixels.as_flattened(), frame.albedo.pixels.as_flattened());
        assert!(difference(now, then, linear_to_srgb) <= unit);
        assert!(difference(now, then, linear) <= 0.0045);
        for (now, then) in read.normal.pixels.iter().zip(&frame.normal.pixels) {
            match then {
                [0.0, 0.0, 0.0] => assert_eq!(*now, [0.0; 3]),
                _ => {
                    assert!(degrees(*now, *then) <= 0.04, "{now:?} {then:?}: {}", degrees(*now, *then));
                    assert!((Vec3::from_array(*now).length() - 1.0).abs() < 1e-6);
                }
            }
        }
        assert!(loss.depth <= 1e-4);
        for (now, then) in read.depth.pixels.iter().zip(&frame.depth.pixels) {
            let same = now == then;
            assert!(same || (now - then).abs() <= loss.depth * then * 1.000_01, "{now} {then} {loss:?}");
        }
        assert!(read.raw.is_none() && read.variance.is_none() && read.samples.is_none() && read.guide_albedo.is_none());
        assert!(read.guide_normal.is_none() && read.light.iter().all(Option::is_none));
        assert!(read.indirect.is_none() && read.hidden.is_none());
        // What was rounded once stays.
        assert_eq!(decode(&encode(&read).0).unwrap().albedo, read.albedo);
        assert_eq!(decode(&encode(&read).0).unwrap().normal, read.normal);
    }
}

/// Directions all over the sphere, the seams of the octahedron included.
#[test]
fn normals_everywhere() {
    let size = 200;
    let state = &mut 3u64;
    let mut frame = common::frame(size, size);
    frame.normal = Image::from_fn(size, size, |x, y| {
        let axes = [0.0, 1.0, -1.0, 1e-7, -1e-7, 0.5];
        let v = match y {
            0..6 => Vec3::new(axes[y], axes[x % 6], axes[x / 6 % 6]),
            _ => Vec3::from_array([0; 3].map(|_| random(state) + random(state) + random(state) - 1.5)),
        };
        v.normalize_or_zero().to_array()
    });
    let read = decode(&encode(&frame).0).unwrap();
    let worst = |f: fn([f32; 3]) -> bool| {
        let pairs = read.normal.pixels.iter().zip(&frame.normal.pixels).filter(|&(_, &n)| n != [0.0; 3] && f(n));
        pairs.map(|(now, then)| degrees(*now, *then)).fold(0.0, f64::max)
    };
    let (all, axes) = (worst(|_| true), worst(|n| n.iter().filter(|v| **v == 0.0).count() == 2));
    assert!(all <= 0.04 && axes == 0.0, "{all} {axes}");
    assert!(all > 0.01, "the bound is nowhere near what happens: {all}");
}

#[test]
fn depth_of_any_range() {
    let mut frame = common::frame(40, 3);
    let mut with = |depth: &dyn Fn(usize) -> f32| {
        frame.depth = Image::from_fn(40, 3, |x, y| depth(x + 40 * y));
        let (bytes, loss) = encode(&frame);
        let read = decode(&bytes).unwrap().depth;
        for (now, then) in read.pixels.iter().zip(&frame.depth.pixels) {
            assert!(now == then || (now - then).abs() <= loss.depth * then * 1.000_01, "{now} {then} {loss:?}");
        }
        loss.depth
    };
    assert_eq!(with(&|_| f32::INFINITY), 0.0);
    assert_eq!(with(&|_| 3.7), 0.0);
    assert_eq!(with(&|i| if i % 2 == 0 { f32::INFINITY } else { f32::MAX }), 0.0);
    assert_eq!(with(&|i| f32::from_bits(1 + i as u32)), 0.0);
    // One octave, then ten, then too many, then what a broken renderer may say.
    assert!(with(&|i| 1.0 + i as f32 / 120.0) <= 8e-6);
    assert!(with(&|i| (i as f32 / 17.0).exp()) <= 8e-5);
    assert_eq!(with(&|i| (i as f32 / 5.0).exp2()), 0.0);
    assert_eq!(with(&|i| i as f32 - 3.0), 0.0);
}

#[test]
fn ids_take_the_smallest_integer() {
    for (highest, bytes) in [(255, 1), (256, 2), (65_535, 2), (65_536, 4), (u32::MAX, 4)] {
        let mut frame = common::frame(20, 10);
        frame.object_id.pixels.iter_mut().enumerate().for_each(|(i, id)| *id = highest - (i % 3) as u32);
        let file = encode(&frame).0;
        assert_eq!(decode(&file).unwrap().object_id, frame.object_id);
        let text = header(&file);
        let layer = text["layers"].as_array().unwrap().iter().find(|l| l["name"] == "object_id").unwrap();
        assert_eq!(layer["encoding"], format!("u{}", 8 * bytes));
    }
}

/// The header as another program reads it.
fn header(file: &[u8]) -> serde_json::Value {
    let length = u32::from_le_bytes(file[8..12].try_into().unwrap()) as usize;
    serde_json::from_slice(&zstd::decode_all(&file[16..16 + length]).unwrap()).unwrap()
}

#[test]
fn all_layers_can_be_kept_and_any_loaded_alone() {
    let frame = noise(30, 20);
    let (bytes, _) = compact::encode_with(Path::new(NAME), &frame, Keep::All).unwrap();
    let read = decode(&bytes).unwrap();
    assert_eq!(read.raw, frame.raw.as_ref().map(half));
    assert_eq!((&read.variance, &read.samples, &read.distance), (&frame.variance, &frame.samples, &frame.distance));
    assert_eq!(read.light[7], frame.light[7].as_ref().map(half));
    assert_eq!(read.guide_normal, frame.guide_normal.as_ref().map(half));
    assert_eq!(header(&bytes)["left_out"], serde_json::json!([]));

    let layers = |names: &[&str]| compact::decode_layers(Path::new(NAME), &bytes, names);
    let some = layers(&["albedo", "depth", "light.2"]).unwrap();
    assert_eq!((&some.albedo, &some.depth, &some.light[2]), (&read.albedo, &read.depth, &read.light[2]));
    assert_eq!((some.beauty, some.light[1].as_ref(), some.normal), (None, None, Rgb::default()));
    assert_eq!((some.width, some.height, some.info), (30, 20, frame.info.clone()));
    let error = layers(&["depth", "deep"]).unwrap_err().to_string();
    assert!(error.starts_with("frame.rff: no layer is called \"deep\"; there are beauty, alpha,"), "{error}");

    let training = header(&encode(&frame).0);
    assert_eq!(training["left_out"].as_array().unwrap().len(), 16);
    let wanted = [
        "beauty",
        "alpha",
        "albedo",
        "normal",
        "depth",
        "material",
        "transmittance",
        "through",
        "irradiance",
        "motion",
        "motion_prev",
    ];
    let names: Vec<_> = training["layers"].as_array().unwrap().iter().map(|l| l["name"].as_str().unwrap().to_owned()).collect();
    assert_eq!(names[..11], wanted);
    assert_eq!(names[11..], ["object_id", "material_id"]);
    for layer in training["layers"].as_array().unwrap() {
        assert!(!layer["precision"].as_str().unwrap().is_empty());
    }
}

#[test]
fn one_reader_for_both_forms() {
    let folder = tempfile::tempdir().unwrap();
    let frame = noise(24, 18);
    for (profile, decoded) in [
        (Profile::Full, exr::decode(Path::new("x"), &exr::encode(Path::new("x"), &frame).unwrap().0).unwrap()),
        (Profile::Compact, decode(&encode(&frame).0).unwrap()),
    ] {
        // The ending says nothing.
        let path = folder.path().join(format!("frame.{}", if profile == Profile::Full { "rff" } else { "exr" }));
        assert_eq!(profile.write(&path, &frame).unwrap(), 0);
        assert_eq!(frame_file::read(&path).unwrap(), decoded);
        assert_eq!(frame_file::info(&path, &std::fs::read(&path).unwrap()).unwrap(), frame.info);
        let again = profile.encode(&path, &frame).unwrap().0;
        assert_eq!(std::fs::read(&path).unwrap(), again, "the same frame gives the same bytes");
    }
    let error = frame_file::read(&folder.path().join("none.rff")).unwrap_err().to_string();
    assert!(error.contains("none.rff: cannot read"), "{error}");
    assert!(frame_file::decode(Path::new("no.rff"), b"PNG").unwrap_err().to_string().starts_with("no.rff: "));
}

#[test]
fn values_out_of_range_are_clamped_and_counted() {
    let mut frame = common::frame(6, 4);
    frame.beauty.as_mut().unwrap().pixels[3] = [1e9, 65504.0, -1e5];
    frame.albedo.pixels[2] = [1.5, -0.1, 1.0];
    frame.normal.pixels[7] = [0.0, 30.0, 0.0];
    let (bytes, loss) = encode(&frame);
    assert_eq!(loss.clamped, 4);
    let read = decode(&bytes).unwrap();
    assert_eq!(read.beauty.unwrap().pixels[3], [65504.0, 65504.0, -65504.0]);
    assert_eq!(read.albedo.pixels[2], [1.0, 0.0, 1.0]);
    assert_eq!(read.normal.pixels[7], [0.0, 1.0, 0.0]);
}

#[test]
fn what_no_frame_may_hold_is_not_written() {
    type Spoil = fn(&mut Frame);
    let cases: &[(Spoil, &str)] = &[
        (|f| f.normal.pixels[9][1] = f32::NAN, "channel normal.Y is NaN at pixel (4, 1)"),
        (|f| f.albedo.pixels[0][0] = f32::INFINITY, "channel albedo.R is inf at pixel (0, 0)"),
        (|f| f.depth.pixels[6] = f32::NEG_INFINITY, "channel depth.Z is -inf at pixel (1, 1)"),
        (|f| f.alpha.pixels[14] = f32::NAN, "channel A is NaN at pixel (4, 2)"),
        (|f| f.info.exposure = f32::NAN, "exposure is NaN"),
        (|f| f.info.camera.cx = f32::INFINITY, "camera holds NaN or infinity"),
        (|f| f.info.indirect_limit = Some(0.0), "limit of indirect light is 0"),
        (|f| f.info.branches = Some(0), "0 samples a camera ray"),
        (|f| f.motion = Some(Image::filled(5, 2, [0.0; 2])), "channel motion.X is 5 x 2"),
        (|f| f.object_id.pixels.clear(), "channel object_id.I is 5 x 3 with 0 pixels"),
        (|f| f.height = 0, "5 x 0"),
    ];
    for (spoil, wanted) in cases {
        let mut frame = common::frame(5, 3);
        spoil(&mut frame);
        let error = compact::encode(Path::new(NAME), &frame).unwrap_err().to_string();
        assert!(error.starts_with(NAME) && error.contains(wanted), "{error}");
    }
}
