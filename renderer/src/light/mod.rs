//! What lights a scene. Directions are in world space, densities in solid angle at the shading point.

mod distribution;
mod envmap;

pub use envmap::EnvironmentLight;

use glam::Vec3A;

/// One direction towards the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// World-space unit direction towards the light.
    pub wi: Vec3A,
    /// Scene-linear radiance arriving from `wi` when nothing is in between.
    pub radiance: Vec3A,
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}
