//! The environment adapter: it scales and shifts the tokens at the start of every block.

use super::config::{Environment, FlowConfig};
use crate::ops;
use crate::wan::init::Init;
use crate::wan::layers::Dense;
use crate::wan::names::Listing;
use burn::module::Module;
use burn::tensor::Tensor;

/// `(gamma + 1) f + beta` in every block (RenderFlow, "Envmap Adapter").
#[derive(Module, Debug)]
pub struct EnvironmentAdapter {
    /// From a patch of an environment latent to a token.
    pub embed: Dense,
    /// For each block, from an environment token to gamma and beta, `[width, 2 width]`; 0 before training.
    pub blocks: Vec<Dense>,
    #[module(skip)]
    form: Environment,
}

impl EnvironmentAdapter {
    /// An adapter that does not change the tokens before training.
    pub(super) fn new(embed: Dense, init: &mut Init, config: &FlowConfig) -> Self {
        let width = config.dit.width();
        let blocks = (0..config.dit.layers).map(|_| Dense::zero(init, width, 2 * width)).collect();
        Self { embed, blocks, form: config.environment }
    }

    /// The input of the blocks from patches of the environment latents, `[b, frames m, values]`: means `[b, frames, width]`, or
    /// the tokens.
    pub(super) fn embedded(&self, patches: Tensor<3>, frames: usize) -> Tensor<3> {
        let tokens = self.embed.forward(patches);
        let [b, n, width] = tokens.dims();
        match self.form {
            // The projections are linear, so averaging tokens is the same as averaging their factors and offsets.
            Environment::Pooled => tokens.reshape([b, frames, n / frames, width]).mean_dim(2).reshape([b, frames, width]),
            Environment::Tokens => tokens,
        }
    }

    /// Modulates the tokens `[b, n, width]` at the start of block `i` by the result of [`Self::embedded`].
    pub(super) fn modulate(&self, i: usize, x: Tensor<3>, environment: Tensor<3>) -> Tensor<3> {
        let width = x.dims()[2];
        let modulation = self.blocks[i].forward(environment);
        let (gamma, beta) = (modulation.clone().narrow(2, 0, width), modulation.narrow(2, width, width));
        ops::modulate(x, gamma.add_scalar(1.0), beta, None)
    }

    pub(super) fn list(&self, list: &mut Listing, patch: &[usize]) {
        self.embed.list(list, "environment_embedding", patch);
        for (i, block) in self.blocks.iter().enumerate() {
            block.list_plain(list, &format!("blocks.{i}.environment_proj"));
        }
    }
}
