//! What a step of training results in, and what a run reports.

use crate::parameters::GradientList;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// The loss of one batch and its gradients.
pub struct StepResult {
    /// The loss that is minimised. A step whose loss is not finite is left out.
    pub total: f32,
    /// Terms of the loss by name, before their weights. The log averages each over the steps that have it.
    pub terms: Vec<(&'static str, f32)>,
    /// Mean squared errors of pictures with values 0..=1, by name. The log shows them as PSNR.
    pub squares: Vec<(&'static str, f32)>,
    /// Number of items in the batch of this process.
    pub items: usize,
    /// Gradients in the order of [`crate::parameters::export_learning`].
    pub gradients: GradientList,
}

/// One line of the log. Means are over the steps since the previous line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogRecord {
    /// Number of steps done.
    pub step: u64,
    /// Share of the run that is done, 0..=1.
    pub share: f64,
    /// Mean of [`StepResult::total`].
    pub loss: f32,
    /// Means of [`StepResult::terms`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub terms: BTreeMap<String, f32>,
    /// PSNR in dB of the means of [`StepResult::squares`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub psnr: BTreeMap<String, f32>,
    /// Mean norm of the gradient before clipping.
    pub gradient_norm: f32,
    /// Learning rate of the last step.
    pub lr: f64,
    /// Items per second.
    pub items_per_second: f64,
    /// Seconds of training so far, over all resumptions.
    pub elapsed: f64,
    /// Estimated seconds to the end of the run.
    pub eta: f64,
}

/// The file in the folder of a run to which every validation adds a line.
pub const VALIDATIONS: &str = "validation.jsonl";

/// The result of a validation of the averaged weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// Number of steps done.
    pub step: u64,
    /// Mean PSNR in dB, by the kind of input or result that was validated.
    pub psnr: BTreeMap<String, f32>,
    /// Means of other errors, by their name with its unit.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub others: BTreeMap<String, f32>,
}

impl Validation {
    /// Appends the result to [`VALIDATIONS`] in the folder of a run.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&self, output: &Path) -> Result<()> {
        let path = output.join(VALIDATIONS);
        let mut line = serde_json::to_vec(self).map_err(|e| Error::malformed(&path, e.to_string()))?;
        line.push(b'\n');
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&path);
        file.map_err(Error::io(&path, "open"))?.write_all(&line).map_err(Error::io(&path, "write"))
    }
}

/// What a run reports while it is under way.
#[derive(Clone, Debug)]
pub enum Progress {
    /// Training data is loaded before the first step.
    Loading {
        /// Clips or sequences that are ready.
        done: u64,
        /// Clips or sequences that are needed.
        total: u64,
    },
    /// A sentence for the user.
    Note(String),
    /// A line of the log was written.
    Step(LogRecord),
    /// The averaged weights were validated.
    Validated(Validation),
}
