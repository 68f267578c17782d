//! A block of the transformer: modulated self-attention, cross-attention to the text, and a modulated perceptron. Each is added
//! to the tokens.

use super::Prepared;
use super::rope::Rope;
use crate::ops;
use crate::wan::activations;
use crate::wan::config::{DitConfig, Gelu};
use crate::wan::init::{Init, Start};
use crate::wan::layers::{Dense, LayerNorm, RmsNorm, modulated_norm};
use crate::wan::names::{Layout, Listing};
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
    /// Normalisation of queries over all channels, before they are split into heads.
    pub norm_q: RmsNorm,
    /// The same for keys.
    pub norm_k: RmsNorm,
    #[module(skip)]
    heads: usize,
}

impl Attention {
    pub(in crate::wan) fn new(init: &mut Init, config: &DitConfig) -> Self {
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

    /// Self-attention of tokens `[b, n, width]` at their positions.
    pub fn self_attention(&self, x: Tensor<3>, rope: &Rope) -> Tensor<3> {
        let q = self.rotated_query(self.to_q.forward(x.clone()), rope);
        let k = self.rotated_key(self.to_k.forward(x.clone()), rope);
        self.attend(q, k, self.to_v.forward(x))
    }

    /// Normalises and rotates the output of [`Self::to_q`].
    pub(in crate::wan) fn rotated_query(&self, q: Tensor<3>, rope: &Rope) -> Tensor<3> {
        rope.rotate(self.norm_q.forward(q))
    }

    /// Normalises and rotates the output of [`Self::to_k`].
    pub(in crate::wan) fn rotated_key(&self, k: Tensor<3>, rope: &Rope) -> Tensor<3> {
        rope.rotate(self.norm_k.forward(k))
    }

    /// Attention of queries to keys and values, and the output projection.
    pub(in crate::wan) fn attend(&self, q: Tensor<3>, k: Tensor<3>, v: Tensor<3>) -> Tensor<3> {
        self.to_out.forward(ops::attention(q, k, v, self.heads))
    }

    /// Cross-attention of tokens `[b, n, width]` to others `[b, m, width]` without positions.
    pub fn cross_attention(&self, x: Tensor<3>, others: Tensor<3>) -> Tensor<3> {
        let q = self.norm_q.forward(self.to_q.forward(x));
        let k = self.norm_k.forward(self.to_k.forward(others.clone()));
        self.attend(q, k, self.to_v.forward(others))
    }

    pub(in crate::wan) fn list(&self, list: &mut Listing, name: &str) {
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
    /// Normalisation of the tokens, if the configuration has it.
    pub norm: Option<LayerNorm>,
    /// The attention.
    pub attention: Attention,
}

impl Cross {
    pub(in crate::wan) fn new(init: &mut Init, config: &DitConfig) -> Self {
        Self {
            norm: config.cross_attn_norm.then(|| LayerNorm::new(init, config.width(), config.layer_norm_eps)),
            attention: Attention::new(init, config),
        }
    }

    /// Cross-attention of tokens `[b, n, width]` to others `[b, m, width]` without positions.
    pub fn forward(&self, x: Tensor<3>, others: Tensor<3>) -> Tensor<3> {
        let x = match &self.norm {
            Some(norm) => norm.forward(x),
            None => x,
        };
        self.attention.cross_attention(x, others)
    }

    pub(in crate::wan) fn list(&self, list: &mut Listing, attention: &str, norm: &str) {
        self.attention.list(list, attention);
        if let Some(layer) = &self.norm {
            layer.list(list, norm);
        }
    }
}

/// A perceptron with one hidden layer.
#[derive(Module, Debug)]
pub struct FeedForward {
    /// From the width to the hidden width.
    pub up: Dense,
    /// From the hidden width to the width.
    pub down: Dense,
    #[module(skip)]
    activation: Gelu,
}

impl FeedForward {
    /// Runs the perceptron on `[b, n, width]`. The result has the same shape.
    pub fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        self.down.forward(self.activate(self.up.forward(x)))
    }

    /// The nonlinearity between the layers.
    pub(in crate::wan) fn activate(&self, x: Tensor<3>) -> Tensor<3> {
        self.activation.apply(x)
    }
}

/// An adapter of a block. By default, a block runs as published.
pub(in crate::wan) trait BlockAdapter {
    /// Self-attention of the normalised tokens, which the gate scales, and another term that is added without the gate.
    fn attend(&self, attention: &Attention, x: Tensor<3>, rope: &Rope) -> (Tensor<3>, Option<Tensor<3>>) {
        (attention.self_attention(x, rope), None)
    }

    /// A term that is added to the tokens between self-attention and perceptron.
    fn cross(&self, _tokens: &Tensor<3>) -> Option<Tensor<3>> {
        None
    }

    /// The perceptron of the normalised tokens.
    fn perceptron(&self, ffn: &FeedForward, x: Tensor<3>) -> Tensor<3> {
        ffn.forward(x)
    }
}

/// Cross-attention to the text, if there is one.
struct Text<'a> {
    cross: Option<&'a Cross>,
    text: Option<&'a Tensor<3>>,
}

impl BlockAdapter for Text<'_> {
    fn cross(&self, tokens: &Tensor<3>) -> Option<Tensor<3>> {
        Some(self.cross?.forward(tokens.clone(), self.text?.clone()))
    }
}

/// One block; see the module.
#[derive(Module, Debug)]
pub struct Block {
    /// `[1, 6, width]`: shift, scale and gate of self-attention, then of the perceptron. They are added to the modulation from
    /// the time.
    pub modulation: Param<Tensor<3>>,
    /// Self-attention.
    pub attention: Attention,
    /// Cross-attention to the text; `None` in the graph without text.
    pub cross: Option<Cross>,
    /// Perceptron.
    pub ffn: FeedForward,
    #[module(skip)]
    eps: f64,
}

impl Block {
    pub(in crate::wan) fn new(init: &mut Init, config: &DitConfig) -> Self {
        let (width, eps) = (config.width(), config.layer_norm_eps);
        Self {
            modulation: init.weight([1, 6, width], Start::Normal((width as f32).powf(-0.5))),
            attention: Attention::new(init, config),
            cross: config.text_dim.map(|_| Cross::new(init, config)),
            ffn: FeedForward {
                up: Dense::new(init, width, config.ffn_dim),
                down: Dense::new(init, config.ffn_dim, width),
                activation: config.activation,
            },
            eps,
        }
    }

    /// Runs the block on tokens `[b, n, width]`. The result has the same shape. Activations are reported as `name`.
    pub fn forward(&self, x: Tensor<3>, state: &Prepared, name: &str) -> Tensor<3> {
        let text = Text { cross: self.cross.as_ref(), text: state.text.as_ref() };
        self.run(x, &state.modulation, &state.rope, &text, name)
    }

    /// Runs the block with the modulation `[b, 6, width]` from the time, the positions of the tokens, and an adapter.
    pub(in crate::wan) fn run(
        &self,
        x: Tensor<3>,
        modulation: &Tensor<3>,
        rope: &Rope,
        adapter: &dyn BlockAdapter,
        name: &str,
    ) -> Tensor<3> {
        let modulation = self.modulation.val() + modulation.clone();
        let part = |i: usize| modulation.clone().narrow(1, i, 1);
        let (shift, scale, gate) = (part(0), part(1), part(2));
        let (y, ungated) = adapter.attend(&self.attention, modulated_norm(x.clone(), scale, shift, self.eps), rope);
        activations::report(&format!("{name}.attn1"), || y.clone());
        let mut x = ops::gate(x, y, gate);
        if let Some(y) = ungated {
            activations::report(&format!("{name}.keyframe_attn"), || y.clone());
            x = x + y;
        }
        if let Some(y) = adapter.cross(&x) {
            x = x + y;
        }
        let (shift, scale, gate) = (part(3), part(4), part(5));
        let y = adapter.perceptron(&self.ffn, modulated_norm(x.clone(), scale, shift, self.eps));
        let x = ops::gate(x, y, gate);
        activations::report(name, || x.clone());
        x
    }

    pub(in crate::wan) fn list(&self, list: &mut Listing, name: &str) {
        list.push(&self.modulation, format!("{name}.scale_shift_table"), Layout::Same);
        self.attention.list(list, &format!("{name}.attn1"));
        if let Some(cross) = &self.cross {
            cross.list(list, &format!("{name}.attn2"), &format!("{name}.norm2"));
        }
        self.ffn.up.list_plain(list, &format!("{name}.ffn.net.0.proj"));
        self.ffn.down.list_plain(list, &format!("{name}.ffn.net.2"));
    }
}
