//! The beauty: camera samples added up on a film, all at once or in parts that are merged.

use super::Settings;
use super::path::Tracer;
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::features::Features;
use crate::film::{GroupStatistics, GuideStatistics, PixelStatistics};
use crate::integrator::gbuffer::Visible;
use crate::schedule::{self, Progress, Tile};
use crate::stats::Stats;
use renderflow_frame::{Frame, Image};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Samples of a picture: sums of radiance, its light groups, and what camera rays hit first. Films of disjoint ranges of samples
/// of the same scene, frame and settings merge into the film of all of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Film {
    pub(super) width: usize,
    pub(super) height: usize,
    /// What must be equal for films to belong together.
    key: String,
    /// Disjoint, in ascending order.
    ranges: Vec<Range<u32>>,
    pub(super) pixels: Vec<PixelStatistics>,
    pub(super) guides: Vec<GuideStatistics>,
    /// Empty unless light groups were asked for.
    pub(super) groups: Vec<GroupStatistics>,
}

/// Everything that the value of a sample depends on, its number apart (the total of samples is in it: footprints follow it).
fn key(scene: &RenderScene, settings: &Settings) -> String {
    let (channels, skips) = Default::default();
    let settings = Settings { guide_samples: 1, irradiance: false, channels, skips, ..*settings };
    let identity = (&scene.hash, scene.seed, scene.frame(), scene.camera().width, scene.camera().height, settings);
    blake3::hash(format!("{identity:?}").as_bytes()).to_hex().to_string()
}

impl Film {
    /// Whether [`super::develop`] may use it for this scene and these settings.
    pub(super) fn check(&self, scene: &RenderScene, settings: &Settings) -> Result<()> {
        if self.key != key(scene, settings) {
            return Err(Error::Merge("the film is of another scene, frame or other settings".into()));
        }
        let count = scene.camera().width * scene.camera().height;
        self.complete(count, if settings.light_groups > 0 { count } else { 0 })
    }

    /// Whether there are as many pixels as there should be: a film may come from a damaged file.
    fn complete(&self, pixels: usize, groups: usize) -> Result<()> {
        if (self.pixels.len(), self.guides.len(), self.groups.len()) == (pixels, pixels, groups) {
            return Ok(());
        }
        Err(Error::Merge(format!("a film holds {} pixels in place of {pixels}", self.pixels.len())))
    }

    /// Fills the beauty's channels.
    pub(super) fn develop(&self, frame: &mut Frame, settings: &Settings) {
        let image = |pixels: Vec<[f32; 3]>| Image { width: self.width, height: self.height, pixels };
        frame.raw = Some(image(self.pixels.iter().map(PixelStatistics::mean).collect()));
        frame.variance =
            settings.channels.variance.then(|| image(self.pixels.iter().map(PixelStatistics::variance_of_mean).collect()));
        for (group, light) in frame.light.iter_mut().enumerate().take(settings.light_groups as usize) {
            *light = Some(image(self.groups.iter().map(|g| g.mean(group)).collect()));
        }
    }

    /// Mean radiance of the samples so far, 0 without any.
    pub fn mean(&self) -> Image<[f32; 3]> {
        let pixels = self.pixels.iter().map(PixelStatistics::mean).collect();
        Image { width: self.width, height: self.height, pixels }
    }

    /// Samples a pixel so far.
    pub fn samples(&self) -> u32 {
        self.ranges.iter().map(|r| r.end - r.start).sum()
    }

    /// Ranges of sample numbers it holds.
    pub fn ranges(&self) -> &[Range<u32>] {
        &self.ranges
    }

    /// Adds the samples of `other`. Sums are exact to some sixteen digits, so that the picture is that of one film whatever the parts.
    ///
    /// # Errors
    /// When it is of another scene, frame or settings, or shares samples with this one; nothing is added then.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        if self.key != other.key {
            return Err(Error::Merge("the other film is of another scene, frame or other settings".into()));
        }
        other.complete(self.pixels.len(), self.groups.len())?;
        let mut ranges: Vec<_> = self.ranges.iter().chain(&other.ranges).cloned().collect();
        ranges.sort_by_key(|r| r.start);
        if let Some(pair) = ranges.windows(2).find(|pair| pair[0].end > pair[1].start) {
            return Err(Error::Merge(format!("both films hold sample {}", pair[1].start)));
        }
        ranges.dedup_by(|next, last| {
            let joins = last.end == next.start;
            if joins {
                last.end = next.end;
            }
            joins
        });
        self.ranges = ranges;
        self.pixels.iter_mut().zip(&other.pixels).for_each(|(a, b)| a.merge(b));
        self.guides.iter_mut().zip(&other.guides).for_each(|(a, b)| a.merge(b));
        self.groups.iter_mut().zip(&other.groups).for_each(|(a, b)| a.merge(b));
        Ok(())
    }
}

/// What a tile adds to the film.
#[derive(Default)]
struct Tally {
    pixels: Vec<PixelStatistics>,
    guides: Vec<GuideStatistics>,
    groups: Vec<GroupStatistics>,
    stats: Stats,
}

/// Traces the samples `range` of every pixel.
pub(super) fn samples<F: Features>(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    range: Range<u32>,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Film, Stats)> {
    let (width, height) = (scene.camera().width, scene.camera().height);
    let work = |tile: Tile| {
        let mut tracer = Tracer::<F>::new(scene, settings);
        let mut tally = Tally::default();
        for (x, y) in tile.pixels() {
            let sampler = settings.random(scene, y * width + x);
            let seen = visible.at(x, y);
            let (mut pixel, mut guides, mut groups) = <(PixelStatistics, GuideStatistics, GroupStatistics)>::default();
            for index in range.clone() {
                let sample = tracer.sample(&sampler, (x, y), index, seen);
                pixel.push(sample.radiance);
                guides.push(sample.first);
                if settings.light_groups > 0 {
                    groups.push(tracer.groups());
                }
            }
            tally.pixels.push(pixel);
            tally.guides.push(guides);
            if settings.light_groups > 0 {
                tally.groups.push(groups);
            }
        }
        tally.stats = tracer.into_stats();
        tally
    };
    let count = width * height;
    let grouped = if settings.light_groups > 0 { count } else { 0 };
    let mut film = Film {
        width,
        height,
        key: key(scene, settings),
        ranges: vec![range.clone()],
        pixels: vec![PixelStatistics::default(); count],
        guides: vec![GuideStatistics::default(); count],
        groups: vec![GroupStatistics::default(); grouped],
    };
    let mut stats = Stats::default();
    schedule::for_tiles((width, height), (range.end - range.start).into(), progress, cancel, work, |tile, tally| {
        stats += tally.stats;
        for (i, (x, y)) in tile.pixels().enumerate() {
            let at = y * width + x;
            film.pixels[at] = tally.pixels[i];
            film.guides[at] = tally.guides[i];
            if let Some(groups) = tally.groups.get(i) {
                film.groups[at] = *groups;
            }
        }
    })?;
    Ok((film, stats))
}
