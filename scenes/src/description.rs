//! The scene file: plain serde data with units and ranges in the docs. JSON in, JSON out; unknown fields are errors.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A whole sequence: camera path, light, materials, objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Format version; this program writes and reads 1.
    pub version: u32,
    /// Name for messages and manifests.
    pub name: String,
    /// Seed of everything random in rendering this sequence.
    #[serde(default)]
    pub seed: u64,
    /// Image size in pixels, width then height, each 1..=16384.
    pub resolution: [u32; 2],
    /// Frames of the sequence, at least 1.
    #[serde(default = "one")]
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
}

fn one() -> u32 {
    1
}

/// Camera of every frame. World is +Y up, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "type")]
pub enum CameraPath {
    /// Turns about `target` at a fixed distance and height.
    Orbit {
        /// Point looked at, metres.
        target: [f32; 3],
        /// Metres from `target`, > 0.
        distance: f32,
        /// Degrees above the horizon, -89..=89.
        elevation: f32,
        /// Degrees about +Y at frame 0; 0 = camera on the +Z side.
        azimuth: f32,
        /// Degrees about +Y from a frame to the next; 3.6 turns once in 100 frames.
        degrees_per_frame: f32,
        /// Vertical field of view in degrees, 1..=170.
        vertical_fov: f32,
    },
    /// One pose a frame; the last is held when there are fewer than frames.
    Poses {
        /// At least one pose.
        poses: Vec<Pose>,
        /// Vertical field of view in degrees, 1..=170.
        vertical_fov: f32,
    },
}

/// Eye and target of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Camera position, metres.
    pub eye: [f32; 3],
    /// Point looked at, metres, different from `eye`.
    pub target: [f32; 3],
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

/// Disney principled material; the parameters this version renders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Unique name.
    pub name: String,
    /// Linear Rec.709, 0..=1.
    #[serde(default = "grey")]
    pub base_color: [f32; 3],
    /// 0..=1.
    #[serde(default)]
    pub metallic: f32,
    /// 0..=1.
    #[serde(default = "half")]
    pub roughness: f32,
    /// 0..=1; 0.5 means 4% at normal incidence.
    #[serde(default = "half")]
    pub specular: f32,
    /// Image multiplied with `base_color`, decoded from sRGB; relative to the scene file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_color_texture: Option<String>,
    /// Image whose green is roughness and blue is metallic (glTF's layout), multiplied with the factors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metallic_roughness_texture: Option<String>,
    /// Tangent-space normal map, OpenGL (+y up).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal_texture: Option<String>,
}

fn grey() -> [f32; 3] {
    [0.8; 3]
}
fn half() -> f32 {
    0.5
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
}

/// Geometry of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Geometry {
    /// A parametric shape.
    Shape(crate::shapes::Shape),
    /// glTF (`.gltf`, `.glb`) or Wavefront (`.obj`); relative to the scene file.
    File(String),
}

/// Scale, then rotation, then translation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Transform {
    /// Metres.
    pub translation: [f32; 3],
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

/// Constant change of a transform, a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Metres a frame.
    pub translation: [f32; 3],
    /// Degrees a frame about the object's own +Y axis through its origin.
    pub spin: f32,
}
