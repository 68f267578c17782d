//! The keyframe adapter: attention to rendered pictures of other times, beside every self-attention.

use super::config::{FlowConfig, KeyframeConfig, Query};
use super::lora::Lora;
use crate::ops;
use crate::wan::dit::{Attention, BlockAdapter, FeedForward, Rope};
use crate::wan::init::Init;
use crate::wan::layers::{Dense, RmsNorm};
use crate::wan::names::Listing;
use burn::module::Module;
use burn::tensor::Tensor;

/// The projection of queries that belong to the adapter.
#[derive(Module, Debug)]
pub struct OwnQuery {
    /// Queries.
    pub to_q: Dense,
    /// Over all channels.
    pub norm_q: RmsNorm,
}

/// The adapter's part in one block.
#[derive(Module, Debug)]
pub struct KeyframeBlock {
    /// `None` if the queries of self-attention are reused.
    pub query: Option<OwnQuery>,
    /// Keys of keyframe tokens.
    pub to_k: Dense,
    /// Values of keyframe tokens.
    pub to_v: Dense,
    /// Output; 0 before training.
    pub to_out: Dense,
    /// Over all channels.
    pub norm_k: RmsNorm,
    /// Corrections of the perceptron's first and second layer.
    pub ffn: Option<[Lora; 2]>,
    #[module(skip)]
    heads: usize,
}

impl KeyframeBlock {
    fn new(init: &mut Init, config: &FlowConfig, adapter: &KeyframeConfig) -> Self {
        let (dit, width) = (&config.dit, config.dit.width());
        let own = |init: &mut Init| OwnQuery {
            to_q: Dense::new(init, width, width),
            norm_q: RmsNorm::new(init, width, dit.qk_norm_eps),
        };
        let layers = [[width, dit.ffn_dim], [dit.ffn_dim, width]];
        Self {
            query: (adapter.query == Query::Dedicated).then(|| own(init)),
            to_k: Dense::new(init, width, width),
            to_v: Dense::new(init, width, width),
            to_out: Dense::zero(init, width, width),
            norm_k: RmsNorm::new(init, width, dit.qk_norm_eps),
            ffn: Lora::several(init, layers, adapter.lora_rank, adapter.lora_alpha),
            heads: dit.heads,
        }
    }
}

/// The adapter in a block, with the keyframe tokens `[b, m, width]` and their positions.
pub(super) struct WithKeyframes<'a> {
    pub block: &'a KeyframeBlock,
    pub tokens: &'a Tensor<3>,
    pub places: &'a Rope,
}

impl BlockAdapter for WithKeyframes<'_> {
    fn attend(&self, attention: &Attention, x: Tensor<3>, rope: &Rope) -> (Tensor<3>, Option<Tensor<3>>) {
        let (block, heads) = (self.block, self.block.heads);
        let q = attention.rotated_query(attention.to_q.forward(x.clone()), rope);
        let own = match &block.query {
            Some(own) => rope.rotate(own.norm_q.forward(own.to_q.forward(x.clone()))),
            None => q.clone(),
        };
        let k = attention.rotated_key(attention.to_k.forward(x.clone()), rope);
        let attended = attention.attend(q, k, attention.to_v.forward(x));
        let k = self.places.rotate(block.norm_k.forward(block.to_k.forward(self.tokens.clone())));
        let v = block.to_v.forward(self.tokens.clone());
        (attended, Some(block.to_out.forward(ops::attention(own, k, v, heads))))
    }

    fn perceptron(&self, ffn: &FeedForward, x: Tensor<3>) -> Tensor<3> {
        match &self.block.ffn {
            Some([up, down]) => down.beside(&ffn.down, ffn.activate(up.beside(&ffn.up, x))),
            None => ffn.forward(x),
        }
    }
}

/// The adapter of all blocks.
#[derive(Module, Debug)]
pub struct KeyframeAdapter {
    /// From a patch of a keyframe's latent to a token.
    pub embed: Dense,
    /// One for each block.
    pub blocks: Vec<KeyframeBlock>,
}

impl KeyframeAdapter {
    /// An adapter that adds 0 before training.
    pub(super) fn new(init: &mut Init, config: &FlowConfig, adapter: &KeyframeConfig) -> Self {
        let values = config.dit.in_channels * config.dit.patch_values();
        Self {
            embed: Dense::new(init, values, config.dit.width()),
            blocks: (0..config.dit.layers).map(|_| KeyframeBlock::new(init, config, adapter)).collect(),
        }
    }

    pub(super) fn list(&self, list: &mut Listing, patch: &[usize]) {
        // The convolution covers one frame, so it has no time axis.
        self.embed.list(list, "keyframe_embedding", &[patch[0], patch[2], patch[3]]);
        for (i, block) in self.blocks.iter().enumerate() {
            let name = format!("blocks.{i}.keyframe_attn");
            if let Some(own) = &block.query {
                own.to_q.list_plain(list, &format!("{name}.to_q"));
                own.norm_q.list(list, &format!("{name}.norm_q"));
            }
            block.to_k.list_plain(list, &format!("{name}.to_k"));
            block.to_v.list_plain(list, &format!("{name}.to_v"));
            block.to_out.list_plain(list, &format!("{name}.to_out.0"));
            block.norm_k.list(list, &format!("{name}.norm_k"));
            if let Some([up, down]) = &block.ffn {
                up.list(list, &format!("blocks.{i}.ffn.net.0.proj"));
                down.list(list, &format!("blocks.{i}.ffn.net.2"));
            }
        }
    }
}
