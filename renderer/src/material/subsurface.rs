//! Burley's diffuse approximation of subsurface scattering (2012, after Hanrahan and Krueger 1993), relative to a Lambertian lobe.

use super::albedo::{COSINES, ROUGHNESSES, Row, Table, quadrature};
use std::sync::OnceLock;

/// Roughness of the first row of the albedo's table, `MIN_ALPHA^(1/2)`. The conserving form takes a smoother base as this rough, so
/// that shape and table agree.
pub(super) const MIN_ROUGHNESS: f32 = 0.031_622_78;

/// `ss` of Burley's code: `1.25 (Fss (1 / (cos_i + cos_o) - 0.5) + 0.5)`, for Schlick weights `fo`, `fi` and `dot` = `wo . wi`.
#[inline]
pub(super) fn shape(roughness: f32, fo: f32, fi: f32, cos_o: f32, cos_i: f32, dot: f32) -> f32 {
    // At both directions on the horizon 1 / 0: cosines are at least the smallest that the formula's square resolves.
    let sum = (cos_o + cos_i).max(1e-12);
    let f90 = 0.5 * roughness * (1.0 + dot).max(0.0);
    let fss = (1.0 + (f90 - 1.0) * fi) * (1.0 + (f90 - 1.0) * fo);
    1.25 * (fss * (sum.recip() - 0.5) + 0.5)
}

/// Mean of [`shape`] over the azimuth: `Fss` is a square in `wo . wi`.
fn mean_shape(roughness: f64, cos_o: f64, cos_i: f64) -> f64 {
    let (fo, fi) = ((1.0 - cos_o).powi(5), (1.0 - cos_i).powi(5));
    let along = 1.0 + cos_o * cos_i;
    let across = 0.5 * (1.0 - cos_o * cos_o) * (1.0 - cos_i * cos_i);
    let x = 0.5 * roughness * along;
    let x2 = 0.25 * roughness * roughness * (along * along + across);
    // (1 - fi + x fi)(1 - fo + x fo)
    let fss = (1.0 - fi) * (1.0 - fo) + x * (fi * (1.0 - fo) + fo * (1.0 - fi)) + x2 * fi * fo;
    1.25 * (fss * (1.0 / (cos_o + cos_i).max(1e-12) - 0.5) + 0.5)
}

/// What a shape needs to know about the coat above it.
#[derive(Clone, Copy)]
pub(super) struct Coat {
    /// The row of the base's roughness.
    pub row: Row,
    /// Reflectances of the coat; both 0 without one.
    pub f0: f32,
    /// At grazing incidence.
    pub f90: f32,
}

/// `integral of k(wi) (s - 1) cos / pi dwi` for `k` = 1, `e - b`, `b` (see [`super::albedo`]).
type Integrals = [f32; 3];

/// Reflectances `(f0, f90)` at which maxima are stored. The integral is affine in both, so its maximum over views is convex, and
/// between two of these points, where `f90(f0)` is affine, the chord bounds it from above.
const COATS: [[f32; 2]; 4] = [[0.0, 0.0], [0.02, 1.0], [0.08, 1.0], [1.0, 1.0]];

struct Shapes {
    nodes: Vec<[Integrals; COSINES]>,
    /// Cosine-weighted means of the products of the integrals with 1, `e - b`, `b`.
    products: Vec<[Integrals; 3]>,
    /// Maxima over views at [`COATS`].
    maxima: Vec<[f32; 4]>,
}

impl Shapes {
    fn get() -> &'static Self {
        static SHAPES: OnceLock<Shapes> = OnceLock::new();
        SHAPES.get_or_init(|| {
            let mut shapes = Self { nodes: vec![], products: vec![], maxima: vec![] };
            for i in 0..ROUGHNESSES {
                shapes.push(i);
            }
            shapes
        })
    }

    fn push(&mut self, index: usize) {
        let table = Table::get();
        let (cosines, abscissa) = (&table.cosines[index], table.abscissa(index));
        let roughness = f64::from(table.roughness(index));
        let nodes: [Integrals; COSINES] = std::array::from_fn(|j| {
            let mut sums = [0.0_f64; 3];
            quadrature(cosines, abscissa, |i, s, cos, weight| {
                let albedo = table.value(index, i, s, cos as f32);
                let excess = weight * (mean_shape(roughness, f64::from(cosines[j]), cos) - 1.0);
                for (sum, k) in sums.iter_mut().zip([1.0, albedo.e - albedo.b, albedo.b]) {
                    *sum += excess * f64::from(k);
                }
            });
            sums.map(|v| v as f32)
        });
        let mut products = [[0.0_f64; 3]; 3];
        quadrature(cosines, abscissa, |i, s, cos, weight| {
            let albedo = table.value(index, i, s, cos as f32);
            for (product, k) in products.iter_mut().zip([1.0, albedo.e - albedo.b, albedo.b]) {
                for (m, value) in product.iter_mut().enumerate() {
                    *value += weight * f64::from(k * (nodes[i][m] + (nodes[i + 1][m] - nodes[i][m]) * s));
                }
            }
        });
        let combine = |v: &Integrals, [f0, f90]: [f32; 2]| v[0] - f0 * v[1] - f90 * v[2];
        self.maxima.push(COATS.map(|coat| nodes.iter().map(|node| combine(node, coat)).fold(f32::MIN, f32::max)));
        self.products.push(products.map(|product| product.map(|v| v as f32)));
        self.nodes.push(nodes);
    }
}

/// The subsurface part of a diffuse lobe under a coat, its share applied.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    coat: Coat,
    share: f32,
    max: f32,
    mean: f32,
}

impl Shape {
    /// `share` in 0..=1.
    pub fn new(coat: Coat, share: f32) -> Self {
        let shapes = Shapes::get();
        let (i, t) = coat.row.rows();
        let segment = COATS.windows(2).position(|pair| coat.f0 <= pair[1][0]).unwrap_or(COATS.len() - 2);
        let (low, high) = (COATS[segment][0], COATS[segment + 1][0]);
        let x = ((coat.f0 - low) / (high - low)).clamp(0.0, 1.0);
        let bound = |maxima: &[f32; 4]| maxima[segment] + (maxima[segment + 1] - maxima[segment]) * x;
        let max = bound(&shapes.maxima[i]) * (1.0 - t) + bound(&shapes.maxima[i + 1]) * t;
        let factors = [1.0, -coat.f0, -coat.f90];
        let mut mean = 0.0;
        for (j, a) in factors.into_iter().enumerate() {
            for (k, b) in factors.into_iter().enumerate() {
                let (low, high) = (shapes.products[i][j][k], shapes.products[i + 1][j][k]);
                mean += a * b * (low + (high - low) * t);
            }
        }
        Self { coat, share, max, mean }
    }

    /// Largest value of the integral over views.
    #[inline]
    pub fn max(&self) -> f32 {
        self.share * self.max
    }

    /// Mean of `T` times [`Self::deficit`], given the mean of `T`.
    #[inline]
    pub fn mean(&self, transmitted: f32) -> f32 {
        self.share * (self.max * transmitted - self.mean).max(0.0)
    }

    /// How far the integral lies below its maximum.
    #[inline]
    pub fn deficit(&self, cos: f32) -> f32 {
        let (i, s) = self.coat.row.locate(cos);
        let (j, t) = self.coat.row.rows();
        let nodes = &Shapes::get().nodes;
        let mut value = 0.0;
        for (k, factor) in [1.0, -self.coat.f0, -self.coat.f90].into_iter().enumerate() {
            let along = |row: &[Integrals; COSINES]| row[i][k] + (row[i + 1][k] - row[i][k]) * s;
            let (low, high) = (along(&nodes[j]), along(&nodes[j + 1]));
            value += factor * (low + (high - low) * t);
        }
        self.share * (self.max - value).max(0.0)
    }
}
