//! `renderflow bench`: one subcommand a measurement.

use crate::bench::{composed, kernels, peers, scenes};
use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Measures speed and error.
#[derive(Subcommand)]
pub enum Bench {
    /// Time against error over samples a pixel, on every benchmark scene
    Convergence(crate::bench::convergence::Options),
    /// What every skip saves, and that it does not show
    Skip(crate::bench::skip::Options),
    /// A frame of a sequence against a frame alone: what is kept from frame to frame
    Orbit(crate::bench::orbit::Options),
    /// Where the time of a frame with everything goes, on composed scenes
    Frame(crate::bench::frame::Options),
    /// Speed and memory over threads, triangles and resolutions
    Scaling(crate::bench::scaling::Options),
    /// List the benchmark scenes, or write one as a scene file with its models and textures
    Scenes(Scenes),
    /// Rays a second of the traversal kernels, beside Embree's
    Kernels(kernels::Options),
    /// Time against error beside Mitsuba 3 and Cycles
    Peers(peers::Options),
    /// What an autoencoder of the paper's network loses, by kind of picture and frame of a clip
    Autoencoder(crate::bench::autoencoder::Options),
    /// What recovered albedo, normals, depth and material are worth
    Inverse(crate::bench::inverse::Options),
}

impl Bench {
    /// Runs the measurement.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        match self {
            Self::Convergence(options) => options.run(allowed, cancel),
            Self::Scaling(options) => options.run(allowed, cancel),
            Self::Skip(options) => options.run(cancel),
            Self::Orbit(options) => options.run(allowed, cancel),
            Self::Frame(options) => options.run(allowed, cancel),
            Self::Scenes(options) => options.run(),
            Self::Kernels(options) => options.run(allowed, cancel),
            Self::Peers(options) => options.run(allowed, cancel),
            Self::Autoencoder(options) => options.run(cancel),
            Self::Inverse(options) => options.run(cancel),
        }
    }
}

/// Lists the benchmark scenes, or writes one.
#[derive(Args)]
#[command(
    after_help = "Example: renderflow bench scenes soft_sun --out soft_sun && renderflow render --scene soft_sun/scene.json --out out"
)]
pub struct Scenes {
    /// Scene to write
    name: Option<String>,
    /// Pixels along both sides
    #[arg(long, default_value_t = scenes::RESOLUTION)]
    resolution: u32,
    /// Folder to write it to
    #[arg(long)]
    out: Option<PathBuf>,
}

impl Scenes {
    fn run(self) -> Result<()> {
        let Some(name) = self.name else {
            scenes::ALL.iter().for_each(|scene| println!("{:9}  {}", scene.name, scene.about));
            println!("{:9}  {}", composed::ALL, composed::ABOUT);
            return Ok(());
        };
        let Some(scene) = scenes::describe(&name, self.resolution)? else {
            bail!("{name}: no such scene; `renderflow bench scenes` lists them")
        };
        let out = self.out.context("--out says which folder to write the scene to")?;
        println!("{}", scene.write(&out)?.display());
        Ok(())
    }
}
