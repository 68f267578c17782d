//! Colours of vertices: they multiply the base colour and what the surface covers, and are interpolated over triangles.

mod common;

use common::{camera, compile, diffuse, furthest, plane, render, scene, sphere, sunny};
use glam::{Affine3A, Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::Frame;
use renderflow_renderer::{RenderScene, Sharing};
use renderflow_scenes::loaded::AlphaMask;
use renderflow_scenes::{LoadedScene, Material, Principled};

/// A floor of `material`, a ball of it, and a ball of something else that has no colours.
fn pictured(material: &Material) -> LoadedScene {
    let ball = |x: f32| Affine3A::from_translation(Vec3::new(x, 0.7, 0.0)) * Affine3A::from_scale(Vec3::splat(0.7));
    let parts = vec![
        (plane(4.0), material.clone(), Affine3A::IDENTITY),
        (sphere(12, true), material.clone(), ball(0.4)),
        (sphere(4, false), diffuse([0.5; 3]), ball(-1.2)),
    ];
    scene(parts, sunny(), camera([0.0, 1.5, 4.0], [0.0, 0.5, 0.0], 45.0, 40, 30))
}

/// The scene with `color` at every vertex of the first two bodies.
fn colored(material: &Material, color: Vec4) -> LoadedScene {
    let mut loaded = pictured(material);
    for mesh in &mut loaded.meshes[..2] {
        mesh.colors = vec![color; mesh.positions.len()];
    }
    loaded
}

/// One colour everywhere gives the picture of a material with that colour and that opacity.
#[test]
fn one_color_everywhere_is_that_of_a_material() {
    let color = Vec4::new(0.25, 0.5, 0.75, 0.5);
    let base = Vec3A::new(0.8, 0.6, 0.4);
    let tinted = |mut material: Material| {
        material.surface.base_color *= Vec3A::from_vec4(color);
        material
    };
    let surface = Principled { base_color: base, roughness: 0.6, ..Principled::default() };
    let plain = Material::from(surface);
    let glass = Material::from(Principled { transmission: 1.0, roughness: 0.0, ..surface });
    let pane = Material { thin_walled: true, ..glass.clone() };
    let mask = |cutoff: f32, factor: f32| Material { alpha_mask: Some(AlphaMask { cutoff, factor }), ..plain.clone() };
    let blend = |opacity: f32| Material { opacity: Some(opacity), ..plain.clone() };
    for (name, with, like) in [
        ("colour", plain.clone(), tinted(plain.clone())),
        ("glass", glass.clone(), tinted(glass)),
        ("pane", pane.clone(), tinted(pane)),
        ("blend", blend(0.9), tinted(blend(0.45))),
        ("a mask that cuts all", mask(0.6, 1.0), tinted(mask(0.6, 0.5))),
        ("a mask that cuts nothing", mask(0.4, 1.0), tinted(plain.clone())),
    ] {
        for sharing in [Sharing::Never, Sharing::Always] {
            let compiled = |loaded: &LoadedScene| RenderScene::compile_with(loaded, sharing).expect("consistent");
            let (got, _) = render(&compiled(&colored(&with, color)), 16);
            let (expected, _) = render(&compiled(&pictured(&like)), 16);
            let apart = furthest(&got, &expected);
            assert!(apart < 1e-4, "{name}, {sharing:?}: {apart}");
            let passed = |frame: &Frame| frame.transmittance.as_ref().map_or(vec![], |t| t.pixels.as_flattened().to_vec());
            let [a, b] = [passed(&got), passed(&expected)];
            assert!(a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5), "{name}: transmittance");
            assert!(got.alpha == expected.alpha, "{name}: coverage");
            let (without, _) = render(&compiled(&pictured(&with)), 16);
            assert!(furthest(&got, &without) > 0.01, "{name}: the colours show");
        }
    }
}

/// Colours that grow evenly over the floor do so in the G-buffer, too.
#[test]
fn colors_are_interpolated() {
    let at = |p: Vec3| Vec3::new(0.5 + 0.2 * p.x, 0.5 + 0.2 * p.z, 0.5 - 0.1 * p.x);
    let above = camera([0.0, 3.0, 0.01], [0.0; 3], 40.0, 24, 24);
    let mut loaded = scene(vec![(plane(4.0), diffuse([0.8; 3]), Affine3A::IDENTITY)], sunny(), above);
    loaded.meshes[0].colors = loaded.meshes[0].positions.iter().map(|&p| at(p).extend(1.0)).collect();
    for sharing in [Sharing::Never, Sharing::Always] {
        let (frame, _) = render(&RenderScene::compile_with(&loaded, sharing).expect("consistent"), 1);
        for y in 0..24 {
            for x in 0..24 {
                let direction = above.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                let p = above.camera_to_world.translation - direction * (above.camera_to_world.translation.y / direction.y);
                let got = Vec3::from(*frame.albedo.at(x, y));
                assert!(got.distance(0.8 * at(p.into())) < 1e-4, "{x} {y}: {got}");
            }
        }
    }
}

/// A material that changes keeps the colours, and a mesh on it without any is white.
#[test]
fn they_stay_when_the_material_changes() {
    let mut floor = diffuse([0.2; 3]);
    floor.change = Some(Principled { base_color: [0.6; 3].into(), ..floor.surface });
    let mut loaded = pictured(&floor);
    loaded.cameras = vec![loaded.cameras[0]; 3];
    let count = loaded.meshes[0].positions.len();
    loaded.meshes[0].colors = vec![Vec4::new(1.0, 0.5, 0.25, 1.0); count];
    let mut compiled = compile(&loaded);
    for (frame, base) in [(0, 0.2), (1, 0.4), (2, 0.6), (0, 0.2)] {
        compiled.set_frame(frame);
        let (picture, _) = render(&compiled, 1);
        let albedo = |object: usize| {
            let pixel = picture.object_id.pixels.iter().position(|&id| id as usize == object).expect("it is seen");
            Vec3::from(picture.albedo.pixels[pixel])
        };
        assert!(albedo(1).distance(base * Vec3::new(1.0, 0.5, 0.25)) < 1e-5, "frame {frame}: {}", albedo(1));
        assert!(albedo(2).distance(Vec3::splat(base)) < 1e-5, "frame {frame}: {}", albedo(2));
    }
}
