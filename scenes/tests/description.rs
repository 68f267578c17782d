//! Scene files: what is refused and how it is said, the schema, the hash, cameras and motion.

mod common;

use common::anywhere;
use common::{empty_scene, grey};
use glam::{DVec3, Vec2, Vec3A};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{CameraPath, Geometry, Motion, Object, Pose, Transform};
use renderflow_scenes::loaded::{AlphaMask, Wrap};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Error, Principled, Scene, load, schema};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).into()
}

/// Regenerate with `RENDERFLOW_UPDATE=1 cargo test --release -p renderflow-scenes --test description schema`.
#[test]
fn schema_file_is_current() {
    let path = folder().join("schema.json");
    let current = serde_json::to_string_pretty(&schema::json_schema()).unwrap() + "\n";
    if std::env::var_os("RENDERFLOW_UPDATE").is_some() {
        std::fs::write(&path, &current).unwrap();
    }
    assert!(std::fs::read_to_string(&path).unwrap() == current, "scenes/schema.json is not what the types say");
}

#[test]
fn examples_load() {
    let mut count = 0;
    for entry in std::fs::read_dir(folder().join("examples")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "json") {
            continue;
        }
        let scene = Scene::read(&path).unwrap_or_else(|e| panic!("{e}"));
        let loaded = load::load(&scene, &Reach::of(&path)).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(loaded.cameras.len(), scene.frames as usize);
        assert_eq!(loaded.instances.len() + loaded.lights.len(), scene.objects.len() + scene.lights.len());
        assert_eq!(loaded.report.triangles.dropped(), 0, "{}: {:?}", path.display(), loaded.report);
        assert_eq!(loaded.hash, scene.hash());
        count += 1;
    }
    assert!(count >= 4);
}

/// What the example of materials says arrives, and none of its parameters is forgotten in it.
#[test]
fn materials_of_the_example_arrive() {
    let path = folder().join("examples/materials.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let schema = schema::json_schema();
    for name in schema["$defs"]["Material"]["properties"].as_object().unwrap().keys() {
        assert!(text.contains(&format!("\"{name}\"")), "the example lacks {name}");
    }
    let scene = Scene::read(&path).unwrap();
    let loaded = load::load(&scene, &Reach::of(&path)).unwrap();
    assert_eq!((loaded.report.alpha_masked, loaded.report.blended, loaded.report.notes.len()), (1, 1, 0), "{:?}", loaded.report);
    let find = |name: &str| loaded.materials.iter().find(|m| m.name == name).unwrap();
    assert_eq!((find("lacquer").surface.clearcoat, find("lacquer").surface.clearcoat_gloss), (1.0, 0.95));
    assert_eq!((find("velvet").surface.sheen, find("velvet").surface.sheen_tint), (1.0, 0.6));
    assert_eq!(find("brushed steel").surface.anisotropic, 0.9);
    assert_eq!(find("tinted plastic").surface.specular_tint, 1.0);
    assert_eq!(find("wax").surface.subsurface, 1.0);
    assert_eq!((find("lamp").emissive, find("lamp").double_sided), ([4.0, 2.6, 1.2], false));
    let plain = find("floor");
    assert_eq!(
        plain,
        &renderflow_scenes::Material {
            name: "floor".into(),
            surface: Principled { base_color: Vec3A::splat(0.4), roughness: 0.8, specular: 0.2, ..Default::default() },
            ..Default::default()
        }
    );
    let glass = find("bottle glass");
    assert_eq!((glass.surface.transmission, glass.thin_walled, glass.opacity), (1.0, false, None));
    assert!(glass.absorption.iter().zip([0.3_f32, 0.75, 0.45]).all(|(a, color)| (a + 2.0 * color.ln()).abs() < 1e-5));
    assert!(find("stained pane").thin_walled);
    assert_eq!(find("gauze").opacity, Some(0.4));
    let sheet = find("punched sheet");
    assert_eq!(sheet.alpha_mask, Some(AlphaMask { cutoff: 0.5, factor: 1.0 }));
    // One decoding for colour and emission, one for data, one for normals; and three maps of the pattern.
    assert_eq!(loaded.textures.len(), 3 + 3);
    assert_eq!(sheet.base_color_texture, sheet.emissive_texture);
    assert!(loaded.textures.iter().all(|t| t.wrap == [Wrap::Mirror; 2]));
    // KHR_texture_transform's own matrices, written out: translation * rotation * scale of a column vector (u, v, 1).
    let uv = sheet.normal_texture.as_ref().unwrap().0.uv_transform.transform_point2(Vec2::new(0.3, 0.1));
    let (sin, cos) = 30_f32.to_radians().sin_cos();
    let (x, y) = (4.0 * 0.3, 4.0 * 0.1);
    assert!(uv.distance(Vec2::new(0.25 + cos * x + sin * y, -sin * x + cos * y)) < 1e-6, "{uv}");
    // Stretched highlights and normal maps need tangents; nothing else does.
    for instance in &loaded.instances {
        let material = &loaded.materials[instance.material];
        let wants = material.surface.anisotropic > 0.0 || material.normal_texture.is_some();
        let shared = loaded.instances.iter().any(|i| i.mesh == instance.mesh && i.material != instance.material);
        assert!(loaded.meshes[instance.mesh].tangents.is_empty() != wants || shared, "{}", instance.name);
    }
}

#[test]
fn new_parameters_have_ranges_and_are_left_out_at_their_defaults() {
    let material = serde_json::json!({
        "name": "a", "specular_tint": 1.1, "anisotropic": -0.1, "sheen": 2, "sheen_tint": -1, "clearcoat": 1.5, "clearcoat_gloss": -1,
        "subsurface": 3, "emissive": [-1, 2e6, 0], "alpha_cutoff": 1.5, "emissive_texture": " ",
        "texture_transform": { "scale": [1e7, 1], "offset": [0, -1e7] }
    });
    let mut scene = empty_scene();
    scene.materials = vec![serde_json::from_value(material).unwrap()];
    scene.materials[0].texture_transform.rotation = f32::NAN;
    let Err(Error::Invalid { problems, .. }) = scene.validate() else { panic!("must be refused") };
    let expected = [
        "specular_tint",
        "anisotropic",
        "sheen",
        "sheen_tint",
        "clearcoat",
        "clearcoat_gloss",
        "subsurface",
        "alpha_cutoff",
        "emissive/0",
        "emissive/1",
        "texture_transform/offset/1",
        "texture_transform/rotation",
        "texture_transform/scale/0",
        "emissive_texture",
    ];
    let found: Vec<_> = problems.iter().map(|p| p.pointer.trim_start_matches("/materials/0/")).collect();
    assert_eq!(found, expected);
    // The text of the first version.
    let plain = serde_json::to_string(&grey("a")).unwrap();
    assert_eq!(plain, r#"{"name":"a","base_color":[0.8,0.8,0.8],"metallic":0.0,"roughness":0.5,"specular":0.5}"#);
    let full = Scene::read(&folder().join("examples/materials.json")).unwrap();
    assert_eq!(Scene::from_json(Path::new("x"), &full.canonical_json()).unwrap(), full);
}

#[test]
fn every_violation_is_reported_with_its_pointer() {
    let text = r#"{
        "version": 2, "name": " ", "resolution": [0, 20000], "frames": 0,
        "camera": { "type": "orbit", "target": [0, 1e10, 0], "distance": 0, "elevation": 90, "azimuth": 0,
                    "degrees_per_frame": 3.6, "vertical_fov": 180 },
        "environment": { "source": { "builtin": "nowhere" }, "intensity": -1 },
        "materials": [ { "name": "a", "roughness": 1.4 }, { "name": "a", "base_color": [0, 2, 0], "normal_texture": "" } ],
        "objects": [
            { "name": "x", "geometry": { "file": "chair.fbx" }, "material": "b" },
            { "name": "x", "geometry": { "shape": { "family": "sphere", "radius": -1 } }, "transform": { "scale": [1, 0, 1] } }
        ]
    }"#;
    let error = Scene::from_json(Path::new("scene.json"), text).unwrap_err();
    let names = renderflow_scenes::sky::names().join(", ");
    let expected = [
        "/version: 2 is not a version this program reads (it reads 1)",
        "/name: is empty",
        "/resolution/0: 0 is outside 1..=16384",
        "/resolution/1: 20000 is outside 1..=16384",
        "/frames: 0 is outside 1..=100000",
        "/camera/target/1: 10000000000 is outside -1000000000..=1000000000",
        "/camera/distance: 0 is outside 0.000000001..=1000000000",
        "/camera/elevation: 90 is outside -89..=89",
        "/camera/vertical_fov: 180 is outside 1..=170",
        "/environment/intensity: -1 is outside 0..=1000000000",
        &format!("/environment/source/builtin: no environment is named \"nowhere\"; there are {names}"),
        "/materials/1/name: \"a\" is the name of /materials/0 too",
        "/materials/0/roughness: 1.4 is outside 0..=1",
        "/materials/1/base_color/1: 2 is outside 0..=1",
        "/materials/1/normal_texture: is an empty path",
        "/objects/1/name: \"x\" is the name of /objects/0 too",
        "/objects/0/geometry/file: \"chair.fbx\" is not a .gltf, .glb, .obj or .ply file",
        "/objects/0/material: no material is named \"b\"",
        "/objects/1/geometry/shape/radius: -1 is outside 0.01..=1000",
        "/objects/1/transform/scale/1: 0 is outside 0.000000001..=1000000000 in size",
    ]
    .map(|line| format!("scene.json {line}"));
    assert_eq!(error.to_string().lines().collect::<Vec<_>>(), expected.iter().map(String::as_str).collect::<Vec<_>>());
}

#[test]
fn broken_json_names_line_and_column() {
    let read = |text| Scene::from_json(Path::new("a/scene.json"), text).unwrap_err().to_string();
    assert_eq!(read("{\n  \"version\": 1,\n  \"nam\": \"x\"\n}").split(": unknown").next(), Some("a/scene.json:3:7"));
    assert!(
        read("{\"version\": \"one\"}")
            .starts_with("a/scene.json:1:17: found the string \"one\" where a whole number from 0 to 4294967295 is needed")
    );
    assert!(read("{").starts_with("a/scene.json:1:1: the text ends inside an object"));
    let missing = Scene::read(Path::new("nowhere/scene.json")).unwrap_err().to_string();
    assert!(missing.starts_with("nowhere/scene.json: cannot read: "), "{missing}");
}

#[test]
fn values_that_are_not_finite_are_refused_in_built_scenes() {
    let mut scene = empty_scene();
    scene.environment.rotation = f32::NAN;
    scene.environment.source = renderflow_scenes::description::EnvironmentSource::Constant([0.0, f32::INFINITY, 1.0]);
    scene.materials.push(renderflow_scenes::description::Material { metallic: f32::NAN, ..grey("a") });
    let Err(Error::Invalid { problems, file: None }) = scene.validate() else { panic!("must be refused") };
    let pointers: Vec<_> = problems.iter().map(|p| p.pointer.as_str()).collect();
    assert_eq!(pointers, ["/environment/rotation", "/environment/source/constant/1", "/materials/0/metallic"]);
    assert!(load::load(&scene, &anywhere()).is_err());
}

#[test]
fn canonical_json_reads_back_equal() {
    let mut state = 12345_u32;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        // Any finite number of the size that scenes hold.
        f32::from_bits((state >> 9) | 0x3f80_0000) - 1.5
    };
    for _ in 0..500 {
        let mut scene = empty_scene();
        let mut material = grey("m");
        material.base_color = std::array::from_fn(|_| random().abs());
        scene.materials.push(material);
        scene.objects.push(Object {
            name: "o".into(),
            geometry: Geometry::Shape(Shape::Sphere { radius: 1.0 }),
            material: Some("m".into()),
            transform: Transform { translation: std::array::from_fn(|_| f64::from(random()) * 1e3), ..Default::default() },
            motion: None,
            animation: None,
        });
        let text = scene.canonical_json();
        let back = Scene::from_json(Path::new("memory"), &text).unwrap();
        assert_eq!(back, scene);
        assert_eq!(back.hash(), scene.hash());
        assert_eq!(scene.hash().len(), 64);
    }
    // What defaults say and what is written out is one scene.
    let terse = std::fs::read_to_string(folder().join("examples/single_sphere.json")).unwrap();
    let scene = Scene::from_json(Path::new("x"), &terse).unwrap();
    let spelled: Scene = serde_json::from_str(&scene.canonical_json()).unwrap();
    assert_eq!(spelled.hash(), scene.hash());
}

#[test]
fn orbits_turn_and_keep_their_target_in_the_middle() {
    let scene = empty_scene();
    let at = |frame| scene.camera(frame);
    // Azimuth 0 is the +Z side, and the orbit closes after 100 frames of 3.6 degrees.
    let first = at(0).position();
    assert!((first - Vec3A::new(0.0, 3.0 * 20_f32.to_radians().sin(), 3.0 * 20_f32.to_radians().cos())).length() < 1e-6);
    // A quarter turn about +Y takes +Z to +X.
    assert!(at(25).position().x > 2.8 && at(25).position().z.abs() < 1e-5);
    assert!((at(100).position() - first).length() < 1e-5);
    // After 999 turns only the rounding of 3.6 to single precision is left: 0.0095 degrees.
    assert!((at(99_900).position() - first).length() < 6e-4);
    for frame in [0, 13, 57] {
        let (pixel, depth) = at(frame).project(Vec3A::ZERO).unwrap();
        assert!(pixel.distance(Vec2::new(4.0, 4.0)) < 1e-4 && (depth - 3.0).abs() < 1e-5);
    }
}

#[test]
fn the_last_pose_is_held() {
    let pose = |x| Pose { eye: [x, 0.0, 5.0], target: [x, 0.0, 0.0], up: [0.0, 1.0, 0.0] };
    let scene = Scene { camera: CameraPath::Poses { poses: vec![pose(0.0), pose(1.0)], vertical_fov: 40.0 }, ..empty_scene() };
    assert_eq!([0, 1, 2, 9].map(|f| scene.camera(f).position().x), [0.0, 1.0, 1.0, 1.0]);
}

#[test]
fn placement_scales_then_turns_then_moves() {
    let object = Object {
        name: "o".into(),
        geometry: Geometry::Shape(Shape::Sphere { radius: 1.0 }),
        material: None,
        transform: Transform { translation: [10.0, 0.0, 0.0], rotation: [90.0, 0.0, 180.0], scale: [1.0, 2.0, 1.0] },
        motion: Some(Motion { translation: [0.0, 0.5, 0.0], spin: 90.0, ..Motion::default() }),
        animation: None,
    };
    let close = |frame, p: [f64; 3], q: [f64; 3]| {
        let found = object.transform_at(frame).transform_point3(p.into());
        assert!((found - DVec3::from(q)).length() < 1e-5, "frame {frame}: {p:?} -> {found}, not {q:?}");
    };
    // +y doubled, turned about x to +z, which a turn about z leaves alone.
    close(0, [0.0, 1.0, 0.0], [10.0, 0.0, 2.0]);
    // +x is left alone by the turn about x, then turned about z to -x.
    close(0, [1.0, 0.0, 0.0], [9.0, 0.0, 0.0]);
    // After two frames: half a turn about the object's own +y, and a metre up.
    close(2, [1.0, 0.0, 0.0], [11.0, 1.0, 0.0]);
    close(2, [0.0, 1.0, 0.0], [10.0, 1.0, 2.0]);
    assert!(object.moves());
}

/// A scene of one ball with a material that changes and a motion of every kind.
fn lively() -> serde_json::Value {
    serde_json::json!({
        "version": 1, "name": "lively", "resolution": [8, 8], "frames": 5,
        "camera": {"type": "poses", "poses": [{"eye": [0, 1, 5], "target": [0, 0, 0]}], "vertical_fov": 40},
        "environment": {"source": {"constant": [1, 1, 1]}},
        "materials": [{"name": "paint", "base_color": [0.2, 0.4, 0.6], "metallic": 0, "roughness": 1,
                       "change": {"metallic": 1, "roughness": 0.5}}],
        "objects": [{"name": "ball", "geometry": {"shape": {"family": "sphere", "radius": 0.5}}, "material": "paint",
                     "motion": {"bounce": {"height": 2, "frames": 4}, "circle": {"center": [1, 0], "degrees": 90}}}]
    })
}

#[test]
fn changes_and_motions_are_read_checked_and_loaded() {
    let read = |value: serde_json::Value| Scene::from_json(Path::new("lively.json"), &value.to_string());
    let scene = read(lively()).unwrap();
    assert_eq!(read(serde_json::from_str(&scene.canonical_json()).unwrap()).unwrap(), scene);
    let loaded = load::load(&scene, &anywhere()).unwrap();
    let middle = loaded.materials[0].at(2.0, loaded.cameras.len()).surface;
    assert_eq!((middle.base_color.to_array(), middle.metallic, middle.roughness), ([0.2, 0.4, 0.6], 0.5, 0.75));
    // Half way up its arc of four frames, and a quarter, half and whole turn about (1, 0) from (0, 0): +z runs before -x does.
    let expected = [[0.0, 0.0, 0.0], [1.0, 1.5, 1.0], [2.0, 2.0, 0.0], [1.0, 1.5, -1.0], [0.0, 0.0, 0.0]];
    for (frame, expected) in expected.into_iter().enumerate() {
        let place = scene.objects[0].transform_at(frame as u32).translation;
        assert!(place.distance(expected.into()) < 1e-9, "frame {frame}: {place}");
    }
    for (place, value, says) in [
        ("/materials/0/change/metallic", serde_json::json!(1.5), "/materials/0/change/metallic: 1.5 is outside 0..=1"),
        ("/materials/0/change/base_color", serde_json::json!([0, 2, 0]), "/materials/0/change/base_color/1"),
        ("/objects/0/motion/bounce/frames", serde_json::json!(0.5), "/objects/0/motion/bounce/frames: 0.5 is outside 1..="),
        ("/objects/0/motion/circle/center", serde_json::json!([0, 1e9]), "/objects/0/motion/circle/center/1"),
    ] {
        let mut broken = lively();
        let (parent, field) = place.rsplit_once('/').unwrap();
        broken.pointer_mut(parent).unwrap()[field] = value;
        let message = read(broken).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
}
