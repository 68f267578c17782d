//! Tells a run that is already at its end, before any training data is made.

use super::Train;
use crate::util::text::plural;
use anyhow::Result;
use renderflow_frame::file;
use renderflow_model::train::Team;
use renderflow_model::train::checkpoint::CheckpointHeader;
use renderflow_model::train::config::TrainingConfig;
use safetensors::SafeTensors;
use std::path::Path;

/// The entry of a checkpoint's metadata that holds its header.
const HEADER: &str = "renderflow";

impl Train {
    /// Prints where the weights are if the run in the output folder is at the end that `config` asks for. Then there is
    /// nothing to do. `data` is the identity of the training data. A run with other options or data, or one that cannot be
    /// read, is left to the training, which says what is wrong with it.
    pub(super) fn is_done<C: TrainingConfig>(&self, config: &C, data: Option<&str>, team: &Team) -> Result<bool> {
        let [checkpoint, weights] = ["checkpoint.safetensors", "weights.safetensors"].map(|name| config.run().output.join(name));
        if !weights.is_file() {
            return Ok(false);
        }
        let bytes = match file::read(&checkpoint) {
            Err(error) if error.is_missing() => return Ok(false),
            read => read?,
        };
        let metadata = SafeTensors::read_metadata(&bytes).ok().and_then(|(_, metadata)| metadata.metadata().clone());
        let header = metadata.and_then(|entries| serde_json::from_str::<CheckpointHeader<C>>(entries.get(HEADER)?).ok());
        let Some(CheckpointHeader { config: old, step, elapsed, data: learned }) = header else { return Ok(false) };
        let (run, before) = (config.run(), old.run());
        let same = run.seed == before.seed
            && run.optimizer == before.optimizer
            && config.difference(&old).is_none()
            && learned.as_deref() == data;
        if !same || run.share(step, elapsed) < 1.0 {
            return Ok(false);
        }
        // Weights are written after the checkpoint of their step, so older ones are of an earlier step.
        let written = |path: &Path| std::fs::metadata(path).and_then(|about| about.modified()).ok();
        if written(&weights) < written(&checkpoint) {
            return Ok(false);
        }
        if team.leads() {
            println!("already done: {} in {elapsed:.0} s: {}", plural(step, "step"), weights.display());
        }
        Ok(true)
    }
}
