//! Scenes around inputs, as JSON, so that they hold for any version of the structs.

use glam::{DAffine3, DVec3};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{Animation, EnvironmentSource, NameOrNumber};
use renderflow_scenes::load::{Capture, ModelView};
use renderflow_scenes::{Error, LoadedScene, Result, Scene, load};
use std::path::Path;

fn parse(text: &str) -> Scene {
    Scene::from_json(Path::new("around.json"), text).expect("the scene around an input is valid")
}

/// A plane seen by the cameras of the file `name` in `folder`, after those cameras were placed around a model.
pub fn capture(folder: &Path, name: &str) -> Result<LoadedScene> {
    let capture = Capture::read(&folder.join(name))?;
    // Far away and much smaller, turned and mirrored: refusing is an answer.
    for placement in [DAffine3::from_scale(DVec3::splat(1e-6)), DAffine3::from_translation(DVec3::splat(-1e6))] {
        let mut scene = parse(PLANE);
        scene.resolution = capture.size().unwrap_or(scene.resolution);
        if let Ok(path) = capture.path(scene.resolution, placement) {
            scene.camera = path;
            // Too many pixels are not the fault of the cameras.
            if let Err(Error::Invalid { problems, .. }) = scene.validate() {
                assert!(problems.iter().all(|problem| problem.pointer == "/resolution"), "cameras that were placed: {problems:?}");
            }
        }
    }
    let mut scene = parse(PLANE);
    // Long sequences only repeat the work.
    scene.frames = capture.len().min(9) as u32;
    scene.camera = capture.path(scene.resolution, DAffine3::IDENTITY)?;
    scene.resolution = capture.size().unwrap_or(scene.resolution);
    load::load(&scene, &Reach::folder(folder))
}

const PLANE: &str = r#"{"version": 1, "name": "fuzz", "resolution": [4, 4],
    "camera": {"type": "orbit", "target": [0, 0, 0], "distance": 3, "elevation": 20, "azimuth": 0, "degrees_per_frame": 1, "vertical_fov": 40},
    "environment": {"source": {"constant": [1, 1, 1]}},
    "objects": [{"name": "o", "geometry": {"shape": {"family": "plane", "size": 1}}}]}"#;

/// The model file `name` in `folder` as its animation plays, and as its cameras see it. Both may be refused.
pub fn in_motion(folder: &Path, name: &str) {
    let reach = Reach::folder(folder);
    let path = folder.join(name);
    let Ok(contents) = load::contents(&path, &reach) else { return };
    let views = [None, Some(Animation { clip: None, frames_per_second: 3.0, start: 0.1 })];
    for animation in views.into_iter().filter(|view| view.is_none() || !contents.animations.is_empty()) {
        let view = ModelView { animation, frames: 3, ..ModelView::default() };
        let Ok(scene) = load::describe_model(&path, None, &view, &reach) else { continue };
        let mut seen = scene.clone();
        for number in 0..contents.cameras.len().min(3) as u32 {
            if load::look_through(&mut seen, &NameOrNumber::Number(number), &reach).is_ok() {
                seen.validate().expect("a scene seen by a camera of its file is valid");
            }
        }
        if view.animation.is_some() || !contents.cameras.is_empty() {
            seen.environment.source = EnvironmentSource::Constant([1.0; 3]);
            if let Ok(loaded) = load::load(&seen, &reach) {
                crate::check_scene(&loaded);
            }
        }
    }
}

/// Loads the model file `name` in `folder`, with its materials, after describing a scene around it.
pub fn model(folder: &Path, name: &str) -> Result<LoadedScene> {
    let reach = Reach::folder(folder);
    if let Ok(around) = load::describe_model(&folder.join(name), None, &ModelView::default(), &reach) {
        around.validate().expect("a scene around a model is valid");
    }
    let scene = format!(
        r#"{{"version": 1, "name": "fuzz", "resolution": [4, 4],
            "camera": {{"type": "orbit", "target": [0, 0, 0], "distance": 3, "elevation": 20, "azimuth": 0, "degrees_per_frame": 1, "vertical_fov": 40}},
            "environment": {{"source": {{"constant": [1, 1, 1]}}}},
            "objects": [{{"name": "model", "geometry": {{"file": "{name}"}}}}]}}"#
    );
    load::load(&parse(&scene), &reach)
}

/// Loads one image file three times: as colour, as data and as a normal map.
pub fn textures(folder: &Path, name: &str) -> Result<LoadedScene> {
    let scene = format!(
        r#"{{"version": 1, "name": "fuzz", "resolution": [4, 4],
            "camera": {{"type": "orbit", "target": [0, 0, 0], "distance": 3, "elevation": 20, "azimuth": 0, "degrees_per_frame": 1, "vertical_fov": 40}},
            "environment": {{"source": {{"constant": [1, 1, 1]}}}},
            "materials": [{{"name": "m", "base_color_texture": "{name}", "metallic_roughness_texture": "{name}", "normal_texture": "{name}"}}],
            "objects": [{{"name": "o", "material": "m", "geometry": {{"shape": {{"family": "plane", "size": 1}}}}}}]}}"#
    );
    load::load(&parse(&scene), &Reach::folder(folder))
}

/// A binary glTF file of its JSON and its binary chunk (glTF 2.0, section 4.4).
pub fn binary(json: &[u8], chunk: &[u8]) -> Vec<u8> {
    let padded = |data: &[u8], filler| {
        let mut data = data.to_vec();
        data.resize(data.len().next_multiple_of(4), filler);
        data
    };
    let (json, chunk) = (padded(json, b' '), padded(chunk, 0));
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((28 + json.len() as u32 + chunk.len() as u32).to_le_bytes());
    for (kind, data) in [(b"JSON", json), (b"BIN\0", chunk)] {
        bytes.extend((data.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(data);
    }
    bytes
}
