//! Scenes at the edge of what a scene can be. Nothing panics, nothing is NaN, and closed meshes stay closed.

mod common;

use common::{camera, check_frame, compile, diffuse, instance, plane, render, scene, sphere};
use glam::{Affine3A, Mat3A, Quat, Vec3, Vec3A};
use renderflow_frame::{Environment, Image};
use renderflow_renderer::accel::{Accel, Scratch};
use renderflow_renderer::ray::Ray;
use renderflow_renderer::{Error, RenderScene, Settings};
use renderflow_scenes::{LoadedScene, Material, Mesh, TextureSlot};
use std::sync::atomic::AtomicBool;

fn small(parts: Vec<(Mesh, Material, Affine3A)>) -> LoadedScene {
    scene(parts, common::sunny(), camera([0.0, 1.0, 4.0], [0.0; 3], 40.0, 13, 9))
}

fn check(loaded: &LoadedScene) -> renderflow_frame::Frame {
    let (frame, stats) = render(&compile(loaded), 4);
    check_frame(&frame);
    assert_eq!(stats.non_finite_samples, 0);
    frame
}

fn triangle(points: [Vec3; 3]) -> Mesh {
    Mesh { name: "triangle".into(), positions: points.to_vec(), triangles: vec![[0, 1, 2]], ..Mesh::default() }
}

#[test]
fn empty_scenes() {
    let frame = check(&small(vec![]));
    assert!(frame.alpha.pixels.iter().all(|&a| a == 0.0));
    check(&small(vec![(Mesh::default(), Material::default(), Affine3A::IDENTITY)]));
    let mut none = small(vec![]);
    none.cameras[0].width = 0;
    none.cameras[0].height = 0;
    check(&none);
}

#[test]
fn single_triangles_of_all_kinds() {
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let frame = check(&small(vec![(triangle([-x, x, y]), Material::default(), Affine3A::IDENTITY)]));
    assert!(frame.alpha.pixels.iter().any(|&a| a > 0.0));
    for points in [
        [Vec3::ZERO; 3],
        [x, x, y],
        [-x, Vec3::ZERO, x],
        [x * 1e-20, y * 1e-20, z * 1e-20],
        [x * 1e11, y * 1e11, z * 1e11],
        [x * 1e30, y, z],
        [Vec3::splat(f32::NAN), x, y],
        [x, y, Vec3::splat(f32::INFINITY)],
        [-x, x, Vec3::new(0.0, 1e-30, 0.0)],
    ] {
        check(&small(vec![(triangle(points), Material::default(), Affine3A::IDENTITY)]));
        // A normal that says nothing must not reach the picture.
        let mesh = Mesh { normals: vec![Vec3::ZERO; 3], ..triangle(points) };
        check(&small(vec![(mesh, Material::default(), Affine3A::IDENTITY)]));
    }
}

#[test]
fn transforms_that_flatten_mirror_and_explode() {
    for scale in [
        Vec3::new(1.0, 0.0, 1.0),
        Vec3::ZERO,
        Vec3::new(-1.0, 1.0, 1.0),
        Vec3::splat(1e-15),
        Vec3::splat(1e15),
        Vec3::splat(1e38),
        Vec3::new(f32::NAN, 1.0, 1.0),
    ] {
        check(&small(vec![(sphere(8, true), Material::default(), Affine3A::from_scale(scale))]));
    }
    // A mirrored sphere looks like a sphere: its normals still point at the camera and outwards.
    let mirrored = check(&small(vec![(sphere(8, true), Material::default(), Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0)))]));
    let straight = check(&small(vec![(sphere(8, true), Material::default(), Affine3A::IDENTITY)]));
    for (a, b) in mirrored.normal.pixels.iter().zip(&straight.normal.pixels) {
        assert!(Vec3A::from_array(*a).distance(Vec3A::from_array(*b)) < 1e-3);
    }
}

#[test]
fn camera_inside_an_object() {
    for smooth in [false, true] {
        let mut loaded = small(vec![(sphere(16, smooth), diffuse([0.5; 3]), Affine3A::IDENTITY)]);
        loaded.cameras[0] = camera([0.1, 0.2, 0.3], [1.0, 0.0, 0.0], 90.0, 24, 24);
        let frame = check(&loaded);
        // A closed sphere lets nothing in: a single lit sample would be a leak.
        assert!(frame.alpha.pixels.iter().all(|&a| a == 1.0));
        assert!(frame.beauty.expect("rendered").pixels.iter().all(|p| *p == [0.0; 3]), "light leaks in");
    }
}

#[test]
fn camera_in_the_plane_of_a_surface() {
    let mut loaded = small(vec![(plane(2.0), Material::default(), Affine3A::IDENTITY)]);
    // Odd sizes put a row of pixel centres exactly in the plane, and a column exactly in x = 0.
    loaded.cameras[0] = camera([0.0, 0.0, 3.0], [0.0; 3], 40.0, 15, 15);
    check(&loaded);
    loaded.cameras[0] = camera([0.0; 3], [0.0, -1.0, 0.0], 40.0, 15, 15);
    check(&loaded);
}

#[test]
fn extreme_environments() {
    for environment in [
        Environment::constant([0.0; 3]),
        Environment::constant([1e-38; 3]),
        Environment::constant([1e30; 3]),
        Environment { intensity: 0.0, ..common::sunny() },
        Environment { intensity: 1e20, ..common::sunny() },
    ] {
        let mut loaded = small(vec![(sphere(8, true), Material::default(), Affine3A::IDENTITY)]);
        loaded.environment = environment;
        let (frame, _) = render(&compile(&loaded), 4);
        assert!(frame.raw.expect("rendered").pixels.iter().flatten().all(|v| v.is_finite()));
    }
}

/// Radiance that would overflow is limited and counted before anything is traced; no sample is lost to it.
#[test]
fn overflow_is_limited_and_counted() {
    let mut loaded = small(vec![
        (plane(4.0), diffuse([1.0; 3]), Affine3A::from_translation(Vec3::NEG_Y)),
        (sphere(8, true), diffuse([1.0; 3]), Affine3A::IDENTITY),
    ]);
    // Two gathered directions of such a sky would already be too much.
    let map = Image::from_fn(8, 4, |x, _| [1.0 - 0.01 * x as f32; 3]);
    loaded.environment = Environment { map, rotation: 0.0, intensity: f32::MAX };
    let compiled = compile(&loaded);
    assert_eq!(compiled.environment_repairs().limited, 8 * 4 * 3);
    let (frame, stats) = render(&compiled, 64);
    assert_eq!(stats.non_finite_samples, 0);
    check_frame(&frame);
    let brightest = frame.raw.expect("rendered").pixels.iter().flatten().copied().fold(0.0, f32::max);
    assert!((brightest / 1e32 - 1.0).abs() < 0.5, "{brightest}");
}

#[test]
fn thousands_of_identical_and_nested_triangles() {
    let one = triangle([-Vec3::X, Vec3::X, Vec3::Y]);
    let many = Mesh { triangles: vec![[0, 1, 2]; 20_000], ..one };
    check(&small(vec![(many, Material::default(), Affine3A::IDENTITY)]));
    // Nested: each half the size of the one before, forty orders of magnitude deep.
    let mut nested = Mesh { name: "nested".into(), ..Mesh::default() };
    for i in 0..400u32 {
        let s = 0.8f32.powi(i as i32);
        nested.positions.extend([Vec3::new(-s, -s, 0.0), Vec3::new(s, -s, 0.0), Vec3::new(0.0, s, 0.0)]);
        nested.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    check(&small(vec![(nested, Material::default(), Affine3A::IDENTITY)]));
}

#[test]
fn many_instances_of_one_mesh() {
    let mut loaded = small(vec![(sphere(6, true), Material::default(), Affine3A::IDENTITY)]);
    for i in 0..200u8 {
        let (a, r) = (f32::from(i) * 2.4, f32::from(i) * 0.01);
        let place = Affine3A::from_scale_rotation_translation(
            Vec3::splat(0.05),
            Quat::IDENTITY,
            Vec3::new(r * a.cos(), r * a.sin(), 1.2),
        );
        loaded.instances.push(instance(0, 0, place));
    }
    assert_eq!(compile(&loaded).triangle_count(), loaded.meshes[0].triangles.len() * 201);
    check(&loaded);
}

#[test]
fn references_that_lead_nowhere_are_errors() {
    let place = |change: &dyn Fn(&mut LoadedScene)| {
        let mut loaded = small(vec![(sphere(4, true), Material::default(), Affine3A::IDENTITY)]);
        change(&mut loaded);
        match RenderScene::compile(&loaded) {
            Err(Error::Inconsistent { place, .. }) => place,
            Err(other) => panic!("{other}"),
            Ok(_) => panic!("accepted"),
        }
    };
    assert_eq!(place(&|s| s.cameras.clear()), "cameras");
    assert_eq!(place(&|s| s.instances[0].mesh = 7), "instances/0/mesh");
    assert_eq!(place(&|s| s.instances[0].material = 7), "instances/0/material");
    assert_eq!(place(&|s| s.instances[0].transforms.clear()), "instances/0/transforms");
    assert_eq!(place(&|s| s.meshes[0].triangles[3][1] = 9999), "meshes/0/triangles/3");
    assert_eq!(place(&|s| s.meshes[0].normals.truncate(5)), "meshes/0/normals");
    assert_eq!(place(&|s| s.materials[0].surface.roughness = f32::NAN), "materials/0");
    let slot = TextureSlot::default();
    assert_eq!(place(&|s| s.materials[0].base_color_texture = Some(slot.clone())), "materials/0");
}

#[test]
fn settings_out_of_range_and_cancelling_are_errors() {
    let compiled = compile(&small(vec![]));
    let cancel = AtomicBool::new(true);
    let result = renderflow_renderer::render(&compiled, &Settings::default(), &|_, _| (), &cancel);
    assert!(matches!(result, Err(Error::Cancelled)));
    for settings in [
        Settings { spp: 0, ..Settings::default() },
        Settings { spp: u32::MAX, ..Settings::default() },
        Settings { max_bounces: 0, ..Settings::default() },
        Settings { guide_samples: 0, ..Settings::default() },
    ] {
        let result = renderflow_renderer::render(&compiled, &settings, &|_, _| (), &AtomicBool::new(false));
        assert!(matches!(result, Err(Error::Setting { .. })));
    }
}

/// From inside a closed mesh every ray must hit, above all those aimed at its edges and vertices.
#[test]
fn closed_meshes_do_not_leak() {
    let mesh = sphere(24, false);
    let mut scratch = Scratch::default();
    for (scale, offset) in [(1.0, 0.0), (1e-5, 0.0), (1e-3, 0.0), (1e5, 0.0), (1.0, 10.0), (1.0, 1000.0)] {
        let transform = Affine3A {
            matrix3: Mat3A::from_quat(Quat::from_euler(glam::EulerRot::XYZ, 0.3, 0.7, 1.1)) * scale,
            translation: Vec3A::splat(offset),
        };
        let positions: Vec<Vec3A> = mesh.positions.iter().map(|&p| transform.transform_point3a(p.into())).collect();
        let triangles: Vec<[Vec3A; 3]> = mesh.triangles.iter().map(|t| t.map(|v| positions[v as usize])).collect();
        let accel = Accel::build(&triangles);
        assert_eq!(accel.triangle_count(), triangles.len());
        let (mut aimed, mut missed) = ([0usize; 3], [0usize; 3]);
        for o in 0..6u8 {
            let o = f32::from(o);
            let inside = Vec3A::new(0.5 * (o * 1.3).sin(), 0.6 * (o * 2.1).cos(), 0.5 * (o * 0.7).sin());
            let origin = transform.transform_point3a(inside);
            let mut shoot = |kind: usize, target: Vec3A| {
                let ray = Ray::new(origin, (target - origin).normalize());
                aimed[kind] += 1;
                let hit = accel.closest(&ray, &mut scratch);
                missed[kind] += usize::from(hit.is_none() || !accel.occluded(&ray, &mut scratch));
                if let Some(hit) = hit {
                    let sum: f32 = hit.weights.iter().sum();
                    assert!((sum - 1.0).abs() < 1e-5 && hit.weights.iter().all(|w| (-1e-6..=1.000_001).contains(w)));
                }
            };
            for t in &triangles {
                for k in 0..3 {
                    shoot(0, t[k]);
                    shoot(1, t[k].lerp(t[(k + 1) % 3], 0.5));
                    shoot(1, t[k].lerp(t[(k + 1) % 3], 0.137));
                }
                shoot(2, (t[0] + t[1] + t[2]) / 3.0);
            }
        }
        println!("scale {scale}, offset {offset}: missed {missed:?} of {aimed:?} (vertices, edges, faces)");
        assert_eq!(missed, [0; 3]);
    }
}

/// Rays along the axes, through box faces and vertices that lie exactly on them.
#[test]
fn axis_aligned_rays_hit() {
    let mut mesh = plane(2.0);
    mesh.positions.push(Vec3::ZERO);
    mesh.triangles = vec![[0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]];
    let triangles: Vec<[Vec3A; 3]> = mesh.triangles.iter().map(|t| t.map(|v| Vec3A::from(mesh.positions[v as usize]))).collect();
    let accel = Accel::build(&triangles);
    let mut scratch = Scratch::default();
    for x in [-1.0, -0.5, 0.0, 0.25, 1.0] {
        for z in [-1.0, -0.25, 0.0, 0.5, 1.0] {
            for direction in [Vec3A::NEG_Y, Vec3A::new(0.0, -1.0, -0.0)] {
                let hit = accel.closest(&Ray::new(Vec3A::new(x, 3.0, z), direction), &mut scratch);
                assert_eq!(hit.map(|h| h.t), Some(3.0), "{x} {z}");
            }
        }
    }
}

/// The nearest hit is the nearest: against testing all triangles one by one in double precision.
#[test]
fn nearest_hit_agrees_with_brute_force() {
    let mut triangles = Vec::new();
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
    };
    for _ in 0..2000 {
        let c = Vec3A::new(random(), random(), random());
        triangles.push([0, 1, 2].map(|_| c + 0.2 * Vec3A::new(random(), random(), random())));
    }
    let accel = Accel::build(&triangles);
    let mut scratch = Scratch::default();
    let (mut hits, mut apart) = (0, 0);
    for _ in 0..2000 {
        let origin = 2.0 * Vec3A::new(random(), random(), random());
        let direction = (0.8 * Vec3A::new(random(), random(), random()) - origin).normalize();
        let expected = triangles
            .iter()
            .filter_map(|t| {
                let [a, b, c] = t.map(|v| v.as_dvec3());
                let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
                let (e1, e2) = (b - a, c - a);
                let p = d.cross(e2);
                let det = e1.dot(p);
                let s = o - a;
                let (u, q) = (s.dot(p) / det, s.cross(e1));
                let (v, t) = (d.dot(q) / det, e2.dot(q) / det);
                (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
            })
            .min_by(f64::total_cmp);
        let found = accel.closest(&Ray::new(origin, direction), &mut scratch).map(|h| f64::from(h.t));
        hits += usize::from(expected.is_some());
        // A ray within rounding of an outline may go either way.
        let same = match (expected, found) {
            (Some(a), Some(b)) => (a - b).abs() < 1e-5,
            (None, None) => true,
            _ => false,
        };
        apart += usize::from(!same);
    }
    println!("{hits} hits, {apart} rays decided otherwise than in double precision");
    assert!(hits > 1000 && apart <= 1);
}

/// Shapes that break tree builders: all in one plane, boxes within boxes, needles, the same triangle again and again. Each is
/// built and every ray aimed at the middle of a triangle hits. Times are printed; 1e6 needles took 0.6 s on one busy core.
#[test]
fn trees_over_degenerate_triangles() {
    let mut state = 7u32;
    let mut random = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
    };
    let mut any = || Vec3A::new(random(), random(), random());
    let flat = |p: Vec3A| Vec3A::new(p.x, 0.0, p.z);
    let nested = |i: u32, k: usize| {
        let s = 0.999f32.powi(i as i32);
        [[-s, -s, s], [s, -s, -s], [0.0, s, s]].map(Vec3A::from_array)[k]
    };
    let needles = if cfg!(debug_assertions) { 10_000 } else { 1_000_000 };
    let shapes: Vec<(&str, Vec<[Vec3A; 3]>)> = vec![
        ("identical", vec![[Vec3A::ZERO, Vec3A::X, Vec3A::Z]; 20_000]),
        (
            "in one plane",
            (0..20_000)
                .map(|_| {
                    let c = any();
                    [flat(c), flat(c + 0.05 * any()), flat(c + 0.05 * any())]
                })
                .collect(),
        ),
        ("nested", (0..20_000).map(|i| [0, 1, 2].map(|k| nested(i, k))).collect()),
        (
            "needles",
            (0..needles)
                .map(|_| {
                    let (c, d) = (any(), any());
                    [c, c + d, c + d + 1e-6 * any()]
                })
                .collect(),
        ),
    ];
    for (name, triangles) in shapes {
        let begin = std::time::Instant::now();
        let accel = Accel::build(&triangles);
        println!("{name}: {} triangles built in {:.2?}", triangles.len(), begin.elapsed());
        assert_eq!(accel.triangle_count(), triangles.len());
        let mut scratch = Scratch::default();
        let (mut aimed, mut missed) = (0, 0);
        for t in triangles.iter().step_by(triangles.len() / 2000) {
            let middle = (t[0] + t[1] + t[2]) / 3.0;
            let origin = middle + (t[1] - t[0]).cross(t[2] - t[0]).normalize_or(Vec3A::Y);
            let ray = Ray::new(origin, (middle - origin).normalize());
            aimed += 1;
            let hit = accel.closest(&ray, &mut scratch);
            assert!(hit.is_none_or(|h| h.t.is_finite() && h.weights.iter().all(|w| w.is_finite())));
            missed += usize::from(hit.is_none());
        }
        println!("  {missed} of {aimed} rays missed");
        // A needle can be thinner than the rounding of a ray that starts 1 away from it.
        assert!(missed == 0 || name == "needles", "{name}: {missed}");
    }
}
