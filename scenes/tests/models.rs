//! Model files against an independent reader (trimesh; `references/make_models.py`), and hostile files.

mod common;

use common::anywhere;
use common::{asset, assets_below, load_model, model_scene};
use glam::DVec3;
use renderflow_scenes::loaded::Encoding;
use renderflow_scenes::mipmap::{self, Texels};
use renderflow_scenes::{LoadedScene, load};

/// World-space triangles, in double precision.
fn triangles(scene: &LoadedScene) -> Vec<[DVec3; 3]> {
    let of = |instance: &renderflow_scenes::Instance| {
        let mesh = &scene.meshes[instance.mesh];
        let to_world = instance.transform(0);
        let corner = |i: u32| to_world.transform_point3a(mesh.positions[i as usize].into()).as_dvec3();
        mesh.triangles.iter().map(|t| t.map(corner)).collect::<Vec<_>>()
    };
    scene.instances.iter().flat_map(of).collect()
}

#[derive(serde::Deserialize)]
struct Expected {
    triangles: usize,
    low: [f64; 3],
    high: [f64; 3],
    area: f64,
    signed_volume: f64,
}

#[test]
fn models_equal_an_independent_reader() {
    let text = include_str!("references/models.json");
    let all: std::collections::BTreeMap<String, Expected> = serde_json::from_str(text).unwrap();
    for (name, expected) in &all {
        let Some(path) = asset(name) else { return };
        let scene = load_model(&path).unwrap_or_else(|e| panic!("{e}"));
        let found = triangles(&scene);
        assert_eq!(found.len(), expected.triangles, "{name}: triangles ({} dropped)", scene.report.triangles.dropped());
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (mut area, mut volume) = (0.0, 0.0);
        for [a, b, c] in found {
            (low, high) = (low.min(a).min(b).min(c), high.max(a).max(b).max(c));
            area += 0.5 * (b - a).cross(c - a).length();
            volume += a.dot(b.cross(c)) / 6.0;
        }
        let size = (high - low).length();
        assert!((low - DVec3::from(expected.low)).length() < 1e-5 * size, "{name}: {low} but {:?}", expected.low);
        assert!((high - DVec3::from(expected.high)).length() < 1e-5 * size, "{name}: {high} but {:?}", expected.high);
        assert!((area - expected.area).abs() < 1e-4 * expected.area, "{name}: area {area} but {}", expected.area);
        // The sign is the winding's: a mirrored or turned triangle would show here.
        let tolerance = 1e-4 * expected.signed_volume.abs() + 1e-5 * area * size;
        assert!((volume - expected.signed_volume).abs() < tolerance, "{name}: volume {volume} but {}", expected.signed_volume);
    }
}

/// trimesh does not read sparse accessors; such files state their own bounds (glTF 2.0: min and max include sparse values).
#[test]
fn sparse_accessors_meet_the_bounds_in_the_file() {
    let Some(path) = asset("gltf/pbr/SimpleSparseAccessor/SimpleSparseAccessor.gltf") else { return };
    let text = std::fs::read_to_string(&path).unwrap();
    let stated: serde_json::Value = serde_json::from_str(&text).unwrap();
    let accessor = stated["accessors"].as_array().unwrap().iter().find(|a| a.get("sparse").is_some()).unwrap();
    assert_eq!(accessor["max"], serde_json::json!([6.0, 4.0, 0.0]));
    let found = triangles(&load_model(&path).unwrap());
    let top = found.iter().flatten().fold(DVec3::NEG_INFINITY, |h, &p| h.max(p));
    assert_eq!(top, DVec3::new(6.0, 4.0, 0.0));
}

/// Negative indices, quads, materials: the measured Cornell box (Cornell University, 1998) is 556 x 548.8 x 559.2.
#[test]
fn cornell_box_has_its_published_size() {
    let Some(path) = asset("obj/edge/tobj/cornell_box.obj") else { return };
    let found = triangles(&load_model(&path).unwrap());
    let top = found.iter().flatten().fold(DVec3::NEG_INFINITY, |h, &p| h.max(p));
    assert!((top - DVec3::new(556.0, 548.8, 559.2)).length() < 1e-3, "{top}");
    assert_eq!(found.len(), 36);
    // The textures of its materials do not come with it.
    let error = load::load(&model_scene(&path, None), &anywhere()).unwrap_err().to_string();
    assert!(error.starts_with("/objects/0 (model): material \"red\": cannot use texture "), "{error}");
    assert!(error.contains("this diffuse texture has spaces.jpg: cannot read: "), "{error}");
}

#[test]
fn real_materials_arrive_whole() {
    let Some(path) = asset("gltf/pbr/Suzanne/Suzanne.gltf") else { return };
    let scene = load::load(&model_scene(&path, None), &anywhere()).unwrap();
    let material = &scene.materials[scene.instances[0].material];
    let color = material.base_color_texture.as_ref().expect("a base colour texture");
    assert!(material.metallic_roughness_texture.is_some() && material.normal_texture.is_none());
    let image = &scene.textures[color.texture].levels[0];
    assert_eq!((image.width, image.height), (1024, 1024));
    let Texels::Bytes(texels) = &image.texels else { panic!("8 bits a channel") };
    // Pillow 13.0.0: mean of the image's red, green and blue after the sRGB curve.
    let mut mean = [0.0_f64; 3];
    let linear = |byte: u8| f64::from(mipmap::decode(Encoding::Srgb, f32::from(byte) / 255.0));
    texels.iter().for_each(|p| (0..3).for_each(|c| mean[c] += linear(p[c]) / texels.len() as f64));
    for (found, expected) in mean.iter().zip(SUZANNE_MEAN) {
        assert!((found - expected).abs() < 1e-5, "{mean:?}");
    }
}

const SUZANNE_MEAN: [f64; 3] = [0.096_819_889, 0.094_175_436, 0.106_299_618];

/// Every file of the validator's and other projects' edge cases: an answer or an error with the file's name, never a panic.
#[test]
fn malformed_files_are_answered() {
    let mut counts = [0, 0];
    for folder in ["gltf/malformed", "gltf/edge", "obj/edge"] {
        for path in assets_below(folder, &["gltf", "glb", "obj"]) {
            let result = load::load(&model_scene(&path, None), &anywhere());
            counts[usize::from(result.is_err())] += 1;
            match result {
                Ok(scene) => check_invariants(&scene),
                Err(e) => assert!(e.to_string().contains(path.file_name().unwrap().to_str().unwrap()) || names_a_file(&e), "{e}"),
            }
        }
    }
    println!("{} files loaded, {} refused", counts[0], counts[1]);
}

/// Errors about images name the image instead.
fn names_a_file(error: &renderflow_scenes::Error) -> bool {
    error.to_string().contains("cannot use texture")
}

/// What a renderer relies on.
fn check_invariants(scene: &LoadedScene) {
    for mesh in &scene.meshes {
        let n = mesh.positions.len();
        assert!(mesh.positions.iter().all(|p| p.is_finite()));
        assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < n));
        assert!(mesh.normals.is_empty() || mesh.normals.len() == n);
        assert!(mesh.uvs.is_empty() || mesh.uvs.len() == n);
        assert!(mesh.tangents.is_empty() || mesh.tangents.len() == n);
        assert!(mesh.normals.iter().all(|v| (v.length() - 1.0).abs() < 1e-4));
        assert!(mesh.tangents.iter().all(|t| (t.truncate().length() - 1.0).abs() < 1e-4 && t.w.abs() == 1.0));
    }
    for instance in &scene.instances {
        assert!(instance.mesh < scene.meshes.len() && instance.material < scene.materials.len());
        assert!(instance.transforms.iter().all(|t| t.is_finite() && t.matrix3.as_dmat3().inverse().as_mat3().is_finite()));
        assert!(!instance.name.is_empty() && instance.object_id > 0);
    }
    let mut names: Vec<_> = scene.instances.iter().map(|i| &i.name).collect();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), scene.instances.len(), "instance names are unique");
    for material in &scene.materials {
        let slots = [&material.base_color_texture, &material.metallic_roughness_texture, &material.emissive_texture];
        assert!(slots.into_iter().flatten().all(|s| s.texture < scene.textures.len()));
    }
}

/// Valid files with bytes changed or cut off: an answer or an error, without a panic and without a huge allocation.
#[test]
fn damaged_files_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for name in [
        "gltf/pbr/Box/Box.glb",
        "gltf/edge/gltf-rs/box_sparse.glb",
        "gltf/edge/gltf-transform/TwoCubes.glb",
        "obj/edge/tobj/cornell_box.obj",
        "obj/edge/tinyobjloader/refl.obj",
    ] {
        let Some(path) = asset(name) else { return };
        let bytes = std::fs::read(&path).unwrap();
        let copy = folder.path().join(path.file_name().unwrap());
        for round in 0..300 {
            let mut damaged = bytes.clone();
            if round % 5 == 0 {
                damaged.truncate(random(bytes.len()));
            } else {
                for _ in 0..=random(4) {
                    let at = random(bytes.len());
                    // Digits become other digits, so that the text stays readable and the numbers go wrong.
                    damaged[at] = if bytes[at].is_ascii_digit() { b'0' + random(10) as u8 } else { random(256) as u8 };
                }
            }
            std::fs::write(&copy, &damaged).unwrap();
            if let Ok(scene) = load_model(&copy) {
                check_invariants(&scene);
            }
        }
    }
}
