//! The training objective on one batch.
//!
//! `L = |z1_hat - z_1|^2 + display_weight * |display error|^2 + gradient_weight * |difference of display gradients|_1`, each a mean
//! over covered pixels. The first term is the bridge-matching loss on the velocity times `(1 - t)^2`: predicting `z1_hat`, the plain
//! velocity loss would weigh t = 0.75 sixteen times as much as t = 0, the only time used by single-step inference.

use crate::bridge::srgb_tensor;
use crate::network::heads::Prediction;
use burn::tensor::Tensor;
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

/// The parts of the loss, scalars on the device.
pub struct Loss {
    /// What is minimised.
    pub total: Tensor<1>,
    /// Squared error in z.
    pub bridge: Tensor<1>,
    /// Squared display error: PSNR is `-10 log10` of it.
    pub display: Tensor<1>,
    /// Absolute difference of gradients.
    pub gradient: Tensor<1>,
}

/// `z1` and `display` `[b, h, w, 3]`, `mask` `[b, h, w, 1]` with 1 where a pixel counts. A batch without such a pixel has loss 0.
pub fn loss(prediction: Prediction, z1: Tensor<4>, display: Tensor<4>, mask: Tensor<4>, weights: LossWeights) -> Loss {
    let [_, h, w, _] = z1.dims();
    let mean = |picture: Tensor<4>, mask: Tensor<4>| {
        let count = mask.clone().sum().mul_scalar(3.0).clamp_min(1.0);
        (picture * mask).sum() / count
    };
    let bridge = mean((prediction.z - z1).square(), mask.clone());
    let error = srgb_tensor(prediction.x.clamp(0.0, 1.0)) - display;
    // The gradient of a difference is the difference of gradients.
    let along = |dim: usize, length: usize| {
        let difference = error.clone().narrow(dim, 1, length - 1) - error.clone().narrow(dim, 0, length - 1);
        mean(difference.abs(), mask.clone().narrow(dim, 1, length - 1) * mask.clone().narrow(dim, 0, length - 1))
    };
    let gradient = along(1, h) + along(2, w);
    let display = mean(error.square(), mask);
    let total = bridge.clone() + display.clone().mul_scalar(weights.display) + gradient.clone().mul_scalar(weights.gradient);
    Loss { total, bridge, display, gradient }
}
