//! Burley's diffuse approximation of subsurface scattering (2012, after Hanrahan and Krueger 1993), relative to a Lambertian
//! lobe.

use super::albedo::{Albedo, COSINES, ROUGHNESSES, Row, Table, quadrature};
use renderflow_frame::fresnel::{self, Dielectric};
use std::sync::OnceLock;

/// Roughness of the first row of the albedo's table, `MIN_ALPHA^(1/2)`. The conserving form takes a smoother base as this rough,
/// so that shape and table agree.
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
    /// Reflectance of the coat at normal incidence, tinted, 0..=1; 0 without one.
    pub f0: f32,
    /// Its surface without the tint.
    pub surface: Dielectric,
}

impl Coat {
    /// Factors of [`columns`] in what the coat lets through.
    #[inline]
    fn factors(&self) -> Integrals {
        factors(self.f0, self.surface.coefficients().to_array())
    }
}

/// `integral of k(wi) (s - 1) cos / pi dwi` for the `k` of [`columns`].
type Integrals = [f32; 6];

/// 1, `e` and the four `b` of an albedo (see [`super::albedo`]).
fn columns(albedo: &Albedo, cos: f32) -> Integrals {
    let [a, b, c, d] = albedo.parts(cos).to_array();
    [1.0, albedo.e, a, b, c, d]
}

/// What a coat lets through is the sum of [`columns`] times these, for its `f0` and the coefficients of its surface.
#[inline]
fn factors(f0: f32, [a, b, c, d]: [f32; 4]) -> Integrals {
    let rise = f0 - 1.0;
    [1.0, -f0, rise * a, rise * b, rise * c, rise * d]
}

/// Reflectances `f0` at which maxima are stored, for each of the surfaces of [`fresnel::nodes`]. The integral is affine in `f0`,
/// and in the surface between two nodes; so its maximum over views is convex along both, and the chords bound it from above.
const COATS: [f32; 3] = [0.0, fresnel::MAX_F0, 1.0];

struct Shapes {
    nodes: Vec<[Integrals; COSINES]>,
    /// Cosine-weighted means of the products of the integrals with [`columns`].
    products: Vec<[Integrals; 6]>,
    /// Maxima over views, for each surface at [`COATS`].
    maxima: Vec<Vec<[f32; 3]>>,
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
        // The same for every view.
        let mut points = Vec::new();
        quadrature(cosines, abscissa, |i, s, cos, _| points.push(columns(&table.value(index, i, s), cos as f32)));
        let nodes: [Integrals; COSINES] = std::array::from_fn(|j| {
            let mut sums = [0.0_f64; 6];
            let mut points = points.iter();
            quadrature(cosines, abscissa, |_, _, cos, weight| {
                let excess = weight * (mean_shape(roughness, f64::from(cosines[j]), cos) - 1.0);
                for (sum, k) in sums.iter_mut().zip(points.next().into_iter().flatten()) {
                    *sum += excess * f64::from(*k);
                }
            });
            sums.map(|v| v as f32)
        });
        let mut products = [[0.0_f64; 6]; 6];
        let mut points = points.iter();
        quadrature(cosines, abscissa, |i, s, _, weight| {
            for (product, k) in products.iter_mut().zip(points.next().into_iter().flatten()) {
                for (m, value) in product.iter_mut().enumerate() {
                    *value += weight * f64::from(k * (nodes[i][m] + (nodes[i + 1][m] - nodes[i][m]) * s));
                }
            }
        });
        let maximum = |factors: Integrals| nodes.iter().map(|node| dot(node, &factors)).fold(f32::MIN, f32::max);
        let maxima = |surface: &glam::Vec4| COATS.map(|f0| maximum(factors(f0, surface.to_array())));
        self.maxima.push(fresnel::nodes().iter().map(maxima).collect());
        self.products.push(products.map(|product| product.map(|v| v as f32)));
        self.nodes.push(nodes);
    }
}

#[inline]
fn dot(a: &Integrals, b: &Integrals) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The subsurface part of a diffuse lobe under a coat, its share applied.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    row: Row,
    factors: Integrals,
    share: f32,
    max: f32,
    mean: f32,
}

impl Shape {
    /// `share` in 0..=1.
    pub fn new(coat: Coat, share: f32) -> Self {
        let shapes = Shapes::get();
        let (i, t) = coat.row.rows();
        let segment = usize::from(coat.f0 > COATS[1]);
        let x = ((coat.f0 - COATS[segment]) / (COATS[segment + 1] - COATS[segment])).clamp(0.0, 1.0);
        let (node, s) = coat.surface.place();
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let bound = |maxima: &[[f32; 3]]| {
            let along = |maxima: &[f32; 3]| lerp(maxima[segment], maxima[segment + 1], x);
            lerp(along(&maxima[node]), along(&maxima[node + 1]), s)
        };
        let max = lerp(bound(&shapes.maxima[i]), bound(&shapes.maxima[i + 1]), t);
        let factors = coat.factors();
        let mean_of = |products: &[Integrals; 6]| dot(&factors, &std::array::from_fn(|j| dot(&products[j], &factors)));
        let mean = lerp(mean_of(&shapes.products[i]), mean_of(&shapes.products[i + 1]), t);
        Self { row: coat.row, factors, share, max, mean }
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
        let (i, s) = self.row.locate(cos);
        let (j, t) = self.row.rows();
        let nodes = &Shapes::get().nodes;
        let along = |row: &[Integrals; COSINES]| {
            let (low, high) = (dot(&row[i], &self.factors), dot(&row[i + 1], &self.factors));
            low + (high - low) * s
        };
        let (low, high) = (along(&nodes[j]), along(&nodes[j + 1]));
        self.share * (self.max - low - (high - low) * t).max(0.0)
    }
}
