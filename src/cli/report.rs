use crate::evaluate::results::Results;
use crate::progress::Progress;
use crate::report;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Makes a report from results: tables with intervals, plots, and a page a sequence with pictures to compare. Needs no network.
#[derive(Args)]
#[command(after_help = "Example: renderflow report results --out report")]
pub struct Report {
    /// Results folder of `renderflow evaluate`
    results: PathBuf,
    /// Folder to write index.html and the pages of the sequences to
    #[arg(long)]
    out: PathBuf,
}

impl Report {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let results = Results::read(&self.results)?;
        let progress = Progress::new("report", results.sequences.len() as u64 + 1);
        report::build(&results, &self.out, &progress, cancel)?;
        progress.finish();
        println!("report: {}", self.out.join("index.html").display());
        Ok(())
    }
}
