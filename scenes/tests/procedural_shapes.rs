//! Meshes of the parametric shapes: closed, outward, well formed, and of the volume that geometry says.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use renderflow_scenes::Mesh;
use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::{FAMILIES, Shape, mesh};
use std::collections::{HashMap, HashSet};
use std::f64::consts::PI;

fn corners(mesh: &Mesh, triangle: [u32; 3]) -> [DVec3; 3] {
    triangle.map(|i| mesh.positions[i as usize].as_dvec3())
}

fn volume(mesh: &Mesh) -> f64 {
    mesh.triangles.iter().map(|&t| corners(mesh, t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

/// Everything a renderer relies on.
fn check(shape: &Shape) {
    assert_eq!(shape.validate(), [], "{shape:?}");
    let m = mesh(shape);
    assert!((1..=20_000).contains(&m.triangles.len()), "{shape:?} has {} triangles", m.triangles.len());
    assert_eq!((m.normals.len(), m.uvs.len()), (m.positions.len(), m.positions.len()));
    assert!(m.positions.iter().all(|p| p.is_finite()) && m.uvs.iter().all(|p| p.is_finite()), "{shape:?} is not finite");
    assert!(m.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-5), "{shape:?} has a normal that is not unit");

    let (low, high) = m.positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
    let extent = (high - low).length();
    assert!((low + high).length() < 1e-4 * extent, "{shape:?} is not centred: {low} {high}");

    // Seams and creases repeat positions bit for bit; edges are compared by position.
    let mut ids = HashMap::new();
    let id: Vec<usize> = m
        .positions
        .iter()
        .map(|p| {
            let next = ids.len();
            *ids.entry(p.to_array().map(|v| (v + 0.0).to_bits())).or_insert(next)
        })
        .collect();
    let mut edges = HashSet::new();
    for &triangle in &m.triangles {
        let [a, b, c] = corners(&m, triangle);
        let area = (b - a).cross(c - a);
        let sides = [a.distance(b), b.distance(c), c.distance(a)];
        let (long, short) = (sides.iter().copied().fold(0.0, f64::max), sides.iter().copied().fold(f64::INFINITY, f64::min));
        // Needles are fine, three corners in a line are not.
        assert!(area.length() > 1e-4 * long * short && short > 0.0, "{shape:?}: degenerate triangle {a} {b} {c}");
        let shading: DVec3 = triangle.iter().map(|&i| m.normals[i as usize].as_dvec3()).sum();
        assert!(shading.dot(area) > 0.0, "{shape:?}: normals look inwards at {a}");
        for k in 0..3 {
            let edge = (id[triangle[k] as usize], id[triangle[(k + 1) % 3] as usize]);
            assert!(edges.insert(edge), "{shape:?}: an edge is walked twice in one direction at {a}");
        }
    }
    if shape.is_solid() {
        let open = edges.iter().filter(|&&(a, b)| !edges.contains(&(b, a))).count();
        assert_eq!(open, 0, "{shape:?} has open edges");
        assert!(volume(&m) > 0.0, "{shape:?} is inside out: volume {}", volume(&m));
    }
}

#[test]
fn random_shapes_of_the_first_families_are_closed_outward_and_well_formed() {
    FAMILIES[..19].par_iter().for_each(|family| {
        for i in 0..16 {
            let shape = Shape::random_of(family, &mut Seed::root(9).child(family, i).rng());
            assert_eq!(shape.family(), *family);
            check(&shape);
        }
    });
}

#[test]
fn shapes_at_the_ends_of_their_ranges_are_well_formed() {
    let json = [
        r#"{"family":"box","size":[0.01,10000,1],"bevel":0}"#,
        r#"{"family":"box","size":[1,1,1],"bevel":0.5}"#,
        r#"{"family":"cylinder","radius":0.3,"height":0.6,"bevel":0.3}"#,
        r#"{"family":"cylinder","radius":1000,"height":0.01}"#,
        r#"{"family":"cone","radius":0.01,"top_radius":5,"height":1}"#,
        r#"{"family":"capsule","radius":0.5,"height":1}"#,
        r#"{"family":"torus","radius":0.5,"tube":0.475}"#,
        r#"{"family":"torus_knot","p":7,"q":6,"radius":0.5,"tube":0.005}"#,
        r#"{"family":"torus_knot","p":1,"q":7,"radius":100,"tube":5}"#,
        r#"{"family":"superellipsoid","size":[1,1,1],"vertical":0.2,"horizontal":0.2}"#,
        r#"{"family":"superellipsoid","size":[1,2,1],"vertical":2.5,"horizontal":2.5}"#,
        r#"{"family":"superellipsoid","size":[1,2,1],"vertical":0.2,"horizontal":2.5}"#,
        r#"{"family":"lathe","radii":[0.01,100],"height":100}"#,
        r#"{"family":"lathe","radii":[0.5,0.1,0.5,0.1,0.5],"height":1,"wall":0.05}"#,
        r#"{"family":"prism","sides":24,"radius":0.5,"height":1,"star":0.2,"twist":360,"taper":0.1}"#,
        r#"{"family":"prism","sides":3,"radius":0.5,"height":1,"taper":1.5}"#,
        r#"{"family":"gear","teeth":48,"radius":0.5,"depth":0.4,"hole":0.5,"height":0.1}"#,
        r#"{"family":"gear","teeth":5,"radius":100,"depth":0.03,"hole":0.05,"height":0.01}"#,
        r#"{"family":"spring","radius":0.5,"tube":0.005,"turns":12,"height":1}"#,
        r#"{"family":"spring","radius":0.05,"tube":0.03,"turns":0.5,"height":0.05}"#,
        r#"{"family":"rock","radius":0.5,"roughness":0.6,"frequency":6,"seed":4294967295}"#,
        r#"{"family":"arch","width":1,"height":0.5,"depth":0.1,"thickness":0.45}"#,
        r#"{"family":"stairs","steps":24,"size":[1,1,1]}"#,
        r#"{"family":"supershape","lobes":0,"vertical_lobes":0,"n":20,"k":20,"size":1}"#,
        r#"{"family":"supershape","lobes":16,"vertical_lobes":2,"n":1,"k":20,"size":1}"#,
    ];
    for text in json {
        check(&serde_json::from_str(text).expect(text));
    }
}

#[test]
fn volumes_agree_with_geometry() {
    // Polygons lie inside the curve, so the mesh may fall a little short, by about (2/3) (pi / segments)^2 a circle.
    let near = |shape: Shape, exact: f64| {
        let v = volume(&mesh(&shape));
        assert!((v / exact - 1.0).abs() < 0.012, "{shape:?}: volume {v}, expected {exact}");
    };
    near(Shape::Box { size: [1.0, 2.0, 3.0], bevel: 0.0 }, 6.0);
    // A rounded box is a smaller box swept by a ball (Steiner's formula).
    let (x, y, z, r) = (0.8, 1.8, 2.8, 0.1);
    let steiner = x * y * z + 2.0 * r * (x * y + y * z + z * x) + PI * r * r * (x + y + z) + 4.0 / 3.0 * PI * r.powi(3);
    near(Shape::Box { size: [1.0, 2.0, 3.0], bevel: 0.1 }, steiner);
    near(Shape::Sphere { radius: 0.5 }, PI / 6.0);
    near(Shape::Cylinder { radius: 0.5, height: 2.0, bevel: 0.0 }, 0.5 * PI);
    near(Shape::Cone { radius: 0.5, top_radius: 0.0, height: 1.0 }, PI / 12.0);
    near(Shape::Cone { radius: 0.5, top_radius: 0.25, height: 1.0 }, PI / 3.0 * (0.25 + 0.125 + 0.0625));
    near(Shape::Capsule { radius: 0.25, height: 1.0 }, PI * 0.0625 * 0.5 + 4.0 / 3.0 * PI * 0.015_625);
    near(Shape::Torus { radius: 0.4, tube: 0.1 }, 2.0 * PI * PI * 0.4 * 0.01);
    near(Shape::Pipe { radius: 0.5, inner_radius: 0.4, height: 1.0 }, PI * (0.25 - 0.16));
    near(Shape::Superellipsoid { size: [1.0, 2.0, 0.5], vertical: 1.0, horizontal: 1.0 }, PI / 6.0);
    let hexagon = 1.5 * 3.0f64.sqrt() * 0.25;
    near(Shape::Prism { sides: 6, radius: 0.5, height: 1.0, star: None, twist: 0.0, taper: 1.0 }, hexagon);
    near(Shape::Prism { sides: 6, radius: 0.5, height: 1.0, star: None, twist: 0.0, taper: 0.5 }, hexagon * 7.0 / 12.0);
    near(Shape::Arch { width: 1.0, height: 1.0, depth: 0.5, thickness: 0.2 }, 0.5 * (0.5 * PI * (0.25 - 0.09) + 2.0 * 0.2 * 0.5));
    near(Shape::Stairs { steps: 4, size: [1.0, 1.0, 1.0] }, 10.0 / 16.0);
    near(Shape::Rock { radius: 0.5, roughness: 0.0, frequency: 1.0, seed: 0, facets: false }, PI / 6.0);
    // Pappus: cross-section times the length of the helix.
    let length = ((2.0 * PI * 0.3 * 3.0f64).powi(2) + 1.0).sqrt();
    near(Shape::Spring { radius: 0.3, tube: 0.05, turns: 3.0, height: 1.0 }, 0.974 * PI * 0.0025 * length);
}

#[test]
fn smooth_normals_follow_the_surface() {
    let m = mesh(&Shape::Sphere { radius: 0.5 });
    for (p, n) in m.positions.iter().zip(&m.normals) {
        assert!(n.dot(p.normalize()) > 0.9995, "{n} at {p}");
    }
    // Sharp boxes keep flat faces.
    let m = mesh(&Shape::Box { size: [1.0; 3], bevel: 0.0 });
    assert!(m.normals.iter().all(|n| n.abs().max_element() > 0.999_999));
}

#[test]
fn parameters_out_of_range_are_named_and_never_panic() {
    let bad = |json: &str, pointer: &str| {
        let shape: Shape = serde_json::from_str(json).expect(json);
        let faults = shape.validate();
        assert!(faults.iter().any(|(at, _)| at == pointer), "{json}: {faults:?}");
        // The mesh may be odd, but making it is safe.
        mesh(&shape);
    };
    bad(r#"{"family":"plane","size":0}"#, "/size");
    bad(r#"{"family":"box","size":[1,-1,1]}"#, "/size/1");
    bad(r#"{"family":"box","size":[1,1,1],"bevel":0.6}"#, "/bevel");
    bad(r#"{"family":"sphere","radius":-1}"#, "/radius");
    bad(r#"{"family":"torus","radius":0.5,"tube":0.5}"#, "/tube");
    bad(r#"{"family":"torus_knot","p":2,"q":4,"radius":0.5,"tube":0.05}"#, "/q");
    bad(r#"{"family":"torus_knot","p":4000000000,"q":0,"radius":0.5,"tube":0.05}"#, "/p");
    bad(r#"{"family":"lathe","radii":[],"height":1}"#, "/radii");
    bad(r#"{"family":"prism","sides":4000000000,"radius":1,"height":1}"#, "/sides");
    bad(r#"{"family":"gear","teeth":0,"radius":0.5,"depth":0.2,"hole":0.2,"height":0.1}"#, "/teeth");
    bad(r#"{"family":"spring","radius":0.5,"tube":0.05,"turns":1e30,"height":1}"#, "/turns");
    bad(r#"{"family":"stairs","steps":4000000000,"size":[1,1,1]}"#, "/steps");
    bad(r#"{"family":"supershape","lobes":3,"vertical_lobes":2,"n":0,"k":0,"size":1}"#, "/n");
    for value in [f32::NAN, f32::INFINITY, -f32::INFINITY] {
        let shape = Shape::Capsule { radius: value, height: value };
        assert!(!shape.validate().is_empty());
        mesh(&shape);
    }
}

#[test]
fn unknown_families_and_fields_are_refused() {
    assert!(serde_json::from_str::<Shape>(r#"{"family":"teapot"}"#).is_err());
    assert!(serde_json::from_str::<Shape>(r#"{"family":"sphere","radius":1,"colour":2}"#).is_err());
}
