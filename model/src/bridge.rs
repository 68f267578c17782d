//! Bridge matching: the curve that maps radiance to the space of the bridge, and the bridge itself
//! (RenderFlow, section "Latent-Space Bridge-Matching Training", with the pixel space in place of a latent one).

use crate::config::Curve;
use burn::tensor::Tensor;
use renderflow_frame::color::{linear_to_srgb, srgb_to_linear};

/// Noise of the Brownian bridge, in units of z.
pub const SIGMA: f32 = 0.005;
/// Times seen in training.
pub const TIMES: [f32; 4] = [0.0, 0.25, 0.5, 0.75];
/// Largest exposed radiance that is represented; brighter is clamped (the half-float limit).
pub const MAX_RADIANCE: f32 = 65504.0;

/// `log1p(8 x) / log1p(8)`: 0 at 0, 1 at 1; expects exposed radiance >= 0, clamps to 0..=65504, NaN becomes 0.
pub fn log_curve(x: f32) -> f32 {
    const SCALE: f32 = 0.455_119_6; // 1 / ln 9
    // `max` and `min` return the other operand for NaN.
    (8.0 * x.max(0.0).min(MAX_RADIANCE)).ln_1p() * SCALE
}

/// Inverse of [`log_curve`].
pub fn log_curve_inverse(c: f32) -> f32 {
    const LN_9: f32 = 2.197_224_6;
    (c * LN_9).exp_m1() * 0.125
}

impl Curve {
    /// Exposed radiance to z (-1 at 0, 1 at display white).
    pub fn encode(self, x: f32) -> f32 {
        match self {
            Self::Log => 2.0 * log_curve(x) - 1.0,
            Self::Srgb => 2.0 * linear_to_srgb(x.max(0.0).min(MAX_RADIANCE)) - 1.0,
        }
    }

    /// z to exposed radiance, clamped to 0..=65504.
    pub fn decode(self, z: f32) -> f32 {
        let x = match self {
            Self::Log => log_curve_inverse(0.5 * (z + 1.0)),
            Self::Srgb => srgb_to_linear(0.5 * (z + 1.0)),
        };
        x.max(0.0).min(MAX_RADIANCE)
    }

    /// [`Self::encode`] on a tensor; expects values >= 0.
    pub fn encode_tensor<const D: usize>(self, x: Tensor<D>) -> Tensor<D> {
        match self {
            Self::Log => x.mul_scalar(8.0).log1p().mul_scalar(2.0 / 9f32.ln()).sub_scalar(1.0),
            Self::Srgb => srgb_tensor(x).mul_scalar(2.0).sub_scalar(1.0),
        }
    }

    /// [`Self::decode`] on a tensor, clamped below at 0.
    pub fn decode_tensor<const D: usize>(self, z: Tensor<D>) -> Tensor<D> {
        match self {
            Self::Log => z.add_scalar(1.0).clamp(0.0, 10.1).mul_scalar(0.5 * 9f32.ln()).exp().sub_scalar(1.0).mul_scalar(0.125),
            Self::Srgb => {
                let s = z.add_scalar(1.0).mul_scalar(0.5).clamp(0.0, 120.0);
                let power = s.clone().clamp_min(0.040_45).add_scalar(0.055).div_scalar(1.055).powf_scalar(2.4);
                let linear = s.clone().div_scalar(12.92);
                power.mask_where(s.lower_equal_scalar(0.040_45), linear)
            }
        }
    }
}

/// sRGB transfer function of values >= 0, continued above 1.
pub fn srgb_tensor<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    // The power branch is clamped before the power: its slope at 0 is infinite and would turn a masked gradient into NaN.
    let power = x.clone().clamp_min(0.003_130_8).powf_scalar(1.0 / 2.4).mul_scalar(1.055).sub_scalar(0.055);
    let linear = x.clone().mul_scalar(12.92);
    power.mask_where(x.lower_equal_scalar(0.003_130_8), linear)
}

/// `z_t = (1 - t) z_0 + t z_1 + sigma sqrt(t (1 - t)) noise`, for one value.
pub fn interpolate(z0: f32, z1: f32, t: f32, noise: f32) -> f32 {
    (1.0 - t) * z0 + t * z1 + SIGMA * (t * (1.0 - t)).sqrt() * noise
}

/// Velocity `(z1_hat - z_t) / (1 - t)` of a predicted end point.
pub fn velocity(z1_hat: f32, z_t: f32, t: f32) -> f32 {
    (z1_hat - z_t) / (1.0 - t)
}
