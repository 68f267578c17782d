//! Placement in double precision: far from the world's zero, tiny, and huge.

mod common;

use common::anywhere;
use common::gltf::{FLOAT, File, bytes, document, square};
use common::{empty_scene, model_scene};
use glam::{DAffine3, DVec3, Vec3};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{CameraPath, Geometry, Motion, Object, Pose, Transform};
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{LoadedScene, Scene};
use serde_json::json;

/// Corners of all triangles at `frame`, seen from the camera of that frame: right, up, back.
fn seen(scene: &LoadedScene, frame: usize) -> Vec<DVec3> {
    let camera = scene.cameras[frame];
    assert_eq!(camera.origin, scene.origin);
    let place = camera.camera_to_world;
    let turn = place.matrix3.as_dmat3().transpose();
    let mut result = vec![];
    for instance in &scene.instances {
        let mesh = &scene.meshes[instance.mesh];
        let t = instance.transform(frame);
        let (matrix, move_) = (t.matrix3.as_dmat3(), t.translation.as_dvec3());
        result.extend(mesh.triangles.iter().flatten().map(|&i| {
            let relative = matrix * mesh.positions[i as usize].as_dvec3() + move_;
            turn * (relative - place.translation.as_dvec3())
        }));
    }
    result
}

fn assert_same(found: &[DVec3], expected: &[DVec3], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    assert!(!found.is_empty());
    for (a, b) in found.iter().zip(expected) {
        assert!(a.distance(*b) < tolerance, "{a} but {b}");
    }
}

/// A moving box and a still sphere, seen by a camera that moves too; everything `shift` metres away and `size` times as large.
fn yard(shift: DVec3, size: f64) -> Scene {
    let at = |x: f64, y: f64, z: f64| (shift + DVec3::new(x, y, z) * size).to_array();
    let pose = |x: f64| Pose { eye: at(x, 1.7, 4.0), target: at(0.1, 0.4, -0.2), up: [0.0, 1.0, 0.0] };
    let object = |name: &str, shape, transform: Transform, motion| Object {
        name: name.into(),
        geometry: Geometry::Shape(shape),
        material: None,
        transform: Transform { scale: [size as f32; 3], ..transform },
        motion,
        animation: None,
    };
    Scene {
        frames: 3,
        camera: CameraPath::Poses { poses: vec![pose(0.3), pose(0.5), pose(-2.0)], vertical_fov: 40.0 },
        objects: vec![
            object(
                "box",
                Shape::Box { size: [0.7, 0.3, 0.5], bevel: 0.0 },
                Transform { translation: at(0.3, 0.2, 0.1), rotation: [10.0, 20.0, 30.0], ..Default::default() },
                Some(Motion { translation: [0.017 * size, 0.0, 0.0], spin: 7.0, ..Motion::default() }),
            ),
            object(
                "sphere",
                Shape::Sphere { radius: 0.4 },
                Transform { translation: at(-0.6, 0.4, -0.3), ..Default::default() },
                None,
            ),
        ],
        ..empty_scene()
    }
}

#[test]
fn a_scene_far_out_is_seen_as_the_near_one() {
    let load = |shift, size| load::load(&yard(shift, size), &anywhere()).unwrap();
    let near = load(DVec3::ZERO, 1.0);
    assert_eq!(near.origin, DVec3::ZERO);
    for (shift, size) in [
        (DVec3::new(1e6, 0.0, 0.0), 1.0),
        (DVec3::new(-1e6, 3e5, 1e6), 1.0),
        (DVec3::ZERO, 1e-6),
        (DVec3::ZERO, 1e6),
        // A millimetre at ten kilometres; a kilometre at a thousand.
        (DVec3::new(0.0, 1e4, 0.0), 1e-3),
        (DVec3::splat(1e6), 1e3),
    ] {
        let far = load(shift, size);
        let out = shift.length() > 100.0 * size;
        assert_eq!(far.origin != DVec3::ZERO, out);
        for frame in 0..3 {
            let expected: Vec<DVec3> = seen(&near, frame).iter().map(|p| *p * size).collect();
            // Single precision of coordinates below 5, twice, and of the turn; double precision of the shift.
            assert_same(&seen(&far, frame), &expected, 2e-6 * size + 1e-15 * shift.length());
        }
    }
}

#[test]
fn orbits_are_as_round_far_out() {
    let orbit = |target: [f64; 3], distance| Scene {
        camera: CameraPath::Orbit {
            target,
            distance,
            elevation: 20.0,
            azimuth: 10.0,
            degrees_per_frame: 3.6,
            vertical_fov: 40.0,
        },
        ..empty_scene()
    };
    for (target, distance) in [([1e6, -1e6, 5e5], 2.0), ([0.0; 3], 1e-6), ([1e6, 0.0, 0.0], 1e-3), ([0.0; 3], 1e6)] {
        let (far, near) = (orbit(target, distance), orbit([0.0; 3], 1.0));
        for frame in [0, 1, 50, 99] {
            let (a, b) = (far.camera(frame), near.camera(frame));
            let world = (a.position_in_world() - DVec3::from(target)) / distance;
            assert!(world.distance(b.position_in_world()) < 1e-6 + 1e-9 / distance, "{world}");
            for axis in 0..3 {
                assert!(a.camera_to_world.matrix3.col(axis).distance(b.camera_to_world.matrix3.col(axis)) < 1e-6);
            }
        }
    }
}

/// Node trees that go a thousand kilometres out and come back, with an object that stands there or here.
#[test]
fn node_trees_keep_their_digits() {
    // 1000000.25 is a number of single precision.
    let far = [1_000_000.25, -500_000.5, 1_000_000.25];
    let back = [-1_000_000.25, 500_000.5, -1_000_000.25];
    let turn = [0.0, 0.6, 0.0, 0.8];
    let mut file = square();
    file["nodes"] = json!([
        { "children": [1], "translation": far },
        { "children": [2], "rotation": turn, "translation": [0.125, 0.25, 0.5] },
        { "mesh": 0, "scale": [2, 3, 1] },
        { "children": [4], "translation": far },
        { "children": [5], "translation": back },
        { "mesh": 0, "rotation": turn },
    ]);
    file["scenes"][0]["nodes"] = json!([0, 3]);
    let written = File::new(&file);
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 0.0));
    // The quaternion (0, 0.6, 0, 0.8): a turn about +y with cosine 0.28 and sine 0.96.
    let turned = |p: DVec3| DVec3::new(0.28 * p.x + 0.96 * p.z, p.y, -0.96 * p.x + 0.28 * p.z);
    for stands in [DVec3::ZERO, DVec3::from(far)] {
        let mut scene = model_scene(&written.path(), None);
        let eye = stands + DVec3::new(0.0, 0.5, 3.0);
        let pose = Pose { eye: eye.to_array(), target: stands.to_array(), up: [0.0, 1.0, 0.0] };
        scene.camera = CameraPath::Poses { poses: vec![pose], vertical_fov: 40.0 };
        let loaded = load::load(&scene, &anywhere()).unwrap();
        for (part, expected) in [
            (0, corners.map(|p| turned(p * DVec3::new(2.0, 3.0, 1.0)) + DVec3::new(0.125, 0.25, 0.5) + DVec3::from(far))),
            (1, corners.map(turned)),
        ] {
            let instance = &loaded.instances[part];
            let transform = DAffine3::from_mat4(glam::Mat4::from(instance.transform(0)).as_dmat4());
            for (p, expected) in corners.iter().zip(expected) {
                let relative = transform.transform_point3(*p);
                // Where the camera stands, a micrometre; a thousand kilometres away, what single precision has there.
                let near = (expected - stands).length() < 10.0;
                let tolerance = if near { 1e-6 } else { 0.1 };
                assert!((relative + loaded.origin).distance(expected) < tolerance, "{part}: {relative} but {expected}");
            }
        }
    }
}

/// Coordinates written a thousand kilometres out, turned and brought back by the object: the file's digits survive.
#[test]
fn meshes_written_far_out_are_moved_without_rounding() {
    let vertices: Vec<[f32; 3]> =
        (0..4).map(|i| [1e6 + 0.0625 * i as f32, 0.5 * (i * i) as f32, -2e6 - 0.125 * (i % 2) as f32]).collect();
    let mut file = document(&[(FLOAT, "VEC3", 4, false, bytes(vertices.as_flattened()))]);
    file["meshes"][0]["primitives"][0]["mode"] = json!(5);
    let written = File::new(&file);
    let mut scene = model_scene(&written.path(), None);
    scene.objects[0].transform =
        Transform { translation: [133_974.6, 0.0, 2_232_050.8], rotation: [0.0, 30.0, 0.0], ..Default::default() };
    let loaded = load::load(&scene, &anywhere()).unwrap();
    let (mesh, transform) = (&loaded.meshes[0], loaded.instances[0].transform(0));
    for (p, v) in mesh.positions.iter().zip(&vertices) {
        let [x, y, z] = v.map(f64::from);
        let (sin, cos) = 30_f64.to_radians().sin_cos();
        let expected = DVec3::new(cos * x + sin * z + 133_974.6, y, cos * z - sin * x + 2_232_050.8);
        assert!(expected.length() < 10.0, "brought back: {expected}");
        let found = transform.transform_point3a((*p).into()).as_dvec3();
        assert!(found.distance(expected) < 1e-6, "{found} but {expected}");
    }
}

#[test]
fn scales_from_a_millionth_to_a_million_and_beyond_load() {
    for scale in [1e-6_f32, 1e6, 1e-13, 1e12] {
        let mut file = square();
        file["nodes"] = json!([{ "mesh": 0, "scale": [scale, scale, -scale] }]);
        let loaded = File::new(&file).load().unwrap();
        let transform = loaded.instances[0].transform(0);
        assert_eq!(transform.matrix3.x_axis.x, scale);
        // Mirrored: the winding is turned, although the determinant of 1e-39 has no sign in single precision.
        assert_eq!(loaded.meshes[loaded.instances[0].mesh].triangles[0], [0, 2, 1]);
    }
    let mut file = square();
    file["nodes"] = json!([{ "mesh": 0, "scale": [1e-6, 0, 1] }]);
    assert!(File::new(&file).load().unwrap().instances.is_empty());
}

/// Triangles whose area is nothing in single precision but not in their numbers.
#[test]
fn tiny_and_huge_triangles_have_normals() {
    for size in [1e-30_f32, 1e-15, 1e-6, 1e6, 1e15, 1e30] {
        let positions = [0.0, 0.0, 0.0, size, 0.0, 0.0, 0.0, 0.0, -size];
        let normals = [0.0_f32; 9];
        let mut file = document(&[(FLOAT, "VEC3", 3, false, bytes(&positions)), (FLOAT, "VEC3", 3, false, bytes(&normals))]);
        file["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(1);
        let loaded = File::new(&file).load().unwrap();
        assert_eq!((loaded.report.triangles.dropped(), loaded.report.triangles.needles), (0, 0), "{size}");
        assert_eq!(loaded.meshes[0].normals, [Vec3::Y; 3], "{size}");
    }
}

#[test]
fn a_model_of_any_size_at_any_place_is_framed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.obj");
    for (size, shift) in [(1e-6, 0.0), (1e6, 0.0), (8.0, 1e6), (1.0 / 1024.0, 1024.0), (1e-6, 1.0 / 64.0)] {
        let corner = |x: f64, y: f64, z: f64| format!("v {} {} {}\n", shift + x * size, shift + y * size, shift + z * size);
        let text = [corner(0.0, 0.0, 0.0), corner(2.0, 0.0, 0.0), corner(0.0, 2.0, 0.0), corner(0.0, 0.0, 2.0)].concat();
        std::fs::write(&path, text + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n").unwrap();
        let scene = load::describe_model(&path, None, &ModelView::default(), &Reach::of(&path)).unwrap();
        let loaded = load::load(&scene, &anywhere()).unwrap();
        let mesh = &loaded.meshes[loaded.instances[0].mesh];
        let placed: Vec<Vec3> = mesh
            .triangles
            .iter()
            .flatten()
            .map(|&i| loaded.instances[0].transform(0).transform_point3(mesh.positions[i as usize]))
            .collect();
        // The middle of the bounding box is (1, 1, 1), and the corners lie sqrt(3) from it: both become 1.
        let expected = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [-1.0, 2.0, -1.0], [-1.0, 0.0, 1.0]]
            .map(|p: [f32; 3]| Vec3::from(p) / 3f32.sqrt());
        // What the file's decimals lose in single precision, in the scene's metres (nothing where they are dyadic).
        let lost = |x: f64| (f64::from((shift + x * size) as f32) - (shift + x * size)).abs() / size;
        let tolerance = 1e-5 + 2.0 * (lost(0.0) + lost(2.0)) as f32;
        assert!(tolerance < 0.02);
        for (found, corner) in placed.iter().zip([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]) {
            assert!(found.distance(expected[corner]) < tolerance, "{size} at {shift}: {found} but {}", expected[corner]);
        }
    }
}

#[test]
fn positions_keep_the_digits_of_single_or_double_precision() {
    use renderflow_scenes::description::decimal;
    assert_eq!([0.1_f32, 1.2e-6, -3e9, 16_777_216.0].map(decimal), [0.1, 1.2e-6, -3e9, 16_777_216.0]);
    let json = |x: f64| {
        let transform = Transform { translation: [x, 0.0, -0.0], ..Default::default() };
        let text = serde_json::to_string(&transform).unwrap();
        let back: Transform = serde_json::from_str(&text).unwrap();
        assert_eq!(back, transform);
        text.split(['[', ',']).nth(1).unwrap().to_owned()
    };
    // Decimals of single precision are written as single precision writes them.
    for (value, text) in [(0.1, "0.1"), (0.000_001_2, "0.0000012"), (1e6, "1000000.0"), (123.456_78, "123.45678")] {
        assert_eq!(json(value), text);
        assert_eq!(json(value), serde_json::to_string(&(value as f32)).unwrap());
    }
    // And others whole.
    assert_eq!(json(1_000_000.3), "1000000.3");
    assert_eq!(json(f64::from(0.1_f32)), "0.10000000149011612");
}
