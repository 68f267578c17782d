mod fusion;
mod monitor;
mod reference;
mod wan;

use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use renderflow_model::config::{KeyframeConfig, Start};
use renderflow_model::train::runner::Summary;
use renderflow_model::train::{self, Config, Stage};
use renderflow_model::wan::FlowConfig;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

const HELP: &str = "\
Examples, the compact network:
  renderflow train --data data/train --minutes 45 --out runs/base
  renderflow train --plan plan.toml --minutes 120 --out runs/fusion
  renderflow train --data data/train --minutes 15 --base runs/base/weights.safetensors --out runs/keyframes

The paper's network, from its autoencoder to keyframes and the way back (wan-1.3b begins with published weights: --from FILE):
  renderflow train --preset wan-small --stage autoencoder --data data/train --minutes 60 --out runs/vae
  renderflow train --preset wan-small --stage base --vae runs/vae/weights.safetensors --data data/train --minutes 120 --out runs/wan
  renderflow train --preset wan-small --stage keyframes --vae runs/vae/weights.safetensors --base runs/wan/weights.safetensors \\
      --data data/train --minutes 60 --out runs/wan-keys
  renderflow train --preset wan-small --stage inverse --vae runs/vae/weights.safetensors --base runs/wan/weights.safetensors \\
      --data data/train --minutes 60 --out runs/wan-inverse";

/// Trains a network on a dataset. The compact one: first its base, then, on the frozen base, the keyframe stage. The paper's: an
/// autoencoder, the renderer on its latents, then adapters on the frozen renderer. Checkpoints as it goes; run again with the same
/// options, it resumes.
#[derive(Args)]
#[command(after_help = HELP)]
pub struct Train {
    /// A split of a dataset
    #[arg(long, required_unless_present = "plan")]
    data: Option<PathBuf>,
    /// A plan (see `dataset plan`): the network that reads samples, keyframes and deferred shading learns from its training sequences,
    /// which are composed and rendered beside the steps; nothing is stored
    #[arg(long, conflicts_with_all = ["data", "preset", "vae", "base", "start", "cache_mib"])]
    plan: Option<PathBuf>,
    /// Folder for checkpoint, log.jsonl and weights.safetensors; with --plan also curves.html, TensorBoard's events and pictures
    #[arg(long)]
    out: PathBuf,
    /// Every option of either network as JSON (as printed by --print-config); flags win over it
    #[arg(long)]
    config: Option<PathBuf>,
    /// A size of the paper's network in place of the compact one
    #[arg(long, value_parser = FlowConfig::PRESETS, requires = "stage", conflicts_with = "config")]
    preset: Option<String>,
    /// What of the paper's network is trained
    #[arg(long, value_enum, requires = "preset")]
    stage: Option<wan::StageArg>,
    /// Weights of the autoencoder of the paper's network
    #[arg(long)]
    vae: Option<PathBuf>,
    /// Weights the paper's network begins with: of this program, or published ones of Wan or VACE
    #[arg(long)]
    from: Option<PathBuf>,
    /// Train an adapter (of the compact network: the keyframe stage) on this base
    #[arg(long)]
    base: Option<PathBuf>,
    /// Start point of the bridge of the compact network
    #[arg(long, value_enum)]
    start: Option<StartArg>,
    /// Optimiser steps
    #[arg(long)]
    steps: Option<u64>,
    /// Minutes over all resumptions; the learning rate anneals to this end
    #[arg(long)]
    minutes: Option<f64>,
    /// Seed of initial weights and batches
    #[arg(long)]
    seed: Option<u64>,
    /// Memory for training data, MiB
    #[arg(long)]
    cache_mib: Option<usize>,
    /// Print the configuration and stop
    #[arg(long)]
    print_config: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum StartArg {
    Ibl,
    Albedo,
    AlbedoIrradiance,
}

/// The bars of a run.
struct Bars {
    loading: Progress,
    /// From the first step on: what was before is none of its time.
    training: OnceLock<Progress>,
}

impl Bars {
    fn new(sequences: u64) -> Self {
        Self { loading: Progress::new("loading", sequences), training: OnceLock::new() }
    }

    fn loading(&self, done: usize, total: usize) {
        self.loading.length(total as u64);
        self.loading.set(done as u64);
    }

    fn note(&self, note: &str) {
        self.loading.hide(|| eprintln!("note: {note}"));
    }

    /// `share` of the run is done.
    fn step(&self, share: f64, message: String) {
        let done = (1000.0 * share) as u64;
        let training = self.training.get_or_init(|| {
            let training = Progress::new("training", 1000);
            training.resume(done);
            training
        });
        training.message(message);
        training.set(done);
    }

    /// Says where a finished run's weights are; an unfinished one is an interruption.
    fn finish<R>(&self, summary: &Summary<R>) -> Result<()> {
        if !summary.finished {
            return Err(Interrupted.into());
        }
        if let Some(training) = self.training.get() {
            training.finish();
        }
        println!("{} steps in {:.0} s: {}", summary.steps, summary.elapsed, summary.weights.display());
        Ok(())
    }
}

impl Train {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        if let Some(plan) = &self.plan {
            return self.fusion(plan, cancel);
        }
        if let Some(config) = self.wan_config()? {
            return self.wan(&config, cancel);
        }
        for (flag, given) in [("--vae", self.vae.is_some()), ("--from", self.from.is_some())] {
            ensure!(!given, "{flag} is of the paper's network: name its --preset or a configuration of it");
        }
        let config = self.config()?;
        if self.print_config {
            println!("{}", serde_json::to_string_pretty(&config)?);
            return Ok(());
        }
        let (dataset, notes) = Dataset::open_to_learn(self.data()?)?;
        let bars = Bars::new(dataset.sequences.len() as u64);
        notes.iter().for_each(|note| bars.note(note));
        let tell = |progress: &train::Progress| match progress {
            train::Progress::Loading { done, total } => bars.loading(*done, *total),
            train::Progress::Note(note) => bars.note(note),
            train::Progress::Step(record) => bars.step(
                record.share,
                format!(
                    "step {} loss {:.5} display {:.2} dB, {:.1} images/s",
                    record.step, record.loss, record.display_psnr, record.images_per_second
                ),
            ),
        };
        bars.finish(&train::run(&config, &dataset, &tell, cancel)?)
    }

    fn data(&self) -> Result<&Path> {
        self.data.as_deref().context("--data is missing")
    }

    fn config(&self) -> Result<Config> {
        let mut config: Config = match &self.config {
            Some(path) => renderflow_frame::file::read_json(path)?,
            None => Config::default(),
        };
        config.output = self.out.clone();
        if let Some(start) = self.start {
            config.network.start = match start {
                StartArg::Ibl => Start::Ibl,
                StartArg::Albedo => Start::Albedo,
                StartArg::AlbedoIrradiance => Start::AlbedoIrradiance,
            };
        }
        if let Some(base) = &self.base {
            config.stage = Stage::Keyframes { base: base.clone(), network: KeyframeConfig::default() };
        }
        config.steps = self.steps.unwrap_or(config.steps);
        config.minutes = self.minutes.or(config.minutes);
        config.seed = self.seed.unwrap_or(config.seed);
        config.cache_mib = self.cache_mib.unwrap_or(config.cache_mib);
        if config.minutes.is_some() && self.steps.is_none() {
            // Time decides.
            config.steps = u64::MAX;
        }
        Ok(config)
    }
}
