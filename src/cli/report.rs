use super::OpenArgs;
use crate::evaluate::results::Results;
use crate::report;
use crate::util::cancel::Cancel;
use crate::util::progress::Progress;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Makes a report from results: tables with intervals, plots, and a page for each sequence where pictures can be compared. The
/// pages need no network connection.
#[derive(Args)]
#[command(after_help = "Example: renderflow report results -o report")]
pub struct Report {
    /// Results folder of `renderflow evaluate`
    results: PathBuf,
    /// Folder for index.html and the pages of the sequences
    #[arg(long, short = 'o')]
    out: PathBuf,
    #[command(flatten)]
    open: OpenArgs,
}

impl Report {
    pub fn run(self, cancel: &Cancel) -> Result<()> {
        let results = Results::read(&self.results)?;
        let progress = Progress::new("report", results.sequences.len() as u64 + 1);
        report::build(&results, &self.out, &progress, cancel)?;
        progress.finish();
        let page = self.out.join("index.html");
        println!("report: {}", page.display());
        self.open.open(&page);
        Ok(())
    }
}
