//! Piecewise-constant distributions drawn by inverting their cumulative sums.
//!
//! An alias table would draw in constant time, but it scatters neighbouring random numbers over the whole domain. Inversion is
//! monotone, so the stratification of a low-discrepancy sequence survives. The guide table (Chen and Asau 1974) brings the
//! search down to a look at one or two entries.

/// Rows of cells with a discrete distribution over rows and, within each, over columns.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    columns: usize,
    rows: Discrete,
    within: Vec<Discrete>,
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
    /// `weights[row * columns + column]`, finite and >= 0. `None` when all are zero. Also returns their sum.
    pub fn new(weights: &[f64], columns: usize) -> Option<(Self, f64)> {
        let sums: Vec<f64> = weights.chunks_exact(columns).map(|row| row.iter().sum()).collect();
        let total = sums.iter().sum();
        let rows = Discrete::new(&sums)?;
        let within = weights.chunks_exact(columns).map(|row| Discrete::new(row).unwrap_or_default()).collect();
        Some((Self { columns, rows, within }, total))
    }

    /// Draws a cell; never one of weight zero.
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Cell {
        let (row, v) = self.rows.sample(u[1]);
        let (column, u) = self.within[row].sample(u[0]);
        debug_assert!(column < self.columns);
        Cell { column, row, u: [u, v] }
    }
}

/// A distribution over `0..n`.
#[derive(Clone, Debug, Default)]
struct Discrete {
    /// `cumulative[i]` = probability of an index <= i; 1 from the last possible index on.
    cumulative: Vec<f32>,
    /// `guide[k]` = first index whose cumulative probability exceeds `k / n`.
    guide: Vec<u32>,
}

impl Discrete {
    fn new(weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let last = weights.iter().rposition(|&w| w > 0.0)?;
        let mut sum = 0.0;
        let mut cumulative: Vec<f32> = weights
            .iter()
            .map(|w| {
                sum += w;
                (sum / total) as f32
            })
            .collect();
        cumulative[last..].fill(1.0);
        let n = cumulative.len();
        let mut first = 0;
        let guide = (0..n)
            .map(|k| {
                while cumulative[first] <= k as f32 / n as f32 {
                    first += 1;
                }
                first as u32
            })
            .collect();
        Some(Self { cumulative, guide })
    }

    /// Index for `u` in 0..1, and where in the index's interval `u` lies.
    #[inline]
    fn sample(&self, u: f32) -> (usize, f32) {
        const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;
        let u = u.min(BELOW_ONE);
        let n = self.cumulative.len();
        let k = ((u * n as f32) as usize).min(n - 1);
        // Rounding of `u * n` can name the next slot; its first index may then lie beyond `u`.
        let mut i = self.guide[k] as usize;
        while i > 0 && self.cumulative[i - 1] > u {
            i -= 1;
        }
        while self.cumulative[i] <= u {
            i += 1;
        }
        let below = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        (i, ((u - below) / (self.cumulative[i] - below)).min(BELOW_ONE))
    }
}

/// Draws `x` in 0..1 with density proportional to `a + (b - a) x`; `a`, `b` >= 0, not both zero.
#[inline]
pub(super) fn sample_linear(a: f32, b: f32, u: f32) -> f32 {
    // Relative to the larger end: the squares of faint weights would underflow.
    let largest = a.max(b);
    if largest <= 0.0 {
        return u;
    }
    let (a, b) = (a / largest, b / largest);
    let root = (a * a + (b * b - a * a) * u).max(0.0).sqrt();
    if u > 0.0 { (u * (a + b) / (a + root)).min(1.0) } else { 0.0 }
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
        for (a, b) in [(1.0, 1.0), (0.0, 2.0), (2.0, 0.0), (0.3, 0.9), (1e-30, 1.0), (2e-30, 1e-30)] {
            for k in 0..=10 {
                let u = k as f32 / 10.0;
                let x = sample_linear(a, b, u);
                let cumulative = (a * x + 0.5 * (b - a) * x * x) / (0.5 * (a + b));
                assert!((cumulative - u).abs() < 1e-6, "{a} {b} {u}: {cumulative}");
            }
        }
    }
}
