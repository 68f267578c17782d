//! The environment as the network sees it: tokens in view space, and one pooled condition vector with the bridge time.

use super::init::Init;
use super::layers::Dense;
use crate::config::NetworkConfig;
use crate::tokens::TOKEN_FEATURES;
use burn::module::Module;
use burn::tensor::Tensor;

/// Sines and cosines that describe the bridge time.
const TIME_FEATURES: usize = 8;

/// Embeds environment tokens and time.
#[derive(Module, Debug)]
pub struct EnvironmentAdapter {
    /// First layer on each token.
    pub first: Dense,
    /// Second layer on each token.
    pub second: Dense,
    /// Pooled tokens and time to the condition, first layer.
    pub pool_first: Dense,
    /// Second layer.
    pub pool_second: Dense,
}

impl EnvironmentAdapter {
    /// Random weights.
    pub fn new(init: &mut Init, config: &NetworkConfig) -> Self {
        let (c, v) = (config.token_width, config.condition_width);
        Self {
            first: Dense::new(init, TOKEN_FEATURES, c, 1.0),
            second: Dense::new(init, c, c, 0.7),
            pool_first: Dense::new(init, c + TIME_FEATURES, v, 1.0),
            pool_second: Dense::new(init, v, v, 1.0),
        }
    }

    /// `tokens` `[b, m, TOKEN_FEATURES]`, `t` `[b, 1, 1]` in 0..1. Returns embedded tokens `[b, m, c]` and the condition `[b, 1, v]`.
    pub fn forward(&self, tokens: Tensor<3>, t: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let embedded = self.second.forward(self.first.forward(tokens, true), false);
        let mut features = vec![embedded.clone().mean_dim(1)];
        for octave in 0..TIME_FEATURES / 2 {
            let angle = t.clone().mul_scalar(0.5 * std::f32::consts::PI * (1 << octave) as f32);
            features.push(angle.clone().sin());
            features.push(angle.cos());
        }
        let condition = self.pool_first.forward(Tensor::cat(features, 2), true);
        (embedded, self.pool_second.forward(condition, true))
    }
}
