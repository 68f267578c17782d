//! Embeddings of time and text.

use crate::ops;
use crate::wan::config::{DitConfig, Gelu};
use crate::wan::init::Init;
use crate::wan::layers::Dense;
use crate::wan::names::Listing;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData, activation};

/// Sinusoidal embedding of times, `[b, 1, length]`: `cos(t w_i)` and then `sin(t w_i)`, with `w_i = 10000^(-i / half)` and half =
/// `length / 2`.
///
/// Angles are computed in f64, as in the original code: at t = 1000, an angle in f32 makes the fifth digit of its sine wrong.
pub fn sinusoid(times: &[f64], length: usize, device: &Device) -> Tensor<3> {
    let half = length / 2;
    let mut values = Vec::with_capacity(times.len() * length);
    for &t in times {
        let angle = |i: usize| t * (-(i as f64) / half as f64 * 10_000f64.ln()).exp();
        values.extend((0..half).map(|i| angle(i).cos() as f32));
        values.extend((0..half).map(|i| angle(i).sin() as f32));
    }
    Tensor::from_data(TensorData::new(values, [times.len(), 1, length]), device)
}

/// From the time to the modulation of blocks and head.
#[derive(Module, Debug)]
pub struct TimeEmbed {
    linear_1: Dense,
    linear_2: Dense,
    proj: Dense,
}

impl TimeEmbed {
    pub(super) fn new(init: &mut Init, config: &DitConfig) -> Self {
        let width = config.width();
        Self {
            linear_1: Dense::new(init, config.freq_dim, width),
            linear_2: Dense::new(init, width, width),
            proj: Dense::new(init, width, 6 * width),
        }
    }

    /// The embedded time `[b, 1, width]` and the modulation of the blocks `[b, 6, width]`, from a sinusoidal embedding `[b, 1,
    /// freq_dim]`.
    pub fn forward(&self, waves: Tensor<3>) -> (Tensor<3>, Tensor<3>) {
        let time = self.linear_2.forward(self.linear_1.forward_silu(waves));
        let modulation = self.proj.forward(activation::silu(time.clone()));
        let [b, _, width] = time.dims();
        (time, modulation.reshape([b, 6, width]))
    }

    pub(super) fn list(&self, list: &mut Listing, name: &str) {
        self.linear_1.list_plain(list, &format!("{name}.time_embedder.linear_1"));
        self.linear_2.list_plain(list, &format!("{name}.time_embedder.linear_2"));
        self.proj.list_plain(list, &format!("{name}.time_proj"));
    }
}

/// From text tokens to tokens of the transformer's width.
#[derive(Module, Debug)]
pub struct TextEmbed {
    linear_1: Dense,
    linear_2: Dense,
    #[module(skip)]
    activation: Gelu,
}

impl TextEmbed {
    pub(super) fn new(init: &mut Init, text_dim: usize, config: &DitConfig) -> Self {
        let width = config.width();
        Self {
            linear_1: Dense::new(init, text_dim, width),
            linear_2: Dense::new(init, width, width),
            activation: config.activation,
        }
    }

    /// Channels of a text token.
    pub fn text_dim(&self) -> usize {
        self.linear_1.weight.lazy_shape()[0]
    }

    /// Embeds text tokens: `[b, n, text_dim]` to `[b, n, width]`.
    pub fn forward(&self, text: Tensor<3>) -> Tensor<3> {
        self.linear_2.forward(self.activation.apply(self.linear_1.forward(text)))
    }

    pub(super) fn list(&self, list: &mut Listing, name: &str) {
        self.linear_1.list_plain(list, &format!("{name}.linear_1"));
        self.linear_2.list_plain(list, &format!("{name}.linear_2"));
    }
}

impl Gelu {
    /// Applies the function to every value (Hendrycks and Gimpel 2016).
    pub fn apply<const D: usize>(self, x: Tensor<D>) -> Tensor<D> {
        match self {
            Self::Tanh => ops::gelu(x),
            Self::Erf => activation::gelu(x),
        }
    }
}
