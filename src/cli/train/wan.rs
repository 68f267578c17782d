//! Training of the paper's network: its flags, and the run.

use super::{Bars, OutputFolder, Train, smallest};
use crate::dataset::Dataset;
use crate::util::cancel::Cancel;
use crate::util::device::DeviceArgs;
use anyhow::{Context, Result, bail};
use renderflow_model::data::ClipSource;
use renderflow_model::lpips::{Backbone, WEIGHTS_VARIABLE, weights_folder};
use renderflow_model::train::Team;
use renderflow_model::train::runner::RunContext;
use renderflow_model::wan::pictures::BridgeStart;
use renderflow_model::wan::train::{self, Config, Stage, StageName};
use std::path::PathBuf;

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

    /// The configuration of a preset with the files of the flags.
    pub(super) fn preset(&self, name: &str, stage: StageName) -> Result<Config> {
        let base = |stage: &str| self.base.clone().with_context(|| format!("--stage {stage}: name the renderer with --base"));
        let mut config = Config::preset(name, stage).with_context(|| format!("{name}: no such preset"))?;
        match &mut config.stage {
            Stage::Keyframes { base: file, .. } => *file = base("keyframes")?,
            Stage::Inverse { base: file, .. } => *file = base("inverse")?,
            Stage::Autoencoder { .. } | Stage::Base { .. } => {}
        }
        if let Some(latents) = config.stage.latents_mut()
            && !weights_folder().is_some_and(|folder| folder.join(Backbone::Squeeze.file_name()).is_file())
        {
            latents.pixels.lpips = 0.0;
            eprintln!("LPIPS is not part of the loss: its weights are missing (set {WEIGHTS_VARIABLE} to their folder)");
        }
        Ok(config)
    }

    pub(super) fn wan(
        &self,
        config: &Config,
        team: &Team,
        folder: &OutputFolder,
        allowed: &[PathBuf],
        cancel: &Cancel,
    ) -> Result<()> {
        let (mut dataset, notes) = Dataset::open_to_learn(self.data()?)?;
        if train::bridge_start(config)? == Some(BridgeStart::Deferred) {
            dataset = dataset.shaded(allowed, config.stage.gap());
        }
        if self.is_done(config, dataset.identity()?.as_deref(), team)? {
            return Ok(());
        }
        let bars = Bars::new(team, dataset.sequences.len() as u64);
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
        let context = RunContext { device: &DeviceArgs::from(self.device).get()?, progress: &tell, cancel, team };
        folder.begin()?;
        bars.finish(&train::run(config, &dataset, context)?)
    }
}
