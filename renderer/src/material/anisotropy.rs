//! Directional albedo of the anisotropic GGX lobe, tabulated.
//!
//! The table has four axes: the logarithm of the widths' ratio, the square root of the roughness, the view's azimuth in a plane
//! stretched by the root of that ratio, and its cosine, spread out by the width that the lobe has along the azimuth
//! ([`super::albedo`] says how): in these the albedo is smooth. Each ratio is a slice of its own, made when it is first met.

use super::albedo::{Abscissa, Albedo, AlbedoMoments, GAUSS, UNIT_MOMENTS, integrate_view, on_threads};
use super::ggx::{Ggx, alpha_xy};
use crate::number::whole;
use glam::{Vec3A, Vec4};
use std::sync::OnceLock;

/// Nodes along the logarithm of the ratio, and of its slices: root of the roughness, stretched azimuth, cosine.
const RATIOS: usize = 8;
const NODES: [usize; 3] = [18, 14, 24];
/// Smallest ratio of the widths, at full anisotropy.
const LEAST_RATIO: f32 = 0.1;
/// Root of the roughness at full anisotropy below which both widths are at their floor: `(MIN_ALPHA * sqrt(LEAST_RATIO))^(1/4)`.
const LOWEST_ROOT: f32 = 0.133_352_14;
/// Strata of the integration, over a whole turn: for lobes up to a width of 1, and for wider ones.
const STRATA: [[usize; 2]; 2] = [[20, 40], [28, 80]];

/// The table may be 0.6 % too low (measured, between its nodes at full anisotropy and roughness 1), and compensation would then
/// gain energy: the albedo is taken this much too high.
const SURPLUS: f32 = 1.006;

/// The albedo of one anisotropic lobe, for every view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anisotropy {
    slices: [&'static Slice; 2],
    /// Share of the second slice; index of the lower roughness and share of the upper one.
    ratio_share: f32,
    root: (usize, f32),
    lobe: Lobe,
}

/// What places a view in a slice.
#[derive(Clone, Copy, Debug)]
struct Lobe {
    /// Squares of the widths, and the root of their ratio.
    alpha2: [f32; 2],
    stretch: f32,
}

impl Lobe {
    fn new([ax, ay]: [f32; 2]) -> Self {
        Self { alpha2: [ax * ax, ay * ay], stretch: (ay / ax).sqrt() }
    }

    /// Position along azimuth and cosine, 0..=1.
    #[inline]
    fn place(&self, w: Vec3A) -> [f32; 2] {
        let (x2, y2) = (w.x * w.x, w.y * w.y);
        // At the pole every azimuth will do.
        let alpha2 = (self.alpha2[0] * x2 + self.alpha2[1] * y2) / (x2 + y2 + f32::MIN_POSITIVE);
        let (x, y) = (w.x.abs(), self.stretch * w.y.abs());
        [y / (x + y + f32::MIN_POSITIVE), Abscissa::new(alpha2.max(self.alpha2[1]).sqrt().sqrt().sqrt()).at(w.z.min(1.0))]
    }
}

/// All lobes of one ratio: nodes in the order of [`NODES`], and the means of each roughness.
#[derive(Debug)]
struct Slice {
    nodes: Vec<Albedo>,
    moments: Vec<AlbedoMoments>,
}

/// Index of the lower node and share of the upper one on an axis of `nodes`; `x` in 0..=1.
#[inline]
fn node(x: f32, nodes: usize) -> (usize, f32) {
    let x = x.clamp(0.0, 1.0) * (nodes - 1) as f32;
    let i = whole(x).min(nodes - 2);
    (i, x - i as f32)
}

fn fraction(i: usize, nodes: usize) -> f32 {
    i as f32 / (nodes - 1) as f32
}

impl Anisotropy {
    /// Both in 0..=1.
    pub fn new(roughness: f32, anisotropic: f32) -> Self {
        let ratio = 1.0 - 0.9 * anisotropic;
        let (slice, ratio_share) = node(ratio.ln() / LEAST_RATIO.ln(), RATIOS);
        let root = (roughness.sqrt() - LOWEST_ROOT) / (1.0 - LOWEST_ROOT);
        Self {
            slices: [Slice::get(slice), Slice::get(slice + 1)],
            ratio_share,
            root: node(root, NODES[0]),
            lobe: Lobe::new(alpha_xy(roughness, anisotropic)),
        }
    }

    /// Albedo for a unit direction on or above the horizon.
    pub fn at(&self, w: Vec3A) -> Albedo {
        let place = self.lobe.place(w);
        let [low, high] = self.slices.map(|slice| slice.at(self.root, place));
        let albedo = low.lerp(high, self.ratio_share);
        // No lobe reflects less than 0.11; the bound keeps the compensation finite.
        let e = albedo.e.clamp(0.05, 1.0);
        let surplus = SURPLUS.min(e.recip());
        Albedo { e: surplus * e, rest: surplus * albedo.rest }
    }

    /// Means over the hemisphere, 3 % and 0.002 low: a base that is thought to receive more reflects less. (Coats of an index
    /// near 1 reflect little, so that a share of it would not outweigh the table's errors.)
    pub fn moments(&self) -> AlbedoMoments {
        let (i, t) = self.root;
        let [low, high] = self.slices.map(|slice| slice.moments[i].lerp(&slice.moments[i + 1], t));
        let mean = low.lerp(&high, self.ratio_share);
        AlbedoMoments {
            whole: mean.whole.map(|m| 0.97 * m),
            parts: std::array::from_fn(|k| 0.97 * mean.parts[k] - 0.002 * UNIT_MOMENTS[k]),
        }
    }
}

impl Slice {
    fn get(index: usize) -> &'static Self {
        static SLICES: [OnceLock<Slice>; RATIOS] = [const { OnceLock::new() }; RATIOS];
        SLICES[index].get_or_init(|| Self::new(LEAST_RATIO.powf(fraction(index, RATIOS))))
    }

    #[inline]
    fn at(&self, (i, r): (usize, f32), [azimuth, x]: [f32; 2]) -> Albedo {
        let ((j, s), (k, t)) = (node(azimuth, NODES[1]), node(x, NODES[2]));
        let along = |i: usize, j: usize| {
            let at = (i * NODES[1] + j) * NODES[2] + k;
            self.nodes[at].lerp(self.nodes[at + 1], t)
        };
        let across = |i: usize| along(i, j).lerp(along(i, j + 1), s);
        across(i).lerp(across(i + 1), r)
    }

    fn new(ratio: f32) -> Self {
        let mut slice = Self { nodes: Vec::with_capacity(NODES.iter().product()), moments: vec![] };
        let widths = |i: usize| {
            let root = LOWEST_ROOT + (1.0 - LOWEST_ROOT) * fraction(i, NODES[0]);
            alpha_xy(root * root, (1.0 - ratio) / 0.9)
        };
        let row = |i: usize| {
            let mut row = Vec::with_capacity(NODES[1] * NODES[2]);
            let lobe = Lobe::new(widths(i));
            let ggx = Ggx::<true>::with_widths(widths(i));
            let strata = STRATA[usize::from(widths(i)[0] > 1.0)];
            for j in 0..NODES[1] {
                // |y| / |x|, 0 to infinity, as a direction.
                let (x, y) = (1.0 - fraction(j, NODES[1]), fraction(j, NODES[1]) / lobe.stretch);
                let (x, y) = (x / x.hypot(y), y / x.hypot(y));
                let alpha2 = lobe.alpha2[0] * x * x + lobe.alpha2[1] * y * y;
                let abscissa = Abscissa::new(alpha2.sqrt().sqrt().sqrt());
                for k in 0..NODES[2] {
                    let cos = abscissa.cosine(fraction(k, NODES[2])).clamp(1e-6, 1.0);
                    let sin = (1.0 - cos * cos).sqrt();
                    let (e, parts) = integrate_view(&ggx, Vec3A::new(sin * x, sin * y, cos), 1.0, strata);
                    row.push(Albedo::new(e, parts, cos));
                }
            }
            row
        };
        slice.nodes.extend(on_threads(NODES[0], row).into_iter().flatten());
        for i in 0..NODES[0] {
            slice.moments.push(slice.mean(i, &Lobe::new(widths(i))));
        }
        slice
    }

    /// Moments of row `i`: Gauss's rule in the root of the cosine, on two halves, and in the stretched azimuth.
    fn mean(&self, i: usize, lobe: &Lobe) -> AlbedoMoments {
        let mut mean = AlbedoMoments::default();
        for half in [0.0, 0.5] {
            for (x, weight) in GAUSS {
                let root = (half + 0.5 * x) as f32;
                let cos = root * root;
                // 2 cos dcos, dcos = 2 root droot.
                let weight = 0.5 * weight as f32 * 4.0 * cos * root;
                let f = (1.0 - cos).powi(5);
                let sin = (1.0 - cos * cos).sqrt();
                let azimuths = 12;
                for k in 0..azimuths {
                    let phi = (k as f32 + 0.5) / azimuths as f32 * std::f32::consts::FRAC_PI_2;
                    let w = Vec3A::new(sin * phi.cos(), sin * phi.sin(), cos);
                    let row = if i + 1 < NODES[0] { (i, 0.0) } else { (i - 1, 1.0) };
                    let albedo = self.at(row, lobe.place(w));
                    let parts: Vec4 = albedo.parts(cos);
                    for (m, factor) in [1.0, cos, f, f * cos, f * cos * cos].into_iter().enumerate() {
                        let factor = factor * weight / azimuths as f32;
                        mean.whole[m] += factor * albedo.e;
                        mean.parts[m] += factor * parts;
                    }
                }
            }
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Never much below an integration with four times the strata, which would gain energy, nor far above.
    #[test]
    fn table_agrees_with_an_integration() {
        let (mut worst, mut lowest) = ((0.0_f32, String::new()), 1.0_f32);
        for anisotropic in [0.1, 0.5, 0.9, 1.0] {
            for roughness in [0.05, 0.2, 0.45, 0.7, 0.9, 1.0] {
                let lobe = Anisotropy::new(roughness, anisotropic);
                let ggx = Ggx::<true>::with_widths(alpha_xy(roughness, anisotropic));
                for cos in [0.005, 0.03, 0.1, 0.3, 0.7, 0.95] {
                    for phi in [0.0_f32, 0.3, 0.8, 1.2, 1.57] {
                        let sin = (1.0_f32 - cos * cos).sqrt();
                        let wo = Vec3A::new(sin * phi.cos(), sin * phi.sin(), cos);
                        let ((e, parts), found) = (integrate_view(&ggx, wo, 1.0, [48, 128]), lobe.at(wo));
                        let error = ((found.e - e) / e).abs().max((found.parts(cos) - parts).abs().max_element());
                        lowest = lowest.min(found.e / e);
                        if error > worst.0 {
                            worst = (error, format!("{anisotropic} {roughness} cos {cos} phi {phi}: {found:?}, {e} {parts}"));
                        }
                    }
                }
            }
        }
        println!("lowest {lowest}, worst: {} {}", worst.0, worst.1);
        assert!(worst.0 < 0.045 && lowest > 0.998, "{lowest} {} {}", worst.0, worst.1);
    }
}
