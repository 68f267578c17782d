//! Composed scenes: valid, reproducible, with objects that do not touch, and as varied as they should be.

use glam::{Vec2, Vec3A};
use rand::Rng;
use rayon::prelude::*;
use renderflow_scenes::description::{CameraPath, EnvironmentSource, Geometry, Object, Scene};
use renderflow_scenes::procedural::{ComposeOptions, Split, compose};
use renderflow_scenes::seed::Seed;
use renderflow_scenes::{shapes, sky};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

fn scene(seed: u64, split: Split) -> Scene {
    compose(&ComposeOptions { seed, split, frames: 100, ..ComposeOptions::default() })
}

/// Training scenes of seeds 0 to 199, made once for all tests.
static SCENES: LazyLock<Vec<Scene>> =
    LazyLock::new(|| (0..200u64).into_par_iter().map(|seed| scene(seed, Split::Train)).collect());

fn shape(object: &Object) -> &shapes::Shape {
    match &object.geometry {
        Geometry::Shape(shape) => shape,
        Geometry::File(file) => panic!("composed scenes have no files, found {file}"),
    }
}

#[test]
fn seeds_form_a_stable_tree() {
    // Stored when the tree was defined: a change here changes every dataset ever made.
    let leaf = Seed::root(7).child("sequence", 3);
    let pixel = leaf.child("frame", 12).child("pixel", 65_535);
    assert_eq!([Seed::root(0).u64(), leaf.u64(), pixel.u64(), leaf.rng().next_u64()], SEEDS);
    let mut seen = BTreeSet::new();
    for index in 0..1000 {
        assert!(seen.insert(Seed::root(1).child("a", index).u64()) && seen.insert(Seed::root(1).child("b", index).u64()));
        assert!(seen.insert(Seed::root(1000 + index).u64()));
    }
}

// The first three agree with the `blake3` package of Python: derive_key of "renderflow 2026 seed tree, root", then keyed hashes of
// (length of the label, label, index), each number 8 bytes little endian.
const SEEDS: [u64; 4] =
    [18_288_444_373_478_556_299, 18_365_428_502_637_909_720, 1_554_266_496_274_973_223, 16_068_202_164_324_143_780];

#[test]
fn the_same_options_give_the_same_bytes() {
    for split in [Split::Train, Split::Val, Split::Test] {
        let text = |seed| scene(seed, split).canonical_json();
        assert_eq!(text(5), text(5));
        assert_ne!(text(5), text(6));
    }
    let hash = |split| scene(1, split).hash();
    assert_eq!(
        [hash(Split::Train), hash(Split::Test)],
        HASHES,
        "composed scenes changed: datasets made before differ from now on"
    );
}

const HASHES: [&str; 2] = [
    "899cf63bb5b3350e809434564627948dd2a745af1c1ffa307cabd7f1abd420d4",
    "ee900d1d4d893f43ccad7a527a3d2c841278e8ae99b6f330ed16830caf48390c",
];

#[test]
fn scenes_are_valid_and_within_the_asked_ranges() {
    for scene in SCENES.iter() {
        scene.validate().unwrap_or_else(|e| panic!("{}: {e}", scene.name));
        let again = Scene::from_json(std::path::Path::new("composed.json"), &scene.canonical_json()).expect("reads back");
        assert_eq!(again, *scene);
        assert!((4..=16).contains(&(scene.objects.len() - 1)), "{} objects", scene.objects.len() - 1);
        let CameraPath::Orbit { elevation, vertical_fov, distance, .. } = scene.camera else { panic!("an orbit") };
        assert!((8.0..=45.0).contains(&elevation) && (30.0..=55.0).contains(&vertical_fov) && distance > 0.5);
        for material in &scene.materials {
            assert!((0.05..=1.0).contains(&material.roughness), "{material:?}");
            assert!(material.base_color.iter().all(|v| (0.0..=1.0).contains(v)), "{material:?}");
        }
    }
}

#[test]
fn shapes_metals_motion_and_skies_are_as_frequent_as_intended() {
    let mut families: BTreeMap<&str, usize> = BTreeMap::new();
    let (mut metals, mut objects, mut moving) = (0, 0, 0);
    let mut lights: BTreeMap<&str, usize> = BTreeMap::new();
    for scene in SCENES.iter() {
        for object in &scene.objects[1..] {
            *families.entry(shape(object).family()).or_default() += 1;
        }
        metals += scene.materials[1..].iter().filter(|m| m.metallic > 0.5).count();
        objects += scene.objects.len() - 1;
        let movers = scene.objects.iter().filter(|o| o.motion.is_some()).count();
        assert!(movers <= 3);
        moving += usize::from(movers > 0);
        match &scene.environment.source {
            EnvironmentSource::Sky(sky) => *lights.entry(sky.family()).or_default() += 1,
            other => panic!("training scenes draw their skies, found {other:?}"),
        }
    }
    let solids = shapes::RANDOM_FAMILIES - 2;
    assert!(families.len() == solids && families.values().all(|&n| n > 40), "{families:?}");
    let share = metals as f64 / objects as f64;
    assert!((0.2..0.3).contains(&share), "share of metals {share}");
    let mean = objects as f64 / 200.0;
    assert!((9.0..11.0).contains(&mean), "{mean} objects a scene");
    assert!((30..=70).contains(&moving), "{moving} of 200 scenes move");
    assert!(lights.len() >= 7, "{lights:?}");
}

#[test]
fn test_scenes_use_held_out_maps_only() {
    let mut used = BTreeSet::new();
    for seed in 0..100 {
        let scene = scene(seed, Split::Test);
        let EnvironmentSource::Builtin(name) = &scene.environment.source else { panic!("test scenes use named maps") };
        assert!(sky::names().contains(&name.as_str()));
        used.insert(name.clone());
        assert_ne!(scene.objects, SCENES[seed as usize].objects, "splits are unrelated");
    }
    assert!(used.len() >= 16, "{used:?}");
}

/// Points of an object's mesh, in its own space.
fn points(object: &Object) -> Vec<Vec3A> {
    shapes::mesh(shape(object)).positions.iter().map(|&p| Vec3A::from(p)).collect()
}

/// Vertical extent and disc (centre, radius) of an object at a frame, by the description's own transform.
fn occupied(object: &Object, points: &[Vec3A], frame: u32) -> (f32, f32, Vec2, f32) {
    let transform = object.transform_at(frame).as_affine3a();
    let centre = Vec2::new(transform.translation.x, transform.translation.z);
    let (mut low, mut high, mut radius) = (f32::INFINITY, f32::NEG_INFINITY, 0.0f32);
    for &p in points {
        let q = transform.transform_point3a(p);
        (low, high) = (low.min(q.y), high.max(q.y));
        radius = radius.max(Vec2::new(q.x, q.z).distance(centre));
    }
    (low, high, centre, radius)
}

#[test]
fn objects_never_overlap_and_rest_on_something() {
    let stacked: usize = (0..40u64)
        .into_par_iter()
        .map(|seed| {
            let options = ComposeOptions { seed, frames: 30, moving_share: 0.6, ..ComposeOptions::default() };
            let scene = compose(&options);
            let meshes: Vec<_> = scene.objects[1..].iter().map(points).collect();
            let mut stacked = 0;
            for frame in [0, 11, 29] {
                let places: Vec<_> = scene.objects[1..].iter().zip(&meshes).map(|(o, p)| occupied(o, p, frame)).collect();
                for (i, a) in places.iter().enumerate() {
                    assert!(a.0 > -1e-5, "seed {seed}: {} sinks to {}", scene.objects[i + 1].name, a.0);
                    let supported =
                        a.0 < 1e-3 || places.iter().any(|b| (a.0 - b.1).abs() < 1e-3 && a.2.distance(b.2) + a.3 <= b.3 + 1e-3);
                    assert!(supported, "seed {seed}: {} floats at {}", scene.objects[i + 1].name, a.0);
                    stacked += usize::from(a.0 > 1e-3);
                    for (j, b) in places.iter().enumerate().skip(i + 1) {
                        let apart = a.2.distance(b.2) >= a.3 + b.3 || a.0 >= b.1 - 1e-4 || b.0 >= a.1 - 1e-4;
                        let names = (&scene.objects[i + 1].name, &scene.objects[j + 1].name);
                        assert!(apart, "seed {seed}, frame {frame}: {names:?} overlap");
                    }
                }
            }
            stacked
        })
        .sum();
    assert!(stacked > 20, "only {stacked} stacked objects");
}

#[test]
fn cameras_stand_outside_and_see_the_objects() {
    let shares: Vec<f32> = SCENES[..40]
        .par_iter()
        .map(|scene| {
            let meshes: Vec<_> = scene.objects[1..].iter().map(points).collect();
            let mut seen = 0;
            for frame in [0, 25, 50, 75] {
                let camera = scene.camera(frame);
                let eye = camera.position();
                assert!(eye.y > 0.05, "{}: the eye is at {eye}", scene.name);
                for (object, points) in scene.objects[1..].iter().zip(&meshes) {
                    let (_, top, centre, radius) = occupied(object, points, frame);
                    let clear = Vec2::new(eye.x, eye.z).distance(centre) > radius || eye.y > top;
                    assert!(clear, "{}: the eye is inside {}", scene.name, object.name);
                    let inside = |p: Vec2| {
                        let size = Vec2::new(camera.width as f32, camera.height as f32);
                        p.cmpge(Vec2::ZERO).all() && p.cmple(size).all()
                    };
                    let origin = object.transform_at(frame).translation.as_vec3a();
                    seen += usize::from(camera.project(origin).is_some_and(|(p, _)| inside(p)));
                }
            }
            seen as f32 / (4 * (scene.objects.len() - 1)) as f32
        })
        .collect();
    let mean = shares.iter().sum::<f32>() / shares.len() as f32;
    assert!(mean > 0.93, "{mean} of the objects' centres are in view");
}

#[test]
fn a_single_frame_a_wide_picture_and_odd_counts_work() {
    let base = ComposeOptions { seed: 3, moving_share: 1.0, ..ComposeOptions::default() };
    for options in [
        ComposeOptions { frames: 1, ..base.clone() },
        ComposeOptions { frames: 0, ..base.clone() },
        ComposeOptions { resolution: [1024, 128], frames: 5, ..base.clone() },
        ComposeOptions { objects: [1, 1], frames: 5, ..base.clone() },
        ComposeOptions { objects: [40, 40], frames: 5, ..base.clone() },
    ] {
        let scene = compose(&options);
        scene.validate().unwrap_or_else(|e| panic!("{options:?}: {e}"));
        assert!(scene.objects.len() as u32 > options.objects[0]);
    }
}
