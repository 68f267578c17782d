//! Bridge matching: the curve that maps radiance to the space of the bridge, and the bridge itself
//! (RenderFlow, section "Latent-Space Bridge-Matching Training", with the pixel space in place of a latent one).

use crate::config::Curve;
use renderflow_frame::color::{linear_to_srgb, srgb_to_linear};

/// Noise of the Brownian bridge, in units of z.
pub const SIGMA: f32 = 0.005;
/// Times seen in training.
pub const TIMES: [f32; 4] = [0.0, 0.25, 0.5, 0.75];
/// Largest exposed radiance that is represented; brighter is clamped (the half-float limit).
pub const MAX_RADIANCE: f32 = 65504.0;

/// Clamps to what the curves and half floats represent; NaN becomes 0.
fn representable(x: f32) -> f32 {
    if x.is_nan() { 0.0 } else { x.clamp(0.0, MAX_RADIANCE) }
}

/// `log1p(8 x) / log1p(8)`: 0 at 0, 1 at 1; expects exposed radiance >= 0, clamps to 0..=65504, NaN becomes 0.
pub fn log_curve(x: f32) -> f32 {
    const SCALE: f32 = 0.455_119_6; // 1 / ln 9
    (8.0 * representable(x)).ln_1p() * SCALE
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
            Self::Srgb => 2.0 * linear_to_srgb(representable(x)) - 1.0,
        }
    }

    /// z to exposed radiance, clamped to 0..=65504.
    pub fn decode(self, z: f32) -> f32 {
        let x = match self {
            Self::Log => log_curve_inverse(0.5 * (z + 1.0)),
            Self::Srgb => srgb_to_linear(0.5 * (z + 1.0)),
        };
        representable(x)
    }

    /// Derivative of [`Self::encode`] at x > 0.
    pub fn encode_slope(self, x: f32) -> f32 {
        match self {
            Self::Log => 2.0 * 8.0 / ((1.0 + 8.0 * x) * 9f32.ln()),
            Self::Srgb => 2.0 * srgb_slope(x),
        }
    }

    /// Derivative of [`Self::decode`] at z; 0 where it is clamped.
    pub fn decode_slope(self, z: f32) -> f32 {
        let x = self.decode(z);
        if x > 0.0 && x < MAX_RADIANCE { 1.0 / self.encode_slope(x) } else { 0.0 }
    }
}

/// Derivative of the sRGB transfer function at x > 0.
pub fn srgb_slope(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * x.powf(1.0 / 2.4 - 1.0) }
}

/// `z_t = (1 - t) z_0 + t z_1 + sigma sqrt(t (1 - t)) noise`, for one value.
pub fn interpolate(z0: f32, z1: f32, t: f32, noise: f32) -> f32 {
    (1.0 - t) * z0 + t * z1 + SIGMA * (t * (1.0 - t)).sqrt() * noise
}

/// Velocity `(z1_hat - z_t) / (1 - t)` of a predicted end point.
pub fn velocity(z1_hat: f32, z_t: f32, t: f32) -> f32 {
    (z1_hat - z_t) / (1.0 - t)
}
