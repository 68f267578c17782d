//! From what the network predicts to a picture: the three demodulated heads of the `ibl` start, or one residual.

use crate::config::{Curve, NetworkConfig, Start};
use burn::tensor::Tensor;

/// Exponents of the multiplicative heads are clamped to +- this: a factor of 55 either way.
pub const MAX_EXPONENT: f32 = 4.0;

/// What the heads act on, each `[b, h, w, 3]`, in exposed linear radiance and weighted by coverage.
#[derive(Clone, Debug)]
pub struct Base {
    /// `alpha * diffuse * irradiance`.
    pub lit: Tensor<4>,
    /// `alpha * specular`.
    pub specular: Tensor<4>,
    /// `alpha * (albedo + f0)`: what the additive head is multiplied by.
    pub tint: Tensor<4>,
    /// `(1 - alpha) * background`.
    pub rest: Tensor<4>,
    /// The bridge's start `z_0`.
    pub z0: Tensor<4>,
    /// Coverage `[b, h, w, 1]`.
    pub alpha: Tensor<4>,
}

/// A predicted picture, `[b, h, w, 3]`.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The bridge's end point `z1_hat`.
    pub z: Tensor<4>,
    /// Exposed linear radiance, >= 0.
    pub x: Tensor<4>,
}

/// Applies head outputs `[b, h, w, head_channels]` to `base`. Outputs of 0 give the start picture.
pub fn apply(config: &NetworkConfig, heads: Tensor<4>, base: &Base) -> Prediction {
    match config.start {
        Start::Ibl => {
            let exponent = |from: usize| heads.clone().narrow(3, from, 3).clamp(-MAX_EXPONENT, MAX_EXPONENT).exp();
            let surface = base.lit.clone() * exponent(0)
                + base.specular.clone() * exponent(3)
                + base.tint.clone() * heads.clone().narrow(3, 6, 3);
            let x = (surface + base.rest.clone()).clamp_min(0.0);
            Prediction { z: config.curve.encode_tensor(x.clone()), x }
        }
        Start::Albedo | Start::AlbedoIrradiance => {
            let z = base.z0.clone() + heads * base.alpha.clone();
            Prediction { x: config.curve.decode_tensor(z.clone()), z }
        }
    }
}

/// One pixel of [`Base`], on the host.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BasePixel {
    /// See [`Base::lit`].
    pub lit: [f32; 3],
    /// See [`Base::specular`].
    pub specular: [f32; 3],
    /// See [`Base::tint`].
    pub tint: [f32; 3],
    /// See [`Base::rest`].
    pub rest: [f32; 3],
    /// Exposed radiance of the start picture.
    pub start: [f32; 3],
    /// Coverage.
    pub alpha: f32,
}

/// [`apply`] for one pixel: exposed linear radiance, >= 0. NaN in `heads` counts as 0.
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
