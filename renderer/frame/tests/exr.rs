//! Frame files: what is written comes back, other readers see the table's channels, and bad frames are refused.

mod common;

use ::exr::prelude::{ReadChannels, ReadLayers};
use glam::{Mat4, Vec3A, Vec4};
use half::f16;
use renderflow_frame::channel::{LAYERS, Storage};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Error, Frame, exr};
use std::path::Path;

const NAME: &str = "frame.exr";

fn encode(frame: &Frame) -> Result<(Vec<u8>, usize), Error> {
    exr::encode(Path::new(NAME), frame)
}

fn decode(bytes: &[u8]) -> Result<Frame, Error> {
    exr::decode(Path::new(NAME), bytes)
}

fn half(picture: &Rgb) -> Rgb {
    picture.map(|p| p.map(|v| f16::from_f32(v).to_f32()))
}

/// The frame with its half channels rounded as the file rounds them.
fn rounded(frame: &Frame) -> Frame {
    let round2 = |picture: &Image<[f32; 2]>| picture.map(|p| p.map(|v| f16::from_f32(v).to_f32()));
    Frame {
        beauty: frame.beauty.as_ref().map(half),
        alpha: frame.alpha.map(|&v| f16::from_f32(v).to_f32()),
        raw: frame.raw.as_ref().map(half),
        light: frame.light.each_ref().map(|light| light.as_ref().map(half)),
        indirect: frame.indirect.as_ref().map(half),
        hidden: frame.hidden.as_ref().map(half),
        albedo: half(&frame.albedo),
        normal: half(&frame.normal),
        material: half(&frame.material),
        transmittance: frame.transmittance.as_ref().map(half),
        through: frame.through.as_ref().map(half),
        irradiance: frame.irradiance.as_ref().map(half),
        guide_albedo: frame.guide_albedo.as_ref().map(half),
        guide_normal: frame.guide_normal.as_ref().map(half),
        motion: frame.motion.as_ref().map(round2),
        motion_prev: frame.motion_prev.as_ref().map(round2),
        ..frame.clone()
    }
}

fn without_options(frame: &Frame) -> Frame {
    Frame {
        beauty: None,
        raw: None,
        variance: None,
        samples: None,
        light: Default::default(),
        indirect: None,
        hidden: None,
        transmittance: None,
        through: None,
        irradiance: None,
        guide_albedo: None,
        guide_normal: None,
        motion: None,
        motion_prev: None,
        ..frame.clone()
    }
}

#[test]
fn a_frame_comes_back_with_its_header() {
    // Sizes around the 16 rows of a ZIP block.
    for (width, height) in [(1, 1), (5, 3), (32, 16), (33, 17), (70, 50)] {
        let frame = common::frame(width, height);
        for mut frame in [without_options(&frame), frame] {
            for denoiser in [None, Some("débruiteur".to_owned())] {
                (frame.info.branches, frame.info.indirect_limit) =
                    if denoiser.is_some() { (Some(4), Some(0.1)) } else { (None, None) };
                frame.info.light_paths = denoiser.is_some();
                frame.info.denoiser = denoiser;
                let (bytes, clamped) = encode(&frame).unwrap();
                assert_eq!(clamped, 0);
                assert_eq!(decode(&bytes).unwrap(), rounded(&frame), "{width} x {height}");
            }
        }
    }
}

#[test]
fn a_header_without_a_camera_comes_back_too() {
    let frame = Frame { info: Default::default(), ..common::frame(4, 4) };
    assert_eq!(decode(&encode(&frame).unwrap().0).unwrap().info, frame.info);
}

/// Random cameras: text must not lose a bit of a float.
#[test]
fn cameras_come_back_bit_for_bit() {
    let mut frame = common::frame(2, 2);
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f32::from_bits((state & 0x807f_ffff) | ((100 + (state >> 24) % 50) << 23))
    };
    for _ in 0..200 {
        let mut camera = common::camera(2, 2);
        camera.camera_to_world.translation = Vec3A::new(random(), random(), random());
        camera.camera_to_world.matrix3.x_axis = Vec3A::new(random(), random(), random());
        (camera.fl_x, camera.fl_y, camera.cx, camera.cy) = (random(), random(), random(), random());
        frame.info.camera = camera;
        frame.info.exposure = random();
        assert_eq!(decode(&encode(&frame).unwrap().0).unwrap().info, frame.info);
    }
}

#[test]
fn the_same_frame_gives_the_same_bytes() {
    // Hash maps are seeded anew each time: twenty files would differ somewhere if any order came from one.
    let frame = common::frame(20, 20);
    let first = encode(&frame).unwrap().0;
    assert!((0..20).all(|_| encode(&frame).unwrap().0 == first));
}

/// `openexr_read.py` asked OpenEXR's own reader what it sees in the file of `write_sample_frame`.
#[test]
fn openexr_sees_the_channels_of_the_table() {
    let reference: serde_json::Value = serde_json::from_str(include_str!("references/openexr_read.json")).unwrap();
    let mut expected = serde_json::Map::new();
    for layer in LAYERS {
        let storage = match layer.storage {
            Storage::Half => "HALF",
            Storage::Float => "FLOAT",
            Storage::Uint => "UINT",
        };
        expected.extend(layer.channel_names().map(|name| (name, storage.into())));
    }
    assert_eq!(reference["channels"], serde_json::Value::Object(expected));
    assert_eq!(reference["parts"], 1);
    assert_eq!(reference["compression"], "ZIP_COMPRESSION");
    assert_eq!(reference["lineOrder"], "INCREASING_Y");
    assert_eq!(reference["has_name"], false);

    // The values it read at pixel (7, 5), and the bytes it read them from.
    let frame = rounded(&common::frame(24, 18));
    let at = |channel: &str| reference["pixel_7_5"][channel].as_f64().unwrap();
    assert_eq!(at("depth.Z") as f32, *frame.depth.at(7, 5));
    assert_eq!(at("albedo.G") as f32, frame.albedo.at(7, 5)[1]);
    assert_eq!(at("normal.Z") as f32, frame.normal.at(7, 5)[2]);
    assert_eq!(at("variance.B") as f32, frame.variance.unwrap().at(7, 5)[2]);
    assert_eq!(at("object_id.I") as u32, *frame.object_id.at(7, 5));
    assert_eq!(at("material_id.I") as u32, *frame.material_id.at(7, 5));
    assert_eq!(at("motion_prev.X") as f32, frame.motion_prev.unwrap().at(7, 5)[0]);
}

/// The matrices OpenEXR's reader found, applied as its documentation says: row vectors, z along the view, (0, 0) at the top left.
#[test]
fn standard_camera_attributes_project_as_the_camera_does() {
    let reference: serde_json::Value = serde_json::from_str(include_str!("references/openexr_read.json")).unwrap();
    // Rows of a matrix for row vectors are columns of glam's.
    let matrix = |name: &str| {
        let numbers: Vec<f32> = reference[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32).collect();
        Mat4::from_cols_slice(&numbers)
    };
    let camera = common::camera(24, 18);
    for p in [Vec3A::ZERO, Vec3A::new(0.2, 0.7, 0.1), Vec3A::new(-0.6, 0.3, -1.0)] {
        let (pixel, depth) = camera.project(p).unwrap();
        let cam = matrix("worldToCamera") * Vec4::from((p, 1.0));
        assert!((cam.z - depth).abs() < 1e-5, "{cam} at depth {depth}");
        assert!((cam.x / cam.z - (pixel.x - camera.cx) / camera.fl_x).abs() < 1e-5);
        assert!((cam.y / cam.z - (camera.cy - pixel.y) / camera.fl_y).abs() < 1e-5);
        let ndc = matrix("worldToNDC") * Vec4::from((p, 1.0));
        assert!((ndc.x / ndc.w * 24.0 - pixel.x).abs() < 1e-4);
        assert!((ndc.y / ndc.w * 18.0 - pixel.y).abs() < 1e-4);
    }
}

/// What is written now is what OpenEXR's reader was shown then: a change here needs the reference made anew.
#[test]
fn the_reference_is_of_what_is_written_now() {
    let reference: serde_json::Value = serde_json::from_str(include_str!("references/openexr_read.json")).unwrap();
    let (bytes, _) = encode(&common::frame(24, 18)).unwrap();
    let meta = ::exr::meta::MetaData::read_from_buffered(&bytes[..], true).unwrap();
    let header = &meta.headers[0];
    let channels = header.channels.list.iter().map(|c| {
        let storage = match c.sample_type {
            ::exr::meta::attribute::SampleType::F16 => "HALF",
            ::exr::meta::attribute::SampleType::F32 => "FLOAT",
            ::exr::meta::attribute::SampleType::U32 => "UINT",
        };
        (c.name.to_string(), storage.into())
    });
    assert_eq!(reference["channels"], serde_json::Value::Object(channels.collect()));
    let own = &header.own_attributes;
    for (name, matrix) in [("worldToCamera", own.world_to_camera), ("worldToNDC", own.world_to_normalized_device)] {
        for (now, then) in matrix.unwrap().iter().zip(reference[name].as_array().unwrap()) {
            assert!((f64::from(*now) - then.as_f64().unwrap()).abs() < 1e-5, "{name}");
        }
    }
    assert_eq!(own.layer_name, None);
    let reader = ::exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let image = reader.all_attributes().from_buffered(std::io::Cursor::new(&bytes)).unwrap();
    for channel in image.layer_data.channel_data.list {
        let then = reference["pixel_7_5"][channel.name.to_string()].as_f64().unwrap();
        match channel.sample_data {
            ::exr::prelude::FlatSamples::U32(ids) => assert_eq!(f64::from(ids[5 * 24 + 7]), then),
            samples => assert_eq!(samples.value_by_flat_index(5 * 24 + 7).to_f32(), then as f32, "{}", channel.name),
        }
    }
    for (name, then) in reference["attributes"].as_object().unwrap() {
        if let Some(::exr::meta::attribute::AttributeValue::Text(now)) = own.other.get(name.as_bytes()) {
            assert_eq!(now.to_string(), then.as_str().unwrap());
        }
    }
}

#[test]
fn values_beyond_half_are_clamped_and_counted() {
    let mut frame = common::frame(4, 4);
    frame.raw.as_mut().unwrap().pixels[5] = [1e9, 65505.0, 65504.0];
    frame.beauty.as_mut().unwrap().pixels[0][2] = -70000.0;
    // Variance is a float channel: nothing to clamp.
    frame.variance.as_mut().unwrap().pixels[3] = [1e30; 3];
    let (bytes, clamped) = encode(&frame).unwrap();
    assert_eq!(clamped, 3);
    let read = decode(&bytes).unwrap();
    assert_eq!(read.raw.unwrap().pixels[5], [65504.0; 3]);
    assert_eq!(read.beauty.unwrap().pixels[0][2], -65504.0);
    assert_eq!(read.variance.unwrap().pixels[3], [1e30; 3]);
}

#[test]
fn nan_and_infinity_are_refused_by_channel_and_pixel() {
    type Spoil = fn(&mut Frame);
    let cases: &[(Spoil, &str)] = &[
        (|f| f.normal.pixels[9][1] = f32::NAN, "channel normal.Y is NaN at pixel (4, 1)"),
        (|f| f.beauty.as_mut().unwrap().pixels[0][0] = f32::INFINITY, "channel R is inf at pixel (0, 0)"),
        (|f| f.alpha.pixels[14] = f32::NAN, "channel A is NaN at pixel (4, 2)"),
        (|f| f.variance.as_mut().unwrap().pixels[1][2] = f32::INFINITY, "channel variance.B is inf at pixel (1, 0)"),
        (|f| f.depth.pixels[6] = f32::NAN, "channel depth.Z is NaN at pixel (1, 1)"),
        (|f| f.depth.pixels[6] = f32::NEG_INFINITY, "channel depth.Z is -inf at pixel (1, 1)"),
        (|f| f.motion.as_mut().unwrap().pixels[4][0] = f32::NAN, "channel motion.X is NaN at pixel (4, 0)"),
        (|f| f.info.exposure = f32::NAN, "exposure is NaN"),
        (|f| f.info.camera.fl_x = f32::INFINITY, "camera holds NaN or infinity"),
        (|f| f.info.spp = u32::MAX, "4294967295 samples"),
        (|f| f.info.branches = Some(u32::MAX), "4294967295 samples a camera ray"),
        (|f| f.info.indirect_limit = Some(0.0), "limit of indirect light is 0"),
        (|f| f.info.indirect_limit = Some(f32::INFINITY), "limit of indirect light is inf"),
        (|f| f.material = Image::filled(5, 2, [0.0; 3]), "channel material.R is 5 x 2"),
        (|f| f.object_id.pixels.clear(), "channel object_id.I is 5 x 3 with 0 pixels"),
        (|f| f.width = 0, "0 x 3"),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (spoil, expected) in cases {
        let mut frame = common::frame(5, 3);
        spoil(&mut frame);
        let path = folder.path().join(NAME);
        let error = exr::write(&path, &frame).unwrap_err().to_string();
        assert!(error.contains(expected) && error.starts_with(path.to_str().unwrap()), "{error:?} does not say {expected:?}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "something was left behind");
}

/// Other people's files against OpenEXR's own reader (`openexr_rgb.py`).
#[test]
fn pixels_of_other_files_are_those_openexr_reads() {
    let Some(folder) = common::asset("exr") else { return };
    let reference: serde_json::Value = serde_json::from_str(include_str!("references/openexr_rgb.json")).unwrap();
    for (name, expected) in reference.as_object().unwrap() {
        let picture = exr::read_rgb(&folder.join(name)).unwrap();
        assert_eq!(
            (Some(picture.width as u64), Some(picture.height as u64)),
            (expected["width"].as_u64(), expected["height"].as_u64())
        );
        for (at, rgb) in expected["pixels"].as_object().unwrap() {
            let (x, y) = at.split_once(',').unwrap();
            let read = picture.at(x.parse().unwrap(), y.parse().unwrap()).map(|v| serde_json::Value::from(f64::from(v)));
            assert_eq!(&read[..], &rgb.as_array().unwrap()[..], "{name} at {at}");
        }
    }
}

#[test]
fn files_that_are_no_frames_are_refused() {
    assert!(exr::read(Path::new("no/frame.exr")).unwrap_err().to_string().starts_with("no/frame.exr: cannot read: "));
    assert!(decode(b"P6 1 1 255 abc").is_err());
    if let Some(path) = common::asset("exr/TestImages/RgbRampsDiagonal.exr") {
        let error = exr::read(&path).unwrap_err().to_string();
        assert!(error.contains("renderflow/conventions is missing"), "{error}");
        let picture = exr::read_rgb(&path).unwrap();
        assert_eq!(picture.pixels.len(), picture.width * picture.height);
    }
    if let Some(path) = common::asset("exr/TestImages/GrayRampsHorizontal.exr") {
        let error = exr::read_rgb(&path).unwrap_err().to_string();
        assert!(error.contains("no channels R, G, B; found Y"), "{error}");
    }
}

/// Renames a channel in the header: the reader must say which one it misses.
#[test]
fn a_missing_channel_is_named() {
    let (bytes, _) = encode(&common::frame(3, 3)).unwrap();
    for (channel, renamed) in [("depth.Z\0", "depth.Q\0"), ("raw.G\0", "raw.Q\0"), ("material_id.I\0", "material_id.Q\0")] {
        let at = bytes.windows(channel.len()).position(|w| w == channel.as_bytes()).unwrap();
        let mut bytes = bytes.clone();
        bytes[at..at + renamed.len()].copy_from_slice(renamed.as_bytes());
        let error = decode(&bytes).unwrap_err().to_string();
        let name = channel.trim_end_matches('\0');
        assert_eq!(error, format!("{NAME}: channel {name} is missing"));
    }
}

/// Colours of ACES or Rec.2020 that were taken for those of Rec.709 would be wrong without a word.
#[test]
fn other_primaries_are_converted() {
    let frame = common::frame(3, 3);
    let (bytes, _) = encode(&frame).unwrap();
    let find = b"chromaticities\0chromaticities\0";
    let at = bytes.windows(find.len()).position(|w| w == find).unwrap() + find.len() + 4;
    let with = |chromaticities: [f32; 8]| {
        let mut bytes = bytes.clone();
        chromaticities.iter().zip(bytes[at..].chunks_exact_mut(4)).for_each(|(v, place)| place.copy_from_slice(&v.to_le_bytes()));
        exr::decode_rgb(Path::new(NAME), &bytes).map(|picture| picture.pixels).map_err(|e| e.to_string())
    };
    let d65 = [0.3127, 0.329];
    let join = |primaries: [f32; 6], white: [f32; 2]| -> [f32; 8] {
        std::array::from_fn(|k| if k < 6 { primaries[k] } else { white[k - 6] })
    };
    let stored = with(join([0.64, 0.33, 0.3, 0.6, 0.15, 0.06], d65)).unwrap();
    // The primaries that Radiance writes.
    assert_eq!(with(join([0.64, 0.33, 0.29, 0.6, 0.15, 0.06], d65)).unwrap(), stored);
    // The published matrices to Rec.709: of Rec.2020 (ITU-R BT.2087), and of ACEScg with Bradford's adaptation (OpenColorIO).
    let rec2020 = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
    let acescg = [[1.705_051, -0.621_792, -0.083_259], [-0.130_256, 1.140_805, -0.010_548], [-0.024_003, -0.128_969, 1.152_972]];
    let spaces = [
        (join([0.708, 0.292, 0.17, 0.797, 0.131, 0.046], d65), rec2020),
        (join([0.713, 0.293, 0.165, 0.83, 0.128, 0.044], [0.32168, 0.33767]), acescg),
    ];
    for (chromaticities, rows) in spaces {
        for (found, stored) in with(chromaticities).unwrap().iter().zip(&stored) {
            let most = stored.iter().fold(0.0, |most: f32, v| most.max(v.abs()));
            for (found, row) in found.iter().zip(rows) {
                let expected: f32 = row.iter().zip(stored).map(|(weight, v)| weight * v).sum();
                assert!((found - expected).abs() <= 2e-4 * most, "{found} and {expected}");
            }
        }
    }
    // On a line, and without numbers.
    for bad in [[0.64, 0.33, 0.32, 0.165, 0.16, 0.0825], [f32::NAN; 6], [f32::INFINITY; 6]] {
        assert!(with(join(bad, d65)).unwrap_err().contains("make no colours"));
    }
    assert!(with(join([0.708, 0.292, 0.17, 0.797, 0.131, 0.046], [0.3, 0.0])).unwrap_err().contains("make no colours"));
}

/// Light has no negative radiance, also where the colour lies beyond Rec.709.
#[test]
fn maps_of_wider_spaces_stay_positive() {
    let mut frame = common::frame(3, 3);
    frame.beauty = Some(renderflow_frame::image::Rgb::filled(3, 3, [0.0, 2.0, 0.0]));
    let (mut bytes, _) = encode(&frame).unwrap();
    let find = b"chromaticities\0chromaticities\0";
    let at = bytes.windows(find.len()).position(|w| w == find).unwrap() + find.len() + 4;
    let wide: [f32; 6] = [0.708, 0.292, 0.17, 0.797, 0.131, 0.046];
    wide.iter().zip(bytes[at..].chunks_exact_mut(4)).for_each(|(v, place)| place.copy_from_slice(&v.to_le_bytes()));
    let loaded = renderflow_frame::hdr::decode(Path::new(NAME), &bytes).unwrap();
    assert_eq!(loaded.repaired, 0);
    let [red, green, blue] = loaded.map.pixels[4];
    assert!(red == 0.0 && blue == 0.0 && (green - 2.0 * 1.1329).abs() < 1e-3, "{:?}", loaded.map.pixels[4]);
}

#[test]
fn another_format_is_refused() {
    let (bytes, _) = encode(&common::frame(3, 3)).unwrap();
    let find = b"{\"format\":1,";
    let at = bytes.windows(find.len()).position(|w| w == find).unwrap();
    let mut bytes = bytes;
    bytes[at + find.len() - 2] = b'7';
    assert!(decode(&bytes).unwrap_err().to_string().contains("frame format 7"));
}
