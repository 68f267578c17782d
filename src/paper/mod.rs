//! The paper's experiments on data of this program, by one command: each table and figure, and the tables that the paper left
//! out. Data, training runs and evaluations are kept in the output folder. A run that was stopped goes on, and nothing is made
//! twice.

mod lab;
mod scale;
mod series;
mod sheet;
mod tables;

pub use scale::{Data, Scale};
pub use tables::Part;

use crate::evaluate::run;
use crate::metrics::Networks;
use crate::util::cancel::Cancel;
use crate::util::machine;
use crate::util::output::Claim;
use crate::util::text::plural;
use anyhow::Result;
use lab::Lab;
use renderflow_frame::file;
use renderflow_model::fusion::Fusion;
use serde_json::{Value, json};
use std::path::Path;

/// The file that says that a folder holds experiments. Its content does not decide anything: results carry their recipes.
const MARK: &str = "experiments.json";
/// The file of the tables.
pub const TABLES: &str = "paper.md";

/// What to make, and with what.
pub struct Options<'a> {
    /// The tables.
    pub parts: &'a [Part],
    /// Sizes of the experiments.
    pub scale: &'a Scale,
    /// The network that reads samples.
    pub fusion: &'a Fusion,
    /// Weights of an autoencoder for the paper's network; without them it is trained.
    pub autoencoder: Option<&'a Path>,
    /// LPIPS, if its weights are there.
    pub lpips: &'a Networks,
}

/// Makes the tables in the folder `out`: [`TABLES`], `paper.json` and pictures. Both files are written again after each table.
/// Returns the tables as Markdown and as JSON.
///
/// # Errors
/// When stopped; when the folder holds something else; when the weights cannot be used; when an experiment fails.
pub fn run(options: &Options, out: &Path, cancel: &Cancel) -> Result<(String, Value)> {
    Lab::check(options)?;
    let about = json!({ "about": "experiments of renderflow paper" });
    let claim = Claim::new(out, MARK, &about, "something else")?;
    claim.write()?;
    let lab = Lab::new(options, out, cancel)?;
    let mut text = preface(options);
    let mut tables = Vec::new();
    for part in options.parts {
        let table = part.make(&lab)?;
        text += &format!("\n{}", table.markdown());
        tables.push(table.json());
        file::write_atomic(&out.join(TABLES), text.as_bytes())?;
        let whole = json!({ "scale": options.scale, "machine": run::machine(), "tables": tables });
        file::write_json(&out.join("paper.json"), &whole)?;
    }
    Ok((text, Value::Array(tables)))
}

/// What the reader of the tables must know.
fn preface(options: &Options) -> String {
    let scale = options.scale;
    let threads = rayon::current_num_threads();
    let autoencoder = match (options.autoencoder, scale.minutes) {
        (Some(_), _) => " The autoencoder is given.",
        (None, Some(_)) => " The autoencoder trained twice as long.",
        (None, None) => "",
    };
    let time = match scale.minutes {
        Some(minutes) => format!("{minutes} minutes a training run"),
        None => format!("{} a training run: these numbers mean nothing", plural(scale.steps, "step")),
    };
    format!(
        "# The paper's experiments on open data\n\n\
         The paper's numbers (right column) come from Unreal renders that were never published, with 1.4 to 1.7 billion parameters and \
         days of training on GPUs. The others come from scenes of this program, from `{}` and {time}.{autoencoder} So rows compare with rows of the \
         same table, and not with the right column. Test scenes share no mesh family, light or seed with training. Numbers are means \
         over {}; brackets hold 95 % of the means of sequences that are drawn again and again. PSNR full, SSIM and LPIPS \
         are of the full frame of {} x {} pixels, environment included. Seconds were measured on {} with {}.\n",
        scale.preset,
        plural(scale.test[0], "test sequence"),
        scale.side,
        scale.side,
        machine::processor(),
        plural(threads, "thread"),
    )
}
