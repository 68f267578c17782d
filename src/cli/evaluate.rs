use crate::dataset::Dataset;
use crate::evaluate::{Evaluation, Options, sequence, table};
use crate::progress::Progress;
use crate::truth::DenoiseMode;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Compares IBL, the network without and with keyframes, and path tracing at few samples with the truth of a dataset.
#[derive(Args)]
#[command(after_help = "Example: renderflow evaluate --data data/test --out results.json")]
pub struct Evaluate {
    /// A split of a dataset, or one sequence
    #[arg(long)]
    data: PathBuf,
    /// Weights; those inside the program without it
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Sample counts of path-traced rows
    #[arg(long, value_delimiter = ',', default_value = "1,4")]
    path_traced: Vec<u32>,
    /// Denoiser of the path-traced rows
    #[arg(long, value_enum, default_value_t)]
    denoise: DenoiseMode,
    /// Every score as JSON
    #[arg(long)]
    out: Option<PathBuf>,
}

impl Evaluate {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let dataset = Dataset::open(&self.data)?;
        let renderer = super::network(self.weights.as_deref())?;
        let lpips = super::lpips()?;
        let options =
            Options { lpips: lpips.as_ref(), path_traced: &self.path_traced, denoise: self.denoise, ..Options::new(&renderer) };
        let progress = Progress::new("evaluate", dataset.sequences.iter().map(|s| s.len() as u64).sum());
        let mut evaluations: Vec<Evaluation> = Vec::new();
        for folder in &dataset.sequences {
            progress.message(folder.name());
            evaluations.push(sequence::evaluate(folder, &options, &mut |_, _, _| (), &progress, cancel)?);
        }
        progress.finish();
        let truth = crate::evaluate::sequence::truth_cost(&dataset.sequences);
        for evaluation in &evaluations {
            println!("{}\n{}", evaluation.sequence, table::print(&table::rows(std::slice::from_ref(evaluation)), None));
        }
        println!("all {} sequences\n{}", evaluations.len(), table::print(&table::rows(&evaluations), truth));
        if let Some(out) = &self.out {
            renderflow_frame::file::write_json(out, &evaluations)?;
        }
        Ok(())
    }
}
