//! Screen-space features: what a G-buffer alone can say about occlusion.

use crate::Camera;
use crate::environment::Environment;
use crate::ibl::Shading;
use crate::image::{Image, Rgb};

/// Occlusion read off the depth buffer; 1 where nothing is covered.
#[derive(Clone, Debug)]
pub struct ScreenSpace {
    /// Ambient occlusion: visible share of the cosine-weighted hemisphere, 0..=1.
    pub occlusion: Image<f32>,
    /// Mean unoccluded direction (camera space, unit), 0 where nothing is covered.
    pub bent_normal: Rgb,
    /// Visibility towards the environment's dominant light, ray-marched through the depth buffer, 0..=1.
    pub light_visibility: Image<f32>,
}

/// Computes all screen-space features; deterministic, no noise that changes between frames.
pub fn features(_shading: &Shading, _camera: &Camera, _environment: &Environment) -> ScreenSpace {
    todo!()
}
