//! Skins and morph targets of glTF: vertices against positions worked out by hand, and against Blender's.

mod common;

use common::gltf::{FLOAT, File, bytes, document};
use common::{anywhere, asset, model_scene};
use glam::Vec3;
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::Animation;
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::{LoadedScene, Result};
use serde_json::{Value, json};
use std::path::Path;

const BYTE: u32 = 5121;
const SHORT: u32 = 5123;
/// Sine and cosine of 45 degrees.
const HALF: f32 = std::f32::consts::FRAC_1_SQRT_2;

/// Corners of a bar along +x, 2 m long, that a joint at x = 0 and one at x = 1 move, and their halves of each.
const BAR: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.5, 0.5, 0.0], [2.0, 0.5, 0.0]];
const SHARES: [[f32; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [0.5, 0.5], [0.0, 1.0]];
/// The same after the second joint has turned by 90 degrees about +z.
const BENT: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.5, 0.0], [0.5, 1.0, 0.0]];

/// The bar: node 0 shows it, nodes 1 and 2 are the joints. An animation turns node 2 in a second, and holds it for another.
fn bar() -> Value {
    let matrix = |x: f32| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, 0.0, 0.0, 1.0];
    let weights: Vec<f32> = SHARES.iter().flat_map(|[a, b]| [*a, *b, 0.0, 0.0]).collect();
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&BAR.concat())),
        (FLOAT, "VEC3", 4, false, bytes(&[0.0, 1.0, 0.0].repeat(4))),
        (BYTE, "VEC4", 4, false, [0, 1, 0, 0].repeat(4)),
        (FLOAT, "VEC4", 4, false, bytes(&weights)),
        (SHORT, "SCALAR", 6, false, [0_u16, 1, 2, 1, 3, 2].into_iter().flat_map(u16::to_le_bytes).collect()),
        (FLOAT, "MAT4", 2, false, bytes(&[matrix(0.0), matrix(-1.0)].concat())),
        (FLOAT, "SCALAR", 3, false, bytes(&[0.0, 1.0, 2.0])),
        (FLOAT, "VEC4", 3, false, bytes(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, HALF, HALF, 0.0, 0.0, HALF, HALF])),
    ]);
    file["meshes"][0]["primitives"][0] =
        json!({ "attributes": { "POSITION": 0, "NORMAL": 1, "JOINTS_0": 2, "WEIGHTS_0": 3 }, "indices": 4 });
    file["nodes"] = json!([
        { "mesh": 0, "skin": 0, "translation": [9, 9, 9] },
        { "children": [2] },
        { "translation": [1, 0, 0] },
    ]);
    file["scenes"][0]["nodes"] = json!([0, 1]);
    file["skins"] = json!([{ "joints": [1, 2], "inverseBindMatrices": 5 }]);
    file["animations"] = json!([{
        "samplers": [{ "input": 6, "output": 7 }],
        "channels": [{ "sampler": 0, "target": { "node": 2, "path": "rotation" } }],
    }]);
    file
}

/// A scene of the file that plays its first animation.
fn playing(path: &Path, frames: u32, frames_per_second: f64) -> Result<LoadedScene> {
    let mut scene = model_scene(path, None);
    scene.frames = frames;
    scene.objects[0].animation = Some(Animation { frames_per_second, ..Animation::default() });
    load::load(&scene, &anywhere())
}

/// Vertices of the first instance in the world at a frame.
fn world(scene: &LoadedScene, frame: usize) -> Vec<Vec3> {
    let instance = &scene.instances[0];
    let posed = scene.meshes[instance.mesh].posed(frame);
    posed.positions.iter().map(|&p| instance.transform(frame).transform_point3(p)).collect()
}

#[track_caller]
fn close(found: &[Vec3], expected: &[[f32; 3]]) {
    let near = |(a, b): (&Vec3, &[f32; 3])| a.distance(Vec3::from(*b)) < 1e-5;
    assert!(found.len() == expected.len() && found.iter().zip(expected).all(near), "{found:?}, not {expected:?}");
}

#[test]
fn a_bar_of_two_joints_bends_by_ninety_degrees() {
    // As it rests, a file has a pose too.
    let mut file = bar();
    let scene = File::new(&file).load().unwrap();
    close(&world(&scene, 0), &BAR);
    file["nodes"][2]["rotation"] = json!([0, 0, HALF, HALF]);
    let scene = File::new(&file).load().unwrap();
    close(&world(&scene, 0), &BENT);
    assert!(!scene.meshes[0].deforms(), "what rests needs no deformation");
    assert_eq!(
        scene.report.notes,
        ["FILE: the file has 1 animation (0); --animation NAME plays one"]
            .map(|note| { note.replace("FILE", scene.report.notes[0].split(": ").next().unwrap()) })
    );

    // The animation takes a quarter of a turn in a second; a twelfth of a turn moves the end by its sine and cosine.
    let file = File::new(&bar());
    let scene = playing(&file.path(), 4, 3.0).unwrap();
    close(&world(&scene, 0), &BAR);
    let (sin, cos) = 30_f32.to_radians().sin_cos();
    close(&world(&scene, 1)[..2], &[[0.0; 3], [1.0 + cos, sin, 0.0]]);
    let scene = playing(&file.path(), 2, 1.0).unwrap();
    close(&world(&scene, 1), &BENT);
    let mesh = &scene.meshes[scene.instances[0].mesh];
    close(&mesh.posed(1).normals, &[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [-HALF, HALF, 0.0], [-1.0, 0.0, 0.0]]);
    assert!(mesh.deforms() && !mesh.same_pose(0, 1) && mesh.same_pose(1, 9));
    // The mesh itself has the pose of the first frame; one vertex alone is where all together have it.
    assert_eq!(mesh.positions, mesh.posed(0).positions.into_owned());
    assert_eq!((0..4).map(|v| mesh.position_at(v, 1)).collect::<Vec<_>>(), mesh.posed(1).positions.into_owned());
}

/// What skins leave to the program: weights that do not add up to 1, as integers and in two sets, and vertices without any.
#[test]
fn weights_are_made_to_add_up_to_one() {
    let mut file = bar();
    file["nodes"][2]["rotation"] = json!([0, 0, HALF, HALF]);
    let append = |file: &mut Value, data: Vec<u8>, accessor: Value| {
        let buffer = file["buffers"].as_array().unwrap().len();
        let view = file["bufferViews"].as_array().unwrap().len();
        let uri = common::gltf::data_uri("application/octet-stream", &data);
        file["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": data.len(), "uri": uri }));
        file["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": buffer, "byteLength": data.len() }));
        let mut accessor = accessor;
        accessor["bufferView"] = json!(view);
        file["accessors"].as_array_mut().unwrap().push(accessor);
        file["accessors"].as_array().unwrap().len() - 1
    };
    // Half of each share, in bytes, in the first set; as much in the second one.
    let half = [[100, 0], [0, 100], [50, 50], [0, 100]];
    let integers = half.iter().flat_map(|[a, b]| [*a, *b, 0, 0]).collect::<Vec<u8>>();
    let fractions = json!({ "componentType": BYTE, "normalized": true, "type": "VEC4", "count": 4 });
    let weights = append(&mut file, integers, fractions);
    let attributes = &mut file["meshes"][0]["primitives"][0]["attributes"];
    attributes["WEIGHTS_0"] = json!(weights);
    attributes["JOINTS_1"] = json!(2);
    attributes["WEIGHTS_1"] = json!(3);
    let scene = File::new(&file).load().unwrap();
    close(&world(&scene, 0), &BENT);
    // A vertex without weight follows the first joint that it names, and a negative weight is none.
    let none: Vec<f32> = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [-1.0, 1.0]].iter().flat_map(|[a, b]| [*a, *b, 0.0, 0.0]).collect();
    let weights = append(&mut file, bytes(&none), json!({ "componentType": FLOAT, "type": "VEC4", "count": 4 }));
    let attributes = &mut file["meshes"][0]["primitives"][0]["attributes"];
    attributes["WEIGHTS_0"] = json!(weights);
    attributes.as_object_mut().unwrap().remove("JOINTS_1");
    attributes.as_object_mut().unwrap().remove("WEIGHTS_1");
    let scene = File::new(&file).load().unwrap();
    close(&world(&scene, 0), &[BENT[0], BENT[1], BAR[2], BENT[3]]);
    let notes = scene.report.notes.join("\n");
    assert!(notes.contains("/meshes/0/primitives/0: 1 weights of joints are negative and are not used"), "{notes}");
    assert!(notes.contains("1 vertices have no weight for any joint"), "{notes}");
}

/// The bar with two morph targets: one lifts the end, one moves everything along z. They are moved before the joints are.
fn morphing() -> Value {
    let mut file = bar();
    let targets = [[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 2.0].repeat(4).try_into().unwrap()];
    let data: Vec<u8> = bytes(&targets.concat());
    let uri = common::gltf::data_uri("application/octet-stream", &data);
    file["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": data.len(), "uri": uri }));
    for target in 0..2 {
        let (views, offset) = (file["bufferViews"].as_array().unwrap().len(), 48 * target);
        file["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 1, "byteOffset": offset, "byteLength": 48 }));
        let accessor = json!({ "bufferView": views, "componentType": FLOAT, "type": "VEC3", "count": 4 });
        file["accessors"].as_array_mut().unwrap().push(accessor);
    }
    file["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 8 }, { "POSITION": 9 }]);
    file
}

#[test]
fn morph_targets_come_before_the_skin() {
    let mut file = morphing();
    let rigid = |file: &Value| {
        let mut file = file.clone();
        file["nodes"][0].as_object_mut().unwrap().remove("skin");
        file["nodes"][0].as_object_mut().unwrap().remove("translation");
        file
    };
    // Without weights, targets and the mesh without them are the same.
    let (with, without) = (File::new(&rigid(&file)).load().unwrap(), File::new(&rigid(&bar())).load().unwrap());
    assert_eq!(with.meshes[0].positions, without.meshes[0].positions);
    // Of the mesh, or in their place those of the node.
    let lifted: [[f32; 3]; 4] = [[0.0, 0.0, 1.0], [2.0, 0.25, 1.0], [1.5, 0.5, 1.0], [2.0, 0.75, 1.0]];
    file["meshes"][0]["weights"] = json!([0.25, 0.5]);
    close(&world(&File::new(&rigid(&file)).load().unwrap(), 0), &lifted);
    file["nodes"][0]["weights"] = json!([0.0, 0.5]);
    close(&world(&File::new(&rigid(&file)).load().unwrap(), 0)[1..2], &[[2.0, 0.0, 1.0]]);
    // Lifted by 1/4 along y, then turned about (1, 0): the end comes to lie at x = 1 - 1/4.
    file["nodes"][0].as_object_mut().unwrap().remove("weights");
    file["nodes"][2]["rotation"] = json!([0, 0, HALF, HALF]);
    close(&world(&File::new(&file).load().unwrap(), 0)[..2], &[[0.0, 0.0, 1.0], [0.75, 1.0, 1.0]]);
}

/// Targets of texture coordinates and colours are noted where some weight asks for the targets.
#[test]
fn targets_that_are_not_read_are_noted() {
    for name in ["TEXCOORD_0", "TEXCOORD_1", "COLOR_0"] {
        let notes = |target: &str, weights: Value| {
            let mut file = morphing();
            file["meshes"][0]["primitives"][0]["targets"][1][target] = json!(9);
            file["meshes"][0]["weights"] = weights;
            let notes = File::new(&file).load().unwrap().report.notes;
            notes.into_iter().filter(|note| note.contains("morph targets")).collect::<Vec<String>>()
        };
        let said = notes(name, json!([0.25, 0.5]));
        let expected = "1 primitives have morph targets of texture coordinates or colours, which are not read";
        assert!(said.len() == 1 && said[0].ends_with(expected), "{name}: {said:?}");
        assert_eq!(notes(name, json!([0, 0])), [""; 0]);
        assert_eq!(notes("NORMAL", json!([0.25, 0.5])), [""; 0]);
    }
    let mut file = morphing();
    file["meshes"][0]["primitives"][0]["targets"][0]["COLOR_0"] = json!(9);
    let file = File::new(&file);
    let notes = playing(&file.path(), 2, 1.0).unwrap().report.notes;
    assert!(notes.iter().any(|note| note.contains("1 primitives have morph targets of")), "{notes:?}");
}

/// The channel `weights`, with each interpolation, and a weight at rest that the animation does not touch.
#[test]
fn animations_move_weights() {
    let heights = |interpolation: &str, values: &[f32]| {
        let mut file = morphing();
        file["nodes"][0].as_object_mut().unwrap().remove("skin");
        file["nodes"][0].as_object_mut().unwrap().remove("translation");
        let data = bytes(&[&[0.0, 1.0], values].concat());
        let uri = common::gltf::data_uri("application/octet-stream", &data);
        file["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": data.len(), "uri": uri }));
        let views = file["bufferViews"].as_array().unwrap().len();
        for (offset, length) in [(0, 8), (8, data.len() - 8)] {
            file["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 2, "byteOffset": offset, "byteLength": length }));
            let accessor =
                json!({ "bufferView": views + offset / 8, "componentType": FLOAT, "type": "SCALAR", "count": length / 4 });
            file["accessors"].as_array_mut().unwrap().push(accessor);
        }
        file["animations"] = json!([{
            "samplers": [{ "input": 10, "output": 11, "interpolation": interpolation }],
            "channels": [{ "sampler": 0, "target": { "node": 0, "path": "weights" } }],
        }]);
        let file = File::new(&file);
        playing(&file.path(), 4, 4.0).map(|scene| (0..4).map(|frame| world(&scene, frame)[1]).collect::<Vec<Vec3>>())
    };
    let end = |weights: [[f32; 2]; 4]| weights.map(|[lift, along]| [2.0, lift, 2.0 * along]);
    let ends = [0.0, 1.0, 1.0, 0.0];
    close(&heights("STEP", &ends).unwrap(), &end([[0.0, 1.0]; 4]));
    close(&heights("LINEAR", &ends).unwrap(), &end([[0.0, 1.0], [0.25, 0.75], [0.5, 0.5], [0.75, 0.25]]));
    // In-tangents, values and out-tangents of both targets. With out-tangent 2 and in-tangent -1 for the first one:
    // s = 1/4: 2 * 0.140625 + 0.15625 - 1 * -0.046875 = 0.484375;  s = 1/2: 2 / 8 + 1 / 2 + 1 / 8 = 0.875
    // s = 3/4: 2 * 0.046875 + 0.84375 + 0.140625 = 1.078125.  The second one has no tangents: 1 - 3 s^2 + 2 s^3.
    let spline = [9.0, 9.0, 0.0, 1.0, 2.0, 0.0, -1.0, 0.0, 1.0, 0.0, 9.0, 9.0];
    let expected = [[0.0, 1.0], [0.484_375, 0.843_75], [0.875, 0.5], [1.078_125, 0.156_25]];
    close(&heights("CUBICSPLINE", &spline).unwrap(), &end(expected));
    let error = heights("LINEAR", &ends[..3]).unwrap_err().to_string();
    assert!(error.contains("/animations/0/samplers/0/output: 3 values where 2 keys of 2 morph targets need 4"), "{error}");
}

#[test]
fn vertices_are_where_blender_has_them() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references");
    let scene = playing(&folder.join("deform.gltf"), 5, 24.0).unwrap();
    let mut lines = 0;
    for line in std::fs::read_to_string(folder.join("deform.csv")).unwrap().lines().skip(1) {
        let numbers: Vec<f32> = line.split(',').map(|number| number.parse().unwrap()).collect();
        let (frame, vertex) = (numbers[0] as usize, numbers[1] as usize);
        let (found, expected) = (world(&scene, frame)[vertex], Vec3::from_slice(&numbers[2..]));
        assert!(found.distance(expected) < 5e-6, "{line}: {found}");
        lines += 1;
    }
    assert_eq!(lines, 5 * 66);
}

/// A normal map splits the vertices of a flat-shaded mesh; each new one moves as the one that it came from.
#[test]
fn vertices_that_are_split_for_tangents_move_as_before() {
    let mut file = bar();
    let primitive = &mut file["meshes"][0]["primitives"][0];
    primitive["attributes"].as_object_mut().unwrap().remove("NORMAL");
    primitive["attributes"]["TEXCOORD_0"] = json!(8);
    primitive["material"] = json!(0);
    let uvs = bytes(&[0.0, 0.0, 1.0, 0.0, 0.5, 1.0, 1.0, 1.0]);
    let uri = common::gltf::data_uri("application/octet-stream", &uvs);
    file["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": uvs.len(), "uri": uri }));
    file["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 1, "byteLength": uvs.len() }));
    file["accessors"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "bufferView": 8, "componentType": FLOAT, "type": "VEC2", "count": 4 }));
    let corners = |file: &Value, frame: usize| {
        let file = File::new(file);
        let scene = playing(&file.path(), 2, 1.0).unwrap();
        let mesh = &scene.meshes[scene.instances[0].mesh];
        let (posed, placed) = (mesh.posed(frame), world(&scene, frame));
        let corners: Vec<Vec3> = mesh.triangles.iter().flatten().map(|&v| placed[v as usize]).collect();
        (corners, posed.normals.into_owned(), posed.tangents.into_owned())
    };
    file["materials"] = json!([{}]);
    let welded = [corners(&file, 0), corners(&file, 1)];
    file["materials"] = json!([{ "normalTexture": { "index": 0 } }]);
    file["textures"] = json!([{ "source": 0 }]);
    let mut png = std::io::Cursor::new(vec![]);
    image::RgbImage::new(1, 1).write_to(&mut png, image::ImageFormat::Png).unwrap();
    file["images"] = json!([{ "uri": common::gltf::data_uri("image/png", &png.into_inner()) }]);
    for (frame, welded) in welded.iter().enumerate() {
        let (split, normals, tangents) = corners(&file, frame);
        assert_eq!((normals.len(), tangents.len(), welded.1.len()), (6, 6, 0));
        assert_eq!(split, welded.0);
    }
    // The corner that only the second joint moves: its tangent, along the bar, turns with it.
    let (_, normals, tangents) = corners(&file, 1);
    close(&[normals[1], tangents[1].truncate()], &[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]);
}

/// A square that is a point at rest has triangles all the same, which its morph target opens.
#[test]
fn triangles_without_area_may_unfold() {
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(&[0.0; 12])),
        (FLOAT, "VEC3", 4, false, bytes(&common::gltf::STRIP)),
        (FLOAT, "SCALAR", 3, false, bytes(&[0.0, 1.0, 2.0])),
        (FLOAT, "SCALAR", 3, false, bytes(&[0.0, 1.0, 1.0])),
    ]);
    file["meshes"][0]["primitives"][0] = json!({ "mode": 5, "attributes": { "POSITION": 0 }, "targets": [{ "POSITION": 1 }] });
    file["animations"] = json!([{
        "samplers": [{ "input": 2, "output": 3 }],
        "channels": [{ "sampler": 0, "target": { "node": 0, "path": "weights" } }],
    }]);
    let file = File::new(&file);
    let scene = playing(&file.path(), 2, 1.0).unwrap();
    assert_eq!(scene.meshes[scene.instances[0].mesh].triangles.len(), 2);
    close(&world(&scene, 1), &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]]);
    // The file has two triangles, however often it is read.
    assert_eq!(scene.report.triangles.no_area, 2);
    assert_eq!(file.load().unwrap().report.triangles.no_area, 2);
}

/// The rectangle around an animated model is that of its poses.
#[test]
fn cameras_and_floors_follow_the_pose() {
    let describe = |file: &Value, animation: Option<Animation>| {
        let file = File::new(file);
        let view = ModelView { animation, ..ModelView::default() };
        load::describe_model(&file.path(), None, &view, &Reach::of(&file.path())).unwrap().objects[0].transform.scale[0]
    };
    let mut file = bar();
    // Half of the diagonal of 2 x 0.5 m.
    let resting = describe(&file, None);
    assert!((1.0 / resting - 0.5 * 4.25_f32.sqrt()).abs() < 1e-5, "{resting}");
    // On its way the end's upper corner, 1.118 m from the joint, passes above it: the box of all moments is 2 x 1.118 m.
    let moving = describe(&file, Some(Animation::default()));
    assert!((1.0 / moving - 1.0_f32.hypot(0.5 * 1.25_f32.sqrt())).abs() < 2e-3, "{moving}");
    file["nodes"][2]["rotation"] = json!([0, 0, HALF, HALF]);
    let bent = describe(&file, None);
    assert!((1.0 / bent - 0.5 * 2.0_f32.sqrt()).abs() < 1e-5, "{bent}");
}

/// Joints that mirror what they move turn its triangles too, so that their fronts stay outside.
#[test]
fn joints_that_mirror_keep_the_front_outside() {
    let mut file = bar();
    for animated in [false, true] {
        for mirror in [1.0, -1.0] {
            file["nodes"][1]["scale"] = json!([1.0, 1.0, mirror]);
            let file = File::new(&file);
            let scene = if animated { playing(&file.path(), 2, 1.0).unwrap() } else { file.load().unwrap() };
            let mesh = &scene.meshes[scene.instances[0].mesh];
            let [a, b, c] = mesh.triangles[0].map(|v| mesh.positions[v as usize]);
            assert_eq!((b - a).cross(c - a).z.signum(), mirror, "the front faced +z in the file");
        }
    }
}

/// What contradicts itself is an error that names the place; nothing panics.
#[test]
fn broken_skins_and_targets_are_refused() {
    type Change = fn(&mut Value);
    let cases: [(Change, &str); 8] = [
        (
            |f| f["skins"][0]["joints"] = json!([1]),
            "/meshes/0/primitives/0/attributes/JOINTS_0: joint 1 does not exist, there are 1",
        ),
        (|f| f["skins"][0]["joints"] = json!([1, 77]), "there is nothing with the index 77"),
        (|f| f["skins"][0]["inverseBindMatrices"] = json!(0), "/skins/0/inverseBindMatrices: accessor 0 has 3 components"),
        (|f| f["accessors"][5]["count"] = json!(1), "/skins/0/inverseBindMatrices: 1 matrices for 2 joints"),
        (
            |f| f["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(1),
            "/meshes/0/primitives/0/attributes/WEIGHTS_0: accessor 1 has 3 components where 4 are needed",
        ),
        (
            |f| drop(f["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("WEIGHTS_0")),
            "/meshes/0/primitives/0/attributes/JOINTS_0: 4 sets of joints and 0 of weights",
        ),
        (|f| f["accessors"][9]["count"] = json!(3), "/meshes/0/primitives/0/targets/1/POSITION: 3 values for 4 positions"),
        (|f| f["nodes"][0]["weights"] = json!([1e39]), "/nodes/0/weights"),
    ];
    for (change, expected) in cases {
        let mut file = morphing();
        file["meshes"][0]["weights"] = json!([1, 1]);
        change(&mut file);
        let error = File::new(&file).error();
        assert!(error.contains(expected), "{error}, not {expected}");
    }
    // Weights that are not numbers.
    let mut file = bar();
    let data = bytes(&[f32::NAN; 16]);
    let uri = common::gltf::data_uri("application/octet-stream", &data);
    file["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": data.len(), "uri": uri }));
    file["bufferViews"][3] = json!({ "buffer": 1, "byteLength": data.len() });
    let error = File::new(&file).error();
    assert!(error.contains("/attributes/WEIGHTS_0: a weight of vertex 0 is not finite"), "{error}");
    // What can be shown without its skin is.
    for (change, expected) in [
        (
            (|f| f["scenes"][0]["nodes"] = json!([0])) as Change,
            "/skins/0/joints/0: node 1 is not in the file's scene; the skin is not used",
        ),
        (
            |f| {
                drop(
                    f["meshes"][0]["primitives"][0]
                        .as_object_mut()
                        .unwrap()
                        .insert("attributes".into(), json!({ "POSITION": 0 })),
                )
            },
            "1 primitives on nodes with a skin that have no joints, and follow their nodes",
        ),
    ] {
        let mut file = bar();
        change(&mut file);
        let scene = File::new(&file).load().unwrap();
        assert!(scene.report.notes.join("\n").contains(expected), "{:?}", scene.report.notes);
        close(&world(&scene, 0)[..1], &[[9.0; 3]]);
    }
}

/// A few kilobytes of JSON must not fill the memory: one mesh with zeros for data, posed by thousands of nodes.
#[test]
fn copies_of_a_posed_mesh_have_a_limit() {
    let mut file = bar();
    for accessor in [0, 1, 2, 3] {
        file["accessors"][accessor]["count"] = json!(200_000);
        file["accessors"][accessor].as_object_mut().unwrap().remove("bufferView");
    }
    file["nodes"] =
        json!((0..3000).map(|i| if i < 2998 { json!({ "mesh": 0, "skin": 0 }) } else { json!({}) }).collect::<Vec<_>>());
    file["scenes"][0]["nodes"] = json!((0..3000).collect::<Vec<_>>());
    file["skins"][0]["joints"] = json!([2998, 2999]);
    let error = File::new(&file).error();
    assert!(error.contains("posed again and again"), "{error}");
    // Thousands of targets, all of the same zeros.
    let mut file = morphing();
    file["meshes"][0]["weights"] = json!(vec![1.0; 5000]);
    file["meshes"][0]["primitives"][0]["targets"] = json!(vec![json!({ "POSITION": 8 }); 5000]);
    assert!(File::new(&file).load().is_ok());
    for accessor in [0, 1, 2, 3, 8] {
        file["accessors"][accessor]["count"] = json!(200_000);
        file["accessors"][accessor].as_object_mut().unwrap().remove("bufferView");
    }
    let error = File::new(&file).error();
    assert!(error.contains("200000 elements without data"), "{error}");
}

/// A file of other people with a morph target and an animation of its weights.
#[test]
fn the_sparse_box_of_gltf_rs_moves() {
    let Some(path) = asset("gltf/edge/gltf-rs/box_sparse.gltf") else { return };
    // Its weight goes from 0 to 1 between 1 and 2 seconds, and corners move by up to 1/2 along each axis.
    let scene = playing(&path, 8, 4.0).unwrap();
    let mesh = &scene.meshes[scene.instances[0].mesh];
    let moved = |frame: usize| {
        let (rest, now) = (mesh.posed(0).positions.into_owned(), mesh.posed(frame).positions.into_owned());
        rest.iter().zip(now).map(|(a, b)| (*a - b).abs().max_element()).fold(0.0, f32::max)
    };
    assert_eq!([4, 5, 6, 7].map(moved), [0.0, 0.125, 0.25, 0.375]);
}

/// Documents with parts exchanged at random: posed or refused, never a panic.
#[test]
fn nonsense_is_refused_and_nothing_else_happens() {
    let file = morphing();
    let mut state = 11_u32;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let places = [
        "/accessors/2/componentType",
        "/accessors/2/normalized",
        "/accessors/3/count",
        "/accessors/3/normalized",
        "/accessors/5/bufferView",
        "/accessors/8/count",
        "/accessors/9/type",
        "/bufferViews/2/byteOffset",
        "/bufferViews/5/byteLength",
        "/meshes/0/primitives/0/attributes/JOINTS_0",
        "/meshes/0/primitives/0/attributes/WEIGHTS_0",
        "/meshes/0/primitives/0/targets",
        "/meshes/0/primitives/0/targets/1/POSITION",
        "/meshes/0/weights",
        "/nodes/0/weights",
        "/nodes/0/skin",
        "/nodes/1/children",
        "/nodes/2/scale",
        "/nodes/2/translation",
        "/skins/0/joints",
        "/skins/0/inverseBindMatrices",
        "/scenes/0/nodes",
        "/animations/0/samplers/0/output",
        "/animations/0/channels/0/target/path",
        "/animations/0/channels/0/target/node",
    ];
    let values = [
        json!(0),
        json!(1),
        json!(2),
        json!(8),
        json!(4_294_967_295_u32),
        json!(5121),
        json!(5126),
        json!("weights"),
        json!("VEC4"),
        json!(true),
        json!([]),
        json!([0]),
        json!([1, 0]),
        json!([1, 1, 0]),
        json!([1e38, -1e38, 1e38]),
        json!([0, 0, 0]),
        json!({}),
    ];
    let (mut posed, mut refused) = (0, 0);
    for _ in 0..800 {
        let mut broken = file.clone();
        broken["meshes"][0]["weights"] = json!([1, 0.5]);
        for _ in 0..1 + random(3) {
            if let Some(place) = broken.pointer_mut(places[random(places.len())]) {
                *place = values[random(values.len())].clone();
            }
        }
        let file = File::new(&broken);
        for loaded in [file.load(), playing(&file.path(), 5, 4.0)] {
            match loaded {
                Ok(scene) => {
                    for instance in &scene.instances {
                        (0..5).for_each(|frame| drop(scene.meshes[instance.mesh].posed(frame)));
                    }
                    posed += 1;
                }
                Err(error) => {
                    assert!(error.to_string().contains("model.gltf"), "{error}");
                    refused += 1;
                }
            }
        }
    }
    println!("{posed} posed, {refused} refused");
    assert!(posed > 50 && refused > 100, "{posed} posed, {refused} refused");
}
