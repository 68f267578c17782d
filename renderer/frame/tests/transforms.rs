//! `transforms.json`: what is written comes back, in nerfstudio's keys, and errors name the key.

mod common;

use glam::{Affine3A, Quat, Vec2, Vec3, Vec3A};
use renderflow_frame::tracks::Tracks;
use renderflow_frame::transforms::{self, Sequence};
use renderflow_frame::{Camera, Error};
use serde_json::Value;
use std::path::Path;

fn sequence() -> Sequence {
    let camera = |i: usize| Camera {
        camera_to_world: Camera::look_at(Vec3A::new(0.3 * i as f32, 1.1, 3.3), Vec3A::ZERO, Vec3A::Y, 0.7, 256, 192)
            .camera_to_world,
        ..common::camera(256, 192)
    };
    let moved =
        |i: usize| Affine3A::from_rotation_translation(Quat::from_rotation_y(0.1 * i as f32), Vec3::new(0.2, 0.0, i as f32));
    Sequence {
        cameras: (0..20).map(camera).collect(),
        files: (0..20).map(|i| format!("frame.{i:04}.exr")).collect(),
        keyframes: vec![0, 16],
        exposure: 0.123_456_79,
        environment: "env.hdr".into(),
        environment_rotation: -1.234_567_9,
        environment_intensity: 0.1,
        tracks: Tracks { objects: [(3, (0..20).map(moved).collect())].into() },
    }
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn written(path: &Path, sequence: &Sequence) -> Value {
    transforms::write(path, sequence).unwrap();
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// Writes `json` and reads it as a sequence.
fn reread(path: &Path, json: &Value) -> Result<Sequence, Error> {
    std::fs::write(path, json.to_string()).unwrap();
    transforms::read(path)
}

#[test]
fn a_sequence_comes_back_exactly_with_shared_and_with_own_intrinsics() {
    let folder = folder();
    let path = folder.path().join("transforms.json");
    let mut sequence = sequence();
    for own in [false, true] {
        if own {
            sequence.cameras[3].fl_x *= 1.5;
        }
        let json = written(&path, &sequence);
        assert_eq!(json.get("fl_x").is_some(), !own);
        assert_eq!(json["frames"][3].get("fl_x").is_some(), own);
        assert_eq!(transforms::read(&path).unwrap(), sequence);
    }
    // An object whose movement is unknown.
    sequence.tracks.objects.insert(5, vec![]);
    assert_eq!(written(&path, &sequence)["object_transforms"]["5"], serde_json::json!([]));
    assert_eq!(transforms::read(&path).unwrap(), sequence);
    let empty = Sequence { cameras: vec![], files: vec![], keyframes: vec![], tracks: Tracks::default(), ..sequence };
    transforms::write(&path, &empty).unwrap();
    assert_eq!(transforms::read(&path).unwrap(), empty);
}

/// Projects with the numbers in the file as nerfstudio documents them: rows of camera-to-world, -z forward, y up, pixel centres
/// at +0.5.
#[test]
fn the_file_projects_points_as_the_camera_does() {
    let folder = folder();
    let sequence = sequence();
    let json = written(&folder.path().join("transforms.json"), &sequence);
    assert_eq!(json["convention"], "opengl_c2w");
    assert_eq!((json["w"].as_u64(), json["h"].as_u64()), (Some(256), Some(192)));
    let number = |value: &Value| value.as_f64().unwrap();
    let angle = 2.0 * (128.0 / number(&json["fl_x"])).atan();
    assert!((number(&json["camera_angle_x"]) - angle).abs() < 1e-6);
    for (camera, frame) in sequence.cameras.iter().zip(json["frames"].as_array().unwrap()) {
        let m = |row: usize, column: usize| number(&frame["transform_matrix"][row][column]);
        let p = [0.2, 0.4, -0.3];
        // Rotation is orthonormal: its transpose takes the offset from the eye into camera space.
        let offset = [p[0] - m(0, 3), p[1] - m(1, 3), p[2] - m(2, 3)];
        let cam = [0, 1, 2].map(|c| (0..3).map(|r| m(r, c) * offset[r]).sum::<f64>());
        let u = number(&json["cx"]) + number(&json["fl_x"]) * cam[0] / -cam[2];
        let v = number(&json["cy"]) - number(&json["fl_y"]) * cam[1] / -cam[2];
        let (pixel, depth) = camera.project(Vec3A::new(0.2, 0.4, -0.3)).unwrap();
        assert!((pixel - Vec2::new(u as f32, v as f32)).length() < 1e-2, "{pixel} against ({u}, {v})");
        assert!((f64::from(depth) + cam[2]).abs() < 1e-4);
    }
}

#[test]
fn a_missing_key_is_named() {
    let folder = folder();
    let path = folder.path().join("transforms.json");
    let good = written(&path, &sequence());
    for key in
        ["camera_model", "convention", "exposure", "environment", "keyframes", "frames", "fl_x", "fl_y", "cx", "cy", "w", "h"]
    {
        let mut json = good.clone();
        json.as_object_mut().unwrap().remove(key);
        let error = reread(&path, &json).unwrap_err().to_string();
        assert!(error.contains(key) && error.starts_with(path.to_str().unwrap()), "{key}: {error}");
    }
    for key in ["file_path", "transform_matrix"] {
        let mut json = good.clone();
        json["frames"][2].as_object_mut().unwrap().remove(key);
        assert!(reread(&path, &json).unwrap_err().to_string().contains(key));
    }
    for key in ["file", "rotation", "intensity"] {
        let mut json = good.clone();
        json["environment"].as_object_mut().unwrap().remove(key);
        assert!(reread(&path, &json).unwrap_err().to_string().contains(key));
    }
}

#[test]
fn wrong_values_are_errors_that_say_where() {
    let folder = folder();
    let path = folder.path().join("transforms.json");
    let good = written(&path, &sequence());
    let cases: &[(&str, Value, &str)] = &[
        ("/convention", "opencv_c2w".into(), "opencv_c2w"),
        ("/camera_model", "OPENCV_FISHEYE".into(), "OPENCV_FISHEYE"),
        ("/keyframes/1", 20.into(), "/keyframes: 20 is no frame"),
        ("/exposure", "bright".into(), "line 1 column"),
        ("/exposure", 1e39.into(), "a number too large at line 1 column"),
        (
            "/frames/7/file_path",
            "../frame.0007.exr".into(),
            "/frames/7/file_path: \"../frame.0007.exr\" is not the plain name of a file",
        ),
        ("/frames/7/file_path", "/frame.0007.exr".into(), "/frames/7/file_path: "),
        ("/frames/7/file_path", "images/0.exr".into(), "/frames/7/file_path: "),
        ("/environment/file", "../env.hdr".into(), "/environment/file: \"../env.hdr\" is not the plain name of a file"),
        ("/fl_y", (-1.0).into(), "fl_y of frame 0"),
        ("/w", 0.into(), "0 x 192"),
        ("/frames/4/transform_matrix/3/0", 0.5.into(), "/frames/4/transform_matrix: the last row"),
        ("/frames/4/transform_matrix/0/0", 7.into(), "/frames/4/transform_matrix is not a rotation"),
    ];
    for (pointer, value, expected) in cases {
        let mut json = good.clone();
        *json.pointer_mut(pointer).unwrap() = value.clone();
        let error = reread(&path, &json).unwrap_err().to_string();
        assert!(error.contains(expected), "{pointer}: {error}");
    }
    // A byte order mark is no part of the text.
    std::fs::write(&path, format!("\u{feff}{good}")).unwrap();
    assert_eq!(transforms::read(&path).unwrap(), sequence());
    std::fs::write(&path, "{\n  \"frames\": [,]\n}").unwrap();
    let error = transforms::read(&path).unwrap_err().to_string();
    assert!(error.contains("line 2 column"), "{error}");
}

#[test]
fn a_sequence_that_could_not_be_read_is_not_written() {
    let folder = folder();
    let path = folder.path().join("transforms.json");
    let mut cases = vec![Sequence { exposure: f32::NAN, ..sequence() }, Sequence { keyframes: vec![20], ..sequence() }];
    cases.push(Sequence { files: vec![], ..sequence() });
    cases.push(Sequence { environment: "../env.hdr".into(), ..sequence() });
    cases.push(Sequence { tracks: Tracks { objects: [(3, vec![Affine3A::IDENTITY])].into() }, ..sequence() });
    let mut mirrored = sequence();
    mirrored.cameras[1].camera_to_world.matrix3.x_axis *= -1.0;
    cases.push(mirrored);
    for sequence in cases {
        transforms::write(&path, &sequence).unwrap_err();
        assert!(!path.exists());
    }
}
