//! Layers with parameters, on channels-last tensors; the arithmetic is in [`crate::ops`].

use super::init::Init;
use crate::ops::{self, Products, Stride};
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// 3 x 3 or 1 x 1 convolution.
#[derive(Module, Debug)]
pub struct Conv {
    /// `[k, k, channels in, channels out]`.
    pub weight: Param<Tensor<4>>,
    /// `[channels out]`.
    pub bias: Param<Tensor<1>>,
}

impl Conv {
    /// `gain` times He initialisation (He et al. 2015); gain 0 makes the layer return 0.
    pub fn new(init: &mut Init, k: usize, from: usize, to: usize, gain: f32) -> Self {
        let std = gain * (2.0 / (k * k * from) as f32).sqrt();
        Self { weight: init.normal([k, k, from, to], std), bias: init.constant([to], 0.0) }
    }

    /// `[b, h, w, channels in]` to `[b, h', w', channels out]`.
    pub fn forward(&self, x: Tensor<4>, stride: Stride, silu: bool) -> Tensor<4> {
        self.forward_by(Products::F32, x, stride, silu)
    }

    /// [`Self::forward`] with a choice of how it multiplies.
    pub fn forward_by(&self, products: Products, x: Tensor<4>, stride: Stride, silu: bool) -> Tensor<4> {
        ops::conv_by(products, x, self.weight.val(), self.bias.val(), stride, silu)
    }

    /// Decoder entry: `silu(conv(concat(up2(x), skip)))`.
    pub fn decode(&self, x: Tensor<4>, skip: Tensor<4>) -> Tensor<4> {
        self.decode_by(Products::F32, x, skip)
    }

    /// [`Self::decode`] with a choice of how it multiplies.
    pub fn decode_by(&self, products: Products, x: Tensor<4>, skip: Tensor<4>) -> Tensor<4> {
        ops::decode_by(products, x, skip, self.weight.val(), self.bias.val())
    }
}

/// Affine map of the last axis.
#[derive(Module, Debug)]
pub struct Dense {
    /// `[channels in, channels out]`.
    pub weight: Param<Tensor<2>>,
    /// `[channels out]`.
    pub bias: Param<Tensor<1>>,
}

impl Dense {
    /// `gain` times He initialisation; gain 0 makes the layer return 0.
    pub fn new(init: &mut Init, from: usize, to: usize, gain: f32) -> Self {
        Self { weight: init.normal([from, to], gain * (2.0 / from as f32).sqrt()), bias: init.constant([to], 0.0) }
    }

    /// `[b, n, channels in]` to `[b, n, channels out]`.
    pub fn forward(&self, x: Tensor<3>, silu: bool) -> Tensor<3> {
        ops::linear(x, self.weight.val(), self.bias.val(), silu)
    }
}

/// Layer normalisation with learned scale and shift (Ba et al. 2016).
#[derive(Module, Debug)]
pub struct Norm {
    /// `[channels]`.
    pub gamma: Param<Tensor<1>>,
    /// `[channels]`.
    pub beta: Param<Tensor<1>>,
}

impl Norm {
    /// Scale 1, shift 0.
    pub fn new(init: &Init, width: usize) -> Self {
        Self { gamma: init.constant([width], 1.0), beta: init.constant([width], 0.0) }
    }

    /// `[b, n, c]` to the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        burn::tensor::module::layer_norm(x, self.gamma.val(), Some(self.beta.val()), 1e-5)
    }
}

/// Adaptive modulation `(gamma + 1) f + beta` from a condition vector (the paper's environment modulation); the identity at first.
#[derive(Module, Debug)]
pub struct Modulation {
    /// Condition to `[gamma, beta]`.
    pub map: Dense,
}

impl Modulation {
    /// For features of `width` channels; zero-initialised.
    pub fn new(init: &mut Init, condition: usize, width: usize) -> Self {
        Self { map: Dense::new(init, condition, 2 * width, 0.0) }
    }

    /// `(1 + gamma, beta)`, each `[b, 1, width]`, of a condition `[b, 1, condition]`.
    pub fn factors(&self, condition: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let both = self.map.forward(condition, false);
        let width = both.dims()[2] / 2;
        (both.clone().narrow(2, 0, width).add_scalar(1.0), both.narrow(2, width, width))
    }

    /// Modulates a sequence `[b, n, width]`.
    pub fn sequence(&self, x: Tensor<3>, condition: Tensor<3>) -> Tensor<3> {
        let (gamma, beta) = self.factors(condition);
        x * gamma + beta
    }

    /// Modulates a picture `[b, h, w, width]`.
    pub fn picture(&self, x: Tensor<4>, condition: Tensor<3>) -> Tensor<4> {
        let (gamma, beta) = self.factors(condition);
        x * gamma.unsqueeze_dim(1) + beta.unsqueeze_dim(1)
    }
}

/// `x + conv(silu(conv(x)))`.
#[derive(Module, Debug)]
pub struct Residual {
    /// First convolution, with SiLU.
    pub first: Conv,
    /// Second convolution, small at first so that depth does not amplify the signal.
    pub second: Conv,
}

impl Residual {
    /// Keeps `width` channels.
    pub fn new(init: &mut Init, width: usize) -> Self {
        Self { first: Conv::new(init, 3, width, width, 1.0), second: Conv::new(init, 3, width, width, 0.3) }
    }

    /// `[b, h, w, width]` to the same shape.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let y = self.first.forward(x.clone(), Stride::One, true);
        x + self.second.forward(y, Stride::One, false)
    }
}
