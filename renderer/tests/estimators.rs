//! Estimators that may only change the noise: pictures of many branches have the mean of pictures of one; limits of indirect
//! light are the one setting that darkens, and count what they take.

mod common;

use common::{camera, compile, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine3A, Vec3};
use renderflow_frame::{Environment, Frame, Image};
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::{LoadedScene, Material, Principled};

/// Diffuse, coated and metal surfaces that light each other, a lamp among them.
fn loaded(seed: u64, lamp: bool) -> LoadedScene {
    let place = |x: f32, y: f32, z: f32, r: f32| {
        Affine3A::from_scale_rotation_translation(Vec3::splat(r), glam::Quat::IDENTITY, Vec3::new(x, y, z))
    };
    let mut parts = vec![
        (plane(6.0), diffuse([0.7, 0.6, 0.5]), Affine3A::IDENTITY),
        (
            sphere(16, true),
            Material::from(Principled { metallic: 1.0, roughness: 0.15, ..Principled::default() }),
            place(-0.7, 0.6, 0.0, 0.6),
        ),
        (sphere(16, true), Material::from(Principled { roughness: 0.4, ..Principled::default() }), place(0.7, 0.5, 0.3, 0.5)),
    ];
    if lamp {
        parts.push((
            sphere(6, false),
            Material { emissive: [20.0, 15.0, 10.0], ..diffuse([0.0; 3]) },
            place(0.0, 1.6, 0.5, 0.15),
        ));
    }
    let mut scene = scene(parts, sunny(), camera([0.4, 1.4, 3.2], [0.0, 0.4, 0.0], 40.0, 16, 12));
    scene.seed = seed;
    scene
}

/// Mean of a picture.
fn mean(frame: &Frame) -> f64 {
    let pixels = frame.raw.as_ref().map_or(&[][..], |i| &i.pixels);
    pixels.iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3 * pixels.len()) as f64
}

/// Mean and its standard error over pictures of `seeds` seeds.
fn over_seeds(seeds: u64, lamp: bool, settings: &Settings) -> (f64, f64) {
    let means: Vec<f64> = (0..seeds).map(|seed| mean(&render_with(&compile(&loaded(seed, lamp)), settings).0)).collect();
    let n = seeds as f64;
    let average = means.iter().sum::<f64>() / n;
    let variance = means.iter().map(|m| (m - average).powi(2)).sum::<f64>() / (n - 1.0);
    (average, (variance / n).sqrt())
}

fn scene_of(lamp: bool) -> RenderScene {
    compile(&loaded(7, lamp))
}

#[test]
fn branches_keep_the_mean() {
    for lamp in [false, true] {
        let settings = |branches, spp| Settings { spp, branches, ..Settings::default() };
        let (one, one_error) = over_seeds(24, lamp, &settings(1, 512));
        for branches in [2, 8] {
            let (many, many_error) = over_seeds(24, lamp, &settings(branches, 512));
            let error = one_error.hypot(many_error);
            println!("lamp {lamp}: {one:.5} with one branch, {many:.5} with {branches}, {error:.1e}");
            assert!((many - one).abs() < 4.0 * error, "{} standard errors", (many - one) / error);
            assert!(error < 0.003 * one, "too noisy to tell");
        }
    }
}

#[test]
fn branches_cost_no_camera_rays() {
    let scene = scene_of(false);
    let stats = |spp, branches| render_with(&scene, &Settings { spp, branches, ..Settings::default() }).1;
    let (one, four) = (stats(8, 1), stats(32, 4));
    assert_eq!(one.camera_rays, four.camera_rays);
    assert_eq!(four.samples, 4 * one.samples);
    // Each of the four goes on alone.
    let paths = four.bounce_rays as f64 / one.bounce_rays as f64;
    assert!((3.5..4.5).contains(&paths), "{paths}");
    // Few samples share none, for the sake of edges; nor do those that no power of two divides.
    let shared = |spp| Settings { spp, branches: 4, ..Settings::default() }.branches();
    assert_eq!([1, 4, 8, 12, 16, 17, 18, 256].map(shared), [1, 1, 2, 2, 4, 1, 2, 4]);
}

#[test]
fn limits_of_indirect_light_darken_and_are_counted() {
    let scene = scene_of(false);
    let at = |clamp_indirect, max_bounces| {
        // A limit ends light paths.
        let settings = Settings { spp: 64, max_bounces, clamp_indirect, light_paths: false, ..Settings::default() };
        let (frame, stats) = render_with(&scene, &settings);
        (mean(&frame), stats.clamped_contributions)
    };
    let (free, none) = at(None, 6);
    assert_eq!(none, 0);
    assert_eq!(at(Some(1e9), 6), (free, 0));
    let (limited, count) = at(Some(0.2), 6);
    assert!(count > 100 && limited < free, "{limited} of {free}, {count}");
    // Direct light is never limited.
    assert_eq!(at(None, 1), at(Some(1e-6), 1));
    assert!(limited > at(None, 1).0);
}

#[test]
fn impossible_limits_and_branches_are_refused() {
    let scene = scene_of(false);
    let run = |settings: &Settings| renderflow_renderer::render(&scene, settings, &|_, _| (), &false.into()).map(|_| ());
    for limit in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(run(&Settings { spp: 1, clamp_indirect: Some(limit), ..Settings::default() }).is_err(), "{limit}");
    }
    for branches in [0, 65] {
        assert!(run(&Settings { spp: 1, branches, ..Settings::default() }).is_err(), "{branches}");
    }
}

/// Pixels of a block of 4 x 4 share out their samples, so their errors cancel where they see nearly the same. Independent errors
/// would leave a sixteenth of their mean square in the means of blocks.
#[test]
fn errors_of_neighbours_cancel() {
    // A matte floor and ball under an even sky from above: no bright sample decides.
    let mut sky = Environment::constant([0.0; 3]);
    sky.map = Image::from_fn(16, 8, |_, y| [if y < 4 { 1.0 } else { 0.1 }; 3]);
    let parts = vec![
        (plane(6.0), diffuse([0.7, 0.6, 0.5]), Affine3A::IDENTITY),
        (sphere(16, true), diffuse([0.5; 3]), Affine3A::from_translation(Vec3::new(0.0, 1.0, 0.0))),
    ];
    let mut scene = scene(parts, sky, camera([0.4, 2.4, 5.2], [0.0, 0.6, 0.0], 40.0, 32, 24));
    let mut picture = |seed, spp| {
        scene.seed = seed;
        // Several light samples of one pixel leave less that could cancel.
        let settings = Settings { spp, light_samples: (spp < 100).then_some(1), ..Settings::default() };
        render_with(&compile(&scene), &settings).0.raw.unwrap()
    };
    let truth = picture(99, 1 << 11);
    // Six are three quarters of a run. Of sixteen, edges leave most, because image points are not shared.
    for (spp, most) in [(1, 0.6), (4, 0.5), (6, 0.8), (16, 0.75)] {
        let (mut pixels, mut blocks) = (0.0, 0.0);
        for seed in 0..8 {
            let raw = picture(seed, spp);
            let error = |x: usize, y: usize| f64::from(raw.pixels[y * 32 + x][1] - truth.pixels[y * 32 + x][1]);
            for (x, y) in (0..24).step_by(4).flat_map(|y| (0..32).step_by(4).map(move |x| (x, y))) {
                let block = || (0..16).map(|i| error(x + i % 4, y + i / 4));
                pixels += block().map(|e| e * e).sum::<f64>() / 16.0;
                blocks += (block().sum::<f64>() / 16.0).powi(2);
            }
        }
        let left = 16.0 * blocks / pixels;
        println!("{spp} samples: {left:.3} of what independent errors leave");
        assert!(left < most, "{spp} samples: {left}");
    }
}
