//! Checkpoints: everything that a run needs to resume exactly where it stopped. Random numbers depend on the seed and the step,
//! so the number of steps is the whole state of the generators.

use super::optimizer::Optimizer;
use crate::weights::{open, read_tensor, write_safetensors};
use crate::{Error, Result};
use safetensors::tensor::Dtype;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The header of a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CheckpointHeader<C> {
    /// Configuration of the run.
    pub config: C,
    /// Number of steps done.
    pub step: u64,
    /// Seconds of training so far.
    pub elapsed: f64,
    /// Identity of the training data ([`ClipSource::identity`](crate::data::ClipSource::identity)). Older checkpoints do not have
    /// it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data: Option<String>,
}

/// Largest number of steps: up to here, counts are exact in double precision.
const MOST_STEPS: u64 = 1 << 53;
/// Prefixes of the tensors of each parameter.
const PARTS: [&str; 4] = ["value", "first", "second", "average"];

/// Advice for a checkpoint that cannot be read.
const AGAIN: &str = "use another output folder, or remove the file to begin again";

/// Writes a checkpoint.
///
/// # Errors
/// When the file cannot be written.
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

/// Reads a checkpoint into `optimizer`, whose parameters determine the names and shapes of the tensors. Returns `None` if there
/// is no file. `difference` names the first option that a resumed run may not change and that differs; `data` is the identity of
/// the training data.
///
/// # Errors
/// When the file is broken, when an option differs, or when the run learned from other data.
pub fn load<C: DeserializeOwned>(
    path: &Path,
    difference: &dyn Fn(&C) -> Option<&'static str>,
    data: Option<&str>,
    optimizer: &mut Optimizer,
) -> Result<Option<CheckpointHeader<C>>> {
    let bytes = match renderflow_frame::file::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.is_missing() => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let broken = |error: Error| match error {
        Error::Frame(renderflow_frame::Error::Malformed { path, reason }) => Error::malformed(path, format!("{reason}; {AGAIN}")),
        Error::Tensor { path, tensor, reason } => Error::Tensor { path, tensor, reason: format!("{reason}; {AGAIN}") },
        other => other,
    };
    let (tensors, header) = open(path, &bytes).map_err(broken)?;
    let header: CheckpointHeader<C> = serde_json::from_str(&header)
        .map_err(|e| broken(Error::malformed(path, format!("header: {}", renderflow_frame::words::plain(&e.to_string())))))?;
    if header.step > MOST_STEPS {
        return Err(broken(Error::malformed(path, format!("header: /step: {} is above {MOST_STEPS}", header.step))));
    }
    if header.elapsed < 0.0 {
        return Err(broken(Error::malformed(path, format!("header: /elapsed: {} is below 0", header.elapsed))));
    }
    if let Some(option) = difference(&header.config) {
        return Err(Error::config(option, format!("differs from the run in {}; use another output folder", path.display())));
    }
    if let (Some(then), Some(now)) = (&header.data, data)
        && then != now
    {
        let run = path.display();
        let reason = format!("is not what the run in {run} learns from; use the same data, or another output folder");
        return Err(Error::Data { place: "training data".into(), reason });
    }
    for slot in &mut optimizer.slots {
        let read = |part: &str| read_tensor(path, &tensors, &format!("{part}/{}", slot.parameter.name), &slot.parameter.shape);
        let read = |part: &str| read(part).map_err(broken);
        let [value, first, second, average] = [read(PARTS[0])?, read(PARTS[1])?, read(PARTS[2])?, read(PARTS[3])?];
        // The optimiser takes its square root: NaN would spread through the network.
        if let Some(negative) = second.iter().find(|v| **v < 0.0) {
            let (tensor, reason) = (format!("{}/{}", PARTS[2], slot.parameter.name), format!("holds {negative}, below 0"));
            return Err(broken(Error::Tensor { path: path.into(), tensor, reason }));
        }
        slot.parameter.values = value;
        slot.first = first;
        slot.second = second;
        slot.average = average;
    }
    optimizer.steps = header.step;
    Ok(Some(header))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::Parameter;

    #[test]
    fn states_that_no_run_can_have_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("checkpoint.safetensors");
        let fresh = || Optimizer::new(vec![Parameter { name: "w".into(), shape: vec![2], values: vec![1.0, 2.0] }]);
        let read = |step: u64, elapsed: f64, second: f32| {
            let mut optimizer = fresh();
            optimizer.slots[0].second[1] = second;
            save(&path, &CheckpointHeader { config: (), step, elapsed, data: None }, &optimizer).expect("written");
            load::<()>(&path, &|()| None, None, &mut fresh()).map(|header| header.expect("there").step)
        };
        assert_eq!(read(MOST_STEPS, 0.0, 0.0).expect("the longest run"), MOST_STEPS);
        for (result, place) in [
            (read(u64::MAX, 0.0, 0.0), "/step: 18446744073709551615"),
            (read(3, -1.0, 0.0), "/elapsed: -1"),
            (read(3, 1.0, -1e-9), "second/w"),
        ] {
            let message = result.expect_err(place).to_string();
            assert!(message.contains(place) && message.contains("checkpoint.safetensors"), "{message}");
        }
    }
}
