//! Pearson's chi-square test of a sampler against the density it claims.
//!
//! One experiment is a [`Counts`]: draws counted in cells, and the counts that the claimed density expects there. [`judge`]
//! decides over any number of them together, at a significance of 1 % in all (Sidak 1967). [`DirectionGrid`] makes cells of
//! directions and integrates a density over them. The draws should come from [`Random`], which has nothing in common with the
//! samplers under test.
//!
//! ```
//! use renderflow_renderer::verify::chi_square::{Counts, Random, judge};
//!
//! let mut random = Random::new(1);
//! let mut fair = Counts::uniform("a die", 6);
//! (0..6000).for_each(|_| fair.add((6.0 * random.next()) as usize));
//! assert!(judge("dice", &[fair]).passed);
//! ```

use super::Outcome;
pub use crate::random::Random;
use glam::DVec3;

/// Probability of refuting any of all true claims.
const SIGNIFICANCE: f64 = 0.01;

/// Cells expected to hold fewer draws than this are pooled.
const SMALLEST_CELL: f64 = 5.0;

/// Halvings of a cell that the integration of a density may use.
const DEPTH: u32 = 8;

/// Observed and expected counts of one experiment, cell by cell.
#[derive(Clone, Debug)]
pub struct Counts {
    /// What was drawn, for messages.
    pub name: String,
    /// Draws found in each cell.
    pub observed: Vec<f64>,
    /// Draws expected in each cell, >= 0, up to a common factor: only the shares count.
    pub expected: Vec<f64>,
}

impl Counts {
    /// No draws yet, from cells that hold the shares `expected` (integrals of the density, up to a common factor).
    pub fn new(name: impl Into<String>, expected: Vec<f64>) -> Self {
        Self { name: name.into(), observed: vec![0.0; expected.len()], expected }
    }

    /// No draws yet, from `cells` equally likely cells.
    pub fn uniform(name: impl Into<String>, cells: usize) -> Self {
        Self::new(name, vec![1.0; cells])
    }

    /// Counts a draw in `cell`.
    ///
    /// # Panics
    /// When there is no such cell.
    pub fn add(&mut self, cell: usize) {
        self.observed[cell] += 1.0;
    }

    /// Number of draws.
    pub fn draws(&self) -> f64 {
        self.observed.iter().sum()
    }

    /// Expected and observed number of draws, cell by cell.
    fn cells(&self) -> impl Iterator<Item = (f64, f64)> {
        let total: f64 = self.expected.iter().sum();
        let factor = if total > 0.0 { self.draws() / total } else { 0.0 };
        self.expected.iter().map(move |e| e * factor).zip(self.observed.iter().copied())
    }

    /// Probability of a deviation at least this large if the claim is true; 0 for expectations that are no numbers.
    pub fn p_value(&self) -> f64 {
        if self.expected.len() != self.observed.len() || !self.expected.iter().all(|e| e.is_finite() && *e >= 0.0) {
            return 0.0;
        }
        let mut cells: Vec<(f64, f64)> = self.cells().collect();
        cells.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut statistic, mut used) = (0.0, 0_u32);
        let (mut pooled_expected, mut pooled_observed) = (0.0, 0.0);
        for (expected, observed) in cells {
            if expected + pooled_expected < SMALLEST_CELL || (expected < SMALLEST_CELL && pooled_expected > 0.0) {
                pooled_expected += expected;
                pooled_observed += observed;
            } else {
                statistic += (observed - expected) * (observed - expected) / expected;
                used += 1;
            }
        }
        if pooled_expected > 0.0 {
            // Draws where the density is zero refute it, however few.
            if pooled_observed > 20.0 + 100.0 * pooled_expected {
                return 0.0;
            }
            if pooled_expected >= SMALLEST_CELL {
                statistic += (pooled_observed - pooled_expected).powi(2) / pooled_expected;
                used += 1;
            }
        } else if pooled_observed > 20.0 {
            return 0.0;
        }
        if used < 2 { 1.0 } else { upper_gamma(0.5 * f64::from(used - 1), 0.5 * statistic) }
    }

    /// The three cells that deviate most, for messages.
    fn worst_cells(&self) -> String {
        let deviation = |&(_, (e, o)): &(usize, (f64, f64))| (o - e).powi(2) / e.max(1.0);
        let mut cells: Vec<_> = self.cells().enumerate().collect();
        cells.sort_by(|a, b| deviation(b).total_cmp(&deviation(a)));
        let describe = |(i, (expected, observed)): &(usize, (f64, f64))| format!("cell {i} holds {observed} of {expected:.2}");
        cells.iter().take(3).map(describe).collect::<Vec<_>>().join(", ")
    }
}

/// Smallest p that a single one of `experiments` may have, so that all true claims pass together with a probability of 99 %
/// (Sidak 1967).
pub fn threshold(experiments: usize) -> f64 {
    -((-SIGNIFICANCE).ln_1p() / experiments.max(1) as f64).exp_m1()
}

/// Judges all experiments together: `worst` is the smallest p, `limit` the [`threshold`], and `detail` names what was refuted, or
/// else what came closest to it.
pub fn judge(name: impl Into<String>, experiments: &[Counts]) -> Outcome {
    let limit = threshold(experiments.len());
    let mut ranked: Vec<(f64, &Counts)> = experiments.iter().map(|counts| (counts.p_value(), counts)).collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let describe = |(p, counts): &(f64, &Counts)| format!("{}: p = {p:.2e}; {}", counts.name, counts.worst_cells());
    let refuted = ranked.iter().take_while(|(p, _)| *p < limit).count();
    let told: Vec<String> = ranked.iter().take(refuted.clamp(1, 10)).map(describe).collect();
    let draws: f64 = experiments.iter().map(Counts::draws).sum();
    let worst = ranked.first().map_or(1.0, |(p, _)| *p);
    Outcome::at_least(name, draws as u64, worst, limit, told.join("\n"))
}

/// A grid of directions around an axis, finer towards it: rows are even in `ln(1 + w / spread)`, where `w = 1 - cos` of the angle
/// from the axis. A large `spread` gives cells of equal solid angle.
#[derive(Clone, Debug)]
pub struct DirectionGrid {
    axis: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    spread: f64,
    rows: usize,
    columns: usize,
}

impl DirectionGrid {
    /// A grid of `rows` times `columns` cells around `axis`; `spread` > 0.
    pub fn new(axis: DVec3, spread: f64, rows: usize, columns: usize) -> Self {
        let axis = axis.normalize();
        let (tangent, bitangent) = axis.any_orthonormal_pair();
        Self { axis, tangent, bitangent, spread, rows, columns }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.rows * self.columns
    }

    /// The cell a direction falls into.
    pub fn cell(&self, direction: DVec3) -> usize {
        // 1 - cos from the difference: the cosine of a single-precision direction would not resolve small angles.
        let w = 0.5 * (direction - self.axis).length_squared();
        let x = (w / self.spread).ln_1p() / (2.0 / self.spread).ln_1p();
        let y = direction.dot(self.bitangent).atan2(direction.dot(self.tangent)) / std::f64::consts::TAU;
        let row = ((x * self.rows as f64) as usize).min(self.rows - 1);
        let column = (((y - y.floor()) * self.columns as f64) as usize).min(self.columns - 1);
        row * self.columns + column
    }

    /// Integral of `density` over each cell.
    pub fn integrate(&self, density: &dyn Fn(DVec3) -> f64) -> Vec<f64> {
        let integrand = |x: f64, y: f64| {
            let range = (2.0 / self.spread).ln_1p();
            let w = self.spread * (x * range).exp_m1();
            let sin = (w * (2.0 - w)).max(0.0).sqrt();
            let (sin_phi, cos_phi) = (std::f64::consts::TAU * y).sin_cos();
            let direction = self.axis * (1.0 - w) + self.tangent * (sin * cos_phi) + self.bitangent * (sin * sin_phi);
            density(direction) * std::f64::consts::TAU * range * (w + self.spread)
        };
        let (h, k) = (1.0 / self.rows as f64, 1.0 / self.columns as f64);
        (0..self.cells())
            .map(|i| {
                let (x, y) = ((i / self.columns) as f64 * h, (i % self.columns) as f64 * k);
                adaptive(&integrand, [x, y], [h, k], DEPTH)
            })
            .collect()
    }
}

/// Cubature over a rectangle: three-point Gauss rules, halved where a refinement changes the value.
fn adaptive(f: &dyn Fn(f64, f64) -> f64, [x, y]: [f64; 2], [h, k]: [f64; 2], depth: u32) -> f64 {
    let whole = gauss(f, [x, y], [h, k]);
    let (h2, k2) = (0.5 * h, 0.5 * k);
    let corners = [[x, y], [x + h2, y], [x, y + k2], [x + h2, y + k2]];
    let parts: f64 = corners.iter().map(|&corner| gauss(f, corner, [h2, k2])).sum();
    // A density that begins inside the rectangle can miss all nodes of the first rules.
    let fine = depth + 2 <= DEPTH && (whole - parts).abs() < 1e-4 * parts.abs() + 1e-8;
    if depth == 0 || fine {
        return parts;
    }
    corners.iter().map(|&corner| adaptive(f, corner, [h2, k2], depth - 1)).sum()
}

fn gauss(f: &dyn Fn(f64, f64) -> f64, [x, y]: [f64; 2], [h, k]: [f64; 2]) -> f64 {
    let nodes = [(0.5 - 0.15_f64.sqrt(), 5.0 / 18.0), (0.5, 4.0 / 9.0), (0.5 + 0.15_f64.sqrt(), 5.0 / 18.0)];
    let mut sum = 0.0;
    for (a, wa) in nodes {
        for (b, wb) in nodes {
            sum += wa * wb * f(x + a * h, y + b * k);
        }
    }
    sum * h * k
}

/// Regularised upper incomplete gamma function Q(a, x): series below `a + 1`, Lentz's continued fraction above
/// (Abramowitz and Stegun 6.5.29 and 6.5.31).
pub fn upper_gamma(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let scale = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        while term > sum * 1e-16 {
            n += 1.0;
            term *= x / n;
            sum += term;
        }
        return 1.0 - scale * sum;
    }
    let mut b = x + 1.0 - a;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut value = d;
    for i in 1..10_000 {
        let i = f64::from(i);
        let an = -i * (i - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        value *= d * c;
        if (d * c - 1.0).abs() < 1e-15 {
            break;
        }
    }
    scale * value
}

/// Logarithm of the gamma function by Stirling's series, shifted to where it is accurate.
fn ln_gamma(a: f64) -> f64 {
    let (mut x, mut shift) = (a, 0.0);
    while x < 10.0 {
        shift += x.ln();
        x += 1.0;
    }
    let r = 1.0 / (x * x);
    let series = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r / 1680.0))) / x;
    (x - 0.5) * x.ln() - x + 0.5 * std::f64::consts::TAU.ln() + series - shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incomplete_gamma_agrees_with_scipy() {
        // scipy.special.gammaincc of SciPy 1.17.1.
        for (a, x, q) in [
            (0.5, 0.5, 0.317_310_507_862_911_15),
            (10.0, 12.0, 0.242_392_161_670_512_47),
            (100.0, 80.0, 0.982_891_686_964_866_8),
            (250.0, 300.0, 0.001_377_471_877_528_201),
        ] {
            let computed = upper_gamma(a, x);
            assert!((computed - q).abs() < 1e-9 * q.max(1e-3), "Q({a}, {x}) = {computed}, not {q}");
        }
    }
}
