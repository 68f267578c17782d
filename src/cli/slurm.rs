use crate::dataset::slurm::{Memory, Request};
use crate::util::text::plural;
use anyhow::{Context, Result};
use clap::Args;
use std::path::PathBuf;

/// Writes the scripts of a cluster.
#[derive(Args)]
#[command(
    after_help = "Example: renderflow dataset slurm --plan plan.json -o data --script-dir jobs --time 04:00:00 && sh jobs/submit.sh"
)]
pub struct SlurmArgs {
    /// Plan file
    #[arg(long, help_heading = "Input")]
    plan: PathBuf,
    /// Dataset folder
    #[arg(long, short = 'o', help_heading = "Output")]
    out: PathBuf,
    /// Folder for array.sh, merge.sh, submit.sh, kubernetes.yaml and the logs
    #[arg(long, help_heading = "Output")]
    script_dir: PathBuf,
    /// Slurm partition; by default the cluster's own default
    #[arg(long, help_heading = "Tasks")]
    partition: Option<String>,
    /// Slurm account
    #[arg(long, help_heading = "Tasks")]
    account: Option<String>,
    /// Time limit of a task, which makes one sequence
    #[arg(long, default_value = "02:00:00", help_heading = "Tasks")]
    time: String,
    /// Processor cores of a task
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Tasks")]
    cpus: u32,
    /// Memory of a task; it is doubled when a task runs out of memory, if the cluster allows that
    #[arg(long, default_value = "8G", help_heading = "Tasks")]
    memory: Memory,
    /// Tasks that may run at the same time; by default any number
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Tasks")]
    tasks_at_once: Option<u32>,
    /// How often a task starts again after it failed or was interrupted
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(..=i64::from(i32::MAX)), help_heading = "Tasks")]
    retries: u32,
    /// Seconds before the end of --time at which a task gets a signal to stop after its frame
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=65535), help_heading = "Tasks")]
    grace: u32,
    /// One more option for sbatch, such as "--qos=long"; may be given several times
    #[arg(long, allow_hyphen_values = true, help_heading = "Tasks")]
    extra: Vec<String>,
    /// Path of this program on the nodes; by default its path here
    #[arg(long, help_heading = "Input")]
    program: Option<PathBuf>,
    /// Replace scripts that were edited or made with other options
    #[arg(long, help_heading = "Output")]
    overwrite: bool,
}

impl SlurmArgs {
    pub fn run(self, allowed: &[PathBuf]) -> Result<()> {
        let program = match self.program {
            Some(program) => program,
            None => std::env::current_exe().context("cannot find this program's own file; name it with --program")?,
        };
        let submit = self.script_dir.join("submit.sh");
        let request = Request {
            program,
            plan: self.plan,
            out: self.out,
            allowed: allowed.to_vec(),
            folder: self.script_dir,
            partition: self.partition,
            account: self.account,
            time: self.time,
            cpus: self.cpus,
            memory: self.memory,
            tasks_at_once: self.tasks_at_once,
            retries: self.retries,
            grace: self.grace,
            extra: self.extra,
        };
        let tasks = request.write(self.overwrite)?;
        println!("{}, one for each sequence; submit with {}", plural(tasks, "task"), submit.display());
        Ok(())
    }
}
