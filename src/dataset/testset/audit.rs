//! Estimates the error of the truth itself: compares one frame of each sequence with a longer render that uses other random
//! numbers.

use crate::dataset::layout::AUDIT;
use crate::dataset::plan::Plan;
use crate::dataset::plan::is_keyframe;
use crate::dataset::{Sequence, Shard};
use crate::metrics::psnr::capped;
use crate::util::cancel::Cancel;
use crate::util::progress::Progress;
use anyhow::{Context, Result, ensure};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::reach::Reach;
use renderflow_frame::{color, file};
use renderflow_renderer::{RenderScene, Settings, render as path_trace};
use renderflow_scenes::{description::Scene, load};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Added to the seed of the sequence.
const OTHER_SEED: u64 = 0x5eed;

/// The error of the truth in one frame. Decibels are PSNR of display values over covered pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// Number of the frame.
    pub frame: usize,
    /// Samples for each pixel of the longer render.
    pub spp: u32,
    /// PSNR of the truth (denoised, if it was) against a perfect picture: from the squared difference to the longer render, minus
    /// that render's own variance. 100 dB where nothing is left.
    pub error: f64,
    /// The same for the truth's raw picture.
    pub raw: f64,
    /// The same for the longer render, from its variance.
    pub longer: f64,
}

/// The mean squared error of display values that follows from a variance of radiance, over covered pixels. To first order: the
/// curve is taken as straight over the width of the noise, and clipped values show no noise.
pub fn display_variance(mean: &Rgb, variance: &Rgb, alpha: &Image<f32>, exposure: f32) -> Option<f64> {
    const STEP: f32 = 1e-3;
    let (mut sum, mut count) = (0.0, 0usize);
    for ((mean, variance), alpha) in mean.pixels.iter().zip(&variance.pixels).zip(&alpha.pixels) {
        if *alpha > 0.0 {
            let above = color::display(mean.map(|v| v + STEP / exposure), exposure);
            let below = color::display(mean.map(|v| (v - STEP / exposure).max(0.0)), exposure);
            for c in 0..3 {
                let width = (STEP / exposure + mean[c].min(STEP / exposure)).max(f32::MIN_POSITIVE);
                let slope = f64::from((above[c] - below[c]) / width);
                sum += slope * slope * f64::from(variance[c]) / 3.0;
            }
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// PSNR of a mean squared error; [`CAP`](crate::metrics::psnr::CAP) where nothing is left of it. NaN stays NaN: it is no sign of
/// a small error.
pub fn decibel(error: f64) -> f64 {
    capped(-10.0 * error.clamp(0.0, f64::INFINITY).log10())
}

/// The number of the audited frame in each sequence of `plan`: the middle frame that is not a keyframe, or the first frame where
/// all are.
pub fn frame(plan: &Plan) -> Option<usize> {
    let between: Vec<usize> = plan.numbers().filter(|&number| !is_keyframe(plan.keyframe_gap(), number)).collect();
    between.get(between.len() / 2).copied().or(plan.numbers().next())
}

/// Audits every sequence in `shard` that has no audit yet.
pub fn run(plan: &Plan, out: &Path, shard: Shard, spp: u32, cancel: &Cancel) -> Result<()> {
    let mine: Vec<u32> = (0..plan.total()).filter(|&index| shard.owns(index)).collect();
    let progress = Progress::new("audit", 1000 * mine.len() as u64);
    for (done, index) in mine.into_iter().enumerate() {
        let folder = plan.folder(out, index);
        let path = folder.join(AUDIT);
        let stored: Option<Audit> = file::read_json(&path).ok();
        if stored.is_some_and(|audit| audit.spp == spp) {
            progress.resume(1000);
            continue;
        }
        let set = |part: u64, whole: u64| progress.set(1000 * done as u64 + 1000 * part / whole.max(1));
        let audit = sequence(plan, &folder, spp, &set, cancel).with_context(|| folder.display().to_string())?;
        file::write_json(&path, &audit)?;
    }
    progress.finish();
    Ok(())
}

fn sequence(plan: &Plan, path: &Path, spp: u32, progress: &(dyn Fn(u64, u64) + Sync), cancel: &Cancel) -> Result<Audit> {
    let sequence = Sequence::open(path)?;
    let index =
        sequence.numbers.iter().position(|&number| Some(number) == frame(plan)).context("the frame to audit is missing")?;
    let stored = sequence.frame(index)?;
    let scene = Scene::read(&path.join("scene.json"))?;
    // The scene beside the frames names the files of the plan in full.
    let loaded = load::load(&scene, &Reach::folder(path).allow(plan.reach().folders()))?;
    let mut compiled = RenderScene::compile(&loaded)?.with_seed(loaded.seed.wrapping_add(OTHER_SEED));
    compiled.set_frame(sequence.numbers[index]);
    let settings = Settings { spp, max_bounces: plan.render.max_bounces, ..Settings::default() };
    let longer = path_trace(&compiled, &settings, progress, cancel);
    cancel.check()?;
    let longer = longer?;
    let (mean, variance) = longer.raw.as_ref().zip(longer.variance.as_ref()).context("the path tracer made no picture")?;
    let exposure = sequence.exposure();
    let noise = display_variance(mean, variance, &stored.alpha, exposure).unwrap_or(0.0);
    let display = |picture: &Rgb| picture.map(|p| color::display(*p, exposure));
    let shown = display(mean);
    let error = |picture: &Option<Rgb>| -> Result<f64> {
        let picture = display(picture.as_ref().context("a frame without a picture")?);
        known(squared_error(&picture, &shown, &stored.alpha) - noise)
    };
    let raw = if stored.raw.is_some() { &stored.raw } else { &stored.beauty };
    Ok(Audit { frame: sequence.numbers[index], spp, error: error(&stored.beauty)?, raw: error(raw)?, longer: known(noise)? })
}

/// PSNR of a mean squared error, which must be a number.
fn known(error: f64) -> Result<f64> {
    ensure!(
        !error.is_nan(),
        "the error of the truth is not a number: a pixel of the stored frame or of the longer render is not"
    );
    Ok(decibel(error))
}

fn squared_error(a: &Rgb, b: &Rgb, alpha: &Image<f32>) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for ((a, b), alpha) in a.pixels.iter().zip(&b.pixels).zip(&alpha.pixels) {
        if *alpha > 0.0 {
            sum += (0..3).map(|c| f64::from(a[c] - b[c]).powi(2)).sum::<f64>() / 3.0;
            count += 1;
        }
    }
    sum / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::psnr::CAP;

    #[test]
    fn variance_on_the_display_is_what_noise_of_that_variance_makes() {
        // Uniform noise of known width on a ramp; the display's curve is bent, the noise small.
        let (width, height) = (64, 64);
        let mut state = 5u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let exposure = 0.25;
        let mean = Rgb::from_fn(width, height, |x, y| [0.4 + x as f32 / 32.0, 0.3 + y as f32 / 32.0, 5.0]);
        let spread = 0.05;
        let noisy = mean.map(|p| p.map(|v| v + spread * random()));
        let variance = mean.map(|_| [spread * spread / 12.0; 3]);
        let alpha = Image::from_fn(width, height, |x, _| if x < 48 { 1.0 } else { 0.0 });
        let shown = |picture: &Rgb| picture.map(|p| color::display(*p, exposure));
        let expected = squared_error(&shown(&noisy), &shown(&mean), &alpha);
        let found = display_variance(&mean, &variance, &alpha, exposure).unwrap();
        assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
        // What is clipped shows no noise.
        let white = mean.map(|_| [9.0; 3]);
        assert_eq!(display_variance(&white, &variance, &alpha, exposure), Some(0.0));
        assert_eq!(display_variance(&mean, &variance, &alpha.map(|_| 0.0), exposure), None);
    }

    #[test]
    fn decibels() {
        assert!((decibel(0.01) - 20.0).abs() < 1e-9);
        assert_eq!((decibel(0.0), decibel(-1.0), decibel(1e-30)), (CAP, CAP, CAP));
        // What is broken is not without error, and is not stored.
        let mut broken = Rgb::filled(4, 4, [0.5; 3]);
        broken.pixels[5][1] = f32::NAN;
        let error = squared_error(&broken, &Rgb::filled(4, 4, [0.5; 3]), &Image::filled(4, 4, 1.0));
        assert!(decibel(error).is_nan() && known(error).unwrap_err().to_string().contains("not a number"));
        assert_eq!(known(0.0).unwrap(), CAP);
    }
}
