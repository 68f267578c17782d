//! The analytic clip as a sequence for renderers.

use super::clip;
use renderflow_frame::ibl::IblTables;
use renderflow_frame::tracks::Movement;
use renderflow_frame::{Camera, Environment, Frame};
use renderflow_model::Clip;
use renderflow_model::renderer::{KeyframePlace, Sequence, View};
use renderflow_model::wan::pictures::{DepthBounds, EnvironmentView, Pictures};

/// Pixels a side: not what tokens cover.
pub const SIDE: usize = 20;

/// A clip in memory as a sequence.
pub struct Memory {
    pub clip: Clip,
    tables: IblTables,
    pub places: Vec<KeyframePlace>,
}

impl Memory {
    pub fn new(frames: usize, keyframes: &[usize]) -> Self {
        let clip = clip(frames, SIDE);
        let places = keyframes.iter().map(|&index| KeyframePlace { number: clip.numbers[index], index }).collect();
        Self { tables: IblTables::new(&clip.environment), places, clip }
    }

    pub fn view(&self, index: usize) -> View<'_> {
        let clip = &self.clip;
        View { number: clip.numbers[index], index, frame: &clip.frames[index], camera: &clip.cameras[index] }
    }

    pub fn len(&self) -> usize {
        self.clip.frames.len()
    }

    pub fn pictures(&self, index: usize) -> Pictures {
        let (clip, bounds) = (&self.clip, DepthBounds::of(&self.clip.frames));
        let view = EnvironmentView::new(&clip.environment, 32, 32);
        let (frame, camera) = (&clip.frames[index], &clip.cameras[index]);
        Pictures::new(frame, camera, &clip.environment, &view, clip.exposure, bounds).expect("pictures")
    }
}

impl Sequence for Memory {
    fn environment(&self) -> &Environment {
        &self.clip.environment
    }

    fn tables(&self) -> &IblTables {
        &self.tables
    }

    fn exposure(&self) -> f32 {
        self.clip.exposure
    }

    fn depth_bounds(&self) -> renderflow_model::Result<DepthBounds> {
        Ok(DepthBounds::of(&self.clip.frames))
    }

    fn keyframes(&self) -> &[KeyframePlace] {
        &self.places
    }

    fn keyframe(&self, index: usize) -> renderflow_model::Result<(Frame, Camera)> {
        Ok((self.clip.frames[index].clone(), self.clip.cameras[index]))
    }

    fn movement(&self, from: usize, to: usize) -> Movement<'_> {
        self.clip.tracks.between(from, to)
    }
}

/// A sequence whose bounds are given.
pub struct Bounded {
    pub sequence: Memory,
    pub bounds: DepthBounds,
}

impl Sequence for Bounded {
    fn environment(&self) -> &Environment {
        self.sequence.environment()
    }

    fn tables(&self) -> &IblTables {
        self.sequence.tables()
    }

    fn exposure(&self) -> f32 {
        self.sequence.exposure()
    }

    fn depth_bounds(&self) -> renderflow_model::Result<DepthBounds> {
        Ok(self.bounds)
    }

    fn keyframes(&self) -> &[KeyframePlace] {
        self.sequence.keyframes()
    }

    fn keyframe(&self, index: usize) -> renderflow_model::Result<(Frame, Camera)> {
        self.sequence.keyframe(index)
    }

    fn movement(&self, from: usize, to: usize) -> Movement<'_> {
        self.sequence.movement(from, to)
    }
}
