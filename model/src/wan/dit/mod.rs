//! The diffusion transformer. It predicts the velocity `noise - data` from latents, a time and an optional text.
//!
//! The time modulates attention and perceptron of each block. Rotary embeddings give queries and keys the position of their token
//! in time, height and width. Without text, cross-attention and its normalisation do not run. That is RenderFlow's backbone.

mod block;
mod embed;
mod rope;

pub(super) use block::BlockAdapter;
pub use block::{Attention, Block, Cross, FeedForward};
pub use embed::{TextEmbed, TimeEmbed, sinusoid};
pub use rope::Rope;

use super::activations;
use super::config::DitConfig;
use super::init::{Init, Start};
use super::layers::{Dense, modulated_norm};
use super::names::{self, Entry, Layout, Listing, Named};
use crate::{Error, Result};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};

/// The transformer; see the module.
#[derive(Module, Debug)]
pub struct Dit {
    /// From a patch of the latent to a token.
    pub patch: Dense,
    /// From the time to the modulation.
    pub time: TimeEmbed,
    /// From text to tokens; `None` in the graph without text.
    pub text: Option<TextEmbed>,
    /// Blocks.
    pub blocks: Vec<Block>,
    /// Shift and scale of the head, `[1, 2, width]`. They are added to the embedded time.
    pub head_modulation: Param<Tensor<3>>,
    /// From a token to its patch of the output.
    pub head: Dense,
    #[module(skip)]
    config: DitConfig,
}

/// The input of the transformer.
#[derive(Clone, Debug)]
pub struct DitInput {
    /// `[b, channels, frames, h, w]`, normalised.
    pub latents: Tensor<5>,
    /// Time of each of the b clips, 0 (data) to 1000 (noise).
    pub times: Vec<f64>,
    /// Text tokens `[b, tokens, text_dim]`; Wan pads texts with zeros to 512 tokens, and attends to all of them. `None` skips
    /// cross-attention.
    pub text: Option<Tensor<3>>,
}

/// The tokens before the first block, and the other inputs of every block.
#[derive(Debug)]
pub struct Prepared {
    /// Tokens `[b, n, width]`, ordered by frame, then row, then column.
    pub tokens: Tensor<3>,
    /// Embedded time `[b, 1, width]`.
    pub time: Tensor<3>,
    /// Modulation of the blocks `[b, 6, width]`. Each block adds its own to it.
    pub modulation: Tensor<3>,
    /// Positions of the tokens.
    pub rope: Rope,
    /// Embedded text `[b, tokens, width]`.
    pub text: Option<Tensor<3>>,
    /// Numbers of frames, rows and columns of tokens.
    pub grid: [usize; 3],
}

impl Dit {
    /// A transformer with weights from `seed`, which are made when they are used. It returns 0 before training.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &DitConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        Ok(Self::with(&mut Init::new(seed, device), config))
    }

    /// A transformer with a valid configuration.
    pub(super) fn with(init: &mut Init, config: &DitConfig) -> Self {
        let width = config.width();
        Self {
            patch: Dense::new(init, config.in_channels * config.patch_values(), width),
            time: TimeEmbed::new(init, config),
            text: config.text_dim.map(|text_dim| TextEmbed::new(init, text_dim, config)),
            blocks: (0..config.layers).map(|_| Block::new(init, config)).collect(),
            head_modulation: init.weight([1, 2, width], Start::Normal((width as f32).powf(-0.5))),
            head: Dense::zero(init, width, config.out_channels * config.patch_values()),
            config: config.clone(),
        }
    }

    /// The configuration of the network.
    pub fn config(&self) -> &DitConfig {
        &self.config
    }

    /// The velocity `[b, out_channels, frames, h, w]`.
    ///
    /// # Errors
    /// [`Error::Data`] when the input does not fit.
    pub fn forward(&self, input: DitInput) -> Result<Tensor<5>> {
        let state = self.prepare(input)?;
        Ok(self.run(state))
    }

    /// Runs all blocks and the head.
    pub fn run(&self, mut state: Prepared) -> Tensor<5> {
        let mut x = state.tokens.clone();
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(x, &state, &format!("block{i}"));
        }
        state.tokens = x;
        self.finish(state)
    }

    /// Runs everything before the first block.
    ///
    /// # Errors
    /// [`Error::Data`] when the input does not fit.
    pub fn prepare(&self, input: DitInput) -> Result<Prepared> {
        self.prepare_embedded(&self.patch, input)
    }

    /// [`Self::prepare`] with another patch embedder.
    pub(super) fn prepare_embedded(&self, patch: &Dense, input: DitInput) -> Result<Prepared> {
        let valid = |t: &f64| t.is_finite() && t.abs() <= 1e6;
        expect(input.times.iter().all(valid), || format!("times {:?}; 0 to 1000 are usual", input.times))?;
        let waves = sinusoid(&input.times, self.config.freq_dim, &input.latents.device());
        let (config, device) = (&self.config, input.latents.device());
        let [b, channels, ..] = input.latents.dims();
        expect(channels == config.in_channels, || format!("{channels} channels of latents instead of {}", config.in_channels))?;
        expect(b > 0 && waves.dims() == [b, 1, config.freq_dim], || format!("{} times for {b} clips", waves.dims()[0]))?;
        let grid = token_grid(config.patch_size, &input.latents)?;
        let tokens = patch.forward(patches(input.latents, config.patch_size));
        activations::report("patch_embedding", || {
            let [f, h, w] = grid;
            tokens.clone().reshape([b, f, h, w, config.width()]).permute([0, 4, 1, 2, 3])
        });
        activations::report("timestep_sinusoid", || waves.clone().reshape([b, config.freq_dim]));
        let (time, modulation) = self.time.forward(waves);
        activations::report("temb", || time.clone().reshape([b, config.width()]));
        activations::report("time_proj", || modulation.clone().reshape([b, 6 * config.width()]));
        let rope = Rope::grid(config, grid, 0.0, 1.0, &device);
        rope.report();
        let text = match (input.text, &self.text) {
            (None, _) => None,
            (Some(_), None) => return Err(data("a text, but this network has no text embedder".into())),
            (Some(text), Some(embed)) => {
                let ([tb, n, c], dim) = (text.dims(), embed.text_dim());
                expect([tb, c] == [b, dim] && n > 0, || format!("a text of shape [{tb}, {n}, {c}] instead of [{b}, n, {dim}]"))?;
                Some(embed.forward(text))
            }
        };
        Ok(Prepared { tokens, time, modulation, rope, text, grid })
    }

    /// The velocity from the tokens after the last block.
    pub fn finish(&self, state: Prepared) -> Tensor<5> {
        self.unpatch(self.head.forward(self.head_norm(state.tokens, state.time)), state.grid)
    }

    /// The input of the head, from the tokens after the last block and the embedded time `[b, 1, width]`.
    pub(super) fn head_norm(&self, tokens: Tensor<3>, time: Tensor<3>) -> Tensor<3> {
        let modulation = self.head_modulation.val() + time;
        let (shift, scale) = (modulation.clone().narrow(1, 0, 1), modulation.narrow(1, 1, 1));
        modulated_norm(tokens, scale, shift, self.config.layer_norm_eps)
    }

    /// Joins patches `[b, n, values out_channels]` of a grid of tokens to `[b, out_channels, frames, h, w]`.
    pub(super) fn unpatch(&self, x: Tensor<3>, [f, h, w]: [usize; 3]) -> Tensor<5> {
        let ([b, ..], [pf, ph, pw]) = (x.dims(), self.config.patch_size);
        let c = self.config.out_channels;
        // The channel is the fastest axis of an output patch, unlike in an input patch.
        x.reshape([b, f, h, w, pf, ph, pw, c]).permute([0, 7, 1, 4, 2, 5, 3, 6]).reshape([b, c, f * pf, h * ph, w * pw])
    }

    pub(super) fn list(&self, list: &mut Listing) {
        let (config, [pf, ph, pw]) = (&self.config, self.config.patch_size);
        list.push(&self.head_modulation, "scale_shift_table".into(), Layout::Same);
        self.patch.list(list, "patch_embedding", &[config.in_channels, pf, ph, pw]);
        self.time.list(list, "condition_embedder");
        if let Some(text) = &self.text {
            text.list(list, "condition_embedder.text_embedder");
        }
        self.head.list_plain(list, "proj_out");
        for (i, block) in self.blocks.iter().enumerate() {
            block.list(list, &format!("blocks.{i}"));
        }
    }
}

impl Named for Dit {
    fn entries(&self) -> Vec<Entry> {
        let mut list = Listing::new(names::dit_original);
        self.list(&mut list);
        list.into_entries()
    }
}

/// Numbers of frames, rows and columns of tokens for latents `[b, c, f, h, w]`.
pub(super) fn token_grid(patch: [usize; 3], latents: &Tensor<5>) -> Result<[usize; 3]> {
    let [_, _, f, h, w] = latents.dims();
    let fits = [f, h, w].iter().zip(patch).all(|(&size, patch)| size > 0 && size.is_multiple_of(patch));
    expect(fits, || format!("latents of {f} frames of {w}x{h} cannot be cut into patches of {patch:?}"))?;
    Ok([f / patch[0], h / patch[1], w / patch[2]])
}

/// Cuts latents `[b, c, f, h, w]` into patches `[b, n, c pf ph pw]`, with the channel as the slowest axis of a patch.
pub(super) fn patches(latents: Tensor<5>, [pf, ph, pw]: [usize; 3]) -> Tensor<3> {
    let [b, c, f, h, w] = latents.dims();
    let (f, h, w) = (f / pf, h / ph, w / pw);
    let cut = latents.reshape([b, c, f, pf, h, ph, w, pw]).permute([0, 2, 4, 6, 1, 3, 5, 7]);
    cut.reshape([b, f * h * w, c * pf * ph * pw])
}

pub(super) fn expect(valid: bool, reason: impl FnOnce() -> String) -> Result<()> {
    if valid { Ok(()) } else { Err(data(reason())) }
}

fn data(reason: String) -> Error {
    Error::Data { place: "transformer".into(), reason }
}
