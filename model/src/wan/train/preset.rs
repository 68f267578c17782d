//! Ready configurations: each stage of the training of each preset of the network.

use super::config::{BatchConfig, Config, LatentConfig, Stage};
use crate::train::Decay;
use crate::wan::flow::{FlowConfig, InverseConfig, KeyframeConfig};
use std::path::PathBuf;

/// A stage of the training without its options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum StageName {
    /// The autoencoder, between pictures and latents
    Autoencoder,
    /// The renderer
    Base,
    /// The keyframe adapter of the renderer
    Keyframes,
    /// The inverse adapter of the renderer
    Inverse,
}

/// Frames of the paper's training clips.
const CLIP: usize = 5;

impl Config {
    /// The configuration of `stage` for a preset of the network ([`FlowConfig::PRESETS`]); `None` for an unknown preset. Names of
    /// files are empty. The options of wan-1.3b are the paper's as far as it states them.
    pub fn preset(name: &str, stage: StageName) -> Option<Self> {
        let network = FlowConfig::preset(name)?;
        let [paper, tiny] = ["wan-1.3b", "wan-tiny"].map(|known| known == name);
        let (base, latents) = (PathBuf::new(), LatentConfig { recompute: paper, ..LatentConfig::default() });
        let stage_config = match stage {
            StageName::Autoencoder => Stage::Autoencoder { network: network.vae, start: None, loss: Default::default() },
            StageName::Base => Stage::Base { network: Box::new(network), start: None, latents },
            StageName::Keyframes => Stage::Keyframes { base, network: KeyframeConfig::default(), gap: 16, latents },
            StageName::Inverse => Stage::Inverse { base, network: InverseConfig::default(), lpips: 0.0, latent: 1.0, latents },
        };
        let size = if tiny { 32 } else { 128 };
        let mut config = Self { stage: stage_config, ..Self::default() };
        let batch = |size, frames, items, weight| BatchConfig { size, frames, items, weight };
        config.batches = match stage {
            // Single pictures teach detail, and clips teach motion.
            StageName::Autoencoder => vec![batch(size, 1, 8, 0.7), batch(size / 2, CLIP, 4, 0.3)],
            StageName::Base | StageName::Inverse if paper => vec![batch(256, CLIP, 32, 1.0)],
            StageName::Keyframes if paper => vec![batch(512, CLIP, 32, 1.0)],
            _ => vec![batch(size, CLIP, 4, 1.0)],
        };
        if paper && stage != StageName::Autoencoder {
            config.run.learning_rate = if stage == StageName::Base { 5e-5 } else { 1e-4 };
            config.run.decay = Decay::Constant;
            config.run.warmup_steps = 0;
        }
        Some(config)
    }
}
