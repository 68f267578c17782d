use super::OpenArgs;
use crate::paper::{self, Part, Scale};
use crate::util::cancel::Cancel;
use crate::util::device::DeviceArgs;
use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Run the paper's experiments on data of this program, table by table
///
/// The command renders the data, trains the paper's network in all the forms that the tables compare, evaluates them beside our
/// own network, deferred shading and path tracing, and writes each table beside the paper's numbers. If it was stopped, the same
/// command continues; what is finished is not made again, unless the weights, the metrics or, for seconds, the machine are
/// others.
#[derive(Args)]
#[command(after_help = "\
Examples:
  renderflow paper --smoke -o paper-smoke                      every table in tiny form, in a few minutes
  renderflow paper -o paper                                    everything: about nine hours on four cores
  renderflow paper --only methods,gaps --minutes 60 -o paper   two tables, with longer training

Writes paper.md, paper.json and pictures; data/, runs/ (weights and logs) and rows/ (scores) hold what they are made from.")]
pub struct Paper {
    /// Make every table in tiny form, to see that the experiments run. The numbers mean nothing
    #[arg(long, conflicts_with_all = ["minutes"], help_heading = "Experiments")]
    smoke: bool,
    /// Minutes of each training run; the autoencoder trains twice as long
    #[arg(long, default_value_t = 30.0, help_heading = "Experiments")]
    minutes: f64,
    /// Side of the pictures in pixels: a multiple of 32
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(64..=1024), conflicts_with = "smoke", help_heading = "Experiments")]
    resolution: u32,
    /// Make these tables only
    #[arg(long, value_enum, value_delimiter = ',', help_heading = "Experiments")]
    only: Vec<Part>,
    /// Weights of the network that reads samples. Without it, the weights inside the program are used
    #[arg(long, help_heading = "Network")]
    weights: Option<PathBuf>,
    /// Weights of an autoencoder for the paper's network, as `train --preset wan-small --stage autoencoder` writes them. Without
    /// it, one is trained first
    #[arg(long, help_heading = "Network")]
    vae: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Folder to write to
    #[arg(long, short, help_heading = "Output")]
    out: PathBuf,
    #[command(flatten)]
    open: OpenArgs,
    /// Print the tables as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Paper {
    pub fn run(self, cancel: &Cancel) -> Result<()> {
        ensure!(self.minutes.is_finite() && self.minutes > 0.0, "--minutes: {} is not a positive number", self.minutes);
        ensure!(self.resolution.is_multiple_of(32), "--resolution: {} is no multiple of 32", self.resolution);
        let lpips = super::evaluate::lpips()?;
        let fusion = super::fusion(self.weights.as_deref(), &self.device.open()?)?;
        let scale = if self.smoke { Scale::smoke() } else { Scale::whole(self.minutes, self.resolution) };
        let parts = if self.only.is_empty() { Part::value_variants() } else { &self.only };
        let options = paper::Options { parts, scale: &scale, fusion: &fusion, autoencoder: self.vae.as_deref(), lpips: &lpips };
        let (text, tables) = paper::run(&options, &self.out, cancel)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&tables)?);
        } else {
            print!("{text}");
        }
        self.open.open(&self.out.join(paper::TABLES));
        Ok(())
    }
}
