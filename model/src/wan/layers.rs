//! Layers of the autoencoder and the transformer, on channels-last tensors. The arithmetic is in [`crate::ops`].

use super::init::{Init, Start};
use super::names::{Layout, Listing};
use crate::ops;
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// Affine map of the last axis.
#[derive(Module, Debug)]
pub struct Dense {
    /// `[channels in, channels out]`.
    pub weight: Param<Tensor<2>>,
    /// `[channels out]`.
    pub bias: Param<Tensor<1>>,
}

impl Dense {
    /// Glorot-initialised weights and a bias of 0.
    pub fn new(init: &mut Init, from: usize, to: usize) -> Self {
        Self { weight: init.matrix(from, to), bias: init.zeros(to) }
    }

    /// A layer that returns 0 before training.
    pub fn zero(init: &mut Init, from: usize, to: usize) -> Self {
        Self { weight: init.weight([from, to], Start::Constant(0.0)), bias: init.zeros(to) }
    }

    /// Another layer that begins with the same values.
    pub fn copy(&self) -> Self {
        Self { weight: Param::from_tensor(self.weight.val().detach()), bias: Param::from_tensor(self.bias.val().detach()) }
    }

    /// `[b, n, channels in]` to `[b, n, channels out]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        ops::linear(x, self.weight.val(), self.bias.val(), false)
    }

    /// [`Self::forward`] and SiLU.
    pub fn forward_silu(&self, x: Tensor<3>) -> Tensor<3> {
        ops::linear(x, self.weight.val(), self.bias.val(), true)
    }

    /// Maps every pixel of a clip: `[.., channels in]` to `[.., channels out]`.
    pub fn clip(&self, x: Tensor<5>) -> Tensor<5> {
        let [b, t, h, w, c] = x.dims();
        let y = self.forward(x.reshape([b, t * h * w, c]));
        let c = y.dims()[2];
        y.reshape([b, t, h, w, c])
    }

    /// Lists the tensors under `name`. In files, the weight is `[channels out, inner..]`, and the product of `inner` is the input
    /// channels.
    pub fn list(&self, list: &mut Listing, name: &str, inner: &[usize]) {
        list.push(&self.weight, format!("{name}.weight"), Layout::Matrix { inner: inner.to_vec() });
        list.push(&self.bias, format!("{name}.bias"), Layout::Same);
    }

    /// Lists the tensors of a plain matrix.
    pub fn list_plain(&self, list: &mut Listing, name: &str) {
        let from = self.weight.lazy_shape()[0];
        self.list(list, name, &[from]);
    }
}

/// Divides the channels of a pixel by their Euclidean norm, and multiplies them by `sqrt(channels)` and a learned factor per
/// channel.
#[derive(Module, Debug)]
pub struct ChannelNorm {
    /// `[channels]`.
    pub gamma: Param<Tensor<1>>,
}

impl ChannelNorm {
    /// Factors of 1.
    pub fn new(init: &mut Init, width: usize) -> Self {
        Self { gamma: init.weight([width], Start::Constant(1.0)) }
    }

    /// `[b, t, h, w, c]` to the same shape.
    pub fn forward(&self, x: Tensor<5>) -> Tensor<5> {
        ops::channel_norm(x, self.gamma.val(), false)
    }

    /// [`Self::forward`] and SiLU.
    pub fn forward_silu(&self, x: Tensor<5>) -> Tensor<5> {
        ops::channel_norm(x, self.gamma.val(), true)
    }

    /// Lists the tensor under `name`. In files, `ones` axes of length 1 follow the channels.
    pub fn list(&self, list: &mut Listing, name: &str, ones: usize) {
        list.push(&self.gamma, format!("{name}.gamma"), Layout::Vector { ones });
    }
}

/// Divides a token by the root mean square of its channels (Zhang and Sennrich 2019), and multiplies by a learned factor per
/// channel.
#[derive(Module, Debug)]
pub struct RmsNorm {
    /// `[channels]`.
    pub weight: Param<Tensor<1>>,
    #[module(skip)]
    eps: f64,
}

impl RmsNorm {
    /// Factors of 1.
    pub fn new(init: &mut Init, width: usize, eps: f64) -> Self {
        Self { weight: init.weight([width], Start::Constant(1.0)), eps }
    }

    /// `[b, n, c]` to the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        ops::rms_norm(x, self.weight.val(), self.eps as f32)
    }

    /// Lists the tensor under `name`.
    pub fn list(&self, list: &mut Listing, name: &str) {
        list.push(&self.weight, format!("{name}.weight"), Layout::Same);
    }
}

/// Layer normalisation with learned scale and shift (Ba et al. 2016).
#[derive(Module, Debug)]
pub struct LayerNorm {
    /// `[channels]`.
    pub weight: Param<Tensor<1>>,
    /// `[channels]`.
    pub bias: Param<Tensor<1>>,
    #[module(skip)]
    eps: f64,
}

impl LayerNorm {
    /// A scale of 1 and a shift of 0.
    pub fn new(init: &mut Init, width: usize, eps: f64) -> Self {
        Self { weight: init.weight([width], Start::Constant(1.0)), bias: init.zeros(width), eps }
    }

    /// `[b, n, c]` to the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let [b, _, c] = x.dims();
        let of = |values: Tensor<1>| values.reshape([1, 1, c]).expand([b, 1, c]);
        ops::modulate(x, of(self.weight.val()), of(self.bias.val()), Some(self.eps as f32))
    }

    /// Lists the tensors under `name`.
    pub fn list(&self, list: &mut Listing, name: &str) {
        list.push(&self.weight, format!("{name}.weight"), Layout::Same);
        list.push(&self.bias, format!("{name}.bias"), Layout::Same);
    }
}

/// `norm(x) (1 + scale) + shift`, where the layer normalisation has no weights.
///
/// `x` `[b, n, c]`, `scale` and `shift` `[b, 1, c]`.
pub fn modulated_norm(x: Tensor<3>, scale: Tensor<3>, shift: Tensor<3>, eps: f64) -> Tensor<3> {
    ops::modulate(x, scale.add_scalar(1.0), shift, Some(eps as f32))
}
