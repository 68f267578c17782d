//! A dataset plan: everything needed to make the same dataset again, byte for byte, anywhere.

use anyhow::{Context, Result, ensure};
use renderflow_scenes::procedural::{ComposeOptions, Split, compose};
use renderflow_scenes::validate::{MAX_FRAMES, MAX_RESOLUTION, MAX_VALUE};
use renderflow_scenes::{description::Scene, seed::Seed};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Counts, sizes and the seed of a dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Format version, 1.
    pub version: u32,
    /// Root of the seed tree.
    pub seed: u64,
    /// Which environments and seeds the sequences draw from.
    pub split: Split,
    /// Number of sequences; one scene each.
    pub sequences: u32,
    /// Frames of a sequence.
    pub frames: u32,
    /// Only frames 0, step, 2 step, ... are rendered; 1 = all. Training wants many scenes more than many frames of one.
    pub frame_step: u32,
    /// Camera turn from a frame to the next, degrees.
    pub degrees_per_frame: f32,
    /// Width and height in pixels.
    pub resolution: [u32; 2],
    /// Samples a pixel of the truth.
    pub spp: u32,
    /// Whether the samples are spread by need, `spp` a pixel on average. Plans that say nothing mean evenly.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub adaptive: bool,
    /// Scattering events of a path.
    pub max_bounces: u32,
    /// Frames 0, gap, 2 gap, ... are keyframes.
    pub keyframe_gap: u32,
}

impl Plan {
    /// Reads and checks a plan file.
    pub fn read(path: &Path) -> Result<Self> {
        let plan: Self = renderflow_frame::file::read_json(path)?;
        plan.check().with_context(|| format!("{}", path.display()))?;
        Ok(plan)
    }

    /// Ranges of every field.
    pub fn check(&self) -> Result<()> {
        ensure!(self.version == 1, "/version: {} is not 1", self.version);
        ensure!(self.sequences >= 1, "/sequences: must be at least 1");
        ensure!((1..=MAX_FRAMES).contains(&self.frames), "/frames: {} is outside 1..={MAX_FRAMES}", self.frames);
        ensure!(self.spp >= 1, "/spp: must be at least 1");
        ensure!(self.max_bounces >= 1, "/max_bounces: must be at least 1");
        ensure!(self.frame_step >= 1, "/frame_step: must be at least 1");
        ensure!(self.keyframe_gap >= 1, "/keyframe_gap: must be at least 1");
        let turn = self.degrees_per_frame;
        ensure!(turn.abs() <= MAX_VALUE, "/degrees_per_frame: {turn} is outside -{MAX_VALUE}..={MAX_VALUE}");
        for (axis, size) in self.resolution.iter().enumerate() {
            ensure!((1..=MAX_RESOLUTION).contains(size), "/resolution/{axis}: {size} is outside 1..={MAX_RESOLUTION}");
        }
        Ok(())
    }

    /// Folder name of sequence `index`.
    pub fn sequence_name(index: u32) -> String {
        format!("seq-{index:06}")
    }

    /// The scene of sequence `index`; depends on the plan's seed and `index` only.
    pub fn scene(&self, index: u32) -> Scene {
        compose(&ComposeOptions {
            seed: Seed::root(self.seed).child("sequence", u64::from(index)).u64(),
            resolution: self.resolution,
            frames: self.frames,
            degrees_per_frame: self.degrees_per_frame,
            split: self.split,
            ..ComposeOptions::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plan of ten million frames, or one whose camera spins beyond what a scene may say, was accepted and made no valid scene.
    #[test]
    fn what_a_plan_may_say_a_scene_may_say() {
        let plan = |frames: u32, degrees_per_frame: f32| Plan {
            version: 1,
            seed: 4,
            split: Split::Train,
            sequences: 2,
            frames,
            frame_step: 1,
            degrees_per_frame,
            resolution: [64, 48],
            spp: 1,
            adaptive: false,
            max_bounces: 1,
            keyframe_gap: 1,
        };
        let largest = plan(MAX_FRAMES, -MAX_VALUE);
        largest.check().unwrap();
        largest.scene(1).validate().unwrap();
        let error = |plan: Plan| plan.check().unwrap_err().to_string();
        assert_eq!(error(plan(10_000_009, 3.6)), "/frames: 10000009 is outside 1..=100000");
        assert!(error(plan(9, 4.294_967_3e10)).starts_with("/degrees_per_frame: 42949673000 is outside"));
        assert!(error(plan(9, f32::NAN)).starts_with("/degrees_per_frame: NaN is outside"));
    }
}
