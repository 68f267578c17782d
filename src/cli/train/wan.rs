//! Training of the paper's network: the configuration of each preset, and the run.

use super::{Bars, Train, smallest};
use crate::dataset::Dataset;
use crate::util::cancel::Cancel;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use renderflow_model::data::ClipSource;
use renderflow_model::lpips::{Backbone, WEIGHTS_VARIABLE, weights_folder};
use renderflow_model::train::Decay;
use renderflow_model::wan::FlowConfig;
use renderflow_model::wan::flow::{InverseConfig, KeyframeConfig};
use renderflow_model::wan::train::{self, BatchConfig, Config, LatentConfig, Stage};

/// A stage of the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StageArg {
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

impl Train {
    /// Applies the flags of the paper's network.
    pub(super) fn apply_wan_flags(&self, config: &mut Config) -> Result<()> {
        self.name_files(&mut config.stage)?;
        config.cache_mib = self.cache_mib.unwrap_or(config.cache_mib);
        if config.run.minutes.is_some() && self.steps.is_none() {
            // The time alone ends the run.
            config.run.steps = u64::MAX;
        }
        Ok(())
    }

    /// Puts the files that flags name into the configuration.
    fn name_files(&self, stage: &mut Stage) -> Result<()> {
        let autoencoder = self.vae.clone();
        let (start, base, latents) = match stage {
            Stage::Autoencoder { start, .. } => (Some(start), None, None),
            Stage::Base { start, latents, .. } => (Some(start), None, Some(latents)),
            Stage::Keyframes { base, latents, .. } | Stage::Inverse { base, latents, .. } => (None, Some(base), Some(latents)),
        };
        match (latents, autoencoder) {
            (Some(latents), Some(file)) => latents.autoencoder = file,
            (None, Some(_)) => bail!("--vae: this stage trains the autoencoder itself; --from names weights to begin with"),
            _ => {}
        }
        match (start, &self.from) {
            (Some(start), Some(file)) => *start = Some(file.clone()),
            (None, Some(_)) => bail!("--from: an adapter begins with the renderer that --base names"),
            _ => {}
        }
        match (base, &self.base) {
            (Some(base), Some(file)) => base.clone_from(file),
            (None, Some(_)) => bail!("--base is for adapters; --from names weights to begin this stage with"),
            _ => {}
        }
        Ok(())
    }

    /// The configuration of a preset. The options of wan-1.3b are the paper's as far as it states them.
    pub(super) fn preset(&self, name: &str, stage: StageArg) -> Result<Config> {
        let network = FlowConfig::preset(name).with_context(|| format!("{name}: no such preset"))?;
        let mut config = Config::default();
        let latents = LatentConfig::default();
        let [paper, tiny] = ["wan-1.3b", "wan-tiny"].map(|known| known == name);
        config.stage = match stage {
            StageArg::Autoencoder => Stage::Autoencoder { network: network.vae, start: None, loss: Default::default() },
            StageArg::Base => Stage::Base { network: Box::new(network), start: None, latents },
            StageArg::Keyframes => {
                let base = self.base.clone().context("--stage keyframes: name the renderer with --base")?;
                Stage::Keyframes { base, network: KeyframeConfig::default(), gap: 16, latents }
            }
            StageArg::Inverse => {
                let base = self.base.clone().context("--stage inverse: name the renderer with --base")?;
                Stage::Inverse { base, network: InverseConfig::default(), lpips: 0.0, latent: 1.0, latents }
            }
        };
        let size = if tiny { 32 } else { 128 };
        let batch = |size, frames, items, weight| BatchConfig { size, frames, items, weight };
        config.batches = match stage {
            // Single pictures teach detail, and clips teach motion.
            StageArg::Autoencoder => vec![batch(size, 1, 8, 0.7), batch(size / 2, CLIP, 4, 0.3)],
            StageArg::Base | StageArg::Inverse if paper => vec![batch(256, CLIP, 32, 1.0)],
            StageArg::Keyframes if paper => vec![batch(512, CLIP, 32, 1.0)],
            _ => vec![batch(size, CLIP, 4, 1.0)],
        };
        if paper && stage != StageArg::Autoencoder {
            config.run.learning_rate = if stage == StageArg::Base { 5e-5 } else { 1e-4 };
            config.run.decay = Decay::Constant;
            config.run.warmup_steps = 0;
        }
        if let Stage::Base { latents, .. } | Stage::Keyframes { latents, .. } | Stage::Inverse { latents, .. } = &mut config.stage
        {
            latents.recompute = paper;
            if !weights_folder().folder.join(Backbone::Squeeze.file_name()).is_file() {
                latents.pixels.lpips = 0.0;
                eprintln!("LPIPS is not part of the loss: its weights are missing (set {WEIGHTS_VARIABLE} to their folder)");
            }
        }
        Ok(config)
    }

    pub(super) fn wan(&self, config: &Config, cancel: &Cancel) -> Result<()> {
        let (dataset, notes) = Dataset::open_to_learn(self.data()?)?;
        if self.is_done(config, dataset.identity()?.as_deref())? {
            return Ok(());
        }
        let bars = Bars::new(dataset.sequences.len() as u64);
        notes.iter().for_each(|note| bars.note(note));
        let picture = config.batches.iter().map(|batch| batch.size).max().unwrap_or(0);
        for sequence in &dataset.sequences {
            let fits = self.check_crop(smallest(sequence), picture, "batches");
            fits.with_context(|| sequence.folder.display().to_string())?;
        }
        let tell = |progress: &train::Progress| match progress {
            train::Progress::Loading { done, total } => bars.loading(*done, *total),
            train::Progress::Note(note) => bars.note(note),
            train::Progress::Step(record) => {
                let psnr = record.psnr.get("pictures").map_or(String::new(), |psnr| format!(" pictures {psnr:.2} dB,"));
                let (step, loss, rate) = (record.step, record.loss, record.items_per_second);
                bars.step(record.share, format!("step {step} loss {loss:.5},{psnr} {rate:.2} items/s"));
            }
            // This training has no validation.
            train::Progress::Validated(_) => {}
        };
        bars.finish(&train::run(config, &dataset, &tell, cancel)?)
    }
}
