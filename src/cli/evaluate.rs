use super::AllWeightsArgs;
use crate::evaluate::find::find;
use crate::evaluate::method::{Method, help};
use crate::evaluate::renderer::{self, Drawing};
use crate::evaluate::{autoencoder, external, inverse, relight, results::Results, run};
use crate::metrics::Networks;
use crate::report::table;
use crate::util::cancel::Cancel;
use crate::util::progress::Progress;
use crate::util::ranges::within;
use crate::util::text::plural;
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Subcommand};
use renderflow_model::lpips::WEIGHTS_VARIABLE;
use renderflow_renderer::Settings;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const HELP: &str = "\
Examples:
  renderflow evaluate --data sets --methods all --every 5 -o results
  renderflow evaluate --data sets --methods standard --budgets .05,.1,.2,.4,.8 --every 10 -o results-budgets
  renderflow evaluate mine/ sets/synthetic/open --label \"my renderer\" -o results-mine
  renderflow report results -o report
  renderflow evaluate --data sets --methods standard,wan,wan+keys --weights runs/wan/flow.safetensors --vae runs/vae.safetensors -o results-wan";

const HELP_OF_FOLDERS: &str = "\
With two folders, the pictures in the first (PNG: display values; EXR, HDR: scene-linear radiance) are compared with those in the
second: a dataset, a test set, or plain pictures. A picture belongs to the truth of the same path, endings apart, else to that of the
same folder whose name ends in the same number; where one is there in several forms, the EXR or else the HDR file is taken. Radiance
becomes sRGB(clamp(exposure x radiance)); datasets say their exposure, and --exposure is that of plain pictures. Pictures are compared
again each time.

Methods: sequences that are complete in the results folder are kept, unless their data changed, so the same command goes on where it
was stopped. Results of sequences that the last command did not ask for stay in the folder and do not count.";

/// Compares methods, or anybody's pictures, with path-traced truth, by metrics with intervals and by seconds.
#[derive(Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = format!("{HELP}\n\nMethods, in a comma-separated list:{}\n\n{HELP_OF_FOLDERS}", help())
)]
pub struct Evaluate {
    #[command(subcommand)]
    part: Option<Part>,
    #[command(flatten)]
    pictures: Pictures,
}

/// Parts of the networks that are measured instead of pictures.
#[derive(Subcommand)]
enum Part {
    Inverse(inverse::Options),
    Relight(relight::Options),
    Autoencoder(autoencoder::Options),
}

impl Evaluate {
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        match self.part {
            Some(Part::Inverse(options)) => options.run(cancel),
            Some(Part::Relight(options)) => options.run(allowed, cancel),
            Some(Part::Autoencoder(options)) => options.run(allowed, cancel),
            None => self.pictures.run(allowed, cancel),
        }
    }
}

/// Methods on test sets, or a folder of pictures.
#[derive(Args)]
struct Pictures {
    /// Folder of pictures to compare
    #[arg(value_name = "PRED_DIR", requires = "truth", conflicts_with_all = ["data", "weights", "vae", "device", "max_bounces"])]
    pictures: Option<PathBuf>,
    /// Folder of the truth
    #[arg(value_name = "TRUTH_DIR")]
    truth: Option<PathBuf>,
    /// Test sets, a dataset, one of its splits, or one sequence, on which to run the program's own methods
    #[arg(long, required_unless_present = "pictures", help_heading = "Input")]
    data: Option<PathBuf>,
    /// Methods to evaluate
    #[arg(long, default_value = "standard", conflicts_with = "pictures", help_heading = "Methods")]
    methods: String,
    /// Also evaluate path tracing with OIDN, in all its forms, with this many seconds for each frame of 256 x 256 pixels (other
    /// sizes get seconds in proportion to their pixels); for example .05,.1,.2,.4,.8
    #[arg(long, value_name = "SECONDS", value_delimiter = ',', conflicts_with = "pictures", help_heading = "Sampling")]
    budgets: Vec<f64>,
    #[command(flatten)]
    weights: AllWeightsArgs,
    /// Evaluate the first two of every n frames; 1 evaluates all
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "pictures", help_heading = "Input")]
    every: u32,
    /// Compare with the truth before it was denoised. Its noise lowers every row, and better rows by more dB. A denoised truth
    /// favours pictures of the same denoiser
    #[arg(long, conflicts_with = "pictures", help_heading = "Input")]
    raw_truth: bool,
    /// How often a path may scatter in path-traced rows
    #[arg(long, default_value_t = Settings::default().max_bounces, value_parser = within(Settings::MAX_BOUNCES), help_heading = "Sampling")]
    max_bounces: u32,
    /// Euler steps of the paper's network; it is trained for 1
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000), conflicts_with = "pictures", help_heading = "Network")]
    steps: u32,
    /// Seed of the noise that the paper's network begins with, for weights that were trained to begin with noise
    #[arg(long, default_value_t = 0, conflicts_with = "pictures", help_heading = "Network")]
    seed: u64,
    /// Name of the pictures in tables
    #[arg(long, default_value = "pictures", requires = "pictures", help_heading = "Input")]
    label: String,
    /// Factor from radiance to display-linear for truth that is not a dataset, 1 by default. A dataset has its own and takes no
    /// other
    #[arg(long, requires = "pictures", help_heading = "Input")]
    exposure: Option<f32>,
    /// Compare the pictures that are there, instead of failing when some are missing
    #[arg(long, requires = "pictures", help_heading = "Input")]
    partial: bool,
    /// Frames of each sequence whose pictures are kept for the report
    #[arg(long, default_value_t = 6, help_heading = "Output")]
    pictures_kept: usize,
    /// Results folder: scores as JSON lines, pictures
    #[arg(long, short = 'o', required = true, help_heading = "Output")]
    out: Option<PathBuf>,
    /// Print the table as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Pictures {
    fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let lpips = lpips()?;
        let out = self.out.as_deref().context("--out")?;
        match (&self.pictures, &self.truth, &self.data) {
            (Some(pictures), Some(truth), None) => self.compare(pictures, truth, out, &lpips, cancel)?,
            (None, None, Some(data)) => self.methods(data, out, &lpips, allowed, cancel)?,
            _ => bail!("either --data FOLDER, or two folders: pictures and truth"),
        }
        let results = Results::read(out)?;
        let scores = results.sequences.iter().flat_map(|sequence| &sequence.scores);
        let scored: BTreeSet<&str> = scores.map(|score| score.method.as_str()).collect();
        ensure!(!scored.is_empty(), "no method has a score: methods that read keyframes need sequences with keyframes");
        for method in results.about.methods.iter().filter(|method| !scored.contains(method.id.as_str())) {
            eprintln!(
                "note: {} has no score: no sequence has the keyframes that it needs, or that the method whose time it takes needs",
                method.id
            );
        }
        if self.json {
            println!("{}", serde_json::to_string_pretty(&table::json(&results))?);
        } else {
            print!("{}", table::markdown(&results, table::Filter::default()));
        }
        Ok(())
    }

    fn methods(&self, data: &Path, out: &Path, lpips: &Networks, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let mut methods = Method::list(&self.methods)?;
        let budgets = Method::budgets(&self.budgets).context("--budgets")?;
        methods.extend(budgets.into_iter().filter(|budget| !methods.contains(budget)).collect::<Vec<_>>());
        let tests = find(data)?;
        let networks = self.weights.open(&methods)?;
        ensure!(
            networks.wan.is_some() || !methods.iter().any(Method::is_wan),
            "--methods: wan and wan+keys need the weights of the paper's network (--weights FILE)"
        );
        let keyed = networks.wan.as_ref().is_none_or(|wan| wan.about().keyframes);
        let asked = methods.iter().any(|method| method.is_wan() && method.needs_keyframes());
        ensure!(keyed || !asked, "--methods: wan+keys and wan-stills+keys: this network does not read keyframes");
        let settings = networks.settings();
        let options = run::Options {
            rendering: renderer::Options {
                drawing: Drawing { steps: self.steps, seed: self.seed },
                max_bounces: self.max_bounces,
                allowed,
                ..networks.rendering(&methods)
            },
            lpips,
            every: self.every,
            raw_truth: self.raw_truth,
            pictures: self.pictures_kept,
            title: "RenderFlow: methods against path-traced truth".into(),
            settings,
        };
        let frames = tests.iter().map(|test| run::frames(test, self.every) as u64).sum();
        let progress = Progress::new("evaluate", frames);
        run::run(&tests, &options, out, &progress, cancel)?;
        progress.finish();
        Ok(())
    }

    fn compare(&self, pictures: &Path, truth: &Path, out: &Path, lpips: &Networks, cancel: &Cancel) -> Result<()> {
        let options = external::Options {
            lpips,
            label: self.label.clone(),
            exposure: self.exposure,
            partial: self.partial,
            pictures: self.pictures_kept,
        };
        let progress = Progress::new("compare", 0);
        let compared = external::run(pictures, truth, &options, out, &progress, cancel)?;
        progress.finish();
        eprintln!("{} compared", plural(compared, "picture"));
        Ok(())
    }
}

/// LPIPS where its weights are found; otherwise a line that says how to get them.
pub(super) fn lpips() -> Result<Networks> {
    let lpips = Networks::find()?;
    if lpips.alex.is_none() {
        eprintln!(
            "note: there is no LPIPS: its weights are missing (set {WEIGHTS_VARIABLE} to their folder; model/README.md says what is in it)"
        );
    }
    Ok(lpips)
}
