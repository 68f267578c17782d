//! Lights of scene files, of glTF files and of photometric profiles.

mod common;

use common::gltf::{File, square};
use common::{anywhere, empty_scene, model_scene};
use glam::{Vec3, Vec3A};
use renderflow_scenes::ies::Profile;
use renderflow_scenes::loaded::{PunctualKind, PunctualLight};
use renderflow_scenes::{LoadedScene, Scene, load};
use serde_json::{Value, json};

fn scene(lights: Value) -> Scene {
    Scene { lights: serde_json::from_value(lights).expect("lights"), frames: 3, ..empty_scene() }
}

fn loaded(lights: Value) -> LoadedScene {
    load::load(&scene(lights), &anywhere()).expect("the scene loads")
}

fn ahead(light: &PunctualLight, frame: usize) -> Vec3 {
    Vec3::from(-light.transform(frame).matrix3.z_axis)
}

fn problems(lights: Value) -> String {
    scene(lights).validate().expect_err("must be refused").to_string()
}

#[test]
fn a_scene_without_lights_is_written_as_before() {
    assert!(!empty_scene().canonical_json().contains("lights"));
    let with = scene(json!([{ "name": "a", "kind": { "point": { "intensity": 2.0 } } }]));
    assert!(with.canonical_json().ends_with(
        r#","objects":[],"lights":[{"name":"a","kind":{"point":{"intensity":2.0}},"color":[1.0,1.0,1.0],"transform":{"translation":[0.0,0.0,0.0],"rotation":[0.0,0.0,0.0],"scale":[1.0,1.0,1.0]}}]}"#
    ));
    assert_eq!(serde_json::from_str::<Scene>(&with.canonical_json()).unwrap(), with);
}

#[test]
fn lights_without_an_area_are_loaded() {
    let found = loaded(json!([
        { "name": "bulb", "kind": { "point": { "intensity": 4.0 } }, "color": [1.0, 0.5, 0.25], "transform": { "translation": [1, 2, 3] } },
        { "name": "spot", "kind": { "spot": { "intensity": 2.0, "inner_angle": 10.0, "outer_angle": 60.0 } },
          "transform": { "translation": [0, 5, 0], "rotation": [-90, 0, 0] } },
        { "name": "sun", "kind": { "directional": { "irradiance": 3.0 } }, "transform": { "translation": [0, 1, 0] }, "target": [1, 0, 0],
          "motion": { "translation": [1, 0, 0] } },
    ]));
    let [bulb, spot, sun] = found.lights.as_slice() else { panic!("{} lights", found.lights.len()) };
    assert_eq!(bulb.kind, PunctualKind::Point { intensity: [4.0, 2.0, 1.0] });
    assert_eq!(Vec3::from(bulb.transform(0).translation), Vec3::new(1.0, 2.0, 3.0));
    let PunctualKind::Spot { intensity, inner, outer } = spot.kind else { panic!("{spot:?}") };
    assert_eq!((intensity, inner), ([2.0; 3], 10_f32.to_radians()));
    assert!((outer - std::f32::consts::FRAC_PI_3).abs() < 1e-6);
    // Along its own -z, which a quarter turn about x takes from ahead to below.
    assert!(ahead(spot, 0).distance(Vec3::NEG_Y) < 1e-6);
    assert_eq!(sun.kind, PunctualKind::Directional { irradiance: [3.0; 3] });
    assert!(ahead(sun, 0).distance(Vec3::new(1.0, -1.0, 0.0).normalize()) < 1e-6);
    // It goes on looking at the target.
    assert!(ahead(sun, 1).distance(Vec3::NEG_Y) < 1e-6 && sun.transforms.len() == 3);
    let up = sun.transform(0).matrix3;
    assert!(up.y_axis.y > 0.7 && (up.determinant() - 1.0).abs() < 1e-6);
}

/// Power over pi of the glowing triangles of an instance, as the sum of areas times radiance, and the mean normal.
fn power(scene: &LoadedScene, number: usize) -> (f64, Vec3) {
    let instance = &scene.instances[number];
    let mesh = &scene.meshes[instance.mesh];
    let (mut sum, mut normal) = (0.0, Vec3::ZERO);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| instance.transform(0).transform_point3(mesh.positions[v as usize]).as_dvec3());
        let cross = (b - a).cross(c - a);
        sum += 0.5 * cross.length() * f64::from(scene.materials[instance.material].emissive[0]);
        normal += cross.as_vec3();
    }
    (sum, normal.normalize_or_zero())
}

#[test]
fn lights_with_an_area_have_their_power_and_shine_ahead() {
    let found = loaded(json!([
        { "name": "ball", "kind": { "sphere": { "power": 10.0, "radius": 0.3 } }, "transform": { "scale": [2, 2, 2] } },
        { "name": "disk", "kind": { "disk": { "power": 20.0, "radius": 0.5 } }, "transform": { "rotation": [-90, 0, 0] } },
        { "name": "panel", "kind": { "rectangle": { "power": 30.0, "width": 2.0, "height": 0.5 } }, "transform": { "scale": [3, -1, 1] } },
    ]));
    assert!(found.lights.is_empty());
    assert_eq!(found.instances.iter().map(|i| i.object_id).collect::<Vec<_>>(), [1, 2, 3]);
    for (number, (watts, normal)) in [(10.0, None), (20.0, Some(Vec3::NEG_Y)), (30.0, Some(Vec3::NEG_Z))].into_iter().enumerate()
    {
        let (sum, mean) = power(&found, number);
        assert!((sum * std::f64::consts::PI / watts - 1.0).abs() < 1e-5, "{number}: {sum}");
        assert!(normal.is_none_or(|n| n.distance(mean) < 1e-5), "{number}: {mean}");
        let material = &found.materials[found.instances[number].material];
        assert!(!material.double_sided && material.surface.base_color == Vec3A::ZERO && material.surface.specular == 0.0);
    }
    // The ball has the radius of the sphere, but for the 0.3 % that its surface is longer.
    let ball = &found.meshes[found.instances[0].mesh];
    assert_eq!(ball.triangles.len(), 1280);
    assert!(ball.positions.iter().all(|p| (p.length() / 0.3 - 1.0).abs() < 0.005));
    let outside = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| ball.positions[v as usize]);
        (b - a).cross(c - a).dot(a) > 0.0
    };
    assert!(ball.triangles.iter().all(outside));
}

#[test]
fn broken_lights_are_refused_with_their_place() {
    for (light, expected) in [
        (json!({ "name": "", "kind": { "point": { "intensity": 1.0 } } }), "/lights/0/name: is empty"),
        (json!({ "name": "a", "kind": { "point": { "intensity": -1.0 } } }), "/lights/0/kind/point/intensity: -1 is outside"),
        (
            json!({ "name": "a", "kind": { "point": { "intensity": 1.0, "ies": "" } } }),
            "/lights/0/kind/point/ies: is an empty path",
        ),
        (
            json!({ "name": "a", "kind": { "spot": { "intensity": 1.0, "inner_angle": 45.0 } } }),
            "/lights/0/kind/spot/inner_angle: 45 is not from 0 to less than outer_angle, 45",
        ),
        (
            json!({ "name": "a", "kind": { "sphere": { "power": 1.0, "radius": 0.0 } } }),
            "/lights/0/kind/sphere/radius: 0 is outside",
        ),
        (
            json!({ "name": "a", "kind": { "directional": { "irradiance": 1.0 } }, "target": [0, 0, 0] }),
            "/lights/0/target: is the place of the light",
        ),
        (
            json!({ "name": "a", "kind": { "point": { "intensity": 1.0 } }, "color": [1, -1, 1] }),
            "/lights/0/color/1: -1 is outside",
        ),
    ] {
        let said = problems(json!([light]));
        assert!(said.contains(expected), "{said}");
    }
    let same = json!({ "name": "a", "kind": { "point": { "intensity": 1.0 } } });
    assert!(problems(json!([same.clone(), same])).contains("/lights/1/name: \"a\" is the name of /lights/0 too"));
}

fn with_lights(file: &mut Value, lights: Value, nodes: &[Value]) {
    file["extensionsUsed"] = json!(["KHR_lights_punctual"]);
    file["extensionsRequired"] = json!(["KHR_lights_punctual"]);
    file["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights } });
    let all = file["nodes"].as_array_mut().unwrap();
    let first = all.len();
    all.extend(nodes.iter().cloned());
    let roots = file["scenes"][0]["nodes"].as_array_mut().unwrap();
    roots.extend((first..first + nodes.len()).map(Value::from));
}

fn on_node(light: usize) -> Value {
    json!({ "KHR_lights_punctual": { "light": light } })
}

#[test]
fn lights_of_gltf_files_come_with_their_nodes() {
    let mut file = square();
    let half = std::f32::consts::FRAC_1_SQRT_2;
    with_lights(
        &mut file,
        json!([
            { "type": "point", "color": [1, 0.5, 0], "intensity": 8, "range": 3, "name": "bulb" },
            { "type": "spot", "intensity": 6, "spot": { "innerConeAngle": 0.1, "outerConeAngle": 0.4 } },
            { "type": "directional" },
        ]),
        &[
            // A quarter turn about x, ten times as large: the place grows, the light does not.
            json!({ "translation": [1, 2, 3], "extensions": on_node(0), "name": "lamp" }),
            json!({ "scale": [10, 10, 10], "rotation": [-half, 0, 0, half], "translation": [0, 1, 0], "extensions": on_node(1) }),
            json!({ "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 4,5,6,1], "extensions": on_node(2) }),
        ],
    );
    let file = File::new(&file);
    let mut scene = model_scene(&file.path(), None);
    scene.objects[0].transform.scale = [2.0; 3];
    scene.objects[0].transform.translation = [0.0, 0.0, 100.0];
    let found = load::load(&scene, &anywhere()).unwrap();
    let at = |k: usize| Vec3::from(found.lights[k].transform(0).translation) + found.origin.as_vec3();
    assert_eq!(
        found.lights.iter().map(|l| l.name.as_str()).collect::<Vec<_>>(),
        ["model/lamp", "model/light 1", "model/light 2"]
    );
    // At twice the distances, four times as bright: the model looks as it did.
    assert_eq!(found.lights[0].kind, PunctualKind::Point { intensity: [32.0, 16.0, 0.0] });
    assert_eq!(at(0), Vec3::new(2.0, 4.0, 106.0));
    let PunctualKind::Spot { intensity, inner, outer } = found.lights[1].kind else { panic!() };
    assert!((intensity[0] - 24.0).abs() < 1e-5 && (inner, outer) == (0.1, 0.4));
    assert!(ahead(&found.lights[1], 0).distance(Vec3::NEG_Y) < 1e-6 && at(1).distance(Vec3::new(0.0, 2.0, 100.0)) < 1e-4);
    assert_eq!(found.lights[2].kind, PunctualKind::Directional { irradiance: [1.0; 3] });
    assert_eq!(ahead(&found.lights[2], 0), Vec3::NEG_Z);
    let notes = found.report.notes.join("\n");
    assert!(notes.contains("1 lights have a range, which is ignored") && !notes.contains("is not read"), "{notes}");
}

#[test]
fn an_animation_moves_the_lights_of_a_file() {
    let mut file = common::gltf::document(&[
        (common::gltf::FLOAT, "VEC3", 4, false, common::gltf::bytes(&common::gltf::STRIP)),
        (common::gltf::FLOAT, "SCALAR", 2, false, common::gltf::bytes(&[0.0, 2.0])),
        (common::gltf::FLOAT, "VEC3", 2, false, common::gltf::bytes(&[0.0, 0.0, 0.0, 4.0, 0.0, 0.0])),
    ]);
    file["meshes"][0]["primitives"][0]["mode"] = json!(5);
    with_lights(&mut file, json!([{ "type": "point" }]), &[json!({ "extensions": on_node(0) })]);
    file["animations"] = json!([{
        "channels": [{ "sampler": 0, "target": { "node": 1, "path": "translation" } }],
        "samplers": [{ "input": 1, "output": 2 }],
    }]);
    let file = File::new(&file);
    let mut scene = Scene { frames: 3, ..model_scene(&file.path(), None) };
    scene.objects[0].animation = serde_json::from_value(json!({ "frames_per_second": 2.0 })).unwrap();
    let found = load::load(&scene, &anywhere()).unwrap();
    let places: Vec<f32> = (0..3).map(|frame| found.lights[0].transform(frame).translation.x).collect();
    assert_eq!(places, [0.0, 1.0, 2.0]);
}

#[test]
fn broken_lights_of_gltf_files_are_refused() {
    for (light, node, expected) in [
        (json!({ "type": "area" }), 0, "lights/0/type: is not \"point\", \"spot\" or \"directional\""),
        (json!({ "type": "point", "intensity": -1 }), 0, "lights/0/intensity: -1 is not a number from 0"),
        (json!({ "type": "point", "color": [1, 2] }), 0, "lights/0/color: is not three numbers"),
        (json!({ "type": "spot", "spot": { "outerConeAngle": 3 } }), 0, "lights/0/spot/outerConeAngle: 3 is not a number"),
        (json!({ "type": "spot", "spot": { "innerConeAngle": 0.9 } }), 0, "innerConeAngle: 0.9 is not less than the outer angle"),
        (json!({ "type": "point" }), 7, "/nodes/1/extensions/KHR_lights_punctual/light: names no light of the file"),
    ] {
        let mut file = square();
        with_lights(&mut file, json!([light]), &[json!({ "extensions": on_node(node) })]);
        let said = File::new(&file).error();
        assert!(said.contains(expected), "{said}");
    }
}

/// A profile with numbers in one list after a head.
fn ies(vertical: &[f32], horizontal: &[f32], candela: &[f32]) -> String {
    let list = |numbers: &[f32]| numbers.iter().map(f32::to_string).collect::<Vec<_>>().join(" ");
    format!(
        "IESNA:LM-63-2002\r\n[TEST] made by hand\r\n[MANUFAC] nobody\r\nTILT=NONE\r\n1 1000 1.0 {} {} 1 2 0 0 0\r\n1.0 1.0 50\r\n{}\r\n{}\r\n{}\r\n",
        vertical.len(),
        horizontal.len(),
        list(vertical),
        list(horizontal),
        list(candela)
    )
}

/// The direction of a vertical and a horizontal angle in degrees, in a light's space.
fn direction(vertical: f32, horizontal: f32) -> Vec3A {
    let (sin, cos) = vertical.to_radians().sin_cos();
    let (y, x) = horizontal.to_radians().sin_cos();
    Vec3A::new(sin * x, sin * y, -cos)
}

#[test]
fn profiles_are_read_as_computed_by_hand() {
    let near = |profile: &Profile, [vertical, horizontal]: [f32; 2], expected: f32| {
        let value = profile.value(direction(vertical, horizontal));
        assert!((value - expected).abs() < 1e-4, "{vertical} {horizontal}: {value}, not {expected}");
    };
    // One plane for all: 400 cd below, 200 at 45 degrees, nothing at the horizon and above.
    let axial = Profile::parse(&ies(&[0.0, 45.0, 90.0], &[0.0], &[400.0, 200.0, 0.0])).unwrap();
    for horizontal in [0.0, 77.0, 200.0, 359.0] {
        for (vertical, value) in [(0.0, 1.0), (22.5, 0.75), (45.0, 0.5), (67.5, 0.25), (90.0, 0.0), (91.0, 0.0), (180.0, 0.0)] {
            near(&axial, [vertical, horizontal], value);
        }
    }
    // A quarter, mirrored at both planes: 100 cd along x, 50 at 45 degrees, 20 along y, at the vertical angles 0 to 180.
    let candela = [100.0, 100.0, 50.0, 50.0, 20.0, 20.0];
    let quarter = Profile::parse(&ies(&[0.0, 180.0], &[0.0, 45.0, 90.0], &candela)).unwrap();
    for (horizontal, value) in
        [(0.0, 1.0), (22.5, 0.75), (45.0, 0.5), (90.0, 0.2), (135.0, 0.5), (180.0, 1.0), (225.0, 0.5), (270.0, 0.2)]
    {
        near(&quarter, [60.0, horizontal], value);
    }
    // A half, mirrored at the plane of x: brighter along +y than along -y would show an error.
    let half = Profile::parse(&ies(&[0.0, 90.0], &[0.0, 90.0, 180.0], &[10.0, 10.0, 5.0, 5.0, 1.0, 1.0])).unwrap();
    for (horizontal, value) in [(0.0, 1.0), (90.0, 0.5), (180.0, 0.1), (270.0, 0.5), (300.0, 0.5 + 0.5 / 3.0)] {
        near(&half, [30.0, horizontal], value);
    }
    // The half of the planes 90 to 270, mirrored at the plane of y.
    let side = Profile::parse(&ies(&[0.0, 90.0], &[90.0, 180.0, 270.0], &[10.0, 10.0, 5.0, 5.0, 1.0, 1.0])).unwrap();
    for (horizontal, value) in [(90.0, 1.0), (180.0, 0.5), (270.0, 0.1), (0.0, 0.5), (45.0, 0.75), (315.0, 0.3)] {
        near(&side, [30.0, horizontal], value);
    }
    // All planes.
    let whole = Profile::parse(&ies(
        &[0.0, 90.0],
        &[0.0, 90.0, 180.0, 270.0, 360.0],
        &[4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 1.0, 1.0, 4.0, 4.0],
    ));
    for (horizontal, value) in [(0.0, 1.0), (90.0, 0.75), (180.0, 0.5), (270.0, 0.25), (315.0, 0.625)] {
        near(whole.as_ref().unwrap(), [30.0, horizontal], value);
    }
    // A table of tilts is passed over, and numbers may be separated by commas.
    let tilted = ies(&[0.0, 90.0], &[0.0], &[2.0, 1.0]).replace("TILT=NONE", "TILT=INCLUDE\r\n1\r\n2\r\n0,90\r\n1.0, 0.9");
    near(&Profile::parse(&tilted).unwrap(), [45.0, 0.0], 0.75);
}

#[test]
fn hostile_profiles_are_refused() {
    let good = ies(&[0.0, 90.0], &[0.0], &[2.0, 1.0]);
    let counts = "1 1000 1.0 2 1 1 2 0 0 0";
    for (text, expected) in [
        (String::new(), "there is no line TILT="),
        ("TILT=NONE".into(), "the file ends before the number of lamps"),
        (good.replace("TILT=NONE", "TILT=other.tlt"), "only NONE and INCLUDE are read"),
        (good.replace(counts, "1 1000 1.0 99999999999 1 1 2 0 0 0"), "is not a whole number from 1 to 16384"),
        (good.replace(counts, "1 1000 1.0 16000 16000 1 2 0 0 0"), "the vertical angles do not rise"),
        (good.replace(counts, "1 1000 1.0 2 -1 1 2 0 0 0"), "the number of horizontal angles: -1 is not"),
        (good.replace(counts, "1 1000 1.0 2 1 3 2 0 0 0"), "only type C"),
        (good.replace("2 1\r\n", "2 NaN\r\n"), "\"NaN\" is not a number"),
        (good.replace("2 1\r\n", "2\r\n"), "the file ends before the candela values"),
        (good.replace("2 1\r\n", "2 -1\r\n"), "the candela value -1 is negative"),
        (good.replace("2 1\r\n", "0 0\r\n"), "all candela values are 0"),
        (ies(&[0.0, 200.0], &[0.0], &[2.0, 1.0]), "vertical angles leave 0..=180"),
        (ies(&[90.0, 0.0], &[0.0], &[2.0, 1.0]), "the vertical angles do not rise at 0"),
        (ies(&[0.0, 90.0], &[0.0, 120.0], &[2.0, 1.0, 1.0, 1.0]), "horizontal angles from 0 to 120 have no symmetry"),
    ] {
        let said = Profile::parse(&text).expect_err("must be refused");
        assert!(said.contains(expected), "{said}, not {expected}");
    }
    // Every beginning of a file, and every file with one byte changed, is read or refused.
    for end in 0..good.len() {
        let _ = Profile::parse(&good[..end]);
        for byte in [b'-', b'e', b'9', b' ', b'.'] {
            let mut changed = good.clone().into_bytes();
            changed[end] = byte;
            let _ = Profile::parse(&String::from_utf8_lossy(&changed));
        }
    }
}

#[test]
fn a_profile_is_read_once_and_belongs_to_its_lights() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lamp.ies");
    std::fs::write(&path, ies(&[0.0, 90.0], &[0.0], &[2.0, 1.0])).unwrap();
    let point =
        |name: &str, file: &std::path::Path| json!({ "name": name, "kind": { "point": { "intensity": 1.0, "ies": file } } });
    let found = loaded(json!([point("a", &path), point("b", &path)]));
    let [a, b] = [0, 1].map(|k| found.lights[k].profile.clone().expect("a profile"));
    assert!(std::sync::Arc::ptr_eq(&a, &b));
    let missing = load::load(&scene(json!([point("a", &folder.path().join("none.ies"))])), &anywhere());
    let said = missing.expect_err("must be refused").to_string();
    assert!(said.starts_with("/lights/0 (a): ") && said.contains("none.ies"), "{said}");
    std::fs::write(&path, "nothing").unwrap();
    let broken = load::load(&scene(json!([point("a", &path)])), &anywhere()).expect_err("must be refused").to_string();
    assert!(broken.contains("lamp.ies: there is no line TILT="), "{broken}");
}
