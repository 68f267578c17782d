//! Directional albedo of the anisotropic GGX lobe: the isotropic one of the width that the lobe shows towards the viewer, plus a
//! tabulated rest.
//!
//! Smith's masking of `wo` depends on that projected width alone; only the shadowing of `wi` sees the other axis. The rest is small
//! and smooth, and is 0 without anisotropy.

use super::albedo::{Albedo, AlbedoMoments, Row, integrate_view};
use super::ggx::{Ggx, alpha_xy};
use glam::Vec3A;
use std::sync::OnceLock;

/// Nodes along anisotropy, fourth root of the roughness, azimuth (`sin^2`), and the rows' abscissa.
const NODES: [usize; 4] = [6, 12, 6, 14];
/// Strata of the integration, over a whole turn.
const STRATA: [usize; 2] = [24, 32];

/// The albedo of one anisotropic lobe, for every view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anisotropy {
    alpha2: [f32; 2],
    /// Position on the table's first two axes.
    anisotropic: f32,
    root: f32,
}

/// Index of the lower node and share of the upper one on an axis of `nodes`; `x` in 0..=1.
#[inline]
fn node(x: f32, nodes: usize) -> (usize, f32) {
    let x = x.clamp(0.0, 1.0) * (nodes - 1) as f32;
    let i = (x as usize).min(nodes - 2);
    (i, x - i as f32)
}

fn fraction(i: usize, nodes: usize) -> f32 {
    i as f32 / (nodes - 1) as f32
}

impl Anisotropy {
    /// Both in 0..=1.
    pub fn new(roughness: f32, anisotropic: f32) -> Self {
        let root = (roughness.sqrt().sqrt() - Self::LOWEST_ROOT) / (1.0 - Self::LOWEST_ROOT);
        Self { alpha2: alpha_xy(roughness, anisotropic).map(|a| a * a), anisotropic, root: root.max(0.0) }
    }

    /// A roughness of 0.03 as fourth root: smoother lobes differ from it at the horizon alone.
    const LOWEST_ROOT: f32 = 0.42;

    /// `sin^2` of the azimuth; any value at the pole, where all agree.
    #[inline]
    fn across(w: Vec3A) -> f32 {
        let (x2, y2) = (w.x * w.x, w.y * w.y);
        if x2 + y2 > 0.0 { y2 / (x2 + y2) } else { 0.0 }
    }

    /// The isotropic row of the width seen from an azimuth.
    #[inline]
    fn row(&self, across: f32) -> Row {
        let alpha2 = self.alpha2[0] + (self.alpha2[1] - self.alpha2[0]) * across;
        Row::new(alpha2.sqrt().sqrt())
    }

    /// Albedo for a unit direction on or above the horizon.
    pub fn at(&self, w: Vec3A) -> Albedo {
        static TABLE: OnceLock<Vec<Albedo>> = OnceLock::new();
        let table = TABLE.get_or_init(table);
        let across = Self::across(w);
        let row = self.row(across);
        let isotropic = row.at(w.z);
        let axes = [
            node(self.anisotropic, NODES[0]),
            node(self.root, NODES[1]),
            node(across, NODES[2]),
            node(row.position(w.z), NODES[3]),
        ];
        let mut rest = Albedo::default();
        for corner in 0..16_usize {
            let (mut index, mut weight) = (0, 1.0);
            for (k, (i, t)) in axes.into_iter().enumerate() {
                let upper = (corner >> k) & 1;
                index = index * NODES[k] + i + upper;
                weight *= if upper == 1 { t } else { 1.0 - t };
            }
            rest.e += weight * table[index].e;
            rest.b += weight * table[index].b;
        }
        let e = (isotropic.e + rest.e).clamp(0.0, 1.0);
        Albedo { e, b: (isotropic.b + rest.b).clamp(0.0, e) }
    }

    /// Means over the hemisphere: over eight azimuths those of the isotropic rows.
    pub fn moments(&self) -> AlbedoMoments {
        let mut mean = AlbedoMoments::default();
        for i in 0..8 {
            let phi = (i as f32 + 0.5) / 8.0 * std::f32::consts::FRAC_PI_2;
            mean = mean.lerp(&self.row(phi.sin().powi(2)).moments(), 1.0 / (i + 1) as f32);
        }
        mean
    }
}

/// The rests at all nodes, in the order of [`NODES`]. One thread, see [`super::albedo`].
fn table() -> Vec<Albedo> {
    let mut rests = Vec::with_capacity(NODES.iter().product());
    for i in 0..NODES[0] {
        let anisotropic = fraction(i, NODES[0]);
        for j in 0..NODES[1] {
            let root = Anisotropy::LOWEST_ROOT + (1.0 - Anisotropy::LOWEST_ROOT) * fraction(j, NODES[1]);
            let lobe = Anisotropy::new(root.powi(4), anisotropic);
            let ggx = Ggx::<true>::with_widths(lobe.alpha2.map(f32::sqrt));
            for k in 0..NODES[2] {
                let across = fraction(k, NODES[2]);
                let row = lobe.row(across);
                for l in 0..NODES[3] {
                    let cos = row.cosine(fraction(l, NODES[3])).clamp(1e-6, 1.0);
                    let sin = (1.0 - cos * cos).sqrt();
                    let wo = Vec3A::new(sin * (1.0 - across).sqrt(), sin * across.sqrt(), cos);
                    let rest = if i == 0 {
                        Albedo::default()
                    } else {
                        let (whole, isotropic) = (integrate_view(&ggx, wo, 1.0, STRATA), row.at(cos));
                        Albedo { e: whole.e - isotropic.e, b: whole.b - isotropic.b }
                    };
                    rests.push(rest);
                }
            }
        }
    }
    rests
}
