//! `dataset export`: writes a dataset for another tool.

use crate::dataset::export::{self, Form};
use crate::util::cancel::Cancel;
use crate::util::text::plural;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Writes a dataset in the names and conventions that another tool reads.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset export data --to nerfstudio -o nerf\n\
nerfstudio: a folder a sequence: transforms.json (world +Z up), images, 16-bit depths in millimetres, masks of what stands still\n\
cosmos:     <clip>.<frame>.{rgb,basecolor,metallic,roughness,normal,depth,env_ldr,env_log}.png of DiffusionRenderer\n\
png:        every channel as a PNG that can be looked at, 16 bits where 8 would lose something, with data_ranges.json\n\
coco:       images and instances with run lengths; categories are mesh families, with the same ids in every split\n\
The folder must be empty, or one of this form and dataset; it may not be the dataset's own, inside of it or above it.")]
pub struct ExportArgs {
    /// Dataset folder, or a split or sequence of it
    dataset: PathBuf,
    /// Tool to write for
    #[arg(long, value_enum)]
    to: Form,
    /// Folder to write to
    #[arg(long, short = 'o')]
    out: PathBuf,
}

impl ExportArgs {
    pub(super) fn run(self, cancel: &Cancel) -> Result<()> {
        let (sequences, frames) = export::export(&self.dataset, self.to, &self.out, cancel)?;
        println!("{}, {}: {}", plural(sequences, "sequence"), plural(frames, "frame"), self.out.display());
        Ok(())
    }
}
