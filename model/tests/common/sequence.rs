//! The analytic clip as a sequence for renderers.

use super::clip;
use renderflow_frame::{DepthBounds, Frame, Light};
use renderflow_model::Clip;
use renderflow_model::renderer::{KeyframePlace, Sequence, View};
use renderflow_model::wan::pictures::{EnvironmentView, Pictures};

/// Pixels a side: not what tokens cover.
pub const SIDE: usize = 20;

/// A clip in memory as a sequence.
pub struct Memory {
    pub clip: Clip,
    pub places: Vec<KeyframePlace>,
}

impl Memory {
    pub fn new(frames: usize, keyframes: &[usize]) -> Self {
        let clip = clip(frames, SIDE);
        let places = keyframes.iter().map(|&index| KeyframePlace { number: clip.numbers[index], index }).collect();
        Self { places, clip }
    }

    pub fn view(&self, index: usize) -> View<'_> {
        let clip = &self.clip;
        View { number: clip.numbers[index], index, frame: &clip.frames[index], shaded: clip.shaded.get(index) }
    }

    pub fn len(&self) -> usize {
        self.clip.frames.len()
    }

    pub fn pictures(&self, index: usize) -> Pictures {
        let (clip, bounds) = (&self.clip, DepthBounds::of(&self.clip.frames));
        let view = EnvironmentView::new(&clip.light.environment, 32, 32);
        Pictures::new(&clip.frames[index], &clip.light, &view, bounds).expect("pictures")
    }
}

impl Sequence for Memory {
    fn light(&self) -> renderflow_model::Result<&Light> {
        Ok(&self.clip.light)
    }

    fn depth_bounds(&self) -> renderflow_model::Result<DepthBounds> {
        Ok(DepthBounds::of(&self.clip.frames))
    }

    fn keyframes(&self) -> &[KeyframePlace] {
        &self.places
    }

    fn keyframe(&self, index: usize) -> renderflow_model::Result<Frame> {
        Ok(self.clip.frames[index].clone())
    }
}

/// A sequence whose bounds are given.
pub struct Bounded {
    pub sequence: Memory,
    pub bounds: DepthBounds,
}

impl Sequence for Bounded {
    fn light(&self) -> renderflow_model::Result<&Light> {
        self.sequence.light()
    }

    fn depth_bounds(&self) -> renderflow_model::Result<DepthBounds> {
        Ok(self.bounds)
    }

    fn keyframes(&self) -> &[KeyframePlace] {
        self.sequence.keyframes()
    }

    fn keyframe(&self, index: usize) -> renderflow_model::Result<Frame> {
        self.sequence.keyframe(index)
    }
}
