use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Makes the skies and studios of hdri/ again, bit for bit, with their manifest.
#[derive(Args)]
#[command(after_help = "Example: renderflow hdri --out hdri")]
pub struct Hdri {
    /// Folder to write to
    #[arg(long, default_value = "hdri")]
    out: PathBuf,
}

impl Hdri {
    pub fn run(self) -> Result<()> {
        renderflow_scenes::sky::write_library(&self.out)?;
        for (name, _) in renderflow_scenes::sky::library() {
            println!("{}", self.out.join(name).with_extension("hdr").display());
        }
        Ok(())
    }
}
