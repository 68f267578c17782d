//! Textures that are looked up in a further set of texture coordinates: the picture is that of a mesh which has those coordinates
//! as its only set.

mod common;

use common::{camera, diffuse, furthest, plane, render, scene, sphere, sunny};
use glam::{Affine3A, Vec2, Vec3};
use renderflow_renderer::{RenderScene, Sharing};
use renderflow_scenes::loaded::{AlphaMask, Encoding, Texture, Wrap};
use renderflow_scenes::{LoadedScene, Material, Mesh, Principled, TextureSlot};

/// Coordinates of the first set, which nothing looks at but a texture of one colour.
fn elsewhere(mesh: &Mesh) -> Vec<Vec2> {
    mesh.positions.iter().map(|p| Vec2::new(3.0 * p.z, 0.1 * p.x)).collect()
}

/// A ball over a floor, both of `material`; in further sets, or as it is.
fn pictured(material: &Material, further: bool) -> LoadedScene {
    let ball = Affine3A::from_translation(Vec3::new(0.0, 0.7, 0.0)) * Affine3A::from_scale(Vec3::splat(0.7));
    let parts = vec![
        (plane(4.0), material.clone(), Affine3A::IDENTITY),
        (sphere(12, true), material.clone(), ball),
        (sphere(4, false), diffuse([0.5; 3]), Affine3A::from_translation(Vec3::new(-1.5, 0.3, 0.0))),
    ];
    let mut loaded = scene(parts, sunny(), camera([0.0, 1.5, 4.0], [0.0, 0.5, 0.0], 45.0, 40, 30));
    let texels: Vec<[u8; 4]> = (0..64).map(|i| [40 + 3 * i, 255 - 3 * i, 90, if i % 3 == 0 { 0 } else { 200 }]).collect();
    let wrap = [Wrap::Repeat; 2];
    loaded.textures = vec![
        Texture::from_rgba8("tiles", [8, 8], texels, Encoding::Srgb, wrap),
        Texture::from_rgba8("even", [1, 1], vec![[255, 128, 255, 255]], Encoding::Linear, wrap),
    ];
    if further {
        for mesh in &mut loaded.meshes {
            let first = elsewhere(mesh);
            mesh.more_uvs = vec![vec![], std::mem::replace(&mut mesh.uvs, first)];
        }
        for material in &mut loaded.materials {
            material.texture_slots_mut().filter(|slot| slot.texture == 0).for_each(|slot| slot.set = 2);
        }
    }
    loaded
}

#[test]
fn a_further_set_makes_the_picture_of_an_only_set() {
    let slot = |texture| Some(TextureSlot { texture, ..TextureSlot::default() });
    let textured = Material { base_color_texture: slot(0), metallic_roughness_texture: slot(1), ..Material::default() };
    let glass = Principled { transmission: 1.0, roughness: 0.0, ..Principled::default() };
    for (name, material) in [
        ("colour", textured.clone()),
        ("emission", Material { emissive: [2.0; 3], emissive_texture: slot(0), base_color_texture: None, ..textured.clone() }),
        ("mask", Material { alpha_mask: Some(AlphaMask { cutoff: 0.5, factor: 1.0 }), ..textured.clone() }),
        ("blend", Material { opacity: Some(0.9), ..textured.clone() }),
        ("pane", Material { surface: glass, thin_walled: true, transmission_texture: slot(0), ..textured }),
    ] {
        for sharing in [Sharing::Never, Sharing::Always] {
            let made = |further| {
                let compiled = RenderScene::compile_with(&pictured(&material, further), sharing).expect("consistent");
                render(&compiled, 8).0
            };
            let (own, further) = (made(false), made(true));
            // The level of detail is found by other code and may differ in its last bit.
            let apart = furthest(&own, &further);
            assert!(apart < 1e-4, "{name}, {sharing:?}: {apart}");
            assert_eq!(own.albedo, further.albedo);
            let wrong =
                Material { base_color_texture: None, emissive_texture: None, transmission_texture: None, ..material.clone() };
            let plain = RenderScene::compile_with(&pictured(&wrong, true), sharing).expect("consistent");
            assert!(furthest(&render(&plain, 8).0, &own) > 0.01, "{name}: the texture shows");
        }
    }
}

/// A set that a mesh does not have is zeros, as the first one is.
#[test]
fn a_missing_set_is_one_texel() {
    let slot = TextureSlot { texture: 0, set: 1, ..TextureSlot::default() };
    let material = Material { base_color_texture: Some(slot), ..Material::default() };
    let mut loaded = pictured(&material, false);
    let compiled = RenderScene::compile(&loaded).expect("consistent");
    let frame = render(&compiled, 1).0;
    let colors: Vec<[f32; 3]> =
        frame.albedo.pixels.iter().zip(&frame.object_id.pixels).filter(|(_, id)| **id == 1).map(|(color, _)| *color).collect();
    assert!(colors.len() > 100 && colors.iter().all(|color| *color == colors[0]));
    // No material has more kinds of textures than there may be sets.
    loaded.materials[0].texture_slots_mut().for_each(|slot| slot.set = 1000);
    assert!(RenderScene::compile(&loaded).is_err());
}

/// An angle turns the direction of highlights in the surface: a quarter turn is the other axis of the texture coordinates.
#[test]
fn the_direction_of_highlights_turns() {
    let brushed = |rotation: f32, swapped: bool| {
        let surface = Principled { metallic: 1.0, roughness: 0.3, anisotropic: 0.9, ..Principled::default() };
        let material = Material { anisotropy_rotation: rotation, ..Material::from(surface) };
        let mut mesh = plane(4.0);
        // u runs along +x; green of a normal map points to where v falls: the bitangent is -z.
        let (tangent, w) = if swapped { ([0.0, 0.0, -1.0], 1.0) } else { ([1.0, 0.0, 0.0], 1.0) };
        mesh.tangents = vec![glam::Vec3::from(tangent).extend(w); 4];
        let loaded = scene(vec![(mesh, material, Affine3A::IDENTITY)], sunny(), camera([0.0, 1.5, 4.0], [0.0; 3], 45.0, 40, 30));
        let frame = render(&RenderScene::compile(&loaded).expect("consistent"), 16).0;
        frame.beauty.expect("asked for").pixels
    };
    let distance = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f64 {
        let difference = |(a, b): (&[f32; 3], &[f32; 3])| f64::from((a[1] - b[1]).abs());
        a.iter().zip(b).map(difference).sum::<f64>() / a.len() as f64
    };
    let (along, turned, across) = (brushed(0.0, false), brushed(std::f32::consts::FRAC_PI_2, false), brushed(0.0, true));
    let (same, other) = (distance(&turned, &across), distance(&along, &across));
    assert!(same < 1e-3 * other, "{same} {other}");
    // Half a turn is the same axis, with other samples.
    assert!(distance(&brushed(std::f32::consts::PI, false), &along) < 0.3 * other);
}
