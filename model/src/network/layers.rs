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
    /// He initialisation (He et al. 2015) times `gain`. With gain 0, the layer returns 0.
    pub fn new(init: &mut Init, k: usize, from: usize, to: usize, gain: f32) -> Self {
        let std = gain * (2.0 / (k * k * from) as f32).sqrt();
        Self { weight: init.normal([k, k, from, to], std), bias: init.constant([to], 0.0) }
    }

    /// `[b, h, w, channels in]` to `[b, h', w', channels out]`.
    pub fn forward(&self, products: Products, x: Tensor<4>, stride: Stride, silu: bool) -> Tensor<4> {
        ops::conv_by(products, x, self.weight.val(), self.bias.val(), stride, silu)
    }

    /// `silu(conv(concat(up2(x), skip)))`, the first layer of a decoder stage.
    pub fn decode(&self, products: Products, x: Tensor<4>, skip: Tensor<4>) -> Tensor<4> {
        ops::decode(products, x, skip, self.weight.val(), self.bias.val())
    }
}
