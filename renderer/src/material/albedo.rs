//! Directional albedo of the GGX lobe, tabulated once a process.
//!
//! With Schlick's Fresnel the single-scattering albedo is `f0 (e - b) + f90 b`, where `e` is the albedo at Fresnel reflectance 1
//! and `b` the part weighted by `(1 - cos)^5`. Both depend on (cosine, roughness) only.

use super::fresnel::schlick_weight;
use super::ggx::{Ggx, MIN_ALPHA};
use glam::Vec3A;
use std::sync::OnceLock;

/// Nodes along the view, even in [`abscissa`].
const COSINES: usize = 32;
/// Nodes along roughness, even in its fourth root from [`MIN_ALPHA`] on: the albedo of smooth surfaces changes with `roughness^4`.
const ROUGHNESSES: usize = 32;
/// Strata of the integration, (radial, azimuthal over half a turn): the albedo is within 0.0013 of its limit.
const STRATA: [usize; 2] = [32, 16];
/// Of [`abscissa`]; by trial, the table is then within 0.0025 everywhere.
const BEND: f32 = 0.1;

/// Where a cosine lies along a row, 0..=1: grazing views are spread out, where the albedo changes fast.
#[inline]
fn abscissa(cos: f32) -> f32 {
    cos * (1.0 + BEND) / (cos + BEND)
}

/// Inverse of [`abscissa`].
fn cosine(x: f32) -> f32 {
    x * BEND / (1.0 + BEND - x)
}

/// Fourth root of the roughness below which `alpha` is constant.
fn lowest_root() -> f32 {
    MIN_ALPHA.sqrt().sqrt().sqrt()
}

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
    /// [`lowest_root`].
    lowest_root: f32,
    /// Nodes in a unit of the fourth root.
    nodes_per_root: f32,
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
        let x = (roughness.sqrt().sqrt() - table.lowest_root).max(0.0) * table.nodes_per_root;
        let i = (x as usize).min(ROUGHNESSES - 2);
        let t = x - i as f32;
        Self { lower: &table.nodes[i], upper: &table.nodes[i + 1], t, mean: table.means[i].lerp(table.means[i + 1], t) }
    }

    /// Albedo for a view at cosine 0..=1.
    #[inline]
    pub fn at(self, cos: f32) -> Albedo {
        let x = abscissa(cos) * (COSINES - 1) as f32;
        let i = (x as usize).min(COSINES - 2);
        let s = x - i as f32;
        self.lower[i].lerp(self.lower[i + 1], s).lerp(self.upper[i].lerp(self.upper[i + 1], s), self.t)
    }
}

impl Table {
    fn new() -> Self {
        let lowest_root = lowest_root();
        let root_step = (1.0 - lowest_root) / (ROUGHNESSES - 1) as f32;
        // One thread, some 10 ms: a rayon worker that waits here would pick up a tile, come back for the table and wait for itself.
        let rows = (0..ROUGHNESSES).map(|i| {
            let alpha = (lowest_root + i as f32 * root_step).powi(8);
            let row = std::array::from_fn(|j| integrate(alpha, cosine(j as f32 / (COSINES - 1) as f32)));
            (row, mean(&row))
        });
        let (nodes, means) = rows.unzip();
        Self { nodes, means, lowest_root, nodes_per_root: root_step.recip() }
    }
}

/// Midpoint rule over visible normals: the mean of `G2 / G1` is the albedo. Symmetric in azimuth, so half a turn suffices.
fn integrate(alpha: f32, cos: f32) -> Albedo {
    let ggx = Ggx::new(alpha);
    // At exactly grazing view the albedo is a limit; a cosine this small is on it.
    let cos = cos.clamp(1e-6, 1.0);
    let wo = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos);
    let (mut e, mut b) = (0.0_f64, 0.0_f64);
    for i in 0..STRATA[0] {
        for j in 0..STRATA[1] {
            // Finer towards u = 1, where the mirrored directions meet the horizon: equal strata err by half of one there.
            let s = (i as f32 + 0.5) / STRATA[0] as f32;
            let u = [1.0 - s * s, 0.5 * (j as f32 + 0.5) / STRATA[1] as f32];
            if let Some(wi) = ggx.sample(wo, u).filter(|wi| wi.z > 0.0) {
                let weight = 2.0 * s * ggx.masking_ratio(cos, wi.z);
                e += f64::from(weight);
                b += f64::from(weight * schlick_weight(0.5 * (wo + wi).length()));
            }
        }
    }
    let n = (STRATA[0] * STRATA[1]) as f64;
    Albedo { e: (e / n).min(1.0) as f32, b: (b / n).min(1.0) as f32 }
}

/// `2 * integral of a(cos) cos dcos` of a row, Simpson's rule on each interval of its interpolant.
fn mean(row: &[Albedo; COSINES]) -> Albedo {
    let h = 1.0 / (COSINES - 1) as f32;
    let (mut e, mut b, mut norm) = (0.0, 0.0, 0.0);
    for (i, pair) in row.windows(2).enumerate() {
        for (t, simpson) in [(0.0, 1.0), (0.5, 4.0), (1.0, 1.0)] {
            let x = (i as f32 + t) * h;
            // dcos / dx without its constant factor.
            let slope = f64::from(1.0 + BEND - x).powi(-2);
            let weight = simpson * f64::from(cosine(x)) * slope;
            let value = pair[0].lerp(pair[1], t);
            e += weight * f64::from(value.e);
            b += weight * f64::from(value.b);
            norm += weight;
        }
    }
    Albedo { e: (e / norm) as f32, b: (b / norm) as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers come from `tests/references/ggx_albedo.py`, which integrates the BRDF in another parametrisation.
    #[test]
    fn table_agrees_with_an_independent_integration() {
        let mut worst: f32 = 0.0;
        for line in include_str!("../../tests/references/ggx_albedo.csv").lines().skip(1) {
            let numbers: Vec<f32> = line.split(',').map(|field| field.parse().unwrap()).collect();
            let [alpha, cos, e, b] = numbers[..] else { panic!("{line}") };
            let albedo = Row::new(alpha.sqrt()).at(cos);
            worst = worst.max((albedo.e - e).abs()).max((albedo.b - b).abs());
        }
        println!("worst: {worst}");
        assert!(worst < 0.003, "{worst}");
    }

    #[test]
    fn means_are_those_of_the_interpolant() {
        for roughness in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let row = Row::new(roughness);
            let n = 100_000;
            let (mut e, mut b) = (0.0_f64, 0.0_f64);
            for i in 0..n {
                // Uniform in cos^2: the weight 2 cos dcos.
                let albedo = row.at(((i as f32 + 0.5) / n as f32).sqrt());
                e += f64::from(albedo.e) / f64::from(n);
                b += f64::from(albedo.b) / f64::from(n);
            }
            assert!((e - f64::from(row.mean.e)).abs() < 1e-4, "{roughness}: {e} {}", row.mean.e);
            assert!((b - f64::from(row.mean.b)).abs() < 1e-4, "{roughness}: {b} {}", row.mean.b);
        }
    }
}
