//! The meshes of a catalogue: all different, all closed, finite, in bounds and outward; and known volumes.

use glam::DVec3;
use rayon::prelude::*;
use renderflow_scenes::Mesh;
use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::{FAMILIES, Shape, Stance, geometry_hash, inspect, mesh};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::PI;

/// The first family with a file of its own: its mesh is empty where a parameter is out of range.
const MODELS: usize = 19;

/// Shape `k` of the catalogue of `root`.
fn entry(root: u64, k: usize) -> Shape {
    let solid = &FAMILIES[2..];
    Shape::random_of(solid[k % solid.len()], &mut Seed::root(root).child("mesh", k as u64).rng())
}

/// How many triangles have shading normals that look into the body. Every vertex must have a normal.
fn inward_normals(mesh: &Mesh) -> usize {
    let looks_in = |t: &&[u32; 3]| {
        let corner = |k: usize| mesh.positions.get(t[k] as usize).map(|p| p.as_dvec3());
        let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else { return false };
        let shading: DVec3 = t.iter().filter_map(|&i| mesh.normals.get(i as usize)).map(|n| n.as_dvec3()).sum();
        shading.dot((b - a).cross(c - a)) <= 0.0
    };
    mesh.triangles.iter().filter(looks_in).count()
}

/// What is wrong with a mesh, if anything.
fn faults(shape: &Shape) -> (String, Vec<String>) {
    let mut wrong = Vec::new();
    for (pointer, reason) in shape.validate() {
        wrong.push(format!("{pointer}: {reason}"));
    }
    let m = mesh(shape);
    let report = inspect(&m);
    let size = (0..3).map(|k| report.high[k] - report.low[k]).fold(0.0, f32::max);
    let mut fault = |yes: bool, what: &str| {
        if yes {
            wrong.push(what.into());
        }
    };
    fault(!(8..=30_000).contains(&report.triangles), "count of triangles");
    fault(!report.watertight, "open or torn");
    fault(report.degenerate > 0, "degenerate triangles");
    fault(report.non_finite > 0, "not finite");
    fault(report.volume <= 0.0 || report.inverted > 0, "inside out");
    fault(m.normals.len() != m.positions.len() || m.uvs.len() != m.positions.len(), "attributes missing");
    fault(m.normals.iter().any(|n| (n.length() - 1.0).abs() > 1e-5), "normals not unit");
    fault(inward_normals(&m) > 0, "normals inwards");
    fault(m.uvs.iter().any(|uv| uv.abs().max_element() > 60.0), "texture coordinates out of bounds");
    fault(!(0.05..=6.0).contains(&size), "size");
    let middle: f32 = (0..3).map(|k| (report.low[k] + report.high[k]).abs()).sum();
    fault(middle > 1e-4 * size, "not centred");
    if !wrong.is_empty() {
        wrong.push(format!("{report:?} {}", serde_json::to_string(shape).unwrap()));
    }
    (geometry_hash(&m), wrong)
}

/// Checks every `step`-th mesh of the catalogue.
fn check_catalogue(step: usize) {
    let all: Vec<(usize, (String, Vec<String>))> =
        (0..4096).into_par_iter().filter(|k| (k + k / 52) % step == 0).map(|k| (k, faults(&entry(7, k)))).collect();
    let wrong: Vec<String> = all.iter().filter(|(_, (_, w))| !w.is_empty()).map(|(k, (_, w))| format!("{k}: {w:?}")).collect();
    assert!(
        wrong.is_empty(),
        "{} of {}:\n{}",
        wrong.len(),
        all.len(),
        wrong.iter().take(60).cloned().collect::<Vec<_>>().join("\n")
    );
    let hashes: BTreeSet<&String> = all.iter().map(|(_, (hash, _))| hash).collect();
    assert_eq!(hashes.len(), all.len(), "meshes are alike");
}

#[test]
fn a_part_of_the_catalogue_is_sound_and_without_twins() {
    check_catalogue(8);
}

#[test]
#[ignore = "the whole catalogue: about a minute of one core"]
fn the_whole_catalogue_is_sound_and_without_twins() {
    check_catalogue(1);
}

#[test]
fn every_family_has_a_name_a_group_and_a_stance() {
    let mut groups = BTreeMap::new();
    for &family in FAMILIES {
        let shape = Shape::random_of(family, &mut Seed::root(1).rng());
        assert_eq!(shape.family(), family);
        *groups.entry(shape.group()).or_insert(0) += 1;
        let json = serde_json::to_value(&shape).unwrap();
        assert_eq!(json["family"], family);
        assert_eq!(serde_json::from_value::<Shape>(json).unwrap(), shape);
    }
    assert!(groups.len() >= 10, "{groups:?}");
    assert_eq!(FAMILIES.iter().collect::<BTreeSet<_>>().len(), FAMILIES.len());
    let chair = Shape::random_of("chair", &mut Seed::root(1).rng());
    assert_eq!((chair.group(), chair.stance()), ("furniture", Stance::Upright));
    assert_eq!(Shape::Torus { radius: 1.0, tube: 0.2 }.stance(), Stance::Rim);
}

#[test]
fn random_members_of_a_family_vary() {
    for family in &FAMILIES[2..] {
        let shapes: HashMap<String, u64> = (0..24)
            .map(|i| (serde_json::to_string(&Shape::random_of(family, &mut Seed::root(5).child(family, i).rng())).unwrap(), i))
            .collect();
        assert_eq!(shapes.len(), 24, "{family}");
    }
}

fn from_json(text: &str) -> Shape {
    let shape: Shape = serde_json::from_str(text).expect(text);
    assert_eq!(shape.validate(), [], "{text}");
    shape
}

/// Volume over that of a body scaled to largest extent 1.
fn volume(text: &str) -> f64 {
    inspect(&mesh(&from_json(text))).volume
}

#[test]
fn volumes_agree_with_geometry() {
    let near =
        |found: f64, exact: f64, share: f64| assert!((found / exact - 1.0).abs() < share, "volume {found}, expected {exact}");
    // Menger's sponge keeps 20 of 27 cells a level.
    for levels in [1u32, 2] {
        let text = format!(
            r#"{{"family":"sponge","size":1,"holes":"menger","cells":3,"levels":{levels},"middle":1,"stretch":[1,1,1],"seed":0}}"#
        );
        near(volume(&text), (20.0f64 / 27.0).powi(levels as i32), 1e-6);
    }
    // One metaball is a ball: what the polygoniser makes of it, on its own grid.
    let blob = r#"{"family":"blobs","size":1,"count":2,"melt":0.05,"contrast":1,"spacing":0.3,"seed":4}"#;
    // Two equal balls of radius r with centres d = 0.6 r apart: their union, scaled to a length of 2 r + d along some direction.
    let shape = inspect(&mesh(&from_json(blob)));
    let (d, h) = (0.6f64, 0.7f64);
    let union = 2.0 * (4.0 / 3.0 * PI) - 2.0 * (PI * h * h * (3.0 - h) / 3.0);
    // The box tells the scale: extents are 2 r + d |axis component|.
    let extents: Vec<f64> = (0..3).map(|k| f64::from(shape.high[k] - shape.low[k])).collect();
    // Solve (e_k - 2 r)^2 summed = (d r)^2 for r by bisection.
    let (mut low, mut high) = (0.0, 0.5 * extents.iter().copied().fold(f64::INFINITY, f64::min));
    for _ in 0..60 {
        let r = 0.5 * (low + high);
        let sum: f64 = extents.iter().map(|e| (e - 2.0 * r).powi(2)).sum();
        if sum > (d * r).powi(2) { low = r } else { high = r }
    }
    near(shape.volume, union * low.powi(3), 0.02);
    // A cube of facets, an octahedron, a supertoroid that is a torus.
    let torus = r#"{"family":"supertoroid","size":1,"tube":0.25,"around":1,"section":1,"height":1,"twist":0}"#;
    near(volume(torus), 2.0 * PI * PI * 0.0625 / 2.5f64.powi(3), 0.01);
    let ball = r#"{"family":"displaced","size":1,"base":"ball","relief":"fractal","depth":0,"frequency":1,"stretch":1,"seed":1}"#;
    near(volume(ball), PI / 6.0, 0.005);
}

#[test]
fn hostile_parameters_are_named_and_never_panic() {
    let values = [f64::MAX, -1.0, 0.0, 1e-30, 4294967295.0, 0.5, 1e4];
    for family in &FAMILIES[MODELS..] {
        let json = serde_json::to_value(Shape::random_of(family, &mut Seed::root(2).child(family, 1).rng())).unwrap();
        let fields: Vec<String> = json.as_object().unwrap().keys().cloned().collect();
        for field in fields {
            for value in values {
                let mut broken = json.clone();
                broken[&field] =
                    if value.fract() == 0.0 && value.abs() < 5e9 { serde_json::json!(value as i64) } else { value.into() };
                let Ok(shape) = serde_json::from_value::<Shape>(broken) else { continue };
                let m = mesh(&shape);
                assert!(shape.validate().is_empty() || m.triangles.is_empty(), "{family}/{field} = {value}");
                assert!(m.positions.iter().all(|p| p.is_finite()));
            }
        }
    }
    let Shape::Tower(mut tower) = Shape::random_of("tower", &mut Seed::root(2).rng()) else { panic!("not a tower") };
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        tower.tall = value;
        let shape = Shape::Tower(tower.clone());
        assert_eq!(shape.validate()[0].0, "/tall");
        assert!(mesh(&shape).triangles.is_empty());
    }
}

#[test]
fn ends_of_all_ranges_are_sound() {
    // Every documented range is taken to both its ends, one parameter at a time.
    let schema = renderflow_scenes::schema::json_schema().to_string();
    assert!(schema.contains("Range "), "ranges stand in the schema");
    let wrong: Vec<String> = FAMILIES[MODELS..]
        .par_iter()
        .flat_map_iter(|family| {
            let json = serde_json::to_value(Shape::random_of(family, &mut Seed::root(11).child(family, 0).rng())).unwrap();
            let fields: Vec<String> = json.as_object().unwrap().keys().cloned().collect();
            let mut wrong = Vec::new();
            for field in fields {
                for probe in [-1e9, 1e9] {
                    let mut broken = json.clone();
                    let whole = broken[&field].is_u64();
                    if !broken[&field].is_number() || field == "size" || (whole && probe < 0.0) {
                        continue;
                    }
                    broken[&field] = if whole { serde_json::json!(4_000_000_000u32) } else { probe.into() };
                    let shape: Shape = serde_json::from_value(broken.clone()).unwrap();
                    // "x is outside low..=high" names the end.
                    let Some((_, reason)) = shape.validate().into_iter().next() else { continue };
                    let range = reason.rsplit(' ').next().unwrap_or_default();
                    let (low, high) = range.split_once("..=").expect(&reason);
                    let end: f64 = if probe < 0.0 { low } else { high }.parse().unwrap();
                    broken[&field] = if whole { serde_json::json!(end as u32) } else { end.into() };
                    let shape: Shape = serde_json::from_value(broken).unwrap();
                    let (_, mut faults) = faults(&shape);
                    faults.retain(|f| !f.starts_with("size") && !f.starts_with("texture"));
                    if faults.len() > 1 {
                        wrong.push(format!("{family}/{field} = {end}: {faults:?}"));
                    }
                }
            }
            wrong
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
