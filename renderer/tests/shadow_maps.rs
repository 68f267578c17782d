//! Shadow maps of a whole frame. Single maps are compared with closed forms beside their code.

mod common;

use common::{camera, compile, diffuse, plane, render, scene, sphere};
use glam::{Affine3A, Vec3, Vec3A};
use renderflow_frame::Frame;
use renderflow_renderer::deferred::{self, Lighting, Options, SHADOW_MAP_SIZE, ShadowTiles, shadow_maps};
use renderflow_renderer::{Settings, render_gbuffer};
use renderflow_scenes::{LoadedScene, Material, Principled};
use std::sync::Arc;

/// A ball of radius 1 at `centre` over a wide floor, seen from above.
fn ball(centre: Vec3, material: Material) -> LoadedScene {
    let parts = vec![
        (sphere(64, false), material, Affine3A::from_translation(centre)),
        (plane(200.0), diffuse([0.5; 3]), Affine3A::IDENTITY),
    ];
    let environment = common::sunny();
    scene(parts, environment, camera([0.5, 6.0, 5.0], [0.0; 3], 50.0, 64, 64))
}

#[test]
fn all_maps_of_a_frame_and_none_without_receivers() {
    let scene = compile(&ball(Vec3::new(0.0, 1.5, 0.0), diffuse([0.5; 3])));
    let lighting = Lighting::new(Arc::clone(scene.light()), deferred::LIGHTS);
    assert!(!lighting.lights.is_empty() && !lighting.sky.is_empty());
    let none = shadow_maps(&scene, &lighting, &Frame::default());
    assert!(none.sky.is_empty() && none.lights.iter().all(Vec::is_empty) && none.lights.len() == lighting.lights.len());

    let (frame, _) = render(&scene, 1);
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| shadow_maps(&scene, &lighting, &frame))
    };
    let maps = made(1);
    let again = made(3);
    assert_eq!((&maps.lights, &maps.sky), (&again.lights, &again.sky));
    assert_eq!(maps.sky.len(), lighting.sky.len());
    assert!(maps.lights.iter().flatten().all(|map| (64..2 * SHADOW_MAP_SIZE).contains(&map.depth.width)));
    let picture = deferred::shade(&frame, &lighting, &maps, &Options::default());
    assert!(picture.image.pixels.iter().flatten().all(|v| v.is_finite()));
    let dark = picture.terms.visibility[0].pixels.iter().filter(|v| **v < 0.1).count();
    assert!(dark > 20, "{dark} pixels in the shadow");
}

/// Light goes through glass, unless it takes more than half of it.
#[test]
fn clear_bodies_and_panes_cast_no_shadow() {
    let glass = |color: f32, thin_walled| Material {
        surface: Principled { transmission: 1.0, roughness: 0.0, base_color: Vec3A::splat(color), ..Principled::default() },
        thin_walled,
        ..Material::default()
    };
    // Pixels of the floor in the shadow of the strongest light.
    let dark = |material: Material| {
        let scene = compile(&ball(Vec3::new(0.0, 1.5, 0.0), material));
        let lighting = Lighting::new(Arc::clone(scene.light()), deferred::LIGHTS);
        let (frame, _) = render(&scene, 1);
        let maps = shadow_maps(&scene, &lighting, &frame);
        let picture = deferred::shade(&frame, &lighting, &maps, &Options::default());
        let seen = picture.terms.visibility[0].pixels.iter().zip(&frame.object_id.pixels);
        seen.filter(|(seen, object)| **seen < 0.1 && **object == 2).count()
    };
    let shadow = dark(diffuse([0.5; 3]));
    assert!(shadow > 20, "{shadow} pixels");
    for thin in [false, true] {
        let [bright, dim] = [0.9, 0.4].map(|color| dark(glass(color, thin)));
        // Beside the ball of glass, one pixel of the floor is dark.
        assert!(bright <= 1 && dim > 20, "{bright} and {dim} pixels");
    }
}

/// A sequence of frames about a still scene looks at some tiles again and again; what is kept of them does not show, and a scene
/// where something moves keeps none.
#[test]
fn kept_tiles_do_not_show() {
    let still = ball(Vec3::new(0.0, 1.5, 0.0), diffuse([0.5; 3]));
    let mut moving = still.clone();
    moving.instances[0].transforms = (0..6).map(|i| Affine3A::from_translation(Vec3::new(0.2 * i as f32, 1.5, 0.0))).collect();
    for mut loaded in [still, moving] {
        let about = |i: usize| camera([0.5 + 0.3 * i as f32, 6.0, 5.0 - 0.1 * i as f32], [0.0; 3], 50.0, 64, 64);
        loaded.cameras = (0..6).map(about).collect();
        let mut scene = compile(&loaded);
        let lighting = Lighting::new(Arc::clone(scene.light()), deferred::LIGHTS);
        let mut tiles = ShadowTiles::default();
        for index in [0, 1, 2, 5, 4, 3, 0] {
            scene.set_frame(index);
            let frame = render_gbuffer(&scene, &Settings::default()).expect("in range");
            let (kept, afresh) = (tiles.maps(&scene, &lighting, &frame), shadow_maps(&scene, &lighting, &frame));
            assert!(kept.lights == afresh.lights && kept.sky == afresh.sky, "frame {index}");
        }
    }
}
