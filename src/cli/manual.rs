//! What other programs read about the command line: completions of shells, and man pages.

use super::Cli;
use crate::util::output;
use anyhow::Result;
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use std::path::PathBuf;

/// Prints the completions of a shell.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow completions bash > ~/.local/share/bash-completion/completions/renderflow\n  \
renderflow completions zsh > \"${fpath[1]}/_renderflow\"")]
pub struct Completions {
    /// The shell
    shell: Shell,
}

impl Completions {
    pub fn run(self) {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "renderflow", &mut script);
        print!("{}", String::from_utf8_lossy(&script));
    }
}

/// Writes a man page for each command.
#[derive(Args)]
#[command(after_help = "Example: renderflow man -o ~/.local/share/man/man1 && man renderflow-render")]
pub struct Man {
    /// Folder to write to
    #[arg(long, short, default_value = "man")]
    out: PathBuf,
    /// Replace pages that hold something else
    #[arg(long)]
    overwrite: bool,
}

impl Man {
    pub fn run(self) -> Result<()> {
        let mut command = Cli::command().disable_help_subcommand(true);
        command.build();
        let mut pages = Vec::new();
        collect(command, "renderflow", &mut pages)?;
        let files: Vec<_> = pages.into_iter().map(|(name, bytes)| (self.out.join(name), bytes)).collect();
        output::write(&files, self.overwrite)?;
        println!("{} pages: {}", files.len(), self.out.display());
        Ok(())
    }
}

/// Adds the page of a command and those of its subcommands.
fn collect(command: clap::Command, name: &str, pages: &mut Vec<(String, Vec<u8>)>) -> Result<()> {
    for part in command.get_subcommands().filter(|part| !part.is_hide_set()) {
        collect(part.clone(), &format!("{name}-{}", part.get_name()), pages)?;
    }
    let mut page = Vec::new();
    clap_mangen::Man::new(command.display_name(name)).render(&mut page)?;
    pages.push((format!("{name}.1"), page));
    Ok(())
}
