//! The validated, fully loaded form of a scene: everything a renderer needs, nothing to look up any more.

use glam::{Affine3A, Vec2, Vec3, Vec4};
use renderflow_frame::{Camera, Environment, Image};

/// Triangles of one shape, in object space, metres.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Name for messages and manifests.
    pub name: String,
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a vertex; empty = flat shading.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one a vertex, (0, 0) = first texel of the first row; empty = none.
    pub uvs: Vec<Vec2>,
    /// Tangents (xyz unit, w = +-1 handedness) as in glTF, one a vertex; empty = none (no normal map is applied then).
    pub tangents: Vec<Vec4>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A mesh placed in the world with a material.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Name, unique in the scene.
    pub name: String,
    /// Index into [`LoadedScene::meshes`]. Where the transform mirrors, that mesh has reversed winding already, so that triangles
    /// are counter-clockwise from outside in the world; `w` of tangents is to be multiplied with the sign of the determinant.
    pub mesh: usize,
    /// Index into [`LoadedScene::materials`]. Material ids in files are this + 1.
    pub material: usize,
    /// Object id in files, >= 1. Instances that came from one object of the description share it.
    pub object_id: u32,
    /// Object to world, one for every frame, or a single one for a static object.
    pub transforms: Vec<Affine3A>,
}

impl Instance {
    /// Object-to-world transform at `frame`.
    pub fn transform(&self, frame: usize) -> Affine3A {
        self.transforms[frame.min(self.transforms.len() - 1)]
    }
}

/// A texture lookup of a material.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureSlot {
    /// Index into [`LoadedScene::textures`].
    pub texture: usize,
    /// `uv' = matrix * uv + offset` (KHR_texture_transform); identity when absent.
    pub uv_transform: glam::Affine2,
}

/// Disney principled material; factors are multiplied with textures where present.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, unique in the scene.
    pub name: String,
    /// Linear Rec.709, 0..=1.
    pub base_color: [f32; 3],
    /// 0..=1.
    pub metallic: f32,
    /// 0..=1, perceptual (alpha = roughness^2).
    pub roughness: f32,
    /// 0..=1; 0.5 means F0 = 0.04.
    pub specular: f32,
    /// Linear RGB (sRGB already decoded), multiplies `base_color`.
    pub base_color_texture: Option<TextureSlot>,
    /// glTF layout: G = roughness, B = metallic; multiplies the factors.
    pub metallic_roughness_texture: Option<TextureSlot>,
    /// Tangent-space normal map, values decoded to -1..=1, with its scale.
    pub normal_texture: Option<(TextureSlot, f32)>,
    /// Emitted radiance is not rendered yet; kept so that nothing is lost. Linear.
    pub emissive: [f32; 3],
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: "default".into(),
            base_color: [0.8; 3],
            metallic: 0.0,
            roughness: 0.5,
            specular: 0.5,
            base_color_texture: None,
            metallic_roughness_texture: None,
            normal_texture: None,
            emissive: [0.0; 3],
        }
    }
}

/// How texture coordinates outside 0..1 behave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// Fractional part.
    #[default]
    Repeat,
    /// Fractional part, every other tile mirrored.
    Mirror,
    /// Edge texel.
    Clamp,
}

/// Texels ready for shading: linear colour, or raw data for normal and metallic-roughness maps.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// File or glTF image it came from.
    pub name: String,
    /// Three channels, decoded.
    pub image: Image<[f32; 3]>,
    /// Wrap along u and v.
    pub wrap: [Wrap; 2],
}

/// What loading had to decide or repair; all counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadReport {
    /// glTF materials with alphaMode BLEND, rendered as opaque.
    pub blend_as_opaque: usize,
    /// glTF materials with alphaMode MASK, rendered as opaque for now.
    pub mask_as_opaque: usize,
    /// Triangles dropped because a vertex was NaN or infinite, an index was out of range, or the area was zero.
    pub dropped_triangles: usize,
    /// Texels of the environment that were NaN, infinite or negative and became 0.
    pub repaired_texels: usize,
    /// Things a person should know, one sentence each (points and lines skipped, unknown extensions, ...).
    pub notes: Vec<String>,
}

/// A scene ready to be compiled by a renderer.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// Name for messages and manifests.
    pub name: String,
    /// Seed of the sequence: pixels draw their random numbers from (seed, frame, pixel).
    pub seed: u64,
    /// BLAKE3 of the scene's canonical JSON, hexadecimal.
    pub hash: String,
    /// Shapes.
    pub meshes: Vec<Mesh>,
    /// Placed shapes.
    pub instances: Vec<Instance>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Light of the scene.
    pub environment: Environment,
    /// Camera of each frame; at least one.
    pub cameras: Vec<Camera>,
    /// What loading decided.
    pub report: LoadReport,
}
