//! Scenes composed from the knobs of a plan: valid, reproducible, free of collisions, and within their knobs and pools.

use glam::{DVec3, Vec2, Vec3, Vec3A};
use rayon::prelude::*;
use renderflow_frame::reach::Reach;
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::description::{EnvironmentSource, Geometry, Material, Object, Scene};
use renderflow_scenes::load::load;
use renderflow_scenes::procedural::{
    Cameras, Composed, Composition, ENVIRONMENT_COUNT, LayoutKind, Layouts, MESH_COUNT, Pool, Request, Split, compose_one,
    families,
};
use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::{self, Shape};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::LazyLock;

const FRAMES: u32 = 40;
const LAYOUTS: [&str; 3] = ["ground", "room", "outdoor"];
const CAMERAS: [&str; 4] = ["orbit", "dolly", "handheld", "fixed"];

fn names(list: &[&str]) -> Vec<String> {
    list.iter().map(|&name| name.to_owned()).collect()
}

/// The pool of a test: owned lists.
struct Lists {
    meshes: Vec<String>,
    environments: Vec<String>,
    models: Vec<String>,
    builtin: Vec<String>,
}

impl Lists {
    fn all() -> Self {
        let catalog = Catalog::new(5, 4096, 512);
        let (meshes, environments) = (names(catalog.mesh_families()), names(catalog.environment_families()));
        Self { meshes, environments, models: vec![], builtin: vec![] }
    }

    fn compose(&self, number: u64, composition: &Composition) -> renderflow_scenes::Result<Composed> {
        let catalog = Catalog::new(5, 4096, 512);
        let pool = Pool {
            catalog: &catalog,
            mesh_families: &self.meshes,
            environment_families: &self.environments,
            models: &self.models,
            hdris: &[],
            builtin: &self.builtin,
            allowed: &[],
        };
        let seed = Seed::root(5).child("sequence", number);
        let name = format!("scene-{number}");
        renderflow_scenes::procedural::compose(&Request {
            seed,
            name,
            resolution: [128, 96],
            frames: FRAMES,
            composition,
            pool: &pool,
        })
    }
}

fn compose(number: u64, composition: &Composition) -> Composed {
    Lists::all().compose(number, composition).unwrap_or_else(|e| panic!("scene {number}: {e}"))
}

/// Knobs for one layout and one camera.
fn only(layout: &str, camera: &str) -> Composition {
    let on = |a: &str, b: &str| f64::from(u8::from(a == b));
    Composition {
        layouts: Layouts { ground: on(layout, "ground"), room: on(layout, "room"), outdoor: on(layout, "outdoor") },
        cameras: Cameras {
            orbit: on(camera, "orbit"),
            dolly: on(camera, "dolly"),
            handheld: on(camera, "handheld"),
            fixed: on(camera, "fixed"),
        },
        moving: 0.6,
        ..Composition::default()
    }
}

/// Seventeen scenes of every layout with every camera.
static SCENES: LazyLock<Vec<Composed>> = LazyLock::new(|| {
    let kinds: Vec<_> = LAYOUTS.iter().flat_map(|l| CAMERAS.iter().map(move |c| only(l, c))).collect();
    // Meshes and light that are made quickly; rooms look at theirs. Threads instead of a parallel loop: whoever waits for this
    // cell might be asked to run a part of such a loop.
    let slow = ["csg", "blobs", "gyroid", "sponge", "fractal", "coral", "tree", "grass", "terrain", "displaced", "seashell"];
    let all = Lists::all();
    let meshes = all.meshes.iter().filter(|family| !slow.contains(&family.as_str())).cloned().collect();
    let lists = Lists { meshes, environments: names(&["fog", "soft_gradient"]), ..all };
    let some = |first: u64| {
        let compose = |k: u64| lists.compose(k, &kinds[k as usize % kinds.len()]).unwrap_or_else(|e| panic!("scene {k}: {e}"));
        (51 * first..51 * (first + 1)).map(compose).collect::<Vec<_>>()
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|first| scope.spawn(move || some(first))).collect();
        threads.into_iter().flat_map(|thread| thread.join().expect("composes")).collect()
    })
});

fn parallel() -> impl ParallelIterator<Item = &'static Composed> {
    LazyLock::force(&SCENES).par_iter()
}

#[test]
fn every_layout_with_every_camera_is_valid_and_loads() {
    let mut kinds = BTreeMap::<_, u32>::new();
    for made in SCENES.iter() {
        *kinds.entry((made.layout, made.camera)).or_default() += 1;
        made.scene.validate().unwrap_or_else(|e| panic!("{}: {e}", made.scene.name));
        let again = Scene::from_json(Path::new("composed.json"), &made.scene.canonical_json()).expect("reads back");
        assert_eq!(again, made.scene);
    }
    assert!(kinds.len() == 12 && kinds.values().all(|&n| n == 17), "{kinds:?}");
    // Skies are other tests' matter, and the slowest part of loading.
    SCENES[..12].par_iter().for_each(|made| {
        let mut scene = made.scene.clone();
        scene.environment.source = EnvironmentSource::Constant([1.0; 3]);
        let loaded = load(&scene, &Reach::folder("")).unwrap_or_else(|e| panic!("{}: {e}", scene.name));
        assert_eq!(loaded.instances.len(), scene.objects.len());
    });
}

fn shape(object: &Object) -> &Shape {
    match &object.geometry {
        Geometry::Shape(shape) => shape,
        Geometry::File(file) => panic!("no files in this pool, found {file}"),
    }
}

fn used(made: &Composed) -> Vec<&Object> {
    let find = |name: &str| made.scene.objects.iter().find(|o| o.name == name).expect("an object of the scene");
    made.meshes.iter().map(|used| find(&used.object)).collect()
}

/// Points of the meshes of every scene's objects, by name.
fn points() -> &'static [BTreeMap<String, Vec<Vec3A>>] {
    static POINTS: LazyLock<Vec<BTreeMap<String, Vec<Vec3A>>>> = LazyLock::new(|| {
        let of = |object: &Object| {
            let points = shapes::mesh(shape(object)).positions.into_iter().map(Vec3A::from);
            (object.name.clone(), points.collect())
        };
        let some = |made: &[Composed]| made.iter().map(|m| m.scene.objects.iter().map(of).collect()).collect::<Vec<_>>();
        std::thread::scope(|scope| {
            let threads: Vec<_> = SCENES.chunks(51).map(|made| scope.spawn(move || some(made))).collect();
            threads.into_iter().flat_map(|thread| thread.join().expect("meshes")).collect()
        })
    });
    &POINTS
}

/// Lowest and highest point and disc (centre, radius) of an object at a frame, by the description's own transform.
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

/// Whether a point lies in a box of the description, grown by `margin` metres. (All boxes of structure have unit scale.)
fn inside_box(object: &Object, point: DVec3, margin: f64) -> bool {
    let Shape::Box { size, .. } = shape(object) else { return false };
    let local = object.transform_at(0).inverse().transform_point3(point);
    let half = DVec3::from(size.map(f64::from)) * 0.5 + margin;
    local.abs().cmple(half).all()
}

#[test]
fn nothing_touches_and_cameras_stand_free_at_every_frame() {
    points().par_iter().zip(&*SCENES).for_each(|(points, made)| {
        let (scene, objects) = (&made.scene, used(made));
        let place = |frame: u32| format!("{} ({:?}, {:?}), frame {frame}", scene.name, made.layout, made.camera);
        let points: Vec<&Vec<Vec3A>> = objects.iter().map(|o| &points[&o.name]).collect();
        let structure: Vec<&Object> = scene.objects.iter().filter(|o| !objects.iter().any(|u| u.name == o.name)).collect();
        for frame in 0..FRAMES {
            let eye = scene.camera.at(frame, scene.resolution).position().as_dvec3() + scene.camera.origin();
            assert!(eye.y > 0.1, "{}: the eye is at {eye}", place(frame));
            for object in &structure {
                // Boxes of a room, tables, houses, screens; hills are spheres.
                assert!(!inside_box(object, eye, 0.02), "{}: the eye is in {}", place(frame), object.name);
                if let Shape::Sphere { radius } = shape(object) {
                    let local = object.transform_at(frame).inverse().transform_point3(eye).length();
                    assert!(local > f64::from(*radius), "{}: the eye is in {}", place(frame), object.name);
                }
            }
            let whole = frame % 13 == 0 || frame + 1 == FRAMES;
            let moved = |o: &Object| whole || o.moves();
            let places: Vec<_> = (objects.iter().zip(&points))
                .map(|(o, p)| if moved(o) { occupied(o, p, frame) } else { (f32::NAN, f32::NAN, Vec2::NAN, 0.0) })
                .collect();
            for (i, a) in places.iter().enumerate().filter(|(_, a)| !a.0.is_nan()) {
                let clear = Vec2::new(eye.x as f32, eye.z as f32).distance(a.2) > a.3 || eye.y as f32 > a.1;
                assert!(clear, "{}: the eye is in {}", place(frame), objects[i].name);
                assert!(a.0 > -2e-4, "{}: {} sinks to {}", place(frame), objects[i].name, a.0);
                for (j, b) in places.iter().enumerate().skip(i + 1) {
                    let apart = b.0.is_nan() || a.2.distance(b.2) >= a.3 + b.3 || a.0 >= b.1 - 2e-4 || b.0 >= a.1 - 2e-4;
                    assert!(apart, "{}: {} and {} overlap", place(frame), objects[i].name, objects[j].name);
                }
            }
        }
        if made.layout == LayoutKind::Room {
            for (object, points) in objects.iter().zip(&points) {
                let (low, high, centre, radius) = occupied(object, points, 0);
                for wall in structure.iter().filter(|o| o.name.starts_with("wall_") && !o.name.contains("bar")) {
                    let Shape::Box { size, .. } = shape(wall) else { continue };
                    let transform = wall.transform_at(0);
                    let near = transform.inverse().transform_point3(DVec3::new(
                        f64::from(centre.x),
                        f64::from(0.5 * (low + high)),
                        f64::from(centre.y),
                    ));
                    let gap = near.z.abs() - 0.5 * f64::from(size[2]);
                    assert!(gap > f64::from(radius) - 1e-3, "{}: {} is in {}", scene.name, object.name, wall.name);
                }
            }
        }
    });
}

/// Nothing floats: at frame 0 every object stands on the ground, on another or on a plain top below it.
#[test]
fn objects_rest_on_something() {
    let stacked: usize = (points().par_iter().zip(&*SCENES))
        .map(|(points, made)| {
            let mut stacked = 0;
            let top = |o: &Object| (occupied(o, &points[&o.name], 0).1, o.clone());
            let tops: Vec<(f32, Object)> = made.scene.objects.iter().map(top).collect();
            for object in used(made) {
                let (low, ..) = occupied(object, &points[&object.name], 0);
                let carried = |(top, o): &(f32, Object)| o.name != object.name && (low - top).abs() < 1e-3;
                assert!(low < 1e-3 || tops.iter().any(carried), "{}: {} floats at {low}", made.scene.name, object.name);
                stacked += usize::from(low > 1e-3);
            }
            stacked
        })
        .sum();
    assert!(stacked > 50, "only {stacked} stand on something");
}

#[test]
fn subjects_are_in_the_picture() {
    let seen: Vec<(f32, String)> = parallel()
        .map(|made| {
            let mut least = 1.0f32;
            for frame in [0, FRAMES / 2, FRAMES - 1] {
                let camera = made.scene.camera(frame);
                let inside = |o: &&Object| {
                    let at = o.transform_at(frame).translation - made.scene.camera.origin();
                    let size = Vec2::new(camera.width as f32, camera.height as f32);
                    let place = camera.project(Vec3A::from(at.as_vec3()));
                    place.is_some_and(|(p, _)| p.cmpge(Vec2::ZERO).all() && p.cmple(size).all())
                };
                let objects = used(made);
                least = least.min(objects.iter().filter(|o| inside(o)).count() as f32 / objects.len() as f32);
            }
            (least, format!("{} {:?} {:?}", made.scene.name, made.layout, made.camera))
        })
        .collect();
    for (share, name) in &seen {
        assert!(*share > 0.0, "{name}: no object's middle is in the picture");
    }
    let mean = seen.iter().map(|s| s.0).sum::<f32>() / seen.len() as f32;
    assert!(mean > 0.6, "{mean} of the objects' middles are in the picture");
}

#[test]
fn the_same_request_gives_the_same_bytes() {
    for number in [0, 1, 2, 7] {
        let kind = only(LAYOUTS[number as usize % 3], CAMERAS[number as usize % 4]);
        assert_eq!(compose(number, &kind).scene.canonical_json(), compose(number, &kind).scene.canonical_json());
    }
    // A plan of before there was glass still makes its scenes.
    let opaque = |number: usize| {
        let Composition { layouts, cameras, moving, .. } = only(LAYOUTS[number], CAMERAS[number]);
        Composition { layouts, cameras, moving, ..Composition::opaque() }
    };
    let hash = |number: u64| compose(number, &opaque(number as usize)).scene.hash();
    let pinned = [0, 1, 2].map(hash);
    assert_eq!(pinned, HASHES, "composed scenes changed: data sets made before differ from now on");
    let hashes: BTreeSet<String> = SCENES.iter().map(|made| made.scene.hash()).collect();
    assert_eq!(hashes.len(), SCENES.len());
}

/// Of a ground with an orbit, a room with a dolly and open country with a camera in the hand.
const HASHES: [&str; 3] = [
    "feb0878da28061ca9fdb0c9cab81c3080ae556a6dcdad1e7c93a37bf037e79f6",
    "1e962cb639522d3d2dc6db075bd842f9cf140bfa67c0dcb65f1987a71e699be4",
    "48af6dfe382ea77502202e2608ff3fbdee4ac94d4148ddab7a30d4d9706a5a05",
];

#[test]
fn one_scene_is_made_of_what_its_split_may_draw_from() {
    let lists = Split::ALL.map(|split| families(&Catalog::new(3, MESH_COUNT, ENVIRONMENT_COUNT), split));
    let meshes: Vec<&String> = lists.iter().flat_map(|list| &list.meshes).collect();
    assert_eq!(meshes.iter().collect::<BTreeSet<_>>().len(), meshes.len());
    assert_eq!(meshes.len(), shapes::FAMILIES.len() - 2);
    for (split, list) in Split::ALL.into_iter().zip(&lists) {
        let compose = |seed| compose_one(seed, split, [96, 64], 5, &Composition::default()).unwrap();
        let scene = compose(3);
        assert_eq!((scene.resolution, scene.frames, scene.name.as_str()), ([96, 64], 5, format!("{split}_3").as_str()));
        assert_eq!(scene, compose(3));
        assert_ne!(scene.hash(), compose(4).hash());
        let EnvironmentSource::Sky(sky) = &scene.environment.source else { panic!("composed scenes draw their skies") };
        let catalog = Catalog::new(3, MESH_COUNT, ENVIRONMENT_COUNT);
        let number = (0..ENVIRONMENT_COUNT).find(|&k| catalog.environment(k) == *sky).expect("of the catalogue");
        assert!(list.environments.iter().any(|family| family == catalog.environment_family(number)));
    }
    assert!(compose_one(3, Split::Train, [0, 64], 5, &Composition::default()).is_err());
}

#[test]
fn only_the_pool_is_used() {
    let lists = Lists {
        meshes: names(&["torus", "gear", "rock"]),
        environments: names(&["fog", "three_point"]),
        models: vec![],
        builtin: names(&["studio_three_point"]),
    };
    let mut environments = BTreeSet::new();
    for number in 0..40 {
        let made = lists.compose(number, &Composition::default()).unwrap();
        for (used, object) in made.meshes.iter().zip(used(&made)) {
            assert!(lists.meshes.contains(&used.family) && shape(object).family() == used.family, "{used:?}");
            let catalog = Catalog::new(5, 4096, 512);
            assert_eq!(catalog.mesh(used.mesh.unwrap()), *shape(object));
        }
        if let EnvironmentSource::Sky(sky) = &made.scene.environment.source {
            assert_eq!(*sky, Catalog::new(5, 4096, 512).environment(made.environment_number.unwrap()));
        }
        environments.insert(made.environment);
    }
    let expected: BTreeSet<String> = ["fog", "three_point", "builtin:studio_three_point"].map(String::from).into();
    assert_eq!(environments, expected);
}

#[test]
fn knobs_at_their_ends_are_obeyed() {
    let count = |composition: &Composition, what: &(dyn Fn(&Composed) -> bool + Sync)| {
        (0..16).into_par_iter().filter(|&number| what(&compose(number, composition))).count()
    };
    let still = Composition { moving: 0.0, changing: 0.0, occluders: 0.0, ..Composition::default() };
    let named =
        |made: &Composed, names: &[&str]| made.scene.objects.iter().any(|o| names.iter().any(|name| o.name.starts_with(name)));
    let shading = |made: &Composed| named(made, &["screen", "pillar", "canopy"]);
    assert_eq!(count(&still, &|made| made.moving || made.changing || shading(made)), 0);
    assert_eq!(count(&Composition { moving: 1.0, ..still.clone() }, &|made| made.moving), 16);
    assert_eq!(count(&Composition { changing: 1.0, ..still.clone() }, &|made| made.changing && !made.moving), 16);
    let shaded = count(&Composition { occluders: 1.0, ..still.clone() }, &shading);
    assert!(shaded >= 14, "{shaded} of 16 scenes found a place for an occluder");
    // A fixed camera before a still scene only where the knobs leave no choice.
    let fixed = |moving, changing| Composition { moving, changing, ..only("ground", "fixed") };
    assert_eq!(count(&fixed(0.0, 0.01), &|made| made.changing && !made.moving), 16);
    assert_eq!(count(&fixed(0.01, 0.0), &|made| made.moving && !made.changing), 16);
    assert_eq!(count(&fixed(0.0, 0.0), &|made| made.moving || made.changing), 0);

    let lit = |made: &Composed| made.scene.materials.iter().any(|m| m.emissive != [0.0; 3]);
    let room = |lamps| Composition { lamps, ..only("room", "orbit") };
    assert_eq!((count(&room(0.0), &lit), count(&room(1.0), &lit)), (0, 16));
    let many = Composition { objects: [7, 7], intensity: [1.5, 1.5], ..Composition::default() };
    assert_eq!(count(&many, &|made| made.scene.environment.intensity == 1.5 && made.meshes.len() >= 6), 16);
    let turning = Composition { degrees_per_frame: -9.0, ..only("ground", "orbit") };
    assert_eq!(count(&turning, &|made| made.scene.canonical_json().contains("\"degrees_per_frame\":-9.0")), 16);
}

#[test]
fn clear_things_come_as_often_as_the_knobs_say() {
    let count = |composition: &Composition, what: &(dyn Fn(&Composed) -> bool + Sync)| {
        (0..16).into_par_iter().filter(|&number| what(&compose(number, composition))).count()
    };
    let clear = |m: &Material| m.transmission > 0.0 || m.opacity.is_some() || m.alpha_cutoff.is_some();
    let any_clear = |made: &Composed| made.scene.materials.iter().any(clear);
    let named = |made: &Composed, name: &str| made.scene.objects.iter().any(|o| o.name.contains(name));
    for layout in LAYOUTS {
        let none = |kind: Composition| Composition { layouts: kind.layouts, ..Composition::opaque() };
        let opaque = none(only(layout, "orbit"));
        assert_eq!(count(&opaque, &any_clear), 0);
        let glass = |made: &Composed| {
            // Light loses its way in a surface that is not closed, or that runs through itself.
            let bodies = made.scene.objects.iter().filter(|o| {
                let material = made.scene.materials.iter().find(|m| Some(&m.name) == o.material.as_ref());
                material.is_some_and(|m| m.transmission == 1.0 && !m.thin_walled && m.name == o.name)
            });
            let closed = bodies.map(|o| shapes::inspect(&shapes::mesh(shape(o)))).collect::<Vec<_>>();
            assert!(closed.iter().all(|m| m.watertight && m.components == 1), "{}", made.scene.name);
            !closed.is_empty()
        };
        assert_eq!(count(&opaque, &glass), 0);
        // Where at least one object is a single closed surface.
        let many = count(&Composition { glass: 1.0, ..opaque.clone() }, &glass);
        assert!(many >= 11, "{layout}: {many}");
        let basin = |made: &Composed| named(made, "basin");
        assert_eq!(count(&Composition { water: 1.0, ..opaque.clone() }, &basin), 16);
        let panes = count(&Composition { panes: 1.0, ..opaque.clone() }, &|made| named(made, "_pane_"));
        assert!(if layout == "room" { panes >= 14 } else { panes == 0 }, "{layout}: {panes}");
        let lit = |made: &Composed| (1..=3).contains(&made.scene.lights.len());
        assert_eq!((count(&opaque, &lit), count(&Composition { lights: 1.0, ..opaque.clone() }, &lit)), (0, 16));
        let leafy =
            |made: &Composed| made.scene.materials.iter().any(|m| m.pattern.as_ref().is_some_and(|p| p.kind() == "leaves"));
        assert_eq!(count(&Composition { leaves: 1.0, ..opaque.clone() }, &leafy), if layout == "outdoor" { 16 } else { 0 });
    }
}

#[test]
fn hostile_knobs_are_refused_with_their_place() {
    let read = |text: &str| serde_json::from_str::<Composition>(text);
    assert!(read("{\"wobble\": 1}").is_err() && read("{\"layouts\": {\"moon\": 1}}").is_err());
    assert_eq!(read("{}").unwrap(), Composition::opaque());
    for (text, says) in [
        (r#"{"moving": 2}"#, "/composition/moving: 2 is outside 0..=1"),
        (r#"{"glass": 1.5}"#, "/composition/glass: 1.5 is outside 0..=1"),
        (r#"{"changing": -0.1}"#, "/composition/changing: -0.1 is outside 0..=1"),
        (r#"{"objects": [0, 4]}"#, "/composition/objects/0: 0 is outside 1..=64"),
        (r#"{"objects": [4, 4000000000]}"#, "/composition/objects/1"),
        (r#"{"objects": [9, 4]}"#, "/composition/objects: 9 is more than 4"),
        (r#"{"layouts": {"ground": 0, "room": 0, "outdoor": 0}}"#, "/composition/layouts: every weight is 0"),
        (r#"{"cameras": {"orbit": -1}}"#, "/composition/cameras/orbit: -1 is outside"),
        (r#"{"intensity": [0, 1]}"#, "/composition/intensity/0"),
        (r#"{"intensity": [2, 1]}"#, "/composition/intensity: 2 is more than 1"),
        (r#"{"degrees_per_frame": 360}"#, "/composition/degrees_per_frame"),
        (r#"{"materials": {"metal": 7}}"#, "/composition/materials/metal: 7 is outside 0..=1"),
    ] {
        let knobs = read(text).unwrap();
        let message = knobs.check().unwrap_err();
        assert!(message.starts_with(says), "{message}");
        // Composing refuses the same, in the same words.
        assert_eq!(Lists::all().compose(0, &knobs).unwrap_err().to_string(), message);
    }
    assert!(Composition { moving: f64::NAN, ..Composition::default() }.check().unwrap_err().contains("NaN"));

    let fails = |lists: Lists| lists.compose(0, &Composition::default()).unwrap_err().to_string();
    let message = fails(Lists { meshes: names(&["gear", "dodo"]), ..Lists::all() });
    assert!(message.contains("/mesh_families/1: there is no family \"dodo\""), "{message}");
    let message = fails(Lists { meshes: vec![], ..Lists::all() });
    assert!(message.contains("/mesh_families: there are neither families nor models"), "{message}");
    let message = fails(Lists { environments: names(&["moon"]), ..Lists::all() });
    assert!(message.contains("/environment_families/0"), "{message}");
    let message = fails(Lists { meshes: vec![], models: names(&["/nowhere/chair.glb"]), ..Lists::all() });
    assert!(message.contains("/nowhere/chair.glb"), "{message}");
}

#[test]
fn models_of_users_rest_on_the_floor() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/gltf");
    let Some(path) = ["pbr/Avocado/Avocado.gltf", "pbr/BoomBoxWithAxes/BoomBoxWithAxes.gltf"]
        .iter()
        .map(|name| folder.join(name))
        .find(|path| path.exists())
    else {
        println!("skipped: no model in {}", folder.display());
        return;
    };
    let path = path.to_string_lossy().into_owned();
    let lists = Lists { models: vec![path.clone()], ..Lists::all() };
    let composition = Composition { user_models: 0.5, ..only("ground", "orbit") };
    let mut models = 0;
    for number in 0..8 {
        let made = lists.compose(number, &composition).unwrap();
        let mut scene = made.scene.clone();
        scene.environment.source = EnvironmentSource::Constant([1.0; 3]);
        let loaded = load(&scene, &Reach::folder("").allow([&folder])).unwrap();
        for used in made.meshes.iter().filter(|used| used.family == "file") {
            assert_eq!((used.file.as_ref(), used.mesh), (Some(&path), None));
            models += 1;
            let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            for instance in loaded.instances.iter().filter(|i| i.name.starts_with(&used.object)) {
                for &p in &loaded.meshes[instance.mesh].positions {
                    let q = instance.transforms[0].transform_point3(p) + loaded.origin.as_vec3();
                    (low, high) = (low.min(q), high.max(q));
                }
            }
            let size = (high - low).max_element();
            assert!((0.4..1.9).contains(&size), "{}: {size} m", used.object);
            assert!(low.y > -1e-3, "{} sinks to {}", used.object, low.y);
        }
    }
    assert!(models > 10, "{models} models");
    let none = Composition { user_models: 0.0, ..composition.clone() };
    assert!(lists.compose(0, &none).unwrap().meshes.iter().all(|used| used.file.is_none()));
    let all = Composition { user_models: 1.0, ..composition };
    assert!(lists.compose(0, &all).unwrap().meshes.iter().all(|used| used.file.is_some()));
}
