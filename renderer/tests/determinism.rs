//! The bytes of a picture depend on seed, scene and settings, and on nothing else. That threads and tiles do not matter is
//! checked by `renderflow_renderer::verify::determinism`.

mod common;

use glam::{Affine3A, Vec3};
use renderflow_renderer::verify::determinism::bits;
use renderflow_renderer::{Settings, Skips};
use renderflow_scenes::{LoadedScene, Material, Principled};

fn loaded() -> LoadedScene {
    let glossy = Material::from(Principled { metallic: 1.0, roughness: 0.2, ..Principled::default() });
    let parts = vec![
        (common::plane(6.0), common::diffuse([0.6, 0.5, 0.4]), Affine3A::IDENTITY),
        (common::sphere(12, true), glossy, Affine3A::from_translation(Vec3::new(-0.8, 1.0, 0.0))),
        (common::sphere(12, false), Material::default(), Affine3A::from_translation(Vec3::new(1.4, 1.0, 0.3))),
    ];
    // Odd sizes leave partial tiles at both edges.
    common::scene(parts, common::sunny(), common::camera([0.0, 2.0, 6.0], [0.0, 0.8, 0.0], 40.0, 45, 37))
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
    let [a, b] = [&scene, &at_once].map(|scene| common::render_with(scene, &settings).0);
    assert!(bits(&a) == bits(&b));
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
