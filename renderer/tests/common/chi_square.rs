//! Pearson's chi-square test of a sampler against the density it claims.

use glam::DVec3;

/// Cells expected to hold fewer draws than this are pooled.
const SMALLEST_CELL: f64 = 5.0;

/// Halvings of a cell that the integration of a density may use.
const DEPTH: u32 = 8;

/// Observed and expected counts of one experiment; each sums to the number of draws.
pub struct Counts {
    pub name: String,
    pub observed: Vec<f64>,
    pub expected: Vec<f64>,
}

impl Counts {
    /// Probability of a deviation at least this large if the claim is true.
    pub fn p_value(&self) -> f64 {
        let mut cells: Vec<(f64, f64)> = self.expected.iter().copied().zip(self.observed.iter().copied()).collect();
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
}

impl Counts {
    /// The three cells that deviate most, for messages.
    fn worst_cells(&self) -> String {
        let deviation = |i: usize| (self.observed[i] - self.expected[i]).powi(2) / self.expected[i].max(1.0);
        let mut cells: Vec<usize> = (0..self.expected.len()).collect();
        cells.sort_by(|&a, &b| deviation(b).total_cmp(&deviation(a)));
        let describe = |&i: &usize| format!("cell {i} holds {} of {:.2}", self.observed[i], self.expected[i]);
        cells.iter().take(3).map(describe).collect::<Vec<_>>().join(", ")
    }
}

/// Fails when any experiment is refuted at a significance of 1 % for all together (Sidak 1967).
pub fn assert_all(experiments: &[Counts]) {
    let threshold = 1.0 - (1.0_f64 - 0.01).powf(1.0 / experiments.len() as f64);
    let mut refuted = Vec::new();
    let mut smallest: f64 = 1.0;
    for counts in experiments {
        let (observed, expected) = (counts.observed.iter().sum::<f64>(), counts.expected.iter().sum::<f64>());
        assert!((observed - expected).abs() < 1e-6 * observed, "{}: {observed} against {expected} draws", counts.name);
        let p = counts.p_value();
        smallest = smallest.min(p);
        if p < threshold {
            refuted.push(format!("{}: p = {p:.2e}; {}", counts.name, counts.worst_cells()));
        }
    }
    println!("{} experiments, smallest p = {smallest:.3}, threshold {threshold:.1e}", experiments.len());
    assert!(refuted.is_empty(), "refuted at {threshold:.1e}:\n{}", refuted.join("\n"));
}

/// A grid of directions around an axis, finer towards it: rows are even in `ln(1 + w / spread)`, where `w = 1 - cos` of the angle
/// from the axis. A large `spread` gives cells of equal solid angle.
pub struct DirectionGrid {
    axis: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    spread: f64,
    rows: usize,
    columns: usize,
}

impl DirectionGrid {
    pub fn new(axis: DVec3, spread: f64, rows: usize, columns: usize) -> Self {
        let axis = axis.normalize();
        let (tangent, bitangent) = axis.any_orthonormal_pair();
        Self { axis, tangent, bitangent, spread, rows, columns }
    }

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

/// Random numbers in 0..1: PCG-XSH-RR (O'Neill 2014), independent of the samplers under test.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        random.next();
        random
    }

    pub fn next(&mut self) -> f32 {
        let old = self.0;
        self.0 = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let bits = ((((old >> 18) ^ old) >> 27) as u32).rotate_right((old >> 59) as u32);
        (bits >> 8) as f32 / 16_777_216.0
    }
}
