//! The bytes of a picture depend on seed, scene and settings, and on nothing else.

mod common;

use glam::{Affine3A, Vec3};
use renderflow_frame::Frame;
use renderflow_renderer::{RenderScene, Settings, Skips};
use renderflow_scenes::{LoadedScene, Material};

fn loaded() -> LoadedScene {
    let glossy = Material { metallic: 1.0, roughness: 0.2, ..Material::default() };
    let parts = vec![
        (common::plane(6.0), common::diffuse([0.6, 0.5, 0.4]), Affine3A::IDENTITY),
        (common::sphere(12, true), glossy, Affine3A::from_translation(Vec3::new(-0.8, 1.0, 0.0))),
        (common::sphere(12, false), Material::default(), Affine3A::from_translation(Vec3::new(1.4, 1.0, 0.3))),
    ];
    // Odd sizes leave partial tiles at both edges.
    common::scene(parts, common::sunny(), common::camera([0.0, 2.0, 6.0], [0.0, 0.8, 0.0], 40.0, 45, 37))
}

fn bits(frame: &Frame) -> Vec<u32> {
    let rgb = [&frame.beauty, &frame.raw, &frame.variance, &frame.guide_albedo, &frame.guide_normal, &frame.irradiance];
    let mut bits: Vec<u32> = rgb.into_iter().flatten().flat_map(|i| i.pixels.as_flattened()).map(|v| v.to_bits()).collect();
    for image in [&frame.albedo, &frame.normal, &frame.material] {
        bits.extend(image.pixels.as_flattened().iter().map(|v| v.to_bits()));
    }
    for image in [&frame.motion, &frame.motion_prev].into_iter().flatten() {
        bits.extend(image.pixels.as_flattened().iter().map(|v| v.to_bits()));
    }
    bits.extend(frame.alpha.pixels.iter().chain(&frame.depth.pixels).map(|v| v.to_bits()));
    bits.extend(frame.object_id.pixels.iter().chain(&frame.material_id.pixels));
    bits
}

fn render_on(threads: usize, scene: &RenderScene, settings: &Settings) -> Vec<u32> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(|| bits(&common::render_with(scene, settings).0))
}

#[test]
fn threads_do_not_change_a_bit() {
    let scene = common::compile(&loaded());
    let settings = Settings { spp: 9, irradiance: true, ..Settings::default() };
    let one = render_on(1, &scene, &settings);
    assert!(one.len() > 45 * 37 * 20);
    for threads in [3, 16] {
        assert!(one == render_on(threads, &scene, &settings), "{threads} threads differ from one");
    }
    // Compiling anew gives the same tree, and so the same picture.
    assert!(one == render_on(3, &common::compile(&loaded()), &settings));
}

#[test]
fn seed_and_frame_change_the_samples() {
    let settings = Settings { spp: 4, ..Settings::default() };
    let mut scene = common::compile(&loaded());
    let first = common::render_with(&scene, &settings).0;
    scene.set_frame(1);
    let second = common::render_with(&scene, &settings).0;
    assert_ne!(first.beauty, second.beauty);
    assert_eq!(first.depth, second.depth, "nothing moved");

    let mut other = loaded();
    other.seed = 2;
    assert_ne!(common::render_with(&common::compile(&other), &settings).0.beauty, first.beauty);
}

#[test]
fn the_tree_is_touched_only_when_something_moves() {
    let mut still = loaded();
    still.cameras = vec![still.cameras[0]; 4];
    let mut scene = common::compile(&still);
    (0..4).for_each(|frame| scene.set_frame(frame));
    assert_eq!(scene.builds().flattened, 1);

    let mut moving = still.clone();
    let start = moving.instances[1].transforms[0];
    moving.instances[1].transforms =
        [0.0, 0.0, 0.5, 0.5].map(|y| Affine3A::from_translation(Vec3::new(0.0, y, 0.0)) * start).to_vec();
    let mut scene = common::compile(&moving);
    (0..4).for_each(|frame| scene.set_frame(frame));
    assert_eq!((scene.builds().flattened, scene.builds().refitted), (1, 1));

    // Arriving at a frame step by step or at once is the same.
    let mut at_once = common::compile(&moving);
    at_once.set_frame(3);
    let settings = Settings { spp: 2, ..Settings::default() };
    assert!(bits(&common::render_with(&scene, &settings).0) == bits(&common::render_with(&at_once, &settings).0));
}

#[test]
fn the_gbuffer_alone_equals_the_gbuffer_of_the_beauty() {
    let scene = common::compile(&loaded());
    let skips = Skips { plain_pixels: false, ..Skips::ALL };
    let settings = Settings { spp: 16, guide_samples: 16, branches: 1, skips, ..Settings::default() };
    let full = common::render_with(&scene, &settings).0;
    let alone = renderflow_renderer::render_gbuffer(&scene, &settings).expect("settings in range");
    assert!(alone.beauty.is_none() && alone.info.spp == 0);
    assert_eq!(full.depth, alone.depth);
    assert_eq!(full.normal, alone.normal);
    assert_eq!(full.albedo, alone.albedo);
    assert_eq!(full.object_id, alone.object_id);
    // Same camera samples, so the same coverage and guides.
    assert_eq!(full.alpha, alone.alpha);
    assert_eq!(full.guide_albedo, alone.guide_albedo);
    assert_eq!(full.guide_normal, alone.guide_normal);
}
