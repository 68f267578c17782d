//! Split-sum image-based lighting (Karis 2013): the classical baseline, and the network's start point.

use crate::environment::Environment;
use crate::image::{Image, Rgb};
use crate::{Camera, Frame};
use glam::Vec3A;

/// Roughness levels of the prefiltered environment, 0 to 1 in equal steps.
pub const LEVELS: usize = 8;

/// Tables of one environment: cosine-convolved irradiance, GGX-prefiltered radiance (N = V = R) and the environment BRDF.
#[derive(Clone, Debug)]
pub struct IblTables {
    /// See [`IblTables::irradiance`].
    pub irradiance_map: Environment,
    /// One map a roughness level.
    pub prefiltered_maps: Vec<Environment>,
}

impl IblTables {
    /// Prefilters `environment`.
    pub fn new(_environment: &Environment) -> Self {
        todo!()
    }

    /// Integral of L max(0, n.w) dw over the environment for a world-space unit normal, divided by pi.
    pub fn irradiance(&self, _n: Vec3A) -> [f32; 3] {
        todo!()
    }

    /// Environment prefiltered by the GGX lobe of `roughness` (0..=1, alpha = roughness^2) about the world-space direction `r`.
    pub fn prefiltered(&self, _r: Vec3A, _roughness: f32) -> [f32; 3] {
        todo!()
    }
}

/// The (scale, bias) on F0 of the split sum for n.v and roughness, each 0..=1.
pub fn environment_brdf(_n_dot_v: f32, _roughness: f32) -> [f32; 2] {
    todo!()
}

/// Normal-incidence reflectance of a material: `0.08 * specular` for dielectrics, `albedo` for metals.
pub fn f0(albedo: [f32; 3], metallic: f32, specular: f32) -> [f32; 3] {
    albedo.map(|a| 0.08 * specular * (1.0 - metallic) + a * metallic)
}

/// Factor from scene radiance to display-linear: an unoccluded upward-facing white diffuse surface maps to 0.8.
/// A black environment gives 1.
pub fn exposure(_environment: &Environment) -> f32 {
    todo!()
}

/// The factors of the split-sum image, per pixel; radiance is scene-linear.
#[derive(Clone, Debug)]
pub struct Shading {
    /// `alpha * (diffuse * irradiance + specular) + (1 - alpha) * background`: the IBL picture.
    pub image: Rgb,
    /// Diffuse albedo: `albedo * (1 - metallic)`, divided by coverage.
    pub diffuse: Rgb,
    /// E(n)/pi at the shading normal.
    pub irradiance: Rgb,
    /// Prefiltered environment along the mirror direction.
    pub prefiltered: Rgb,
    /// `prefiltered * (f0 * a + b)`.
    pub specular: Rgb,
    /// Environment-BRDF scale and bias (a, b).
    pub brdf: Image<[f32; 2]>,
    /// Albedo used (anti-aliased where guides exist), divided by coverage.
    pub albedo: Rgb,
    /// Camera-space unit normal used (anti-aliased where guides exist), 0 where nothing is covered.
    pub normal: Rgb,
    /// (roughness, metallic, specular) used; pixels with coverage whose centre missed borrow their nearest neighbour's.
    pub material: Rgb,
    /// Planar depth used, borrowed like `material`; +inf where nothing is covered.
    pub depth: Image<f32>,
    /// The environment seen through the pixel.
    pub background: Rgb,
    /// Coverage.
    pub alpha: Image<f32>,
}

/// Shades the G-buffer of `frame` with the split sum.
pub fn shade(_frame: &Frame, _camera: &Camera, _environment: &Environment, _tables: &IblTables) -> Shading {
    todo!()
}
