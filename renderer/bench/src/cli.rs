//! The command line of `renderflow-bench`: one command a measurement.

use crate::{composed, convergence, files, frame, gallery, kernels, orbit, peers, scaling, scenes, skip};
use anyhow::{Context, Result, bail};
use clap::{Args, Parser, Subcommand};
use renderflow::cli::program::{self, Common};
use std::path::PathBuf;
use std::process::ExitCode;

/// Measures RenderFlow: rays, error against time, what is skipped, and the same scenes in other renderers.
#[derive(Parser)]
#[command(version, about, long_about = None, after_help = "Exit codes: 0 done, 1 failed, 2 usage, 75 interrupted and resumable.")]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Time against error over samples a pixel, on every benchmark scene
    Convergence(convergence::Options),
    /// Time saved by each skip, and proof that the picture stays the same
    Skip(skip::Options),
    /// A frame of a sequence against a frame alone: what is kept from frame to frame
    Orbit(orbit::Options),
    /// Where the time of a frame with everything goes, on composed scenes
    Frame(frame::Options),
    /// Speed and memory over threads, triangles and resolutions
    Scaling(scaling::Options),
    /// List the benchmark scenes, or write one as a scene file with its models and textures
    Scenes(Scenes),
    /// Rays a second of the traversal kernels, beside Embree's
    Kernels(kernels::Options),
    /// Time against error beside Mitsuba 3 and Cycles
    Peers(peers::Options),
    /// Glass, panes and blended surfaces beside Mitsuba 3 and Cycles: how far the pictures differ
    Agree(peers::agree::Options),
    /// Models as the program shows them, on one labelled sheet
    Gallery(gallery::Options),
    /// Bytes and seconds of frames as OpenEXR and in the compact form
    Files(files::Options),
}

/// Parses the command line and runs it.
pub fn main() -> ExitCode {
    program::exit_code(run(Cli::parse())).into()
}

fn run(cli: Cli) -> Result<()> {
    let (allowed, cancel) = cli.common.start()?;
    match cli.command {
        Command::Convergence(options) => options.run(&allowed, &cancel),
        Command::Skip(options) => options.run(&cancel),
        Command::Orbit(options) => options.run(&allowed, &cancel),
        Command::Frame(options) => options.run(&allowed, &cancel),
        Command::Scaling(options) => options.run(&allowed, &cancel),
        Command::Scenes(scenes) => scenes.run(),
        Command::Kernels(options) => options.run(&allowed, &cancel),
        Command::Peers(options) => options.run(&allowed, &cancel),
        Command::Agree(options) => options.run(&allowed, &cancel),
        Command::Gallery(options) => options.run(&allowed, &cancel),
        Command::Files(options) => options.run(&cancel),
    }
}

/// Lists the benchmark scenes, or writes one.
#[derive(Args)]
#[command(
    after_help = "Example: renderflow-bench scenes soft_sun --out soft_sun && renderflow render --scene soft_sun/scene.json --out out"
)]
struct Scenes {
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
            scenes::ALL.iter().chain(&scenes::CLEAR).for_each(|scene| println!("{:12}  {}", scene.name, scene.about));
            println!("{:12}  {}", composed::ALL, composed::ABOUT);
            return Ok(());
        };
        let Some(scene) = scenes::describe(&name, self.resolution)? else {
            bail!("{name}: no such scene; `renderflow-bench scenes` lists them")
        };
        let out = self.out.context("--out says which folder to write the scene to")?;
        println!("{}", scene.write(&out)?.display());
        Ok(())
    }
}
