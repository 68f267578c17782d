//! Images are read only where something looks at them.

mod common;

use common::{empty_scene, grey};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{Geometry, Material, Object, Scene};
use renderflow_scenes::load;
use renderflow_scenes::shapes::Shape;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("examples")
}

/// An image that is there.
fn image() -> String {
    let mut found: Vec<_> = std::fs::read_dir(folder().join("textures")).unwrap().map(|e| e.unwrap().file_name()).collect();
    found.sort();
    format!("textures/{}", found[0].to_str().unwrap())
}

fn object(name: &str, geometry: Geometry, material: &str) -> Object {
    Object {
        name: name.into(),
        geometry,
        material: Some(material.into()),
        transform: Default::default(),
        motion: None,
        animation: None,
    }
}

fn ball(name: &str, material: &str) -> Object {
    object(name, Geometry::Shape(Shape::Sphere { radius: 1.0 }), material)
}

fn scene(materials: Vec<Material>, objects: Vec<Object>) -> Scene {
    Scene { materials, objects, ..empty_scene() }
}

#[test]
fn only_textures_that_something_looks_at_are_read() {
    let image = Some(image());
    let gone = Some("textures/gone.png".to_owned());
    let colored = Material { base_color_texture: image.clone(), ..grey("colored") };
    let idle = Material { base_color_texture: gone.clone(), normal_texture: gone.clone(), ..grey("idle") };
    let dark = Material {
        base_color: [0.0; 3],
        base_color_texture: gone.clone(),
        emissive_texture: gone.clone(),
        roughness: 0.0,
        metallic_roughness_texture: gone.clone(),
        ..grey("dark")
    };
    let described = scene(vec![idle, dark, colored], vec![ball("a", "colored"), ball("b", "dark")]);
    let loaded = load::load(&described, &Reach::folder(folder())).unwrap();
    assert_eq!((loaded.textures.len(), loaded.materials.len()), (1, 3));
    let slots: Vec<usize> = loaded.materials.iter().map(|m| m.texture_slots().count()).collect();
    assert_eq!(slots, [0, 0, 1]);
    let slot = loaded.materials[2].base_color_texture.as_ref().unwrap();
    assert!(slot.texture == 0 && !loaded.textures[0].levels.is_empty());
    assert_eq!(loaded.report.notes, ["material \"idle\" is on no object: its textures are not read"]);

    // Everything, where that is asked for: then the images must be there.
    let error = load::load_everything(&described, &Reach::folder(folder())).unwrap_err().to_string();
    assert!(error.contains("gone.png"), "{error}");
}

#[test]
fn a_broken_texture_that_is_looked_at_is_an_error_with_its_place() {
    let broken = Material { base_color_texture: Some("textures/gone.png".into()), ..grey("broken") };
    let error =
        load::load(&scene(vec![grey("a"), broken], vec![ball("b", "broken")]), &Reach::folder(folder())).unwrap_err().to_string();
    assert!(error.starts_with("/materials/1: ") && error.contains("broken") && error.contains("gone.png"), "{error}");
}

/// A mesh without texture coordinates has no tangents, so that a normal map has no direction to lean to.
#[test]
fn normal_maps_need_tangents() {
    let bumpy = Material { normal_texture: Some(image()), ..grey("bumpy") };
    let file = tempfile::tempdir().unwrap();
    let bare = file.path().join("bare.obj");
    std::fs::write(&bare, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let bare = Geometry::File(bare.to_str().unwrap().into());
    let load = |objects: Vec<Object>| {
        load::load(&scene(vec![bumpy.clone()], objects), &Reach::folder(folder()).allow([file.path()])).unwrap()
    };
    let without = load(vec![object("bare", bare.clone(), "bumpy")]);
    assert_eq!((without.textures.len(), without.materials[0].normal_texture.is_some()), (0, false));
    assert_eq!(without.report.notes.len(), 1, "{:?}", without.report.notes);
    // One mesh that can use it is enough.
    let with = load(vec![object("bare", bare, "bumpy"), ball("ball", "bumpy")]);
    assert_eq!((with.textures.len(), with.materials[0].normal_texture.is_some()), (1, true));
}
