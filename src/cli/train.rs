mod fusion;
mod monitor;
mod reference;
mod wan;

use crate::util::cancel::{Cancel, Interrupted};
use crate::util::progress::Progress;
use anyhow::{Context, Result};
use clap::Args;
use renderflow_model::train::runner::Summary;
use renderflow_model::wan::FlowConfig;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const HELP: &str = "\
Examples, the network that reads samples, keyframes and deferred shading:
  renderflow train --plan plan.toml --minutes 120 --out runs/fusion
  renderflow train --data data/train --minutes 45 --from runs/fusion/weights.safetensors --out runs/mine

The paper's network, from its autoencoder to keyframes and the way back (wan-1.3b begins with published weights: --from FILE):
  renderflow train --preset wan-small --stage autoencoder --data data/train --minutes 60 --out runs/vae
  renderflow train --preset wan-small --stage base --vae runs/vae/weights.safetensors --data data/train --minutes 120 --out runs/wan
  renderflow train --preset wan-small --stage keyframes --vae runs/vae/weights.safetensors --base runs/wan/weights.safetensors \\
      --data data/train --minutes 60 --out runs/wan-keys
  renderflow train --preset wan-small --stage inverse --vae runs/vae/weights.safetensors --base runs/wan/weights.safetensors \\
      --data data/train --minutes 60 --out runs/wan-inverse";

/// Trains a network: the one that reads samples, from a plan or a dataset; with --preset the paper's, from its autoencoder to adapters on the
/// frozen renderer. Checkpoints as it goes; run again with the same options, it resumes.
#[derive(Args)]
#[command(after_help = HELP)]
pub struct Train {
    /// A split of a dataset. The network that reads samples takes the truth from its frames and renders the rest from their scenes; it is
    /// validated on the split `val` beside it
    #[arg(long, required_unless_present_any = ["plan", "print_config"])]
    data: Option<PathBuf>,
    /// A plan (see `dataset plan`): its training sequences are composed and rendered beside the steps; nothing is stored
    #[arg(long, conflicts_with_all = ["data", "preset", "vae", "base", "cache_mib"])]
    plan: Option<PathBuf>,
    /// Folder for checkpoint, log.jsonl and weights.safetensors; but for the paper's network also curves.html, TensorBoard's events and
    /// pictures
    #[arg(long)]
    out: PathBuf,
    /// Every option of either network as JSON (as printed by --print-config); flags win over it
    #[arg(long)]
    config: Option<PathBuf>,
    /// A size of the paper's network in place of the network that reads samples
    #[arg(long, value_parser = FlowConfig::PRESETS, requires = "stage", conflicts_with = "config")]
    preset: Option<String>,
    /// What of the paper's network is trained
    #[arg(long, value_enum, requires = "preset")]
    stage: Option<wan::StageArg>,
    /// Weights of the autoencoder of the paper's network
    #[arg(long)]
    vae: Option<PathBuf>,
    /// Weights to begin with: of this program, and for the paper's network published ones of Wan or VACE
    #[arg(long)]
    from: Option<PathBuf>,
    /// Train an adapter of the paper's network on this base
    #[arg(long, requires = "preset")]
    base: Option<PathBuf>,
    /// Optimiser steps
    #[arg(long)]
    steps: Option<u64>,
    /// Minutes over all resumptions; the learning rate anneals to this end
    #[arg(long)]
    minutes: Option<f64>,
    /// Seed of initial weights and batches
    #[arg(long)]
    seed: Option<u64>,
    /// Memory for training data of the paper's network, MiB
    #[arg(long)]
    cache_mib: Option<usize>,
    /// Print the configuration and stop
    #[arg(long)]
    print_config: bool,
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

    fn loading(&self, done: u64, total: u64) {
        self.loading.length(total);
        self.loading.set(done);
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
    fn finish(&self, summary: &Summary) -> Result<()> {
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
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        match self.wan_config()? {
            Some(config) => self.wan(&config, cancel),
            None => self.fusion(allowed, cancel),
        }
    }

    fn data(&self) -> Result<&Path> {
        self.data.as_deref().context("--data is missing")
    }
}
