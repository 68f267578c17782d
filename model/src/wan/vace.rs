//! VACE: a second sequence of blocks. It reads a context (masked video, masks, references) and adds hints to the transformer's
//! tokens.

use super::activations;
use super::config::VaceConfig;
use super::dit::{Block, Dit, DitInput, Prepared, expect, patches, token_grid};
use super::init::Init;
use super::layers::Dense;
use super::names::{self, Entry, Listing, Named};
use crate::Result;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

/// One context block.
#[derive(Module, Debug)]
pub struct ContextBlock {
    /// In the first block only, before the transformer's tokens are added.
    pub proj_in: Option<Dense>,
    /// A block like the transformer's.
    pub block: Block,
    /// From context to hint; 0 before training.
    pub proj_out: Dense,
}

/// The transformer with its context path.
#[derive(Module, Debug)]
pub struct Vace {
    /// The transformer.
    pub dit: Dit,
    /// A patch of the context to a token.
    pub patch: Dense,
    /// Context blocks, one for each entry of `vace_layers`.
    pub blocks: Vec<ContextBlock>,
    #[module(skip)]
    config: VaceConfig,
}

impl Vace {
    /// A network with weights from `seed`, which are made when they are used. Its hints are 0.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &VaceConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let init = &mut Init::new(seed, device);
        let (dit, width) = (&config.dit, config.dit.width());
        let context = |(i, _): (usize, &usize)| ContextBlock {
            proj_in: (i == 0).then(|| Dense::zero(init, width, width)),
            block: Block::new(init, dit),
            proj_out: Dense::zero(init, width, width),
        };
        let blocks = config.vace_layers.iter().enumerate().map(context).collect();
        Ok(Self {
            patch: Dense::new(init, config.vace_in_channels * dit.patch_values(), width),
            dit: Dit::with(init, dit),
            blocks,
            config: config.clone(),
        })
    }

    /// The configuration of the network.
    pub fn config(&self) -> &VaceConfig {
        &self.config
    }

    /// The velocity of [`Dit::forward`] with a context `[b, vace_in_channels, frames', h, w]`, which may have fewer frames than
    /// the latents. With `scales`, each hint is multiplied by the scale of its context block.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when latents, context or scales do not fit.
    pub fn forward(&self, input: DitInput, context: Tensor<5>, scales: Option<&[f32]>) -> Result<Tensor<5>> {
        let state = self.dit.prepare(input)?;
        self.run(state, context, scales)
    }

    /// Runs the network on a prepared input.
    ///
    /// # Errors
    /// As for [`Self::forward`].
    pub fn run(&self, mut state: Prepared, context: Tensor<5>, scales: Option<&[f32]>) -> Result<Tensor<5>> {
        let (config, hints) = (&self.config, self.blocks.len());
        let ([b, channels, ..], [f, h, w]) = (context.dims(), state.grid);
        let channels_fit = channels == config.vace_in_channels;
        expect(channels_fit, || format!("{channels} channels of context instead of {}", config.vace_in_channels))?;
        let [cf, ch, cw] = token_grid(config.dit.patch_size, &context)?;
        let size_fits = (b, ch, cw) == (state.tokens.dims()[0], h, w) && cf <= f;
        expect(size_fits, || format!("context {:?} beside {f} x {h} x {w} tokens of latents", context.dims()))?;
        expect(scales.is_none_or(|s| s.len() == hints), || format!("{} scales for {hints} hints", scales.map_or(0, <[_]>::len)))?;
        let hints = self.hints(&state, context);
        let mut x = state.tokens.clone();
        for (i, block) in self.dit.blocks.iter().enumerate() {
            x = block.forward(x, &state, &format!("block{i}"));
            if let Some(at) = config.vace_layers.iter().position(|&layer| layer == i) {
                let hint = hints[at].clone();
                x = x + scales.map_or(hint.clone(), |scales| hint * scales[at]);
            }
        }
        state.tokens = x;
        Ok(self.dit.finish(state))
    }

    /// The hint of each context block, from the transformer's tokens before its first block.
    fn hints(&self, state: &Prepared, context: Tensor<5>) -> Vec<Tensor<3>> {
        let mut c = self.patch.forward(patches(context, self.config.dit.patch_size));
        let ([b, n, width], [_, tokens, _]) = (c.dims(), state.tokens.dims());
        if n < tokens {
            c = Tensor::cat(vec![c.clone(), Tensor::zeros([b, tokens - n, width], &c.device())], 1);
        }
        let mut hints = Vec::with_capacity(self.blocks.len());
        for context in &self.blocks {
            if let Some(proj_in) = &context.proj_in {
                c = proj_in.forward(c) + state.tokens.clone();
            }
            c = activations::unrecorded(|| context.block.forward(c, state, ""));
            hints.push(context.proj_out.forward(c.clone()));
        }
        hints
    }
}

impl Named for Vace {
    fn entries(&self) -> Vec<Entry> {
        let mut list = Listing::new(names::dit_original);
        self.dit.list(&mut list);
        let [pf, ph, pw] = self.config.dit.patch_size;
        self.patch.list(&mut list, "vace_patch_embedding", &[self.config.vace_in_channels, pf, ph, pw]);
        for (i, context) in self.blocks.iter().enumerate() {
            let name = format!("vace_blocks.{i}");
            context.block.list(&mut list, &name);
            if let Some(proj_in) = &context.proj_in {
                proj_in.list_plain(&mut list, &format!("{name}.proj_in"));
            }
            context.proj_out.list_plain(&mut list, &format!("{name}.proj_out"));
        }
        list.into_entries()
    }
}
