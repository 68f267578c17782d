//! Keyframes of a sequence, carried to its other frames over a picture that is made without paths.

use crate::dataset::SequenceFolder;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::deferred::{self, Carry};
use renderflow_frame::image::Rgb;

/// A keyframe and what its truth is divided by.
pub struct Keyframe {
    /// Index among the stored frames.
    pub index: usize,
    /// Its G-buffer.
    pub frame: Frame,
    /// Its truth.
    pub truth: Rgb,
    /// The picture that is made of it without paths.
    pub start: Rgb,
}

/// Reads the keyframes of `folder`; `draw` makes the picture of one from its index and G-buffer.
///
/// # Errors
/// When one cannot be read, has no beauty, or cannot be drawn.
pub fn prepare(folder: &SequenceFolder, mut draw: impl FnMut(usize, &Frame) -> Result<Rgb>) -> Result<Vec<Keyframe>> {
    let keyframe = |&index: &usize| {
        let mut frame = folder.frame(index)?;
        let truth = frame.beauty.take().with_context(|| format!("keyframe {index} has no beauty"))?;
        let start = draw(index, &frame)?;
        Ok(Keyframe { index, frame, truth, start })
    };
    folder.sequence.keyframes.iter().map(keyframe).collect()
}

/// The keyframes carried to stored frame `index` with the G-buffer `frame`, over `current`, the picture that is made of it without paths.
pub fn carry(folder: &SequenceFolder, keys: &[Keyframe], index: usize, frame: &Frame, current: &Rgb) -> Rgb {
    let seen = |key: &Keyframe| folder.numbers[key.index] as f32 - folder.numbers[index] as f32;
    let keys: Vec<deferred::Keyframe> = keys
        .iter()
        .map(|key| deferred::Keyframe {
            frame: &key.frame,
            truth: &key.truth,
            start: &key.start,
            distance: seen(key),
            movement: folder.sequence.tracks.between(index, key.index),
        })
        .collect();
    deferred::warp_fill(frame, current, &keys, folder.sequence.exposure, Carry::default())
}
