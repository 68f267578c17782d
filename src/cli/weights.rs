use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Prints configuration and training record of a weights file as JSON.
#[derive(Args)]
#[command(after_help = "Example: renderflow weights            (those inside the program)")]
pub struct Weights {
    /// A safetensors file; the weights inside the program without it
    file: Option<PathBuf>,
}

impl Weights {
    pub fn run(self) -> Result<()> {
        println!("{}", serde_json::to_string_pretty(super::network(self.file.as_deref())?.header())?);
        Ok(())
    }
}
