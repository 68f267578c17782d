//! Renderers and their inputs at the size of unit tests.

use super::gradients::{tensor, waves};
use super::values;
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use renderflow_model::parameters;
use renderflow_model::wan::flow::{Conditions, Environment, Intrinsic, InverseConfig, KeyframeConfig, KeyframeLatent, Query};
use renderflow_model::wan::{Flow, FlowConfig};

/// A small renderer with both adapters.
pub fn config(query: Query, environment: Environment, lora_rank: usize) -> FlowConfig {
    let lora_alpha = 6.0;
    let inverse = InverseConfig { lora_rank, lora_alpha, prompts: 5, prompt_tokens: 3 };
    let config = FlowConfig { environment, ..FlowConfig::tiny() };
    config.with_keyframes(KeyframeConfig { query, lora_rank, lora_alpha }).with_inverse(inverse)
}

/// `network` with values in place of the zeros its adapters begin with, so that nothing is hidden by them.
pub fn warmed<M: Module>(network: M, device: &Device) -> M {
    let mut all = parameters::export(&network);
    for (i, parameter) in all.iter_mut().enumerate() {
        if parameter.values.iter().all(|&v| v == 0.0) {
            parameter.values = waves(parameter.values.len(), 0.3 + i as f32 * 0.17).iter().map(|v| 0.15 * v).collect();
        }
    }
    let values: Vec<&[f32]> = all.iter().map(|p| p.values.as_slice()).collect();
    parameters::import(network, &values, device)
}

/// A renderer of `config` in which every part acts.
pub fn warm(config: &FlowConfig, device: &Device) -> Flow {
    warmed(Flow::new(config, 3, device).expect("network"), device)
}

/// Latents of a clip.
pub fn latents([b, f, h, w]: [usize; 4], device: &Device) -> Tensor<5> {
    tensor([b, 4, f, h, w], 0.1, device)
}

/// Conditions of a clip of [`latents`], with keyframes at these times.
pub fn conditions(config: &FlowConfig, [b, f, h, w]: [usize; 4], keyframes: &[f64], device: &Device) -> Conditions {
    let size = if config.environment == Environment::Tokens { [h, w] } else { [2, 4] };
    Conditions {
        attributes: tensor([b, config.attribute_channels(), f, h, w], 0.2, device),
        environment: tensor([b, 4, f, size[0], size[1]], 0.3, device),
        keyframes: keyframes
            .iter()
            .enumerate()
            .map(|(i, &time)| KeyframeLatent { latent: tensor([b, 4, 1, h, w], 0.4 + i as f32, device), time })
            .collect(),
    }
}

/// Clips, latent frames, rows and columns.
pub const CLIP: [usize; 4] = [2, 2, 4, 6];
/// Times of the clips.
pub const TIMES: [f64; 2] = [0.0, 0.25];

/// Both variants of everything that has two.
pub fn both() -> [FlowConfig; 2] {
    [config(Query::Dedicated, Environment::Pooled, 3), config(Query::Reused, Environment::Tokens, 0)]
}

/// Velocity of the clips.
pub fn velocity(flow: &Flow, conditions: &Conditions) -> Vec<f32> {
    let z_t = latents(CLIP, &Device::flex());
    values(flow.velocity(z_t, &TIMES, conditions).expect("renders")).values
}

/// Latents behind the clips.
pub fn invert(flow: &Flow, intrinsic: Intrinsic) -> Vec<f32> {
    let z_t = latents(CLIP, &Device::flex());
    values(flow.invert(z_t, &TIMES, intrinsic).expect("inverts")).values
}

/// Largest difference over the largest value.
pub fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert!(a.len() == b.len() && a.iter().chain(b).all(|v| v.is_finite()));
    let largest = b.iter().fold(0.0f32, |most, v| most.max(v.abs()));
    a.iter().zip(b).fold(0.0f32, |most, (a, b)| most.max((a - b).abs())) / largest
}
