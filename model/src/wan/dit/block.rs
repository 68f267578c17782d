//! One block: modulated self-attention, cross-attention to the text, modulated perceptron, each added to the tokens.

use super::Prepared;
use super::rope::Rope;
use crate::ops;
use crate::wan::config::{DitConfig, Gelu};
use crate::wan::init::{Init, Start};
use crate::wan::layers::{Dense, LayerNorm, RmsNorm, modulated_norm};
use crate::wan::names::{Layout, Listing};
use crate::wan::probe::Probe;
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// Attention with normalised queries and keys.
#[derive(Module, Debug)]
pub struct Attention {
    /// Queries.
    pub to_q: Dense,
    /// Keys.
    pub to_k: Dense,
    /// Values.
    pub to_v: Dense,
    /// Output.
    pub to_out: Dense,
    /// Over all channels, before they are split into heads.
    pub norm_q: RmsNorm,
    /// Same of keys.
    pub norm_k: RmsNorm,
    #[module(skip)]
    heads: usize,
}

impl Attention {
    pub(super) fn new(init: &mut Init, config: &DitConfig) -> Self {
        let width = config.width();
        Self {
            to_q: Dense::new(init, width, width),
            to_k: Dense::new(init, width, width),
            to_v: Dense::new(init, width, width),
            to_out: Dense::new(init, width, width),
            norm_q: RmsNorm::new(init, width, config.qk_norm_eps),
            norm_k: RmsNorm::new(init, width, config.qk_norm_eps),
            heads: config.heads,
        }
    }

    /// Tokens `[b, n, width]` among themselves, turned by their places.
    pub fn among(&self, x: Tensor<3>, rope: &Rope) -> Tensor<3> {
        let q = rope.turn(self.norm_q.forward(self.to_q.forward(x.clone())), self.heads);
        let k = rope.turn(self.norm_k.forward(self.to_k.forward(x.clone())), self.heads);
        self.to_out.forward(ops::attention(q, k, self.to_v.forward(x), self.heads))
    }

    /// Tokens `[b, n, width]` to others `[b, m, width]` that have no place.
    pub fn towards(&self, x: Tensor<3>, others: Tensor<3>) -> Tensor<3> {
        let q = self.norm_q.forward(self.to_q.forward(x));
        let k = self.norm_k.forward(self.to_k.forward(others.clone()));
        self.to_out.forward(ops::attention(q, k, self.to_v.forward(others), self.heads))
    }

    fn list(&self, list: &mut Listing, name: &str) {
        self.to_q.list_plain(list, &format!("{name}.to_q"));
        self.to_k.list_plain(list, &format!("{name}.to_k"));
        self.to_v.list_plain(list, &format!("{name}.to_v"));
        self.to_out.list_plain(list, &format!("{name}.to_out.0"));
        self.norm_q.list(list, &format!("{name}.norm_q"));
        self.norm_k.list(list, &format!("{name}.norm_k"));
    }
}

/// Cross-attention and the normalisation before it.
#[derive(Module, Debug)]
pub struct Cross {
    /// `None` where the configuration goes without.
    pub norm: Option<LayerNorm>,
    /// To the text.
    pub attention: Attention,
}

/// Perceptron with one hidden layer.
#[derive(Module, Debug)]
pub struct FeedForward {
    /// Width to hidden.
    pub up: Dense,
    /// Hidden to width.
    pub down: Dense,
    #[module(skip)]
    activation: Gelu,
}

impl FeedForward {
    /// `[b, n, width]` to the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        self.down.forward(self.activation.apply(self.up.forward(x)))
    }
}

/// One block; see the module.
#[derive(Module, Debug)]
pub struct Block {
    /// `[1, 6, width]`: shift, scale and gate of self-attention, then of the perceptron; added to those from the time.
    pub modulation: Param<Tensor<3>>,
    /// Self-attention.
    pub attention: Attention,
    /// To the text; `None` in the graph without text.
    pub cross: Option<Cross>,
    /// Perceptron.
    pub ffn: FeedForward,
    #[module(skip)]
    eps: f64,
}

impl Block {
    pub(in crate::wan) fn new(init: &mut Init, config: &DitConfig) -> Self {
        let (width, eps) = (config.width(), config.layer_norm_eps);
        let cross = |init: &mut Init| Cross {
            norm: config.cross_attn_norm.then(|| LayerNorm::new(init, width, eps)),
            attention: Attention::new(init, config),
        };
        Self {
            modulation: init.weight([1, 6, width], Start::Normal((width as f32).powf(-0.5))),
            attention: Attention::new(init, config),
            cross: config.text_dim.map(|_| cross(init)),
            ffn: FeedForward {
                up: Dense::new(init, width, config.ffn_dim),
                down: Dense::new(init, config.ffn_dim, width),
                activation: config.activation,
            },
            eps,
        }
    }

    /// Tokens `[b, n, width]` to the same shape; reports as `name`.
    pub fn forward(&self, x: Tensor<3>, state: &Prepared, probe: &mut Probe, name: &str) -> Tensor<3> {
        let modulation = self.modulation.val() + state.modulation.clone();
        let part = |i: usize| modulation.clone().narrow(1, i, 1);
        let (shift, scale, gate) = (part(0), part(1), part(2));
        let y = self.attention.among(modulated_norm(x.clone(), scale, shift, self.eps), &state.rope);
        probe.report(&format!("{name}.attn1"), || y.clone());
        let mut x = x + y * gate;
        if let (Some(cross), Some(text)) = (&self.cross, &state.text) {
            let normed = match &cross.norm {
                Some(norm) => norm.forward(x.clone()),
                None => x.clone(),
            };
            x = x + cross.attention.towards(normed, text.clone());
        }
        let (shift, scale, gate) = (part(3), part(4), part(5));
        let x = x.clone() + self.ffn.forward(modulated_norm(x, scale, shift, self.eps)) * gate;
        probe.report(name, || x.clone());
        x
    }

    pub(in crate::wan) fn list(&self, list: &mut Listing, name: &str) {
        list.push(&self.modulation, format!("{name}.scale_shift_table"), Layout::Same);
        self.attention.list(list, &format!("{name}.attn1"));
        if let Some(cross) = &self.cross {
            cross.attention.list(list, &format!("{name}.attn2"));
            if let Some(norm) = &cross.norm {
                norm.list(list, &format!("{name}.norm2"));
            }
        }
        self.ffn.up.list_plain(list, &format!("{name}.ffn.net.0.proj"));
        self.ffn.down.list_plain(list, &format!("{name}.ffn.net.2"));
    }
}
