//! What the programs of this project share: threads, files that scenes may name, interrupts, and exit codes.

use crate::util::cancel::{Cancel, Interrupted};
use crate::util::console::{self, message};
use crate::util::progress::{self, Display};
use crate::util::text::plural;
use crate::util::{log, stop};
use anyhow::{Context, Result, bail};
use clap::{ArgAction, Args};
use std::path::PathBuf;

/// Options of every command.
#[derive(Args)]
#[command(next_help_heading = "General")]
pub struct Common {
    /// Number of threads, at most 4 for each core; 0 (the default) takes one for each core. Results do not depend on it
    #[arg(long, short, global = true)]
    threads: Option<usize>,
    /// Let scenes and models name files in this folder too, not only in their own. May be given several times
    #[arg(long, global = true, value_name = "FOLDER")]
    allow_files: Vec<PathBuf>,
    /// Show no progress
    #[arg(long, short, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Log which files are read, how large scenes are, and how long stages take; -vv also logs each frame. The variable
    /// RENDERFLOW_LOG overrides it with a filter, such as debug
    #[arg(long, short, global = true, action = ArgAction::Count)]
    verbose: u8,
}

impl Common {
    /// Starts the threads and the log, and listens for interrupts. Returns the folders that scenes may name files in, and the
    /// flag that the first interrupt sets.
    ///
    /// # Errors
    /// When a folder is missing, the filter of the log is wrong, or the threads cannot be started.
    pub fn start(self) -> Result<(Vec<PathBuf>, Cancel)> {
        let logs = log::start(self.verbose).map_err(anyhow::Error::msg)?;
        progress::display(match (self.quiet, logs) {
            (true, _) => Display::Nothing,
            (false, true) => Display::Lines,
            (false, false) => Display::Usual,
        });
        if let Some(asked) = self.threads {
            rayon::ThreadPoolBuilder::new().num_threads(threads(asked)).build_global().context("--threads")?;
        }
        let cancel = stop::listen()?;
        if let Some(missing) = self.allow_files.iter().find(|folder| !folder.exists()) {
            bail!("--allow-files {}: there is no such folder", missing.display());
        }
        Ok((self.allow_files, cancel))
    }
}

/// More threads than this for each core only take memory.
const THREADS_A_CORE: usize = 4;

/// The number of threads that `--threads` asks for; 0 stands for one for each core. Prints a note where the user asks for too
/// many.
fn threads(asked: usize) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let most = THREADS_A_CORE * cores;
    if asked > most {
        eprintln!("note: --threads {asked}: {most} are used, {THREADS_A_CORE} for each of {}", plural(cores, "core"));
    }
    asked.min(most)
}

/// The exit code of a program whose work ended with `result`. An error is printed on standard error.
pub fn exit_code(result: Result<()>) -> u8 {
    match result {
        Ok(()) => match console::lost_output() {
            None => 0,
            Some(error) => {
                eprintln!("error: the work is done, but standard output could not be written: {error}");
                1
            }
        },
        Err(error) if error.downcast_ref::<Interrupted>().is_some() || error.root_cause().is::<Interrupted>() => {
            eprintln!("{}", message(&error));
            stop::RESUMABLE
        }
        Err(error) => {
            eprintln!("error: {}", message(&error));
            1
        }
    }
}
