//! The validated, fully loaded form of a scene: everything a renderer needs, nothing to look up any more.

mod deform;
mod light;
mod moments;

pub use crate::mipmap::{Encoding, Texture, Wrap};
pub use deform::{Deformation, Displacement, Influence, Posed, Poses, Rows, Shape};
pub use light::{PunctualKind, PunctualLight};

use crate::Principled;
use glam::{Affine3A, DVec3, Vec2, Vec3, Vec4};
use renderflow_frame::{Camera, Environment};
use std::sync::Arc;

/// Triangles of one shape, in object space, metres.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Name for messages and manifests.
    pub name: String,
    /// Vertex positions; those of the first frame where the mesh deforms.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a vertex; empty = flat shading.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one a vertex, (0, 0) = first texel of the first row; empty = none.
    pub uvs: Vec<Vec2>,
    /// Further sets of texture coordinates, for texture slots that ask for set 1, 2, ...; each one a vertex, or empty.
    pub more_uvs: Vec<Vec<Vec2>>,
    /// Colours, one a vertex, linear, with an opacity, each 0..=1; empty = none. The base colour of the material is multiplied by
    /// the colour, interpolated, and what it covers (by a mask or by opacity) by the opacity.
    pub colors: Vec<Vec4>,
    /// Tangents (xyz unit, w = +-1 handedness) as in glTF, one a vertex; empty = none (no normal map is applied then). They
    /// belong to the first set of texture coordinates: as the file has them, or made for the coordinates that the normal map on
    /// the mesh is looked up with, [`TextureSlot::uv_transform`] applied.
    pub tangents: Vec<Vec4>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// How its vertices move against each other along the sequence; `None` = they do not.
    pub deformation: Option<Arc<Deformation>>,
}

impl Mesh {
    /// Texture coordinates of a set, one a vertex; empty = none.
    pub fn uv_set(&self, set: usize) -> &[Vec2] {
        match set.checked_sub(1) {
            None => &self.uvs,
            Some(further) => self.more_uvs.get(further).map_or(&[], Vec::as_slice),
        }
    }
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
    /// Object to world relative to [`LoadedScene::origin`], one for every frame, or a single one for a static object.
    pub transforms: Vec<Affine3A>,
}

impl Instance {
    /// Object-to-world transform at `frame`.
    pub fn transform(&self, frame: usize) -> Affine3A {
        self.transforms[frame.min(self.transforms.len() - 1)]
    }
}

/// A texture lookup of a material.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TextureSlot {
    /// Index into [`LoadedScene::textures`].
    pub texture: usize,
    /// `uv' = matrix * uv + offset` (KHR_texture_transform); identity when absent.
    pub uv_transform: glam::Affine2,
    /// Set of texture coordinates of the mesh: 0 for [`Mesh::uvs`], n for number n - 1 of [`Mesh::more_uvs`]. A normal map is in
    /// set 0.
    pub set: usize,
}

/// Disney principled material; factors are multiplied with textures where present.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, unique in the scene.
    pub name: String,
    /// Its parameters at the first frame.
    pub surface: Principled,
    /// Linear RGB (sRGB already decoded), multiplies `base_color`.
    pub base_color_texture: Option<TextureSlot>,
    /// glTF layout: G = roughness, B = metallic; multiplies the factors.
    pub metallic_roughness_texture: Option<TextureSlot>,
    /// Tangent-space normal map, values decoded to -1..=1, with its scale.
    pub normal_texture: Option<(TextureSlot, f32)>,
    /// Emitted radiance, linear Rec.709, >= 0; emitted by the front, and by the back where double-sided.
    pub emissive: [f32; 3],
    /// Linear RGB (sRGB already decoded), multiplies `emissive`.
    pub emissive_texture: Option<TextureSlot>,
    /// Angle from the tangent to the direction in which `anisotropic` stretches highlights, radians, counter-clockwise towards
    /// the bitangent.
    pub anisotropy_rotation: f32,
    /// Where the surface is cut out; `None` = nowhere.
    pub alpha_mask: Option<AlphaMask>,
    /// Share of the surface that covers what lies behind, 0..=1, multiplied by the alpha of the base colour's texture; `None` =
    /// all of it. There is no `alpha_mask` besides.
    pub opacity: Option<f32>,
    /// Its red multiplies `transmission`.
    pub transmission_texture: Option<TextureSlot>,
    /// Whether a surface with transmission is a sheet without an inside.
    pub thin_walled: bool,
    /// What the inside of a body with transmission absorbs, per metre, >= 0: light becomes `exp(-absorption distance)` of itself.
    pub absorption: [f32; 3],
    /// Whether the surface exists seen from behind; a single-sided one lets rays pass from there, as glTF culls it.
    pub double_sided: bool,
    /// Its parameters at the last frame of the sequence, between which and `surface` it changes evenly; `None` where it does not
    /// change.
    pub change: Option<Principled>,
}

impl Material {
    /// The material as it is at `time`, in frames from the first one, of a sequence of `frames`: between the first and the last
    /// one, evenly; held beyond. The result changes no more.
    pub fn at(&self, time: f64, frames: usize) -> Self {
        let Some(last) = self.change else { return self.clone() };
        let t = if frames < 2 { 0.0 } else { (time / (frames - 1) as f64).clamp(0.0, 1.0) };
        Self { surface: self.surface.mixed(&last, t), change: None, ..self.clone() }
    }

    /// Every texture lookup.
    pub fn texture_slots(&self) -> impl Iterator<Item = &TextureSlot> {
        let slots =
            [&self.base_color_texture, &self.metallic_roughness_texture, &self.emissive_texture, &self.transmission_texture];
        slots.into_iter().flatten().chain(self.normal_texture.as_ref().map(|(slot, _)| slot))
    }

    /// Every texture lookup, to be changed.
    pub fn texture_slots_mut(&mut self) -> impl Iterator<Item = &mut TextureSlot> {
        let slots = [
            &mut self.base_color_texture,
            &mut self.metallic_roughness_texture,
            &mut self.emissive_texture,
            &mut self.transmission_texture,
        ];
        slots.into_iter().flatten().chain(self.normal_texture.as_mut().map(|(slot, _)| slot))
    }
}

impl From<Principled> for Material {
    /// A material with these parameters and nothing else.
    fn from(surface: Principled) -> Self {
        Self { surface, ..Self::default() }
    }
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: "default".into(),
            surface: Principled::default(),
            base_color_texture: None,
            metallic_roughness_texture: None,
            normal_texture: None,
            emissive: [0.0; 3],
            emissive_texture: None,
            anisotropy_rotation: 0.0,
            alpha_mask: None,
            opacity: None,
            transmission_texture: None,
            thin_walled: false,
            absorption: [0.0; 3],
            double_sided: true,
            change: None,
        }
    }
}

/// glTF's alpha mode MASK: the surface is there where `factor` times the alpha of the base colour's texture reaches `cutoff`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaMask {
    /// Smallest alpha that is there.
    pub cutoff: f32,
    /// 0..=1, multiplies the texture's alpha.
    pub factor: f32,
}

/// Triangles that loading left out, by cause (the first that applies), and those it kept but a person should know of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TriangleReport {
    /// Left out: a vertex that does not exist.
    pub out_of_range: usize,
    /// Left out: a coordinate that is NaN or infinite.
    pub not_finite: usize,
    /// Left out: two corners coincide or all three lie on a line, as exactly as double precision tells from the corners.
    pub no_area: usize,
    /// Left out: the mesh has a triangle at the same three places with the same winding already. The same places with the other
    /// winding are the back of a sheet, and stay.
    pub duplicate: usize,
    /// Kept: the longest edge is more than [`Self::NEEDLE`] times the height above it.
    pub needles: usize,
}

impl TriangleReport {
    /// Longest edge over height from which on a triangle counts as a needle.
    pub const NEEDLE: f64 = 1e6;

    /// Triangles left out.
    pub fn dropped(&self) -> usize {
        self.out_of_range + self.not_finite + self.no_area + self.duplicate
    }
}

impl std::ops::AddAssign for TriangleReport {
    fn add_assign(&mut self, other: Self) {
        self.out_of_range += other.out_of_range;
        self.not_finite += other.not_finite;
        self.no_area += other.no_area;
        self.duplicate += other.duplicate;
        self.needles += other.needles;
    }
}

/// What loading had to decide or repair; all counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadReport {
    /// Materials that let light straight through a share of their surface (glTF's alphaMode BLEND; `d` or `Tr` of MTL).
    pub blended: usize,
    /// Materials with holes where their alpha is low.
    pub alpha_masked: usize,
    /// Triangles left out or remarkable. Meshes are counted once, however often they are placed.
    pub triangles: TriangleReport,
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
    /// BLAKE3 of what the files that the scene names hold, as far as they were read, hexadecimal; empty without files.
    pub files: String,
    /// Shapes.
    pub meshes: Vec<Mesh>,
    /// Placed shapes.
    pub instances: Vec<Instance>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// The point of the world that transforms and cameras are counted from, metres (see
    /// [`renderflow_frame::camera::near_origin`]).
    pub origin: DVec3,
    /// Light of the scene.
    pub environment: Environment,
    /// Lights without an area. Those with one are instances.
    pub lights: Vec<PunctualLight>,
    /// Camera of each frame; at least one.
    pub cameras: Vec<Camera>,
    /// What loading decided.
    pub report: LoadReport,
}
