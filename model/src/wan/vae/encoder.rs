//! The encoder, from pictures to moments.

use super::causal::{Cache, CausalConv};
use super::residual::{Middle, Residual};
use super::to_first;
use crate::ops::{self, Stride};
use crate::wan::activations;
use crate::wan::config::VaeConfig;
use crate::wan::init::{Init, Start};
use crate::wan::layers::ChannelNorm;
use crate::wan::names::{Layout, Listing};
use burn::module::{Module, Param};
use burn::tensor::{Tensor, activation};

/// A 3 x 3 convolution of pictures.
#[derive(Module, Debug)]
pub struct Conv {
    /// `[3, 3, channels in, channels out]`.
    pub weight: Param<Tensor<4>>,
    /// `[channels out]`.
    pub bias: Param<Tensor<1>>,
}

impl Conv {
    pub(super) fn new(init: &mut Init, from: usize, to: usize) -> Self {
        let std = (2.0 / (9 * from) as f32).sqrt();
        Self { weight: init.weight([3, 3, from, to], Start::Normal(std)), bias: init.offsets(9 * from, to) }
    }

    pub(super) fn forward(&self, x: Tensor<4>, stride: Stride) -> Tensor<4> {
        ops::conv(x, self.weight.val(), self.bias.val(), stride, false)
    }

    pub(super) fn list(&self, list: &mut Listing, name: &str) {
        list.push(&self.weight, format!("{name}.weight"), Layout::Kernel2);
        list.push(&self.bias, format!("{name}.bias"), Layout::Same);
    }
}

/// Halves height and width. With a convolution over time, it also halves the frame rate.
#[derive(Module, Debug)]
pub struct Down {
    conv: Conv,
    time: Option<CausalConv>,
}

impl Down {
    fn new(init: &mut Init, width: usize, temporal: bool) -> Self {
        Self { conv: Conv::new(init, width, width), time: temporal.then(|| CausalConv::new(init, 1, width, width)) }
    }

    /// `[b, t, h, w, c]` to `[b, t', h / 2, w / 2, c]`, sizes rounded down.
    fn forward(&self, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        let x = self.space(x);
        let Some(time) = &self.time else { return x };
        let first = cache.is_first();
        let with = cache.extend(x.clone(), 1);
        if first { x } else { time.strided(with, 2) }
    }

    fn space(&self, x: Tensor<5>) -> Tensor<5> {
        let [b, t, h, w, c] = x.dims();
        let y = self.conv.forward(x.reshape([b * t, h, w, c]), Stride::Half);
        y.reshape([b, t, h / 2, w / 2, c])
    }

    fn list(&self, list: &mut Listing, name: &str) {
        self.conv.list(list, &format!("{name}.resample.1"));
        if let Some(time) = &self.time {
            time.list(list, &format!("{name}.time_conv"));
        }
    }
}

/// One step of the encoder.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)] // A dozen of them in a network.
pub enum Step {
    /// Residual block.
    Residual(Residual),
    /// Reduction.
    Down(Down),
}

/// The encoder; see [`super`].
#[derive(Module, Debug)]
pub struct Encoder {
    conv_in: CausalConv,
    steps: Vec<Step>,
    middle: Middle,
    norm_out: ChannelNorm,
    conv_out: CausalConv,
}

impl Encoder {
    pub(super) fn new(init: &mut Init, config: &VaeConfig) -> Self {
        let conv_in = CausalConv::new(init, 3, config.in_channels, config.base_dim);
        let (mut steps, mut width) = (Vec::new(), config.base_dim);
        for (level, multiple) in config.dim_mult.iter().enumerate() {
            for _ in 0..config.num_res_blocks {
                steps.push(Step::Residual(Residual::new(init, width, multiple * config.base_dim)));
                width = multiple * config.base_dim;
            }
            if let Some(&temporal) = config.temporal_downsample.get(level) {
                steps.push(Step::Down(Down::new(init, width, temporal)));
            }
        }
        Self {
            conv_in,
            steps,
            middle: Middle::new(init, width),
            norm_out: ChannelNorm::new(init, width),
            conv_out: CausalConv::new(init, 3, width, 2 * config.z_dim),
        }
    }

    /// Encodes one chunk `[b, t, h, w, channels]` to `[b, 1, h / s, w / s, 2 z]`, channels-last. With a new cache, t is 1; then
    /// it is the number of frames that a latent frame spans.
    pub fn forward(&self, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        cache.begin();
        let mut x = self.conv_in.forward(x, cache);
        activations::report("enc.conv_in", || to_first(x.clone()));
        for (i, step) in self.steps.iter().enumerate() {
            x = match step {
                Step::Residual(residual) => residual.forward(x, cache),
                Step::Down(down) => down.forward(x, cache),
            };
            activations::report(&format!("enc.down_blocks.{i}"), || to_first(x.clone()));
        }
        let x = self.norm_out.forward(self.middle.forward(x, cache, "enc"));
        activations::report("enc.norm_out", || to_first(x.clone()));
        let x = self.conv_out.forward(activation::silu(x), cache);
        activations::report("enc.conv_out", || to_first(x.clone()));
        x
    }

    pub(super) fn list(&self, list: &mut Listing) {
        self.conv_in.list(list, "encoder.conv_in");
        for (i, step) in self.steps.iter().enumerate() {
            let name = format!("encoder.down_blocks.{i}");
            match step {
                Step::Residual(residual) => residual.list(list, &name),
                Step::Down(down) => down.list(list, &name),
            }
        }
        self.middle.list(list, "encoder.mid_block");
        self.norm_out.list(list, "encoder.norm_out", 3);
        self.conv_out.list(list, "encoder.conv_out");
    }
}
