//! Single maps against closed forms.

use super::*;
use crate::verify::scenes::{Part, camera, compile, diffuse, sunny};
use glam::{Affine3A, Vec3};
use renderflow_frame::Environment;
use renderflow_scenes::loaded::AlphaMask;
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Material, Mesh};

/// One map over all `receivers`, `size` texels along the longer side or up to 1.5 times as many; `None` where there are none.
/// `light` is the unit direction towards the light, `radius` the angle that it covers, radians.
fn shadow_map(scene: &RenderScene, light: Vec3A, radius: f32, receivers: &[Vec3A], size: usize) -> Option<ShadowMap> {
    let start = scene.first_along(-light);
    let plan = Plan::new(light, receivers, size)?.look(receivers, reach(radius, start))?;
    ShadowTiles::default().draw(scene, vec![plan]).pop()
}

/// A ball of radius 1 at `centre` over a wide floor, seen from above.
fn ball(centre: Vec3, material: Material) -> RenderScene {
    let positions = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, z]| 100.0 * Vec3::new(x, 0.0, z)).to_vec();
    let mesh = Mesh { positions, triangles: vec![[0, 2, 1], [0, 3, 2]], ..Mesh::default() };
    let floor = Part { mesh, material: diffuse([0.5; 3]), transform: Affine3A::IDENTITY };
    let ball = Part::new(Shape::Sphere { radius: 1.0 }, material, Affine3A::from_translation(centre));
    compile(vec![ball, floor], sunny(), camera([0.5, 6.0, 5.0], [0.0; 3], 50.0, 64, 64)).expect("consistent")
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
        let scene = ball(centre, diffuse([0.5; 3]));
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
    let scene = ball(Vec3::new(0.0, 2.0, 0.0), hole);
    let Some(map) = shadow_map(&scene, Vec3A::Y, 0.01, &floor(), 128) else { panic!("no map") };
    assert!(floor().iter().all(|p| map.visibility(*p, Vec3A::Y, 0.01, 0.3) == 1.0));
}

#[test]
fn a_single_receiver_and_an_empty_scene_are_no_trouble() {
    let scene = ball(Vec3::new(0.0, 2.0, 0.0), diffuse([0.5; 3]));
    let Some(map) = shadow_map(&scene, Vec3A::Y, 0.0, &[Vec3A::ZERO], 8) else { panic!("no map") };
    assert_eq!(map.visibility(Vec3A::ZERO, Vec3A::Y, 0.0, 0.0), 0.0);
    assert!(shadow_map(&scene, Vec3A::Y, 0.0, &[Vec3A::NAN], 16).is_none());
    let empty = compile(Vec::new(), Environment::constant([1.0; 3]), camera([0.0, 1.0, 5.0], [0.0; 3], 50.0, 8, 8));
    let empty = empty.expect("consistent");
    let Some(map) = shadow_map(&empty, Vec3A::Y, 0.0, &floor(), 8) else { panic!("no map") };
    assert!(map.depth.pixels.iter().all(|z| *z == f32::INFINITY));
}
