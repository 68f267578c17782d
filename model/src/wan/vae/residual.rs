//! Blocks of encoder and decoder: the residual block, attention within a frame, and the middle block, which has both.

use super::causal::{Cache, CausalConv};
use crate::ops;
use crate::wan::activations;
use crate::wan::init::Init;
use crate::wan::layers::{ChannelNorm, Dense};
use crate::wan::names::Listing;
use burn::module::Module;
use burn::tensor::Tensor;

/// Normalisation, SiLU and convolution, twice, added to the input. If the number of channels changes, a point-wise layer maps the
/// input.
#[derive(Module, Debug)]
pub struct Residual {
    norm1: ChannelNorm,
    conv1: CausalConv,
    norm2: ChannelNorm,
    conv2: CausalConv,
    shortcut: Option<Dense>,
}

impl Residual {
    pub fn new(init: &mut Init, from: usize, to: usize) -> Self {
        Self {
            norm1: ChannelNorm::new(init, from),
            conv1: CausalConv::new(init, 3, from, to),
            norm2: ChannelNorm::new(init, to),
            conv2: CausalConv::new(init, 3, to, to),
            shortcut: (from != to).then(|| Dense::new(init, from, to)),
        }
    }

    /// `[b, t, h, w, from]` to `[b, t, h, w, to]`.
    pub fn forward(&self, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        let y = self.conv1.forward(self.norm1.forward_silu(x.clone()), cache);
        let y = self.conv2.forward(self.norm2.forward_silu(y), cache);
        match &self.shortcut {
            Some(shortcut) => shortcut.clip(x) + y,
            None => x + y,
        }
    }

    pub fn list(&self, list: &mut Listing, name: &str) {
        self.norm1.list(list, &format!("{name}.norm1"), 3);
        self.conv1.list(list, &format!("{name}.conv1"));
        self.norm2.list(list, &format!("{name}.norm2"), 3);
        self.conv2.list(list, &format!("{name}.conv2"));
        if let Some(shortcut) = &self.shortcut {
            let from = shortcut.weight.lazy_shape()[0];
            shortcut.list(list, &format!("{name}.conv_shortcut"), &[from, 1, 1, 1]);
        }
    }
}

/// Self-attention among the pixels of each frame, with one head.
#[derive(Module, Debug)]
pub struct FrameAttention {
    norm: ChannelNorm,
    qkv: Dense,
    proj: Dense,
}

impl FrameAttention {
    pub fn new(init: &mut Init, width: usize) -> Self {
        Self {
            norm: ChannelNorm::new(init, width),
            qkv: Dense::new(init, width, 3 * width),
            proj: Dense::new(init, width, width),
        }
    }

    /// `[b, t, h, w, c]` to the same shape.
    pub fn forward(&self, x: Tensor<5>) -> Tensor<5> {
        let [b, t, h, w, c] = x.dims();
        let qkv = self.qkv.forward(self.norm.forward(x.clone()).reshape([b * t, h * w, c]));
        let part = |i: usize| qkv.clone().narrow(2, i * c, c);
        let y = self.proj.forward(ops::attention(part(0), part(1), part(2), 1));
        x + y.reshape([b, t, h, w, c])
    }

    fn list(&self, list: &mut Listing, name: &str) {
        let width = self.proj.weight.lazy_shape()[0];
        self.norm.list(list, &format!("{name}.norm"), 2);
        self.qkv.list(list, &format!("{name}.to_qkv"), &[width, 1, 1]);
        self.proj.list(list, &format!("{name}.proj"), &[width, 1, 1]);
    }
}

/// The middle block: residual block, attention, residual block.
#[derive(Module, Debug)]
pub struct Middle {
    first: Residual,
    attention: FrameAttention,
    second: Residual,
}

impl Middle {
    pub fn new(init: &mut Init, width: usize) -> Self {
        Self {
            first: Residual::new(init, width, width),
            attention: FrameAttention::new(init, width),
            second: Residual::new(init, width, width),
        }
    }

    /// `[b, t, h, w, c]` to the same shape; reports as `<side>.mid_attn` and `<side>.mid_block`.
    pub fn forward(&self, x: Tensor<5>, cache: &mut Cache, side: &str) -> Tensor<5> {
        let x = self.attention.forward(self.first.forward(x, cache));
        activations::report(&format!("{side}.mid_attn"), || super::to_first(x.clone()));
        let x = self.second.forward(x, cache);
        activations::report(&format!("{side}.mid_block"), || super::to_first(x.clone()));
        x
    }

    pub fn list(&self, list: &mut Listing, name: &str) {
        self.first.list(list, &format!("{name}.resnets.0"));
        self.attention.list(list, &format!("{name}.attentions.0"));
        self.second.list(list, &format!("{name}.resnets.1"));
    }
}
