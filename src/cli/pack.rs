//! `dataset pack`: packs a dataset into shards, or verifies shards.

use crate::dataset::pack::{self, Frames};
use crate::util::cancel::Cancel;
use crate::util::text::plural;
use anyhow::{Result, bail};
use clap::Args;
use std::path::PathBuf;

/// Turn a dataset into WebDataset tar shards, or verify such shards
///
/// Finished shards stay. With --verify, shards are compared with their manifest.
#[derive(Args)]
#[command(
    after_help = "Example: renderflow dataset pack data -o shards --profile compact\n         renderflow dataset pack --verify shards\n\
Samples are `seq-000123_0007.exr|rff` and `.json` (camera, keyframe, spp, exposure, moving objects, split, hash); the environment and the\n\
scene of each sequence are in `<split>-sequences.tar`. `manifest.json` is written last. The folder must be empty, or one of this command."
)]
pub struct PackArgs {
    /// Dataset folder
    #[arg(required_unless_present = "verify")]
    dataset: Option<PathBuf>,
    /// Folder for the shards
    #[arg(long, short = 'o', required_unless_present = "verify")]
    out: Option<PathBuf>,
    /// Samples in a shard; the last shard of a split may have fewer
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
    samples_per_shard: u32,
    /// Form of the frames
    #[arg(long, value_enum, default_value_t)]
    profile: Frames,
    /// Hash and count the shards in this folder instead
    #[arg(long, value_name = "OUT", conflicts_with_all = ["dataset", "out"])]
    verify: Option<PathBuf>,
}

impl PackArgs {
    pub(super) fn run(self, cancel: &Cancel) -> Result<()> {
        if let Some(shards) = &self.verify {
            return pack::verify(shards, cancel);
        }
        let (Some(dataset), Some(out)) = (&self.dataset, &self.out) else { bail!("a dataset and --out are needed") };
        let manifest = pack::pack(dataset, out, self.samples_per_shard, self.profile, cancel)?;
        let bytes: u64 = manifest.shards.iter().map(|shard| shard.bytes).sum();
        let samples: u64 = manifest.samples.values().sum();
        let (shards, samples) = (plural(manifest.shards.len(), "shard"), plural(samples, "sample"));
        println!("{shards}, {samples}, {bytes} bytes: {}", out.join(pack::MANIFEST).display());
        Ok(())
    }
}
