//! Piecewise-constant distributions drawn by inverting their cumulative sums.
//!
//! An alias table would draw in constant time, but it scatters neighbouring random numbers over the whole domain. Inversion is
//! monotone, so the stratification of a low-discrepancy sequence survives. The guide table (Chen and Asau 1974) brings the
//! search down to a look at a few entries.

use crate::number::whole;
use rayon::prelude::*;

/// Columns that share an entry of the guide table: fewer made draws no faster.
const SHARED: usize = 2;
/// Entries that are looked at in one go, without a branch. All that an entry of the guide leads to are among them, most often.
const AHEAD: usize = 4;

/// Rows of cells with a discrete distribution over rows and, within each, over columns.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    columns: usize,
    rows: Discrete,
    /// Tables of a row after those of another, as in [`Discrete`]; rows of weight zero are meaningless and never used.
    cumulative: Vec<f32>,
    guide: Vec<u32>,
}

/// A cell drawn from a [`Grid`], with what is left of the random numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub column: usize,
    pub row: usize,
    /// Uniform in 0..1 given the cell.
    pub u: [f32; 2],
}

impl Grid {
    /// `fill(row, weights)` gives the weights of the cells of a row, finite and >= 0; it is called from rayon's threads. `None`
    /// when all are zero. Also returns their sum.
    pub fn new(columns: usize, rows: usize, fill: impl Fn(usize, &mut [f64]) + Sync) -> Option<(Self, f64)> {
        let [steps, slots] = sizes(columns);
        let mut cumulative = vec![0.0; steps * rows];
        let mut guide = vec![0; slots * rows];
        let tables = cumulative.par_chunks_exact_mut(steps).zip(guide.par_chunks_exact_mut(slots)).enumerate();
        let sums: Vec<f64> = tables
            .map_init(
                || vec![0.0; columns],
                |weights, (row, (cumulative, guide))| {
                    fill(row, weights);
                    tabulate(weights, cumulative, guide)
                },
            )
            .collect();
        let total = sums.iter().sum();
        Some((Self { columns, rows: Discrete::new(&sums)?, cumulative, guide }, total))
    }

    /// Draws a cell; never one of weight zero.
    #[inline(always)]
    pub fn sample(&self, u: [f32; 2]) -> Cell {
        let (row, v) = self.rows.sample(u[1]);
        let [steps, slots] = sizes(self.columns);
        let cumulative = &self.cumulative[row * steps..(row + 1) * steps];
        let guide = &self.guide[row * slots..(row + 1) * slots];
        let (column, u) = invert(cumulative, guide, u[0]);
        Cell { column, row, u: [u, v] }
    }
}

/// A distribution over `0..n`.
#[derive(Clone, Debug)]
struct Discrete {
    /// `cumulative[i]` = probability of an index below i; 1 beyond the last possible index, to the end.
    cumulative: Vec<f32>,
    /// `guide[k]` = first index `i` with `cumulative[i + 1]` beyond `k / guide.len()`, roundings allowed for.
    guide: Vec<u32>,
}

impl Discrete {
    fn new(weights: &[f64]) -> Option<Self> {
        let [steps, slots] = sizes(weights.len());
        let (mut cumulative, mut guide) = (vec![0.0; steps], vec![0; slots]);
        (tabulate(weights, &mut cumulative, &mut guide) > 0.0).then_some(Self { cumulative, guide })
    }

    #[inline(always)]
    fn sample(&self, u: f32) -> (usize, f32) {
        invert(&self.cumulative, &self.guide, u)
    }
}

/// Lengths of the tables of a distribution over `0..n`: the cumulative one with what may be read beyond its end, and the guide.
#[inline(always)]
fn sizes(n: usize) -> [usize; 2] {
    [n + AHEAD, n.div_ceil(SHARED)]
}

/// Fills the tables of a [`Discrete`]; returns the sum of the weights. Where it is zero the tables are left as they are.
fn tabulate(weights: &[f64], cumulative: &mut [f32], guide: &mut [u32]) -> f64 {
    let total: f64 = weights.iter().sum();
    let Some(last) = weights.iter().rposition(|&w| w > 0.0) else { return 0.0 };
    let mut sum = 0.0;
    for (c, w) in cumulative[1..].iter_mut().zip(weights) {
        sum += w;
        *c = (sum / total) as f32;
    }
    cumulative[last + 1..].fill(1.0);
    let mut first = 0;
    let slots = guide.len() as f32;
    for (k, slot) in guide.iter_mut().enumerate() {
        // Slightly less than the slot begins with: a product that was rounded up names it for numbers before.
        while cumulative[first + 1] <= k as f32 / slots * (1.0 - 4.0 * f32::EPSILON) {
            first += 1;
        }
        *slot = first as u32;
    }
    total
}

/// Index for `u` in 0..1, and where in the index's interval `u` lies.
#[inline(always)]
fn invert(cumulative: &[f32], guide: &[u32], u: f32) -> (usize, f32) {
    const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;
    let u = u.clamp(0.0, BELOW_ONE);
    let slots = guide.len();
    let mut i = guide[whole(u * slots as f32).min(slots - 1)] as usize;
    let passed = cumulative[i + 1..i + AHEAD].iter().fold(0, |sum, &c| sum + usize::from(c <= u));
    i += passed;
    if passed == AHEAD - 1 {
        while cumulative[i + 1] <= u {
            i += 1;
        }
    }
    let (below, above) = (cumulative[i], cumulative[i + 1]);
    (i, ((u - below) / (above - below)).min(BELOW_ONE))
}

/// Draws `x` in 0..1 with density proportional to `a + (b - a) x`; `a`, `b` in 0..=1, one of them above 1e-18.
#[inline(always)]
pub(super) fn sample_linear(a: f32, b: f32, u: f32) -> f32 {
    let root = (a * a + (b * b - a * a) * u).max(0.0).sqrt();
    // Zero for u = 0 where the density vanishes, and for ends so faint, against the brightest place, that they are never drawn.
    let sum = (a + root).max(f32::MIN_POSITIVE);
    (u * (a + b) / sum).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inversion_is_monotone_and_never_draws_zero_weight() {
        let weights = [0.0, 3.0, 0.0, 1e-12, 0.0, 5.0, 0.25, 0.0];
        let distribution = Discrete::new(&weights).unwrap();
        let mut previous = (0, -1.0);
        for k in 0..100_000 {
            let u = k as f32 / 100_000.0;
            let (i, r) = distribution.sample(u);
            assert!(weights[i] > 0.0, "index {i} at {u}");
            assert!((0.0..1.0).contains(&r));
            assert!((i, r) > previous, "not monotone at {u}");
            previous = (i, r);
        }
        assert_eq!(distribution.sample(1.0).0, 6);
    }

    #[test]
    fn linear_density_inverts_its_cumulative() {
        for (a, b) in [(1.0, 1.0), (0.0, 2.0), (2.0, 0.0), (0.3, 0.9), (1e-17, 1.0), (2e-17, 1e-17)] {
            for k in 0..=10 {
                let u = k as f32 / 10.0;
                let x = sample_linear(a, b, u);
                let cumulative = (a * x + 0.5 * (b - a) * x * x) / (0.5 * (a + b));
                assert!((cumulative - u).abs() < 1e-6, "{a} {b} {u}: {cumulative}");
            }
        }
    }
}
