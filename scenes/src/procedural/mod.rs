//! The composer. It makes scenes of many kinds from the knobs of a plan: objects on a ground, rooms and open country, seen by
//! cameras that turn, drive, walk or stand still, with objects that move and materials that change.
//!
//! The same [`Request`] gives the same scene, to the byte of its JSON, on every machine.

mod body;
mod build;
mod camera;
mod change;
mod clear;
mod daylight;
mod ground;
mod knobs;
mod layout;
mod lights;
pub mod materials;
mod motion;
mod occluders;
mod outdoor;
mod paths;
mod pick;
mod room;
mod split;

pub use knobs::{CameraKind, Cameras, Composition, LayoutKind, Layouts};
pub use split::{Families, Split, deal, families};

use crate::catalog::Catalog;
use crate::description::{EnvironmentLight, Object, Scene};
use crate::draw::Draw;
use crate::error::{Error, Problem, Result};
use crate::seed::Seed;
use crate::validate::MAX_FRAMES;
use build::Build;
use glam::Vec3;
use layout::Context;
use pick::Picker;
use std::path::PathBuf;

/// Meshes in a catalogue, unless a plan says otherwise.
pub const MESH_COUNT: u32 = 4096;
/// Maps in a catalogue of environments, unless a plan says otherwise.
pub const ENVIRONMENT_COUNT: u32 = 512;

/// What a split may draw from.
#[derive(Clone, Copy, Debug)]
pub struct Pool<'a> {
    /// Numbers of meshes and environments refer to it.
    pub catalog: &'a Catalog,
    /// Families of meshes; may be empty where there are models.
    pub mesh_families: &'a [String],
    /// Families of environments; may be empty where there are maps.
    pub environment_families: &'a [String],
    /// Paths of glTF, OBJ and PLY files, as the scene shall name them; read from the working directory, so better absolute.
    pub models: &'a [String],
    /// Paths of `.hdr` and `.exr` maps, as the scene shall name them.
    pub hdris: &'a [String],
    /// Names of maps of `hdri/`.
    pub builtin: &'a [String],
    /// Folders beside its own that a model may name files of.
    pub allowed: &'a [PathBuf],
}

/// What [`compose`] makes.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// Of this sequence: everything random follows from it.
    pub seed: Seed,
    /// Name of the scene.
    pub name: String,
    /// Image size in pixels, width then height.
    pub resolution: [u32; 2],
    /// Frames of the sequence, at least 1.
    pub frames: u32,
    /// The plan's knobs.
    pub composition: &'a Composition,
    /// The split's pool.
    pub pool: &'a Pool<'a>,
}

/// A scene and what it was made from.
#[derive(Clone, Debug)]
pub struct Composed {
    /// The scene; it passes `Scene::validate`.
    pub scene: Scene,
    /// Where its objects stand.
    pub layout: LayoutKind,
    /// How its camera moves.
    pub camera: CameraKind,
    /// Whether an object moves.
    pub moving: bool,
    /// Whether a material changes.
    pub changing: bool,
    /// One an object that comes from the pool. Floors, walls, plain furniture and occluders (made of planes, boxes, spheres,
    /// cylinders and cones) are not in it.
    pub meshes: Vec<Used>,
    /// Family, `builtin:NAME` or `file:PATH`.
    pub environment: String,
    /// Number in the catalogue, for a family.
    pub environment_number: Option<u32>,
}

/// Where an object comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Used {
    /// Name of the object in the scene.
    pub object: String,
    /// Family of the catalogue, or `file`.
    pub family: String,
    /// Number in the catalogue.
    pub mesh: Option<u32>,
    /// Path of the model file.
    pub file: Option<String>,
}

/// A scene of the plan's kind.
///
/// # Errors
/// [`Error::Invalid`] for knobs out of range, for a pool that is empty or names what does not exist, for a resolution or a number
/// of frames out of range; a model file that cannot be read is an error that names it.
pub fn compose(request: &Request) -> Result<Composed> {
    let knobs = request.composition;
    knobs.check().map_err(invalid)?;
    // Before anything is made for every frame.
    if !(1..=MAX_FRAMES).contains(&request.frames) {
        return Err(invalid(format!("/frames: {} is outside 1..={MAX_FRAMES}", request.frames)));
    }
    let picker = Picker::new(request.pool, knobs)?;
    let frames = request.frames;
    let root = request.seed;
    let kind = draw(&root.child("layout kind", 0), &knobs.layouts.weights());
    let kind_of_camera = draw(&root.child("camera kind", 0), &knobs.cameras.weights());
    let chance = |label: &str, share: f64| frames > 1 && root.child(label, 0).rng().chance(share);
    let (mut moves, mut changes) = (chance("moves", knobs.moving), chance("changes", knobs.changing));
    if kind_of_camera == CameraKind::Fixed && frames > 1 && !moves && !changes && knobs.moving + knobs.changing > 0.0 {
        // A hundred equal pictures are of no use.
        let which = root.child("moves", 1).rng().weighted(&[knobs.moving, knobs.changing]);
        (moves, changes) = (which == 0, which == 1);
    }

    let light = picker.light(&mut root.child("light", 0).rng(), kind);
    let context = Context { root, knobs, picker: &picker, frames, camera: kind_of_camera };
    let mut layout = match kind {
        LayoutKind::Ground => ground::layout(&context)?,
        LayoutKind::Room => room::layout(&context, &light.source)?,
        LayoutKind::Outdoor => outdoor::layout(&context)?,
    };
    if root.child("glass", 0).rng().chance(knobs.glass) {
        clear::cast_in_glass(&mut layout, &root);
    }
    if moves {
        motion::set_in_motion(&mut layout, &mut root.child("motion", 0).rng(), frames);
    }
    let camera = camera::camera(&context, &layout, request.resolution);
    if root.child("occluders", 0).rng().chance(knobs.occluders) {
        occluders::place(&mut layout, &mut root.child("occluders", 1).rng(), &camera, frames, request.resolution);
    }
    let mut rng = root.child("light", 1).rng();
    let [least, most] = knobs.intensity;
    let rotation = rng.between(0.0, 360.0);
    let environment =
        EnvironmentLight { source: light.source, rotation: layout.turn.unwrap_or(rotation), intensity: rng.log(least, most) };

    let leafy = kind == LayoutKind::Outdoor && root.child("leaves", 0).rng().chance(knobs.leaves);
    let mut build = Build::new(root, &knobs.materials, environment.intensity, leafy);
    for (name, part) in &layout.structure {
        build.part(name, part, Vec3::ZERO);
    }
    for (index, body) in layout.bodies.iter().enumerate() {
        build.body(&format!("{}_{:02}", body.label, index + 1), body);
    }
    if changes {
        change::change(&mut root.child("change", 0).rng(), &mut build.materials, &build.changeable);
    }
    let gain = environment.intensity;
    let scene = Scene {
        version: crate::validate::VERSION,
        name: request.name.clone(),
        // 53 bits survive every JSON reader.
        seed: root.child("render", 0).u64() >> 11,
        resolution: request.resolution,
        frames,
        camera,
        environment,
        materials: build.materials,
        objects: build.objects,
        lights: if root.child("lights", 0).rng().chance(knobs.lights) {
            lights::lights(&layout, &mut root.child("lights", 1).rng(), gain)
        } else {
            vec![]
        },
    };
    scene.validate()?;
    Ok(Composed {
        moving: scene.objects.iter().any(Object::moves),
        changing: scene.materials.iter().any(|m| m.change.is_some()),
        scene,
        layout: kind,
        camera: kind_of_camera,
        meshes: build.meshes,
        environment: light.name,
        environment_number: light.number,
    })
}

/// One scene from what a split may draw from: the families that [`families`] gives it, of a catalogue of 4096 meshes and 512
/// environments. The same arguments give the same scene.
///
/// # Errors
/// As [`compose`].
pub fn compose_one(seed: u64, split: Split, resolution: [u32; 2], frames: u32, composition: &Composition) -> Result<Scene> {
    let catalog = Catalog::new(seed, MESH_COUNT, ENVIRONMENT_COUNT);
    let Families { meshes, environments } = families(&catalog, split);
    let pool = Pool {
        catalog: &catalog,
        mesh_families: &meshes,
        environment_families: &environments,
        models: &[],
        hdris: &[],
        builtin: &[],
        allowed: &[],
    };
    let (seed, name) = (Seed::root(seed).child("sequence", 0), format!("{split}_{seed}"));
    Ok(compose(&Request { seed, name, resolution, frames, composition, pool: &pool })?.scene)
}

/// A name drawn by its weight.
fn draw<T: Copy>(seed: &Seed, weights: &[(T, f64)]) -> T {
    let list: Vec<f64> = weights.iter().map(|(_, weight)| *weight).collect();
    weights[seed.rng().weighted(&list)].0
}

/// An error of the knobs, whose message begins with its pointer.
fn invalid(message: String) -> Error {
    let (pointer, reason) = message.split_once(": ").unwrap_or(("", &message));
    Error::Invalid { file: None, problems: vec![Problem { pointer: pointer.into(), reason: reason.into() }] }
}
