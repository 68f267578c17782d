use crate::bench;
use anyhow::Result;
use clap::Subcommand;
use std::sync::atomic::AtomicBool;

#[derive(Subcommand)]
pub enum Bench {
    /// Rays a second of the traversal kernels, beside Embree's
    Kernels(bench::kernels::Options),
}

impl Bench {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        match self {
            Self::Kernels(options) => options.run(cancel),
        }
    }
}
