//! The two stages of training: the base network, and the keyframe network on top of a frozen base.

use super::loss::{Loss, LossWeights, loss};
use crate::bridge::SIGMA;
use crate::config::NetworkConfig;
use crate::data::{BASE_CHANNELS, Batch};
use crate::keyframe::{self, KeyInputs, KeyframeNet};
use crate::network::heads::{self, Base, Prediction};
use crate::network::{Network, unet::UNet};
use crate::tokens::{TOKEN_FEATURES, TOKENS};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

/// What the loop needs of a stage.
pub trait Objective {
    /// The module that learns.
    type Model: Module;
    /// Loss of `model` on `batch`; tensors are made on `device`, which records gradients.
    fn loss(&self, model: &Self::Model, batch: Batch, weights: LossWeights, device: &Device) -> Loss;
}

/// Stage 1.
pub struct BaseStage {
    /// The network's configuration.
    pub config: NetworkConfig,
}

/// Stage 2: the base runs without gradient.
pub struct KeyframeStage {
    /// The frozen network, on a device that records no gradients.
    pub base: Network,
}

struct BatchTensors {
    input: Tensor<4>,
    tokens: Tensor<3>,
    times: Tensor<3>,
    base: Base,
    z1: Tensor<4>,
    display: Tensor<4>,
    mask: Tensor<4>,
}

/// Moves the pictures of a batch to `device`.
fn tensors(batch: Batch, device: &Device) -> BatchTensors {
    let Batch { items, size, .. } = batch;
    let picture = |values: Vec<f32>| {
        let channels = values.len() / (items * size * size);
        Tensor::<4>::from_data(TensorData::new(values, [items, size, size, channels]), device)
    };
    let half = size / 2;
    let channels = batch.input.len() / (items * half * half);
    let base = picture(batch.base);
    debug_assert_eq!(base.dims()[3], BASE_CHANNELS);
    let part = |i: usize| base.clone().narrow(3, 3 * i, 3);
    let target = picture(batch.target);
    BatchTensors {
        input: Tensor::from_data(TensorData::new(batch.input, [items, half, half, channels]), device),
        tokens: Tensor::from_data(TensorData::new(batch.tokens, [items, TOKENS, TOKEN_FEATURES]), device),
        times: Tensor::from_data(TensorData::new(batch.times, [items, 1, 1]), device),
        base: Base { lit: part(0), specular: part(1), tint: part(2), rest: part(3), z0: part(4), alpha: picture(batch.alpha) },
        z1: target.clone().narrow(3, 0, 3),
        display: target.narrow(3, 3, 3),
        mask: picture(batch.mask),
    }
}

impl Objective for BaseStage {
    type Model = UNet;

    fn loss(&self, model: &UNet, batch: Batch, weights: LossWeights, device: &Device) -> Loss {
        let t = tensors(batch, device);
        let outputs = crate::network::shuffle(model.forward(t.input, t.tokens, t.times));
        let prediction = heads::apply(&self.config, outputs, &t.base);
        loss(prediction, t.z1, t.display, t.mask, weights)
    }
}

impl Objective for KeyframeStage {
    type Model = KeyframeNet;

    fn loss(&self, model: &KeyframeNet, mut batch: Batch, weights: LossWeights, device: &Device) -> Loss {
        let plain = device.clone().without_autodiff();
        let (items, size) = (batch.items, batch.size);
        let picture = |values: &mut Vec<f32>, channels: usize| {
            Tensor::<4>::from_data(TensorData::new(std::mem::take(values), [items, size, size, channels]), &plain)
        };
        let keys = picture(&mut batch.keys, keyframe::CHANNELS);
        let guides = picture(&mut batch.guides, keyframe::GUIDES);
        let noise = picture(&mut batch.noise, 3);
        let t = tensors(batch, &plain);
        let time = t.times.clone().unsqueeze_dim::<4>(3);

        // The base predicts from its own start; its time is always 0.
        let outputs = self.base.heads(t.input, t.tokens, t.times.zeros_like());
        let base = heads::apply(self.base.config(), outputs, &t.base).z;
        let inputs = KeyInputs { keys, guides, base };
        let z0 = keyframe::start(&inputs);
        let rest = time.clone().neg().add_scalar(1.0);
        let spread = (time.clone() * rest.clone()).sqrt().mul_scalar(SIGMA);
        let z_t = z0 * rest + t.z1.clone() * time.clone() + noise * spread;

        let tracked = |x: Tensor<4>| Tensor::from_inner(x);
        let inputs = KeyInputs { keys: tracked(inputs.keys), guides: tracked(inputs.guides), base: tracked(inputs.base) };
        let z = model.forward(&inputs, tracked(z_t), tracked(time));
        let x = self.base.config().curve.decode_tensor(z.clone());
        loss(Prediction { z, x }, tracked(t.z1), tracked(t.display), tracked(t.mask), weights)
    }
}
