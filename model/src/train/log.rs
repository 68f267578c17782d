//! The training log: one JSON object a line.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// One line of the log; averages are over the steps since the line before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Steps done.
    pub step: u64,
    /// Share of the run done, 0..=1.
    pub share: f64,
    /// Total loss.
    pub loss: f32,
    /// Squared error in z.
    pub bridge: f32,
    /// PSNR of the display picture over covered pixels, from the mean squared error.
    pub display_psnr: f32,
    /// Absolute difference of display gradients.
    pub gradient: f32,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f32,
    /// Learning rate.
    pub lr: f64,
    /// Crops a second.
    pub images_per_second: f64,
    /// Seconds of training so far, over all resumptions.
    pub elapsed: f64,
    /// Seconds left.
    pub eta: f64,
}

/// What every kind of record has.
#[derive(Deserialize)]
struct Stepped {
    step: u64,
}

/// Appends records to a file.
pub struct Log {
    path: PathBuf,
    file: File,
}

impl Log {
    /// Opens `path`; lines of steps after `resumed` (written before an interruption, to be done again) are dropped.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub fn open(path: &Path, resumed: u64) -> Result<Self> {
        let kept = match std::fs::read_to_string(path) {
            Ok(text) => text
                .lines()
                .filter(|line| serde_json::from_str::<Stepped>(line).is_ok_and(|record| record.step <= resumed))
                .map(|line| format!("{line}\n"))
                .collect(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(Error::io(path, "read")(error)),
        };
        renderflow_frame::file::write_atomic(path, kept.as_bytes())?;
        let file = File::options().append(true).open(path).map_err(Error::io(path, "open"))?;
        Ok(Self { path: path.into(), file })
    }

    /// Appends one line.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, record: &impl Serialize) -> Result<()> {
        let mut line = serde_json::to_vec(record).map_err(|e| Error::malformed(&self.path, e.to_string()))?;
        line.push(b'\n');
        self.file.write_all(&line).map_err(Error::io(&self.path, "write"))
    }
}
