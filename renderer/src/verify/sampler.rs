//! Sampler dimensions and pixel filters against the densities they claim.

use super::chi_square::{Counts, Random, judge};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::camera::Filter;
use crate::sampler::{PixelSampler, Sampler, Sharing};
use rayon::prelude::*;

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "sampler.uniform",
        about: "every dimension of a sample, over random pixels, frames and seeds, is uniform in 0..1 (chi-square)",
        run: uniform,
    },
    Check {
        name: "sampler.pairs",
        about: "pairs of dimensions within a set, across sets, samples, pixels and frames are independent (chi-square)",
        run: pairs,
    },
    Check {
        name: "sampler.strata",
        about: "the first 2^k samples of a pixel put one number into each of 2^k strata of every dimension",
        run: strata,
    },
    Check {
        name: "sampler.blocks",
        about: "the first 2^k samples of all pixels of a block together put one number into each of 16 x 2^k strata",
        run: blocks,
    },
    Check { name: "filter.density", about: "pixel filters are drawn from their window (chi-square)", run: filter },
];

/// Sets looked at: camera, five surfaces and five light samples.
const SETS: u32 = 11;

/// The sampler of a random pixel of a random frame of a random scene.
fn any_pixel(random: &mut Random) -> (u64, u64, u64) {
    (random.bits().into(), random.below(1000).into(), random.below(1 << 24).into())
}

fn uniform(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let draws = effort.pick(200_000, 4_000_000);
    // Early samples, the last before and the first after the sequence begins anew, and the last of a render.
    let indices = [0, 1, 2, 63, 255, 4095, (1 << 16) - 1, 1 << 16, (1 << 24) - 1];
    ticker.expect(indices.len() as u64 * u64::from(SETS));
    let jobs: Vec<(u32, u32)> = indices.into_iter().flat_map(|index| (0..SETS).map(move |set| (index, set))).collect();
    let experiments: Vec<Counts> = jobs
        .into_par_iter()
        .flat_map_iter(|(index, set)| {
            let mut random = Random::new(u64::from(index) << 8 | u64::from(set));
            let mut counts: Vec<Counts> =
                (0..4).map(|d| Counts::uniform(format!("sample {index}, set {set}, dimension {d}"), 256)).collect();
            for _ in 0..if ticker.cancelled() { 0 } else { draws } {
                let (seed, frame, pixel) = any_pixel(&mut random);
                // Half of the pixels share a sequence with their block.
                let sampler = match random.below(2) {
                    0 => PixelSampler::new(seed, frame, pixel),
                    _ => {
                        let sharing = Sharing::new(1 << random.below(9), 1 << random.below(4), 1);
                        PixelSampler::shared(
                            Sampler::Sobol,
                            seed,
                            frame,
                            (pixel as u32 % 4096, pixel as u32 / 4096),
                            4096,
                            sharing,
                        )
                    }
                };
                let point = sampler.point(index, set);
                // A number outside 0..1 has no cell: it goes to the first and refutes it.
                counts.iter_mut().zip(point).for_each(|(c, v)| c.add(cell(v, 256).unwrap_or(0)));
            }
            ticker.add(1);
            counts
        })
        .collect();
    vec![judge("uniform in 256 cells", &experiments)]
}

/// Which of `cells` equal parts of 0..1 a number is in.
fn cell(v: f32, cells: usize) -> Option<usize> {
    (0.0..1.0).contains(&v).then_some((v * cells as f32) as usize)
}

fn pairs(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    const SIDE: usize = 24;
    let draws = effort.pick(200_000, 4_000_000);
    /// What the second number of a pair differs in from the first.
    #[derive(Clone, Copy, Debug)]
    enum Other {
        Set(u32),
        Sample(u32),
        Pixel(u64),
        Block,
        Frame,
        Seed,
    }
    let mut jobs = Vec::new();
    for other in [
        Other::Set(0),
        Other::Set(1),
        Other::Set(2),
        Other::Set(5),
        // Not the neighbouring sample: two points of a net repel one another, by design.
        Other::Sample(1 << 16),
        Other::Sample(1 << 20),
        Other::Pixel(1),
        Other::Pixel(1920),
        // Not the neighbouring pixel of a block, for the same reason.
        Other::Block,
        Other::Frame,
        Other::Seed,
    ] {
        for (a, b) in (0..4).flat_map(|a| (0..4).map(move |b| (a, b))) {
            // Within a set a pair has two dimensions, and order does not matter.
            if !matches!(other, Other::Set(0)) || a < b {
                jobs.push((other, a, b));
            }
        }
    }
    ticker.expect(jobs.len() as u64);
    let experiments: Vec<Counts> = jobs
        .into_par_iter()
        .enumerate()
        .map(|(number, (other, a, b))| {
            let mut random = Random::new(1 << 40 | number as u64);
            let mut counts = Counts::uniform(format!("dimension {a} against dimension {b}, {other:?}"), SIDE * SIDE);
            for _ in 0..if ticker.cancelled() { 0 } else { draws } {
                let (seed, frame, pixel) = any_pixel(&mut random);
                let (index, set) = (random.below(64), random.below(6));
                let shared = |x: u32| {
                    let at = (x + pixel as u32 % 4096, pixel as u32 / 4096);
                    PixelSampler::shared(Sampler::Sobol, seed, frame, at, 4100, Sharing::new(16, 2, 1)).point(index, set)
                };
                let first = match other {
                    Other::Block => shared(0),
                    _ => PixelSampler::new(seed, frame, pixel).point(index, set),
                };
                let second = match other {
                    Other::Set(step) => PixelSampler::new(seed, frame, pixel).point(index, set + step),
                    Other::Sample(step) => PixelSampler::new(seed, frame, pixel).point(index + step, set),
                    Other::Pixel(step) => PixelSampler::new(seed, frame, pixel + step).point(index, set),
                    Other::Block => shared(4),
                    Other::Frame => PixelSampler::new(seed, frame + 1, pixel).point(index, set),
                    Other::Seed => PixelSampler::new(seed + 1, frame, pixel).point(index, set),
                };
                let at = cell(first[a], SIDE).zip(cell(second[b], SIDE)).map_or(0, |(i, j)| i * SIDE + j);
                counts.add(at);
            }
            ticker.add(1);
            counts
        })
        .collect();
    vec![judge("independent in 24 x 24 cells", &experiments)]
}

fn strata(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let pixels = effort.pick(300_u64, 10_000);
    ticker.expect(pixels);
    let worst = (0..pixels)
        .into_par_iter()
        .map(|pixel| {
            let mut worst = Worst::default();
            if ticker.cancelled() {
                return worst;
            }
            let sampler = PixelSampler::new(11, pixel / 7, pixel);
            for set in 0..SETS {
                for exponent in [1, 4, 8, 10] {
                    let n = 1_u32 << exponent;
                    let mut filled = vec![[0_u8; 4]; n as usize];
                    for index in 0..n {
                        for (d, v) in sampler.point(index, set).into_iter().enumerate() {
                            if let Some(i) = cell(v, n as usize) {
                                filled[i][d] = filled[i][d].saturating_add(1);
                            }
                        }
                    }
                    let empty = filled.iter().flatten().filter(|&&count| count != 1).count();
                    worst.see(empty as f64, || format!("pixel {pixel}, set {set}, {n} samples"));
                }
            }
            ticker.add(1);
            worst
        })
        .reduce(Worst::default, merged);
    vec![worst.at_most("strata that do not hold exactly one number", 0.0)]
}

fn blocks(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    /// Pixels of a block.
    const PIXELS: u32 = 16;
    let blocks = effort.pick(100_u32, 3_000);
    ticker.expect(blocks.into());
    let worst = (0..blocks)
        .into_par_iter()
        .map(|block| {
            let mut worst = Worst::default();
            if ticker.cancelled() {
                return worst;
            }
            let (rays, lights, branches) = [(1, 1, 1), (4, 2, 1), (8, 4, 2), (64, 2, 2)][block as usize % 4];
            let sharing = Sharing::new(rays, lights, branches);
            // Image points are not shared.
            for set in 1..SETS {
                let samples = rays * if set == 2 { lights } else { branches };
                let n = (samples * PIXELS) as usize;
                let mut filled = vec![[0_u8; 4]; n];
                for (x, y) in (0..PIXELS).map(|i| (4 * block + i % 4, i / 4)) {
                    let sampler = PixelSampler::shared(Sampler::Sobol, 11, 5, (x, y), 4 * blocks, sharing);
                    for (index, d) in (0..samples).flat_map(|index| (0..4).map(move |d| (index, d))) {
                        if let Some(i) = cell(sampler.point(index, set)[d], n) {
                            filled[i][d] = filled[i][d].saturating_add(1);
                        }
                    }
                }
                let empty = filled.iter().flatten().filter(|&&count| count != 1).count();
                worst.see(empty as f64, || format!("block {block}, set {set}, {samples} samples a pixel"));
            }
            ticker.add(1);
            worst
        })
        .reduce(Worst::default, merged);
    vec![worst.at_most("strata that do not hold exactly one number", 0.0)]
}

/// [`Worst::merge`] as a function of two.
pub(super) fn merged(mut a: Worst, b: Worst) -> Worst {
    a.merge(b);
    a
}

/// Share of the four-term Blackman-Harris window (Harris 1978) left of `x`, x in -1/2..1/2, from its antiderivative.
fn blackman_harris_share(x: f64) -> f64 {
    const A: [f64; 4] = [0.35875, 0.48829, 0.14128, 0.01168];
    let term = |k: usize| A[k] / (std::f64::consts::TAU * k as f64) * (std::f64::consts::TAU * k as f64 * x).sin();
    0.5 + (A[0] * x + term(1) + term(2) + term(3)) / A[0]
}

fn filter(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    const SIDE: usize = 48;
    let draws = effort.pick(300_000, 4_000_000);
    // Numbers of a pseudo-random stream, and those that the integrator draws first in each pixel.
    let jobs = [(Filter::Box, false), (Filter::Box, true), (Filter::BlackmanHarris, false), (Filter::BlackmanHarris, true)];
    ticker.expect(jobs.len() as u64);
    let (experiments, beyond): (Vec<Counts>, Vec<Worst>) = jobs
        .into_par_iter()
        .map(|(filter, net)| {
            let share = |x: f64| match filter {
                Filter::Box => x + 0.5,
                Filter::BlackmanHarris => blackman_harris_share(x),
            };
            let cut = |i: usize| share(i as f64 / SIDE as f64 - 0.5);
            let mass: Vec<f64> = (0..SIDE).map(|i| cut(i + 1) - cut(i)).collect();
            let expected = mass.iter().flat_map(|a| mass.iter().map(move |b| a * b)).collect();
            let name = format!("{filter:?}, {}", if net { "first points of pixels" } else { "random numbers" });
            let mut counts = Counts::new(name.clone(), expected);
            let mut beyond = Worst::default();
            let radius = filter.radius();
            let mut draw = |u: [f32; 2]| {
                let offset = filter.sample(u);
                beyond.see(f64::from(offset.abs().max_element() - radius), || format!("{name}: {offset} for {u:?}"));
                offset
            };
            let mut random = Random::new(77);
            for i in 0..if ticker.cancelled() { 0 } else { draws } {
                let [a, b, ..] = PixelSampler::new(5, 0, i).point(0, 0);
                let offset = draw(if net { [a, b] } else { [random.next(), random.next()] });
                let at = |v: f32| (((v / (2.0 * radius) + 0.5) * SIDE as f32) as usize).min(SIDE - 1);
                counts.add(at(offset.x) * SIDE + at(offset.y));
            }
            // The ends of the range.
            for u in [0.0, f32::MIN_POSITIVE, 1.0 - f32::EPSILON / 2.0] {
                draw([u, u]);
            }
            ticker.add(1);
            (counts, beyond)
        })
        .unzip();
    let beyond = beyond.into_iter().fold(Worst::default(), merged);
    vec![judge("window in 48 x 48 cells", &experiments), beyond.at_most("distance beyond the radius, pixels", 0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_the_integral_of_the_window() {
        let window = |x: f64| {
            let c = |k: f64| (k * std::f64::consts::TAU * x).cos();
            0.35875 + 0.48829 * c(1.0) + 0.14128 * c(2.0) + 0.01168 * c(3.0)
        };
        let n = 20_000;
        let (mut sum, step) = (0.0, 1.0 / f64::from(n));
        for i in 0..n {
            sum += window((f64::from(i) + 0.5) * step - 0.5) * step / 0.35875;
            assert!((blackman_harris_share(f64::from(i + 1) * step - 0.5) - sum).abs() < 1e-8);
        }
        assert!((sum - 1.0).abs() < 1e-12);
    }
}
