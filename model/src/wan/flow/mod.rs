//! The paper's renderer: the transformer of [`super::dit`] without text, fed with the albedo's latent in place of noise, with
//! embedders for the other buffers, and adapters for the environment, for keyframes and for the way back from a picture.
//!
//! The autoencoder is a module of its own ([`super::Vae`]); here everything is a normalised latent of it,
//! `[batch, z, latent frames, h, w]`. Keyframe and inverse adapter are optional in the configuration, and where they are not asked
//! for nothing of them runs: the renderer without them is bit for bit the one they were added to.
//!
//! Sources: RenderFlow, section "Model Architecture", "Keyframe Guidance", "Inverse Rendering"; VACE (Jiang et al. 2025) for the
//! masked reference; where the paper is silent, the documentation of the item says what was chosen.
//!
//! # Names in files
//! The backbone has diffusers' names (or the original ones), the rest these; `s` is the autoencoder's spatial factor:
//!
//! | name | shape | what |
//! |---|---|---|
//! | `attribute_embedding` | `[width, 2 z + s^2 + 3 z, 1, 2, 2]` | other buffers and the masked reference |
//! | `environment_embedding` | `[width, z, 1, 2, 2]` | environment |
//! | `blocks.i.environment_proj` | `[2 width, width]` | gamma, then beta |
//! | `keyframe_embedding` | `[width, z, 2, 2]` | keyframes |
//! | `blocks.i.keyframe_attn.{to_q,to_k,to_v,to_out.0,norm_q,norm_k}` | as `blocks.i.attn1` | without `to_q` and `norm_q` where queries are reused |
//! | `blocks.i.ffn.{net.0.proj,net.2}.{lora_A,lora_B}` | `[rank, in]`, `[out, rank]` | correction with keyframes |
//! | `inverse_embedding` | `[width, z, 1, 2, 2]` | picture |
//! | `inverse_prompts` | `[prompts, tokens, width]` | albedo, normal, depth, material, reserve |
//! | `blocks.i.attn1.{to_q,to_k,to_v}.{lora_A,lora_B}` | `[rank, width]`, `[width, rank]` | correction on the way back |
//! | `blocks.i.{inverse_attn,inverse_norm}` | as `blocks.i.{attn2,norm2}` | cross-attention to the prompt |
//! | `inverse_heads.{albedo,normal,depth,material}.{linear_1,linear_2}` | `[width, width]`, `[4 z, width]` | velocity |

mod config;
mod environment;
mod group;
mod inverse;
mod keyframes;
mod lora;
mod mask;
mod names;
mod stages;

pub(super) use config::BUFFERS;
pub use config::{Environment, FlowConfig, Intrinsic, InverseConfig, KeyframeConfig, Query};
pub use environment::EnvironmentAdapter;
pub use group::Group;
pub use inverse::{Head, InverseAdapter, InverseBlock};
pub use keyframes::{KeyframeAdapter, KeyframeBlock, OwnQuery};
pub use lora::Lora;
pub use mask::mask_cells;
pub use stages::Shared;

use super::dit::Dit;
use super::init::Init;
use super::layers::Dense;
use crate::Result;
use burn::module::Module;
use burn::tensor::{Device, Tensor};

/// The renderer; see the module.
#[derive(Module, Debug)]
pub struct Flow {
    /// Backbone; its patch embedder reads the albedo.
    pub dit: Dit,
    /// Patches of [`Conditions::attributes`] to what is added to the albedo's tokens.
    pub attributes: Dense,
    /// Environment to the modulation of every block.
    pub environment: EnvironmentAdapter,
    /// Trained after the rest, which it leaves as it is.
    pub keyframes: Option<KeyframeAdapter>,
    /// Trained after the rest, which it leaves as it is.
    pub inverse: Option<InverseAdapter>,
    #[module(skip)]
    config: FlowConfig,
}

/// What a clip is rendered from, beside its albedo. Latents are normalised and of the frames and size of the albedo's.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// `[b, 2 z + s^2 + 3 z, f, h, w]` with s the autoencoder's spatial factor, in this order: latents of the reference clip with the
    /// unknown frames grey (inactive), with the known frames grey (reactive), the mask's s x s cells (channel s row + column; 1 where
    /// a frame is to be rendered, 0 where it is given), latents of normals, depth and material.
    pub attributes: Tensor<5>,
    /// Latents of the tone-mapped environment of each frame, turned into its camera's space, `[b, z, f, he, we]`; with
    /// [`Environment::Tokens`], he and we are h and w.
    pub environment: Tensor<5>,
    /// Rendered frames inside or outside of the clip; none is the renderer without keyframes.
    pub keyframes: Vec<KeyframeLatent>,
}

/// One keyframe of each clip of the batch.
#[derive(Clone, Debug)]
pub struct KeyframeLatent {
    /// Latent of the picture encoded by itself, `[b, z, 1, h, w]`.
    pub latent: Tensor<5>,
    /// `(frame of the keyframe - first frame of the clip) / temporal factor of the autoencoder`: its time in latent frames. Any finite
    /// number, negative before the clip.
    pub time: f64,
}

/// Distances between the seeds of the parts, so that a part is the same with and without the others.
const KEYFRAMES: u64 = 0x6B65_7966_7261_6D65;
const INVERSE: u64 = 0x696E_7665_7273_6521;
const ADAPTERS: u64 = 0x6164_6170_7465_7273;

impl Flow {
    /// A renderer with weights from `seed`, none of them made yet. Its first prediction is the albedo (and the inverse adapter's the
    /// picture): heads and the outputs of adapters are 0. The embedders of environment and inverse adapter are copies of the albedo's.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &FlowConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let (dit, width) = (&config.dit, config.dit.width());
        let from = |part: u64| Init::new(seed.wrapping_add(part), device);
        let albedo = || {
            // The albedo's embedder is the first thing made from the seed, so that the first thing made from it again is a copy.
            Dense::new(&mut Init::new(seed, device), dit.in_channels * dit.patch_values(), width)
        };
        let init = &mut from(ADAPTERS);
        let attributes = Dense::new(init, config.attribute_channels() * dit.patch_values(), width);
        Ok(Self {
            dit: Dit::with(&mut Init::new(seed, device), dit),
            attributes,
            environment: EnvironmentAdapter::new(albedo(), init, config),
            keyframes: config.keyframes.as_ref().map(|adapter| KeyframeAdapter::new(&mut from(KEYFRAMES), config, adapter)),
            inverse: config.inverse.as_ref().map(|adapter| InverseAdapter::new(albedo(), &mut from(INVERSE), config, adapter)),
            config: config.clone(),
        })
    }

    /// What the network is.
    pub fn config(&self) -> &FlowConfig {
        &self.config
    }

    /// The paper's velocity, image minus albedo, `[b, z, f, h, w]`, of a state `z_t` of the bridge of that shape at `times` in 0..=1,
    /// one a clip: 0 is the albedo, 1 the image.
    ///
    /// Wan's time runs from 1000 (start) to 0 (data) and its velocity towards the start, so that here its time is `1000 (1 - t)` and
    /// its velocity is negated.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when the inputs do not fit.
    pub fn velocity(&self, z_t: Tensor<5>, times: &[f64], conditions: &Conditions) -> Result<Tensor<5>> {
        let (tokens, shared) = self.prepare(z_t, times, conditions)?;
        Ok(self.run(tokens, &shared))
    }

    /// Latents `[b, z, f, h, w]` of one of the buffers behind pictures, from a state `z_t` of the bridge between the two (at t = 0 the
    /// pictures' own latents): `z_t + (1 - t) v`. The heads give the velocity v, so that the bridge is that of rendering and the first
    /// prediction is the picture; the environment, which is not known, modulates nothing.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when the inputs do not fit, [`crate::Error::Config`] when there is no inverse adapter.
    pub fn invert(&self, z_t: Tensor<5>, times: &[f64], intrinsic: Intrinsic) -> Result<Tensor<5>> {
        let (tokens, shared) = self.prepare_inverse(z_t.clone(), times, intrinsic)?;
        let velocity = self.run(tokens, &shared);
        let left: Vec<f32> = times.iter().map(|t| (1.0 - t) as f32).collect();
        let left = Tensor::<1>::from_data(left.as_slice(), &z_t.device()).reshape([times.len(), 1, 1, 1, 1]);
        Ok(z_t + velocity * left)
    }
}
