//! The paper's renderer: the transformer of [`super::dit`] without text. It starts from the latent of the albedo in place of
//! noise, has embedders for the other buffers, and adapters for the environment, for keyframes and for inverse rendering.
//!
//! The autoencoder is another module ([`super::Vae`]). Pictures here are its normalised latents, `[batch, z, latent frames, h,
//! w]`. The keyframe adapter and the inverse adapter are optional in the configuration. Without keyframes and inverse rendering,
//! no part of them runs: the results of the renderer are the same to the bit.
//!
//! Sources: RenderFlow, sections "Model Architecture", "Keyframe Guidance" and "Inverse Rendering"; VACE (Jiang et al. 2025) for
//! the masked reference. Where the paper leaves a choice, the documentation of the item states it.
//!
//! # Names in files
//! The backbone has diffusers' names or the original ones. The other tensors have these names, where `s` is the autoencoder's
//! spatial factor:
//!
//! | name | shape | what |
//! |---|---|---|
//! | `attribute_embedding` | `[width, 2 z + s^2 + 3 z, 1, 2, 2]` | other buffers and the masked reference |
//! | `environment_embedding` | `[width, z, 1, 2, 2]` | environment |
//! | `blocks.i.environment_proj` | `[2 width, width]` | gamma, then beta |
//! | `keyframe_embedding` | `[width, z, 2, 2]` | keyframes |
//! | `blocks.i.keyframe_attn.{to_q,to_k,to_v,to_out.0,norm_q,norm_k}` | as `blocks.i.attn1` | without `to_q` and `norm_q` if queries are reused |
//! | `blocks.i.ffn.{net.0.proj,net.2}.{lora_A,lora_B}` | `[rank, in]`, `[out, rank]` | correction with keyframes |
//! | `inverse_embedding` | `[width, z, 1, 2, 2]` | picture |
//! | `inverse_prompts` | `[prompts, tokens, width]` | albedo, normal, depth, material, reserve |
//! | `blocks.i.attn1.{to_q,to_k,to_v}.{lora_A,lora_B}` | `[rank, width]`, `[width, rank]` | correction for inverse rendering |
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
    /// Backbone. Its patch embedder reads the albedo.
    pub dit: Dit,
    /// From patches of [`Conditions::attributes`] to a term that is added to the albedo's tokens.
    pub attributes: Dense,
    /// From the environment to the modulation of every block.
    pub environment: EnvironmentAdapter,
    /// Trained with the rest frozen.
    pub keyframes: Option<KeyframeAdapter>,
    /// Trained with the rest frozen.
    pub inverse: Option<InverseAdapter>,
    #[module(skip)]
    config: FlowConfig,
}

/// The conditions of a clip, besides its albedo. Latents are normalised, and have the frames and the size of the albedo's latent.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// `[b, 2 z + s^2 + 3 z, f, h, w]`, where s is the autoencoder's spatial factor. The channels are, in this order: latents of
    /// the reference clip with the unknown frames grey (inactive), latents of it with the known frames grey (reactive), the s x s
    /// cells of the mask (channel s row + column; 1 for a frame to render, 0 for a given frame), and latents of normals, depth
    /// and material; last those of the albedo, z more channels, if the bridge begins with noise.
    pub attributes: Tensor<5>,
    /// Latents of the tone-mapped environment around the camera of each frame, `[b, z, f, he, we]`. With [`Environment::Tokens`],
    /// he and we are h and w.
    pub environment: Tensor<5>,
    /// Keyframes inside or outside the clip.
    pub keyframes: Vec<KeyframeLatent>,
}

/// One keyframe for each clip of the batch.
#[derive(Clone, Debug)]
pub struct KeyframeLatent {
    /// Latent of the picture, encoded alone, `[b, z, 1, h, w]`.
    pub latent: Tensor<5>,
    /// Time in latent frames: `(frame of the keyframe - first frame of the clip) / temporal factor of the autoencoder`. It is any
    /// finite number, and negative before the clip.
    pub time: f64,
}

/// Distances between the seeds of the parts. A part begins with the same weights whether or not the other parts exist.
const KEYFRAMES: u64 = 0x6B65_7966_7261_6D65;
const INVERSE: u64 = 0x696E_7665_7273_6521;
const ADAPTERS: u64 = 0x6164_6170_7465_7273;

impl Flow {
    /// A renderer with weights from `seed`, which are made when they are used. Heads and the outputs of adapters are 0, so its
    /// first prediction is the albedo, or the picture for inverse rendering. The embedders of environment and inverse adapter are
    /// copies of the albedo's.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &FlowConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let (dit, width) = (&config.dit, config.dit.width());
        let from = |part: u64| Init::new(seed.wrapping_add(part), device);
        let albedo = || {
            // The albedo's embedder is the first layer made from the seed. The first layer made from the same seed is a copy of
            // it.
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

    /// The configuration of the network.
    pub fn config(&self) -> &FlowConfig {
        &self.config
    }

    /// The paper's velocity, image minus albedo, `[b, z, f, h, w]`. `z_t` is a state of the bridge of the same shape, and `times`
    /// holds the time of each clip in 0..=1: 0 is the albedo, and 1 the image.
    ///
    /// Wan's time runs from 1000 (start) to 0 (data), and its velocity points to the start. Therefore Wan's time is `1000 (1 -
    /// t)`, and its velocity is negated.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when the inputs do not fit.
    pub fn velocity(&self, z_t: Tensor<5>, times: &[f64], conditions: &Conditions) -> Result<Tensor<5>> {
        let (tokens, shared) = self.prepare(z_t, times, conditions)?;
        Ok(self.run(tokens, &shared))
    }

    /// Latents `[b, z, f, h, w]` of an intrinsic, `z_t + (1 - t) v`. `z_t` is a state of the bridge from the picture (t = 0) to
    /// the intrinsic. As in rendering, the heads predict the velocity v, so the first prediction is the picture. The environment
    /// is not known, and modulates nothing.
    ///
    /// # Errors
    /// [`crate::Error::Data`] when the inputs do not fit, and [`crate::Error::Config`] when there is no inverse adapter.
    pub fn invert(&self, z_t: Tensor<5>, times: &[f64], intrinsic: Intrinsic) -> Result<Tensor<5>> {
        let (tokens, shared) = self.prepare_inverse(z_t.clone(), times, intrinsic)?;
        let velocity = self.run(tokens, &shared);
        let left: Vec<f32> = times.iter().map(|t| (1.0 - t) as f32).collect();
        let left = Tensor::<1>::from_data(left.as_slice(), &z_t.device()).reshape([times.len(), 1, 1, 1, 1]);
        Ok(z_t + velocity * left)
    }
}
