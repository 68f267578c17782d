//! `train slurm`: a job that trains with several processes.

use super::{Configuration, Train};
use crate::dataset::slurm::{Memory, WAIT, directives, fill, full, set_mode, word};
use crate::util::output;
use crate::util::text::plural;
use anyhow::{Context, Result, ensure};
use clap::{Args, Parser, ValueEnum};
use renderflow_frame::words::shell;
use renderflow_model::train::Share;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

const JOB: &str = include_str!("job.sh");

const EXAMPLE: &str = "Example:\n  renderflow train slurm --nodes 2 --processes 2 --cpus 16 --script-dir jobs -- \
    --plan plan.toml --keep kept -o runs/big";

/// What starts the processes of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Launcher {
    /// Slurm itself; its plugin for PMIx must be installed.
    Srun,
    /// The launcher of Open MPI.
    Mpirun,
}

/// Write a Slurm job that trains with several processes
///
/// What follows -- is the command line of the training. The job goes on from the last checkpoint when its time is up, when a
/// process is killed and when a node dies.
#[derive(Args)]
#[command(after_help = EXAMPLE)]
pub struct SlurmArgs {
    /// Folder for job.sh
    #[arg(long, help_heading = "Output")]
    script_dir: PathBuf,
    /// Replace a script that was edited or made with other options
    #[arg(long, help_heading = "Output")]
    overwrite: bool,
    /// Nodes of the job
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Job")]
    nodes: u32,
    /// Processes on all nodes together. Each makes an equal part of every batch
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Job")]
    processes: u32,
    /// Processor cores of a process
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Job")]
    cpus: u32,
    /// Memory on each node
    #[arg(long, default_value = "32G", help_heading = "Job")]
    memory: Memory,
    /// Time limit of the job. It must suffice for loading and some steps; a longer run is requeued
    #[arg(long, default_value = "24:00:00", help_heading = "Job")]
    time: String,
    /// Slurm partition; by default the cluster's own default
    #[arg(long, help_heading = "Job")]
    partition: Option<String>,
    /// Slurm account
    #[arg(long, help_heading = "Job")]
    account: Option<String>,
    /// What starts the processes
    #[arg(long, value_enum, default_value = "srun", help_heading = "Job")]
    launcher: Launcher,
    /// How often the job starts again after it failed or was interrupted
    #[arg(long, default_value_t = 20, help_heading = "Job")]
    retries: u32,
    /// Seconds before the end of --time at which the processes are told to stop after their step. A step, a checkpoint and a
    /// validation should take less; with mpirun, less than a third of it
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..=65535), help_heading = "Job")]
    grace: u32,
    /// One more option for sbatch, such as "--qos=long"; may be given several times
    #[arg(long, allow_hyphen_values = true, help_heading = "Job")]
    extra: Vec<String>,
    /// Path of this program on the nodes; by default its path here
    #[arg(long, help_heading = "Job")]
    program: Option<PathBuf>,
    /// Options of the training
    #[arg(last = true, required = true)]
    training: Vec<OsString>,
}

/// The command line of a training.
#[derive(Parser)]
#[command(name = "renderflow train")]
struct Line {
    #[command(flatten)]
    train: Train,
}

impl SlurmArgs {
    pub fn run(self, allowed: &[PathBuf]) -> Result<()> {
        let words = std::iter::once("renderflow train".into()).chain(self.training.iter().cloned());
        let Line { train } = Line::try_parse_from(words).unwrap_or_else(|error| error.exit());
        let share = Share { rank: 0, size: self.processes as usize };
        match train.configuration()? {
            Configuration::Fusion(options) => share.check_crops(&options.training.crops)?,
            Configuration::Inverse(options) => share.check_crops(&options.training.crops)?,
            Configuration::Wan(config) => {
                config.batches.iter().try_for_each(|batch| share.check_batch("batches.items", batch.items))?;
            }
        }
        ensure!(
            self.processes == 1 || cfg!(feature = "mpi") || self.program.is_some(),
            "this program was built without MPI. Build it with `cargo build --release --features mpi`, or name another with --program"
        );
        if self.processes > 1 && train.preset.is_none() && train.keep.is_none() {
            eprintln!(
                "note: every process will render all sequences: with --keep and a folder that all see, they share the rendering"
            );
        }
        let job = self.script_dir.join("job.sh");
        let script = self.script(&std::env::current_dir().context("there is no current folder")?, allowed)?;
        output::write(&[(job.clone(), script.into_bytes())], self.overwrite)?;
        set_mode(&job, 0o755).with_context(|| format!("{}: cannot be made executable", job.display()))?;
        let (processes, nodes) = (plural(self.processes, "process"), plural(self.nodes, "node"));
        println!("{processes} on {nodes}; submit with sbatch {}", job.display());
        Ok(())
    }

    /// The script of the job, which runs in `folder`.
    fn script(&self, folder: &Path, allowed: &[PathBuf]) -> Result<String> {
        let program = match &self.program {
            Some(program) => program.clone(),
            None => std::env::current_exe().context("cannot find this program's own file; name it with --program")?,
        };
        let quoted = |argument: &OsString| {
            let text = argument.to_str().with_context(|| format!("{}: is not UTF-8", argument.display()))?;
            Ok(format!(" {}", shell(text)))
        };
        let allowed = allowed.iter().map(|folder| Ok(format!(" --allow-files {}", shell(&full(folder)?))));
        let (launch, signal) = match self.launcher {
            // A process that is killed ends the others.
            Launcher::Srun => ("srun --mpi=pmix --kill-on-bad-exit=1 --cpus-per-task=@CPUS@", "TERM"),
            Launcher::Mpirun => ("mpirun -n @PROCESSES@ --bind-to none", "B:TERM"),
        };
        let numbers = [
            ("NODES", self.nodes.to_string()),
            ("PROCESSES", self.processes.to_string()),
            ("CPUS", self.cpus.to_string()),
            ("MEGABYTES", self.memory.megabytes.to_string()),
            ("RETRIES", self.retries.to_string()),
            ("GRACE", self.grace.to_string()),
            ("PATIENCE", (self.grace / 3).max(1).to_string()),
        ];
        let mut values = vec![
            ("TIME", word("--time", &self.time)?.into()),
            ("SIGNAL", signal.to_owned()),
            ("WAIT", WAIT.trim_end().to_owned()),
            ("DIRECTIVES", directives(self.partition.as_deref(), self.account.as_deref(), &self.extra)?),
            ("PROGRAM", shell(&full(&program)?)),
            ("FOLDER", shell(&full(folder)?)),
            ("LAUNCH", fill(launch, &numbers)?),
            ("ARGUMENTS", self.training.iter().map(quoted).collect::<Result<String>>()?),
            ("ALLOWED", allowed.collect::<Result<String>>()?),
        ];
        values.extend(numbers);
        fill(JOB, &values)
    }
}
