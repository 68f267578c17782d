//! Adaptive sampling: more samples where the picture is noisier, in rounds.
//!
//! A pilot traces a few samples in every pixel. Then each round estimates how noisy the pixels are and traces what brings the
//! error of the picture down fastest: with relative variance `r` of one sample and cost `c` a sample, counts in proportion to
//! `sqrt(r / c)` minimise the sum of `r / n` for a given sum of `c n`. Counts are a function of the samples alone, so that
//! threads do not enter.
//!
//! A mean of samples is biased when its own samples decide how many there are: a pixel whose first samples missed the bright ones
//! stops early and stays dark. So the noise of a pixel is estimated from its *neighbours*, whose random numbers are independent.
//! [`Budget::Average`] asks once, after the pilot, when nothing that a neighbour has depends on this pixel: it asks all of them
//! near by. Where counts are decided on again and again they do depend on it: there pixels have one of four colours, and each is
//! judged by those of the next colour only. Its samples come back to it after four rounds at the earliest, thinned by some forty
//! pixels each time. Judging by all neighbours made a caustic scene measurably darker there.
//!
//! What remains is that all pixels share one sum: a bright sample takes samples from all, its own pixel too. That bias is in
//! inverse proportion to the number of noisy places in the picture; it shows in tiny pictures alone.
//!
//! The error, the biases and the variants that were tried and left are in docs/measurements/renderer-notes.md, adaptive.

use super::accumulate::{Meter, Work};
use super::light_paths::CausticCasters;
use super::mean;
use super::visible::Visible;
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::film::Film;
use crate::sampler::hash;
use crate::schedule::Progress;
use crate::settings::{Budget, FLOOR, STEP, Settings, pilot};
use crate::stats::Stats;
use glam::DVec3;
use rayon::prelude::*;
use renderflow_frame::Image;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Largest count of a map that fits the scene's picture.
pub(super) fn largest(scene: &RenderScene, settings: &Settings, map: &Image<u32>) -> Result<u32> {
    let (width, height) = (scene.camera().width, scene.camera().height);
    if (map.width, map.height, map.pixels.len()) != (width, height, width * height) {
        return Err(Error::SampleMap(format!(
            "it is of {} x {} pixels, the picture of {width} x {height}",
            map.width, map.height
        )));
    }
    if let Some(at) = map.pixels.iter().position(|n| !(1..=MOST).contains(n)) {
        let (x, y) = (at % width, at / width);
        return Err(Error::SampleMap(format!("{} samples at pixel ({x}, {y}) are outside 1..={MOST}", map.pixels[at])));
    }
    let branches = settings.branches();
    if let Some(at) = map.pixels.iter().position(|n| !n.is_multiple_of(branches)) {
        let (x, y) = (at % width, at / width);
        let count = map.pixels[at];
        return Err(Error::SampleMap(format!("{count} samples at pixel ({x}, {y}), and {branches} share a camera ray")));
    }
    Ok(map.pixels.iter().copied().max().unwrap_or(0))
}

/// Most samples of a pixel.
pub(super) const MOST: u32 = 1 << 24;
/// Largest step after the pilot: twice the batches that random numbers and light samples are made in. Steps of 4 made a round as
/// dear as one of four times the samples.
const LARGEST_STEP: u32 = 32;
/// Samples after the smallest round that is worth it, relative to those before.
const LEAST_ROUND: f64 = 1.05;
/// The pilot's share where the environment alone is seen.
const FLOOR_UNSEEN: f64 = 1.0 / 8.0;
/// Most samples of a pixel, in averages.
const CAP: f64 = 32.0;
/// Colours of the pixels, see above.
const COLOURS: i64 = 4;
/// How far the pixels are that judge a pixel, in pixels, where one of four does.
const RADIUS: i64 = 7;
/// The same where all do. 7 is worse on most scenes (docs/measurements/renderer-notes.md, adaptive).
const RADIUS_ONCE: i64 = 3;
/// What relative errors are relative to, besides the squared mean: that of relMSE.
const DARK: f64 = 0.01;
/// Cost of a sample that may see geometry, in samples that see the environment alone.
const COST: u64 = 16;

/// Spreads samples as `settings.budget` asks and traces them.
pub(super) fn render(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Film, Stats)> {
    let started = Instant::now();
    let (width, height) = (scene.camera().width, scene.camera().height);
    let casters = CausticCasters::find(scene, settings);
    let work = Work::new(scene, settings, visible, casters.as_ref(), cancel);
    let mut film = Film::new(scene, settings, 0..settings.spp, None);
    let mut plan = Plan {
        seed: hash::child(hash::child(scene.seed, scene.frame() as u64), 0x4144_4150),
        seen: (0..width * height).map(|pixel| visible.at(pixel % width, pixel / width)).collect(),
        counts: vec![0; width * height],
    };
    let unit = plan.cost(&vec![1; width * height]);
    let most = unit as f64 * f64::from(settings.spp);
    let limit = match settings.budget {
        Budget::Time { milliseconds } => Some(Duration::from_millis(milliseconds.into())),
        _ => None,
    };
    let meter = Meter::new(progress, limit);

    let fewest = settings.budget.fewest(settings.spp);
    // Deviations are judged by camera rays.
    let fewest_unseen = pilot(settings.spp, FLOOR_UNSEEN).max(STEP * settings.branches()).min(fewest);
    let mut stats = Stats::default();
    let mut target: Vec<u32> = plan.seen.iter().map(|&seen| if seen { fewest } else { fewest_unseen }).collect();
    let first = plan.cost(&target) as f64;
    let mut budget = first;
    for round in 1.. {
        let light = mean(&plan.counts)..mean(&target);
        let samples = plan.samples(&target) + work.light_paths(&light);
        // What is left is guessed from what the budget says; the last round knows.
        let total = meter.done() + samples;
        let expected = (samples as f64 * (most / budget.max(1.0))).max(total as f64) as u64;
        let last = round > 1 || settings.spp == fewest;
        let total = if settings.budget == Budget::Average && !last { expected } else { total };
        stats += work.trace_light(&mut film, light, (&meter, total))?;
        let span = |pixel: usize| plan.counts[pixel]..target[pixel];
        stats += work.trace(&mut film, &span, (&meter, total))?;
        plan.counts.clone_from(&target);
        let next = match settings.budget {
            Budget::Uniform | Budget::Average | Budget::Detail => most,
            Budget::Error { millionths } => {
                let ratio = error(&film) / (f64::from(millionths) * 1e-6);
                // Above the target, another round is worth it.
                if ratio > 1.0 { budget * ratio.clamp(LEAST_ROUND, 2.0) } else { 0.0 }
            }
            Budget::Time { milliseconds } => {
                let share = f64::from(milliseconds) * 1e-3 / started.elapsed().as_secs_f64().max(1e-6);
                budget * share.min(2.0)
            }
        };
        let next = next.min(most);
        // Less is not worth a round.
        if last && settings.budget == Budget::Average || next < LEAST_ROUND * budget {
            break;
        }
        budget = next;
        target = plan.allocate(&importance(&film, &judges(settings.budget)), budget, unit, settings.spp);
    }
    film.complete_map(&plan.counts);
    Ok((film, stats))
}

/// Counts so far and what the next ones depend on besides noise.
struct Plan {
    seed: u64,
    /// Whether a pixel may see geometry.
    seen: Vec<bool>,
    counts: Vec<u32>,
}

impl Plan {
    /// Sum of counts, weighed by what a sample costs.
    fn cost(&self, counts: &[u32]) -> u64 {
        counts.par_iter().enumerate().map(|(pixel, &n)| self.cost_of(pixel, n)).sum()
    }

    fn cost_of(&self, pixel: usize, count: u32) -> u64 {
        u64::from(count) * if self.seen[pixel] { COST } else { 1 }
    }

    /// Samples that `target` has beyond those so far.
    fn samples(&self, target: &[u32]) -> u64 {
        target.iter().zip(&self.counts).map(|(&n, &done)| u64::from(n.saturating_sub(done))).sum()
    }

    /// Counts in proportion to `importance`, none below those so far, that cost at most `budget`: as much as can be used.
    fn allocate(&self, importance: &[f64], budget: f64, unit: u64, spp: u32) -> Vec<u32> {
        let average = budget / unit.max(1) as f64;
        let floor = average * FLOOR;
        let cap = (average * CAP).min(f64::from(MOST));
        // Without geometry a sample is cheap, and they may be many: but no more than a uniform picture has.
        let cap_unseen = f64::from(spp / STEP * STEP);
        let step = (spp / 4).clamp(STEP, LARGEST_STEP).next_power_of_two();
        // Rounded down or up at random, so that neighbours differ by a step rather than all of them by none.
        let dither = |pixel: usize| (hash::child(self.seed, pixel as u64) >> 11) as f64 / (1_u64 << 53) as f64;
        let dither: Vec<f64> = (0..importance.len()).into_par_iter().map(dither).collect();
        let count = |pixel: usize, scale: f64| {
            let seen = self.seen[pixel];
            let wish = scale * importance[pixel];
            let wish = if seen { wish.clamp(floor, cap) } else { (wish * (COST as f64).sqrt()).min(cap_unseen) };
            let steps = (wish / f64::from(step) + dither[pixel]) as u32;
            self.counts[pixel].max(steps.saturating_mul(step).min(MOST))
        };
        let counts = |scale: f64| (0..importance.len()).into_par_iter().map(|pixel| count(pixel, scale)).collect::<Vec<_>>();
        let cost =
            |scale: f64| (0..importance.len()).into_par_iter().map(|pixel| self.cost_of(pixel, count(pixel, scale))).sum::<u64>();
        let affordable = |scale: f64| cost(scale) as f64 <= budget;
        // The largest scale that is affordable, to five digits: the bits of positive numbers are in the order of their values.
        let (mut low, mut high) = (1e-20_f64.to_bits(), 1e20_f64.to_bits());
        for _ in 0..24 {
            let middle = low + (high - low) / 2;
            *(if affordable(f64::from_bits(middle)) { &mut low } else { &mut high }) = middle;
        }
        counts(f64::from_bits(low))
    }
}

/// A variance relative to a mean, averaged over the channels.
fn relative(variance: DVec3, mean: DVec3) -> f64 {
    (0..3).map(|c| variance[c] / (mean[c] * mean[c] + DARK)).sum::<f64>() / 3.0
}

/// Where the pixels are that judge a pixel, as seen from it.
fn judges(budget: Budget) -> Vec<(i64, i64)> {
    let once = budget == Budget::Average;
    let radius = if once { RADIUS_ONCE } else { RADIUS };
    let near = (-radius..=radius).flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy)));
    let asked = |&(dx, dy): &(i64, i64)| if once { (dx, dy) != (0, 0) } else { (dx + 2 * dy).rem_euclid(COLOURS) == 1 };
    near.filter(|(dx, dy)| dx * dx + dy * dy <= radius * (radius + 1)).filter(asked).collect()
}

/// Standard deviation of a sample relative to the picture for each pixel, as its `judges` tell. Samples are camera paths: what
/// light paths bring is in the picture, but its noise is not theirs.
///
/// Variances are relative to the mean of the same pixel: where one bright sample among `n` makes it, they are at most `n`, so
/// that single fireflies cannot take the whole budget. Relative to the mean of all neighbours the error was larger.
fn importance(film: &Film, judges: &[(i64, i64)]) -> Vec<f64> {
    let (width, height) = (film.width as i64, film.height as i64);
    let of_sample = |at: usize| {
        let pixel = &film.pixels[at];
        relative(pixel.variance_of_mean_f64() * pixel.count() as f64, film.mean_of(at)).min(1e30)
    };
    let relative: Vec<f64> = (0..film.pixels.len()).into_par_iter().map(of_sample).collect();
    let pooled = |pixel: usize| {
        let (x, y) = (pixel as i64 % width, pixel as i64 / width);
        let (mut sum, mut count) = (0.0, 0_u32);
        for (x, y) in judges.iter().map(|(dx, dy)| (x + dx, y + dy)) {
            if (0..width).contains(&x) && (0..height).contains(&y) {
                sum += relative[(y * width + x) as usize];
                count += 1;
            }
        }
        // A picture of one column: nobody to ask.
        if count == 0 { 1.0 } else { (sum / f64::from(count)).sqrt() }
    };
    (0..relative.len()).into_par_iter().map(pooled).collect()
}

/// Estimated relMSE of the picture so far: the variance of each pixel's mean relative to the mean of those around it. Relative to
/// its own it would be far too small, since a pixel that a bright sample makes noisy is made bright by it.
///
/// Independent samples would have that variance; low-discrepancy ones have less: where light paths find the caustics it is a few
/// times the relMSE (docs/measurements/renderer-notes.md, adaptive).
fn error(film: &Film) -> f64 {
    let (width, height) = (film.width, film.height);
    let around = |pixel: usize| {
        let (x, y) = (pixel % width, pixel / width);
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for y in y.saturating_sub(1)..(y + 2).min(height) {
            for at in (x.saturating_sub(1)..(x + 2).min(width)).map(|x| y * width + x).filter(|&at| at != pixel) {
                sum += film.mean_of(at);
                count += 1.0;
            }
        }
        if count == 0.0 { film.mean_of(pixel) } else { sum / count }
    };
    let relative = |pixel: usize| relative(film.variance_of_mean(pixel), around(pixel));
    // Summed in order, whoever made them.
    let errors: Vec<f64> = (0..film.pixels.len()).into_par_iter().map(relative).collect();
    errors.iter().sum::<f64>() / errors.len().max(1) as f64
}
