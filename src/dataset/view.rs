//! A sequence on disk as renderers see it.

use super::SequenceFolder;
use rayon::prelude::*;
use renderflow_frame::{DepthBounds, Frame, Light};
use renderflow_model::renderer::{KeyframePlace, Sequence};
use renderflow_model::{Error, Result};
use std::sync::OnceLock;

/// A sequence whose depths are read when they are first asked for.
#[derive(Debug)]
pub struct SequenceView<'a> {
    /// The sequence.
    pub folder: &'a SequenceFolder,
    bounds: OnceLock<DepthBounds>,
    keyframes: Vec<KeyframePlace>,
}

impl<'a> SequenceView<'a> {
    /// Nothing is read yet.
    pub fn new(folder: &'a SequenceFolder) -> Self {
        let places = folder.sequence.keyframes.iter().map(|&index| KeyframePlace { number: folder.numbers[index], index });
        let mut keyframes: Vec<KeyframePlace> = places.collect();
        keyframes.sort_by_key(|place| place.number);
        Self { folder, bounds: OnceLock::new(), keyframes }
    }

    fn frame(&self, index: usize) -> Result<Frame> {
        let place = || self.folder.path.display().to_string();
        self.folder.frame(index).map_err(|error| Error::Data { place: place(), reason: crate::console::message(&error) })
    }
}

impl Sequence for SequenceView<'_> {
    fn light(&self) -> &Light {
        &self.folder.light
    }

    fn depth_bounds(&self) -> Result<DepthBounds> {
        if let Some(bounds) = self.bounds.get() {
            return Ok(*bounds);
        }
        let extremes = |index: usize| -> Result<[f32; 2]> {
            let frame = self.frame(index)?;
            let seen = frame.depth.pixels.iter().copied().filter(|d| *d > 0.0 && d.is_finite());
            Ok(seen.fold([f32::INFINITY, 0.0], |[near, far], d| [near.min(d), far.max(d)]))
        };
        let extremes: Vec<[f32; 2]> = (0..self.folder.len()).into_par_iter().map(extremes).collect::<Result<_>>()?;
        Ok(*self.bounds.get_or_init(|| DepthBounds::of_depths(extremes.into_iter().flatten())))
    }

    fn keyframes(&self) -> &[KeyframePlace] {
        &self.keyframes
    }

    fn keyframe(&self, index: usize) -> Result<Frame> {
        self.frame(index)
    }
}
