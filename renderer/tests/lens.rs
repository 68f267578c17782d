//! Cameras with lenses: what is blurred and what is bent.

mod common;

use common::{camera, compile, diffuse, plane, render_with, scene, sphere};
use glam::{Affine3A, Vec2, Vec3};
use renderflow_frame::{Camera, Distortion, Environment, Frame};
use renderflow_renderer::{RenderScene, Settings, ThinLens, render_gbuffer};
use renderflow_scenes::Material;

fn picture(scene: &RenderScene, lens: Option<ThinLens>, spp: u32) -> Frame {
    render_with(scene, &Settings { spp, lens, ..Settings::default() }).0
}

/// A wide black sheet before a white sky, seen across its straight edge, `distance` metres away. The camera looks at the edge.
fn edge(distance: f32, look: Camera) -> RenderScene {
    let far = Affine3A::from_rotation_translation(
        glam::Quat::from_rotation_x(std::f32::consts::FRAC_PI_2),
        Vec3::new(-500.0, 0.0, -distance),
    );
    let black = Material { double_sided: true, ..diffuse([0.0; 3]) };
    compile(&scene(vec![(plane(1000.0), black, far)], Environment::constant([1.0; 3]), look))
}

/// Share of the sky across the edge, in columns.
fn profile(frame: &Frame) -> Vec<f64> {
    let raw = frame.raw.as_ref().expect("a picture");
    let mean = |x: usize| (0..raw.height).map(|y| f64::from(raw.at(x, y)[0])).sum::<f64>() / raw.height as f64;
    (0..raw.width).map(mean).collect()
}

/// An edge is blurred by the integral of a disc: the share of the lens' circle that an edge `s` radii beside its middle leaves.
/// The circle of confusion has the radius `aperture fl |1 / distance - 1 / focus|`, in pixels.
#[test]
fn an_edge_is_blurred_as_wide_as_the_circle_of_confusion() {
    let (width, height) = (129, 16);
    let look = camera([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 10.0, width, height);
    let (aperture, focus) = (0.2, 2.0);
    for distance in [1.0_f32, 2.0, 6.0] {
        let scene = edge(distance, look);
        let frame = picture(&scene, Some(ThinLens { aperture, focus }), 1024);
        let radius = f64::from(aperture * look.fl_x * (1.0 / distance - 1.0 / focus).abs()).max(1e-3);
        for (x, got) in profile(&frame).into_iter().enumerate() {
            // Mean over the pixel of the share of a disc on one side of a line.
            let share = |s: f64| 0.5 + (s * (1.0 - s * s).sqrt() + s.asin()) / std::f64::consts::PI;
            let steps = 64;
            let expected = (0..steps)
                .map(|k| share(((x as f64 + (f64::from(k) + 0.5) / 64.0 - 64.5) / radius).clamp(-1.0, 1.0)))
                .sum::<f64>()
                / f64::from(steps);
            assert!((got - expected).abs() < 0.012, "distance {distance}, column {x}: {got} for {expected}");
        }
        // The G-buffer is that of a pinhole.
        assert_eq!(frame.depth, picture(&scene, None, 4).depth);
        assert_eq!(frame.info.lens, "aperture 0.2 focus 2");
    }
}

/// What blurs a picture blurs what the denoiser is told, by the same rays.
#[test]
fn coverage_and_guides_are_as_blurred_as_the_picture() {
    let look = camera([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], 10.0, 65, 8);
    let lens = Some(ThinLens { aperture: 0.05, focus: 0.5 });
    let frame = picture(&edge(2.0, look), lens, 256);
    let raw = frame.raw.as_ref().expect("a picture");
    // The sheet is black and the sky is white.
    for (alpha, pixel) in frame.alpha.pixels.iter().zip(&raw.pixels) {
        assert!((alpha + pixel[0] - 1.0).abs() < 1e-5, "{alpha} {pixel:?}");
    }
    assert!(frame.alpha.pixels.iter().filter(|a| **a > 0.1 && **a < 0.9).count() > 35);
    let guides = render_gbuffer(&edge(2.0, look), &Settings { lens, guide_samples: 256, ..Settings::default() }).unwrap();
    for (a, b) in frame.alpha.pixels.iter().zip(&guides.alpha.pixels) {
        assert!((a - b).abs() < 0.12, "{a} {b}");
    }
}

#[test]
fn a_tiny_lens_is_a_pinhole_and_wrong_ones_are_refused() {
    let look = camera([0.0, 1.0, 4.0], [0.0; 3], 40.0, 24, 16);
    let scene = compile(&scene(vec![(sphere(24, true), diffuse([0.6; 3]), Affine3A::IDENTITY)], common::sunny(), look));
    let settings = Settings { spp: 16, light_paths: false, ..Settings::default() };
    let sharp = render_with(&scene, &settings).0;
    let tiny = render_with(&scene, &Settings { lens: Some(ThinLens { aperture: 1e-9, focus: 4.0 }), ..settings }).0;
    let pairs = || sharp.raw.iter().flat_map(|r| &r.pixels).zip(tiny.raw.iter().flat_map(|r| &r.pixels));
    let same = pairs().filter(|(a, b)| (a[0] - b[0]).abs() < 1e-3 * (1.0 + a[0])).count();
    assert!(same * 100 > 97 * pairs().count(), "{same} of {}", pairs().count());
    for (aperture, focus, place) in [(0.0, 1.0, "lens/aperture"), (0.1, -1.0, "lens/focus"), (f32::NAN, 1.0, "lens/aperture")] {
        let wrong = Settings { lens: Some(ThinLens { aperture, focus }), ..settings };
        let error = render_gbuffer(&scene, &wrong).unwrap_err().to_string();
        assert!(error.contains(place), "{error}");
    }
    // Settings without a lens are written as they were before there were lenses.
    assert!(!serde_json::to_string(&settings).unwrap().contains("\"lens\""));
}

/// Points stand where the lens shows them, for rays, depth and motion alike.
#[test]
fn a_bent_picture_agrees_with_its_camera() {
    let distortion = Distortion::new([-0.25, 0.08, 0.0, 0.0, 0.0, 0.0, 0.001, -0.0008]);
    let still = Camera { distortion, ..camera([0.0, 0.5, 4.0], [0.0; 3], 50.0, 64, 48) };
    let moved = Camera { distortion, ..camera([0.3, 0.6, 3.8], [0.1, 0.0, 0.0], 50.0, 64, 48) };
    let parts = vec![
        (sphere(48, true), diffuse([0.6; 3]), Affine3A::IDENTITY),
        (plane(30.0), diffuse([0.3; 3]), Affine3A::from_translation(Vec3::NEG_Y)),
    ];
    let mut loaded = scene(parts, common::sunny(), still);
    loaded.cameras = vec![still, moved];
    let compiled = compile(&loaded);
    let frame = render_gbuffer(&compiled, &Settings::default()).unwrap();
    let motion = frame.motion.as_ref().expect("motion");
    let mut seen = 0;
    for (x, y) in (0..48).flat_map(|y| (0..64).map(move |x| (x, y))) {
        let depth = *frame.depth.at(x, y);
        if !depth.is_finite() {
            continue;
        }
        let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        let p = still.unproject(pixel, depth);
        let (back, _) = still.project(p).expect("in front");
        assert!((back - pixel).length() < 1e-2, "{pixel} {back}");
        // On the ball or on the floor.
        let off = (p.length() - 1.0).abs().min((p.y + 1.0).abs());
        assert!(off < 5e-3, "{p} is {off} off");
        let (next, _) = moved.project(p).expect("in front");
        assert!((next - pixel - Vec2::from(*motion.at(x, y))).length() < 2e-2, "{pixel}");
        seen += 1;
    }
    assert!(seen > 1000);
    // Straight lines are bent: the horizon of the floor.
    let straight = Camera { distortion: None, ..still };
    let away = (still.direction_cam(Vec2::new(1.0, 1.0)) - straight.direction_cam(Vec2::new(1.0, 1.0))).length();
    assert!(away > 0.02, "{away}");
}
