//! The scene that a command works on: a file, a model or a composed scene, with the options that change it.

use crate::dataset::plan::Plan;
use crate::dataset::source::{Described, SceneSource, Setting};
use crate::util::ranges::{Resolution, resolution};
use anyhow::Result;
use clap::Args;
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{Animation, NameOrNumber, Scene};
use renderflow_scenes::sky;
use std::path::{Path, PathBuf};

/// A model file or a scene, instead of a composed scene.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Input")]
pub(super) struct SceneArgs {
    /// Scene (.json) or model (.gltf, .glb, .obj, .ply). A model stands on a ground plane. Without a file, a scene is composed
    /// from --seed
    #[arg(value_name = "SCENE", id = "SCENE", help_heading = None::<&str>)]
    file: Option<PathBuf>,
    /// The earlier form of SCENE
    #[arg(long = "scene", value_name = "FILE", id = "scene", hide = true, conflicts_with = "SCENE")]
    earlier: Option<PathBuf>,
    /// Environment map (.hdr, .exr), or the name of a built-in one
    #[arg(long, value_name = "MAP", long_help = format!(
        "Environment map (.hdr, .exr), or the name of a built-in one: {}", sky::names().join(", ")
    ))]
    hdri: Option<String>,
    /// Degrees by which to turn the environment about +Y
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    hdri_rotation: Option<f32>,
    /// Look through a camera of the model file. A wrong name is answered with the names that there are; numbers start at 0
    #[arg(long, value_name = "NAME|NUMBER", conflicts_with = "cameras")]
    camera: Option<NameOrNumber>,
    /// Look through the cameras of a transforms.json, one for each frame (nerfstudio, instant-ngp, or this program). They stand
    /// in the coordinates of the model file, or in the world of the scene
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    /// Play an animation of the model file, at 24 frames a second; the first one, if no name is given. Without --frames, there
    /// are as many frames as it lasts
    #[arg(long, value_name = "NAME|NUMBER", num_args = 0..=1, default_missing_value = "0")]
    animation: Option<NameOrNumber>,
    /// Change a value of the scene, for example materials/0/roughness=.2; materials/-={...} adds one. May be given several times
    #[arg(long, value_name = "PATH=VALUE")]
    set: Vec<Setting>,
}

/// What a command asks of its scene beside [`SceneArgs`].
pub(super) struct Wanted {
    /// Composes the scene. A scene or model from a file is sampled with it.
    pub(super) seed: Option<u64>,
    /// Composes the scene where there is no seed.
    pub(super) composed: u64,
    pub(super) resolution: Option<Resolution>,
    pub(super) frames: Option<u32>,
}

impl SceneArgs {
    /// The file, if one is named.
    pub(super) fn file(&self) -> Option<&Path> {
        self.file.as_deref().or(self.earlier.as_deref())
    }

    /// Whether nothing is asked of a scene.
    pub(super) fn is_empty(&self) -> bool {
        let Self { file, earlier, hdri, hdri_rotation, camera, cameras, animation, set } = self;
        let files = [file, earlier, cameras].iter().all(|file| file.is_none());
        files && hdri.is_none() && hdri_rotation.is_none() && camera.is_none() && animation.is_none() && set.is_empty()
    }

    /// The scene to work on, and the files that it may name: in its own folder, in the folders `allowed`, and those that the user
    /// names here.
    pub(super) fn describe(&self, allowed: &[PathBuf], wanted: &Wanted) -> Result<(Scene, Reach)> {
        if let Some(path) = &self.earlier {
            eprintln!("note: --scene will be removed; write the file without it: {}", path.display());
        }
        let file = self.file().map(Path::to_owned);
        let seed = if file.is_some() { wanted.seed } else { wanted.seed.or(Some(wanted.composed)) };
        let source = SceneSource {
            file,
            seed,
            hdri: self.hdri.clone(),
            hdri_rotation: self.hdri_rotation,
            resolution: wanted.resolution.map(|Resolution(size)| size),
            frames: wanted.frames,
            camera: self.camera.clone(),
            cameras: self.cameras.clone(),
            animation: self.animation.clone().map(|clip| Animation { clip: Some(clip), ..Animation::default() }),
            set: self.set.clone(),
        };
        let Described { scene, reach, notes } = source.describe(allowed)?;
        notes.iter().for_each(|note| eprintln!("note: {note}"));
        Ok((scene, reach))
    }
}

/// A parser of `--resolution` for scenes of any size.
pub(super) fn any_resolution() -> impl Fn(&str) -> std::result::Result<Resolution, String> + Clone + Send + Sync + 'static {
    resolution(Plan::RESOLUTION)
}
