//! Cameras of glTF files, and those of transforms.json.

mod common;

use common::gltf::{FLOAT, File, STRIP, bytes, document, square};
use common::{anywhere, asset, assets_below, empty_scene, model_scene};
use glam::{Affine3A, DAffine3, DMat4, DQuat, DVec3, DVec4, Mat3A, Vec2, Vec3A};
use renderflow_frame::Camera;
use renderflow_frame::transforms::{self, Sequence};
use renderflow_scenes::description::{Animation, CameraPath, NameOrNumber, Scene};
use renderflow_scenes::load::{self, Capture, ModelView};
use serde_json::{Value, json};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2};
use std::path::Path;

/// A square, and cameras on nodes of their own: one below a node that is turned, scaled and moved, one that looks elsewhere.
fn filmed() -> Value {
    let mut file = square();
    file["cameras"] = json!([
        { "type": "perspective", "perspective": { "yfov": 0.6, "aspectRatio": 1.5, "znear": 0.1, "zfar": 50 } },
        { "type": "perspective", "name": "lens", "perspective": { "yfov": 1.1, "znear": 0.1 } },
        { "type": "orthographic", "name": "plan", "orthographic": { "xmag": 1, "ymag": 1, "znear": 0, "zfar": 9 } },
    ]);
    file["nodes"] = json!([
        { "mesh": 0, "name": "square" },
        { "name": "crane", "children": [2], "translation": [0.5, 1, 2], "rotation": [0, FRAC_1_SQRT_2 / 2.0, 0, 0.9354143466934853],
          "scale": [2, 2, 2] },
        { "camera": 0, "name": "Front", "translation": [0.25, -0.5, 1.5], "rotation": [-0.19611613513818404, 0, 0, 0.9805806756909202] },
        { "camera": 1, "translation": [0, 0, 4] },
        { "camera": 2 },
    ]);
    file["scenes"][0]["nodes"] = json!([0, 1, 3, 4]);
    file
}

fn by_name(name: &str) -> NameOrNumber {
    NameOrNumber::Name(name.into())
}

/// The scene around a model, seen by its camera.
fn seen(file: &File, view: &ModelView, camera: &NameOrNumber) -> Result<(Scene, Vec<String>), String> {
    let mut scene = load::describe_model(&file.path(), None, view, &anywhere()).map_err(|e| e.to_string())?;
    let notes = load::look_through(&mut scene, camera, &anywhere()).map_err(|e| e.to_string())?;
    Ok((scene, notes))
}

/// glTF's own matrices: the projection of section 3.10.3.2, and the camera's node transform.
#[test]
fn a_camera_shows_what_the_matrices_of_gltf_say() {
    let file = File::new(&filmed());
    let turned = |axis: DVec3, w: f64| DQuat::from_vec4((axis * (1.0 - w * w).sqrt()).extend(w)).normalize();
    let crane = DMat4::from_scale_rotation_translation(
        DVec3::splat(2.0),
        turned(DVec3::Y, 0.935_414_346_693_485_3),
        DVec3::new(0.5, 1.0, 2.0),
    );
    let front = DMat4::from_rotation_translation(turned(DVec3::NEG_X, 0.980_580_675_690_920_2), DVec3::new(0.25, -0.5, 1.5));
    // A camera has no size: the scale of its nodes moves it, and is not seen in its picture.
    let (_, rotation, translation) = (crane * front).to_scale_rotation_translation();
    let view = DMat4::from_rotation_translation(rotation, translation).inverse();
    for resolution in [[300, 200], [200, 200], [160, 240]] {
        let (n, f, aspect) = (0.1, 50.0, f64::from(resolution[0]) / f64::from(resolution[1]));
        let cot = 1.0 / (0.3_f64).tan();
        let projection = DMat4::from_cols(
            DVec4::new(cot / aspect, 0.0, 0.0, 0.0),
            DVec4::new(0.0, cot, 0.0, 0.0),
            DVec4::new(0.0, 0.0, (f + n) / (n - f), -1.0),
            DVec4::new(0.0, 0.0, 2.0 * f * n / (n - f), 0.0),
        );
        let options = ModelView { resolution, ..ModelView::default() };
        let (scene, notes) = seen(&file, &options, &by_name("Front")).unwrap();
        let (camera, placement) = (scene.camera(0), scene.objects[0].transform_at(0));
        for point in [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1.0, 1.0, 0.0), DVec3::new(0.2, 0.7, -3.0)] {
            let clip = projection * view * point.extend(1.0);
            let [x, y] = [clip.x / clip.w, clip.y / clip.w];
            let expected = Vec2::new(
                (0.5 * (x + 1.0) * f64::from(resolution[0])) as f32,
                (0.5 * (1.0 - y) * f64::from(resolution[1])) as f32,
            );
            let (pixel, depth) = camera.project(placement.transform_point3(point).as_vec3a()).unwrap();
            assert!(pixel.distance(expected) < 2e-3, "{point}: {pixel}, not {expected}");
            let scale = placement.matrix3.x_axis.length();
            assert!((f64::from(depth) - clip.w * scale).abs() < 1e-5, "{depth}");
        }
        // Where the picture is narrower than the camera's, the sides are gone.
        assert_eq!(notes.len(), usize::from(aspect < 1.5), "{notes:?}");
        if aspect == 1.0 {
            let says =
                "camera Front: its pictures are 1.5 times as wide as high, so 200x200 cuts off their sides; --resolution 300x200";
            assert!(notes[0].starts_with(says), "{notes:?}");
        }
        assert!(matches!(&scene.camera, CameraPath::Poses { poses, .. } if poses.len() == 1));
        let notes = load::load(&scene, &anywhere()).unwrap().report.notes.join("\n");
        assert!(!notes.contains("--camera"), "{notes}");
    }
}

#[test]
fn a_camera_is_chosen_by_name_or_number_and_refused_in_plain_words() {
    let file = File::new(&filmed());
    let look = |choice: NameOrNumber| seen(&file, &ModelView::default(), &choice);
    let scene = |choice| look(choice).unwrap().0.camera;
    assert_eq!(scene(by_name("Front")), scene(NameOrNumber::Number(0)));
    // A node without a name has that of its camera.
    assert_eq!(scene(by_name("lens")), scene(by_name("1")));
    assert_ne!(scene(by_name("lens")), scene(by_name("Front")));
    let says = |choice| look(choice).unwrap_err();
    assert!(says(by_name("Back")).ends_with("model.gltf: no camera is named \"Back\"; there are Front, lens, plan"));
    assert!(says(NameOrNumber::Number(3)).ends_with("model.gltf: there is no camera 3; there are Front, lens, plan"));
    let plan = says(by_name("plan"));
    assert!(plan.ends_with("camera plan: it is orthographic; only perspective cameras can be used"), "{plan}");
    let none = File::new(&square());
    let says = seen(&none, &ModelView::default(), &NameOrNumber::Number(0)).unwrap_err();
    assert!(says.ends_with("model.gltf: no node of the file's scene shows a camera"), "{says}");
    for (yfov, says) in [(3.1, "its yfov of 177.6"), (0.0, "its yfov of 0 degrees is outside 1..=170")] {
        let mut wrong = filmed();
        wrong["cameras"][0]["perspective"]["yfov"] = json!(yfov);
        let error = seen(&File::new(&wrong), &ModelView::default(), &NameOrNumber::Number(0)).unwrap_err();
        assert!(error.contains(says), "{error}");
    }
    let mut flat = filmed();
    flat["nodes"][1]["scale"] = json!([1, 1, 0]);
    let error = seen(&File::new(&flat), &ModelView::default(), &NameOrNumber::Number(0)).unwrap_err();
    assert!(error.ends_with("camera Front: its node is flattened at frame 0, so it looks nowhere"), "{error}");
    // Without the option, the orbit stays, and a note says what there is.
    let scene = load::describe_model(&file.path(), None, &ModelView::default(), &anywhere()).unwrap();
    assert!(matches!(scene.camera, CameraPath::Orbit { .. }));
    let notes = load::load(&scene, &anywhere()).unwrap().report.notes.join("\n");
    assert!(notes.contains("the file has 3 cameras (Front, lens, plan); --camera NAME uses one"), "{notes}");
    let contents = load::contents(&file.path(), &anywhere()).unwrap();
    assert_eq!((contents.cameras, contents.animations), (vec!["Front".into(), "lens".into(), "plan".into()], vec![]));
}

/// A camera whose node rises by two metres and turns by a quarter in a second.
#[test]
fn a_camera_goes_where_its_node_goes() {
    let s = FRAC_1_SQRT_2 as f32;
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&STRIP)),
        (FLOAT, "SCALAR", 2, false, bytes(&[0.0, 1.0])),
        (FLOAT, "VEC3", 2, false, bytes(&[0.0, 0.0, 5.0, 0.0, 2.0, 5.0])),
        (FLOAT, "VEC4", 2, false, bytes(&[0.0, 0.0, 0.0, 1.0, 0.0, s, 0.0, s])),
    ]);
    file["meshes"][0]["primitives"][0]["mode"] = json!(5);
    file["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.7, "znear": 0.1 } }]);
    file["nodes"] = json!([{ "mesh": 0 }, { "camera": 0, "translation": [0, 0, 5] }]);
    file["scenes"][0]["nodes"] = json!([0, 1]);
    file["animations"] = json!([{
        "samplers": [{ "input": 1, "output": 2 }, { "input": 1, "output": 3 }],
        "channels": [
            { "sampler": 0, "target": { "node": 1, "path": "translation" } },
            { "sampler": 1, "target": { "node": 1, "path": "rotation" } }
        ]
    }]);
    let file = File::new(&file);
    let view = ModelView {
        frames: 4,
        animation: Some(Animation { frames_per_second: 4.0, ..Animation::default() }),
        ..ModelView::default()
    };
    let (scene, _) = seen(&file, &view, &NameOrNumber::Number(0)).unwrap();
    let placement = scene.objects[0].transform_at(0);
    for frame in 0..4 {
        let t = f64::from(frame) / 4.0;
        let (sin, cos) = (t * FRAC_PI_2).sin_cos();
        let camera = scene.camera(frame);
        let eye = placement.transform_point3(DVec3::new(0.0, 2.0 * t, 5.0));
        assert!((camera.position().as_dvec3() - eye).length() < 1e-5, "frame {frame}");
        let ahead = -camera.camera_to_world.matrix3.z_axis.as_dvec3();
        assert!((ahead - DVec3::new(-sin, 0.0, -cos)).length() < 1e-6, "frame {frame}: {ahead}");
        assert!((camera.camera_to_world.matrix3.y_axis - Vec3A::Y).length() < 1e-6);
    }
    // At rest, it is one pose.
    let (scene, _) = seen(&file, &ModelView { frames: 4, ..ModelView::default() }, &NameOrNumber::Number(0)).unwrap();
    assert!(matches!(&scene.camera, CameraPath::Poses { poses, .. } if poses.len() == 1));
}

/// Files about cameras and their nodes, the broken ones too, are used or refused by name.
#[test]
fn files_of_the_validator_are_used_or_refused() {
    let Some(_) = asset("gltf/malformed/khronos-validator/camera") else { return };
    for folder in ["camera", "node", "scene"] {
        for path in assets_below(&format!("gltf/malformed/khronos-validator/{folder}"), &["gltf", "glb"]) {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if let Err(error) = load::look_through(&mut model_scene(&path, None), &NameOrNumber::Number(0), &anywhere()) {
                assert!(error.to_string().contains(&name), "{name}: {error}");
            }
        }
    }
}

fn written(folder: &Path, content: &Value) -> std::path::PathBuf {
    let path = folder.join("cameras.json");
    std::fs::write(&path, content.to_string()).unwrap();
    path
}

fn capture(content: &Value) -> Result<Capture, String> {
    let folder = tempfile::tempdir().unwrap();
    Capture::read(&written(folder.path(), content)).map_err(|e| e.to_string())
}

/// Two frames as nerfstudio writes them; the second stands elsewhere and looks along -x.
fn nerfstudio() -> Value {
    json!({
        "w": 640, "h": 360.0, "fl_x": 500.0, "fl_y": 510.0, "cx": 300.0, "cy": 190.5, "k1": 0.0, "k2": 0, "p1": 0, "p2": 0,
        "camera_model": "OPENCV", "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "ply_file_path": "/a/b.ply",
        "frames": [
            { "file_path": "../../images/1.jpg", "transform_matrix": [[1, 0, 0, 0.5], [0, 1, 0, 1], [0, 0, 1, 4], [0, 0, 0, 1]] },
            { "file_path": "images/2.jpg", "colmap_im_id": 7,
              "transform_matrix": [[0, 0, 1, 4], [0, 1, 0, 1], [-1, 0, 0, 0], [0, 0, 0, 1]] }
        ]
    })
}

#[test]
fn cameras_of_nerfstudio_are_seen_as_they_stand() {
    let found = capture(&nerfstudio()).unwrap();
    assert_eq!((found.len(), found.size(), found.in_world()), (2, Some([640, 360]), false));
    let path = found.path([9, 9], DAffine3::IDENTITY).unwrap();
    let scene = Scene { camera: path, frames: 3, resolution: [640, 360], ..empty_scene() };
    scene.validate().unwrap();
    let camera = scene.camera(0);
    assert_eq!((camera.fl_x, camera.fl_y, camera.cx, camera.cy), (500.0, 510.0, 300.0, 190.5));
    assert_eq!(camera.position(), Vec3A::new(0.5, 1.0, 4.0));
    // One metre to the right and up, two metres ahead.
    let (pixel, depth) = camera.project(Vec3A::new(1.5, 2.0, 2.0)).unwrap();
    assert!((pixel - Vec2::new(300.0 + 250.0, 190.5 - 255.0)).length() < 1e-3 && depth == 2.0, "{pixel} {depth}");
    let ahead = -scene.camera(1).camera_to_world.matrix3.z_axis;
    assert!((ahead - Vec3A::NEG_X).length() < 1e-6);
    // The last one is held, and the intrinsics follow the size of the picture.
    assert_eq!(scene.camera(2), scene.camera(1));
    let half = Scene { resolution: [320, 180], ..scene.clone() };
    half.validate().unwrap();
    assert_eq!((half.camera(0).fl_x, half.camera(0).cy), (250.0, 95.25));
    let square = Scene { resolution: [320, 320], ..scene.clone() };
    let says = square.validate().unwrap_err().to_string();
    assert_eq!(says, "/resolution: 320 x 320 has not the shape of the 640 x 360 pixels of the cameras");
    // As text and back: the same scene.
    let text = scene.canonical_json();
    assert_eq!(Scene::from_json(Path::new("x"), &text).unwrap(), scene);
    // The viewer turns about what the camera looks at.
    let (pose, fov) = scene.camera.pose(0);
    assert!((f64::from(fov) - (2.0 * (180.0_f64 / 510.0).atan()).to_degrees()).abs() < 1e-4);
    assert_eq!((pose.eye, pose.target[0], pose.target[1]), ([0.5, 1.0, 4.0], 0.5, 1.0));
}

/// A model is scaled and moved; cameras around it are too, so that they see it where they saw it.
#[test]
fn cameras_around_a_model_go_with_it() {
    let file = File::new(&square());
    let view = ModelView { resolution: [640, 360], ..ModelView::default() };
    let mut scene = load::describe_model(&file.path(), None, &view, &anywhere()).unwrap();
    let placement = scene.objects[0].transform_at(0);
    assert!(placement.matrix3.x_axis.length() > 1.2);
    scene.camera = capture(&nerfstudio()).unwrap().path([640, 360], placement).unwrap();
    scene.validate().unwrap();
    let corner = placement.transform_point3(DVec3::X).as_vec3a();
    let (pixel, _) = scene.camera(0).project(corner).unwrap();
    // (1, 0, 0) from (0.5, 1, 4): half a metre right, one down, four ahead.
    assert!((pixel - Vec2::new(300.0 + 62.5, 190.5 + 127.5)).length() < 1e-3, "{pixel}");
}

/// What a render leaves beside its frames gives the same cameras again.
#[test]
fn cameras_of_this_program_come_back() {
    let look = |x: f32, f: f32| {
        let eye = Vec3A::new(x, 1.3, 4.7);
        let camera = Camera::look_at(eye, Vec3A::new(0.1, 0.2, -0.3), Vec3A::Y, 0.7, 320, 180);
        Camera { fl_x: f, cx: 160.25, ..camera }
    };
    for cameras in [vec![look(0.3, 247.1), look(-1.7, 247.1)], vec![look(0.3, 200.0), look(2.0, 250.0), look(9.0, 251.5)]] {
        let sequence = Sequence {
            files: (0..cameras.len()).map(|i| format!("frame.{i:04}.exr")).collect(),
            cameras: cameras.clone(),
            keyframes: vec![0],
            exposure: 1.0,
            environment: "env.hdr".into(),
            environment_rotation: 0.0,
            environment_intensity: 1.0,
            tracks: Default::default(),
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        transforms::write(&path, &sequence).unwrap();
        let found = Capture::read(&path).unwrap();
        assert!(found.in_world());
        let scene = Scene { camera: found.path([1, 1], DAffine3::IDENTITY).unwrap(), resolution: [320, 180], ..empty_scene() };
        scene.validate().unwrap();
        for (frame, camera) in cameras.iter().enumerate() {
            let again = scene.camera(frame as u32);
            assert_eq!(again.camera_to_world, camera.camera_to_world);
            let numbers = |c: &Camera| [c.fl_x, c.fl_y, c.cx, c.cy];
            assert_eq!((numbers(&again), again.width, again.height), (numbers(camera), 320, 180));
        }
    }
}

/// The synthetic scenes of NeRF say one angle and nothing else.
#[test]
fn an_angle_is_enough() {
    let angle = json!({ "camera_angle_x": 2.0 * (0.25_f64).atan(), "frames": [{ "transform_matrix":
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]], "rotation": 0.01, "file_path": "./train/r_0" }] });
    let found = capture(&angle).unwrap();
    assert_eq!(found.size(), None);
    let scene = Scene { camera: found.path([80, 40], DAffine3::IDENTITY).unwrap(), resolution: [80, 40], ..empty_scene() };
    scene.validate().unwrap();
    let camera = scene.camera(0);
    for (number, expected) in [(camera.fl_x, 160.0), (camera.fl_y, 160.0), (camera.cx, 40.0), (camera.cy, 20.0)] {
        assert!((number - expected).abs() < 1e-3, "{number} {expected}");
    }
}

/// Scale and the rounding of the file are taken out of a matrix.
#[test]
fn scale_is_removed() {
    let mut scaled = nerfstudio();
    scaled["frames"][1]["transform_matrix"] = json!([[0, 0, 0.33, 4], [0, 0.330001, 0.0001, 1], [-0.33, 0, 0, 0], [0, 0, 0, 1]]);
    let CameraPath::Frames { frames, .. } = capture(&scaled).unwrap().path([640, 360], DAffine3::IDENTITY).unwrap() else {
        panic!("cameras with intrinsics")
    };
    let axes = Mat3A::from_cols_array_2d(&[0, 1, 2].map(|c| [0, 1, 2].map(|r| frames[1].camera_to_world[r][c] as f32)));
    assert!((axes.transpose() * axes).abs_diff_eq(Mat3A::IDENTITY, 1e-6));
    let placed = Affine3A { matrix3: axes, translation: Vec3A::ZERO };
    assert!(placed.transform_vector3a(Vec3A::Z).distance(Vec3A::X) < 1e-3);
    assert_eq!(frames[1].camera_to_world.map(|row| row[3]), [4.0, 1.0, 0.0]);
}

/// Lenses that bend lines show points where OpenCV does; a lens that folds inside of its picture is refused.
#[test]
fn distorted_lenses_are_seen_as_they_stand() {
    let mut file = nerfstudio();
    (file["k1"], file["k2"], file["p1"], file["p2"]) = (json!(-0.28), json!(0.09), json!(0.0004), json!(-0.0007));
    let path = capture(&file).unwrap().path([9, 9], DAffine3::IDENTITY).unwrap();
    let scene = Scene { camera: path, frames: 2, resolution: [640, 360], ..empty_scene() };
    scene.validate().unwrap();
    let text = scene.canonical_json();
    assert_eq!(serde_json::from_str::<Scene>(&text).unwrap(), scene);
    // Of cv2.projectPoints for (-0.4, 0.3, 1), y down: (-0.374745, 0.2810275).
    let camera = scene.camera(0);
    let (pixel, _) = camera.project(camera.camera_to_world.transform_point3a(Vec3A::new(-0.4, -0.3, -1.0))).unwrap();
    assert!((pixel - Vec2::new(300.0 - 500.0 * 0.374_745, 190.5 + 510.0 * 0.281_027_5)).length() < 1e-3, "{pixel}");
    let back = camera.direction_cam(pixel);
    assert!((back - Vec3A::new(-0.4, -0.3, -1.0)).length() < 1e-5, "{back}");
    // At half the size, the lens is the same.
    let half = Scene { resolution: [320, 180], ..scene };
    assert!((half.camera(0).direction_cam(0.5 * pixel) - back).length() < 1e-5);
    file["k1"] = json!(-1.0);
    let error = capture(&file).unwrap().path([9, 9], DAffine3::IDENTITY).map(drop).unwrap_err().to_string();
    assert!(error.contains("/frames/0: the lens shows nothing at"), "{error}");
}

#[test]
fn wrong_cameras_are_refused_with_their_place() {
    let refused = |pointer: &str, value: Value, says: &str| {
        let mut file = nerfstudio();
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        match file.pointer_mut(parent).unwrap() {
            Value::Array(items) => items[key.parse::<usize>().unwrap()] = value,
            other => other[key] = value,
        }
        let error = capture(&file).map(drop).expect_err(says);
        assert!(error.contains(says), "{says:?} is not in {error:?}");
    };
    let undistort = "undistort the pictures first (COLMAP's image_undistorter and OpenCV's undistort do it)";
    refused("/k1", json!(3e4), "/k1: 30000 is outside -1000..=1000");
    refused("/k1", json!("big"), "/k1: a number is needed");
    refused("/k4", json!(0.1), "/frames/0: programs disagree about k4");
    refused("/frames/0/distortion_params", json!([0, 0.1]), "/frames/0/distortion_params: they have no names");
    refused(
        "/camera_model",
        json!("OPENCV_FISHEYE"),
        &format!("/camera_model: \"OPENCV_FISHEYE\" is not a camera that is read; {undistort}"),
    );
    refused("/is_fisheye", json!(true), "/is_fisheye: a fisheye");
    let matrix = "/frames/1/transform_matrix";
    refused(matrix, json!([[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), &format!("{matrix}: it mirrors"));
    refused(matrix, json!([[1, 0.2, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), &format!("{matrix}: it is no rotation"));
    refused(matrix, json!([[1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "an axis of the camera is zero");
    refused(matrix, json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]), "the last row is");
    refused(matrix, json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1]]), "4 rows of 4 numbers are needed");
    refused(matrix, json!([[1, 0, 0, 1e10], [0, 1, 0, 0], [0, 0, 1, 0]]), "the camera is further than 1000000000");
    refused("/frames/0/w", json!(641), "/frames/1: has 640 x 360 pixels, frame 0 has 641 x 360 pixels; all frames need one size");
    refused("/w", json!(640.5), "/frames/0: a picture cannot have 640.5 pixels along an edge");
    refused("/w", json!(1e9), "/w: 1000000000 is outside 1..=16384");
    refused("/fl_x", json!(0), "/fl_x: 0 is outside 0.001..=");
    refused("/fl_y", json!("500"), "/fl_y: a number is needed");
    refused("/cx", json!(1e300), "/cx: 1e300 is outside");
    refused("/w", json!(null), "/frames/0: w and h are missing");
    refused("/frames", json!([]), "/frames: has 0 cameras; 1 to 100000 are needed");
    let frame = nerfstudio()["frames"][0].clone();
    refused("/frames", json!(vec![frame; 100_001]), "/frames: has 100001 cameras");
    refused("/convention", json!("opencv_w2c"), "/convention: \"opencv_w2c\" is not \"opengl_c2w\"");
    let mut bare = nerfstudio();
    bare.as_object_mut().unwrap().retain(|key, _| !key.starts_with("fl_"));
    assert!(capture(&bare).map(drop).unwrap_err().contains("neither fl_x nor camera_angle_x is there"));
    // Text that is no JSON, or other JSON.
    let folder = tempfile::tempdir().unwrap();
    for text in ["", "{", "[]", "7", r#"{"frames": 7}"#, r#"{"frames": [{"transform_matrix": NaN}]}"#, "\u{feff}{}"] {
        let path = folder.path().join("cameras.json");
        std::fs::write(&path, text).unwrap();
        let error = Capture::read(&path).map(drop).unwrap_err().to_string();
        assert!(error.contains("cameras.json"), "{text}: {error}");
    }
    assert!(Capture::read(&folder.path().join("gone.json")).is_err());
}

/// A description with such cameras is checked as well: anybody can write one.
#[test]
fn described_cameras_are_checked() {
    let path = capture(&nerfstudio()).unwrap().path([640, 360], DAffine3::IDENTITY).unwrap();
    let whole: Value =
        serde_json::from_str(&Scene { camera: path, resolution: [640, 360], ..empty_scene() }.canonical_json()).unwrap();
    let identity: [[f64; 4]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    assert_eq!(whole["camera"]["frames"][0]["camera_to_world"][0], json!([1.0, 0.0, 0.0, 0.5]));
    let mut mirrored = identity;
    mirrored[0][0] = -1.0;
    for (pointer, value, says) in [
        ("/camera/frames/1/camera_to_world", json!(mirrored), "/camera/frames/1/camera_to_world: is not a rotation"),
        ("/camera/frames/1/camera_to_world/2/3", json!(1e10), "/camera/frames/1/camera_to_world/2/3: 10000000000 is outside"),
        ("/camera/frames/0/fl_x", json!(0), "/camera/frames/0/fl_x: 0 is outside 0.001..="),
        ("/camera/frames/0/cy", json!(1e7), "/camera/frames/0/cy: 10000000 is outside"),
        ("/camera/frames", json!([]), "/camera/frames: has 0 cameras"),
        ("/camera/size/0", json!(0), "/camera/size/0: 0 is outside 1..=16384"),
        ("/camera/size", json!([640, 640]), "/resolution: 640 x 360 has not the shape of the 640 x 640 pixels"),
    ] {
        let mut broken = whole.clone();
        *broken.pointer_mut(pointer).unwrap() = value;
        let error = Scene::from_json(Path::new("x.json"), &broken.to_string()).unwrap_err().to_string();
        assert!(error.contains(says), "{says:?} is not in {error:?}");
    }
}

/// Bytes of a file exchanged at random: read or refused, never a panic, and what is read makes a valid scene.
#[test]
fn nonsense_is_refused() {
    let text = nerfstudio().to_string().into_bytes();
    let mut state = 11_u32;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.json");
    let (mut read, mut refused) = (0, 0);
    for _ in 0..3000 {
        let mut broken = text.clone();
        for _ in 0..1 + random(3) {
            let at = random(broken.len());
            broken[at] = b"0123456789.-e,[]{}:\"nultrfw"[random(27)];
        }
        std::fs::write(&path, broken).unwrap();
        match Capture::read(&path) {
            Ok(found) => {
                let resolution = found.size().unwrap_or([640, 360]);
                let camera = found.path(resolution, DAffine3::IDENTITY).unwrap();
                Scene { camera, resolution, ..empty_scene() }.validate().unwrap();
                read += 1;
            }
            Err(_) => refused += 1,
        }
    }
    assert!(read > 100 && refused > 1000, "{read} read, {refused} refused");
}
