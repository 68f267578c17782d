//! From a compiled scene to a [`Frame`]: the path integrator for the beauty, the first-hit integrator for the G-buffer, and the
//! split-sum baseline on top of the latter.

mod accumulate;
mod adaptive;
pub mod detail;
mod direct;
mod gbuffer;
pub mod ibl;
mod light_paths;
mod memory;
mod moments;
mod path;
mod scatter;
mod splitting;
mod tracer;
mod visible;

pub use memory::Memory;
pub use moments::render_with_shutter;

use crate::compile::RenderScene;
use crate::error::Result;
use crate::features::with_features;
use crate::film::{Beauty, Film};
use crate::schedule::Progress;
use crate::settings::{Budget, Settings};
use crate::skips::Channels;
use crate::stats::Stats;
use accumulate::{Meter, Work};
use gbuffer::{GuidesFrom, fill_guides, frame as gbuffer};
use light_paths::CausticCasters;
use renderflow_frame::{Frame, Image};
use std::ops::Range;
use std::sync::atomic::AtomicBool;
use visible::Visible;

/// Path-traces the current frame: beauty with variance, coverage, guides, and the G-buffer at pixel centres.
///
/// The picture is a function of the scene (its seed included), the frame and the settings; threads and tiles do not enter.
/// A sample that is not finite contributes 0; [`render_with_stats`] tells how many there were.
///
/// # Errors
/// When a setting is out of range, or `cancel` was set.
pub fn render(scene: &RenderScene, settings: &Settings, progress: Progress<'_>, cancel: &AtomicBool) -> Result<Frame> {
    render_with_stats(scene, settings, progress, cancel).map(|(frame, _)| frame)
}

/// As [`render`], with statistics.
///
/// # Errors
/// As [`render`].
pub fn render_with_stats(
    scene: &RenderScene,
    settings: &Settings,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    settings.check(scene)?;
    let visible = Visible::new(scene, settings);
    // The other order of work is for comparison.
    if settings.budget == Budget::Detail && settings.skips.shared_guides {
        return by_detail(scene, settings, &visible, progress, cancel);
    }
    let (film, mut stats) = whole(scene, settings, &visible, progress, cancel)?;
    let (frame, more) = finish(scene, settings, &visible, film, cancel)?;
    stats += more;
    Ok((frame, stats))
}

fn whole(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Film, Stats)> {
    match settings.budget {
        Budget::Uniform => {
            expose_samples(Samples { scene, settings, visible, range: 0..settings.spp, map: None }, progress, cancel)
        }
        Budget::Detail => {
            let map = detail_of(scene, settings, visible, cancel)?.pixels;
            let range = 0..map.iter().copied().max().unwrap_or(0);
            expose_samples(Samples { scene, settings, visible, range, map: Some(&map) }, progress, cancel)
        }
        _ => adaptive::render(scene, settings, visible, progress, cancel),
    }
}

/// The map of [`Budget::Detail`], from a G-buffer of its own.
fn detail_of(scene: &RenderScene, settings: &Settings, visible: &Visible, cancel: &AtomicBool) -> Result<Image<u32>> {
    let channels = Channels { gbuffer: true, ..Channels::BEAUTY };
    let own = &Settings { channels, irradiance: false, guide_samples: 1, ..*settings };
    let (frame, _) = with_features!(own.needed(scene), own.full(), gbuffer(scene, own, visible, GuidesFrom::Later, cancel))?;
    detail::detail_map(&frame, settings.spp)
}

/// A picture under [`Budget::Detail`], whose G-buffer tells the map before it gets its guides.
fn by_detail(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    let own = &Settings { channels: Channels { gbuffer: true, ..settings.channels }, ..*settings };
    let (mut frame, mut stats) =
        with_features!(own.needed(scene), own.full(), gbuffer(scene, own, visible, GuidesFrom::Later, cancel))?;
    let map = detail::detail_map(&frame, settings.spp)?.pixels;
    if !settings.channels.gbuffer {
        let Frame { albedo, normal, depth, material, object_id, material_id, transmittance, through, .. } = Frame::default();
        frame = Frame { albedo, normal, depth, material, object_id, material_id, transmittance, through, ..frame };
    }
    let range = 0..map.iter().copied().max().unwrap_or(0);
    let (mut film, more) = expose_samples(Samples { scene, settings, visible, range, map: Some(&map) }, progress, cancel)?;
    stats += more;
    let beauty = film.beauty(settings);
    film.keep_guides_alone();
    fill_guides(&mut frame, scene, &film);
    described(&mut frame, settings, beauty);
    Ok((frame, stats))
}

/// Path-traces all samples as `settings.budget` distributes them: [`render_with_stats`] without the last step, [`develop`].
///
/// # Errors
/// As [`render`].
pub fn expose_whole(
    scene: &RenderScene,
    settings: &Settings,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Film, Stats)> {
    settings.check(scene)?;
    whole(scene, settings, &Visible::new(scene, settings), progress, cancel)
}

/// Path-traces the samples `samples` of every pixel, out of `settings.spp`. The film is a part of the picture and merges with the
/// others.
///
/// # Errors
/// When a setting is out of range; when `samples` is empty, goes beyond `settings.spp` or is not in multiples of
/// [`Settings::branches()`]; or when `cancel` was set.
pub fn expose(
    scene: &RenderScene,
    settings: &Settings,
    samples: Range<u32>,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Film, Stats)> {
    settings.check(scene)?;
    settings.check_range(&samples, settings.spp)?;
    let visible = &Visible::new(scene, settings);
    expose_samples(Samples { scene, settings, visible, range: samples, map: None }, progress, cancel)
}

/// As [`render_with_stats`] with the number of samples of each pixel from `map`. Of `settings.budget`, only what it says about
/// the filtering of textures, about samples that share a camera ray and about pixels that share points counts. The
/// [`Frame::samples`] of a picture and its settings give the same picture again, bit for bit.
///
/// # Errors
/// As [`render_with_stats`], and when the map does not have the picture's size or its counts are outside 1..=2^24 or not
/// multiples of [`Settings::branches()`].
pub fn render_mapped(
    scene: &RenderScene,
    settings: &Settings,
    map: &Image<u32>,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    settings.check(scene)?;
    let visible = Visible::new(scene, settings);
    let range = 0..adaptive::largest(scene, settings, map)?;
    let samples = Samples { scene, settings, visible: &visible, range, map: Some(&map.pixels) };
    let (film, mut stats) = expose_samples(samples, progress, cancel)?;
    let (frame, more) = finish(scene, settings, &visible, film, cancel)?;
    stats += more;
    Ok((frame, stats))
}

/// Samples of a picture that are to be traced.
struct Samples<'a> {
    scene: &'a RenderScene,
    settings: &'a Settings,
    visible: &'a Visible,
    /// Numbers of the samples of every pixel.
    range: Range<u32>,
    /// Where given, the number of each pixel's samples: those of `range` at or above it are left out.
    map: Option<&'a [u32]>,
}

/// Traces `samples` onto a new film.
fn expose_samples(samples: Samples, progress: Progress<'_>, cancel: &AtomicBool) -> Result<(Film, Stats)> {
    let Samples { scene, settings, visible, range, map } = samples;
    let mut film = Film::new(scene, settings, range.clone(), map);
    let span = |pixel: usize| range.start..map.map_or(range.end, |map| range.end.min(map[pixel]));
    let casters = CausticCasters::find(scene, settings);
    let mut work = Work::new(scene, settings, visible, casters.as_ref(), cancel);
    if map.is_none() {
        work = work.even();
    } else if settings.budget == Budget::Detail && map.is_some_and(|map| detail::is_even(map, film.width)) {
        work = work.even_in_blocks();
    }
    // Where pixels have different counts, the mean gives the number of light paths.
    let all = map.map_or(range.end, mean);
    let light = range.start.min(all)..range.end.min(all);
    let paths: u64 = (0..scene.camera().width * scene.camera().height).map(|pixel| span(pixel).len() as u64).sum();
    let (meter, total) = (Meter::new(progress, None), paths + work.light_paths(&light));
    let mut stats = work.trace_light(&mut film, light, (&meter, total))?;
    stats += work.trace(&mut film, &span, (&meter, total))?;
    Ok((film, stats))
}

/// Mean of counts, rounded to the nearest integer.
fn mean(counts: &[u32]) -> u32 {
    let count = counts.len().max(1) as u64;
    let sum: u64 = counts.iter().map(|&n| u64::from(n)).sum();
    u32::try_from((sum + count / 2) / count).unwrap_or(u32::MAX)
}

/// The frame of a film: means, variance, guides, and the G-buffer at pixel centres.
///
/// # Errors
/// When a setting is out of range or the film is of another scene, frame or settings.
pub fn develop(scene: &RenderScene, settings: &Settings, film: &Film) -> Result<(Frame, Stats)> {
    settings.check(scene)?;
    film.check(scene, settings)?;
    let never = AtomicBool::new(false);
    picture(scene, settings, &Visible::new(scene, settings), film.beauty(settings), film, &never)
}

/// The frame of a film that is no longer needed; its memory is freed for the frame.
fn finish(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    mut film: Film,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    let beauty = film.beauty(settings);
    if settings.skips.shared_guides {
        film.keep_guides_alone();
    }
    picture(scene, settings, visible, beauty, &film, cancel)
}

/// The frame of `beauty`, with the guides of `film`.
fn picture(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    beauty: Beauty,
    film: &Film,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    let (mut frame, stats) = with_features!(
        settings.needed(scene),
        settings.full(),
        gbuffer(scene, settings, visible, GuidesFrom::Film(film), cancel)
    )?;
    described(&mut frame, settings, beauty);
    Ok((frame, stats))
}

/// Stores the pictures of the samples in `frame`, and how they were made.
fn described(frame: &mut Frame, settings: &Settings, beauty: Beauty) {
    beauty.store(frame);
    if frame.samples.is_some() && settings.budget != Budget::Uniform {
        frame.info.sampling = settings.sampling();
    }
    frame.info.max_bounces = Some(settings.max_bounces);
    frame.info.branches = Some(settings.branches()).filter(|&branches| branches > 1);
    frame.info.indirect_limit = settings.clamp_indirect;
    frame.info.bsdf = settings.bsdf.name().into();
}

/// Renders only what camera rays see: G-buffer, and coverage and guides from `settings.guide_samples` rays per pixel. No light is
/// traced.
///
/// # Errors
/// When a setting is out of range.
pub fn render_gbuffer(scene: &RenderScene, settings: &Settings) -> Result<Frame> {
    render_gbuffer_until(scene, settings, &AtomicBool::new(false))
}

/// As [`render_gbuffer`], until `cancel` is set.
///
/// # Errors
/// As [`render_gbuffer`], and when `cancel` was set.
pub fn render_gbuffer_until(scene: &RenderScene, settings: &Settings, cancel: &AtomicBool) -> Result<Frame> {
    settings.check(scene)?;
    let visible = Visible::new(scene, settings);
    let frame =
        with_features!(settings.needed(scene), settings.full(), gbuffer(scene, settings, &visible, GuidesFrom::Rays, cancel));
    frame.map(|(frame, _)| frame)
}
