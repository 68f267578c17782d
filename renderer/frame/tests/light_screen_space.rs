//! Screen-space occlusion and shadows against closed forms and against rays traced through the same analytic scene.

mod light_scene;

use glam::{Vec3, Vec3A};
use light_scene::{Surface, point, render, trace};
use renderflow_frame::environment::Environment;
use renderflow_frame::ibl::{IblTables, Shading, shade};
use renderflow_frame::image::Rgb;
use renderflow_frame::screen_space::features;
use renderflow_frame::{Camera, Frame};

const SIZE: usize = 128;

/// A dim sky with a small bright sun.
fn sunny(direction: Vec3A) -> Environment {
    let plain = Environment { map: Rgb::filled(256, 128, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map =
        Rgb::from_fn(256, 128, |x, y| [if plain.texel_direction(x, y).angle_between(direction) < 0.05 { 500.0 } else { 0.3 }; 3]);
    Environment { map, ..plain }
}

fn shaded(frame: &Frame, camera: &Camera, environment: &Environment) -> Shading {
    shade(frame, camera, environment, &IblTables::new(&Environment::constant([1.0; 3])))
}

fn view(eye: Vec3A, target: Vec3A) -> Camera {
    Camera::look_at(eye, target, Vec3A::Y, 0.7, SIZE, SIZE)
}

/// Cosine-weighted directions about `n`, the same for every call.
fn hemisphere(n: Vec3A, count: usize) -> impl Iterator<Item = Vec3A> {
    let (t, b) = Vec3::from(n).any_orthonormal_pair();
    (0..count).map(move |i| {
        let (r, phi) = (((i as f32 + 0.5) / count as f32).sqrt(), 2.399_963 * i as f32);
        Vec3A::from(t * (r * phi.cos()) + b * (r * phi.sin())) + n * (1.0 - r * r).sqrt()
    })
}

#[test]
fn an_open_plane_is_unoccluded() {
    for eye in [Vec3A::new(0.0, 2.0, 3.0), Vec3A::new(1.0, 0.4, 2.0), Vec3A::new(0.0, 4.0, 0.01)] {
        let camera = view(eye, Vec3A::ZERO);
        let frame = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Y)], &camera);
        let sun = Vec3A::new(0.4, 0.6, 0.3).normalize();
        let environment = sunny(sun);
        let found = features(&shaded(&frame, &camera, &environment), &camera, &environment);
        let up = camera.world_to_camera().matrix3 * Vec3A::Y;
        for i in 0..SIZE * SIZE {
            let covered = frame.depth.pixels[i].is_finite();
            assert!(
                found.occlusion.pixels[i] > 0.99 && found.occlusion.pixels[i] <= 1.0,
                "{} at depth {}",
                found.occlusion.pixels[i],
                frame.depth.pixels[i]
            );
            assert!(found.light_visibility.pixels[i] > 0.999, "shadow on an open plane: {}", found.light_visibility.pixels[i]);
            let bent = Vec3A::from_array(found.bent_normal.pixels[i]);
            if covered {
                assert!(bent.angle_between(up) < 0.05 && (bent.length() - 1.0).abs() < 1e-5, "{bent} {up}");
            } else {
                assert_eq!(bent, Vec3A::ZERO);
            }
        }
    }
}

#[test]
fn a_corner_hides_half_the_hemisphere() {
    // Floor and wall at right angles. Deep in the corner half of the cosine-weighted hemisphere is hidden, and a wall of height h at
    // distance d hides (1 - d / sqrt(d^2 + h^2)) / 2.
    let camera = view(Vec3A::new(0.0, 1.5, 2.5), Vec3A::new(0.0, 0.3, 0.0));
    let frame = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Y), Surface::Plane(Vec3A::ZERO, Vec3A::Z)], &camera);
    let environment = Environment::constant([1.0; 3]);
    let found = features(&shaded(&frame, &camera, &environment), &camera, &environment);
    let (mut deep, mut deep_count) = (0.0, 0);
    for i in 0..SIZE * SIZE {
        let p = point(&frame, &camera, i);
        let d = p.y.max(p.z);
        if d > 0.03 && d < 0.1 && p.x.abs() < 0.4 {
            deep += found.occlusion.pixels[i];
            deep_count += 1;
            // The open quarter is symmetric about 45 degrees: the bent normal leans from the surface towards it.
            let bent = camera.camera_to_world.matrix3 * Vec3A::from_array(found.bent_normal.pixels[i]);
            assert!(bent.x.abs() < 0.2 && bent.y > 0.3 && bent.z > 0.3, "{bent}");
        }
        // Without a dominant light nothing is in its shadow.
        assert_eq!(found.light_visibility.pixels[i], 1.0);
    }
    let deep = deep / deep_count as f32;
    println!("deep in the corner: {deep} over {deep_count} pixels");
    assert!((deep - 0.55).abs() < 0.06, "{deep}");
    // Along the floor, towards the camera, occlusion only fades.
    let column = SIZE / 2;
    let mut last = 0.0;
    for row in 0..SIZE {
        let i = row * SIZE + column;
        if frame.object_id.pixels[i] == 1 && point(&frame, &camera, i).z > 0.05 {
            assert!(found.occlusion.pixels[i] > last - 0.03, "row {row}");
            last = found.occlusion.pixels[i].max(last);
        }
    }
    assert!(last > 0.75, "{last}");
}

/// Objects on a floor as dense as in the composed scenes.
fn still_life() -> Vec<Surface> {
    vec![
        Surface::Plane(Vec3A::ZERO, Vec3A::Y),
        Surface::Sphere(Vec3A::new(-0.5, 0.4, 0.1), 0.4),
        Surface::Sphere(Vec3A::new(0.1, 0.2, 0.6), 0.2),
        Surface::Block(Vec3A::new(0.2, 0.0, -0.5), Vec3A::new(0.7, 0.9, 0.0)),
        Surface::Block(Vec3A::new(-0.9, 0.0, -0.9), Vec3A::new(-0.1, 0.3, -0.6)),
    ]
}

#[test]
fn occlusion_and_shadow_follow_traced_rays() {
    let scene = still_life();
    let sun = Vec3A::new(-0.6, 0.7, 0.5).normalize();
    let environment = sunny(sun);
    let mut count = 0;
    // Sums of absolute differences; the `plain` ones are of no occlusion, the normal, and no shadow.
    let (mut error, mut plain, mut bias, mut bent_error, mut bent_plain) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let (mut shadow_right, mut shadow_plain) = (0, 0);
    for eye in [Vec3A::new(0.9, 1.5, 2.6), Vec3A::new(-2.2, 0.7, 1.5), Vec3A::new(-0.4, 2.4, -1.6)] {
        let camera = view(eye, Vec3A::new(0.0, 0.25, 0.0));
        let frame = render(&scene, &camera);
        let found = features(&shaded(&frame, &camera, &environment), &camera, &environment);
        for i in (0..SIZE * SIZE).step_by(5) {
            if !frame.depth.pixels[i].is_finite() {
                continue;
            }
            let n = camera.camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[i]);
            let p = point(&frame, &camera, i) + n * 1e-3;
            let open: Vec<Vec3A> = hemisphere(n, 256).filter(|d| trace(&scene, p, *d).is_none()).collect();
            let truth = open.len() as f32 / 256.0;
            count += 1;
            error += (found.occlusion.pixels[i] - truth).abs();
            bias += found.occlusion.pixels[i] - truth;
            plain += 1.0 - truth;
            if let Some(bent) = open.iter().sum::<Vec3A>().try_normalize() {
                bent_error += bent.angle_between(camera.camera_to_world.matrix3 * Vec3A::from_array(found.bent_normal.pixels[i]));
                bent_plain += bent.angle_between(n);
            }
            let lit = n.dot(sun) > 0.0 && trace(&scene, p, sun).is_none();
            shadow_right += usize::from((found.light_visibility.pixels[i] > 0.5) == lit);
            shadow_plain += usize::from((n.dot(sun) > 0.0) == lit);
        }
    }
    let n = count as f32;
    let (shadow_right, shadow_plain) = (shadow_right as f32 / n, shadow_plain as f32 / n);
    println!("occlusion off by {:.4} (bias {:.4}; without any: {:.4})", error / n, bias / n, plain / n);
    println!("bent normal off by {:.4} rad (normal: {:.4})", bent_error / n, bent_plain / n);
    println!("shadow right on {shadow_right:.4} (n.l alone: {shadow_plain:.4})");
    assert!(error < 0.5 * plain && bent_error < 0.65 * bent_plain);
    assert!(1.0 - shadow_right < 0.5 * (1.0 - shadow_plain));
}

#[test]
fn thread_count_does_not_change_a_bit() {
    let camera = view(Vec3A::new(0.9, 1.2, 2.6), Vec3A::new(0.0, 0.25, 0.0));
    let frame = render(&still_life(), &camera);
    let environment = sunny(Vec3A::new(-0.6, 0.5, 0.5).normalize());
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let tables = IblTables::new(&environment);
            let shading = shade(&frame, &camera, &environment, &tables);
            let space = features(&shading, &camera, &environment);
            let tokens = environment.tokens(&camera, 8);
            (shading.image, space.occlusion, space.bent_normal, space.light_visibility, tokens)
        })
    };
    let one = run(1);
    for threads in [2, 3, 7] {
        assert!(run(threads) == one, "{threads} threads differ");
    }
}

#[test]
fn unknown_depth_and_odd_normals_stay_finite() {
    let camera = view(Vec3A::new(0.9, 1.2, 2.6), Vec3A::ZERO);
    let mut frame = render(&still_life(), &camera);
    for i in (0..SIZE * SIZE).step_by(7) {
        frame.normal.pixels[i] = [[0.0; 3], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]][i % 3];
        frame.depth.pixels[i] = [f32::INFINITY, 1e-6, 1e6][i / 7 % 3];
    }
    let environment = sunny(Vec3A::Y);
    let found = features(&shaded(&frame, &camera, &environment), &camera, &environment);
    let unit = |v: &f32| v.is_finite() && (0.0..=1.0).contains(v);
    assert!(found.occlusion.pixels.iter().all(unit) && found.light_visibility.pixels.iter().all(unit));
    assert!(found.bent_normal.pixels.iter().flatten().all(|v| v.is_finite()));
    let empty = shaded(&Frame::default(), &camera, &environment);
    assert!(features(&empty, &camera, &environment).occlusion.pixels.is_empty());
}
