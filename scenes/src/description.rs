//! The scene file: plain serde data with units and ranges in the docs. JSON in, JSON out; unknown fields are errors.

mod animation;
mod change;
mod exact;
mod frames;
mod light;
mod material;
mod principled;

pub use animation::{Animation, NameOrNumber};
pub use change::MaterialChange;
pub use exact::decimal;
pub use frames::{CameraFrame, same_shape};
pub use light::{Light, LightKind};
pub use material::{Material, TextureTransform, TextureWrap};
pub use principled::Principled;

use crate::error::{Error, Result};
use glam::{DAffine3, DMat3, DQuat, DVec3, EulerRot, Vec3A};
use renderflow_frame::Camera;
use renderflow_frame::camera::near_origin;
use renderflow_frame::{file, words};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A whole sequence: camera path, light, materials, objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Format version; this program writes and reads 1.
    #[schemars(range(min = 1, max = 1))]
    pub version: u32,
    /// Name for messages and manifests.
    pub name: String,
    /// Seed of everything random in rendering this sequence.
    #[serde(default)]
    pub seed: u64,
    /// Image size in pixels, width then height, each 1..=16384.
    #[schemars(inner(range(min = 1, max = 16384)))]
    pub resolution: [u32; 2],
    /// Frames of the sequence, 1..=100000.
    #[serde(default = "one")]
    #[schemars(range(min = 1, max = 100_000))]
    pub frames: u32,
    /// Where the camera is in each frame.
    pub camera: CameraPath,
    /// The light: an environment around the scene.
    pub environment: EnvironmentLight,
    /// Materials, referred to by name.
    #[serde(default)]
    pub materials: Vec<Material>,
    /// Objects.
    pub objects: Vec<Object>,
    /// Lights besides the environment and emissive materials; none by default, and written only where there are some.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lights: Vec<Light>,
}

fn one() -> u32 {
    1
}

impl Scene {
    /// Reads and validates a scene file.
    ///
    /// # Errors
    /// [`Error::Frame`] when it cannot be read, [`Error::Json`] with line and column, [`Error::Invalid`] with every violation.
    pub fn read(path: &Path) -> Result<Self> {
        let text = file::read_text(path)?;
        Self::from_json(path, &text)
    }

    /// Parses and validates the text of a scene file; `path` stands in errors only.
    ///
    /// # Errors
    /// As [`Scene::read`].
    pub fn from_json(path: &Path, text: &str) -> Result<Self> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let scene: Self = serde_json::from_str(text).map_err(|e| {
            let (line, column) = (e.line(), e.column());
            let full = e.to_string();
            let place = format!(" at line {line} column {column}");
            let reason = words::plain(full.strip_suffix(&place).unwrap_or(&full));
            Error::Json { path: path.into(), line, column, reason }
        })?;
        scene.validate().map_err(|e| match e {
            Error::Invalid { problems, .. } => Error::Invalid { file: Some(path.into()), problems },
            other => other,
        })?;
        Ok(scene)
    }

    /// Compact JSON with the fields in the order of this file and every default written out: equal scenes, equal bytes.
    /// Validate first: values that are not finite become `null`.
    pub fn canonical_json(&self) -> String {
        serde_json::to_string(self).expect("a scene is numbers, strings, lists and structs: all of them have a JSON form")
    }

    /// BLAKE3 of [`Scene::canonical_json`], 64 hexadecimal digits.
    pub fn hash(&self) -> String {
        blake3::hash(self.canonical_json().as_bytes()).to_hex().to_string()
    }

    /// Camera of `frame`, counted from 0, with the sequence's [`CameraPath::origin`].
    pub fn camera(&self, frame: u32) -> Camera {
        self.camera.at(frame, self.resolution)
    }
}

/// Camera of every frame. World is +Y up, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "type")]
pub enum CameraPath {
    /// Turns about `target` at a fixed distance and height.
    Orbit {
        /// Point looked at, metres.
        #[serde(serialize_with = "exact::vector")]
        target: [f64; 3],
        /// Metres from `target`, > 0.
        #[serde(serialize_with = "exact::number")]
        #[schemars(range(min = 1e-9, max = 1e9))]
        distance: f64,
        /// Degrees above the horizon, -89..=89.
        #[schemars(range(min = -89, max = 89))]
        elevation: f32,
        /// Degrees about +Y at frame 0; 0 = camera on the +Z side.
        azimuth: f32,
        /// Degrees about +Y from a frame to the next; 3.6 turns once in 100 frames.
        degrees_per_frame: f32,
        /// Vertical field of view in degrees, 1..=170.
        #[schemars(range(min = 1, max = 170))]
        vertical_fov: f32,
    },
    /// One pose a frame; the last is held when there are fewer than frames.
    Poses {
        /// At least one pose.
        #[schemars(length(min = 1))]
        poses: Vec<Pose>,
        /// Vertical field of view in degrees, 1..=170.
        #[schemars(range(min = 1, max = 170))]
        vertical_fov: f32,
    },
    /// One camera a frame with its own intrinsics; the last is held when there are fewer than frames. The scene's resolution has
    /// the shape of `size`.
    Frames {
        /// Width and height in pixels that the intrinsics are for, each 1..=16384.
        #[schemars(inner(range(min = 1, max = 16384)))]
        size: [u32; 2],
        /// 1 to 100000 cameras.
        #[schemars(length(min = 1, max = 100_000))]
        frames: Vec<CameraFrame>,
    },
}

/// Furthest that what cameras with their own intrinsics look at is assumed to be, metres.
const FURTHEST_CAPTURE: f64 = 1000.0;

/// Where a camera stands and looks, in the world.
pub(crate) struct View {
    pub eye: DVec3,
    pub target: DVec3,
    pub up: Vec3A,
    /// Degrees.
    pub vertical_fov: f32,
}

impl CameraPath {
    /// Camera of `frame`, counted from 0, for an image of `resolution` pixels (width, height); placed relative to
    /// [`Self::origin`].
    pub fn at(&self, frame: u32, resolution: [u32; 2]) -> Camera {
        self.at_from(frame, resolution, self.origin())
    }

    /// As [`Self::at`], placed relative to `origin`, a point of the world in metres.
    pub fn at_from(&self, frame: u32, resolution: [u32; 2], origin: DVec3) -> Camera {
        if let Self::Frames { size, frames } = self
            && let Some(own) = frames.get(frame as usize).or(frames.last())
        {
            return own.camera(*size, resolution, origin);
        }
        let View { eye, target, up, vertical_fov } = self.view(frame);
        // The direction from the difference in double precision, whatever the place and the distance.
        let ahead = (target - eye).normalize_or(DVec3::NEG_Z).as_vec3a();
        let [width, height] = resolution.map(|v| v as usize);
        let mut camera = Camera::look_at(Vec3A::ZERO, ahead, up, vertical_fov.to_radians(), width, height);
        camera.camera_to_world.translation = (eye - origin).as_vec3a();
        Camera { origin, ..camera }
    }

    /// The pose at `frame`, counted from 0, and the vertical field of view in degrees. A principal point off the centre is not in
    /// it.
    pub fn pose(&self, frame: u32) -> (Pose, f32) {
        let View { eye, target, up, vertical_fov } = self.view(frame);
        (Pose { eye: eye.to_array(), target: target.to_array(), up: up.to_array() }, vertical_fov)
    }

    /// The point of the world that cameras and objects of the sequence are counted from, metres: [`near_origin`] of the first
    /// camera.
    pub fn origin(&self) -> DVec3 {
        let View { eye, target, .. } = self.view(0);
        near_origin(eye, eye.distance(target))
    }

    /// The pose of `frame`, counted from 0.
    pub(crate) fn view(&self, frame: u32) -> View {
        match self {
            Self::Orbit { target, distance, elevation, azimuth, degrees_per_frame, vertical_fov } => {
                // The angle in f64: frame 100_000 of an orbit is as exact as frame 1.
                let turn = f64::from(*azimuth) + f64::from(frame) * f64::from(*degrees_per_frame);
                let (sin, cos) = turn.rem_euclid(360.0).to_radians().sin_cos();
                let (rise, reach) = f64::from(*elevation).to_radians().sin_cos();
                let offset = DVec3::new(reach * sin, rise, reach * cos) * *distance;
                let target = DVec3::from(*target);
                View { eye: target + offset, target, up: Vec3A::Y, vertical_fov: *vertical_fov }
            }
            Self::Poses { poses, vertical_fov } => {
                let last = poses.len().saturating_sub(1);
                let held = Pose { eye: [0.0, 0.0, 1.0], target: [0.0; 3], up: up() };
                let pose = poses.get(last.min(frame as usize)).unwrap_or(&held);
                let up = Vec3A::from(pose.up).normalize_or(Vec3A::Y);
                View { eye: pose.eye.into(), target: pose.target.into(), up, vertical_fov: *vertical_fov }
            }
            Self::Frames { size, frames } => {
                let Some(own) = frames.get(frame as usize).or(frames.last()) else {
                    return View { eye: DVec3::Z, target: DVec3::ZERO, up: Vec3A::Y, vertical_fov: 40.0 };
                };
                let (eye, axes) = (own.position(), own.rotation());
                // Nothing says how far away the things are. Captures lie about the world's origin.
                let target = eye - axes.z_axis * eye.length().clamp(1.0, FURTHEST_CAPTURE);
                let half = (0.5 * f64::from(size[1]) / own.fl_y).atan();
                View { eye, target, up: axes.y_axis.as_vec3a(), vertical_fov: (2.0 * half).to_degrees() as f32 }
            }
        }
    }
}

/// Eye and target of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Camera position, metres.
    #[serde(serialize_with = "exact::vector")]
    pub eye: [f64; 3],
    /// Point looked at, metres, different from `eye`.
    #[serde(serialize_with = "exact::vector")]
    pub target: [f64; 3],
    /// Up direction; +Y by default.
    #[serde(default = "up")]
    pub up: [f32; 3],
}

fn up() -> [f32; 3] {
    [0.0, 1.0, 0.0]
}

/// The environment and how it is turned and scaled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentLight {
    /// Where the map comes from.
    pub source: EnvironmentSource,
    /// Degrees the sky turns about +Y.
    #[serde(default)]
    pub rotation: f32,
    /// Gain, >= 0.
    #[serde(default = "unit")]
    #[schemars(range(min = 0))]
    pub intensity: f32,
}

fn unit() -> f32 {
    1.0
}

/// Source of an environment map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum EnvironmentSource {
    /// Radiance `.hdr` or OpenEXR `.exr`, equirectangular; relative to the scene file.
    File(String),
    /// One of the maps of the project's `hdri/` folder, by name (made in memory, no file needed).
    Builtin(String),
    /// A map made from parameters.
    Sky(crate::sky::Sky),
    /// The same scene-linear radiance from everywhere.
    Constant([f32; 3]),
}

/// A shape or a model file, placed in the world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// Unique name.
    pub name: String,
    /// What it looks like.
    pub geometry: Geometry,
    /// Name of a material. Without it a shape is grey, and a model file keeps its own materials.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// Placement at frame 0.
    #[serde(default)]
    pub transform: Transform,
    /// Change of placement from a frame to the next; static without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
    /// An animation of the model file; without it the model rests. It moves the model's nodes, and `transform` and `motion` place
    /// the whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub animation: Option<Animation>,
}

/// Geometry of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Geometry {
    /// A parametric shape.
    Shape(crate::shapes::Shape),
    /// glTF (`.gltf`, `.glb`), Wavefront (`.obj`) or Stanford (`.ply`); relative to the scene file.
    File(String),
}

/// Scale, then rotation, then translation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Transform {
    /// Metres.
    #[serde(serialize_with = "exact::vector")]
    pub translation: [f64; 3],
    /// Degrees about x, y, z, applied in the order x, y, z.
    pub rotation: [f32; 3],
    /// Factors along the object's axes, none of them 0.
    pub scale: [f32; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self { translation: [0.0; 3], rotation: [0.0; 3], scale: [1.0; 3] }
    }
}

impl Transform {
    /// Object to world, with the object turned by `spin` degrees about its own +Y axis and moved by `shift` metres first.
    fn matrix(&self, shift: DVec3, spin: f64) -> DAffine3 {
        let [x, y, z] = self.rotation.map(|degrees| f64::from(degrees).to_radians());
        // x first: the matrix is Rz Ry Rx.
        let turn = DQuat::from_euler(EulerRot::ZYX, z, y, x) * DQuat::from_rotation_y(spin.rem_euclid(360.0).to_radians());
        let matrix3 = DMat3::from_quat(turn) * DMat3::from_diagonal(self.scale.map(f64::from).into());
        DAffine3 { matrix3, translation: DVec3::from(self.translation) + shift }
    }
}

impl Object {
    /// Object to world at `frame`, counted from 0: scale, spin, rotation, translation. In double precision: the world may be
    /// wide.
    pub fn transform_at(&self, frame: u32) -> DAffine3 {
        let motion = self.motion.clone().unwrap_or_default();
        self.transform.matrix(motion.shift(frame), f64::from(motion.spin) * f64::from(frame))
    }

    /// Does the object's placement change from frame to frame?
    pub fn moves(&self) -> bool {
        self.motion.as_ref().is_some_and(|m| *m != Motion::default())
    }
}

/// Change of a transform from frame to frame: a steady way, a turn, and on top of them a bounce and a circle. The last two came
/// after the first version and are written only where they are.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Metres a frame.
    #[serde(serialize_with = "exact::vector")]
    pub translation: [f64; 3],
    /// Degrees a frame about the object's own +Y axis through its origin.
    pub spin: f32,
    /// Arcs through the air, one after the other; none by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounce: Option<Bounce>,
    /// A way around a vertical axis; none by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub circle: Option<Circle>,
}

/// A body that leaves its place upwards, falls back and starts again: parabolas.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bounce {
    /// Highest point above the place at frame 0, metres, 0..=1e6.
    #[schemars(range(min = 0, max = 1e6))]
    pub height: f32,
    /// Frames from one touch to the next, 1..=1e6.
    #[schemars(range(min = 1, max = 1e6))]
    pub frames: f32,
}

/// A circle in the horizontal plane. The object keeps its own orientation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// Axis, along x and z from the object's place at frame 0, metres, -1e6..=1e6.
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub center: [f32; 2],
    /// Degrees a frame about +Y.
    pub degrees: f32,
}

impl Motion {
    /// How far `frame`, counted from 0, is from the place at frame 0, metres.
    pub fn shift(&self, frame: u32) -> DVec3 {
        let time = f64::from(frame);
        let mut shift = DVec3::from(self.translation) * time;
        if let Some(bounce) = &self.bounce {
            let phase = (time / f64::from(bounce.frames).max(1.0)).fract();
            shift.y += 4.0 * f64::from(bounce.height) * phase * (1.0 - phase);
        }
        if let Some(circle) = &self.circle {
            let [x, z] = circle.center.map(f64::from);
            let (sin, cos) = (time * f64::from(circle.degrees)).rem_euclid(360.0).to_radians().sin_cos();
            // c - R c, where R turns about +Y.
            shift += DVec3::new(x - (cos * x + sin * z), 0.0, z - (cos * z - sin * x));
        }
        shift
    }
}
