//! Scenes around inputs, as JSON, so that they hold for any version of the structs.

use renderflow_frame::reach::Reach;
use renderflow_scenes::load::ModelView;
use renderflow_scenes::{LoadedScene, Result, Scene, load};
use std::path::Path;

fn parse(text: &str) -> Scene {
    Scene::from_json(Path::new("around.json"), text).expect("the scene around an input is valid")
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
