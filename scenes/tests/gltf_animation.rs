//! Animations of glTF nodes: their values against values from the formulae of glTF 2.0 (appendix C), worked out by hand.

mod common;

use common::gltf::{FLOAT, File, STRIP, bytes, document};
use common::{anywhere, asset, assets_below, model_scene};
use glam::{Vec3, Vec3A};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{Animation, Motion, NameOrNumber, Scene, Transform};
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::{LoadedScene, Result};
use serde_json::{Value, json};

/// Sine and cosine of 45 degrees.
const HALF: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// A curve for node 0: property, interpolation, key times, values.
type Curve<'a> = (&'a str, &'a str, &'a [f32], &'a [f32]);

/// A square that the curves move.
fn moved(curves: &[Curve]) -> Value {
    let mut accessors = vec![(FLOAT, "VEC3", 4, false, bytes(&STRIP))];
    let (mut samplers, mut channels) = (vec![], vec![]);
    for (property, interpolation, times, values) in curves {
        let (input, width) = (accessors.len(), if *property == "rotation" { 4 } else { 3 });
        accessors.push((FLOAT, "SCALAR", times.len(), false, bytes(times)));
        accessors.push((FLOAT, if width == 4 { "VEC4" } else { "VEC3" }, values.len() / width, false, bytes(values)));
        samplers.push(json!({ "input": input, "output": input + 1, "interpolation": interpolation }));
        channels.push(json!({ "sampler": samplers.len() - 1, "target": { "node": 0, "path": property } }));
    }
    let mut file = document(&accessors);
    file["meshes"][0]["primitives"][0]["mode"] = json!(5);
    file["animations"] = json!([{ "name": "move", "samplers": samplers, "channels": channels }]);
    file
}

/// The scene of a document, playing its first animation.
fn playing(file: &File, frames: u32, frames_per_second: f64) -> Scene {
    let mut scene = model_scene(&file.path(), None);
    scene.frames = frames;
    scene.objects[0].animation = Some(Animation { frames_per_second, ..Animation::default() });
    scene
}

fn play(document: &Value, frames: u32, frames_per_second: f64) -> Result<LoadedScene> {
    let file = File::new(document);
    load::load(&playing(&file, frames, frames_per_second), &anywhere())
}

/// Where a corner of the square is at a frame.
fn corner(scene: &LoadedScene, frame: usize, corner: Vec3) -> Vec3 {
    // Meshes may have been moved to their own middle: by how much, the first corner tells.
    let instance = &scene.instances[0];
    let shift = scene.meshes[instance.mesh].positions.iter().fold(Vec3::INFINITY, |low, p| low.min(*p));
    instance.transform(frame).transform_point3(corner + shift)
}

#[track_caller]
fn close(found: Vec3, expected: Vec3) {
    assert!(found.distance(expected) < 1e-5, "{found}, not {expected}");
}

/// A quarter turn about +Y in a second takes +x to -z, at an even speed.
#[test]
fn a_node_turns_by_ninety_degrees_in_a_second() {
    let turn = moved(&[("rotation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 0.0, HALF, 0.0, HALF])]);
    let scene = play(&turn, 25, 24.0).unwrap();
    assert_eq!(scene.instances[0].transforms.len(), 25);
    for frame in 0..24 {
        let angle = 90_f32.to_radians() * frame as f32 / 24.0;
        close(corner(&scene, frame, Vec3::X), Vec3::new(angle.cos(), 0.0, -angle.sin()));
    }
    // It starts again after its second.
    close(corner(&scene, 24, Vec3::X), Vec3::X);
    let file = File::new(&turn);
    let animation = Animation::default();
    let length = load::animation_length(&file.path(), &Reach::of(&file.path()), &animation).unwrap();
    assert_eq!((length, animation.frames(length)), (1.0, 24.0));
    // From a later start, and past several turns.
    let mut late = playing(&file, 30, 4.0);
    late.objects[0].animation.as_mut().unwrap().start = 0.5;
    let late = load::load(&late, &anywhere()).unwrap();
    for frame in [0, 4, 28] {
        close(corner(&late, frame, Vec3::X), Vec3::new(HALF, 0.0, -HALF));
    }
}

/// Steps, lines and cubic splines between the keys, and what holds beyond them.
#[test]
fn values_between_keys_follow_their_interpolation() {
    let place = |interpolation: &str, values: &[f32]| {
        // Keys at 1 and 3 seconds; a second curve makes the animation last four seconds.
        let hold = ("scale", "STEP", &[0.0, 4.0][..], &[1.0; 6][..]);
        let scene = play(&moved(&[("translation", interpolation, &[1.0, 3.0], values), hold]), 8, 2.0).unwrap();
        (0..8).map(|frame| corner(&scene, frame, Vec3::ZERO).x).collect::<Vec<f32>>()
    };
    let ends = [2.0, 0.0, 0.0, 6.0, 0.0, 0.0];
    assert_eq!(place("STEP", &ends), [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 6.0, 6.0]);
    assert_eq!(place("LINEAR", &ends), [2.0, 2.0, 2.0, 3.0, 4.0, 5.0, 6.0, 6.0]);
    // In-tangent, value, out-tangent. With dt = 2, out-tangent 3 and in-tangent -1 a second:
    // s = 1/4: 0.84375 * 2 + 2 * 3 * 0.140625 + 0.15625 * 6 + 2 * -1 * -0.046875 = 3.5625
    // s = 1/2: 1 + 6 / 8 + 3 + 2 / 8 = 5;  s = 3/4: 0.15625 * 2 + 6 * 0.046875 + 0.84375 * 6 + 2 * 0.140625 = 5.9375
    let spline = [9.0, 0.0, 0.0, 2.0, 0.0, 0.0, 3.0, 0.0, 0.0, -1.0, 0.0, 0.0, 6.0, 0.0, 0.0, 9.0, 0.0, 0.0];
    assert_eq!(place("CUBICSPLINE", &spline), [2.0, 2.0, 2.0, 3.5625, 5.0, 5.9375, 6.0, 6.0]);
}

/// The second quaternion stands for the quarter turn about z with the other sign: the long way would go through -135 degrees.
#[test]
fn rotations_go_the_shorter_way_and_splines_are_normalised() {
    let turn = moved(&[("rotation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -HALF, -HALF])]);
    close(corner(&play(&turn, 2, 2.0).unwrap(), 1, Vec3::X), Vec3::new(HALF, HALF, 0.0));
    // A third of a turn of 90 degrees is 30 degrees; between chords it would be 29.1.
    let scene = play(&turn, 3, 3.0).unwrap();
    close(corner(&scene, 1, Vec3::X), Vec3::new(30_f32.to_radians().cos(), 0.5, 0.0));
    // Without tangents, the middle of (0, 0, 0, 1) and (0, 0, 1, 0) is (0, 0, 1/2, 1/2): a quarter turn once it is normalised.
    let mut values = vec![0.0; 24];
    (values[7], values[18]) = (1.0, 1.0);
    let spline = moved(&[("rotation", "CUBICSPLINE", &[0.0, 1.0], &values)]);
    close(corner(&play(&spline, 2, 2.0).unwrap(), 1, Vec3::X), Vec3::Y);
}

/// Quaternions of 16-bit integers, as gltfpack writes them.
#[test]
fn normalised_integers_are_fractions() {
    let mut turn = moved(&[("rotation", "STEP", &[0.0, 1.0], &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, HALF, HALF])]);
    let integers: Vec<u8> = [0_i16, 0, 0, 32767, 0, 0, 23170, 23170].into_iter().flat_map(i16::to_le_bytes).collect();
    turn["buffers"].as_array_mut().unwrap().push(json!({
        "byteLength": 16, "uri": common::gltf::data_uri("application/octet-stream", &integers)
    }));
    turn["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 1, "byteLength": 16 }));
    turn["accessors"][2] = json!({ "bufferView": 3, "componentType": 5122, "normalized": true, "type": "VEC4", "count": 2 });
    // The mesh is a child of the node that turns.
    turn["nodes"] = json!([{ "children": [1] }, { "mesh": 0, "translation": [1, 0, 0] }]);
    close(corner(&play(&turn, 2, 2.0).unwrap(), 1, Vec3::ZERO), Vec3::X);
    turn["animations"][0]["samplers"][0]["interpolation"] = json!("LINEAR");
    let scene = play(&turn, 2, 2.0).unwrap();
    let half = 45_f32.to_radians();
    close(corner(&scene, 1, Vec3::ZERO), Vec3::new(half.cos(), half.sin(), 0.0));
}

/// The animation is in the model's own space; the object's transform and motion place the whole in each frame.
#[test]
fn the_object_moves_what_the_animation_moves() {
    let slide = moved(&[("translation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0])]);
    let file = File::new(&slide);
    let mut scene = playing(&file, 4, 4.0);
    scene.objects[0].transform = Transform { translation: [0.0, 1.0, 0.0], scale: [2.0; 3], ..Transform::default() };
    scene.objects[0].motion = Some(Motion { translation: [0.0, 0.0, 0.5], ..Motion::default() });
    let loaded = load::load(&scene, &anywhere()).unwrap();
    for frame in 0..4 {
        let t = frame as f32;
        close(corner(&loaded, frame, Vec3::ZERO), Vec3::new(2.0 * t, 1.0, 0.5 * t));
    }
}

/// A node that nothing moves keeps one transform, so that its triangles stay where they are in the renderer's trees.
#[test]
fn what_stands_still_has_one_transform() {
    let mut slide = moved(&[("translation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0])]);
    slide["nodes"] = json!([{ "mesh": 0, "name": "slides" }, { "mesh": 0, "name": "stands", "translation": [0, 2, 0] }]);
    slide["scenes"][0]["nodes"] = json!([0, 1]);
    let scene = play(&slide, 5, 4.0).unwrap();
    let lengths: Vec<usize> = scene.instances.iter().map(|instance| instance.transforms.len()).collect();
    assert_eq!(lengths, [5, 1]);
    assert!(scene.report.notes.iter().all(|note| !note.contains("animation")), "{:?}", scene.report.notes);
    // Without the field, the model rests and a note says what there is.
    let rests = File::new(&slide).load().unwrap();
    assert!(rests.instances.iter().all(|instance| instance.transforms.len() == 1));
    let note = "the file has 1 animation (move); --animation NAME plays one";
    assert!(rests.report.notes.iter().any(|n| n.ends_with(note)), "{:?}", rests.report.notes);
}

/// Files hide things by a scale of zero. Such a part is a speck in these frames, and its transform still has an inverse.
#[test]
fn a_part_without_size_is_hidden_and_a_mirrored_one_is_turned() {
    let grow = moved(&[("scale", "STEP", &[0.0, 1.0, 2.0, 3.0], &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, -2.0, 1.0, 1.0, 1.0, 1.0, 1.0])]);
    let mut resting = grow.clone();
    // It rests without size: only the animation shows it.
    resting["nodes"][0]["scale"] = json!([0, 0, 0]);
    for document in [&grow, &resting] {
        let scene = play(document, 3, 1.0).unwrap();
        // One instance for the frames in which it is mirrored, one for the others.
        assert_eq!(scene.instances.len(), 2);
        assert!(scene.instances.iter().all(|i| i.object_id == 1));
        let [plain, mirrored] = [&scene.instances[0], &scene.instances[1]];
        let size = |i: &renderflow_scenes::Instance, f| i.transform(f).matrix3.determinant().abs().cbrt();
        assert!(size(plain, 0) < 1e-8 && size(plain, 1) > 0.9 && size(plain, 2) < 1e-8);
        assert!(size(mirrored, 0) < 1e-8 && size(mirrored, 1) < 1e-8 && size(mirrored, 2) > 1.1);
        for instance in [plain, mirrored] {
            assert!(instance.transforms.iter().all(|t| t.inverse().is_finite()));
            let sign = instance.transform(0).matrix3.determinant().signum();
            assert!(instance.transforms.iter().all(|t| t.matrix3.determinant().signum() == sign));
            // The square still faces +z, in its winding as well.
            let mesh = &scene.meshes[instance.mesh];
            let [a, b, c] = mesh.triangles[0].map(|i| Vec3A::from(mesh.positions[i as usize]));
            let t = instance.transform(if sign > 0.0 { 1 } else { 2 });
            let [a, b, c] = [a, b, c].map(|p| t.transform_point3a(p));
            assert!((b - a).cross(c - a).z > 0.0);
        }
        let notes = scene.report.notes.join("\n");
        assert!(notes.contains("1 parts are hidden in frames in which the animation flattens them"), "{notes}");
    }
}

/// The sphere around the model holds it at every moment of the animation, not only at rest.
#[test]
fn a_described_model_is_in_the_picture_all_the_time() {
    let far = moved(&[("translation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 30.0, 0.0, 0.0])]);
    let file = File::new(&far);
    let view = ModelView { frames: 24, animation: Some(Animation::default()), ground: false, ..ModelView::default() };
    let scene = load::describe_model(&file.path(), None, &view, &Reach::of(&file.path())).unwrap();
    assert_eq!(scene.objects[0].animation, view.animation);
    let loaded = load::load(&scene, &anywhere()).unwrap();
    for frame in 0..24 {
        for at in [Vec3::ZERO, Vec3::ONE.with_z(0.0)] {
            let place = corner(&loaded, frame, at);
            let (pixel, _) = loaded.cameras[frame].project(place.into()).unwrap();
            assert!(pixel.cmpge(glam::Vec2::ZERO).all() && pixel.cmple(glam::Vec2::splat(256.0)).all(), "frame {frame}: {pixel}");
        }
    }
}

#[test]
fn clips_are_chosen_by_name_or_number() {
    let mut two = moved(&[("translation", "LINEAR", &[0.0, 1.0], &[1.0, 1.0, 1.0, 4.0, 1.0, 1.0])]);
    let mut other = two["animations"][0].clone();
    (other["name"], other["channels"][0]["target"]["path"]) = (json!("grow"), json!("scale"));
    two["animations"].as_array_mut().unwrap().push(other);
    let file = File::new(&two);
    let with = |clip: Option<NameOrNumber>| {
        let mut scene = playing(&file, 2, 2.0);
        scene.objects[0].animation.as_mut().unwrap().clip = clip;
        load::load(&scene, &anywhere()).map(|scene| corner(&scene, 1, Vec3::ZERO).x).map_err(|e| e.to_string())
    };
    for first in
        [None, Some(NameOrNumber::Number(0)), Some(NameOrNumber::Name("move".into())), Some(NameOrNumber::Name("0".into()))]
    {
        assert_eq!(with(first).unwrap(), 2.5);
    }
    for second in [NameOrNumber::Number(1), NameOrNumber::Name("grow".into())] {
        assert_eq!(with(Some(second)).unwrap(), 0.0);
    }
    let says = with(Some(NameOrNumber::Name("jump".into()))).unwrap_err();
    assert!(says.ends_with("model.gltf: no animation is named \"jump\"; there are move, grow"), "{says}");
    assert!(with(Some(NameOrNumber::Number(2))).unwrap_err().ends_with("there is no animation 2; there are move, grow"));
    // The same, put into a scene by name.
    let mut scene = model_scene(&file.path(), None);
    let asked = Animation { clip: Some(NameOrNumber::Name("grow".into())), ..Animation::default() };
    assert_eq!(load::play(&mut scene, &asked, &anywhere()).unwrap(), 1.0);
    assert_eq!(scene.objects[0].animation, Some(asked));
    let asked = Animation { clip: Some(NameOrNumber::Name("jump".into())), ..Animation::default() };
    let says = load::play(&mut scene, &asked, &anywhere()).unwrap_err().to_string();
    assert!(says.contains("the animation \"jump\"; there are move, grow"), "{says}");
}

#[test]
fn the_field_is_checked_and_written_only_where_it_is() {
    let mut scene = common::empty_scene();
    scene.objects = model_scene(std::path::Path::new("a.glb"), None).objects;
    assert!(!scene.canonical_json().contains("animation"));
    let mut value: Value = serde_json::from_str(&scene.canonical_json()).unwrap();
    value["objects"][0]["animation"] = json!({ "clip": "walk" });
    let read = |value: &Value| Scene::from_json("x.json".as_ref(), &value.to_string()).map_err(|e| e.to_string());
    let walking = read(&value).unwrap();
    let text = walking.canonical_json();
    assert!(text.contains(r#""animation":{"clip":"walk","frames_per_second":24.0,"start":0.0}"#), "{text}");
    assert_eq!(read(&serde_json::from_str(&text).unwrap()).unwrap(), walking);
    for (field, wrong, says) in [
        ("frames_per_second", json!(0), "/objects/0/animation/frames_per_second: 0 is outside 0.001..="),
        ("start", json!(-1), "/objects/0/animation/start: -1 is outside 0..="),
        ("speed", json!(1), "unknown field `speed`"),
    ] {
        let mut broken = value.clone();
        broken["objects"][0]["animation"][field] = wrong;
        let message = read(&broken).unwrap_err();
        assert!(message.contains(says), "{message}");
    }
    value["objects"][0]["geometry"] = json!({ "file": "a.obj" });
    assert!(read(&value).unwrap_err().contains("/objects/0/animation: only a glTF file has animations"));
    value["objects"][0]["geometry"] = json!({ "shape": { "family": "sphere", "radius": 1 } });
    assert!(read(&value).unwrap_err().contains("/objects/0/animation: only a glTF file has animations"));
}

/// The bytes of scenes without animation are those of before there was any: their hash names them in every stored frame.
#[test]
fn hashes_of_older_scenes_are_unchanged() {
    for (name, hash) in [
        ("single_sphere", "afa8b0e36d5db99172d1175b36713c0638c39ce5b6b9c2e51cbd599685227128"),
        ("moving_objects", "c629333572837cb6cb69fa7bedc2f15d1f1ac1ccffeaef26b3d09849ddc3440c"),
    ] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("examples/{name}.json"));
        assert_eq!(Scene { frames: 1, ..Scene::read(&path).unwrap() }.hash(), hash, "{name}");
    }
}

#[test]
fn broken_animations_are_refused_where_they_are_played() {
    let slide = || moved(&[("translation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0])]);
    let refused = |change: &dyn Fn(&mut Value), says: &str| {
        let mut file = slide();
        change(&mut file);
        let error = play(&file, 4, 4.0).map(drop).expect_err(says).to_string();
        assert!(error.contains(says), "{says:?} is not in {error:?}");
    };
    let channel = "/animations/0/channels/0/target";
    refused(&|f| f["animations"][0]["channels"][0]["target"]["node"] = json!(9), &format!("{channel}/node: there is nothing"));
    refused(&|f| f["animations"][0]["channels"][0]["target"]["path"] = json!("colour"), &format!("{channel}/path: not one of"));
    refused(&|f| f["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]), "node 0 has a matrix");
    refused(
        &|f| {
            let again = f["animations"][0]["channels"][0].clone();
            f["animations"][0]["channels"].as_array_mut().unwrap().push(again);
        },
        "/animations/0/channels/1/target: another channel moves the same",
    );
    refused(&|f| f["animations"][0]["samplers"][0]["interpolation"] = json!("BEZIER"), "not one of the values allowed");
    refused(&|f| f["animations"][0]["samplers"][0]["interpolation"] = json!("CUBICSPLINE"), "2 values where 2 keys need 6");
    refused(&|f| f["accessors"][2]["count"] = json!(1), "/animations/0/samplers/0/output: 1 values where 2 keys need 2");
    refused(&|f| f["animations"][0]["samplers"][0]["output"] = json!(1), "accessor 1 has 1 components where 3 are needed");
    refused(&|f| f["accessors"][1]["count"] = json!(4_000_000_000_u32), "/accessors/1: 4000000000 elements");
    let keys = |times: &[f32], values: &[f32], says: &str| {
        let error = play(&moved(&[("translation", "LINEAR", times, values)]), 4, 4.0).map(drop).expect_err(says).to_string();
        assert!(error.contains(says), "{says:?} is not in {error:?}");
    };
    keys(&[0.0, 2.0, 1.0], &[0.0; 9], "/animations/0/samplers/0/input: key 2 at 1 seconds comes after key 1 at 2");
    keys(&[-1.0, 1.0], &[0.0; 6], "the first key is at -1 seconds");
    keys(&[0.0, f32::NAN], &[0.0; 6], "/animations/0/samplers/0/input: element 1 of accessor 1 is not finite");
    keys(&[0.0, 1.0], &[0.0, 0.0, 0.0, f32::INFINITY, 0.0, 0.0], "output: element 1 of accessor 2 is not finite");
    // Two keys at one time are a jump.
    assert!(play(&moved(&[("translation", "LINEAR", &[0.0, 1.0, 1.0], &[0.0; 9])]), 4, 4.0).is_ok());
    // Resting, none of it is read.
    let mut file = slide();
    file["animations"][0]["channels"][0]["target"]["node"] = json!(9);
    assert!(File::new(&file).load().is_ok());
    // Far more than fits into memory.
    let mut file = slide();
    file["nodes"] = json!((0..2000).map(|_| json!({ "mesh": 0 })).collect::<Vec<_>>());
    file["scenes"][0]["nodes"] = json!((0..2000).collect::<Vec<_>>());
    let says = play(&file, 100_000, 24.0).unwrap_err().to_string();
    assert!(says.contains("2000 nodes and 2000 parts in 100000 frames are too many; at most 8388 frames"), "{says}");
}

#[test]
fn an_animation_that_moves_nothing_is_noted() {
    let mut file = moved(&[("translation", "LINEAR", &[0.0, 1.0], &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0])]);
    // The mesh has no morph targets.
    file["animations"][0]["channels"][0]["target"]["path"] = json!("weights");
    let scene = play(&file, 4, 4.0).unwrap();
    let notes = scene.report.notes.join("\n");
    assert!(notes.contains("the animation move moves no node of the file's scene"), "{notes}");
    assert_eq!(scene.instances[0].transforms.len(), 1);
}

/// The validator's files about animations are played, or refused by name.
#[test]
fn files_of_the_validator_are_played_or_refused() {
    let Some(_) = asset("gltf/malformed/khronos-validator/animation") else { return };
    let (mut played, mut refused) = (vec![], vec![]);
    for folder in ["animation", "animation_data"] {
        for path in assets_below(&format!("gltf/malformed/khronos-validator/{folder}"), &["gltf"]) {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            match load::animation_length(&path, &Reach::of(&path), &Animation::default()) {
                Ok(length) => played.push((name, length)),
                Err(error) => {
                    let text = error.to_string();
                    assert!(text.contains(&name), "{name}: {text}");
                    refused.push(name);
                }
            }
        }
    }
    println!("played {played:?}, refused {refused:?}");
    let names: Vec<&str> = refused.iter().map(String::as_str).collect();
    for wrong in ["channel_duplicate_targets", "channel_node_matrix", "empty_array", "unresolved_sampler_output"] {
        assert!(names.contains(&wrong), "{wrong} was played");
    }
    assert!(played.iter().any(|(name, _)| name == "valid"), "{played:?}");
}

/// Documents with parts exchanged at random: played or refused, never a panic.
#[test]
fn nonsense_is_refused_and_nothing_else_happens() {
    let file = moved(&[
        ("translation", "CUBICSPLINE", &[0.0, 1.0], &[0.5; 18]),
        ("rotation", "LINEAR", &[0.0, 0.5], &[0.0, 0.0, 0.0, 1.0, 0.0, HALF, 0.0, HALF]),
        ("scale", "STEP", &[0.0, 0.25], &[1.0, 1.0, 1.0, 2.0, 1.0, -1.0]),
    ]);
    let mut state = 7_u32;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let places = [
        "/animations/0/samplers/0/input",
        "/animations/0/samplers/1/output",
        "/animations/0/samplers/2/interpolation",
        "/animations/0/channels/0/sampler",
        "/animations/0/channels/1/target/node",
        "/animations/0/channels/2/target/path",
        "/accessors/1/count",
        "/accessors/2/componentType",
        "/accessors/3/type",
        "/accessors/4/bufferView",
        "/bufferViews/1/byteLength",
        "/bufferViews/2/byteOffset",
        "/nodes/0/mesh",
        "/animations/0/channels",
        "/accessors/5/normalized",
    ];
    let values = [
        json!(0),
        json!(1),
        json!(2),
        json!(6),
        json!(4_294_967_295_u32),
        json!(-1),
        json!(0.5),
        json!("LINEAR"),
        json!("scale"),
        json!("weights"),
        json!("VEC4"),
        json!(5120),
        json!(5126),
        json!(true),
        json!([]),
        json!(null),
        json!({}),
    ];
    let (mut played, mut refused) = (0, 0);
    for _ in 0..600 {
        let mut broken = file.clone();
        for _ in 0..1 + random(3) {
            if let Some(place) = broken.pointer_mut(places[random(places.len())]) {
                *place = values[random(values.len())].clone();
            }
        }
        match play(&broken, 6, 4.0) {
            Ok(scene) => {
                assert!(scene.instances.iter().all(|i| i.transforms.iter().all(|t| t.is_finite() && t.inverse().is_finite())));
                played += 1;
            }
            Err(error) => {
                assert!(error.to_string().contains("model.gltf"), "{error}");
                refused += 1;
            }
        }
    }
    assert!(played > 20 && refused > 100, "{played} played, {refused} refused");
}
