//! The command line: one file for each subcommand.

mod check;
mod compose;
mod dataset;
mod demo;
mod doctor;
mod edit;
mod evaluate;
mod export;
mod hdri;
mod infer;
mod invert;
mod manual;
mod pack;
mod paper;
pub mod program;
mod render;
mod report;
mod scene;
mod slurm;
mod stress;
mod testset;
mod train;
mod view;
mod weights;

use crate::dataset::denoise::Denoise;
use crate::evaluate::method::Method;
use crate::evaluate::renderer;
use crate::util::device::{self, DeviceArgs};
use crate::util::ranges::within;
use crate::util::stop;
use crate::util::text::plural;
use crate::util::weights::{autoencoder, digest, digests, inside};
use anyhow::{Result, bail, ensure};
use clap::error::ErrorKind;
use clap::{Args, Parser, Subcommand};
use renderflow_model::device::NetworkDevice;
use renderflow_model::fusion::{Fusion, FusionNet};
use renderflow_model::network::trained::Described;
use renderflow_model::renderer::Renderer;
use renderflow_model::wan::{self, Autoencoder};
use renderflow_renderer::Settings;
use renderflow_scenes::LoadReport;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const HELP: &str = "\
Examples:
  renderflow demo                                  the whole pipeline on one scene; open demo-out/report/index.html
  renderflow render model.glb -o out               a path-traced picture of a model: out/frame.0000.png and .exr
  renderflow doctor                                what the program found on this machine

Exit codes: 0 done, 1 failed, 2 usage, 75 interrupted and resumable, 130 interrupted with nothing to resume (check).";

/// From a seed to an evaluated neural image: path-traced ground truth, a single-step neural renderer, and their comparison.
#[derive(Parser)]
#[command(version, about, long_about = None, after_help = HELP)]
struct Cli {
    #[command(flatten)]
    common: program::Common,
    #[command(subcommand)]
    command: Command,
}

// A variant without a comment takes its help from the comment of its options, which is longer.
#[derive(Subcommand)]
enum Command {
    Demo(demo::Demo),
    Render(render::Render),
    View(view::View),
    /// Write a procedurally composed scene as JSON
    Compose(compose::Compose),
    Check(check::Check),
    /// What became of `renderflow bench`
    #[command(hide = true, disable_help_flag = true)]
    Bench {
        /// What was asked of it
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    Stress(stress::Stress),
    /// Plan and render datasets
    #[command(subcommand, after_help = dataset::HELP)]
    Dataset(dataset::DatasetCommand),
    Train(train::TrainCommand),
    Infer(infer::Infer),
    Invert(invert::Invert),
    /// Make the test sets that numbers are reported on
    #[command(subcommand, after_help = "Example: renderflow testset make synthetic -o sets")]
    Testset(testset::TestsetCommand),
    Edit(edit::Edit),
    /// Compare methods, or anybody's pictures, with path-traced truth
    Evaluate(evaluate::Evaluate),
    Paper(paper::Paper),
    /// Make a report from the results of an evaluation
    Report(report::Report),
    /// Make the skies and studios in hdri/ again
    Hdri(hdri::Hdri),
    /// Print the JSON Schema of scene files
    #[command(after_help = "Example: renderflow schema > scene.schema.json")]
    Schema,
    Weights(weights::Weights),
    /// Show what the program found on this machine
    Doctor(doctor::Doctor),
    /// Print the completions of a shell
    Completions(manual::Completions),
    /// Write man pages
    Man(manual::Man),
}

/// Said to whoever runs `renderflow bench`.
const BENCH_MOVED: &str = "the measurements are in the program renderflow-bench (cargo build --release -p renderflow-bench); \
    `bench inverse` and `bench autoencoder` are `renderflow evaluate inverse` and `renderflow evaluate autoencoder`\n";

/// Parses the command line of this process and runs it.
pub fn main() -> ExitCode {
    main_with(std::env::args_os()).into()
}

/// Parses a command line, whose first argument is the name of the program, and runs it. Returns the exit code.
pub fn main_with(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    program::exit_code(run(Cli::parse_from(arguments)))
}

fn run(cli: Cli) -> Result<()> {
    let (allowed, cancel) = cli.common.start()?;
    match cli.command {
        Command::Demo(command) => command.run(&allowed, &cancel),
        Command::Render(command) => command.run(&allowed, &cancel),
        Command::View(command) => command.run(&allowed, &cancel),
        Command::Compose(command) => stop::at_once(stop::NOTHING_TO_RESUME, || command.run()),
        Command::Check(command) => stop::at_once(stop::NOTHING_TO_RESUME, || command.run(&allowed)),
        Command::Bench { .. } => clap::Error::raw(ErrorKind::InvalidSubcommand, BENCH_MOVED).exit(),
        Command::Stress(command) => command.run(&cancel),
        Command::Dataset(command) => command.run(&allowed, &cancel),
        Command::Train(command) => command.run(&allowed, &cancel),
        Command::Infer(command) => command.run(&allowed, &cancel),
        Command::Invert(command) => command.run(&cancel),
        Command::Testset(command) => command.run(&allowed, &cancel),
        Command::Edit(command) => command.run(&allowed, &cancel),
        Command::Evaluate(command) => command.run(&allowed, &cancel),
        Command::Paper(command) => command.run(&cancel),
        Command::Report(command) => command.run(&cancel),
        Command::Hdri(command) => command.run(),
        Command::Schema => {
            println!("{}", serde_json::to_string_pretty(&renderflow_scenes::schema::json_schema())?);
            Ok(())
        }
        Command::Weights(command) => command.run(),
        Command::Doctor(command) => command.run(),
        Command::Completions(command) => {
            command.run();
            Ok(())
        }
        Command::Man(command) => command.run(),
    }
}

/// Options of every command that traces paths.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Sampling")]
struct TraceArgs {
    /// Samples for each pixel; 256 by default, 128 in the demo and for edits
    #[arg(long, value_parser = within(Settings::SPP))]
    spp: Option<u32>,
    /// How often a path may scatter
    #[arg(long, default_value_t = Settings::default().max_bounces, value_parser = within(Settings::MAX_BOUNCES))]
    max_bounces: u32,
    /// How to denoise the picture
    #[arg(long, value_enum, default_value_t, help_heading = "Denoising")]
    denoise: Denoise,
}

impl TraceArgs {
    /// The settings of the renderer that follow from these options; `usual` samples for each pixel by default.
    fn settings(&self, usual: u32) -> Settings {
        Settings { spp: self.spp.unwrap_or(usual), max_bounces: self.max_bounces, ..Settings::default() }
    }
}

/// Opens what a command has made.
#[derive(Args, Clone, Copy, Debug)]
struct OpenArgs {
    /// Open the result with the program that the desktop uses for it
    #[arg(long, help_heading = "Output")]
    open: bool,
}

impl OpenArgs {
    /// Opens the file at `path` if the user asked for it. A desktop that cannot do so is no failure of the work.
    fn open(self, path: &Path) {
        if self.open
            && let Err(error) = open::that_detached(path)
        {
            eprintln!("note: {}: cannot be opened: {error}", path.display());
        }
    }
}

/// Weights of a network that renders.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Network")]
struct WeightsArgs {
    /// Weights of a network; the file says which network. Without it, the weights inside the program are used
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Weights of the autoencoder of the paper's network. Without it, vae.safetensors beside --weights is used
    #[arg(long, requires = "weights")]
    vae: Option<PathBuf>,
    /// Encode and decode larger pictures in tiles of this many pixels a side, which overlap by a quarter. Tiles need less memory,
    /// and pixels near their edges change slightly
    #[arg(long, requires = "weights")]
    tile: Option<usize>,
    #[command(flatten)]
    device: DeviceArgs,
}

impl WeightsArgs {
    /// The network that reads samples, if the options choose it.
    fn fusion(&self, device: &NetworkDevice) -> Result<Option<Fusion>> {
        match &self.weights {
            Some(path) if !Fusion::recognises(path) => Ok(None),
            weights => Ok(Some(fusion(weights.as_deref(), device)?)),
        }
    }

    /// The paper's network in the file at `weights`.
    fn wan(&self, weights: &Path, device: &NetworkDevice) -> Result<Box<dyn Renderer>> {
        Ok(wan::open(weights, Autoencoder { file: self.vae.as_deref(), tile: self.tile }, device)?)
    }

    /// BLAKE3 of every weights file; without one, of the weights of `N` inside the program.
    fn digests<N: Described>(&self) -> Result<Vec<String>> {
        digests::<N>(self.weights.as_deref(), self.vae.as_deref())
    }
}

/// The network that reads samples, in the file `weights` or inside the program, on a device.
fn fusion(weights: Option<&Path>, device: &NetworkDevice) -> Result<Fusion> {
    Ok(weights.map_or_else(Fusion::shipped, Fusion::load)?.to(device)?)
}

/// Weights of both networks, for a comparison.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Network")]
struct AllWeightsArgs {
    /// Weights of the network that reads samples, or of the paper's network; the file says which. May be given once for each.
    /// Without weights for the network that reads samples, those inside the program are used
    #[arg(long)]
    weights: Vec<PathBuf>,
    /// Weights of the autoencoder of the paper's network. Without it, vae.safetensors beside the network's own weights is used
    #[arg(long, requires = "weights")]
    vae: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// The networks that make the rows of a comparison.
struct Networks {
    /// The one that reads samples.
    fusion: Option<Fusion>,
    /// The paper's.
    wan: Option<Box<dyn Renderer>>,
    /// Where they run.
    device: NetworkDevice,
    /// What their weights are, and the BLAKE3 of each.
    digests: Vec<(&'static str, String)>,
}

impl AllWeightsArgs {
    /// Opens the networks that `methods` need. The one inside the program stands in where no file holds the network that reads
    /// samples.
    fn open(&self, methods: &[Method]) -> Result<Networks> {
        let device = self.device.open()?;
        let mut networks = Networks { fusion: None, wan: None, device, digests: Vec::new() };
        let (mut fusion_digest, mut wan_digests) = (None, Vec::new());
        for path in &self.weights {
            let twice = || format!("{}: --weights names two networks of this kind", path.display());
            if Fusion::recognises(path) {
                ensure!(networks.fusion.replace(fusion(Some(path), &networks.device)?).is_none(), twice());
                fusion_digest = Some(digest(path)?);
            } else {
                let parts = Autoencoder { file: self.vae.as_deref(), tile: None };
                ensure!(networks.wan.replace(wan::open(path, parts, &networks.device)?).is_none(), twice());
                wan_digests.push((WAN_DIGEST, digest(path)?));
                wan_digests.push((AUTOENCODER_DIGEST, digest(&autoencoder(self.vae.as_deref(), path))?));
            }
        }
        if let Some(vae) = self.vae.as_ref().filter(|_| networks.wan.is_none()) {
            bail!("{}: an autoencoder, but none of --weights is a network that needs one", vae.display());
        }
        if !methods.iter().any(Method::is_neural) {
            networks.fusion = None;
        } else if networks.fusion.is_none() {
            networks.fusion = Some(fusion(None, &networks.device)?);
        }
        if networks.fusion.is_some() {
            let digest = fusion_digest.or_else(inside::<FusionNet>);
            networks.digests.extend(digest.map(|digest| (FUSION_DIGEST, digest)));
        }
        if methods.iter().any(Method::is_wan) {
            networks.digests.extend(wan_digests);
        } else {
            networks.wan = None;
        }
        Ok(networks)
    }
}

/// Names of the settings that tell weights apart: files with the same header may hold other values.
const FUSION_DIGEST: &str = "network, BLAKE3";
const WAN_DIGEST: &str = "network (wan), BLAKE3";
const AUTOENCODER_DIGEST: &str = "autoencoder (wan), BLAKE3";

impl Networks {
    /// Options of rendering by `methods` with these networks.
    fn rendering<'a>(&'a self, methods: &'a [Method]) -> renderer::Options<'a> {
        renderer::Options { fusion: self.fusion.as_ref(), wan: self.wan.as_deref(), ..renderer::Options::new(methods) }
    }

    /// What the weights say about themselves, and what tells them apart, as settings for a report.
    fn settings(&self) -> Vec<(String, String)> {
        let fusion = self.fusion.as_ref().and_then(|fusion| serde_json::to_string(fusion.header()).ok());
        let wan = self.wan.as_ref().map(|wan| wan.about().header);
        let named = [("network", fusion), ("network (wan)", wan), ("device", device::recorded(&self.device))];
        let named = named.into_iter().filter_map(|(name, header)| Some((name, header?)));
        named.chain(self.digests.iter().cloned()).map(|(name, value)| (name.to_owned(), value)).collect()
    }
}

/// Prints what loading had to decide. It prints nothing where there was nothing to decide.
fn print_report(report: &LoadReport) {
    let counted = [
        (report.triangles.out_of_range, "triangle", "dropped: a vertex that does not exist"),
        (report.triangles.not_finite, "triangle", "dropped: a coordinate that is not finite"),
        (report.triangles.no_area, "triangle", "dropped: no area"),
        (report.triangles.duplicate, "triangle", "dropped: there already"),
        (report.triangles.needles, "needle triangle", "kept (a million times longer than high)"),
        (report.repaired_texels, "texel", "of the environment made black: not finite or negative"),
    ];
    for (count, noun, what) in counted.into_iter().filter(|(count, ..)| *count > 0) {
        eprintln!("note: {} {what}", plural(count, noun));
    }
    for note in &report.notes {
        eprintln!("note: {note}");
    }
}
