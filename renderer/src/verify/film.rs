//! Sums of the film against sums made in another way.

use super::chi_square::Random;
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::film::PixelStatistics;
use glam::Vec3A;

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "film.sums",
        about: "mean and variance of up to 2^22 samples of one pixel equal the two-pass textbook formulae in compensated double precision",
        run: sums,
    },
    Check { name: "film.merge", about: "partial films merged in any split and order equal the whole bit for bit", run: merge },
];

/// A stream of samples that is hard on running sums.
struct Stream {
    name: &'static str,
    /// The sample from its number, how many there are, and a random number.
    value: fn(u32, u32, &mut Random) -> f32,
}

const STREAMS: &[Stream] = &[
    Stream { name: "uniform in 0..1", value: |_, _, r| r.next() },
    Stream { name: "constant 0.1", value: |_, _, _| 0.1 },
    Stream { name: "1e7 first, then 0.25", value: |i, _, _| if i == 0 { 1e7 } else { 0.25 } },
    Stream { name: "0.25, then 1e7 last", value: |i, n, _| if i + 1 == n { 1e7 } else { 0.25 } },
    Stream { name: "1e30 first, then 1", value: |i, _, _| if i == 0 { 1e30 } else { 1.0 } },
    Stream { name: "sixty powers of ten", value: |i, _, _| 10f32.powi(i as i32 % 60 - 30) },
    Stream { name: "1000 with a spread of 0.1", value: |_, _, r| 1000.0 + 0.1 * (r.next() - 0.5) },
    Stream { name: "a heavy tail", value: |_, _, r| (1.0 / (1.0 - r.next())).powf(0.8) },
    Stream { name: "alternating 0 and 1e-30", value: |i, _, _| if i % 2 == 0 { 0.0 } else { 1e-30 } },
    Stream { name: "the largest number", value: |_, _, _| f32::MAX },
    Stream { name: "black", value: |_, _, _| 0.0 },
];

/// Mean, and variance of the mean, of values: two passes, each compensated (Neumaier 1974).
fn textbook(values: &[f32]) -> (f64, f64) {
    let sum = |f: &dyn Fn(f64) -> f64| {
        let (mut sum, mut lost) = (0.0_f64, 0.0_f64);
        for &value in values {
            let term = f(value.into());
            let next = sum + term;
            lost += if sum.abs() >= term.abs() { (sum - next) + term } else { (term - next) + sum };
            sum = next;
        }
        sum + lost
    };
    let n = values.len() as f64;
    let mean = sum(&|v| v) / n;
    (mean, sum(&|v| (v - mean) * (v - mean)) / (n * (n - 1.0)))
}

/// Half a step of single precision, in which the film answers.
const ROUNDING: f64 = f32::EPSILON as f64;
/// Values below the smallest normal number of single precision have no relative precision to keep.
const TINY: f64 = f32::MIN_POSITIVE as f64;

/// Error of a mean in steps of single precision.
fn mean_error(found: f32, expected: f64) -> f64 {
    (f64::from(found) - expected).abs() / (ROUNDING * expected.abs()).max(TINY)
}

/// Error of the standard deviation of one sample relative to what can be told from rounding: 1e-5 of itself, or 1e-7 of the mean,
/// the step at which the samples themselves are rounded.
fn spread_error(found: f32, expected: f64, mean: f64, n: f64) -> f64 {
    let largest = f64::from(f32::MAX);
    let (found, expected) = (f64::from(found), expected.min(largest));
    ((found * n).sqrt() - (expected * n).sqrt()).abs() / (1e-5 * (expected * n).sqrt() + 1e-7 * mean.abs() + (TINY * n).sqrt())
}

fn sums(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let sizes: &[u32] = effort.pick(&[2, 3, 4096, 1 << 16], &[2, 3, 100, 4096, 10_000, 1 << 16, 1 << 20, 1 << 22]);
    let total: u64 = sizes.iter().map(|&n| u64::from(n)).sum();
    ticker.expect(total * STREAMS.len() as u64);
    let (mut means, mut spreads) = (Worst::default(), Worst::default());
    for stream in STREAMS {
        for &n in sizes {
            if ticker.cancelled() {
                break;
            }
            let mut random = Random::new(n.into());
            let values: Vec<f32> = (0..n).map(|i| (stream.value)(i, n, &mut random)).collect();
            let mut film = PixelStatistics::default();
            // The channels differ, so that none can stand in for another.
            values.iter().for_each(|&v| film.push(Vec3A::new(v, 0.5 * v, 0.25)));
            let (mean, variance) = textbook(&values);
            let name = || format!("{n} samples, {}", stream.name);
            for (c, factor) in [(0, 1.0), (1, 0.5)] {
                let expected = mean * factor;
                means.see(mean_error(film.mean()[c], expected), name);
                let expected_variance = variance * factor * factor;
                spreads.see(spread_error(film.variance_of_mean()[c], expected_variance, expected, n.into()), name);
            }
            means.see(mean_error(film.mean()[2], 0.25), name);
            ticker.add(n.into());
        }
    }
    vec![
        means.at_most("mean, steps of single precision", 1.0),
        spreads.at_most("standard deviation, shares of 1e-5 of itself and 1e-7 of the mean", 1.0),
    ]
}

fn merge(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let rounds = effort.pick(20_u64, 400);
    ticker.expect(rounds);
    let (mut counts, mut means, mut spreads) = (Worst::default(), Worst::default(), Worst::default());
    let mut random = Random::new(3);
    for round in 0..rounds {
        if ticker.cancelled() {
            break;
        }
        let stream = &STREAMS[round as usize % STREAMS.len()];
        let (n, parts) = (2 + random.below(20_000), 1 + random.below(16));
        let mut films = vec![PixelStatistics::default(); parts as usize];
        let mut whole = PixelStatistics::default();
        for i in 0..n {
            let value = Vec3A::splat((stream.value)(i, n, &mut random));
            whole.push(value);
            films[random.below(parts) as usize].push(value);
        }
        // In any order, empty parts among them.
        let mut joined = PixelStatistics::default();
        while !films.is_empty() {
            joined.merge(&films.swap_remove(random.below(films.len() as u32) as usize));
        }
        let name = || format!("{n} samples in {parts} parts, {}", stream.name);
        let steps = |a: f32, b: f32| f64::from(a.to_bits().abs_diff(b.to_bits()));
        counts.see(joined.count().abs_diff(whole.count()) as f64, name);
        means.see(steps(joined.mean()[0], whole.mean()[0]), name);
        spreads.see(steps(joined.variance_of_mean()[0], whole.variance_of_mean()[0]), name);
        ticker.add(1);
    }
    vec![
        counts.at_most("samples lost or gained", 0.0),
        means.at_most("mean, steps of single precision", 0.0),
        spreads.at_most("variance, steps of single precision", 0.0),
    ]
}
