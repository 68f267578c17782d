//! Split-sum image-based lighting (Karis 2013).

mod brdf;
mod edges;
mod prefilter;
mod shade;

pub use brdf::{EnvironmentBrdf, environment_brdf};
pub use edges::{Edge, blend, blend_picture};
pub use shade::{Shading, Surfaces, nearest_hit, shade, shade_surfaces, surfaces};

use crate::color::luminance;
use crate::environment::Environment;
use crate::fresnel::{Dielectric, MAX_F0};
use glam::Vec3A;

/// Roughness levels of the prefiltered environment, 0 to 1 in equal steps.
pub const LEVELS: usize = 8;

/// Width of the largest table: the map itself at roughness 0 (half as high).
const MIRROR_WIDTH: usize = 1024;

/// Width of the table of each level from the second on (half as high): at least seven texels across the lobe's half-width,
/// so that bilinear look-ups stay within some per cent of a point light's peak.
const LEVEL_WIDTHS: [usize; LEVELS - 1] = [512, 256, 128, 64, 64, 64, 64];

/// Width of the irradiance table (half as high).
const IRRADIANCE_WIDTH: usize = 64;

/// Tables of one environment: cosine-convolved irradiance and GGX-prefiltered radiance (N = V = R).
/// Every value includes the environment's intensity; the tables turn with its rotation.
#[derive(Clone, Debug)]
pub struct IblTables {
    /// See [`IblTables::irradiance`].
    pub irradiance_map: Environment,
    /// One map for each roughness level.
    pub prefiltered_maps: Vec<Environment>,
}

impl IblTables {
    /// Prefilters `environment`. A constant map costs nothing; any other takes about 0.1 s on four cores, whatever its size.
    pub fn new(environment: &Environment) -> Self {
        if environment.is_constant() {
            let radiance = environment.radiance(Vec3A::Y);
            let map = Environment { rotation: environment.rotation, ..Environment::constant(radiance) };
            return Self { irradiance_map: map.clone(), prefiltered_maps: vec![map; LEVELS] };
        }
        let pyramid = prefilter::Pyramid::new(environment);
        let convolve = |kernel, width| environment.with_map(pyramid.convolve(kernel, width, width / 2));
        let mirror =
            environment.downsampled(environment.map.width.min(MIRROR_WIDTH), environment.map.height.min(MIRROR_WIDTH / 2));
        let rough = LEVEL_WIDTHS.iter().enumerate().map(|(i, width)| {
            let roughness = (i + 1) as f32 / (LEVELS - 1) as f32;
            convolve(prefilter::Kernel::Ggx { alpha: roughness * roughness }, *width)
        });
        Self {
            irradiance_map: convolve(prefilter::Kernel::Cosine, IRRADIANCE_WIDTH),
            prefiltered_maps: std::iter::once(mirror).chain(rough).collect(),
        }
    }

    /// Turns the tables to the rotation (radians) that their environment now has.
    pub fn turn(&mut self, rotation: f32) {
        self.irradiance_map.rotation = rotation;
        self.prefiltered_maps.iter_mut().for_each(|map| map.rotation = rotation);
    }

    /// Integral of L max(0, n.w) dw over the environment for a world-space unit normal, divided by pi.
    #[inline]
    pub fn irradiance(&self, n: Vec3A) -> [f32; 3] {
        self.irradiance_map.radiance(n)
    }

    /// Environment prefiltered by the GGX lobe of `roughness` (0..=1, alpha = roughness^2) about the world-space direction `r`:
    /// the mean of L weighted by D(h) (n.l) with n = v = r. Linear between the two nearest levels.
    #[inline]
    pub fn prefiltered(&self, r: Vec3A, roughness: f32) -> [f32; 3] {
        let level = roughness.clamp(0.0, 1.0) * (LEVELS - 1) as f32;
        let below = (level as usize).min(LEVELS - 2);
        let t = level - below as f32;
        // All levels share one orientation.
        let uv = self.prefiltered_maps[below].uv(r);
        let a = Vec3A::from_array(self.prefiltered_maps[below].radiance_uv(uv));
        let b = Vec3A::from_array(self.prefiltered_maps[below + 1].radiance_uv(uv));
        (a + (b - a) * t).to_array()
    }
}

/// [`IblTables::irradiance_map`] alone, for callers that need no other table.
pub fn irradiance_map(environment: &Environment) -> Environment {
    if environment.is_constant() {
        return IblTables::new(environment).irradiance_map;
    }
    let pyramid = prefilter::Pyramid::new(environment);
    environment.with_map(pyramid.convolve(prefilter::Kernel::Cosine, IRRADIANCE_WIDTH, IRRADIANCE_WIDTH / 2))
}

/// Normal-incidence reflectance of a material: `0.08 * specular` for dielectrics, `albedo` for metals.
pub fn f0(albedo: [f32; 3], metallic: f32, specular: f32) -> [f32; 3] {
    albedo.map(|a| MAX_F0 * specular * (1.0 - metallic) + a * metallic)
}

/// The dielectric part of a material of this `specular`, 0..=1.
pub fn dielectric(specular: f32) -> Dielectric {
    Dielectric::new(MAX_F0 * specular)
}

/// Factor from scene radiance to display-linear: an unoccluded upward-facing white diffuse surface maps to a luminance of 0.8.
/// A black environment gives 1.
pub fn exposure(environment: &Environment) -> f32 {
    let map = &environment.map;
    let mut irradiance = 0.0_f64;
    for (row, texels) in map.pixels.chunks_exact(map.width.max(1)).enumerate() {
        // Integral of cos theta over the band between two thetas of the upper half, over pi: sin^2 - sin^2.
        let edge =
            |row: usize| (std::f64::consts::PI * row as f64 / map.height as f64).min(std::f64::consts::FRAC_PI_2).sin().powi(2);
        let weight = edge(row + 1) - edge(row);
        if weight <= 0.0 {
            break;
        }
        irradiance += weight * texels.iter().map(|texel| f64::from(luminance(*texel))).sum::<f64>() / map.width as f64;
    }
    let factor = (0.8 / (irradiance * f64::from(environment.intensity))) as f32;
    if factor.is_finite() && factor > 0.0 { factor } else { 1.0 }
}
