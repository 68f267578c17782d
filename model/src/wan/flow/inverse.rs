//! The inverse adapter: it lets the transformer recover an intrinsic from a picture.

use super::config::{FlowConfig, Intrinsic, InverseConfig};
use super::lora::Lora;
use crate::wan::config::Gelu;
use crate::wan::dit::{Attention, BlockAdapter, Cross, Rope};
use crate::wan::init::{Init, Start};
use crate::wan::layers::Dense;
use crate::wan::names::{Layout, Listing};
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// The adapter's part in one block.
#[derive(Module, Debug)]
pub struct InverseBlock {
    /// Corrections of the queries, keys and values of self-attention.
    pub qkv: Option<[Lora; 3]>,
    /// Attention to the prompt, after self-attention. It adds 0 before training.
    pub cross: Cross,
}

/// From tokens after the last block to patches of one intrinsic.
#[derive(Module, Debug)]
pub struct Head {
    /// First layer.
    pub first: Dense,
    /// Second layer; 0 before training.
    pub second: Dense,
    #[module(skip)]
    activation: Gelu,
}

impl Head {
    /// `[b, n, width]` to `[b, n, patch values of a latent]`.
    pub(super) fn forward(&self, x: Tensor<3>) -> Tensor<3> {
        self.second.forward(self.activation.apply(self.first.forward(x)))
    }
}

/// The adapter in a block, with the prompt `[b, tokens, width]`.
pub(super) struct WithPrompt<'a> {
    pub block: &'a InverseBlock,
    pub prompt: &'a Tensor<3>,
}

impl BlockAdapter for WithPrompt<'_> {
    fn attend(&self, attention: &Attention, x: Tensor<3>, rope: &Rope) -> (Tensor<3>, Option<Tensor<3>>) {
        let Some([q, k, v]) = &self.block.qkv else { return (attention.self_attention(x, rope), None) };
        let q = attention.rotated_query(q.beside(&attention.to_q, x.clone()), rope);
        let k = attention.rotated_key(k.beside(&attention.to_k, x.clone()), rope);
        (attention.attend(q, k, v.beside(&attention.to_v, x)), None)
    }

    fn cross(&self, tokens: &Tensor<3>) -> Option<Tensor<3>> {
        Some(self.block.cross.forward(tokens.clone(), self.prompt.clone()))
    }
}

/// The adapter of all blocks.
#[derive(Module, Debug)]
pub struct InverseAdapter {
    /// From a patch of a picture's latent to a token, in place of the embedders of albedo and attributes.
    pub embed: Dense,
    /// `[prompts, tokens, width]`. The first prompts belong to [`Intrinsic::ALL`].
    pub prompts: Param<Tensor<3>>,
    /// One for each block.
    pub blocks: Vec<InverseBlock>,
    /// One for each intrinsic.
    pub heads: Vec<Head>,
}

impl InverseAdapter {
    /// An adapter whose prediction is the picture.
    pub(super) fn new(embed: Dense, init: &mut Init, config: &FlowConfig, adapter: &InverseConfig) -> Self {
        let (dit, width) = (&config.dit, config.dit.width());
        let block = |init: &mut Init| {
            let qkv = Lora::several(init, [[width; 2]; 3], adapter.lora_rank, adapter.lora_alpha);
            let mut cross = Cross::new(init, dit);
            cross.attention.to_out = Dense::zero(init, width, width);
            InverseBlock { qkv, cross }
        };
        Self {
            embed,
            prompts: init.weight([adapter.prompts, adapter.prompt_tokens, width], Start::Normal(1.0)),
            blocks: (0..dit.layers).map(|_| block(init)).collect(),
            heads: Intrinsic::ALL
                .iter()
                .map(|_| Head {
                    first: Dense::new(init, width, width),
                    second: Dense::zero(init, width, dit.out_channels * dit.patch_values()),
                    activation: dit.activation,
                })
                .collect(),
        }
    }

    /// The prompt of an intrinsic for `b` clips, `[b, tokens, width]`.
    pub(super) fn prompt(&self, intrinsic: Intrinsic, b: usize) -> Tensor<3> {
        let prompt = self.prompts.val().narrow(0, intrinsic.index(), 1);
        if b == 1 { prompt } else { prompt.repeat_dim(0, b) }
    }

    pub(super) fn list(&self, list: &mut Listing, patch: &[usize]) {
        self.embed.list(list, "inverse_embedding", patch);
        list.push(&self.prompts, "inverse_prompts".into(), Layout::Same);
        for (i, block) in self.blocks.iter().enumerate() {
            if let Some(qkv) = &block.qkv {
                for (lora, part) in qkv.iter().zip(["to_q", "to_k", "to_v"]) {
                    lora.list(list, &format!("blocks.{i}.attn1.{part}"));
                }
            }
            block.cross.list(list, &format!("blocks.{i}.inverse_attn"), &format!("blocks.{i}.inverse_norm"));
        }
        for (head, intrinsic) in self.heads.iter().zip(Intrinsic::ALL) {
            let name = format!("inverse_heads.{}", intrinsic.name());
            head.first.list_plain(list, &format!("{name}.linear_1"));
            head.second.list_plain(list, &format!("{name}.linear_2"));
        }
    }
}
