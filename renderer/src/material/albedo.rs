//! Directional albedo of the GGX lobe, tabulated once a process.
//!
//! With Schlick's Fresnel the single-scattering albedo is `f0 (e - b) + f90 b`, where `e` is the albedo at Fresnel reflectance 1
//! and `b` the part weighted by `(1 - cos)^5`. Both depend on (cosine, roughness) only.

use super::fresnel::schlick_weight;
use super::ggx::{Ggx, alpha};
use glam::Vec3A;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Nodes along the square root of the cosine, which spreads out the fast change at grazing view.
const COSINES: usize = 32;
/// Nodes along perceptual roughness.
const ROUGHNESSES: usize = 32;
/// Strata of the integration, (radial, azimuthal over half a turn). With them the white furnace closes within 0.3 %.
const STRATA: [usize; 2] = [48, 24];

/// `e` and `b` of the module's text.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Albedo {
    /// Albedo with Fresnel reflectance 1.
    pub e: f32,
    /// The same weighted by Schlick's `(1 - cos)^5`.
    pub b: f32,
}

impl Albedo {
    #[inline]
    fn lerp(self, other: Self, t: f32) -> Self {
        Self { e: self.e + (other.e - self.e) * t, b: self.b + (other.b - self.b) * t }
    }
}

struct Table {
    /// `[roughness][cosine]`.
    nodes: Vec<[Albedo; COSINES]>,
    /// Cosine-weighted mean of each row as interpolated, so that the lobes built on it close exactly.
    means: Vec<Albedo>,
}

/// The row of the table that belongs to one roughness.
#[derive(Clone, Copy)]
pub(super) struct Row {
    lower: &'static [Albedo; COSINES],
    upper: &'static [Albedo; COSINES],
    t: f32,
    /// Cosine-weighted hemispherical mean.
    pub mean: Albedo,
}

impl Row {
    /// `roughness` in 0..=1.
    #[inline]
    pub fn new(roughness: f32) -> Self {
        static TABLE: OnceLock<Table> = OnceLock::new();
        let table = TABLE.get_or_init(Table::new);
        let x = roughness * (ROUGHNESSES - 1) as f32;
        let i = (x as usize).min(ROUGHNESSES - 2);
        let t = x - i as f32;
        Self { lower: &table.nodes[i], upper: &table.nodes[i + 1], t, mean: table.means[i].lerp(table.means[i + 1], t) }
    }

    /// Albedo for a view at cosine 0..=1.
    #[inline]
    pub fn at(self, cos: f32) -> Albedo {
        let x = cos.sqrt() * (COSINES - 1) as f32;
        let i = (x as usize).min(COSINES - 2);
        let s = x - i as f32;
        self.lower[i].lerp(self.lower[i + 1], s).lerp(self.upper[i].lerp(self.upper[i + 1], s), self.t)
    }
}

impl Table {
    fn new() -> Self {
        let nodes: Vec<[Albedo; COSINES]> = (0..ROUGHNESSES)
            .into_par_iter()
            .map(|i| {
                let roughness = i as f32 / (ROUGHNESSES - 1) as f32;
                std::array::from_fn(|j| {
                    let root = j as f32 / (COSINES - 1) as f32;
                    integrate(roughness, root * root)
                })
            })
            .collect();
        let means = nodes.iter().map(mean).collect();
        Self { nodes, means }
    }
}

/// Midpoint rule over visible normals: the mean of `G2 / G1` is the albedo. Symmetric in azimuth, so half a turn suffices.
fn integrate(roughness: f32, cos: f32) -> Albedo {
    let ggx = Ggx::new(alpha(roughness));
    // At exactly grazing view the albedo is a limit; a cosine this small is on it.
    let cos = cos.max(1e-6);
    let wo = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos);
    let (mut e, mut b) = (0.0_f64, 0.0_f64);
    for i in 0..STRATA[0] {
        for j in 0..STRATA[1] {
            let u = [(i as f32 + 0.5) / STRATA[0] as f32, 0.5 * (j as f32 + 0.5) / STRATA[1] as f32];
            if let Some(wi) = ggx.sample(wo, u).filter(|wi| wi.z > 0.0) {
                let weight = ggx.masking_ratio(cos, wi.z);
                e += f64::from(weight);
                b += f64::from(weight * schlick_weight(0.5 * (wo + wi).length()));
            }
        }
    }
    let n = (STRATA[0] * STRATA[1]) as f64;
    Albedo { e: (e / n).min(1.0) as f32, b: (b / n).min(1.0) as f32 }
}

/// `2 * integral of a(cos) cos dcos` of a row, exact for its interpolant: with `s = sqrt(cos)` it is `4 * integral of a(s) s^3 ds`.
fn mean(row: &[Albedo; COSINES]) -> Albedo {
    let h = 1.0 / (COSINES - 1) as f64;
    let (mut e, mut b) = (0.0, 0.0);
    for (i, pair) in row.windows(2).enumerate() {
        let (s0, s1) = (i as f64 * h, (i + 1) as f64 * h);
        // Moments of s^3 against the falling and the rising hat function.
        let m3 = s1.powi(4) - s0.powi(4);
        let m4 = 0.8 * (s1.powi(5) - s0.powi(5));
        let rising = (m4 - s0 * m3) / h;
        let falling = m3 - rising;
        e += f64::from(pair[0].e) * falling + f64::from(pair[1].e) * rising;
        b += f64::from(pair[0].b) * falling + f64::from(pair[1].b) * rising;
    }
    Albedo { e: e as f32, b: b as f32 }
}
