//! What the tests of this crate share.
#![allow(dead_code)]

pub mod gltf;

use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{CameraPath, EnvironmentLight, EnvironmentSource, Geometry, Material, Object, Scene};
use renderflow_scenes::{LoadedScene, Result, load};
use std::path::{Path, PathBuf};

/// A file of the shared assets, which stand beside the repository; `None` (and a word on the terminal) without them.
pub fn asset(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets").join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there", path.display());
    None
}

/// All files below a folder of the assets with one of the endings (any, if there is none), sorted.
pub fn assets_below(folder: &str, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = vec![];
    let mut open: Vec<PathBuf> = asset(folder).into_iter().collect();
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if endings.is_empty() || path.extension().is_some_and(|e| endings.iter().any(|ending| e == *ending)) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// A scene without objects.
pub fn empty_scene() -> Scene {
    Scene {
        version: 1,
        name: "test".into(),
        seed: 0,
        resolution: [8, 8],
        frames: 1,
        camera: CameraPath::Orbit {
            target: [0.0; 3],
            distance: 3.0,
            elevation: 20.0,
            azimuth: 0.0,
            degrees_per_frame: 3.6,
            vertical_fov: 40.0,
        },
        environment: EnvironmentLight { source: EnvironmentSource::Constant([1.0; 3]), rotation: 0.0, intensity: 1.0 },
        materials: vec![],
        objects: vec![],
        lights: vec![],
    }
}

/// A grey material.
pub fn grey(name: &str) -> Material {
    serde_json::from_value(serde_json::json!({ "name": name })).unwrap()
}

/// A scene with the model at `path`, with its own materials or the given one.
pub fn model_scene(path: &Path, material: Option<Material>) -> Scene {
    let name = material.as_ref().map(|m| m.name.clone());
    let object = Object {
        name: "model".into(),
        geometry: Geometry::File(path.to_str().unwrap().into()),
        material: name,
        transform: Default::default(),
        motion: None,
        animation: None,
    };
    Scene { materials: material.into_iter().collect(), objects: vec![object], ..empty_scene() }
}

/// The model at `path` in grey: its own materials and textures are not read.
pub fn load_model(path: &Path) -> Result<LoadedScene> {
    load::load(&model_scene(path, Some(grey("grey"))), &anywhere())
}

/// For tests that are not about names: they may lead anywhere.
pub fn anywhere() -> Reach {
    Reach::folder("").allow(["/"])
}
