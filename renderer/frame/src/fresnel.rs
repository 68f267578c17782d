//! Reflectance of dielectrics by Fresnel's equations, and four functions that represent it in tables.
//!
//! The reflectance of unpolarised light is `F(c) = f0 + (1 - f0) W(c)` at the cosine `c` between a direction and the normal of
//! the facet that mirrors it. `f0` is the reflectance at normal incidence, and `W` rises from 0 there to 1 at grazing incidence.
//! Schlick (1994) approximates `W` by `(1 - c)^5` for every index of refraction, which gives 16 to 23 % too little light between
//! 45 and 65 degrees at index 1.5.
//!
//! The mean of `W` over a lobe depends on view, roughness and index. Tables need no third axis: to within 4e-4 each `W`
//! is a combination of the four functions of [`basis`], with coefficients that depend on the index alone
//! ([`Dielectric::coefficients`]), and so is its mean.

use glam::Vec4;
use std::sync::OnceLock;

/// Largest `f0`, at `specular` = 1: an index of refraction of 1.79.
pub const MAX_F0: f32 = 0.08;

/// Smallest `f0` whose reflectance is exact: an index of 1.058, and no solid has less. From here to air `W` fades with the root
/// of `f0`, like the hemispherical mean of the exact reflectance. (The four functions cannot represent its narrower rise at
/// grazing incidence.)
pub const MIN_F0: f32 = 0.0008;

/// `f0` of the last three functions of [`basis`], and the square of their index less 1, `4 sqrt(f0) / (1 - sqrt(f0))^2`.
const BASIS: [[f32; 2]; 3] = [[0.001, 0.134_887_24], [0.008, 0.431_509_6], [0.04, 1.25]];

/// Nodes of the coefficients, even in the fourth root of `f0` from [`MIN_F0`] to [`MAX_F0`], after one for air.
const NODES: usize = 49;
/// Cosines that the coefficients are fitted at.
const FITTED: usize = 400;

/// Schlick's weight `(1 - cos)^5` for `cos` in 0..=1 (Schlick 1994).
#[inline(always)]
pub fn schlick_weight(cos: f32) -> f32 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// Unpolarised reflectance at a cosine 0..=1 from outside a dielectric, the square of whose index is `1 + excess`, `excess` > 0.
#[inline(always)]
fn exact(excess: f32, cos: f32) -> f32 {
    // With g = index * cosine inside: r_s = (g - c) / (g + c), r_p = r_s (c (g + c) - 1) / (c (g - c) + 1) (Cook and Torrance
    // 1982). g - c is excess / (g + c), which does not cancel. One division for both.
    let g = (cos * cos + excess).sqrt();
    let sum = g + cos;
    let (sum2, below) = (sum * sum, cos * (g - cos) + 1.0);
    let inverse = (sum2 * below).recip();
    let s = excess * below * inverse;
    let ratio = (cos * sum - 1.0) * sum2 * inverse;
    0.5 * s * s * (1.0 + ratio * ratio)
}

/// The four functions at a cosine 0..=1: Schlick's weight, and `W` of `f0` = 0.001, 0.008, 0.04.
#[inline]
pub fn basis(cos: f32) -> Vec4 {
    Vec4::from_array(basis_numbers(cos))
}

/// [`basis`] as numbers, for loops over many cosines.
#[inline(always)]
pub fn basis_numbers(cos: f32) -> [f32; 4] {
    let [a, b, c] = BASIS.map(|[f0, excess]| (exact(excess, cos) - f0) / (1.0 - f0));
    [schlick_weight(cos), a, b, c].map(|weight| weight.max(0.0))
}

/// The surface of a dielectric in air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dielectric {
    f0: f32,
    /// Square of the index less 1, and the reflectance at normal incidence that goes with it.
    excess: f32,
    least: f32,
    /// Factor from what the reflectance rises by to `W`.
    scale: f32,
    coefficients: Vec4,
}

impl Dielectric {
    /// Index of refraction 1: no surface at all.
    pub const AIR: Self = Self { f0: 0.0, excess: 1.0, least: 0.0, scale: 0.0, coefficients: Vec4::ZERO };
    /// Index of refraction 1.5: most glass and lacquer, and `specular` = 0.5.
    pub const GLASS: Self = Self { f0: 0.04, excess: 1.25, least: 0.04, scale: 1.0 / 0.96, coefficients: Vec4::W };

    /// The dielectric with this reflectance at normal incidence, clamped to 0..=[`MAX_F0`].
    #[inline]
    pub fn new(f0: f32) -> Self {
        let f0 = f0.clamp(0.0, MAX_F0);
        let (node, share) = place(f0);
        let nodes = nodes();
        let coefficients = nodes[node] + (nodes[node + 1] - nodes[node]) * share;
        let least = f0.max(MIN_F0);
        let root = least.sqrt();
        let scale = if node == 0 { share } else { 1.0 } / (1.0 - least);
        Self { f0, excess: 4.0 * root / ((1.0 - root) * (1.0 - root)), least, scale, coefficients }
    }

    /// Reflectance at normal incidence.
    #[inline(always)]
    pub fn f0(&self) -> f32 {
        self.f0
    }

    /// Reflectance at a cosine 0..=1 from outside.
    #[inline(always)]
    pub fn reflectance(&self, cos: f32) -> f32 {
        self.f0 + (1.0 - self.f0) * self.weight(cos)
    }

    /// `W` of the module's documentation, 0..=1.
    #[inline(always)]
    pub fn weight(&self, cos: f32) -> f32 {
        ((exact(self.excess, cos) - self.least) * self.scale).max(0.0)
    }

    /// Coefficients of the four functions of [`basis`] whose sum is `W`; their own sum is about 1.
    #[inline(always)]
    pub fn coefficients(&self) -> Vec4 {
        self.coefficients
    }

    /// Index of a node of [`nodes`] and share of the next, between which the coefficients lie.
    #[inline]
    pub fn place(&self) -> (usize, f32) {
        place(self.f0)
    }
}

#[inline]
fn place(f0: f32) -> (usize, f32) {
    if f0 < MIN_F0 {
        return (0, (f0 / MIN_F0).sqrt());
    }
    let (low, high) = (MIN_F0.sqrt().sqrt(), MAX_F0.sqrt().sqrt());
    let x = (f0.sqrt().sqrt() - low) / (high - low) * (NODES - 1) as f32;
    let i = (x as usize).min(NODES - 2);
    (i + 1, x - i as f32)
}

/// Coefficients between which those of every dielectric are linear: for air, then even in the fourth root of `f0`.
#[inline]
pub fn nodes() -> &'static [Vec4] {
    static TABLE: OnceLock<Vec<Vec4>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let (low, high) = (MIN_F0.sqrt().sqrt(), MAX_F0.sqrt().sqrt());
        let f0 = |i: usize| (low + (high - low) * i as f32 / (NODES - 1) as f32).powi(4);
        std::iter::once(Vec4::ZERO).chain((0..NODES).map(|i| fit(f0(i)))).collect()
    })
}

/// Coefficients for one `f0` by least squares, over cosines even in their root: dense at grazing incidence.
fn fit(f0: f32) -> Vec4 {
    let root = f0.sqrt();
    let excess = 4.0 * root / ((1.0 - root) * (1.0 - root));
    // Normal equations, the right side as fifth column.
    let mut rows = [[0.0_f64; 5]; 4];
    for i in 0..FITTED {
        let x = (i as f32 + 0.5) / FITTED as f32;
        let cos = x * x;
        let [a, b, c, d] = basis(cos).to_array();
        let wanted = (exact(excess, cos) - f0) / (1.0 - f0);
        let line = [a, b, c, d, wanted].map(f64::from);
        for (row, factor) in rows.iter_mut().zip(line) {
            for (sum, value) in row.iter_mut().zip(line) {
                *sum += factor * value;
            }
        }
    }
    // Gauss's elimination; the matrix is positive definite and needs no pivots.
    for k in 0..4 {
        let pivot = rows[k];
        for (j, row) in rows.iter_mut().enumerate() {
            if j != k {
                let factor = row[k] / pivot[k];
                for (value, above) in row.iter_mut().zip(pivot) {
                    *value -= factor * above;
                }
            }
        }
    }
    Vec4::from_array(std::array::from_fn(|k| (rows[k][4] / rows[k][k]) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest difference of `W` and its combination of four functions, over all cosines and all `f0` in `0..=`[`MAX_F0`].
    const COMBINED_ERROR: f32 = 4e-4;

    /// Snell's law and Fresnel's two equations as they stand in textbooks.
    fn fresnel(index: f64, cos: f64) -> f64 {
        let sin_inside = (1.0 - cos * cos).sqrt() / index;
        let inside = (1.0 - sin_inside * sin_inside).sqrt();
        let s = (cos - index * inside) / (cos + index * inside);
        let p = (index * cos - inside) / (index * cos + inside);
        0.5 * (s * s + p * p)
    }

    /// Dense at grazing incidence, both ends included.
    fn cosines() -> impl Iterator<Item = f32> {
        (0..=500).map(|i| (i as f32 / 500.0).powi(3))
    }

    fn reflectances() -> impl Iterator<Item = f32> {
        (0..=200).map(|i| MIN_F0 + (MAX_F0 - MIN_F0) * (i as f32 / 200.0).powi(3))
    }

    #[test]
    fn reflectance_is_fresnels() {
        let mut worst = 0.0_f64;
        for f0 in reflectances() {
            let dielectric = Dielectric::new(f0);
            let root = f64::from(f0).sqrt();
            let index = (1.0 + root) / (1.0 - root);
            for cos in cosines() {
                let error = (f64::from(dielectric.reflectance(cos)) - fresnel(index, f64::from(cos))).abs();
                worst = worst.max(error);
            }
        }
        println!("worst: {worst:.1e}");
        assert!(worst < 1e-6, "{worst}");
        // Glass: 4 % at normal incidence, 8.9 % at 60 degrees, all at grazing incidence; nothing of p at Brewster's angle.
        let glass = Dielectric::GLASS;
        assert!((glass.reflectance(1.0) - 0.04).abs() < 1e-7);
        assert!((glass.reflectance(0.5) - 0.089_186_7).abs() < 1e-6 && (glass.reflectance(0.0) - 1.0).abs() < 1e-6);
        let brewster = (1.0 / (1.0 + 1.5_f32 * 1.5)).sqrt();
        assert!((glass.reflectance(brewster) - 0.5 * (1.25_f32 / 3.25).powi(2)).abs() < 1e-6);
        let made = Dielectric::new(0.04);
        assert!(cosines().all(|cos| (made.reflectance(cos) - glass.reflectance(cos)).abs() < 1e-6));
        assert!((made.coefficients() - glass.coefficients()).abs().max_element() < 0.01, "{}", made.coefficients());
    }

    #[test]
    fn four_functions_make_every_dielectric() {
        let mut worst = (0.0_f32, 0.0, 0.0);
        for f0 in reflectances().chain((0..=20).map(|i| MIN_F0 * i as f32 / 20.0)) {
            let dielectric = Dielectric::new(f0);
            for cos in cosines() {
                let error = (dielectric.coefficients().dot(basis(cos)) - dielectric.weight(cos)).abs();
                if error > worst.0 {
                    worst = (error, f0, cos);
                }
            }
            if f0 >= MIN_F0 {
                assert!((dielectric.coefficients().element_sum() - 1.0).abs() < 1e-3, "{f0}: {}", dielectric.coefficients());
                assert!(dielectric.coefficients().abs().max_element() < 1.5, "{f0}: {}", dielectric.coefficients());
            }
        }
        println!("worst: {worst:?}");
        assert!(worst.0 < COMBINED_ERROR, "{worst:?}");
    }

    /// From the least exact one down to air, which reflects nothing.
    #[test]
    fn reflectance_is_continuous_down_to_air() {
        let air = Dielectric::new(0.0);
        assert!(air.coefficients() == Vec4::ZERO);
        assert!(cosines().all(|cos| air.reflectance(cos) == 0.0 && Dielectric::AIR.reflectance(cos) == 0.0));
        let mut last = air;
        // Even in the root of f0, in which the fade is linear.
        for i in 1..=2000 {
            let next = Dielectric::new(2.0 * MIN_F0 * (i as f32 / 2000.0).powi(2));
            for cos in cosines() {
                let step = next.reflectance(cos) - last.reflectance(cos);
                assert!((-1e-6..1.5e-3).contains(&step), "{step} at {} {cos}", next.f0());
            }
            let step = (next.coefficients() - last.coefficients()).abs().max_element();
            assert!(step < 3e-3, "{step} at {}", next.f0());
            last = next;
        }
    }

    #[test]
    fn values_stay_in_range_beyond_it() {
        for f0 in [-1.0, 0.0, f32::MIN_POSITIVE, 1e-20, 1e-9, 5e-5, MIN_F0, 0.02, MAX_F0, 0.5, f32::INFINITY] {
            let dielectric = Dielectric::new(f0);
            let mut last = 1.0 + 1e-6;
            for cos in cosines() {
                let reflectance = dielectric.reflectance(cos);
                assert!((0.0..=1.000_001).contains(&reflectance), "{f0} {cos}: {reflectance}");
                // It never rises with the cosine.
                assert!(reflectance <= last + 1e-6, "{f0} {cos}: {reflectance} after {last}");
                last = reflectance;
            }
            assert!((dielectric.reflectance(1.0) - f0.clamp(0.0, MAX_F0)).abs() < 1e-6);
        }
        assert_eq!(Dielectric::new(1.0), Dielectric::new(MAX_F0));
        assert!(Dielectric::new(f32::NAN).reflectance(0.5).is_nan());
    }
}
