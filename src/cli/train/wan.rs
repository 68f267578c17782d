//! Training of the paper's network: which configuration is meant, and the run.

use super::{Bars, Train};
use crate::dataset::Dataset;
use crate::util::cancel::Cancel;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use renderflow_model::lpips::{Backbone, WEIGHTS_VARIABLE, weights_folder};
use renderflow_model::train::schedule::Decay;
use renderflow_model::wan::FlowConfig;
use renderflow_model::wan::flow::{InverseConfig, KeyframeConfig};
use renderflow_model::wan::train::{self, BatchConfig, Config, LatentConfig, Stage};
use serde_json::Value;
use std::path::Path;

/// What can be trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StageArg {
    /// Pictures to latents and back
    Autoencoder,
    /// The renderer
    Base,
    /// Its keyframe adapter
    Keyframes,
    /// Its inverse adapter
    Inverse,
}

/// Frames of the clips the paper trains on.
const CLIP: usize = 5;

impl Train {
    /// The configuration, where flags or file are of the paper's network.
    pub(super) fn wan_config(&self) -> Result<Option<Config>> {
        let mut config = match (&self.preset, self.stage, &self.config) {
            (Some(preset), Some(stage), _) => self.preset(preset, stage)?,
            (_, _, Some(path)) => match read(path)? {
                Some(config) => config,
                None => return Ok(None),
            },
            _ => return Ok(None),
        };
        self.name_files(&mut config.stage)?;
        config.output = self.out.clone();
        config.steps = self.steps.unwrap_or(config.steps);
        config.minutes = self.minutes.or(config.minutes);
        config.seed = self.seed.unwrap_or(config.seed);
        config.cache_mib = self.cache_mib.unwrap_or(config.cache_mib);
        if config.minutes.is_some() && self.steps.is_none() {
            // Time decides.
            config.steps = u64::MAX;
        }
        Ok(Some(config))
    }

    /// Puts the files of the flags into the configuration.
    fn name_files(&self, stage: &mut Stage) -> Result<()> {
        let autoencoder = self.vae.clone();
        let (start, base, latents) = match stage {
            Stage::Autoencoder { start, .. } => (Some(start), None, None),
            Stage::Base { start, latents, .. } => (Some(start), None, Some(latents)),
            Stage::Keyframes { base, latents, .. } | Stage::Inverse { base, latents, .. } => (None, Some(base), Some(latents)),
        };
        match (latents, autoencoder) {
            (Some(latents), Some(file)) => latents.autoencoder = file,
            (None, Some(_)) => bail!("--vae: it is the autoencoder that is trained; --from names what it begins with"),
            _ => {}
        }
        match (start, &self.from) {
            (Some(start), Some(file)) => *start = Some(file.clone()),
            (None, Some(_)) => bail!("--from: adapters begin with the renderer that --base names"),
            _ => {}
        }
        match (base, &self.base) {
            (Some(base), Some(file)) => base.clone_from(file),
            (None, Some(_)) => bail!("--base is for adapters; --from names the weights that this stage begins with"),
            _ => {}
        }
        Ok(())
    }

    /// Settings of a preset; those of wan-1.3b are the paper's, where it tells them.
    fn preset(&self, name: &str, stage: StageArg) -> Result<Config> {
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
            // Stills teach detail, clips what moves.
            StageArg::Autoencoder => vec![batch(size, 1, 8, 0.7), batch(size / 2, CLIP, 4, 0.3)],
            StageArg::Base | StageArg::Inverse if paper => vec![batch(256, CLIP, 32, 1.0)],
            StageArg::Keyframes if paper => vec![batch(512, CLIP, 32, 1.0)],
            _ => vec![batch(size, CLIP, 4, 1.0)],
        };
        if paper && stage != StageArg::Autoencoder {
            config.optimizer.learning_rate = if stage == StageArg::Base { 5e-5 } else { 1e-4 };
            config.optimizer.decay = Decay::Constant;
            config.optimizer.warmup_steps = 0;
        }
        if let Stage::Base { latents, .. } | Stage::Keyframes { latents, .. } | Stage::Inverse { latents, .. } = &mut config.stage
        {
            latents.recompute = paper;
            if !weights_folder().folder.join(Backbone::Squeeze.file_name()).is_file() {
                latents.pixels.lpips = 0.0;
                eprintln!("LPIPS: left out of the loss (no weights; set {WEIGHTS_VARIABLE} to a folder with them)");
            }
        }
        Ok(config)
    }

    /// Trains, or prints the configuration.
    pub(super) fn wan(&self, config: &Config, cancel: &Cancel) -> Result<()> {
        if self.print_config {
            println!("{}", serde_json::to_string_pretty(config)?);
            return Ok(());
        }
        let (dataset, notes) = Dataset::open_to_learn(self.data()?)?;
        let bars = Bars::new(dataset.sequences.len() as u64);
        notes.iter().for_each(|note| bars.note(note));
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

/// A configuration of the paper's network; `None` where the file is one of the other network.
fn read(path: &Path) -> Result<Option<Config>> {
    let value: Value = renderflow_frame::file::read_json(path)?;
    // The other network's options are those of its training and of the frames that it learns from.
    let others = ["training", "recipe"].iter().any(|key| value.get(key).is_some());
    Ok(if others { None } else { Some(renderflow_frame::file::read_json(path)?) })
}
