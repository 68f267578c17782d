//! From what the network predicts to a picture: the three demodulated heads of the `ibl` start, or one residual.

use crate::config::{Curve, Start};

/// Exponents of the multiplicative heads are clamped to +- this: a factor of 55 either way.
pub const MAX_EXPONENT: f32 = 4.0;

/// What the heads of one pixel act on, in exposed linear radiance and weighted by coverage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BasePixel {
    /// `alpha * diffuse * irradiance`.
    pub lit: [f32; 3],
    /// `alpha * specular`.
    pub specular: [f32; 3],
    /// `alpha * (albedo + f0)`: what the additive head is multiplied by.
    pub tint: [f32; 3],
    /// `(1 - alpha) * background`.
    pub rest: [f32; 3],
    /// Exposed radiance of the start picture.
    pub start: [f32; 3],
    /// Coverage.
    pub alpha: f32,
}

/// Applies the head outputs of one pixel: exposed linear radiance, >= 0. Outputs of 0 give the start; NaN counts as 0.
pub fn apply_pixel(start: Start, curve: Curve, heads: &[f32], base: &BasePixel) -> [f32; 3] {
    let head = |i: usize| if heads[i].is_nan() { 0.0 } else { heads[i] };
    let exponential = |i: usize| head(i).clamp(-MAX_EXPONENT, MAX_EXPONENT).exp();
    std::array::from_fn(|c| match start {
        Start::Ibl => {
            let surface = base.lit[c] * exponential(c) + base.specular[c] * exponential(3 + c) + base.tint[c] * head(6 + c);
            (surface + base.rest[c]).clamp(0.0, crate::bridge::MAX_RADIANCE)
        }
        Start::Albedo | Start::AlbedoIrradiance => {
            let residual = base.alpha * head(c);
            // Without a residual the start comes out as it is, not after a round trip through the curve.
            if residual == 0.0 { base.start[c] } else { curve.decode(curve.encode(base.start[c]) + residual) }
        }
    })
}
