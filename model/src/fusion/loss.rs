//! The loss of one picture and its derivative: the error that PSNR measures, two terms for dark and bright parts and for edges,
//! and LPIPS of a whole batch.

use super::batch::Batch;
use super::record::PixelInputs;
use crate::Result;
use crate::bridge::{log_curves, srgb_slope};
use crate::lpips::Lpips;
use crate::parameters::read;
use crate::train::config;
use burn::tensor::{Device, Tensor, TensorData};
use renderflow_frame::color::linear_to_srgb;
use serde::{Deserialize, Serialize};

/// Weights of the terms of the loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Natural logarithm of the mean squared error of each display picture against the raw truth. Results are reported as mean
    /// PSNR, in which easy and hard pictures have the same weight.
    pub psnr: f32,
    /// Squared error of the display picture against the raw truth.
    pub display: f32,
    /// Absolute error in the logarithmic curve.
    pub log: f32,
    /// Absolute error of the display picture's differences between neighbours.
    pub gradient: f32,
    /// LPIPS of the display picture, with SqueezeNet ([`perceptual`]).
    pub lpips: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { psnr: 0.01, display: 0.0, log: 0.1, gradient: 0.05, lpips: 0.0 }
    }
}

impl LossWeights {
    /// Checks every weight.
    ///
    /// # Errors
    /// [`Error::Config`](crate::Error::Config) naming the first one that is not a number of at least 0.
    pub fn validate(&self) -> Result<()> {
        let Self { psnr, display, log, gradient, lpips } = *self;
        config::weights([
            ("loss.psnr", psnr),
            ("loss.display", display),
            ("loss.log", log),
            ("loss.gradient", gradient),
            ("loss.lpips", lpips),
        ])
    }
}

/// Terms of the loss, as means over the three channels of the pixels that show a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// The loss that is minimised.
    pub total: f32,
    /// Mean squared display error against the raw truth: PSNR is `-10 log10` of it.
    pub display: f32,
    /// Mean absolute error in the logarithmic curve.
    pub log: f32,
    /// Mean absolute error of differences between neighbouring pixels.
    pub gradient: f32,
}

/// What a rendered picture is compared with, exposed linear radiance.
///
/// The picture with the least mean square to noisy ones is their mean (Lehtinen et al., Noise2Noise, 2018), so squares are of the
/// raw truth, in which no denoiser has left its errors. The display curve bends, so the mean of noisy display values is a little
/// too dark; more samples make this smaller. Absolute errors and LPIPS lead elsewhere under noise, so they are of the denoised
/// truth.
#[derive(Clone, Copy, Debug)]
pub struct Truth<'a> {
    /// The truth, denoised where a denoiser was found.
    pub picture: &'a [[f32; 3]],
    /// The same before it was denoised.
    pub raw: &'a [[f32; 3]],
}

/// Display value of an exposed radiance.
pub fn display(x: f32) -> f32 {
    linear_to_srgb(x.clamp(0.0, 1.0))
}

/// Added to the mean squared error before its logarithm: the error at 50 dB.
const LEAST: f32 = 1e-5;

/// Slope of the logarithmic curve ([`log_curves`]).
fn log_slope(x: f32) -> f32 {
    8.0 / ((1.0 + 8.0 * x.max(0.0)) * 9f32.ln())
}

/// The loss of a rendered picture of `width` columns without LPIPS, and its derivative with respect to the rendered pixels.
pub fn loss(
    width: usize,
    pixels: &[PixelInputs],
    drawn: &[[f32; 3]],
    truth: Truth,
    weights: LossWeights,
) -> (Loss, Vec<[f32; 3]>) {
    let covered = |i: usize| pixels[i].alpha > 0.0;
    let count = |pairs: &dyn Fn(usize) -> bool| 3.0 * (0..pixels.len()).filter(|i| pairs(*i)).count().max(1) as f32;
    let height = pixels.len() / width;
    let right = |i: usize| i % width + 1 < width && covered(i) && covered(i + 1);
    let below = |i: usize| i / width + 1 < height && covered(i) && covered(i + width);
    let (n, n_right, n_below) = (count(&covered), count(&right), count(&below));

    let errors = |truth: &[[f32; 3]]| -> Vec<[f32; 3]> {
        drawn.iter().zip(truth).map(|(a, b)| std::array::from_fn(|c| display(a[c]) - display(b[c]))).collect()
    };
    let (error, from_raw) = (errors(truth.picture), errors(truth.raw));
    let log_of = |picture: &[[f32; 3]]| {
        let mut values = picture.as_flattened().to_vec();
        log_curves(&mut values);
        values
    };
    let (of_drawn, of_truth) = (log_of(drawn), log_of(truth.picture));
    let curved = |values: &[f32], i: usize, c: usize| values[3 * i + c];
    let squares = (0..drawn.len()).filter(|i| covered(*i)).flat_map(|i| from_raw[i]).map(|e| f64::from(e * e)).sum::<f64>();
    let squares = (squares / f64::from(n)) as f32;
    let steepness = weights.display + weights.psnr / (squares + LEAST);
    let mut of_display = vec![[0.0; 3]; drawn.len()];
    let mut slopes = vec![[0.0; 3]; drawn.len()];
    let mut sums = [0.0_f64; 2];
    for i in (0..drawn.len()).filter(|i| covered(*i)) {
        for c in 0..3 {
            let e = error[i][c];
            of_display[i][c] += 2.0 * steepness * from_raw[i][c] / n;
            let along = curved(&of_drawn, i, c) - curved(&of_truth, i, c);
            sums[0] += f64::from(along.abs()) / f64::from(n);
            slopes[i][c] += weights.log * sign(along) * log_slope(drawn[i][c]) / n;
            for (pair, other, n) in [(right(i), i + 1, n_right), (below(i), i + width, n_below)] {
                if pair {
                    let difference = e - error[other][c];
                    sums[1] += f64::from(difference.abs()) / f64::from(n);
                    let slope = weights.gradient * sign(difference) / n;
                    of_display[i][c] += slope;
                    of_display[other][c] -= slope;
                }
            }
        }
    }
    for (slope, (of_display, drawn)) in slopes.iter_mut().zip(of_display.iter().zip(drawn)) {
        for c in 0..3 {
            // Display values that are clamped have no slope.
            if drawn[c] > 0.0 && drawn[c] < 1.0 {
                slope[c] += of_display[c] * srgb_slope(drawn[c]);
            }
        }
    }
    let [log, gradient] = sums.map(|sum| sum as f32);
    let of_psnr = weights.psnr * (1.0 + squares / LEAST).ln();
    let total = of_psnr + weights.display * squares + weights.log * log + weights.gradient * gradient;
    (Loss { total, display: squares, log, gradient }, slopes)
}

/// Mean LPIPS of the display pictures of a batch, and its derivative with respect to `drawn`, the rendered pixels. Pixels that
/// show no surface are left as they are, so their derivative is 0. `device` is the one of `lpips`, with automatic derivatives.
///
/// # Errors
/// When the crops are smaller than LPIPS can compare, and when the device fails.
pub fn perceptual(lpips: &Lpips, batch: &Batch, drawn: &[[f32; 3]], device: &Device) -> Result<(f32, Vec<[f32; 3]>)> {
    let shape = [batch.items, batch.height, batch.width, 3];
    // Channels come before rows there, and values go from -1 to 1.
    let shown = |pixels: &[[f32; 3]]| {
        let values: Vec<f32> = pixels.as_flattened().iter().map(|v| 2.0 * display(*v) - 1.0).collect();
        Tensor::<4>::from_data(TensorData::new(values, shape), device)
    };
    let picture = shown(drawn).require_grad();
    let channels_first = |picture: Tensor<4>| picture.permute([0, 3, 1, 2]);
    let distance = lpips.loss(channels_first(picture.clone()), channels_first(shown(&batch.truth)))?;
    let value = read(distance.clone().without_autodiff())?[0];
    let gradients = distance.backward();
    let slopes = picture.grad(&gradients).map(read).transpose()?.unwrap_or_default();
    let mut out = vec![[0.0; 3]; drawn.len()];
    for ((out, slopes), (drawn, pixel)) in out.iter_mut().zip(slopes.chunks_exact(3)).zip(drawn.iter().zip(&batch.pixels)) {
        for c in (0..3).filter(|&c| pixel.alpha > 0.0 && drawn[c] > 0.0 && drawn[c] < 1.0) {
            out[c] = 2.0 * slopes[c] * srgb_slope(drawn[c]);
        }
    }
    Ok((value, out))
}

/// The sign of a number. It is 0 for 0, which is a subgradient.
fn sign(v: f32) -> f32 {
    if v == 0.0 { 0.0 } else { v.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn derivatives_agree_with_differences() {
        let mut rng = Pcg64Mcg::seed_from_u64(8);
        let pixels: Vec<PixelInputs> =
            (0..48).map(|_| PixelInputs { alpha: f32::from(u8::from(rng.random_bool(0.8))), ..PixelInputs::default() }).collect();
        let mut picture =
            |most: f32| -> Vec<[f32; 3]> { (0..48).map(|_| [(); 3].map(|()| rng.random_range(0.05..most))).collect() };
        let [drawn, truth, raw] = [(); 3].map(|()| picture(1.4));
        let truth = Truth { picture: &truth, raw: &raw };
        let weights = LossWeights { psnr: 0.05, display: 3.0, log: 0.7, gradient: 0.2, lpips: 0.0 };
        let (_, slopes) = loss(8, &pixels, &drawn, truth, weights);
        for i in 0..48 {
            for c in 0..3 {
                let step = 1e-3;
                let at = |delta: f32| {
                    let mut moved = drawn.clone();
                    moved[i][c] += delta;
                    loss(8, &pixels, &moved, truth, weights).0.total
                };
                let expected = (at(step) - at(-step)) / (2.0 * step);
                let near_a_corner = (drawn[i][c] - 1.0).abs() < 2.0 * step;
                assert!(near_a_corner || (slopes[i][c] - expected).abs() < 2e-3, "{i} {c}: {} and {expected}", slopes[i][c]);
            }
        }
    }

    /// Squares are of the raw truth alone, absolute errors of the denoised one alone.
    #[test]
    fn each_term_has_its_truth() {
        let pixels = vec![PixelInputs { alpha: 1.0, ..PixelInputs::default() }; 16];
        let (same, other) = (vec![[0.3; 3]; 16], (0..16).map(|i| [0.02 * i as f32; 3]).collect::<Vec<_>>());
        let of = |picture, raw| loss(4, &pixels, &same, Truth { picture, raw }, LossWeights::default()).0;
        let (noisy, cleaned) = (of(&same, &other), of(&other, &same));
        assert!(noisy.display > 0.0 && noisy.log == 0.0 && noisy.gradient == 0.0, "{noisy:?}");
        assert!(cleaned.display == 0.0 && cleaned.log > 0.0 && cleaned.gradient > 0.0, "{cleaned:?}");
    }

    #[test]
    fn the_truth_has_no_loss() {
        let pixels = vec![PixelInputs { alpha: 1.0, ..PixelInputs::default() }; 16];
        let picture = vec![[0.3, 0.6, 2.0]; 16];
        let truth = Truth { picture: &picture, raw: &picture };
        let (loss, slopes) = loss(4, &pixels, &picture, truth, LossWeights::default());
        assert_eq!(loss, Loss::default());
        assert!(slopes.iter().flatten().all(|v| *v == 0.0));
    }
}
