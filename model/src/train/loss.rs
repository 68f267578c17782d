//! The training objective on one batch, with its gradient.
//!
//! `L = |z1_hat - z_1|^2 + display_weight * |display error|^2 + gradient_weight * |difference of display gradients|_1`, each a mean
//! over covered pixels. The first term is the bridge-matching loss on the velocity times `(1 - t)^2`: predicting `z1_hat`, the plain
//! velocity loss would weigh t = 0.75 sixteen times as much as t = 0, the only time used by single-step inference.
//!
//! Everything behind the network's output is a few operations a pixel, so they run fused on the host, with derivatives by hand; as
//! tensor operations they took a sixth of a step. `tests/loss.rs` holds them against automatic differentiation.

use crate::bridge::{MAX_RADIANCE, srgb_slope};
use crate::config::{Curve, Start};
use crate::data::{BASE_CHANNELS, Batch};
use crate::network::heads::MAX_EXPONENT;
use rayon::prelude::*;
use renderflow_frame::color::linear_to_srgb;
use serde::{Deserialize, Serialize};

/// Weights of the pixel terms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Squared error of the display picture, which is what PSNR measures.
    pub display: f32,
    /// Absolute difference of the display picture's gradients.
    pub gradient: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { display: 4.0, gradient: 0.1 }
    }
}

/// The parts of the loss.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// What is minimised.
    pub total: f32,
    /// Squared error in z.
    pub bridge: f32,
    /// Squared display error: PSNR is `-10 log10` of it.
    pub display: f32,
    /// Absolute difference of gradients.
    pub gradient: f32,
}

/// A predicted value and its derivatives: z and exposed radiance x.
#[derive(Clone, Copy, Default)]
struct Predicted {
    z: f32,
    x: f32,
}

/// The base network's outputs `[b, h/2, w/2, 4 * head_channels]` and what they act on.
struct BaseOutputs<'a> {
    start: Start,
    curve: Curve,
    outputs: &'a [f32],
    batch: &'a Batch,
}

impl BaseOutputs<'_> {
    fn heads(&self, i: usize) -> &[f32] {
        let channels = self.start.head_channels();
        &self.outputs[unshuffled(i, self.batch.size) * channels..][..channels]
    }

    /// Channels of [`Batch::base`] from channel `c` of pixel `i` on.
    fn pixel(&self, i: usize, c: usize) -> &[f32] {
        &self.batch.base[i * BASE_CHANNELS + c..]
    }

    fn predict(&self, i: usize, c: usize) -> Predicted {
        let (h, p) = (self.heads(i), self.pixel(i, c));
        match self.start {
            Start::Ibl => {
                let raw = p[0] * exponential(h[c]) + p[3] * exponential(h[3 + c]) + p[6] * h[6 + c] + p[9];
                let x = raw.clamp(0.0, MAX_RADIANCE);
                Predicted { z: self.curve.encode(x), x }
            }
            Start::Albedo | Start::AlbedoIrradiance => {
                let z = p[12] + h[c] * self.batch.alpha[i];
                Predicted { z, x: self.curve.decode(z) }
            }
        }
    }
}

fn exponential(v: f32) -> f32 {
    v.clamp(-MAX_EXPONENT, MAX_EXPONENT).exp()
}

/// The base network's prediction z `[b, h, w, 3]` from its outputs.
pub fn predict(start: Start, curve: Curve, outputs: &[f32], batch: &Batch) -> Vec<f32> {
    let base = BaseOutputs { start, curve, outputs, batch };
    (0..3 * batch.mask.len()).into_par_iter().with_min_len(1024).map(|i| base.predict(i / 3, i % 3).z).collect()
}

/// Loss of the base network's raw outputs `[b, h/2, w/2, 4 * head_channels]` and its gradient with respect to them.
pub fn base(start: Start, curve: Curve, outputs: &[f32], batch: &Batch, weights: LossWeights) -> (Loss, Vec<f32>) {
    let channels = start.head_channels();
    let base = BaseOutputs { start, curve, outputs, batch };
    let (loss, slopes) = evaluate(batch, weights, &|i, c| base.predict(i, c));
    let mut gradient = vec![0.0; outputs.len()];
    gradient.par_chunks_exact_mut(channels).enumerate().for_each(|(at, out)| {
        let i = shuffled(at, batch.size);
        for c in 0..3 {
            let [dz, dx] = slopes[3 * i + c];
            let Predicted { z, x } = base.predict(i, c);
            match start {
                Start::Ibl => {
                    // The clamp passes no gradient.
                    let d = if x > 0.0 && x < MAX_RADIANCE { dx + dz * curve.encode_slope(x) } else { 0.0 };
                    let (h, p) = (base.heads(i), base.pixel(i, c));
                    let inside = |v: f32| if v.abs() < MAX_EXPONENT { exponential(v) } else { 0.0 };
                    out[c] = d * p[0] * inside(h[c]);
                    out[3 + c] = d * p[3] * inside(h[3 + c]);
                    out[6 + c] = d * p[6];
                }
                Start::Albedo | Start::AlbedoIrradiance => out[c] = (dz + dx * curve.decode_slope(z)) * batch.alpha[i],
            }
        }
    });
    (loss, gradient)
}

/// Loss of a prediction z `[b, h, w, 3]` and its gradient.
pub fn direct(curve: Curve, z: &[f32], batch: &Batch, weights: LossWeights) -> (Loss, Vec<f32>) {
    let predict = |i: usize, c: usize| Predicted { z: z[3 * i + c], x: curve.decode(z[3 * i + c]) };
    let (loss, slopes) = evaluate(batch, weights, &predict);
    let gradient = slopes.par_iter().zip(z).map(|([dz, dx], z)| dz + dx * curve.decode_slope(*z)).collect();
    (loss, gradient)
}

/// Position in the order of 2 x 2 blocks of pixel `i` of a batch of squares.
fn unshuffled(i: usize, size: usize) -> usize {
    let (x, y, item) = (i % size, i / size % size, i / (size * size));
    item * size * size + ((y / 2) * (size / 2) + x / 2) * 4 + (y % 2) * 2 + x % 2
}

/// Inverse of [`unshuffled`].
fn shuffled(at: usize, size: usize) -> usize {
    let (sub, block) = (at % 4, at / 4);
    let (x, y, item) = (block % (size / 2), block / (size / 2) % (size / 2), block / (size * size / 4));
    item * size * size + (2 * y + sub / 2) * size + 2 * x + sub % 2
}

/// Loss and its derivatives `[dL/dz, dL/dx]` of each value, the other held fixed.
fn evaluate(batch: &Batch, weights: LossWeights, predict: &(dyn Fn(usize, usize) -> Predicted + Sync)) -> (Loss, Vec<[f32; 2]>) {
    let size = batch.size;
    let pixels = batch.mask.len();
    let row = 3 * size;
    let values: Vec<Predicted> = (0..3 * pixels).into_par_iter().with_min_len(row).map(|i| predict(i / 3, i % 3)).collect();
    let error: Vec<f32> = values
        .par_iter()
        .with_min_len(row)
        .enumerate()
        .map(|(i, value)| linear_to_srgb(value.x.clamp(0.0, 1.0)) - batch.target[6 * (i / 3) + 3 + i % 3])
        .collect();

    // Weights of the means: covered pixels, and pairs of neighbours that are both covered.
    let mask = &batch.mask;
    let right = |i: usize| if i % size + 1 < size { mask[i] * mask[i + 1] } else { 0.0 };
    let row_of = |i: usize| i / size % size;
    let below = |i: usize| if row_of(i) + 1 < size { mask[i] * mask[i + size] } else { 0.0 };
    let count = |weight: &dyn Fn(usize) -> f32| (3.0 * (0..pixels).map(|i| f64::from(weight(i))).sum::<f64>().max(1.0)) as f32;
    let (n, n_right, n_below) = (count(&|i| mask[i]), count(&right), count(&below));

    // One sum a row, added in order: the result does not depend on threads.
    let mut slopes = vec![[0.0; 2]; 3 * pixels];
    let sums: Vec<[f64; 3]> = slopes
        .par_chunks_exact_mut(row)
        .enumerate()
        .map(|(y, slopes)| {
            let mut sums = [0.0; 3];
            for (k, slope) in slopes.iter_mut().enumerate() {
                let (i, c) = (y * size + k / 3, k % 3);
                let at = 3 * i + c;
                if mask[i] == 0.0 {
                    continue;
                }
                let (e, bridge) = (error[at], values[at].z - batch.target[6 * i + c]);
                sums[0] += f64::from(mask[i] * bridge * bridge);
                sums[1] += f64::from(mask[i] * e * e);
                let mut de = 2.0 * weights.display * mask[i] * e / n;
                for (weight, other, n, own) in [
                    (right(i), at + 3, n_right, true),
                    (below(i), at + row, n_below, true),
                    (if i % size > 0 { right(i - 1) } else { 0.0 }, at.wrapping_sub(3), n_right, false),
                    (if row_of(i) > 0 { below(i - size) } else { 0.0 }, at.wrapping_sub(row), n_below, false),
                ] {
                    if weight > 0.0 {
                        let difference = e - error[other];
                        if own {
                            sums[2] += f64::from(weight * difference.abs() / n);
                        }
                        // The sign of 0 is 0: a subgradient.
                        let sign = if difference == 0.0 { 0.0 } else { difference.signum() };
                        de += weights.gradient * weight * sign / n;
                    }
                }
                let x = values[at].x;
                let slope_x = if x > 0.0 && x < 1.0 { srgb_slope(x) } else { 0.0 };
                *slope = [2.0 * mask[i] * bridge / n, de * slope_x];
            }
            sums
        })
        .collect();
    let [bridge, display, gradient] = sums.iter().fold([0.0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
    let (bridge, display, gradient) = (bridge as f32 / n, display as f32 / n, gradient as f32);
    (Loss { total: bridge + weights.display * display + weights.gradient * gradient, bridge, display, gradient }, slopes)
}
