use crate::dataset::Shard;
use crate::testset::{self, Extent, Sources, TestSet};
use anyhow::Result;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Test sets: the same pictures for everybody who reports numbers.
#[derive(Subcommand)]
pub enum TestsetCommand {
    /// Make a set, or go on with it
    Make(Make),
    /// Prove a finished set: every file's hash, every frame, the set's own hash
    Verify(Verify),
}

/// Makes a set: plans, truth, an estimate of the truth's own error, and a proof of all of it.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow testset make synthetic --out sets\n  \
renderflow testset make assets --models models/ --hdris hdris/ --out sets\n\
The synthetic set takes 4 GB and, on 4 cores, about an hour; with --every 10 some three tenths of both. A termination signal lets the frame at hand finish (exit code 75); the\n\
same command goes on.")]
pub struct Make {
    /// Which one
    set: TestSet,
    /// Models (.gltf, .glb, .obj) of the assets set: files, or folders of them
    #[arg(long, num_args = 1.., value_name = "PATH")]
    models: Vec<PathBuf>,
    /// Environment maps (.hdr, .exr) of the assets set: files, or folders of them
    #[arg(long, num_args = 1.., value_name = "PATH")]
    hdris: Vec<PathBuf>,
    /// Folder in which the set gets one of its own
    #[arg(long)]
    out: PathBuf,
    /// Part i of n of every class, counted from 1
    #[arg(long)]
    shard: Option<Shard>,
    /// Of every so many frames make the first two alone, beside the keyframes: what `evaluate --every` reads with the same number; 1 = all.
    /// The set is not finished then; without it the rest is made
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Samples a pixel of the longer render, of one frame a sequence, that tells how far the truth is from the truth; 0 = none
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(..=1 << 20))]
    audit: u32,
}

/// Proves a finished set.
#[derive(Args)]
#[command(after_help = "Example: renderflow testset verify sets/synthetic")]
pub struct Verify {
    /// Folder of the set
    set: PathBuf,
}

impl TestsetCommand {
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        match self {
            Self::Make(make) => make.run(allowed, cancel),
            Self::Verify(verify) => {
                println!("no faults; BLAKE3 {}", testset::check(&verify.set, cancel)?.blake3);
                Ok(())
            }
        }
    }
}

impl Make {
    fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let sources = Sources { models: self.models, hdris: self.hdris, allowed: allowed.to_vec() };
        let assigned = Shard::choose(self.shard)?;
        let extent = Extent { shard: assigned.shard, every: self.every, audited: self.audit };
        let made = testset::make(self.set, &sources, &self.out, extent, cancel)?;
        let folder = self.out.join(self.set.name());
        for line in testset::audits(self.set, &self.out)? {
            println!("{line}");
        }
        match made {
            Some(set) => println!("{}: complete, BLAKE3 {}", folder.display(), set.blake3),
            None if self.every > 1 => {
                println!("{}: two frames of every {} and the keyframes are there", folder.display(), self.every)
            }
            None => println!("{}: this shard's part is done", folder.display()),
        }
        Ok(())
    }
}
