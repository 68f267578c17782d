//! `train`: trains the fusion network, the inverse network, or the paper's network stage by stage.

mod done;
mod fusion;
mod inverse;
mod monitor;
mod reference;
mod sequences;
mod slurm;
mod wan;

use super::program;
use crate::dataset::Sequence;
use crate::util::cancel::{Cancel, Interrupted};
use crate::util::device::{self, DeviceArgs};
use crate::util::output::Hold;
use crate::util::progress::{self, Display, Progress};
use crate::util::stop;
use crate::util::text::plural;
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Subcommand};
use renderflow_frame::{file, words};
use renderflow_model::device::DeviceChoice;
use renderflow_model::fusion::training::Config as FusionConfig;
use renderflow_model::inverse::training::Config as InverseConfig;
use renderflow_model::network::trained::{Described, Trained};
use renderflow_model::train::runner::Summary;
use renderflow_model::train::{RunConfig, Team};
use renderflow_model::wan::FlowConfig;
use renderflow_model::wan::train::{Config as WanConfig, StageName};
use sequences::Options;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

const HELP: &str = "\
Examples for the fusion network, which reads samples, keyframes and deferred shading:
  renderflow train --plan plan.toml --minutes 120 -o runs/fusion
  renderflow train --data data/train --minutes 45 --from runs/fusion/weights.safetensors -o runs/mine

Examples for the paper's network, in its order of stages (with wan-1.3b, add --from FILE to begin with published weights):
  renderflow train --preset wan-small --stage autoencoder --data data/train --minutes 60 -o runs/vae
  renderflow train --preset wan-small --stage base --vae runs/vae/weights.safetensors --data data/train --minutes 120 -o runs/wan
  renderflow train --preset wan-small --stage keyframes --vae runs/vae/weights.safetensors --base runs/wan/weights.safetensors \\
      --data data/train --minutes 60 -o runs/wan-keys
  renderflow train --preset wan-small --stage inverse --vae runs/vae/weights.safetensors --base runs/wan/weights.safetensors \\
      --data data/train --minutes 60 -o runs/wan-inverse

Several processes train together, each on a part of every batch (docs/scale-out.md; built with --features mpi):
  mpirun -n 2 --bind-to none renderflow train --plan plan.toml --keep kept --minutes 120 -o runs/fusion --threads 8

The inverse network, which invert uses, is trained by a file run.json that holds {\"network\": \"inverse\"}:
  renderflow train --config run.json --plan plan.toml --minutes 120 -o runs/inverse

A configuration file names its network: \"network\": \"fusion\", \"inverse\" or \"wan\". --print-config shows every option.";

/// Train a network: the one that reads samples, the one that inverts pictures, or the paper's
///
/// Without --preset, this trains the fusion network, or the network that --config names, on a plan or a dataset. With --preset,
/// it trains a stage of the paper's network on a dataset. The run writes checkpoints; the same command resumes a run that was
/// stopped.
#[derive(Args)]
#[command(after_help = HELP, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct TrainCommand {
    #[command(subcommand)]
    other: Option<Other>,
    #[command(flatten)]
    train: Option<Train>,
}

#[derive(Subcommand)]
enum Other {
    Slurm(slurm::SlurmArgs),
}

impl TrainCommand {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        match (self.other, self.train) {
            (Some(Other::Slurm(command)), _) => command.run(allowed),
            (None, Some(train)) => train.run(allowed, cancel),
            // clap has asked for what is required.
            (None, None) => bail!("--out is missing"),
        }
    }
}

/// The name of the weights inside the program, for --from.
const SHIPPED: &str = "shipped";

/// The options of a training.
#[derive(Args)]
struct Train {
    /// Folder of one split of a dataset. The fusion and the inverse network take the truth from its frames and render the rest
    /// from their scenes; they are validated on the split `val` beside it
    #[arg(long, required_unless_present_any = ["plan", "print_config"], help_heading = "Input")]
    data: Option<PathBuf>,
    /// Plan file (see `dataset plan`) for the fusion or the inverse network. Its training sequences are composed and rendered
    /// during training, and are not stored
    #[arg(long, conflicts_with_all = ["data", "preset", "vae", "base", "cache_mib"], help_heading = "Input")]
    plan: Option<PathBuf>,
    /// Folder that keeps the sequences which the fusion or the inverse network learns from. Later runs with the same plan or
    /// dataset and the same recipe read them from there instead of rendering them. A sequence of five frames takes up to 35 MB at
    /// 256x256
    #[arg(long, value_name = "DIR", conflicts_with = "preset", help_heading = "Input")]
    keep: Option<PathBuf>,
    /// Folder for the checkpoint, log.jsonl and weights.safetensors. The fusion and the inverse network also write curves.html,
    /// TensorBoard events and pictures
    #[arg(long, short, required_unless_present = "print_config", help_heading = "Output")]
    out: Option<PathBuf>,
    /// JSON file with the options of a network, as --print-config prints them. Other flags override it
    #[arg(long, help_heading = "Input")]
    config: Option<PathBuf>,
    /// Train the paper's network at this size
    #[arg(long, value_parser = FlowConfig::PRESETS, requires = "stage", conflicts_with = "config", help_heading = "Network")]
    preset: Option<String>,
    /// Stage of the paper's network to train
    #[arg(long, value_enum, requires = "preset", help_heading = "Network")]
    stage: Option<StageName>,
    /// Weights of the autoencoder of the paper's network
    #[arg(long, help_heading = "Network")]
    vae: Option<PathBuf>,
    /// Weights to begin with, written by this program; `shipped` for those inside the program. The paper's network can also begin
    /// with published weights of Wan or VACE
    #[arg(long, help_heading = "Network")]
    from: Option<PathBuf>,
    /// Weights of the renderer on which an adapter of the paper's network is trained
    #[arg(long, requires = "preset", help_heading = "Network")]
    base: Option<PathBuf>,
    /// Number of optimiser steps
    #[arg(long, help_heading = "Training")]
    steps: Option<u64>,
    /// Minutes of training over all resumptions. The learning rate is annealed by the end. Crops that begin later in a run
    /// (`crops` of the configuration) go by --steps alone
    #[arg(long, help_heading = "Training")]
    minutes: Option<f64>,
    /// Seed of the initial weights and of the batches
    #[arg(long, help_heading = "Training")]
    seed: Option<u64>,
    /// Memory for the training data of the paper's network, MiB
    #[arg(long, help_heading = "Training")]
    cache_mib: Option<usize>,
    // A group of options inside of this one would hide from clap whether any option is there.
    #[arg(long, help = device::TRAINING, help_heading = "Network")]
    device: Option<DeviceChoice>,
    /// Print the configuration as JSON and exit
    #[arg(long, help_heading = "Output")]
    print_config: bool,
}

/// A configuration file. It names its network.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "network", rename_all = "lowercase")]
enum Configuration {
    /// The fusion network.
    Fusion(Box<Options<FusionConfig>>),
    /// The inverse network.
    Inverse(Box<Options<InverseConfig>>),
    /// The paper's network.
    Wan(Box<WanConfig>),
}

impl Configuration {
    fn read(path: &Path) -> Result<Self> {
        let mut file: Map<String, Value> = file::read_json(path)?;
        // Older files do not name their network. Those of the fusion network have these options.
        let fusion = ["training", "recipe"].iter().any(|option| file.contains_key(*option));
        file.entry("network").or_insert_with(|| if fusion { "fusion" } else { "wan" }.into());
        let parsed = serde_json::from_value(Value::Object(file));
        parsed.map_err(|e| renderflow_frame::Error::malformed(path, words::plain(&e.to_string())).into())
    }
}

/// What every training takes part in.
struct Session<'a> {
    team: &'a Team,
    bars: &'a Bars,
    folder: &'a OutputFolder<'a>,
    cancel: &'a Cancel,
}

/// The folder that a run writes to. One run at a time may; of several processes, the one that leads keeps others out.
struct OutputFolder<'a> {
    path: &'a Path,
    hold: RefCell<Option<Hold>>,
}

impl<'a> OutputFolder<'a> {
    fn new(path: &'a Path, team: &Team) -> Result<Self> {
        Ok(Self { path, hold: RefCell::new(team.leads().then(|| Hold::new(path)).transpose()?) })
    }

    /// Makes the folder, if there was none, and removes the temporary files of runs that were killed. Must be called before the
    /// first file is written.
    fn begin(&self) -> Result<()> {
        let mut hold = self.hold.borrow_mut();
        let Some(hold) = hold.as_mut() else { return Ok(()) };
        hold.begin()?;
        file::remove_leftovers(self.path);
        Ok(())
    }
}

/// The progress bars of a run. Of several processes, one shows them.
struct Bars {
    /// Whether this process shows them.
    shown: bool,
    loading: Progress,
    /// Begins with the first step, so that its time leaves out the loading.
    training: OnceLock<Progress>,
}

impl Bars {
    fn new(team: &Team, sequences: u64) -> Self {
        if !team.leads() {
            progress::display(Display::Nothing);
        }
        Self { shown: team.leads(), loading: Progress::new("loading", sequences), training: OnceLock::new() }
    }

    fn loading(&self, done: u64, total: u64) {
        self.loading.length(total);
        self.loading.set(done);
    }

    fn note(&self, note: &str) {
        if self.shown {
            self.loading.hide(|| eprintln!("note: {note}"));
        }
    }

    /// Shows the share of the run that is done.
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

    /// Prints where the weights of a finished run are. An unfinished run was interrupted.
    fn finish(&self, summary: &Summary) -> Result<()> {
        if !summary.finished {
            return Err(Interrupted.into());
        }
        if let Some(training) = self.training.get() {
            training.finish();
        }
        if self.shown {
            println!("{} in {:.0} s: {}", plural(summary.steps, "step"), summary.elapsed, summary.weights.display());
        }
        Ok(())
    }
}

impl Train {
    fn run(mut self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        if self.print_config {
            println!("{}", serde_json::to_string_pretty(&self.configuration()?)?);
            return Ok(());
        }
        let team = Team::from_environment()?;
        if team.size() > 1 {
            self.device = self.device.map(|choice| choice.of_process(team.place_on_machine()));
        }
        let done = self.train(&team, allowed, cancel);
        end(team, done)
    }

    /// Trains as a process of `team`.
    fn train(&self, team: &Team, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let configuration = self.configuration()?;
        if self.device == Some(DeviceChoice::Exact) && !matches!(configuration, Configuration::Wan(_)) {
            bail!("a run multiplies as \"products\" of its configuration says: \"f32\" or \"bf16\". cpu:f32 is for pictures");
        }
        let folder = &OutputFolder::new(self.out.as_deref().context("--out is missing")?, team)?;
        DeviceArgs::from(self.device).open()?;
        match configuration {
            Configuration::Fusion(options) => self.sequences(&options, team, folder, allowed, cancel),
            Configuration::Inverse(options) => self.sequences(&options, team, folder, allowed, cancel),
            Configuration::Wan(config) => self.wan(&config, team, folder, allowed, cancel),
        }
    }

    /// The configuration of the preset or of the file, with the other flags applied.
    fn configuration(&self) -> Result<Configuration> {
        let mut configuration = match (&self.preset, self.stage, &self.config) {
            (Some(preset), Some(stage), _) => Configuration::Wan(Box::new(self.preset(preset, stage)?)),
            (_, _, Some(path)) => Configuration::read(path)?,
            _ => Configuration::Fusion(Box::default()),
        };
        match &mut configuration {
            Configuration::Fusion(options) => {
                self.apply_flags(&mut options.training.run);
                self.check_sequences(options)?;
            }
            Configuration::Inverse(options) => {
                self.apply_flags(&mut options.training.run);
                self.check_sequences(options)?;
            }
            Configuration::Wan(config) => {
                for (flag, given) in [("--plan", self.plan.is_some()), ("--keep", self.keep.is_some())] {
                    ensure!(
                        !given,
                        "{flag} is for networks that learn from rendered sequences; this configuration is of the paper's"
                    );
                }
                self.apply_flags(&mut config.run);
                self.apply_wan_flags(config)?;
            }
        }
        Ok(configuration)
    }

    /// Applies the flags that all networks have.
    fn apply_flags(&self, run: &mut RunConfig) {
        run.output = self.out.clone().unwrap_or_default();
        run.steps = self.steps.unwrap_or(run.steps);
        run.minutes = self.minutes.or(run.minutes);
        run.seed = self.seed.unwrap_or(run.seed);
    }

    /// The network to begin with, if there is one.
    fn start<N: Described>(&self) -> Result<Option<Trained<N>>> {
        let Some(path) = &self.from else { return Ok(None) };
        if self.out.as_ref().is_some_and(|out| out.join("checkpoint.safetensors").is_file()) {
            eprintln!("note: --from has no effect, because the run goes on from its own checkpoint");
            return Ok(None);
        }
        Ok(Some(if path == Path::new(SHIPPED) { Trained::shipped()? } else { Trained::load(path)? }))
    }

    /// Refuses frames of `size` pixels that are smaller than a crop of `crop`, and says how to get smaller crops. `option` is
    /// where the configuration has them.
    fn check_crop(&self, size: [usize; 2], crop: usize, option: &str) -> Result<()> {
        let [width, height] = size;
        let command = match (&self.preset, &self.stage, &self.config) {
            (Some(preset), Some(_), _) => format!("renderflow train --preset {preset} --stage ... "),
            (_, _, Some(file)) => format!("renderflow train --config {} ", file.display()),
            _ => "renderflow train ".to_owned(),
        };
        ensure!(
            width.min(height) >= crop,
            "frames of {width} x {height} pixels are smaller than the crop of {crop}. Write the configuration with `{command}--print-config > \
             run.json`, set each /{option}/N/size to at most {}, and train with --config run.json",
            width.min(height)
        );
        Ok(())
    }

    fn data(&self) -> Result<&Path> {
        self.data.as_deref().context("--data is missing")
    }
}

/// Seconds for which the other processes let the first one say what is wrong: often it is the same with all.
const FIRST_SPEAKS: Duration = Duration::from_secs(2);

/// Returns the outcome of this process. If it has failed, this ends the other processes, which would wait for it for ever. If
/// all were interrupted, one says so.
fn end(team: Team, done: Result<()>) -> Result<()> {
    if done.is_ok() || team.size() == 1 {
        return done;
    }
    if team.has_parted() {
        if !team.leads() {
            drop(team);
            std::process::exit(stop::RESUMABLE.into());
        }
        return done;
    }
    if !team.leads() {
        std::thread::sleep(FIRST_SPEAKS);
        eprint!("process {} of 0..{}: ", team.share().rank, team.size());
    }
    team.abort(program::exit_code(done));
    Err(Interrupted.into())
}

/// Width and height of the smallest frame of a sequence.
fn smallest(sequence: &Sequence) -> [usize; 2] {
    let camera = sequence.transforms.cameras.iter().min_by_key(|camera| camera.width.min(camera.height));
    camera.map_or([0; 2], |camera| [camera.width, camera.height])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Configuration, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.json");
        std::fs::write(&path, text).expect("a file");
        Configuration::read(&path).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn a_configuration_names_its_network() {
        for (text, fusion) in [
            (r#"{"network": "fusion"}"#, true),
            (r#"{"network": "wan", "steps": 7}"#, false),
            // Files of older programs.
            (r#"{"training": {"network": {"widths": [16, 16, 16, 16]}, "steps": 7}}"#, true),
            (r#"{"recipe": {"frames": 2}}"#, true),
            (r#"{"steps": 7, "optimizer": {"learning_rate": 0.001}}"#, false),
            ("{}", false),
        ] {
            let configuration = read(text).expect(text);
            assert_eq!(matches!(configuration, Configuration::Fusion(_)), fusion, "{text}");
            let printed = serde_json::to_string_pretty(&configuration).expect("JSON");
            assert!(printed.contains(if fusion { r#""network": "fusion""# } else { r#""network": "wan""# }), "{printed}");
            assert_eq!(read(&printed).expect("what was printed"), configuration);
        }
        for (text, expected) in [
            (r#"{"network": "fusion", "steps": 7}"#, "unknown field `steps`, expected one of `training`, `recipe`, `validation`"),
            (r#"{"network": "wan", "training": {}}"#, "unknown field `training`, expected one of `batches`"),
            (r#"{"network": "nerf"}"#, "unknown name `nerf`, expected one of `fusion`, `inverse`, `wan`"),
            (r#"{"network": "wan", "steps": "many"}"#, "found the string \"many\" where a whole number from 0 on is needed"),
            (r#"{"training": {"rate": 1}}"#, "unknown field `rate`, expected one of `checkpoint_steps`"),
        ] {
            let said = read(text).expect_err(text);
            assert!(said.contains("run.json: ") && said.contains(expected), "{text}: {said}");
        }
    }
}
