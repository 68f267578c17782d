//! Keyframes: their truth, carried to the current frame, becomes the start of a second bridge; a small network repairs it.
//!
//! What is carried is the ratio between a keyframe's truth and its own split-sum picture, so that texture and view-dependent shading
//! come from the current frame. The base network fills what no keyframe saw. Without keyframes nothing of this file runs.

use crate::bridge::{MAX_RADIANCE, log_curve, log_curve_inverse};
use crate::config::{Input, KeyframeConfig, Start};
use crate::data::Clip;
use crate::features::{BACKGROUND, Features, STORED, TARGET};
use crate::network::init::Init;
use crate::network::layers::{Conv, Residual};
use crate::network::{shuffle, unshuffle};
use crate::ops::Stride;
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::{Tensor, activation};
use half::f16;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;
use renderflow_frame::{Frame, warp};

/// Keyframes used for one frame: the nearest before and the nearest after.
pub const KEYS: usize = 2;
/// Channels for each of them: carried radiance (3, exposed, log curve), validity, age.
pub const KEY_CHANNELS: usize = 5;
/// Channels a pixel of all keyframes.
pub const CHANNELS: usize = KEYS * KEY_CHANNELS;
/// Frames that count as age 1.
const AGE_UNIT: f32 = 16.0;
/// Logit of the blend before training: 0.98 for the carried picture.
const TRUST: f32 = 4.0;

/// Indices of the keyframes used for frame `i`: nearest at or before, nearest after.
pub fn nearest(keyframes: &[usize], i: usize) -> [Option<usize>; KEYS] {
    [keyframes.iter().copied().filter(|&k| k <= i).max(), keyframes.iter().copied().filter(|&k| k > i).min()]
}

/// Exposed split-sum picture of a frame.
pub fn start_picture(f: &Features) -> Rgb {
    let pixels = f.physical.iter().map(|p| p.base(Start::Ibl).start).collect();
    Image { width: f.width, height: f.height, pixels }
}

/// Exposed truth of a frame; 0 where it has no beauty.
pub fn truth_picture(f: &Features) -> Rgb {
    let truth = |stored: &[f32]| [TARGET, TARGET + 1, TARGET + 2].map(|c| log_curve_inverse(stored[c]));
    Image { width: f.width, height: f.height, pixels: f.pixels.chunks_exact(STORED).map(truth).collect() }
}

/// A keyframe as the current frame sees it.
#[derive(Clone, Debug)]
pub struct Carried {
    /// Exposed radiance, 0 where invalid.
    pub radiance: Rgb,
    /// 0..=1.
    pub valid: Image<f32>,
    /// Distance in units of 16 frames, at most 2.
    pub age: f32,
}

/// Carries a keyframe to the current frame by [`warp::ratio_fetch`]. `truth` and `start` are the keyframe's exposed pictures,
/// `distance` is in frames.
pub fn carry(
    frame: &Frame,
    features: &Features,
    key: &Frame,
    truth: &Rgb,
    start: &Rgb,
    distance: f32,
    movement: Movement,
) -> Carried {
    let correspondence = warp::correspond(frame, key, Some(&|id| movement.of(id)));
    // All pictures are exposed already.
    let mut radiance = warp::ratio_fetch(truth, start, &start_picture(features), &correspondence, 1.0);
    let mut valid = correspondence.valid;
    for (i, radiance) in radiance.pixels.iter_mut().enumerate() {
        let usable = features.physical[i].alpha > 0.0 && radiance.iter().all(|v| v.is_finite());
        valid.pixels[i] = if usable { valid.pixels[i].clamp(0.0, 1.0) } else { 0.0 };
        *radiance = if valid.pixels[i] > 0.0 { radiance.map(|v| v.clamp(0.0, MAX_RADIANCE)) } else { [0.0; 3] };
    }
    Carried { radiance, valid, age: age(distance) }
}

fn age(distance: f32) -> f32 {
    (distance.abs() / AGE_UNIT).min(2.0)
}

/// Carried keyframes of one frame in the training cache.
#[derive(Clone, Debug)]
pub struct StoredKeys {
    /// `[height][width][KEYS][4]`: radiance in the log curve, validity.
    pixels: Vec<f16>,
    ages: [f32; KEYS],
}

impl StoredKeys {
    /// From up to two carried keyframes.
    pub fn new(width: usize, height: usize, carried: &[Option<Carried>; KEYS]) -> Self {
        let mut pixels = Vec::with_capacity(width * height * KEYS * 4);
        for i in 0..width * height {
            for key in carried {
                match key {
                    Some(key) => {
                        pixels.extend(key.radiance.pixels[i].map(|v| f16::from_f32(log_curve(v))));
                        pixels.push(f16::from_f32(key.valid.pixels[i]));
                    }
                    None => pixels.extend([f16::ZERO; 4]),
                }
            }
        }
        Self { pixels, ages: [0, 1].map(|k| carried[k].as_ref().map_or(2.0, |key| key.age)) }
    }

    /// Memory it takes.
    pub fn bytes(&self) -> usize {
        2 * self.pixels.len()
    }

    /// Appends the [`CHANNELS`] of pixel `index`.
    pub fn read(&self, index: usize, out: &mut Vec<f32>) {
        for (k, key) in self.pixels[index * KEYS * 4..][..KEYS * 4].chunks_exact(4).enumerate() {
            out.extend(key.iter().map(|v| v.to_f32()));
            out.push(self.ages[k]);
        }
    }
}

/// Carries the keyframes of `clip` to its frame `i`.
///
/// # Errors
/// When a keyframe index is outside the clip or the clip has none.
pub fn store(clip: &Clip, features: &[Features], i: usize) -> Result<StoredKeys> {
    let broken = |reason: String| Error::Data { place: clip.name.clone(), reason };
    if clip.keyframes.is_empty() {
        return Err(broken("has no keyframes to learn from".into()));
    }
    if let Some(k) = clip.keyframes.iter().find(|&&k| k >= features.len()) {
        return Err(broken(format!("keyframe {k} of {} frames", features.len())));
    }
    let carried = nearest(&clip.keyframes, i).map(|key| {
        key.map(|k| {
            let distance = clip.numbers[k] as f32 - clip.numbers[i] as f32;
            let (truth, start) = (truth_picture(&features[k]), start_picture(&features[k]));
            carry(&clip.frames[i], &features[i], &clip.frames[k], &truth, &start, distance, clip.tracks.between(i, k))
        })
    });
    Ok(StoredKeys::new(features[i].width, features[i].height, &carried))
}

/// Per-pixel inputs of the keyframe network: z_t 3, carried pictures 6, validity 2, ages 2, normal 3, roughness and metallic 2,
/// split-sum factors (which hold n.v) 2, coverage 1, base prediction 3.
pub const NETWORK_CHANNELS: usize = 24;
/// Predictions: blend between carried and base, blend between the two carried, residual 3.
const HEAD_CHANNELS: usize = 5;

/// What the keyframe network works on, pictures `[b, h, w, ..]`.
#[derive(Clone, Debug)]
pub struct KeyInputs {
    /// Carried keyframes, [`CHANNELS`].
    pub keys: Tensor<4>,
    /// Guides: normal 3, roughness, metallic, split-sum factors 2, coverage: 8 channels.
    pub guides: Tensor<4>,
    /// Prediction of the base network as z, 3 channels, without gradient.
    pub base: Tensor<4>,
}

/// Channels of [`KeyInputs::guides`].
pub const GUIDES: usize = 8;

/// Writes the guides of one stored pixel.
pub fn push_guides(stored: &[f32], out: &mut Vec<f32>) {
    let normal = Input::Normal.offset();
    let material = Input::Material.offset();
    let brdf = Input::Brdf.offset();
    debug_assert!(stored.len() >= BACKGROUND);
    out.extend_from_slice(&stored[normal..normal + 3]);
    out.extend_from_slice(&stored[material..material + 2]);
    out.extend_from_slice(&stored[brdf..brdf + 2]);
    out.push(stored[Input::Coverage.offset()]);
}

/// Blend of the carried pictures before and after learning.
struct Blend {
    /// z of each keyframe, `[b, h, w, 3]`.
    z: [Tensor<4>; KEYS],
    /// Validity over age, `[b, h, w, 1]`.
    weight: [Tensor<4>; KEYS],
    /// 1 where any keyframe is valid, `[b, h, w, 1]`.
    any: Tensor<4>,
}

impl Blend {
    fn new(keys: &Tensor<4>) -> Self {
        let part = |k: usize, from: usize, count: usize| keys.clone().narrow(3, k * KEY_CHANNELS + from, count);
        let weight = [0, 1].map(|k| part(k, 3, 1) / part(k, 4, 1).add_scalar(1.0 / AGE_UNIT));
        let any = (part(0, 3, 1) + part(1, 3, 1)).clamp(0.0, 1.0);
        Self { z: [0, 1].map(|k| part(k, 0, 3).mul_scalar(2.0).sub_scalar(1.0)), weight, any }
    }

    /// Weighted mean of the carried pictures, the first keyframe's weight multiplied by `factor`; 0 where none is valid.
    fn mean(&self, factor: Option<Tensor<4>>) -> Tensor<4> {
        let first = match factor {
            Some(factor) => self.weight[0].clone() * factor,
            None => self.weight[0].clone(),
        };
        let total = (first.clone() + self.weight[1].clone()).clamp_min(1e-6);
        (self.z[0].clone() * first + self.z[1].clone() * self.weight[1].clone()) / total
    }
}

/// Start of the second bridge: the carried pictures where valid, weighted by age, the base prediction elsewhere.
pub fn start(inputs: &KeyInputs) -> Tensor<4> {
    let blend = Blend::new(&inputs.keys);
    let any = blend.any.clone();
    blend.mean(None) * any.clone() + inputs.base.clone() * any.neg().add_scalar(1.0)
}

/// A small U-Net on carried keyframes.
#[derive(Module, Debug)]
pub struct KeyframeNet {
    /// Pixel-unshuffled input to 1/2.
    pub stem: Conv,
    /// At 1/2.
    pub block_half: Residual,
    /// 1/2 to 1/4.
    pub down_quarter: Conv,
    /// At 1/4.
    pub block_quarter: Residual,
    /// 1/4 to 1/8.
    pub down_eighth: Conv,
    /// At 1/8.
    pub blocks_eighth: Vec<Residual>,
    /// 1/8 to 1/4.
    pub up_quarter: Conv,
    /// At 1/4.
    pub block_up_quarter: Residual,
    /// 1/4 to 1/2.
    pub up_half: Conv,
    /// At 1/2.
    pub block_up_half: Residual,
    /// Zero-initialised predictions.
    pub head: Conv,
}

impl KeyframeNet {
    /// Random weights; the head is zero, so that the first prediction is the blend of carried pictures and base.
    pub fn new(init: &mut Init, config: &KeyframeConfig) -> Self {
        let [w0, w1, w2] = config.widths;
        Self {
            // One more channel: the bridge time.
            stem: Conv::new(init, 3, 4 * (NETWORK_CHANNELS + 1), w0, 1.0),
            block_half: Residual::new(init, w0),
            down_quarter: Conv::new(init, 3, w0, w1, 1.0),
            block_quarter: Residual::new(init, w1),
            down_eighth: Conv::new(init, 3, w1, w2, 1.0),
            blocks_eighth: (0..2).map(|_| Residual::new(init, w2)).collect(),
            up_quarter: Conv::new(init, 3, w2 + w1, w1, 1.0),
            block_up_quarter: Residual::new(init, w1),
            up_half: Conv::new(init, 3, w1 + w0, w0, 1.0),
            block_up_half: Residual::new(init, w0),
            head: Conv::new(init, 3, w0, 4 * HEAD_CHANNELS, 0.0),
        }
    }

    /// Predicts the end point `z1_hat` `[b, h, w, 3]` from the bridge state `z_t` (same shape) at time `t` `[b, 1, 1, 1]`; h and w
    /// multiples of 8. Pixels without coverage keep the base prediction.
    pub fn forward(&self, inputs: &KeyInputs, z_t: Tensor<4>, t: Tensor<4>) -> Tensor<4> {
        let [b, h, w, _] = z_t.dims();
        let blend = Blend::new(&inputs.keys);
        let alpha = inputs.guides.clone().narrow(3, GUIDES - 1, 1);
        let x = Tensor::cat(
            vec![
                z_t,
                blend.z[0].clone() * inputs.keys.clone().narrow(3, 3, 1),
                blend.z[1].clone() * inputs.keys.clone().narrow(3, KEY_CHANNELS + 3, 1),
                inputs.keys.clone().narrow(3, 3, 2),
                inputs.keys.clone().narrow(3, KEY_CHANNELS + 3, 2),
                inputs.guides.clone(),
                inputs.base.clone(),
                t.expand([b, h, w, 1]),
            ],
            3,
        );
        let half = self.block_half.forward(self.stem.forward(unshuffle(x), Stride::One, true));
        let quarter = self.block_quarter.forward(self.down_quarter.forward(half.clone(), Stride::Two, true));
        let mut eighth = self.down_eighth.forward(quarter.clone(), Stride::Two, true);
        for block in &self.blocks_eighth {
            eighth = block.forward(eighth);
        }
        let quarter = self.block_up_quarter.forward(self.up_quarter.decode(eighth, quarter));
        let half = self.block_up_half.forward(self.up_half.decode(quarter, half));
        let heads = shuffle(self.head.forward(half, Stride::One, false));

        let between = heads.clone().narrow(3, 1, 1).clamp(-8.0, 8.0).exp();
        let carried = blend.mean(Some(between));
        let trust = activation::sigmoid(heads.clone().narrow(3, 0, 1).add_scalar(TRUST)) * blend.any;
        let mixed = carried * trust.clone() + inputs.base.clone() * trust.neg().add_scalar(1.0);
        mixed + heads.narrow(3, 2, 3) * alpha
    }
}
