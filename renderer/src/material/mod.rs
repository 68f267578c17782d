//! How surfaces scatter light.
//!
//! Everything here works in the local frame of a surface point: the shading normal is +z, the tangent +x, `wo` and `wi` are unit
//! and point away from the surface. Densities (`pdf`) are in solid angle.
//!
//! Everything that a vertex calls is always inlined: the compiler's own choice left the parts of a material in memory, which is
//! slower (docs/measurements/renderer-notes.md, small).

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
pub use renderflow_scenes::Principled;

use glam::Vec3A;
use serde::{Deserialize, Serialize};

/// Which form of the material is rendered.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Normalised diffuse, compensation for what single scattering loses, and dielectrics that reflect by Fresnel's equations: a
    /// white furnace closes.
    #[default]
    Conserving,
    /// Burley's formulae as printed, including Schlick's Fresnel term, for comparison with other renderers.
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
