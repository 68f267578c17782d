//! Where a scene to work on comes from: a scene file, a model with a light, or a seed.

use crate::util::files;
use anyhow::{Context, Result};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{EnvironmentSource, Scene};
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::procedural::{Composition, Split, compose_one};
use std::path::{Path, PathBuf};

/// Pixels along both sides of a composed scene, unless somebody asks for others.
const RESOLUTION: [u32; 2] = [256; 2];

/// A scene that somebody asks for. What is `None` keeps the value of the file, or a default.
#[derive(Clone, Debug, Default)]
pub struct SceneSource {
    /// Scene file (.json) or model (.gltf, .glb, .obj). Without it, the scene is composed with meshes and light that training
    /// never sees.
    pub file: Option<PathBuf>,
    /// Environment map (.hdr, .exr), or the name of a built-in one.
    pub hdri: Option<String>,
    /// Degrees by which the environment is turned about +Y.
    pub hdri_rotation: Option<f32>,
    /// Seed. It composes the scene (1 by default), or samples the scene of a file.
    pub seed: Option<u64>,
    /// Columns and rows.
    pub resolution: Option<[u32; 2]>,
    /// Number of frames.
    pub frames: Option<u32>,
}

/// A scene, the files that it may name, and what was decided about it that a person should know.
pub struct Described {
    /// The scene.
    pub scene: Scene,
    /// Its own folder, the folders that are allowed, and the files that somebody named.
    pub reach: Reach,
    /// One sentence each.
    pub notes: Vec<String>,
}

impl SceneSource {
    /// Reads or composes the scene. It may name files in its own folder and in the folders `allowed`.
    ///
    /// # Errors
    /// When a file cannot be read, or its content is no valid scene or model.
    pub fn describe(&self, allowed: &[PathBuf]) -> Result<Described> {
        let mut reach = self.file.as_deref().map_or_else(|| Reach::folder("."), Reach::of).allow(allowed);
        let mut notes = Vec::new();
        let mut scene = match &self.file {
            None => {
                let (seed, frames) = (self.seed.unwrap_or(1), self.frames.unwrap_or(1));
                let resolution = self.resolution.unwrap_or(RESOLUTION);
                compose_one(seed, Split::Test, resolution, frames, &Composition::default())?
            }
            Some(path) if files::has_ending(path, &["json"]) => Scene::read(path)?,
            Some(path) => self.model(path, &reach, &mut notes)?,
        };
        if let (Some(seed), true) = (self.seed, self.file.is_some()) {
            scene.seed = seed;
        }
        scene.resolution = self.resolution.unwrap_or(scene.resolution);
        scene.frames = self.frames.unwrap_or(scene.frames);
        if let Some(hdri) = &self.hdri {
            let builtin = renderflow_scenes::sky::library().iter().any(|(name, _)| *name == hdri.as_str());
            scene.environment.source = if builtin {
                EnvironmentSource::Builtin(hdri.clone())
            } else {
                let path = std::path::absolute(hdri).with_context(|| format!("{hdri}: no such path"))?;
                reach = reach.allow([&path]);
                EnvironmentSource::File(path.to_string_lossy().into_owned())
            };
        }
        scene.environment.rotation = self.hdri_rotation.unwrap_or(scene.environment.rotation);
        Ok(Described { scene, reach, notes })
    }

    fn model(&self, path: &Path, reach: &Reach, notes: &mut Vec<String>) -> Result<Scene> {
        let usual = ModelView::default();
        let view =
            ModelView { resolution: self.resolution.unwrap_or(usual.resolution), frames: self.frames.unwrap_or(1), ..usual };
        let scene = load::describe_model(path, None, &view, reach)?;
        if view.ground && scene.objects.len() == 1 {
            notes.push(format!("{}: the model has a floor of its own, so no ground plane is added", path.display()));
        }
        Ok(scene)
    }
}
