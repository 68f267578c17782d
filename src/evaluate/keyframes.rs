//! Keyframes of a sequence, ready to be carried to its other frames.

use crate::dataset::SequenceFolder;
use anyhow::Result;
use renderflow_frame::ibl::IblTables;
use renderflow_model::infer::{Keyframe, PreparedKeyframe};

/// Truth of every keyframe of `folder`, ready to be carried to other frames; in the order of `sequence.keyframes`.
pub fn prepare_keyframes(folder: &SequenceFolder, tables: &IblTables) -> Result<Vec<PreparedKeyframe>> {
    let prepare = |&key: &usize| -> Result<PreparedKeyframe> {
        let frame = folder.frame(key)?;
        Ok(PreparedKeyframe::new(&frame, folder.camera(key), &folder.environment, tables, folder.sequence.exposure)?)
    };
    folder.sequence.keyframes.iter().map(prepare).collect()
}

/// The keyframes as seen from stored frame `index`: all of them, with their distance in frames.
pub fn keyframes_for<'a>(folder: &'a SequenceFolder, prepared: &'a [PreparedKeyframe], index: usize) -> Vec<Keyframe<'a>> {
    let here = folder.numbers[index] as f32;
    let keys = folder.sequence.keyframes.iter().zip(prepared);
    keys.map(|(&key, prepared)| Keyframe {
        prepared,
        distance: folder.numbers[key] as f32 - here,
        movement: folder.sequence.tracks.between(index, key),
    })
    .collect()
}
