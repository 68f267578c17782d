use crate::util::output;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Makes the skies and studios of hdri/ again, bit for bit, with their manifest.
#[derive(Args)]
#[command(after_help = "Example: renderflow hdri -o hdri")]
pub struct Hdri {
    /// Folder to write to
    #[arg(long, short = 'o', default_value = "hdri")]
    out: PathBuf,
    /// Replace files of these names that hold something else
    #[arg(long)]
    overwrite: bool,
}

impl Hdri {
    pub fn run(self) -> Result<()> {
        let files = renderflow_scenes::sky::library_files()?;
        let files: Vec<_> = files.into_iter().map(|(name, bytes)| (self.out.join(name), bytes)).collect();
        output::write(&files, self.overwrite)?;
        for (name, _) in renderflow_scenes::sky::library() {
            println!("{}", self.out.join(name).with_extension("hdr").display());
        }
        Ok(())
    }
}
