//! How surfaces scatter light.
//!
//! Everything here works in the local frame of a surface point: the shading normal is +z, the tangent +x, `wo` and `wi` are unit
//! and point away from the surface. Densities (`pdf`) are in solid angle.
//!
//! Everything that a vertex calls is always inlined: the compiler's own choice left the parts of a material in memory, which is
//! slower (docs/measurements/renderer-notes.md, small).

mod albedo;
mod anisotropy;
mod clear;
mod clearcoat;
mod conserving;
mod diffuse;
mod disney;
mod fresnel;
pub mod ggx;
pub(crate) mod glass;
mod published;
mod sheen;
mod subsurface;

pub use clear::{ClearBsdf, ClearView};
use disney::Lobes;
pub use disney::{Bsdf, Prepared, View};
pub use fresnel::schlick;
pub use glass::refraction_index;
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

/// Draws of a smaller density are discarded. The quotient of value and density would be rounded beyond use (both are subnormal or
/// nearly so), and such a draw has a probability below 1e-28 of happening at all.
const MIN_PDF: f32 = 1e-30;

/// What a surface that lets light through is to the one who sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Side {
    /// The boundary of a body, seen from outside.
    #[default]
    Outside,
    /// The boundary of a body, seen from inside.
    Inside,
    /// A rough sheet without an inside.
    Sheet,
    /// A smooth sheet; what it lets through goes straight on and is no part of the BSDF.
    Pane,
}

impl Side {
    /// What the surface is to a viewer on its other side.
    #[inline(always)]
    pub fn across(self) -> Self {
        match self {
            Self::Outside => Self::Inside,
            Self::Inside => Self::Outside,
            sheet => sheet,
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
    /// Unit; above the shading horizon, or below it where light is let through.
    pub wi: Vec3A,
    /// `f_cos / pdf`.
    pub weight: Vec3A,
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}
