//! Patterns: their maps, how scenes say them and what loading makes of them.

mod common;

use common::anywhere;
use common::empty_scene;
use renderflow_scenes::description::{Geometry, Material, Object, TextureTransform, TextureWrap};
use renderflow_scenes::pattern::{self, Map, MapSet, Pattern};
use renderflow_scenes::procedural::materials::{self, MaterialKnobs};
use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Error, LoadedScene, Scene, load};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

fn all() -> impl Iterator<Item = Pattern> {
    Pattern::KINDS.iter().map(|kind| Pattern::named(kind).unwrap())
}

/// Materials for objects, floors and walls in turn.
fn drawn(count: u64) -> Vec<Material> {
    let root = Seed::root(77);
    let draw = |index: u64| {
        let (mut rng, knobs) = (root.child("material", index).rng(), MaterialKnobs { textured: 0.7, ..MaterialKnobs::default() });
        let name = format!("m{index}");
        match index % 4 {
            0 => materials::floor(&mut rng, &name, &knobs),
            1 => materials::wall(&mut rng, &name, &knobs),
            _ => materials::object(&mut rng, &name, &knobs),
        }
    };
    (0..count).map(draw).collect()
}

/// A map as numbers 0..=1, three a texel; what is constant as one texel, again and again.
fn channels(map: &Option<Map>, size: usize) -> Vec<[f64; 3]> {
    match map.as_ref().unwrap() {
        Map::Constant(value) => vec![value.map(f64::from); size * size],
        Map::Bytes(texels) => texels.iter().map(|t| [t[0], t[1], t[2]].map(|v| f64::from(v) / 255.0)).collect(),
        Map::Words(texels) => texels.iter().map(|t| [t[0], t[1], t[2]].map(|v| f64::from(v) / 65535.0)).collect(),
    }
}

/// Mean difference of two rows (or columns) of texels that lie side by side, by the number of the first; the last lies beside the
/// first.
fn steps(texels: &[[f64; 3]], n: usize, columns: bool) -> Vec<f64> {
    let at = |line: usize, i: usize| texels[if columns { i * n + line % n } else { line % n * n + i }];
    let apart = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>();
    (0..n).map(|line| (0..n).map(|i| apart(at(line, i), at(line + 1, i))).sum::<f64>() / n as f64).collect()
}

/// No border: the step from the last texels to the first is no larger than steps within.
#[test]
fn every_kind_repeats_without_a_seam() {
    for pattern in all() {
        let n = 256;
        let maps = pattern.clone().with(5, n as u32).maps(MapSet::ALL);
        for (what, map) in [("colour", &maps.base_color), ("surface", &maps.metallic_roughness), ("normal", &maps.normal)] {
            let texels = channels(map, n);
            for columns in [true, false] {
                let steps = steps(&texels, n, columns);
                let most = steps[..n - 1].iter().fold(0.0_f64, |a, b| a.max(*b));
                let seam = steps[n - 1];
                assert!(seam <= 1.1 * most + 1e-9, "{} {what}, columns {columns}: {seam} but {most} within", pattern.kind());
            }
        }
    }
}

#[test]
fn values_stay_in_their_ranges_and_normals_are_normals() {
    let of_materials = drawn(160).into_iter().filter_map(|m| m.pattern).map(|p| p.with(9, 96));
    for pattern in all().map(|p| p.with(2, 128)).chain(of_materials) {
        let maps = pattern.maps(MapSet::ALL);
        let count = (maps.size * maps.size) as f64;
        let json = serde_json::to_value(&pattern).unwrap();
        let bound = |k: usize| json["roughness"][k].as_f64().unwrap();
        for t in channels(&maps.metallic_roughness, maps.size) {
            assert!(t[1] >= bound(0) - 0.003 && t[1] <= bound(1) + 0.003, "{}: {t:?}", pattern.kind());
        }
        let mut mean = [0.0; 3];
        if let Some(Map::Words(texels)) = &maps.normal {
            assert!(texels.iter().all(|t| t[3] == u16::MAX));
            for t in channels(&maps.normal, maps.size) {
                let n = t.map(|v| 2.0 * v - 1.0);
                let length = n.iter().map(|v| v * v).sum::<f64>().sqrt();
                assert!((length - 1.0).abs() < 1e-4 && n[2] > 0.1, "{}: {n:?}", pattern.kind());
                (0..3).for_each(|c| mean[c] += n[c] / count);
            }
            assert!(mean[0].abs() < 0.03 && mean[1].abs() < 0.03 && mean[2] > 0.75, "{}: mean {mean:?}", pattern.kind());
        }
        if let Some(Map::Bytes(texels)) = &maps.base_color {
            // Only leaves have holes between them: about the share that is left of two layers.
            let open = texels.iter().filter(|t| t[3] == 0).count() as f64 / texels.len() as f64;
            let holes = if pattern.kind() == "leaves" { 0.05..0.6 } else { 0.0..1e-9 };
            assert!(holes.contains(&open), "{}: {open}", pattern.kind());
            let distinct: BTreeSet<_> = texels.iter().collect();
            assert!(distinct.len() > 2, "{}: {} colours", pattern.kind(), distinct.len());
        }
    }
}

/// The bytes of every kind, whatever machine made them. A change here changes published data: `RENDERFLOW_UPDATE=1` renews the
/// file.
#[test]
fn maps_are_pinned() {
    let found: String = all()
        .map(|pattern| {
            let maps = pattern.clone().with(1, 64).maps(MapSet::ALL);
            let mut hash = blake3::Hasher::new();
            let mut add = |bytes: &[u8]| {
                hash.update(bytes);
            };
            for map in [&maps.base_color, &maps.metallic_roughness, &maps.normal] {
                match map.as_ref().unwrap() {
                    Map::Constant(value) => value.iter().for_each(|v| add(&v.to_le_bytes())),
                    Map::Bytes(texels) => texels.iter().for_each(|t| add(t)),
                    Map::Words(texels) => texels.iter().flatten().for_each(|v| add(&v.to_le_bytes())),
                }
            }
            format!("{} {}\n", pattern.kind(), hash.finalize().to_hex())
        })
        .collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references/patterns.txt");
    if std::env::var_os("RENDERFLOW_UPDATE").is_some() {
        std::fs::write(&path, &found).unwrap();
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), found);
}

/// A sine on paper: the difference over two texels of sin is 2 cos sin(step).
#[test]
fn normals_of_ribs_are_those_of_a_sine() {
    let (n, ribs, depth) = (256_usize, 8_u32, 0.01_f32);
    let sheet = pattern::Corrugated { ribs, depth, square: 0.0, resolution: n as u32, ..Default::default() };
    let maps = Pattern::Corrugated(sheet).maps(MapSet { base_color: false, metallic_roughness: false, normal: true });
    assert!(maps.base_color.is_none() && maps.metallic_roughness.is_none());
    let step = std::f64::consts::TAU * f64::from(ribs) / n as f64;
    for (i, texel) in channels(&maps.normal, n).into_iter().enumerate() {
        let angle = step * ((i % n) as f64 + 0.5);
        // Height depth / 2 * sin; it rises to the right where the cosine is positive, and the normal leans to the left.
        let slope = 0.5 * f64::from(depth) * angle.cos() * step.sin() * n as f64;
        let scale = 1.0 / (1.0 + slope * slope).sqrt();
        let expected = [-slope * scale, 0.0, scale];
        let found = texel.map(|v| 2.0 * v - 1.0);
        assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 4e-5), "{i}: {found:?} but {expected:?}");
    }
}

/// Rust is a dielectric on a metal: both are there, little lies between, and the oxide is the rougher.
#[test]
fn rust_is_no_metal() {
    let maps = Pattern::named("rust").unwrap().with(4, 256).maps(MapSet::ALL);
    let texels = channels(&maps.metallic_roughness, maps.size);
    let share = |low: f64, high: f64| texels.iter().filter(|t| (low..=high).contains(&t[2])).count() as f64 / texels.len() as f64;
    assert!(
        share(0.0, 0.05) > 0.15 && share(0.6, 1.0) > 0.25 && share(0.05, 0.4) < 0.2,
        "{} {}",
        share(0.0, 0.05),
        share(0.6, 1.0)
    );
    let mean = |metal: bool| {
        let part: Vec<f64> = texels.iter().filter(|t| (t[2] > 0.5) == metal).map(|t| t[1]).collect();
        part.iter().sum::<f64>() / part.len() as f64
    };
    assert!(mean(false) > mean(true) + 0.3, "{} {}", mean(false), mean(true));
}

/// One plane for each material.
fn planes(materials: Vec<Material>) -> Scene {
    let mut scene = empty_scene();
    scene.objects = materials
        .iter()
        .map(|m| Object {
            name: format!("with {}", m.name),
            geometry: Geometry::Shape(Shape::Plane { size: 1.0 }),
            material: Some(m.name.clone()),
            transform: Default::default(),
            motion: None,
            animation: None,
        })
        .collect();
    scene.materials = materials;
    scene
}

fn patterned(name: &str, kind: &str) -> Material {
    let pattern = Pattern::named(kind).map(|p| p.with(1, 64));
    Material { name: name.into(), base_color: [1.0; 3], metallic: 1.0, roughness: 1.0, pattern, ..Material::default() }
}

fn loaded(scene: &Scene) -> LoadedScene {
    load::load(scene, &anywhere()).unwrap()
}

#[test]
fn a_pattern_becomes_three_textures_that_equal_patterns_share() {
    let other =
        Material { texture_transform: TextureTransform { scale: [3.0, 2.0], ..Default::default() }, ..patterned("b", "rust") };
    let mirrored = Material { texture_wrap: TextureWrap::Mirror, ..patterned("c", "rust") };
    let scene = planes(vec![patterned("a", "rust"), other, mirrored]);
    let loaded = loaded(&scene);
    // Base colour, surface and normals, once for each wrap; the texels exist once.
    assert_eq!(loaded.textures.len(), 6, "{:?}", loaded.report.notes);
    assert!(loaded.textures.iter().all(|t| t.levels.len() == 7), "all are made");
    let [a, b, c] = [0, 1, 2].map(|i| &loaded.materials[i]);
    let texture = |m: &renderflow_scenes::Material| m.base_color_texture.as_ref().unwrap().texture;
    assert_eq!(texture(a), texture(b));
    assert!(Arc::ptr_eq(&loaded.textures[texture(a)].levels, &loaded.textures[texture(c)].levels));
    let uv = b.normal_texture.as_ref().unwrap().0.uv_transform.transform_point2(glam::Vec2::ONE);
    assert_eq!(uv.to_array(), [3.0, 2.0]);
    assert!(!loaded.meshes[0].tangents.is_empty());
    let maps = scene.materials[0].pattern.as_ref().unwrap().maps(MapSet::ALL);
    let (Some(Map::Bytes(made)), renderflow_scenes::mipmap::Texels::Bytes(stored)) =
        (&maps.base_color, &loaded.textures[texture(a)].levels[0].texels)
    else {
        panic!("bytes")
    };
    assert_eq!(made, stored);
}

#[test]
fn what_a_pattern_does_not_need_is_not_made() {
    // Nothing uses it.
    let mut scene = planes(vec![patterned("a", "bricks"), patterned("b", "tiles")]);
    scene.objects.pop();
    let unused = loaded(&scene);
    assert_eq!(unused.textures.len(), 3);
    assert!(unused.materials[1].base_color_texture.is_none() && unused.report.notes.len() == 1, "{:?}", unused.report.notes);

    // Without relief: no normals, no tangents. One roughness and no metal: no map of them, but a factor.
    let flat = pattern::Blotches { depth: 0.0, roughness: [0.4; 2], resolution: 64, ..Default::default() };
    let material = Material { pattern: Some(Pattern::Blotches(flat.clone())), ..patterned("flat", "bricks") };
    let plain = loaded(&planes(vec![material.clone()]));
    assert_eq!(plain.textures.len(), 1);
    assert!(plain.meshes[0].tangents.is_empty());
    assert!((plain.materials[0].surface.roughness - 0.4).abs() < 0.002 && plain.materials[0].surface.metallic == 0.0);

    // One colour as well: nothing is left but factors.
    let one = pattern::Blotches { colors: [[0.5, 0.25, 0.1]; 3], ..flat };
    let material = Material { base_color: [0.5; 3], pattern: Some(Pattern::Blotches(one)), ..material };
    let bare = loaded(&planes(vec![material]));
    assert!(bare.textures.is_empty());
    let color = bare.materials[0].surface.base_color.to_array();
    assert!(color.iter().zip([0.25, 0.125, 0.05]).all(|(a, b)| (a - b).abs() < 0.003), "{color:?}");
}

#[test]
fn violations_name_their_place() {
    let bricks = pattern::Bricks {
        colors: [[0.5; 3], [0.5, 1.5, 0.5], [0.5; 3]],
        roughness: [0.2, f32::NAN],
        depth: 0.3,
        pairs: 0,
        resolution: 32,
        ..Default::default()
    };
    let mut scene = planes(vec![Material { pattern: Some(Pattern::Bricks(bricks)), ..patterned("a", "rust") }]);
    scene.materials[0].base_color_texture = Some("a.png".into());
    scene.materials[0].normal_texture = Some("n.png".into());
    scene.materials[0].emissive_texture = Some("e.png".into());
    let Err(Error::Invalid { problems, .. }) = scene.validate() else { panic!("must be refused") };
    let found: Vec<&str> = problems.iter().map(|p| p.pointer.as_str()).collect();
    let at = |field: &str| format!("/materials/0/{field}");
    let expected = [
        at("base_color_texture"),
        at("normal_texture"),
        at("pattern/colors/1/1"),
        at("pattern/roughness/1"),
        at("pattern/depth"),
        at("pattern/pairs"),
        at("pattern/resolution"),
    ];
    assert_eq!(found, expected);
    assert!(problems[0].reason.contains("together with a pattern"), "{}", problems[0]);
}

#[test]
fn patterns_are_json_and_old_materials_stay_as_they_were() {
    for pattern in all() {
        let text = serde_json::to_string(&pattern).unwrap();
        assert!(text.starts_with(&format!("{{\"kind\":\"{}\"", pattern.kind())), "{text}");
        assert_eq!(serde_json::from_str::<Pattern>(&text).unwrap(), pattern);
        let short = format!("{{\"kind\":\"{}\"}}", pattern.kind());
        assert_eq!(serde_json::from_str::<Pattern>(&short).unwrap(), pattern);
        let wrong = format!("{{\"kind\":\"{}\",\"colour\":1}}", pattern.kind());
        assert!(serde_json::from_str::<Pattern>(&wrong).unwrap_err().to_string().contains("unknown field"));
    }
    assert!(serde_json::from_str::<Pattern>("{\"kind\":\"brick\"}").is_err());
    let old = Material { name: "a".into(), ..Material::default() };
    let text = r#"{"name":"a","base_color":[0.8,0.8,0.8],"metallic":0.0,"roughness":0.5,"specular":0.5}"#;
    assert_eq!(serde_json::to_string(&old).unwrap(), text);
}

#[test]
fn materials_are_valid_and_of_all_kinds() {
    let materials = drawn(2000);
    let scene = planes(materials[..400].to_vec());
    scene.validate().unwrap();
    let text = scene.canonical_json();
    assert_eq!(serde_json::from_str::<Scene>(&text).unwrap(), scene);
    let kinds: BTreeSet<&str> = materials.iter().filter_map(|m| m.pattern.as_ref()).map(Pattern::kind).collect();
    // Leaves hang on trees and are no surface of objects.
    assert_eq!(kinds, Pattern::KINDS.iter().copied().filter(|kind| *kind != "leaves").collect());
    assert_eq!(drawn(20), materials[..20]);
    // Metal is never wood: what is metallic has a pattern of metal, or none.
    let metals = ["rust", "scratched", "chipped_paint", "brushed", "hammered", "corrugated", "tread_plate"];
    for material in &materials {
        let Some(pattern) = &material.pattern else { continue };
        assert!(material.metallic == 0.0 || metals.contains(&pattern.kind()), "{material:?}");
    }
}

#[test]
fn knobs_are_shares() {
    let count = 3000;
    let share = |knobs: &MaterialKnobs, is: fn(&Material) -> bool| {
        let hits = (0..count).filter(|&i| is(&materials::object(&mut Seed::root(i).rng(), "m", knobs))).count();
        hits as f64 / count as f64
    };
    let knobs = MaterialKnobs::default();
    // Four standard deviations of a share of 0.4 in 3000 are 0.036.
    let textured = share(&knobs, |m| m.pattern.is_some());
    assert!((textured - 0.4).abs() < 0.036, "{textured}");
    let none = MaterialKnobs { textured: 0.0, metal: 0.0, coated: 0.0, sheen: 0.0, anisotropic: 0.0, subsurface: 0.0 };
    assert_eq!(share(&none, |m| m.pattern.is_some() || m.clearcoat > 0.0 || m.sheen > 0.0 || m.anisotropic > 0.0), 0.0);
    let every = MaterialKnobs { textured: 1.0, metal: 1.0, coated: 1.0, ..none };
    assert_eq!(share(&every, |m| m.pattern.is_some() && m.clearcoat > 0.0), 1.0);
    assert_eq!(serde_json::from_str::<MaterialKnobs>("{}").unwrap(), knobs);
    assert!(serde_json::from_str::<MaterialKnobs>("{\"metals\":1}").is_err());
    assert_eq!(MaterialKnobs { metal: 1.5, sheen: f64::NAN, ..knobs }.validate().len(), 2);
}
