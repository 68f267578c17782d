//! How surfaces scatter light.
//!
//! Everything here works in the local frame of a surface point: the shading normal is +z, the tangent +x, `wo` and `wi` are unit and point away
//! from the surface. Densities (`pdf`) are in solid angle.
//!
//! What a vertex calls is inlined always: the compiler's own choice left the parts of a material in memory, which is slower
//! (docs/measurements/renderer-notes.md, small).

mod albedo;
mod anisotropy;
mod clearcoat;
mod conserving;
mod diffuse;
mod disney;
mod fresnel;
pub mod ggx;
mod published;
mod sheen;
mod subsurface;

use disney::Lobes;
pub use disney::{Bsdf, Prepared, View};
pub use fresnel::schlick;

use glam::Vec3A;
use serde::{Deserialize, Serialize};

/// Which form of the material is rendered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Normalised diffuse, compensation for what single scattering loses, and dielectrics that reflect by Fresnel's equations: a white
    /// furnace closes.
    #[default]
    Conserving,
    /// Formulae as Burley printed them, Schlick's Fresnel among them, for comparison with other renderers.
    Published,
}

impl Mode {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Conserving => "conserving",
            Self::Published => "published",
        }
    }
}

/// Material parameters at one surface point, textures applied. All scalars are in 0..=1 and mean what Burley's (2012) do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Linear Rec.709, 0..=1.
    pub base_color: Vec3A,
    /// Share of the conductor.
    pub metallic: f32,
    /// Perceptual: the GGX width is `alpha = roughness^2`.
    pub roughness: f32,
    /// Dielectric reflectance at normal incidence is `0.08 * specular`: indices of refraction from 1 to 1.79, 1.5 at one half.
    pub specular: f32,
    /// Share of the base colour's hue in the dielectric reflectance.
    pub specular_tint: f32,
    /// The GGX widths along tangent and bitangent differ by `1 - 0.9 * anisotropic`.
    pub anisotropic: f32,
    /// Strength of the grazing lobe of cloth.
    pub sheen: f32,
    /// Share of the base colour's hue in the sheen.
    pub sheen_tint: f32,
    /// Strength of the second specular layer.
    pub clearcoat: f32,
    /// 0 is satin, 1 is gloss.
    pub clearcoat_gloss: f32,
    /// Share of the diffuse shape that imitates subsurface scattering.
    pub subsurface: f32,
}

impl Default for Surface {
    /// A plain grey dielectric.
    fn default() -> Self {
        Self {
            base_color: Vec3A::splat(0.5),
            metallic: 0.0,
            roughness: 0.5,
            specular: 0.5,
            specular_tint: 0.0,
            anisotropic: 0.0,
            sheen: 0.0,
            sheen_tint: 0.5,
            clearcoat: 0.0,
            clearcoat_gloss: 1.0,
            subsurface: 0.0,
        }
    }
}

impl Surface {
    /// Whether [`Bsdf`] with `FULL = false` has all that this material needs.
    pub fn is_plain(&self) -> bool {
        [self.specular_tint, self.anisotropic, self.sheen, self.clearcoat, self.subsurface].iter().all(|v| *v <= 0.0)
    }

    /// Every parameter in its range.
    #[inline]
    fn clamped(&self) -> Self {
        Self {
            specular_tint: self.specular_tint.clamp(0.0, 1.0),
            anisotropic: self.anisotropic.clamp(0.0, 1.0),
            sheen: self.sheen.clamp(0.0, 1.0),
            sheen_tint: self.sheen_tint.clamp(0.0, 1.0),
            clearcoat: self.clearcoat.clamp(0.0, 1.0),
            clearcoat_gloss: self.clearcoat_gloss.clamp(0.0, 1.0),
            subsurface: self.subsurface.clamp(0.0, 1.0),
            ..self.clamped_plain()
        }
    }

    /// The parameters of plain materials in their range, the rest as it is.
    #[inline]
    fn clamped_plain(&self) -> Self {
        Self {
            base_color: self.base_color.clamp(Vec3A::ZERO, Vec3A::ONE),
            metallic: self.metallic.clamp(0.0, 1.0),
            roughness: self.roughness.clamp(0.0, 1.0),
            specular: self.specular.clamp(0.0, 1.0),
            ..*self
        }
    }
}

/// Value of a BSDF for a pair of directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BsdfEval {
    /// BSDF times `|cos(wi, ns)|`.
    pub f_cos: Vec3A,
    /// Density with which [`View::sample`] draws `wi`, per steradian.
    pub pdf: f32,
}

/// A direction drawn by [`View::sample`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Unit, above the shading horizon.
    pub wi: Vec3A,
    /// `f_cos / pdf`.
    pub weight: Vec3A,
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}
