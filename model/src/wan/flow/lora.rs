//! Low-rank corrections of frozen layers (Hu et al. 2022).

use crate::ops;
use crate::wan::init::{Init, Start};
use crate::wan::layers::Dense;
use crate::wan::names::{Layout, Listing};
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// Adds `alpha / rank x A B` to the output of a [`Dense`] layer for `x`. It adds 0 before training.
#[derive(Module, Debug)]
pub struct Lora {
    /// A, `[channels in, rank]`.
    pub down: Param<Tensor<2>>,
    /// B, `[rank, channels out]`; 0 before training.
    pub up: Param<Tensor<2>>,
    #[module(skip)]
    scale: f32,
}

impl Lora {
    /// A correction that is 0 before training.
    pub fn new(init: &mut Init, [from, to]: [usize; 2], rank: usize, alpha: f32) -> Self {
        Self {
            // The uniform values that the authors' code draws have this variance.
            down: init.weight([from, rank], Start::Normal((3.0 * from as f32).powf(-0.5))),
            up: init.weight([rank, to], Start::Constant(0.0)),
            scale: alpha / rank as f32,
        }
    }

    /// A correction for each of `layers` (input channels, output channels), or `None` for rank 0.
    pub(super) fn several<const N: usize>(
        init: &mut Init,
        layers: [[usize; 2]; N],
        rank: usize,
        alpha: f32,
    ) -> Option<[Self; N]> {
        (rank > 0).then(|| layers.map(|layer| Self::new(init, layer, rank, alpha)))
    }

    /// The correction `[b, n, channels out]` for `x` `[b, n, channels in]`.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        let (down, up) = (self.down.val(), self.up.val());
        let ([_, rank], [_, to], device) = (down.dims(), up.dims(), x.device());
        let x = ops::linear(x, down, Tensor::zeros([rank], &device), false);
        // Scaling costs least between the two matrices.
        let x = if self.scale == 1.0 { x } else { x.mul_scalar(self.scale) };
        ops::linear(x, up, Tensor::zeros([to], &device), false)
    }

    /// The corrected output of `dense` for `x` `[b, n, channels in]`.
    pub fn beside(&self, dense: &Dense, x: Tensor<3>) -> Tensor<3> {
        dense.forward(x.clone()) + self.forward(x)
    }

    /// `dense` with the correction added to its weights. The output is the same up to rounding, at the cost of `dense` alone.
    pub fn merged(&self, dense: Dense) -> Dense {
        let correction = self.down.val().matmul(self.up.val()).mul_scalar(self.scale);
        Dense { weight: dense.weight.map(|weight| weight + correction), bias: dense.bias }
    }

    /// Lists the tensors under peft's names for the layer `name`.
    pub(super) fn list(&self, list: &mut Listing, name: &str) {
        let matrix = |param: &Param<Tensor<2>>| Layout::Matrix { inner: vec![param.lazy_shape()[0]] };
        list.push(&self.down, format!("{name}.lora_A.weight"), matrix(&self.down));
        list.push(&self.up, format!("{name}.lora_B.weight"), matrix(&self.up));
    }
}
