//! The two stages of training: the base network, and the keyframe network on top of a frozen base.

use super::loss::{self, Loss, LossWeights};
use crate::config::NetworkConfig;
use crate::data::Batch;
use crate::keyframe::{self, KeyInputs, KeyframeNet};
use crate::network::{Network, unet::UNet};
use crate::parameters::to_vec;
use crate::tokens::{TOKEN_FEATURES, TOKENS};
use burn::module::Module;
use burn::tensor::{Device, Gradients, Tensor, TensorData};

/// What the loop needs of a stage.
pub trait Objective {
    /// The module that learns.
    type Model: Module;
    /// Loss of `model` on `batch` and the gradients of its parameters; tensors are made on `device`, which records them.
    fn gradients(&self, model: &Self::Model, batch: Batch, weights: LossWeights, device: &Device) -> (Loss, Gradients);
}

/// Continues a gradient that was computed on the host, of the loss with respect to `outputs`, to the parameters behind it.
fn backward(outputs: Tensor<4>, gradient: Vec<f32>, device: &Device) -> Gradients {
    let gradient = Tensor::<4>::from_data(TensorData::new(gradient, outputs.dims()), device);
    // The derivative of this sum with respect to `outputs` is `gradient`.
    (outputs * gradient).sum().backward()
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
    /// Noise of the bridge.
    pub sigma: f32,
}

struct NetworkInput {
    input: Tensor<4>,
    tokens: Tensor<3>,
    times: Tensor<3>,
}

/// Moves what the base network reads to `device`.
fn network_input(batch: &mut Batch, device: &Device) -> NetworkInput {
    let (items, half) = (batch.items, batch.size / 2);
    let channels = batch.input.len() / (items * half * half);
    let input = TensorData::new(std::mem::take(&mut batch.input), [items, half, half, channels]);
    let tokens = TensorData::new(std::mem::take(&mut batch.tokens), [items, TOKENS, TOKEN_FEATURES]);
    NetworkInput {
        input: Tensor::from_data(input, device),
        tokens: Tensor::from_data(tokens, device),
        times: Tensor::from_data(TensorData::new(batch.times.clone(), [items, 1, 1]), device),
    }
}

impl Objective for BaseStage {
    type Model = UNet;

    fn gradients(&self, model: &UNet, mut batch: Batch, weights: LossWeights, device: &Device) -> (Loss, Gradients) {
        let network = network_input(&mut batch, device);
        let outputs = model.forward(network.input, network.tokens, network.times);
        let values = to_vec(outputs.clone().without_autodiff());
        let (loss, gradient) = loss::base(self.config.start, self.config.curve, &values, &batch, weights);
        (loss, backward(outputs, gradient, device))
    }
}

impl Objective for KeyframeStage {
    type Model = KeyframeNet;

    fn gradients(&self, model: &KeyframeNet, mut batch: Batch, weights: LossWeights, device: &Device) -> (Loss, Gradients) {
        let plain = device.clone().without_autodiff();
        let (items, size) = (batch.items, batch.size);
        let picture = |values: Vec<f32>, channels: usize| {
            Tensor::<4>::from_data(TensorData::new(values, [items, size, size, channels]), &plain)
        };
        let config = self.base.config();

        // The base predicts from its own start; its time is always 0.
        let network = network_input(&mut batch, &plain);
        let channels = config.start.head_channels();
        let outputs = to_vec(self.base.base.forward(network.input, network.tokens, network.times.zeros_like()));
        let base = loss::predict(config.start, config.curve, &outputs, &batch);
        debug_assert_eq!(outputs.len(), items * size * size * channels);
        let inputs = KeyInputs {
            keys: picture(std::mem::take(&mut batch.keys), keyframe::CHANNELS),
            guides: picture(std::mem::take(&mut batch.guides), keyframe::GUIDES),
            base: picture(base, 3),
        };

        let time = network.times.unsqueeze_dim::<4>(3);
        let rest = time.clone().neg().add_scalar(1.0);
        let spread = (time.clone() * rest.clone()).sqrt().mul_scalar(self.sigma);
        let z1 = picture(batch.target.clone(), 6).narrow(3, 0, 3);
        let noise = picture(std::mem::take(&mut batch.noise), 3);
        let z_t = keyframe::start(&inputs) * rest + z1 * time.clone() + noise * spread;

        let tracked = |x: Tensor<4>| Tensor::from_inner(x);
        let inputs = KeyInputs { keys: tracked(inputs.keys), guides: tracked(inputs.guides), base: tracked(inputs.base) };
        let z = model.forward(&inputs, tracked(z_t), tracked(time));
        let (loss, gradient) = loss::direct(config.curve, &to_vec(z.clone().without_autodiff()), &batch, weights);
        (loss, backward(z, gradient, device))
    }
}
