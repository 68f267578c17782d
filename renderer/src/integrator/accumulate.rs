//! Traces camera samples and light paths, and adds them to a film.

use super::light_paths::{CausticCasters, Deposit, LightPaths, trace as trace_light};
use super::splitting::light_samples;
use super::tracer::{SHOTS, Shot, Tracer};
use crate::compile::RenderScene;
use crate::error::Result;
use crate::features::{Features, with_features};
use crate::film::{Film, GroupStatistics, GuideStatistics, PathStatistics, PixelStatistics};
use crate::integrator::visible::Visible;
use crate::sampler::Sharing;
use crate::schedule::{self, Progress, TilePixels};
use crate::settings::Settings;
use crate::stats::Stats;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Counts traced samples and reports the progress of a render.
pub(super) struct Meter<'a> {
    progress: Progress<'a>,
    done: AtomicU64,
    /// When the render began and how long it may take; `None` where time is not limited.
    clock: Option<(Instant, Duration)>,
}

impl<'a> Meter<'a> {
    pub fn new(progress: Progress<'a>, limit: Option<Duration>) -> Self {
        Self { progress, done: 0.into(), clock: limit.map(|limit| (Instant::now(), limit)) }
    }

    /// Number of samples so far.
    pub fn done(&self) -> u64 {
        self.done.load(Ordering::Relaxed)
    }

    /// Reports `samples` more samples of `total`.
    fn add(&self, samples: u64, total: u64) {
        let done = self.done.fetch_add(samples, Ordering::Relaxed) + samples;
        match self.clock {
            None => (self.progress)(done.min(total), total),
            Some((start, limit)) => {
                let milliseconds = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
                (self.progress)(milliseconds(start.elapsed().min(limit)), milliseconds(limit).max(1));
            }
        }
    }
}

/// What all samples of a picture share.
#[derive(Clone, Copy)]
pub(super) struct Work<'a> {
    pub scene: &'a RenderScene,
    pub settings: &'a Settings,
    pub visible: &'a Visible,
    pub casters: Option<&'a CausticCasters>,
    /// Number of light samples at the first surface behind a camera ray.
    lights: u32,
    /// Which pixels share sequences.
    blocks: Blocks,
    pub cancel: &'a AtomicBool,
}

/// Which pixels share sequences. Those with samples of different number do not.
#[derive(Clone, Copy)]
enum Blocks {
    None,
    /// All pixels have the samples that the settings ask for.
    Even,
    /// Pixels of a block have the same samples, from the first one on.
    Own,
}

impl<'a> Work<'a> {
    pub fn new(
        scene: &'a RenderScene,
        settings: &'a Settings,
        visible: &'a Visible,
        casters: Option<&'a CausticCasters>,
        cancel: &'a AtomicBool,
    ) -> Self {
        let lights = light_samples(scene, settings, visible, casters);
        Self { scene, settings, visible, casters, lights, blocks: Blocks::None, cancel }
    }

    /// For pictures whose pixels all have the samples that the settings ask for.
    pub fn even(self) -> Self {
        Self { blocks: Blocks::Even, ..self }
    }

    /// For pictures whose pixels have the same samples in each block, and all of them.
    pub fn even_in_blocks(self) -> Self {
        Self { blocks: Blocks::Own, ..self }
    }

    /// How a pixel with `rays` camera rays shares sequences.
    fn sharing(&self, rays: u32) -> Option<Sharing> {
        match self.blocks {
            Blocks::None => None,
            Blocks::Even => Some(self.settings.sharing(self.settings.camera_samples(), self.lights)),
            Blocks::Own => Some(self.settings.sharing(rays, self.lights)),
        }
    }

    /// Number of light paths of the samples `samples`.
    pub fn light_paths(&self, samples: &Range<u32>) -> u64 {
        self.casters.map_or(0, |casters| casters.paths() * samples.len() as u64)
    }

    /// Traces the light paths of the samples `samples` a pixel, which `film` does not hold yet.
    pub fn trace_light(&self, film: &mut Film, samples: Range<u32>, meter: (&Meter<'_>, u64)) -> Result<Stats> {
        let Some(casters) = self.casters.filter(|_| !samples.is_empty()) else { return Ok(Stats::default()) };
        let groups = self.settings.groups(self.scene);
        let sums = film.light_paths(samples.len() as u32);
        let mut store = |deposit: Deposit| {
            let group = groups.as_ref().map(|groups| deposit.from.group(groups));
            sums.push(deposit.pixel as usize, deposit.radiance, group);
        };
        let done = |paths: u64| meter.0.add(paths, meter.1);
        let (scene, settings) = (self.scene, self.settings);
        let paths = LightPaths { scene, settings, casters, samples };
        with_features!(settings.needed(scene), settings.full(), trace_light(&paths, self.cancel, &done, &mut store))
    }

    /// Traces the samples `span(pixel)` of every pixel and adds them to `film`, in the order of their numbers and on top of the
    /// sums so far: a film made in rounds equals a film made at once, bit for bit. `meter` comes with the total number of
    /// samples.
    pub fn trace(&self, film: &mut Film, span: &(dyn Fn(usize) -> Range<u32> + Sync), meter: (&Meter<'_>, u64)) -> Result<Stats> {
        with_features!(self.settings.needed(self.scene), self.settings.full(), trace(*self, film, span, meter))
    }
}

fn trace<F: Features>(
    all: Work<'_>,
    film: &mut Film,
    span: &(dyn Fn(usize) -> Range<u32> + Sync),
    (meter, total): (&Meter<'_>, u64),
) -> Result<Stats> {
    let Work { scene, settings, visible, casters, lights, cancel, .. } = all;
    let (width, height) = (film.width, film.height);
    let branches = settings.branches();
    let work = |mut plot: TilePixels<'_, PixelStatistics, GuideStatistics, GroupStatistics, PathStatistics>| {
        let tile = plot.tile;
        let mut tracer = Tracer::<F>::new(scene, settings, casters, lights);
        let mut samples = 0;
        // Shots with the places of their pixels in the tile. Sixteen may be of several pixels: in the rounds of an adaptive
        // picture a pixel has but few.
        let (mut shots, mut places) = (Vec::with_capacity(SHOTS), Vec::with_capacity(SHOTS));
        let mut shoot = |shots: &mut Vec<Shot>, places: &mut Vec<usize>| {
            tracer.aim(shots);
            for (k, (shot, i)) in shots.drain(..).zip(places.drain(..)).enumerate() {
                let sample = tracer.sample(k, &shot);
                let (column, row) = (i % tile.width, i / tile.width);
                plot.first[row][column].push(sample.radiance);
                plot.second[row][column].push(sample.first);
                if let Some(groups) = plot.third[row].get_mut(column) {
                    groups.push(tracer.groups());
                }
                if let Some(paths) = plot.fourth[row].get_mut(column) {
                    paths.push(tracer.paths());
                }
            }
        };
        for (i, (x, y)) in tile.pixels().enumerate() {
            let at = y * width + x;
            let range = span(at);
            samples += u64::from(range.end.saturating_sub(range.start));
            let indices = range.start / branches..range.end / branches;
            let (sampler, seen) = (settings.random(scene, (x, y), all.sharing(indices.end)), visible.at(x, y));
            let count = indices.len() as u32;
            for index in indices {
                // A pixel may have millions of samples.
                if cancel.load(Ordering::Relaxed) {
                    break;
                }
                if shots.len() == SHOTS || shots.last().is_some_and(|shot: &Shot| shot.seen != seen) {
                    shoot(&mut shots, &mut places);
                }
                shots.push(Shot { sampler, pixel: (x, y), index, count, seen });
                places.push(i);
            }
        }
        shoot(&mut shots, &mut places);
        meter.add(samples, total);
        tracer.into_stats()
    };
    let mut stats = Stats::default();
    let sums = (&mut film.pixels[..], &mut film.guides[..], &mut film.groups[..], &mut film.paths[..]);
    schedule::fill_tiles((width, height), sums, cancel, work, |tile| stats += tile)?;
    Ok(stats)
}
