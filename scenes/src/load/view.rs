//! Cameras and animations of model files, put into a scene.

use super::gltf::{label, rig::Rig};
use super::{model, play::Play};
use crate::description::{Animation, CameraPath, Geometry, NameOrNumber, Pose, Scene};
use crate::error::{Error, Problem, Result};
use crate::model_format::Format;
use glam::DVec3;
use renderflow_frame::reach::Reach;
use renderflow_frame::words::{number, shortened};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Vertical fields of view that a scene may have, degrees.
const FIELDS_OF_VIEW: std::ops::RangeInclusive<f64> = 1.0..=170.0;
/// Least distance of the point that a camera looks at, metres, and in distances of the scene's middle.
const NEAREST: f64 = 1e-3;

/// Names of what a model file has beside its triangles; numbers, counted from 0, where there is no name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Cameras on nodes of the file's scene.
    pub cameras: Vec<String>,
    /// Animations.
    pub animations: Vec<String>,
}

/// What a model file has beside its triangles. OBJ and PLY files have nothing.
///
/// # Errors
/// When the file cannot be read.
pub fn contents(path: &Path, reach: &Reach) -> Result<Contents> {
    if Format::of_file(path)? != Some(Format::Gltf) {
        return Ok(Contents::default());
    }
    let rig = model::rig(path, reach, None)?;
    let label = |(number, name): (usize, Option<&str>)| label::of(number, name);
    Ok(Contents {
        cameras: rig.cameras.iter().map(|camera| camera.name.as_deref()).enumerate().map(label).collect(),
        animations: rig.clips.iter().map(Option::as_deref).enumerate().map(label).collect(),
    })
}

/// Seconds that an animation of a model file lasts.
///
/// # Errors
/// When the file cannot be read or has no such animation.
pub fn animation_length(path: &Path, reach: &Reach, animation: &Animation) -> Result<f64> {
    Ok(model::rig(path, reach, Some(animation))?.length)
}

/// The glTF files of a scene: the object of each, its file, and the file's tree with the animation that the object plays.
type Rigs = Vec<(usize, PathBuf, Rc<Rig>)>;

fn rigs(scene: &Scene, reach: &Reach) -> Result<Rigs> {
    let (mut found, mut known) = (Vec::new(), HashMap::new());
    for (index, object) in scene.objects.iter().enumerate() {
        let Geometry::File(file) = &object.geometry else { continue };
        let place = |e: Error| e.at(format!("/objects/{index} ({})", object.name));
        let path = reach.resolve(file).map_err(|reason| place(Error::Name { reason }))?;
        if Format::of_file(&path).map_err(place)? == Some(Format::Gltf) {
            let key = (path.clone(), object.animation.as_ref().map(|animation| animation.clip.clone()));
            let rig = match known.get(&key) {
                Some(known) => Rc::clone(known),
                None => Rc::new(model::rig(&path, &reach.at(&path), object.animation.as_ref()).map_err(place)?),
            };
            known.insert(key, Rc::clone(&rig));
            found.push((index, path, rig));
        }
    }
    Ok(found)
}

/// A refusal that names the only glTF file of a scene, or else its objects.
fn refusal(rigs: &Rigs, reason: String) -> Error {
    match rigs.as_slice() {
        [(_, path, _)] => Error::model(path, "", reason),
        _ => Error::Invalid { file: None, problems: vec![Problem { pointer: "/objects".into(), reason }] },
    }
}

/// Lets the objects of a scene whose files have this animation play it. Returns the seconds that the longest one lasts.
///
/// # Errors
/// When a file cannot be read, or none has the animation.
pub fn play(scene: &mut Scene, animation: &Animation, reach: &Reach) -> Result<f64> {
    let rigs = rigs(scene, reach)?;
    let choice = animation.clip.clone().unwrap_or(NameOrNumber::Number(0));
    let mut longest = None;
    for (index, path, rig) in &rigs {
        if choice.find(rig.clips.iter().map(Option::as_deref)).is_some() {
            let length = animation_length(path, &reach.at(path), animation)?;
            longest = Some(length.max(longest.unwrap_or(0.0)));
            scene.objects[*index].animation = Some(animation.clone());
        }
    }
    longest.ok_or_else(|| {
        let known = label::list(rigs.iter().flat_map(|(.., rig)| rig.clips.iter().map(Option::as_deref)));
        let reason = match known.as_str() {
            "" => "no model file of the scene has an animation".to_owned(),
            known => format!("no model file of the scene has the animation {choice}; there are {known}"),
        };
        refusal(&rigs, reason)
    })
}

/// Lets a scene be seen by a camera of one of its glTF files, which goes where its node goes. Cameras of several files are
/// counted through, in the order of the objects. Returns what a person should know, one sentence each.
///
/// # Errors
/// When the scene is not valid, a file cannot be read, there is no such camera, or it has no perspective.
pub fn look_through(scene: &mut Scene, choice: &NameOrNumber, reach: &Reach) -> Result<Vec<String>> {
    scene.validate()?;
    let rigs = rigs(scene, reach)?;
    let all: Vec<_> = rigs.iter().flat_map(|rig| rig.2.cameras.iter().map(move |camera| (rig, camera))).collect();
    let names = all.iter().map(|(_, camera)| camera.name.as_deref());
    let Some(chosen) = choice.find(names.clone()) else {
        let reason = match label::list(names).as_str() {
            "" => "no node of the file's scene shows a camera".to_owned(),
            known => match choice {
                NameOrNumber::Number(number) => format!("there is no camera {number}; there are {known}"),
                name => format!("no camera is named {name}; there are {known}"),
            },
        };
        return Err(refusal(&rigs, reason));
    };
    let ((index, path, rig), camera) = all[chosen];
    let name = label::of(chosen, camera.name.as_deref());
    let error = |reason: String| Error::model(path, "", format!("camera {name}: {reason}"));
    let fail = |reason: String| Err(error(reason));
    let Some(lens) = camera.lens else {
        return fail("it is orthographic; only perspective cameras can be used".into());
    };
    let vertical_fov = lens.yfov.to_degrees();
    if !FIELDS_OF_VIEW.contains(&vertical_fov) {
        let (low, high) = (FIELDS_OF_VIEW.start(), FIELDS_OF_VIEW.end());
        return fail(format!("its yfov of {} degrees is outside {low}..={high}", number(vertical_fov)));
    }
    let object = &scene.objects[*index];
    let animation = object.animation.clone().unwrap_or_default();
    let moves = object.moves() || object.animation.is_some();
    let play = Play { rig, animation: &animation, frames: if moves { scene.frames } else { 1 } };
    play.check(0).map_err(error)?;
    let middle = scene.camera.view(0).target;
    let mut poses = Vec::new();
    for (frame, pose) in play.poses().enumerate() {
        let [eye, ahead, up] = rig.view(camera, &pose, object.transform_at(frame as u32));
        let (Some(ahead), Some(_)) = (ahead.try_normalize(), up.cross(ahead).try_normalize()) else {
            return fail(format!("its node is flattened at frame {frame}, so it looks nowhere"));
        };
        if !eye.is_finite() {
            return fail(format!("it is nowhere at frame {frame}"));
        }
        let ahead = ahead * (middle - eye).dot(ahead).max(NEAREST * middle.distance(eye)).max(NEAREST);
        let up = up.normalize_or(DVec3::Y).as_vec3().to_array();
        poses.push(Pose { eye: eye.to_array(), target: (eye + ahead).to_array(), up });
    }
    // A camera that stands still is one pose.
    if poses.iter().all(|pose| *pose == poses[0]) {
        poses.truncate(1);
    }
    scene.camera = CameraPath::Poses { poses, vertical_fov: vertical_fov as f32 };
    scene.validate()?;
    let [width, height] = scene.resolution.map(f64::from);
    let wider = lens.aspect.filter(|aspect| *aspect > width / height * 1.001);
    Ok(wider.into_iter().map(|aspect| cut_off(&name, aspect, scene.resolution)).collect())
}

fn cut_off(name: &str, aspect: f64, [width, height]: [u32; 2]) -> String {
    let rounded = |v: f64| number((v * 1000.0).round() / 1000.0);
    let needed = (f64::from(height) * aspect).round();
    format!(
        "camera {}: its pictures are {} times as wide as high, so {width}x{height} cuts off their sides; --resolution {}x{height} \
shows them",
        shortened(name),
        rounded(aspect),
        number(needed)
    )
}
