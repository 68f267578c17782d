//! How surfaces scatter light.
//!
//! Everything here works in the local frame of a surface point: the shading normal is +z, `wo` and `wi` are unit and point away
//! from the surface. Densities (`pdf`) are in solid angle.

mod albedo;
mod disney;
mod fresnel;
pub mod ggx;

pub use disney::Bsdf;
pub use fresnel::{f90, schlick};

use glam::Vec3A;

/// Material parameters at one surface point, textures applied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Linear Rec.709, 0..=1.
    pub base_color: Vec3A,
    /// 0..=1, share of the conductor.
    pub metallic: f32,
    /// 0..=1, perceptual: the GGX width is `alpha = roughness^2`.
    pub roughness: f32,
    /// 0..=1, dielectric reflectance at normal incidence is `0.08 * specular`.
    pub specular: f32,
}

/// Value of a BSDF for a pair of directions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BsdfEval {
    /// BSDF times `|cos(wi, ns)|`.
    pub f_cos: Vec3A,
    /// Density with which [`Bsdf::sample`] draws `wi`, per steradian.
    pub pdf: f32,
}

/// A direction drawn by [`Bsdf::sample`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BsdfSample {
    /// Unit, above the shading horizon.
    pub wi: Vec3A,
    /// `f_cos / pdf`.
    pub weight: Vec3A,
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}
