//! Burley's clearcoat (2012): a fixed dielectric of reflectance 0.04 with the long-tailed GTR1 distribution.
//!
//! `0.25 clearcoat D F V`: `D` is GTR1 of width `mix(0.1, 0.001, gloss)`, `F` the reflectance, and `V` his separable Smith term
//! of width 0.25, which holds the `1 / (4 cos_o cos_i)` of microfacet theory, as in his BRDF explorer's code. He prints Schlick's
//! reflectance from 0.04; the conserving form takes that of index 1.5 by Fresnel's equations.

use super::albedo::on_threads;
use crate::angle::sin_cos_turns;
use crate::number::whole;
use glam::Vec3A;
use renderflow_frame::fresnel::{Dielectric, schlick_weight};
use std::f32::consts::PI;
use std::sync::OnceLock;

/// Nodes along gloss and along the square root of the cosine.
const NODES: [usize; 2] = [16, 32];
/// Strata of the table's integration.
const STRATA: [usize; 2] = [96, 32];

/// The lobe of one material: with Fresnel's reflectance where `EXACT`, else with Schlick's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clearcoat<const EXACT: bool> {
    /// `0.25 clearcoat`.
    strength: f32,
    gloss: f32,
    alpha2: f32,
    /// `pi ln(alpha^2)`.
    tail: f32,
}

impl<const EXACT: bool> Clearcoat<EXACT> {
    /// Both in 0..=1.
    pub fn new(clearcoat: f32, gloss: f32) -> Self {
        let alpha = 0.1 + (0.001 - 0.1) * gloss;
        let alpha2 = alpha * alpha;
        Self { strength: 0.25 * clearcoat, gloss, alpha2, tail: PI * alpha2.ln() }
    }

    /// Value (times cosine) and density.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> (f32, f32) {
        let h = wo + wi;
        let len2 = h.length_squared();
        if len2 < 1e-30 {
            return (0.0, 0.0);
        }
        // sin^2 + alpha^2 cos^2: the printed 1 + (alpha^2 - 1) cos^2 cancels in the middle of the lobe.
        let t = (h.x * h.x + h.y * h.y + self.alpha2 * h.z * h.z) / len2;
        let d = (self.alpha2 - 1.0) / (self.tail * t);
        let cos_d = 0.5 * len2.sqrt();
        let fresnel = if EXACT { Dielectric::GLASS.reflectance(cos_d) } else { 0.04 + 0.96 * schlick_weight(cos_d) };
        // Density of the half vector, D cos, over the Jacobian 4 (wo . h).
        let pdf = 0.5 * d * h.z / len2;
        (self.strength * d * fresnel * visibility(wo.z) * visibility(wi.z) * wi.z, pdf)
    }

    /// Half vectors proportional to `D cos` (Burley 2012, appendix B.2), mirrored; the result may lie below the horizon.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2]) -> Vec3A {
        mirror(wo, self.tilt(u[0]), u[1])
    }

    /// Sine and cosine of the angle of a drawn half vector.
    #[inline]
    fn tilt(&self, u: f32) -> (f32, f32) {
        let range = 1.0 - self.alpha2;
        // sin^2 directly: it is as small as alpha^2.
        let sin2 = ((self.alpha2.powf(1.0 - u) - self.alpha2) / range).clamp(0.0, 1.0);
        (sin2.sqrt(), (1.0 - sin2).sqrt())
    }

    /// Directional albedo for a view at cosine 0..=1, within 1e-4.
    #[inline]
    pub fn albedo(&self, cos: f32) -> f32 {
        // Statics know no generics: one table for each reflectance.
        static TABLES: [OnceLock<Vec<[f32; NODES[1]]>>; 2] = [const { OnceLock::new() }; 2];
        let table = TABLES[usize::from(EXACT)].get_or_init(|| {
            let row = |i: usize| {
                let coat = Self::new(1.0, i as f32 / (NODES[0] - 1) as f32);
                std::array::from_fn(|j| coat.integrate((j as f32 / (NODES[1] - 1) as f32).powi(2)))
            };
            on_threads(NODES[0], row)
        });
        let (x, y) = (self.gloss * (NODES[0] - 1) as f32, cos.sqrt() * (NODES[1] - 1) as f32);
        let (i, j) = (whole(x).min(NODES[0] - 2), whole(y).min(NODES[1] - 2));
        let (s, t) = (x - i as f32, y - j as f32);
        let along = |row: &[f32; NODES[1]]| row[j] + (row[j + 1] - row[j]) * t;
        let (low, high) = (along(&table[i]), along(&table[i + 1]));
        4.0 * self.strength * (low + (high - low) * s)
    }

    /// Directional albedo by the midpoint rule over the lobe's own draws, half a turn of azimuths.
    fn integrate(&self, cos: f32) -> f32 {
        let cos = cos.clamp(1e-6, 1.0);
        let wo = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        let mut sum = 0.0_f64;
        for i in 0..STRATA[0] {
            let tilt = self.tilt((i as f32 + 0.5) / STRATA[0] as f32);
            for j in 0..STRATA[1] {
                let wi = mirror(wo, tilt, 0.5 * (j as f32 + 0.5) / STRATA[1] as f32);
                if wi.z > 0.0 {
                    let (value, pdf) = self.eval(wo, wi);
                    sum += f64::from(value / pdf);
                }
            }
        }
        (sum / (STRATA[0] * STRATA[1]) as f64) as f32
    }
}

/// `wo` mirrored in the half vector of the given sine and cosine, `turns` about the normal.
#[inline]
fn mirror(wo: Vec3A, (sin, cos): (f32, f32), turns: f32) -> Vec3A {
    let (sin_phi, cos_phi) = sin_cos_turns(turns);
    let h = Vec3A::new(sin * cos_phi, sin * sin_phi, cos);
    (2.0 * wo.dot(h) * h - wo).normalize()
}

/// `smithG_GGX` of Burley's code with width 0.25: `G1 / (2 cos)`.
#[inline]
fn visibility(cos: f32) -> f32 {
    const ALPHA2: f32 = 0.25 * 0.25;
    (cos + (ALPHA2 + (1.0 - ALPHA2) * cos * cos).sqrt()).recip()
}
