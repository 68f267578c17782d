//! Shadow maps of compiled scenes against closed forms.

mod common;

use common::{camera, compile, diffuse, plane, render, scene, sphere};
use glam::{Affine3A, Vec3, Vec3A};
use renderflow_frame::{Environment, Frame};
use renderflow_renderer::deferred::{self, Lighting, Options, SHADOW_MAP_SIZE, ShadowTiles, shadow_map, shadow_maps};
use renderflow_renderer::{Settings, render_gbuffer};
use renderflow_scenes::loaded::AlphaMask;
use renderflow_scenes::{LoadedScene, Material};
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

/// Points of the floor about the origin.
fn floor() -> Vec<Vec3A> {
    (0..1600).map(|i| Vec3A::new((i % 40) as f32 * 0.1 - 1.95, 0.0, (i / 40) as f32 * 0.1 - 1.95)).collect()
}

/// How far the line from `p` towards `light` passes by the ball's middle.
fn miss(p: Vec3A, light: Vec3A, centre: Vec3) -> f32 {
    (Vec3A::from(centre) - p).cross(light).length()
}

#[test]
fn maps_hold_what_the_light_sees() {
    // Above the receivers, beside their square, and far towards the light.
    for (light, centre) in [
        (Vec3A::Y, Vec3::new(0.0, 2.0, 0.0)),
        (Vec3A::new(0.8, 0.6, 0.0), Vec3::new(4.0, 3.0, 0.2)),
        (Vec3A::new(-0.36, 0.8, 0.48), Vec3::new(-18.0, 40.0, 24.5)),
    ] {
        let scene = compile(&ball(centre, diffuse([0.5; 3])));
        let Some(map) = shadow_map(&scene, light, 0.0, &floor(), 256) else { panic!("no map") };
        let (mut dark, mut lit) = (0, 0);
        for p in floor() {
            assert!(map.covers(p, 5.0));
            let seen = map.visibility(p, Vec3A::Y, 0.0, 0.1);
            let distance = miss(p, light, centre);
            if distance < 0.9 {
                assert_eq!(seen, 0.0, "{p}");
                dark += 1;
            } else if distance > 1.1 {
                assert_eq!(seen, 1.0, "{p}");
                lit += 1;
            }
        }
        assert!(dark > 150 && lit > 400, "{dark} dark, {lit} lit");
        // The first row of the map's own axis is the distance away from the light.
        let at = map.world_to_map.transform_point3a(Vec3A::new(1.9, 0.0, -1.9));
        if miss(Vec3A::new(1.9, 0.0, -1.9), light, centre) > 1.1 {
            let stored = *map.depth.at(at.x as usize, at.y as usize);
            assert!((stored - at.z).abs() < 3.0 * map.texel, "{stored} {}", at.z);
        }
    }
}

#[test]
fn holes_cast_no_shadow() {
    let hole = Material { alpha_mask: Some(AlphaMask { cutoff: 0.5, factor: 0.2 }), ..diffuse([0.5; 3]) };
    let scene = compile(&ball(Vec3::new(0.0, 2.0, 0.0), hole));
    let Some(map) = shadow_map(&scene, Vec3A::Y, 0.01, &floor(), 128) else { panic!("no map") };
    assert!(floor().iter().all(|p| map.visibility(*p, Vec3A::Y, 0.01, 0.3) == 1.0));
}

#[test]
fn all_maps_of_a_frame_and_none_without_receivers() {
    let scene = compile(&ball(Vec3::new(0.0, 1.5, 0.0), diffuse([0.5; 3])));
    let lighting = Lighting::new(Arc::clone(scene.light()), deferred::LIGHTS);
    assert!(!lighting.lights.is_empty() && !lighting.sky.is_empty());
    let none = shadow_maps(&scene, &lighting, &Frame::default());
    assert!(none.sky.is_empty() && none.lights.iter().all(Vec::is_empty) && none.lights.len() == lighting.lights.len());
    assert!(shadow_map(&scene, Vec3A::Y, 0.0, &[Vec3A::NAN], 16).is_none());

    let (frame, _) = render(&scene, 1);
    let made = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| shadow_maps(&scene, &lighting, &frame))
    };
    let maps = made(1);
    assert_eq!(maps, made(3));
    assert_eq!(maps.sky.len(), lighting.sky.len());
    assert!(maps.lights.iter().flatten().all(|map| (64..2 * SHADOW_MAP_SIZE).contains(&map.depth.width)));
    let picture = deferred::shade(&frame, &lighting, &maps, &Options::default());
    assert!(picture.image.pixels.iter().flatten().all(|v| v.is_finite()));
    let dark = picture.terms.visibility[0].pixels.iter().filter(|v| **v < 0.1).count();
    assert!(dark > 20, "{dark} pixels in the shadow");
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
            assert!(tiles.maps(&scene, &lighting, &frame) == shadow_maps(&scene, &lighting, &frame), "frame {index}");
        }
    }
}

#[test]
fn a_single_receiver_and_an_empty_scene_are_no_trouble() {
    let scene = compile(&ball(Vec3::new(0.0, 2.0, 0.0), diffuse([0.5; 3])));
    let Some(map) = shadow_map(&scene, Vec3A::Y, 0.0, &[Vec3A::ZERO], 8) else { panic!("no map") };
    assert_eq!(map.visibility(Vec3A::ZERO, Vec3A::Y, 0.0, 0.0), 0.0);
    let empty =
        compile(&common::scene(Vec::new(), Environment::constant([1.0; 3]), camera([0.0, 1.0, 5.0], [0.0; 3], 50.0, 8, 8)));
    let Some(map) = shadow_map(&empty, Vec3A::Y, 0.0, &floor(), 8) else { panic!("no map") };
    assert!(map.depth.pixels.iter().all(|z| *z == f32::INFINITY));
}
