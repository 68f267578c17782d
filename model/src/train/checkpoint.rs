//! Checkpoints: everything a run needs to go on exactly where it stopped. Random numbers are a function of (seed, step), so the step
//! counter is the whole state of the generators.

use super::optimizer::Optimizer;
use crate::weights::{open, read_tensor, write_safetensors};
use crate::{Error, Result};
use safetensors::tensor::Dtype;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What stands in a checkpoint besides tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckpointHeader<C> {
    /// Settings of the run.
    pub config: C,
    /// Steps done.
    pub step: u64,
    /// Seconds of training so far.
    pub elapsed: f64,
}

const PARTS: [&str; 4] = ["value", "first", "second", "average"];

/// Writes a checkpoint beside its place and renames it.
///
/// # Errors
/// When it cannot be written.
pub fn save<C: Serialize>(path: &Path, header: &CheckpointHeader<C>, optimizer: &Optimizer) -> Result<()> {
    let mut entries = Vec::new();
    for slot in &optimizer.slots {
        for (part, values) in PARTS.iter().zip([&slot.parameter.values, &slot.first, &slot.second, &slot.average]) {
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            entries.push((format!("{part}/{}", slot.parameter.name), slot.parameter.shape.clone(), bytes));
        }
    }
    let header = serde_json::to_string(header).map_err(|e| Error::malformed(path, e.to_string()))?;
    let tensors = entries.iter().map(|(name, shape, bytes)| (name.as_str(), Dtype::F32, shape.as_slice(), bytes.as_slice()));
    Ok(renderflow_frame::file::write_atomic(path, &write_safetensors(path, &header, tensors)?)?)
}

/// Reads a checkpoint into `optimizer`, whose parameters give names and shapes. `None` when there is no file. `difference` names the
/// first option that decides what is learned and that the checkpoint's run had otherwise.
///
/// # Errors
/// When the file is broken, or there is such an option.
pub fn load<C: DeserializeOwned>(
    path: &Path,
    difference: &dyn Fn(&C) -> Option<&'static str>,
    optimizer: &mut Optimizer,
) -> Result<Option<CheckpointHeader<C>>> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Error::io(path, "read")(error)),
    };
    let (tensors, header) = open(path, &bytes)?;
    let header: CheckpointHeader<C> =
        serde_json::from_str(&header).map_err(|e| Error::malformed(path, format!("header: {e}")))?;
    if let Some(option) = difference(&header.config) {
        return Err(Error::config(option, format!("differs from the run in {}; use another output folder", path.display())));
    }
    for slot in &mut optimizer.slots {
        let read = |part: &str| read_tensor(path, &tensors, &format!("{part}/{}", slot.parameter.name), &slot.parameter.shape);
        let [value, first, second, average] = [read(PARTS[0])?, read(PARTS[1])?, read(PARTS[2])?, read(PARTS[3])?];
        slot.parameter.values = value;
        slot.first = first;
        slot.second = second;
        slot.average = average;
    }
    optimizer.steps = header.step;
    Ok(Some(header))
}
