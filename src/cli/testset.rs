use crate::dataset::Shard;
use crate::dataset::testset::{self, Extent, Sources, TestSet};
use crate::util::cancel::Cancel;
use anyhow::Result;
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Test sets: the same pictures for everybody who reports numbers.
#[derive(Subcommand)]
pub enum TestsetCommand {
    /// Make a set, or continue one
    Make(Make),
    /// Verify a finished set: every file's hash, every frame, the set's own hash
    Verify(Verify),
}

/// Makes a set: plans, truth, and an estimate of the truth's own error; verifies all of it.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow testset make synthetic -o sets\n  \
renderflow testset make assets --models models/ --hdris hdris/ -o sets\n\
The synthetic set takes 4 GB and, on 4 cores, about an hour; with --every 10 about three tenths of both.\n\
After a termination signal, the current frame is finished (exit code 75); the same command goes on.")]
pub struct Make {
    /// The set
    set: TestSet,
    /// Models (.gltf, .glb, .obj, .ply) of the assets set: files, or folders of them
    #[arg(long, num_args = 1.., value_name = "PATH")]
    models: Vec<PathBuf>,
    /// Environment maps (.hdr, .exr) of the assets set: files, or folders of them
    #[arg(long, num_args = 1.., value_name = "PATH")]
    hdris: Vec<PathBuf>,
    /// Folder in which the set gets a folder of its own
    #[arg(long, short = 'o')]
    out: PathBuf,
    /// Part i of n of every class, counted from 1
    #[arg(long)]
    shard: Option<Shard>,
    /// Make only the first two of every n frames, and the keyframes: `evaluate --every` with the same number reads these; 1 makes
    /// all. The set is not finished then; the same command without this option makes the rest
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Samples for each pixel of a longer render of one frame in each sequence, which estimates the error of the truth; 0 skips
    /// it
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(..=1 << 20))]
    audit: u32,
}

/// Verifies a finished set.
#[derive(Args)]
#[command(after_help = "Example: renderflow testset verify sets/synthetic")]
pub struct Verify {
    /// Folder of the set
    set: PathBuf,
}

impl TestsetCommand {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
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
    fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
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
                println!("{}: two of every {} frames and the keyframes are done", folder.display(), self.every)
            }
            None => println!("{}: this shard's part is done", folder.display()),
        }
        Ok(())
    }
}
