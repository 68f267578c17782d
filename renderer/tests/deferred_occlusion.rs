//! Occlusion and shadows that deferred shading reads off the depth buffer, against closed forms and against rays traced through
//! the same analytic scene.

#[path = "../frame/tests/light_scene/mod.rs"]
mod light_scene;

use glam::{Vec3, Vec3A};
use light_scene::{Surface, point, render, trace};
use renderflow_frame::environment::Environment;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Camera, Frame, Light};
use renderflow_renderer::deferred::{Deferred, Lighting, Options, ShadowMode, Shadows, shade};

const SIZE: usize = 128;

/// A dim sky with a small bright sun.
fn sunny(direction: Vec3A) -> Environment {
    let plain = Environment { map: Rgb::filled(256, 128, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map =
        Rgb::from_fn(256, 128, |x, y| [if plain.texel_direction(x, y).angle_between(direction) < 0.05 { 500.0 } else { 0.3 }; 3]);
    Environment { map, ..plain }
}

/// The frame with what the depth buffer says of occlusion and of the lights.
fn features(frame: &Frame, environment: &Environment) -> Deferred {
    let options = Options { occlusion: true, shadows: ShadowMode::ScreenSpace, ..Options::NONE };
    shade(frame, &Lighting::new(Light::new(environment.clone()), 1), &Shadows::default(), &options)
}

/// Occlusion and bent normals.
fn parts(found: &Deferred) -> (&Image<f32>, &Rgb) {
    (found.terms.occlusion.as_ref().expect("occlusion"), found.bent_normal.as_ref().expect("bent normals"))
}

/// How far occluders reach, in units of the depth of the pixel.
const REACH: f32 = 0.1;

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
        let found = features(&frame, &environment);
        let (occlusion, bent_normal) = parts(&found);
        let up = camera.world_to_camera().matrix3 * Vec3A::Y;
        for i in 0..SIZE * SIZE {
            let covered = frame.depth.pixels[i].is_finite();
            assert!(
                occlusion.pixels[i] > 0.99 && occlusion.pixels[i] <= 1.0,
                "{} at depth {}",
                occlusion.pixels[i],
                frame.depth.pixels[i]
            );
            let bent = Vec3A::from_array(bent_normal.pixels[i]);
            if covered {
                let visibility = found.terms.visibility[0].pixels[i];
                assert!(visibility > 0.999, "shadow on an open plane: {visibility}");
                assert!(bent.angle_between(up) < 0.05 && (bent.length() - 1.0).abs() < 1e-5, "{bent} {up}");
            } else {
                assert_eq!(bent, Vec3A::ZERO);
            }
        }
    }
}

#[test]
fn a_corner_hides_what_the_wall_covers() {
    // Floor and wall at right angles: a wall of height h at distance d hides (1 - d / sqrt(d^2 + h^2)) / 2 of the cosine-weighted
    // hemisphere.
    let camera = view(Vec3A::new(0.0, 1.5, 2.5), Vec3A::new(0.0, 0.3, 0.0));
    let frame = render(&[Surface::Plane(Vec3A::ZERO, Vec3A::Y), Surface::Plane(Vec3A::ZERO, Vec3A::Z)], &camera);
    let found = features(&frame, &Environment::constant([1.0; 3]));
    let (occlusion, bent_normal) = parts(&found);
    // Without a light there is nothing to be in the shadow of.
    assert!(found.terms.visibility.is_empty());
    let (mut open, mut expected, mut count) = (0.0, 0.0, 0);
    for i in 0..SIZE * SIZE {
        let p = point(&frame, &camera, i);
        let d = p.y.max(p.z);
        if d > 0.03 && d < 0.1 && p.x.abs() < 0.4 {
            open += occlusion.pixels[i];
            // What is farther away than the reach does not count; it fades over the last fifth of the way there.
            let reach = 0.9 * REACH * frame.depth.pixels[i];
            expected += 0.5 + 0.5 * d / reach;
            count += 1;
            // The open quarter is symmetric about 45 degrees: the bent normal leans from the surface towards it.
            let bent = camera.camera_to_world.matrix3 * Vec3A::from_array(bent_normal.pixels[i]);
            assert!(bent.x.abs() < 0.2 && bent.y.min(bent.z) > 0.05, "{bent}");
        }
    }
    let (open, expected) = (open / count as f32, expected / count as f32);
    println!("deep in the corner: {open}, expected {expected}, over {count} pixels");
    assert!((open - expected).abs() < 0.06, "{open} and {expected}");
    // Along the floor, towards the camera, occlusion only fades.
    let column = SIZE / 2;
    let mut last = 0.0;
    for row in 0..SIZE {
        let i = row * SIZE + column;
        if frame.object_id.pixels[i] == 1 && point(&frame, &camera, i).z > 0.05 {
            assert!(occlusion.pixels[i] > last - 0.03, "row {row}");
            last = occlusion.pixels[i].max(last);
        }
    }
    assert!(last > 0.99, "{last}");
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
        let found = features(&frame, &environment);
        let (occlusion, bent_normal) = parts(&found);
        for i in (0..SIZE * SIZE).step_by(5) {
            if !frame.depth.pixels[i].is_finite() {
                continue;
            }
            let n = camera.camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[i]);
            let p = point(&frame, &camera, i) + n * 1e-3;
            let reach = REACH * frame.depth.pixels[i];
            let free = |d: &Vec3A| trace(&scene, p, *d).is_none_or(|hit| hit.0 > reach);
            let open: Vec<Vec3A> = hemisphere(n, 256).filter(free).collect();
            let truth = open.len() as f32 / 256.0;
            count += 1;
            error += (occlusion.pixels[i] - truth).abs();
            bias += occlusion.pixels[i] - truth;
            plain += 1.0 - truth;
            if let Some(bent) = open.iter().sum::<Vec3A>().try_normalize() {
                bent_error += bent.angle_between(camera.camera_to_world.matrix3 * Vec3A::from_array(bent_normal.pixels[i]));
                bent_plain += bent.angle_between(n);
            }
            let lit = n.dot(sun) > 0.0 && trace(&scene, p, sun).is_none();
            shadow_right += usize::from((found.terms.visibility[0].pixels[i] > 0.5) == lit);
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
            let found = features(&frame, &environment);
            (found.image, found.terms.occlusion, found.bent_normal, found.terms.visibility)
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
    let found = features(&frame, &environment);
    let (occlusion, bent_normal) = parts(&found);
    let unit = |v: &f32| v.is_finite() && (0.0..=1.0).contains(v);
    assert!(occlusion.pixels.iter().all(unit) && found.terms.visibility[0].pixels.iter().all(unit));
    assert!(bent_normal.pixels.iter().flatten().all(|v| v.is_finite()));
    assert!(features(&Frame::default(), &environment).image.pixels.is_empty());
}
