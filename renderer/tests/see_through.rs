//! What the G-buffer says is seen through surfaces, and deferred shading with it.

mod common;

use common::{camera, compile, diffuse, plane, render, scene, sphere};
use glam::{Affine3A, Quat, Vec3, Vec3A};
use renderflow_frame::{Environment, Frame, Image, Light};
use renderflow_renderer::deferred::{Lighting, Options, Shadows, picture};
use renderflow_renderer::{Settings, render_gbuffer};
use renderflow_scenes::{LoadedScene, Material, Mesh, Principled};

const IOR: f32 = 1.5;

fn glass(absorption: [f32; 3], base_color: Vec3A) -> Material {
    let specular = ((IOR - 1.0) / (IOR + 1.0)).powi(2) / 0.08;
    let surface = Principled { base_color, roughness: 0.0, specular, transmission: 1.0, ..Principled::default() };
    Material { absorption, ..Material::from(surface) }
}

fn pane(base_color: Vec3A) -> Material {
    Material { thin_walled: true, ..glass([0.0; 3], base_color) }
}

/// Fresnel's reflectance of unpolarised light, by the two polarisations (Born and Wolf 1999, section 1.5).
fn fresnel(cos: f64, ior: f64) -> f64 {
    let inner = (1.0 - (1.0 - cos * cos) / (ior * ior)).sqrt();
    let (s, p) = ((cos - ior * inner) / (cos + ior * inner), (ior * cos - inner) / (ior * cos + inner));
    0.5 * (s * s + p * p)
}

fn at(mesh: Mesh, material: Material, height: f32) -> (Mesh, Material, Affine3A) {
    (mesh, material, Affine3A::from_translation(Vec3::Y * height))
}

/// Bright from above and from one side.
fn sky() -> Environment {
    let blank = Environment { map: Image::filled(64, 32, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Image::from_fn(64, 32, |x, y| {
        let d = blank.texel_direction(x, y);
        [1.0 + 0.8 * d.x, 1.0 + 0.5 * d.y, 1.0 - 0.6 * d.z]
    });
    blank.with_map(map)
}

fn gbuffer(scene: &LoadedScene) -> Frame {
    render_gbuffer(&compile(scene), &Settings::default()).expect("a G-buffer")
}

/// Transmittance and direction of the pixel at (x, y).
fn seen(frame: &Frame, x: usize, y: usize) -> (Vec3A, Vec3A) {
    let picture = |image: &Option<Image<[f32; 3]>>| Vec3A::from_array(*image.as_ref().expect("the channel").at(x, y));
    (picture(&frame.transmittance), picture(&frame.through))
}

#[track_caller]
fn close(a: Vec3A, b: Vec3A, tolerance: f32) {
    assert!(a.distance(b) < tolerance, "{a} for {b}");
}

#[test]
fn scenes_without_clear_surfaces_have_no_such_channels() {
    let parts = vec![at(sphere(24, true), diffuse([0.5; 3]), 0.0)];
    let frame = gbuffer(&scene(parts, sky(), camera([0.0, 0.0, 4.0], [0.0; 3], 30.0, 16, 16)));
    assert!(frame.transmittance.is_none() && frame.through.is_none());
}

/// A tinted pane in front of the sky, in front of a wall, and a blended sheet, all seen straight on.
#[test]
fn sheets_pass_their_share_straight_on() {
    let look = camera([0.0, 5.0, 0.0], [0.0; 3], 1.0, 8, 8);
    let r = fresnel(1.0, f64::from(IOR)) as f32;
    let tint = Vec3A::new(1.0, 0.5, 0.25);
    let passed = tint * ((1.0 - r) / (1.0 + r));
    let frame = gbuffer(&scene(vec![at(plane(10.0), pane(tint), 0.0)], sky(), look));
    let (transmittance, through) = seen(&frame, 3, 4);
    close(transmittance, passed, 1e-3);
    close(through, Vec3A::NEG_Z, 0.02);
    let wall = at(plane(10.0), diffuse([0.3; 3]), -1.0);
    let frame = gbuffer(&scene(vec![at(plane(10.0), pane(tint), 0.0), wall.clone()], sky(), look));
    let (transmittance, through) = seen(&frame, 3, 4);
    close(transmittance, passed, 1e-3);
    assert_eq!(through, Vec3A::ZERO);
    // Two panes behind each other.
    let frame = gbuffer(&scene(vec![at(plane(10.0), pane(tint), 0.0), at(plane(10.0), pane(tint), -1.0)], sky(), look));
    close(seen(&frame, 3, 4).0, passed * passed, 1e-3);
    let veil = Material { opacity: Some(0.7), ..diffuse([0.9; 3]) };
    let frame = gbuffer(&scene(vec![at(plane(10.0), veil, 0.0), wall], sky(), look));
    let (transmittance, through) = seen(&frame, 3, 4);
    close(transmittance, Vec3A::splat(0.3), 1e-3);
    assert_eq!(through, Vec3A::ZERO);
}

/// A slab bends light back to where it came from, and absorbs along the way inside.
#[test]
fn a_slab_passes_parallel_light() {
    let absorption = [0.2, 1.0, 3.0];
    let faces = vec![
        at(plane(40.0), glass(absorption, Vec3A::ONE), 0.25),
        (
            plane(40.0),
            glass(absorption, Vec3A::ONE),
            Affine3A::from_rotation_translation(Quat::from_rotation_x(std::f32::consts::PI), Vec3::NEG_Y * 0.25),
        ),
    ];
    let look = camera([0.0, 5.0, 3.0], [0.0; 3], 1.0, 9, 9);
    let frame = gbuffer(&scene(faces, sky(), look));
    let cos = 5.0 / 34.0_f64.sqrt();
    let inner = (1.0 - (1.0 - cos * cos) / f64::from(IOR * IOR)).sqrt();
    let passed = (1.0 - fresnel(cos, f64::from(IOR))).powi(2);
    let expected = absorption.map(|a| (passed * (-f64::from(a) * 0.5 / inner).exp()) as f32);
    let (transmittance, through) = seen(&frame, 4, 4);
    close(transmittance, Vec3A::from_array(expected), 2e-3);
    close(through, Vec3A::NEG_Z, 1e-3);
}

/// A ball turns a ray by twice the difference of its angles outside and inside.
#[test]
fn a_ball_bends_twice() {
    let look = camera([0.0, 0.0, 200.0], [0.0; 3], 0.6, 65, 65);
    let ball = vec![at(sphere(400, true), glass([0.0; 3], Vec3A::ONE), 0.0)];
    let frame = gbuffer(&scene(ball, sky(), look));
    let mut met = 0;
    for x in 5..60 {
        let height = f64::from(200.0 * look.direction_cam(glam::Vec2::new(x as f32 + 0.5, 32.5)).normalize().x);
        if height.abs() > 0.85 {
            continue;
        }
        let (outside, inside) = (height.asin(), (height / f64::from(IOR)).asin());
        let turned = 2.0 * (outside - inside);
        let (transmittance, through) = seen(&frame, x, 32);
        let expected = Vec3A::new(-(turned.sin() as f32), 0.0, -(turned.cos() as f32));
        close(through, expected, 0.02);
        let passed = (1.0 - fresnel(outside.cos(), f64::from(IOR))).powi(2) as f32;
        close(transmittance, Vec3A::splat(passed), 0.01);
        met += 1;
    }
    assert!(met > 30, "{met}");
}

/// Deferred shading of smooth glass before the sky is near the path tracer's picture. It lacks what is mirrored inside of a body,
/// and one half of what a sheet mirrors, on both of its sides.
#[test]
fn deferred_shading_shows_the_sky_behind_glass() {
    for (material, tolerance) in [(pane(Vec3A::new(1.0, 0.9, 0.8)), 0.12), (glass([0.1, 0.4, 0.2], Vec3A::ONE), 0.06)] {
        let look = camera([0.0, 0.5, 4.0], [0.0; 3], 35.0, 48, 48);
        let shapes = scene(vec![at(sphere(96, true), material, 0.0)], sky(), look);
        let frame = gbuffer(&shapes);
        let lighting = Lighting::new(Light::new(sky()), 0);
        let deferred = picture(&frame, &lighting, &Shadows::default(), &Options::NONE);
        let (traced, _) = render(&compile(&shapes), 256);
        let traced = traced.beauty.expect("a picture");
        let inner = |x: usize, y: usize| (x as f32 - 23.5).hypot(y as f32 - 23.5) < 15.0;
        let (mut error, mut sum) = (0.0, 0.0);
        for (x, y) in (0..48).flat_map(|y| (0..48).map(move |x| (x, y))).filter(|&(x, y)| inner(x, y)) {
            for c in 0..3 {
                error += (deferred.at(x, y)[c] - traced.at(x, y)[c]).abs();
                sum += traced.at(x, y)[c];
            }
        }
        println!("mean difference {:.4}", error / sum);
        assert!(error / sum < tolerance, "{}", error / sum);
    }
}
