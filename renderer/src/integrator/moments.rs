//! Pictures that are taken while things move.

use super::accumulate::{Meter, Work};
use super::finish;
use super::light_paths::CausticCasters;
use super::splitting::light_samples;
use super::visible::Visible;
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::film::Film;
use crate::schedule::Progress;
use crate::settings::{Budget, Settings};
use crate::stats::Stats;
use renderflow_frame::Frame;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// As [`crate::render_with_stats`], while the shutter of [`RenderScene::compile_with_shutter`] is open: each moment gets an
/// equal part of the samples. Beauty, variance, coverage and guides are blurred; the G-buffer at pixel centres and the motion
/// vectors are those of the frame itself, in the middle of the time. The scene stands at its frame afterwards.
///
/// # Errors
/// As [`crate::render_with_stats`]; when the scene has no shutter, when `settings.budget` is another than [`Budget::Uniform`],
/// and when a pixel has fewer camera rays than there are moments.
pub fn render_with_shutter(
    scene: &mut RenderScene,
    settings: &Settings,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    settings.check(scene)?;
    let shutter = scene.shutter().ok_or_else(|| Error::inconsistent("shutter", "the scene was compiled without one"))?;
    if settings.budget != Budget::Uniform {
        return Err(Error::inconsistent("budget", "with a shutter, every pixel has the same number of samples"));
    }
    let (branches, moments) = (settings.branches(), shutter.moments);
    let rays = settings.spp / branches;
    if rays < moments {
        let reason = format!("{rays} camera rays a pixel are fewer than its {moments} moments");
        return Err(Error::inconsistent("shutter", reason));
    }
    let frame = scene.frame();
    let exposed = expose(scene, settings, progress, cancel, |k| {
        let ray = |k: u32| (u64::from(rays) * u64::from(k) / u64::from(moments)) as u32 * branches;
        ray(k)..if k + 1 == moments { settings.spp } else { ray(k + 1) }
    });
    scene.set_frame(frame);
    let (film, mut stats) = exposed?;
    let mut settings = *settings;
    // Rays of the frame alone would not be blurred.
    settings.skips.shared_guides = true;
    let (mut frame, more) = finish(scene, &settings, &Visible::new(scene, &settings), film, cancel)?;
    frame.info.shutter = shutter.to_string();
    stats += more;
    Ok((frame, stats))
}

/// Traces the samples `range(k)` at each moment `k` of the scene's shutter.
fn expose(
    scene: &mut RenderScene,
    settings: &Settings,
    progress: Progress<'_>,
    cancel: &AtomicBool,
    range: impl Fn(u32) -> Range<u32>,
) -> Result<(Film, Stats)> {
    let mut film = Film::new(scene, settings, 0..settings.spp, None);
    // One pilot serves all moments.
    let casters = CausticCasters::find(scene, settings);
    let lights = light_samples(scene, settings, &Visible::new(scene, settings), casters.as_ref());
    let settings = &Settings { light_samples: Some(lights), ..*settings };
    let pixels = (scene.camera().width * scene.camera().height) as u64;
    let meter = Meter::new(progress, None);
    let (mut stats, mut without) = (Stats::default(), 0);
    // Light paths so far, by instance.
    let mut traced = Vec::new();
    for (k, moment) in (0..scene.shutter().map_or(0, |shutter| shutter.moments)).zip(0..) {
        scene.set_moment(moment);
        let samples = range(k);
        // As much is worth finding out as a moment has rays.
        let own = Settings { spp: samples.len() as u32, ..*settings };
        let visible = Visible::new(scene, &own);
        let mut casters = CausticCasters::find(scene, settings);
        if let Some(casters) = &mut casters {
            casters.go_on(&mut traced, &samples);
        }
        let work = Work::new(scene, settings, &visible, casters.as_ref(), cancel).even();
        let light = work.light_paths(&samples);
        // Moments may have different numbers of light paths; all are taken to be like this one.
        let total = (pixels * samples.len() as u64 + light) * u64::from(settings.spp) / samples.len().max(1) as u64;
        if casters.is_none() {
            without += samples.len() as u32;
        }
        stats += work.trace_light(&mut film, samples.clone(), (&meter, total))?;
        stats += work.trace(&mut film, &|_| samples.clone(), (&meter, total))?;
    }
    if film.has_light_paths() && without > 0 {
        // These moments have no light paths, which is part of the mean.
        film.light_paths(without);
    }
    Ok((film, stats))
}
