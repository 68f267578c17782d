//! The scene that a command works on: a file, a model or a composed scene, with the options that change it.

use crate::dataset::plan::Plan;
use crate::util::files;
use crate::util::ranges::{Resolution, resolution};
use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{EnvironmentSource, Scene};
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::procedural::{Composition, Split, compose_one};
use renderflow_scenes::sky;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A model file or a scene, instead of a composed scene.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Input")]
pub(super) struct SceneArgs {
    /// Scene (.json) or model (.gltf, .glb, .obj). A model stands on a ground plane. Without a file, a scene is composed from
    /// --seed
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
    /// Change a value of the scene, for example materials/0/roughness=.2. May be given several times
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

    /// The scene to work on, and the files that it may name. The scene comes from a file, or is composed with meshes and light
    /// that training never sees. It may name files in its own folder, in the folders that are `allowed`, and those that the user
    /// names here.
    pub(super) fn describe(&self, allowed: &[PathBuf], wanted: &Wanted) -> Result<(Scene, Reach)> {
        if let Some(path) = &self.earlier {
            eprintln!("note: --scene will be removed; write the file without it: {}", path.display());
        }
        let Wanted { seed, composed, frames, .. } = *wanted;
        let size = wanted.resolution.map(|Resolution(size)| size);
        let mut reach = self.file().map_or_else(|| Reach::folder("."), Reach::of).allow(allowed);
        if let Some(path) = self.file() {
            tracing::info!(path = %path.display(), "reading");
        }
        let mut scene = match self.file() {
            None => {
                let size = size.unwrap_or([256; 2]);
                compose_one(seed.unwrap_or(composed), Split::Test, size, frames.unwrap_or(1), &Composition::default())?
            }
            Some(path) if files::has_ending(path, &["json"]) => read(path, &self.set)?,
            Some(path) => {
                let usual = ModelView::default();
                let view = ModelView { resolution: size.unwrap_or(usual.resolution), frames: frames.unwrap_or(1), ..usual };
                let scene = load::describe_model(path, None, &view, &reach)?;
                if view.ground && scene.objects.len() == 1 {
                    eprintln!("note: {}: the model has a floor of its own, so no ground plane is added", path.display());
                }
                scene
            }
        };
        if let (Some(seed), Some(_)) = (seed, self.file()) {
            scene.seed = seed;
        }
        scene.resolution = size.unwrap_or(scene.resolution);
        scene.frames = frames.unwrap_or(scene.frames);
        if let Some(hdri) = &self.hdri {
            scene.environment.source = match environment(hdri)? {
                EnvironmentSource::File(path) => {
                    reach = reach.allow([Path::new(&path)]);
                    EnvironmentSource::File(path)
                }
                builtin => builtin,
            };
        }
        scene.environment.rotation = self.hdri_rotation.unwrap_or(scene.environment.rotation);
        if !self.set.is_empty() {
            scene = apply(&scene, &self.set)?;
            scene.validate().context("--set")?;
        }
        let [width, height] = scene.resolution;
        tracing::info!(scene = scene.name, objects = scene.objects.len(), width, height, frames = scene.frames, "described");
        Ok((scene, reach))
    }
}

/// The scene in a file. It is checked at once, or after the settings have been applied.
fn read(path: &Path, settings: &[Setting]) -> Result<Scene> {
    if settings.is_empty() {
        return Ok(Scene::read(path)?);
    }
    Ok(renderflow_frame::file::read_json(path)?)
}

/// The environment that `--hdri` names: a built-in one, or a file, with its full path.
fn environment(name: &str) -> Result<EnvironmentSource> {
    let known = sky::names();
    if known.contains(&name) {
        return Ok(EnvironmentSource::Builtin(name.to_owned()));
    }
    let path = std::path::absolute(name).with_context(|| format!("--hdri {name}: no such path"))?;
    ensure!(
        path.exists(),
        "--hdri {name}: there is no such file, and no built-in environment of this name. There are {}",
        known.join(", ")
    );
    Ok(EnvironmentSource::File(path.to_string_lossy().into_owned()))
}

/// A value of a scene that the user changes: `PATH=VALUE`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Setting {
    /// The names and positions that lead to the value.
    path: Vec<String>,
    value: Value,
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (path, value) = text.split_once('=').ok_or("give PATH=VALUE, as in materials/0/roughness=.2")?;
        let path: Vec<String> =
            path.trim_matches('/').split('/').map(|step| step.replace("~1", "/").replace("~0", "~")).collect();
        if path.iter().any(String::is_empty) {
            return Err("the path has an empty part".into());
        }
        // A number may begin with its point. What is no JSON is a string.
        let number = || value.parse::<f64>().ok().filter(|number| number.is_finite()).map(Value::from);
        let value = serde_json::from_str(value).ok().or_else(number).unwrap_or_else(|| value.into());
        Ok(Self { path, value })
    }
}

/// `scene` with changed values. The result is not validated.
fn apply(scene: &Scene, settings: &[Setting]) -> Result<Scene> {
    // Through text: a single-precision 3.6 would otherwise become 3.5999999046325684.
    let mut whole: Value = serde_json::from_str(&scene.canonical_json())?;
    for setting in settings {
        let known = put(&mut whole, setting)?;
        if let Err(error) = serde_json::from_value::<Scene>(whole.clone()) {
            let reason = renderflow_frame::words::plain(&error.to_string());
            // The reason may list the names itself.
            let known = if reason.contains("expected") { "" } else { &known };
            bail!("--set {}: {reason}{known}", setting.path.join("/"));
        }
    }
    Ok(serde_json::from_value(whole)?)
}

/// Puts the value of `setting` in its place. Returns the names that are there, if its own name is not among them: then only the
/// description of scenes knows whether there may be such a name.
fn put(whole: &mut Value, setting: &Setting) -> Result<String> {
    let (mut place, mut above) = (whole, String::new());
    let (last, steps) = setting.path.split_last().context("an empty path")?;
    for step in steps {
        let known = known(place, &above);
        let next = match place {
            Value::Object(fields) => fields.get_mut(step),
            Value::Array(items) => step.parse().ok().and_then(|index: usize| items.get_mut(index)),
            _ => None,
        };
        place = next.with_context(|| format!("--set {}: there is no {step:?}{known}", setting.path.join("/")))?;
        above += &format!("/{step}");
    }
    let known = known(place, &above);
    match place {
        Value::Object(fields) => {
            let found = fields.insert(last.clone(), setting.value.clone()).is_some();
            return Ok(if found { String::new() } else { known });
        }
        Value::Array(items) => {
            if let Some(item) = last.parse().ok().and_then(|index: usize| items.get_mut(index)) {
                *item = setting.value.clone();
                return Ok(String::new());
            }
        }
        _ => {}
    }
    bail!("--set {}: there is no {last:?}{known}", setting.path.join("/"))
}

/// The names or positions inside of a value, as the end of an error.
fn known(value: &Value, at: &str) -> String {
    let at = if at.is_empty() { "the scene" } else { at };
    match value {
        Value::Object(fields) => format!("; {at} has {}", fields.keys().cloned().collect::<Vec<_>>().join(", ")),
        Value::Array(items) if items.is_empty() => format!("; {at} is empty"),
        Value::Array(items) => format!("; {at} has 0 to {}", items.len() - 1),
        _ => format!("; {at} is a single value"),
    }
}

/// A parser of `--resolution` for scenes of any size.
pub(super) fn any_resolution() -> impl Fn(&str) -> std::result::Result<Resolution, String> + Clone + Send + Sync + 'static {
    resolution(Plan::RESOLUTION)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Scene {
        compose_one(3, Split::Test, [32, 32], 1, &Composition::default()).expect("a scene")
    }

    fn set(settings: &[&str]) -> Result<Scene> {
        apply(&scene(), &settings.iter().map(|text| text.parse().expect("a setting")).collect::<Vec<_>>())
    }

    #[test]
    fn settings_change_their_value_and_nothing_else() {
        let mut expected = scene();
        expected.resolution[1] = 48;
        expected.name = "mine".into();
        expected.environment.rotation = 0.25;
        assert_eq!(set(&["/resolution/1=48", "name=mine", "environment/rotation=.25"]).expect("a scene"), expected);
        assert_eq!(set(&[]).expect("a scene"), scene());
    }

    #[test]
    fn a_wrong_path_is_answered_with_what_there_is() {
        for (setting, words) in [
            ("sampels=4", &["--set sampels: unknown field `sampels`", "`resolution`"][..]),
            ("resolution/2=4", &["no \"2\"", "/resolution has 0 to 1"]),
            ("environment/turn=4", &["--set environment/turn", "unknown field `turn`", "rotation"]),
            ("objects/0/materials/roughness=4", &["no \"materials\"", "/objects/0 has"]),
            ("name/first=4", &["/name is a single value"]),
            ("frames=many", &["--set frames", "many"]),
        ] {
            let said = format!("{:#}", set(&[setting]).expect_err(setting));
            assert!(words.iter().all(|word| said.contains(word)), "{setting}: {said}");
        }
        for bad in ["", "frames", "=4", "a//b=4"] {
            assert!(bad.parse::<Setting>().is_err(), "{bad}");
        }
    }
}
