//! Where a scene to work on comes from: a scene file, a model with a light, or a seed.

use crate::util::files;
use anyhow::{Context, Result, bail, ensure};
use glam::DAffine3;
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::{Animation, EnvironmentSource, NameOrNumber, Scene, same_shape};
use renderflow_scenes::load::{self, Capture, ModelView};
use renderflow_scenes::procedural::{Composition, Split, compose_one};
use renderflow_scenes::sky;
use renderflow_scenes::validate::MAX_FRAMES;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Columns and rows of a composed scene, unless somebody asks for others.
const RESOLUTION: [u32; 2] = [256; 2];

/// A scene that somebody asks for. What is `None` keeps the value of the file, or a default.
#[derive(Clone, Debug, Default)]
pub struct SceneSource {
    /// Scene file (.json) or model (.gltf, .glb, .obj, .ply). Without it, the scene is composed with meshes and light that
    /// training never sees.
    pub file: Option<PathBuf>,
    /// Environment map (.hdr, .exr), or the name of a built-in one.
    pub hdri: Option<String>,
    /// Degrees by which the environment is turned about +Y.
    pub hdri_rotation: Option<f32>,
    /// Seed. It composes the scene (1 by default), or samples the scene of a file.
    pub seed: Option<u64>,
    /// Columns and rows.
    pub resolution: Option<[u32; 2]>,
    /// Number of frames; a model has one by default.
    pub frames: Option<u32>,
    /// A camera of the model file, by name or number. A composed scene has none.
    pub camera: Option<NameOrNumber>,
    /// Cameras of a `transforms.json`, one for each frame.
    pub cameras: Option<PathBuf>,
    /// An animation of the model file. Without a number of frames, there are as many as it lasts.
    pub animation: Option<Animation>,
    /// Values that are changed at the end.
    pub set: Vec<Setting>,
}

/// A scene, the files that it may name, and what was decided about it that a person should know.
#[derive(Clone, Debug)]
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
    /// When a file cannot be read, its content is no valid scene or model, or a setting names no value of it.
    pub fn describe(&self, allowed: &[PathBuf]) -> Result<Described> {
        let mut reach = self.file.as_deref().map_or_else(|| Reach::folder("."), Reach::of).allow(allowed);
        let mut notes = Vec::new();
        let mut scene = match &self.file {
            None => {
                let (seed, frames) = (self.seed.unwrap_or(1), self.frames.unwrap_or(1));
                let resolution = self.resolution.unwrap_or(RESOLUTION);
                let asked = [self.camera.is_some(), self.animation.is_some()];
                ensure!(asked == [false; 2], "a composed scene has no cameras or animations of a file; name a model file");
                compose_one(seed, Split::Test, resolution, frames, &Composition::default())?
            }
            Some(path) => {
                tracing::info!(path = %path.display(), "reading");
                if files::has_ending(path, &["json"]) {
                    let mut scene = read(path, &self.set)?;
                    if let Some(animation) = &self.animation {
                        let length = load::play(&mut scene, animation, &reach)?;
                        scene.frames = frames(animation, length, &mut notes);
                    }
                    scene
                } else {
                    self.model(path, &reach, &mut notes)?
                }
            }
        };
        if let (Some(seed), Some(_)) = (self.seed, &self.file) {
            scene.seed = seed;
        }
        scene.resolution = self.resolution.unwrap_or(scene.resolution);
        scene.frames = self.frames.unwrap_or(scene.frames);
        self.look(&mut scene, &reach, &mut notes)?;
        if let Some(hdri) = &self.hdri {
            scene.environment.source = environment(hdri)?;
            if let EnvironmentSource::File(path) = &scene.environment.source {
                reach = reach.allow([Path::new(path)]);
            }
        }
        scene.environment.rotation = self.hdri_rotation.unwrap_or(scene.environment.rotation);
        if self.set.is_empty() {
            scene.validate()?;
        } else {
            scene = apply(&scene, &self.set)?;
            scene.validate().context("set")?;
        }
        let [width, height] = scene.resolution;
        tracing::info!(scene = scene.name, objects = scene.objects.len(), width, height, frames = scene.frames, "described");
        Ok(Described { scene, reach, notes })
    }

    fn model(&self, path: &Path, reach: &Reach, notes: &mut Vec<String>) -> Result<Scene> {
        let usual = ModelView::default();
        let resolution = self.resolution.unwrap_or(usual.resolution);
        let frames = match (self.frames, &self.animation) {
            (Some(frames), _) => frames,
            (None, Some(animation)) => frames(animation, load::animation_length(path, reach, animation)?, notes),
            (None, None) => 1,
        };
        let view = ModelView { resolution, frames, animation: self.animation.clone(), ..usual };
        let scene = load::describe_model(path, None, &view, reach)?;
        if view.ground && scene.objects.len() == 1 {
            notes.push(format!("{}: the model has a floor of its own, so no ground plane is added", path.display()));
        }
        Ok(scene)
    }

    /// Gives the scene the cameras that are asked for.
    fn look(&self, scene: &mut Scene, reach: &Reach, notes: &mut Vec<String>) -> Result<()> {
        if let Some(choice) = &self.camera {
            notes.extend(load::look_through(scene, choice, reach)?);
        }
        let Some(path) = &self.cameras else { return Ok(()) };
        let capture = Capture::read(path)?;
        let of_model = self.file.as_ref().is_some_and(|file| !files::has_ending(file, &["json"]));
        let placement = match scene.objects.first() {
            Some(model) if of_model && !capture.in_world() => model.transform_at(0),
            _ => DAffine3::IDENTITY,
        };
        scene.resolution = self.resolution.or(capture.size()).unwrap_or(scene.resolution);
        if let Some(size) = capture.size() {
            let ([w, h], [width, height]) = (scene.resolution, size);
            let fitting = (u64::from(w) * u64::from(height) + u64::from(width) / 2) / u64::from(width);
            ensure!(
                same_shape(scene.resolution, size),
                "{}: its pictures have {width} x {height} pixels, and {w} x {h} is another shape; --resolution {w}x{fitting} fits",
                path.display()
            );
        }
        scene.frames = self.frames.unwrap_or(capture.len() as u32);
        scene.camera = capture.path(scene.resolution, placement)?;
        Ok(())
    }
}

/// As many frames as one turn of an animation of `length` seconds, up to the most that a scene may have.
fn frames(animation: &Animation, length: f64, notes: &mut Vec<String>) -> u32 {
    let (wanted, most) = (animation.frames(length), f64::from(MAX_FRAMES));
    if wanted > most {
        notes.push(format!("the animation lasts {length} seconds, and the scene ends after {MAX_FRAMES} frames"));
    }
    wanted.min(most) as u32
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
    let path = std::path::absolute(name).with_context(|| format!("{name}: no such path"))?;
    ensure!(
        path.exists(),
        "{name}: there is no such file, and no built-in environment of this name. There are {}",
        known.join(", ")
    );
    Ok(EnvironmentSource::File(path.to_string_lossy().into_owned()))
}

/// A value of a scene that somebody changes. As text: `PATH=VALUE`.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// The names and positions that lead to the value.
    path: Vec<String>,
    value: Value,
}

impl Setting {
    pub(super) fn new(path: Vec<String>, value: Value) -> Self {
        Self { path, value }
    }

    /// The names and positions in `path`, which are separated as in a JSON pointer.
    pub(super) fn steps(path: &str) -> std::result::Result<Vec<String>, String> {
        let path: Vec<String> =
            path.trim_matches('/').split('/').map(|step| step.replace("~1", "/").replace("~0", "~")).collect();
        if path.iter().any(String::is_empty) {
            return Err("the path has an empty part".into());
        }
        Ok(path)
    }
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (path, value) = text.split_once('=').ok_or("give PATH=VALUE, as in materials/0/roughness=.2")?;
        let path = Self::steps(path)?;
        // A number may begin with its point. What is no JSON is a string.
        let number = || value.parse::<f64>().ok().filter(|number| number.is_finite()).map(Value::from);
        let value = serde_json::from_str(value).ok().or_else(number).unwrap_or_else(|| value.into());
        Ok(Self { path, value })
    }
}

/// `scene` with changed values. The result is not validated.
pub(super) fn apply(scene: &Scene, settings: &[Setting]) -> Result<Scene> {
    // Through text: a single-precision 3.6 would otherwise become 3.5999999046325684.
    let mut whole: Value = serde_json::from_str(&scene.canonical_json())?;
    for setting in settings {
        let known = put(&mut whole, setting)?;
        if let Err(error) = serde_json::from_value::<Scene>(whole.clone()) {
            let reason = renderflow_frame::words::plain(&error.to_string());
            // The reason may list the names itself.
            let known = if reason.contains("expected") { "" } else { &known };
            bail!("set {}: {reason}{known}", setting.path.join("/"));
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
        place = next.with_context(|| format!("set {}: there is no {step:?}{known}", setting.path.join("/")))?;
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
            // The place behind the last one, as JSON Patch (RFC 6902) writes it.
            if last == "-" {
                items.push(setting.value.clone());
                return Ok(String::new());
            }
        }
        _ => {}
    }
    bail!("set {}: there is no {last:?}{known}", setting.path.join("/"))
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

    /// What the note about hollow glass advises.
    #[test]
    fn a_list_grows_at_its_end() {
        let solid = "materials/-={\"name\": \"solid\", \"transmission\": 1, \"roughness\": 0, \"base_color\": [1, 1, 1]}";
        let grown = set(&[solid, "objects/0/material=solid"]).expect("a scene");
        assert_eq!(grown.materials.len(), scene().materials.len() + 1);
        assert_eq!(grown.materials.last().map(|m| (m.name.as_str(), m.transmission, m.thin_walled)), Some(("solid", 1.0, false)));
        assert_eq!(grown.objects[0].material.as_deref(), Some("solid"));
        assert!(set(&["frames/-=3"]).is_err());
    }

    #[test]
    fn a_wrong_path_is_answered_with_what_there_is() {
        for (setting, words) in [
            ("sampels=4", &["sampels: unknown field `sampels`", "`resolution`"][..]),
            ("resolution/2=4", &["no \"2\"", "/resolution has 0 to 1"]),
            ("environment/turn=4", &["environment/turn", "unknown field `turn`", "rotation"]),
            ("objects/0/materials/roughness=4", &["no \"materials\"", "/objects/0 has"]),
            ("name/first=4", &["/name is a single value"]),
            ("frames=many", &["frames", "many"]),
        ] {
            let said = format!("{:#}", set(&[setting]).expect_err(setting));
            assert!(words.iter().all(|word| said.contains(word)), "{setting}: {said}");
        }
        for bad in ["", "frames", "=4", "a//b=4"] {
            assert!(bad.parse::<Setting>().is_err(), "{bad}");
        }
    }
}
