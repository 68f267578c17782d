//! The network's inputs: mirror symmetry (training mirrors crops), energy, curves, the order of channels.

mod common;

use common::{camera, clip, gbuffer, sky};
use glam::{Mat3A, Vec3A};
use renderflow_frame::ibl::{self, IblTables};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, Environment, Frame};
use renderflow_model::bridge::{Bridge, log_curve, log_curve_inverse, velocity};
use renderflow_model::config::{Curve, Input, Start};
use renderflow_model::features::{BACKGROUND, Features, INPUT_CHANNELS, Physical, STORED, TARGET, write_input};
use renderflow_model::tokens::{EnvironmentSummary, TOKEN_FEATURES, mirrored};
use renderflow_model::{Clip, NetworkConfig};

fn features(frame: &Frame, camera: &Camera, environment: &Environment) -> Features {
    let tables = IblTables::new(environment);
    Features::new(frame, camera, environment, &EnvironmentSummary::new(environment), &tables, 0.7)
}

#[test]
fn channel_offsets_follow_the_list() {
    assert_eq!(Input::ALL.iter().map(|input| input.channels()).sum::<usize>(), INPUT_CHANNELS);
    assert_eq!(Input::Coverage.offset(), INPUT_CHANNELS - 1);
    assert_eq!((Input::Albedo.offset(), Input::Normal.offset(), Input::Depth.offset(), Input::Brdf.offset()), (0, 3, 6, 16));
    assert_eq!(NetworkConfig::default().pixel_channels(), 3 + INPUT_CHANNELS);
}

#[test]
fn curves_invert() {
    for x in [0.0f32, 1e-4, 0.02, 0.18, 1.0, 37.0, 60_000.0] {
        assert!((log_curve_inverse(log_curve(x)) - x).abs() <= 1e-6 + 3e-6 * x, "{x}");
        for curve in [Curve::Log, Curve::Srgb] {
            assert!((curve.decode(curve.encode(x)) - x).abs() <= 2e-6 + 1e-5 * x, "{curve:?} {x}");
        }
    }
    assert_eq!(Curve::Log.encode(0.0), -1.0);
    assert!((Curve::Log.encode(1.0) - 1.0).abs() < 1e-6 && (Curve::Srgb.encode(1.0) - 1.0).abs() < 1e-6);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -3.0] {
        assert!(log_curve(bad).is_finite() && Curve::Srgb.encode(bad).is_finite());
    }
}

#[test]
fn slopes_are_derivatives() {
    for curve in [Curve::Log, Curve::Srgb] {
        for x in [0.001f32, 0.02, 0.4, 2.0] {
            let h = 1e-2 * f64::from(x);
            let at = |x: f64| match curve {
                Curve::Log => 2.0 * (8.0 * x).ln_1p() / 9f64.ln() - 1.0,
                Curve::Srgb if x <= 0.003_130_8 => 2.0 * 12.92 * x - 1.0,
                Curve::Srgb => 2.0 * (1.055 * x.powf(1.0 / 2.4) - 0.055) - 1.0,
            };
            let expected = (at(f64::from(x) + h) - at(f64::from(x) - h)) / (2.0 * h);
            assert!((f64::from(curve.encode_slope(x)) / expected - 1.0).abs() < 1e-3, "{curve:?} at {x}");
            let z = curve.encode(x);
            assert!((curve.decode_slope(z) * curve.encode_slope(x) - 1.0).abs() < 1e-3, "{curve:?} at {x}");
        }
    }
}

#[test]
fn the_bridge_ends_where_it_should() {
    let interpolate = |z0, z1, t, noise| Bridge::default().interpolate(z0, z1, t, noise);
    assert_eq!(interpolate(-0.4, 0.8, 0.0, 3.0), -0.4);
    // Half way, noise 1: sigma / 2 above the middle.
    assert!((interpolate(-0.4, 0.8, 0.5, 1.0) - 0.2025).abs() < 1e-7);
    // From any point of a noise-free bridge the velocity leads to z_1.
    let z_t = interpolate(-0.4, 0.8, 0.25, 0.0);
    assert!((z_t + 0.75 * velocity(0.8, z_t, 0.25) - 0.8).abs() < 1e-6);
}

/// The scene and the camera seen in a mirror: x negated, in the world and in the picture.
fn mirror(clip: &Clip) -> (Frame, Camera, Environment) {
    let (frame, camera) = (&clip.frames[0], clip.cameras[0]);
    let flip = |image: &Rgb| Rgb::from_fn(image.width, image.height, |x, y| *image.at(image.width - 1 - x, y));
    let scalar = |image: &renderflow_frame::Image<f32>| {
        renderflow_frame::Image::from_fn(image.width, image.height, |x, y| *image.at(image.width - 1 - x, y))
    };
    let mirrored = Frame {
        width: frame.width,
        height: frame.height,
        alpha: scalar(&frame.alpha),
        albedo: flip(&frame.albedo),
        normal: flip(&frame.normal).map(|n| [-n[0], n[1], n[2]]),
        depth: scalar(&frame.depth),
        material: flip(&frame.material),
        object_id: renderflow_frame::Image::from_fn(frame.width, frame.height, |x, y| {
            *frame.object_id.at(frame.width - 1 - x, y)
        }),
        material_id: renderflow_frame::Image::from_fn(frame.width, frame.height, |x, y| {
            *frame.material_id.at(frame.width - 1 - x, y)
        }),
        ..Frame::default()
    };
    let x = Mat3A::from_diagonal(glam::Vec3::new(-1.0, 1.0, 1.0));
    let mut camera_mirrored = camera;
    camera_mirrored.camera_to_world.matrix3 = x * camera.camera_to_world.matrix3 * x;
    camera_mirrored.camera_to_world.translation = x * camera.position();
    // phi -> -phi: columns reversed, rotation negated.
    let environment = Environment { map: flip(&clip.environment.map), rotation: -clip.environment.rotation, intensity: 1.0 };
    (mirrored, camera_mirrored, environment)
}

#[test]
fn mirroring_the_inputs_equals_mirroring_the_world() {
    let clip = clip(1, 48);
    let (frame, camera, environment) = mirror(&clip);
    let world = features(&frame, &camera, &environment);
    let straight = features(&clip.frames[0], &clip.cameras[0], &clip.environment);

    for (i, (a, b)) in world.tokens.iter().zip(mirrored(&straight.tokens)).enumerate() {
        assert!((a - b).abs() < 2e-3, "token {} feature {}: {a} instead of {b}", i / TOKEN_FEATURES, i % TOKEN_FEATURES);
    }
    // The screen-space features sample along a fixed pattern of directions, which the mirror does not keep: held more loosely.
    let noisy = [Input::Occlusion, Input::BentNormal, Input::LightVisibility].map(Input::offset);
    let mut sums = [0.0f32; STORED];
    for y in 0..48 {
        for x in 0..48 {
            let a = &world.pixels[(y * 48 + x) * STORED..][..STORED];
            let mut b = straight.pixels[(y * 48 + 47 - x) * STORED..][..STORED].to_vec();
            b[Input::Normal.offset()] *= -1.0;
            for (c, (a, b)) in a[..TARGET].iter().zip(&b).enumerate() {
                assert!(noisy.contains(&c) || (a - b).abs() < 1e-2, "({x}, {y}) channel {c}: {a} instead of {b}");
                sums[c] += (a - b).abs() / (48.0 * 48.0);
            }
        }
    }
    for c in noisy {
        assert!(sums[c] < 0.05, "channel {c} differs by {} on average", sums[c]);
    }
}

#[test]
fn tokens_hold_the_energy_and_the_place_of_the_light() {
    // A constant sky: every token the same radiance; mean direction = centre.
    let white = EnvironmentSummary::new(&Environment::constant([1.0; 3])).tokens(&camera(0.4, 32), 1.0);
    for (i, token) in white.chunks_exact(TOKEN_FEATURES).enumerate() {
        assert!((token[0] - 1.0).abs() < 2e-3, "cell {i}: {}", token[0]);
        // The mean direction of a cell is shorter than its centre and close to it.
        let (mean, centre) = (Vec3A::from_slice(&token[3..]), Vec3A::from_slice(&token[6..]));
        assert!((mean - centre).length() < 0.25 && mean.length() <= 1.0001, "cell {i}: {mean} and {centre}");
    }
    // Without the curve, cell means sum to the mean over the sphere.
    let environment = sky();
    let summary = EnvironmentSummary::new(&environment);
    let tokens = summary.tokens(&camera(0.4, 32), 1.0);
    let mean: f32 = tokens.chunks_exact(TOKEN_FEATURES).map(|t| log_curve_inverse(0.5 * (t[1] + 1.0))).sum::<f32>() / 64.0;
    let (mut expected, mut weight) = (0.0, 0.0);
    for y in 0..256 {
        for x in 0..512 {
            let uv = glam::Vec2::new((x as f32 + 0.5) / 512.0, (y as f32 + 0.5) / 256.0);
            let solid_angle = (std::f32::consts::PI * uv.y).sin();
            expected += environment.radiance(environment.direction(uv))[1] * solid_angle;
            weight += solid_angle;
        }
    }
    assert!((mean / (expected / weight) - 1.0).abs() < 0.01, "{mean} instead of {}", expected / weight);
    // The brightest cell points at the sun.
    let brightest = tokens.chunks_exact(TOKEN_FEATURES).max_by(|a, b| a[9].total_cmp(&b[9])).unwrap();
    let to_camera = camera(0.4, 32).camera_to_world.matrix3.transpose();
    let towards = Vec3A::from_slice(&brightest[3..]).normalize().dot(to_camera * summary.light_direction);
    assert!(towards > 0.99, "cosine to the sun {towards}");
}

#[test]
fn stored_pixels_give_the_start_back() {
    let clip = clip(1, 48);
    let f = features(&clip.frames[0], &clip.cameras[0], &clip.environment);
    let tables = IblTables::new(&clip.environment);
    let shading = ibl::shade(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables);
    for i in 0..48 * 48 {
        // Through half precision, as in training.
        let stored: Vec<f32> = f.to_half()[i * STORED..][..STORED].iter().map(|v| v.to_f32()).collect();
        let base = Physical::from_stored(&stored).base(Start::Ibl);
        for c in 0..3 {
            let expected = 0.7 * shading.image.pixels[i][c];
            assert!(
                (base.start[c] - expected).abs() < 5e-3 * expected + 1e-3,
                "pixel {i}: {} instead of {expected}",
                base.start[c]
            );
        }
    }
}

#[test]
fn broken_values_reach_no_input() {
    let camera = camera(0.0, 32);
    let mut frame = gbuffer(&camera);
    for i in 500..560 {
        frame.normal.pixels[i] = [f32::NAN; 3];
        frame.albedo.pixels[i] = [f32::INFINITY, -1.0, f32::NAN];
        frame.depth.pixels[i] = f32::NAN;
        frame.material.pixels[i] = [f32::NAN, 7.0, -2.0];
        frame.alpha.pixels[i] = f32::NAN;
    }
    let f = features(&frame, &camera, &sky());
    assert!(f.pixels.iter().chain(&f.tokens).all(|v| v.is_finite()));
    let config = NetworkConfig::default();
    let mut out = vec![0.0; config.pixel_channels()];
    for stored in f.pixels.chunks_exact(STORED) {
        write_input(&config, [0.0; 3], stored, &mut out);
        assert!(out.iter().all(|v| v.abs() <= 20.0), "{out:?}");
    }
    assert_eq!(BACKGROUND + 6, STORED);
}
