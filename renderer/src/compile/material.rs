//! Materials with their constant parts ready.

use crate::material::{Prepared, Principled, Side};
use crate::texture::Sampled;
use glam::Vec3A;
use renderflow_scenes::loaded::AlphaMask;
use renderflow_scenes::{LoadedScene, Material, Mesh, TextureSlot};

/// A material with its constant part ready.
#[derive(Clone, Debug)]
pub(crate) struct CompiledMaterial {
    pub surface: Principled,
    pub base_color_texture: Option<TextureSlot>,
    /// The lowest opacity in the colours of the vertices on it; `None` where they have no colours.
    pub least_alpha: Option<f32>,
    pub metallic_roughness_texture: Option<TextureSlot>,
    pub normal_texture: Option<(TextureSlot, f32)>,
    /// Whether the textures of colour, roughness, normals and transmission are all read at the same places.
    pub same_places: bool,
    /// Radiance; zero where the surface does not emit.
    pub emissive: Vec3A,
    pub emissive_texture: Option<TextureSlot>,
    /// `None` where the mask cuts nothing, even if the file has one.
    pub alpha_mask: Option<AlphaMask>,
    /// See [`Material::opacity`]; `None` where the surface covers everything.
    pub opacity: Option<f32>,
    pub double_sided: bool,
    pub clear: Clear,
    pub thin_walled: bool,
    /// See [`Material::anisotropy_rotation`].
    pub anisotropy_rotation: f32,
    pub transmission_texture: Option<TextureSlot>,
    /// What the inside absorbs per metre.
    pub absorption: Vec3A,
}

/// How a material lets light through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clear {
    /// Not at all, or straight through holes.
    No,
    /// It bounds a body.
    Body,
    /// A rough sheet.
    Sheet,
    /// A smooth sheet.
    Pane,
}

/// Sheets smoother than this let light straight through: they spread it over less than half a degree.
const PANE_ROUGHNESS: f32 = 0.08;

impl Clear {
    /// Of a material with the factors `surface`; `textured` tells whether a texture changes metallic and roughness.
    pub fn of(surface: &Principled, thin_walled: bool, textured: bool) -> Self {
        if surface.transmission <= 0.0 || surface.metallic >= 1.0 && !textured {
            Self::No
        } else if !thin_walled {
            Self::Body
        } else if surface.roughness < PANE_ROUGHNESS {
            Self::Pane
        } else {
            Self::Sheet
        }
    }
}

impl CompiledMaterial {
    /// `least_alpha` is what [`least_alphas`] says of it.
    pub fn new(material: &Material, textures: &[Sampled], least_alpha: Option<f32>) -> Self {
        let emissive = Vec3A::from_array(material.emissive).max(Vec3A::ZERO);
        // A mask that cuts nothing must not cost every ray a look-up.
        let lowest = material.base_color_texture.as_ref().map_or(1.0, |slot| textures[slot.texture].lowest_alpha());
        let lowest = lowest * least_alpha.unwrap_or(1.0);
        let alpha_mask = material.alpha_mask.filter(|mask| mask.factor * lowest < mask.cutoff);
        let normal = material.normal_texture.as_ref().map(|(slot, _)| slot);
        let others = [&material.metallic_roughness_texture, &material.transmission_texture, &material.base_color_texture];
        let slots: Vec<&TextureSlot> = others.into_iter().flatten().chain(normal).collect();
        let of = |slot: &TextureSlot| &textures[slot.texture];
        let same_places = slots.windows(2).all(|pair| of(pair[0]).shares_places(pair[0], (of(pair[1]), pair[1])));
        Self {
            surface: material.surface.clamped(),
            base_color_texture: material.base_color_texture.clone(),
            least_alpha,
            metallic_roughness_texture: material.metallic_roughness_texture.clone(),
            normal_texture: material.normal_texture.clone(),
            same_places,
            emissive,
            emissive_texture: material.emissive_texture.clone().filter(|_| emissive != Vec3A::ZERO),
            alpha_mask,
            opacity: material.opacity.filter(|opacity| opacity * lowest < 1.0),
            double_sided: material.double_sided,
            clear: Clear::of(&material.surface, material.thin_walled, material.metallic_roughness_texture.is_some()),
            thin_walled: material.thin_walled,
            anisotropy_rotation: material.anisotropy_rotation,
            transmission_texture: material.transmission_texture.clone(),
            absorption: Vec3A::from_array(material.absorption).max(Vec3A::ZERO),
        }
    }

    /// Whether the base colour is multiplied by colours of vertices.
    #[inline(always)]
    pub fn has_colors(&self) -> bool {
        self.least_alpha.is_some()
    }

    /// Whether base colour or normal differ from point to point.
    #[inline(always)]
    pub fn varies(&self) -> bool {
        self.base_color_texture.is_some() || self.has_colors() || self.normal_texture.is_some()
    }

    /// The BSDF, `None` where it changes from place to place: by a texture, by colours of vertices, or because the material is
    /// anisotropic and not `directed` everywhere.
    pub(super) fn prepared(&self, directed: bool) -> Option<Prepared> {
        let slots = [&self.base_color_texture, &self.metallic_roughness_texture, &self.transmission_texture];
        let same = slots.iter().all(|slot| slot.is_none()) && (directed || self.surface.anisotropic == 0.0);
        (same && !self.has_colors()).then(|| Prepared::new(&self.surface))
    }

    /// Whether every ray that meets the surface stops there, from either side.
    #[inline(always)]
    pub fn is_solid(&self) -> bool {
        self.both_sides() && self.alpha_mask.is_none() && self.opacity.is_none()
    }

    /// Whether rays meet the surface from behind too. They must where it bounds a body, or they would never leave that.
    #[inline(always)]
    pub fn both_sides(&self) -> bool {
        self.double_sided || self.clear == Clear::Body
    }

    /// What the surface is to a viewer in front of it or behind it.
    #[inline(always)]
    pub fn side(&self, front: bool) -> Side {
        match self.clear {
            Clear::Sheet => Side::Sheet,
            Clear::Pane => Side::Pane,
            Clear::No | Clear::Body if front => Side::Outside,
            Clear::No | Clear::Body => Side::Inside,
        }
    }
}

/// The lowest opacity that the colours of vertices give each material; `None` where no mesh on it has any.
pub(super) fn least_alphas(scene: &LoadedScene) -> Vec<Option<f32>> {
    let least = |mesh: &Mesh| mesh.colors.iter().map(|color| color.w).reduce(f32::min);
    let meshes: Vec<Option<f32>> = scene.meshes.iter().map(least).collect();
    let mut materials = vec![None; scene.materials.len()];
    for instance in &scene.instances {
        if let Some(alpha) = meshes[instance.mesh] {
            let lowest: &mut Option<f32> = &mut materials[instance.material];
            *lowest = Some(lowest.map_or(alpha, |lowest| lowest.min(alpha)));
        }
    }
    materials
}
