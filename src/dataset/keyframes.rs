//! Warps the keyframes of a sequence to its other frames, over a picture that is made without tracing paths.

use super::Sequence;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::image::Rgb;
use renderflow_frame::warp::{self, Keyframe, Neighbour};

/// Reads the stored frames `keys` of `sequence` as keyframes, each with its index; `draw` makes the picture without paths of one
/// from its index and G-buffer.
///
/// # Errors
/// When a keyframe cannot be read, has no beauty, or cannot be drawn.
pub fn prepare(
    sequence: &Sequence,
    keys: &[usize],
    mut draw: impl FnMut(usize, &Frame) -> Result<Option<Rgb>>,
) -> Result<Vec<(usize, Keyframe)>> {
    let keyframe = |&index: &usize| {
        let mut frame = sequence.frame(index)?;
        let truth = frame.beauty.take().with_context(|| format!("keyframe {index} has no beauty"))?;
        let start = draw(index, &frame)?;
        Ok((index, Keyframe { frame, truth, start }))
    };
    keys.iter().map(keyframe).collect()
}

/// Keyframe `key`, stored frame `there`, in relation to stored frame `index`.
pub fn seen_from<'a>(sequence: &'a Sequence, index: usize, there: usize, key: &'a Keyframe) -> Neighbour<'a> {
    let distance = sequence.numbers[there] as f32 - sequence.numbers[index] as f32;
    Neighbour { key, distance, movement: sequence.transforms.tracks.between(index, there) }
}

/// The keyframes warped to stored frame `index` with the G-buffer `frame`, over `start`, its picture without paths.
pub fn warp(sequence: &Sequence, keys: &[(usize, Keyframe)], index: usize, frame: &Frame, start: &Rgb) -> Rgb {
    let keys: Vec<Neighbour> = keys.iter().map(|(there, key)| seen_from(sequence, index, *there, key)).collect();
    warp::fill(frame, start, &keys, sequence.exposure())
}
