//! How much memory a picture takes while it is made.

use super::gbuffer;
use super::light_paths::CausticCasters;
use crate::compile::RenderScene;
use crate::film::{GroupStatistics, GuideStatistics, LightStatistics, PathStatistics, PixelStatistics};
use crate::schedule;
use crate::settings::{Budget, Settings};
use renderflow_frame::frame::LIGHT_GROUPS;

const RGB: usize = size_of::<[f32; 3]>();
const FLOW: usize = size_of::<[f32; 2]>();
const NUMBER: usize = size_of::<f32>();

/// Bytes that a picture takes at most at a time, beside the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Memory {
    /// While it is traced: the sums of all samples with the pictures made of them, then the frame beside the sums of the guides.
    pub tracing: u64,
    /// The frame.
    pub frame: u64,
}

impl RenderScene {
    /// Whether light paths will be traced with these settings.
    pub fn has_light_paths(&self, settings: &Settings) -> bool {
        CausticCasters::find(self, settings).is_some()
    }
}

impl Settings {
    /// Memory of a picture of `width x height` pixels, with light paths or without.
    pub fn memory(&self, [width, height]: [usize; 2], light_paths: bool, gbuffer_alone: bool) -> Memory {
        let pixels = (width as u64).saturating_mul(height as u64);
        let when = |condition: bool, bytes: usize| if condition { bytes } else { 0 };
        let groups = (self.light_groups as usize).min(LIGHT_GROUPS);
        let sums = size_of::<PixelStatistics>() + when(groups > 0, size_of::<GroupStatistics>());
        let sums = sums + when(self.channels.paths, size_of::<PathStatistics>());
        let guides = size_of::<GuideStatistics>();
        let light = when(light_paths, size_of::<LightStatistics>() + when(groups > 0, size_of::<GroupStatistics>()));
        // Counts and noise of the pixels, of which adaptive sampling needs some more.
        let spread = when(self.budget != Budget::Uniform, 48);
        let adaptive = when(self.budget != Budget::Uniform, size_of::<u32>());
        // What the film's beauty is, and what camera rays make.
        let paths = when(self.channels.paths, 2 * RGB);
        let beauty = RGB * (1 + groups) + when(self.channels.variance, RGB) + paths + adaptive;
        let wanted = self.channels;
        let centres = NUMBER
            // With what is seen through clear surfaces, which only some scenes have.
            + when(wanted.gbuffer, 5 * RGB + 3 * NUMBER)
            + when(wanted.guides, 2 * RGB)
            + when(wanted.motion, 2 * FLOW)
            + when(self.irradiance, RGB);
        // Whether a pixel may see geometry.
        let seen = size_of::<bool>();
        let [film, kept, made] = if gbuffer_alone { [0; 3] } else { [sums + guides + light + spread, guides, beauty] };
        let frame = centres + if gbuffer_alone { 0 } else { beauty + RGB };
        let all = |bytes: usize| pixels.saturating_mul(bytes as u64);
        // Tiles of the G-buffer are held until they are stored. They come on top of the film's sums, too, which the allocator
        // gives back to the system some time after they are freed.
        let looks = gbuffer_alone || wanted.gbuffer || wanted.motion || self.irradiance;
        let held = if looks { schedule::most_pixels().min(pixels) * gbuffer::HELD } else { 0 };
        // A G-buffer that tells the counts is there before the samples.
        let together = self.budget == Budget::Detail && !gbuffer_alone;
        let before = when(together && !wanted.gbuffer, 5 * RGB + 3 * NUMBER);
        let sums = if together { film + centres + before } else { film.max(kept + centres) };
        let traced = all(sums + made + seen).saturating_add(held);
        Memory { tracing: traced.max(all(kept + frame + seen)), frame: all(frame) }
    }
}
