//! From a compiled scene to a [`Frame`]: the path integrator for the beauty, the first-hit integrator for the G-buffer, and the
//! split-sum baseline on top of the latter.

mod accumulate;
mod adaptive;
mod direct;
mod gbuffer;
pub mod ibl;
mod light_paths;
mod memory;
mod path;
mod scatter;
mod splitting;

pub use adaptive::Budget;
pub use memory::Memory;

use crate::camera::Filter;
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::features::{FeatureSet, with_features};
use crate::film::{Beauty, Film};
use crate::light::LightGroups;
use crate::material::{Mode, Prepared};
use crate::sampler::{PixelSampler, Sampler};
use crate::schedule::Progress;
use crate::skips::{Channels, Skips};
use crate::stats::Stats;
use accumulate::{Meter, Work};
use gbuffer::Visible;
use gbuffer::frame as gbuffer;
use light_paths::CausticCasters;
use renderflow_frame::{Frame, Image};
use serde::{Deserialize, Serialize};
use std::ops::{Range, RangeInclusive};
use std::sync::atomic::AtomicBool;

/// How the light that reaches a surface directly is found. All converge to the same picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DirectLight {
    /// By light samples and scattering, weighed by multiple importance sampling.
    #[default]
    Mis,
    /// By scattering alone: small lights are noise.
    Scattering,
    /// By light samples alone: sharp reflections are noise. Needs an environment that is sampled everywhere it shines
    /// ([`crate::light::Sampling::Plain`]).
    Lights,
}

/// Camera rays a pixel from which on guides count as clean.
const CLEAN_GUIDES: u32 = 16;

/// What to render, and at which quality.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Samples per pixel of the beauty, 1..=2^24. A sample is a path; some paths share a camera ray (see `branches`). Powers of
    /// two use the sampler best. `budget` may change the number.
    pub spp: u32,
    /// Number of surfaces that a path may scatter at, 1..=1024; 1 gives direct light only.
    pub max_bounces: u32,
    /// Camera rays per pixel for coverage and guides where no beauty is rendered, 1..=2^16.
    pub guide_samples: u32,
    /// Whether to fill [`Frame::irradiance`].
    pub irradiance: bool,
    /// Groups to split the light into ([`Frame::light`]), 0..=8; 0 = no split. See [`LightGroups`] for which is which.
    pub light_groups: u32,
    /// Pixel filter of beauty, coverage and guides.
    pub filter: Filter,
    /// Form of the principled BRDF.
    pub bsdf: Mode,
    /// How direct light is found.
    pub direct: DirectLight,
    /// Kind of the random numbers.
    pub sampler: Sampler,
    /// Which pictures of the frame to fill.
    pub channels: Channels,
    /// Work that is skipped because it cannot change the picture.
    pub skips: Skips,
    /// Largest number of the samples of a pixel that share a camera ray, 1..=64: what it hits and the light samples there are
    /// made once for all of them, and each goes on from there with a path of its own. [`Self::branches`] says how many it
    /// becomes. More branches make paths cheaper, and the picture noisier where much happens within a pixel: edges, small leaves,
    /// penumbrae. 2 is the best of 1, 2 and 4 on most scenes (docs/measurements/renderer-notes.md, branches).
    pub branches: u32,
    /// Light samples at the first surface behind a camera ray, 1..=64; `None` = 1, 2, 4 or 8 by what some paths of a pilot say of
    /// this picture (1 where it has few samples). All converge to the same picture. Several pay for themselves on most scenes
    /// (docs/measurements/renderer-notes.md, light-samples).
    pub light_samples: Option<u32>,
    /// Largest contribution of light that was scattered at two or more surfaces, in any channel, > 0; `None` = no limit, the only
    /// setting without bias. It is for pictures to look at, never for references or data sets: a limit darkens the picture by
    /// some per cent and takes most of its noise (docs/measurements/renderer-notes.md, clamp-indirect).
    /// [`Stats::clamped_contributions`] counts.
    pub clamp_indirect: Option<f32>,
    /// Whether light is followed from the environment, over shiny bodies, to what the camera sees, besides paths from the camera:
    /// what casts caustics is found from both sides and weighed. Off by itself where it would bring nothing: no shiny bodies, no
    /// concentrated light, another filter than [`Filter::Box`], `direct` other than [`DirectLight::Mis`], a limit on indirect
    /// light. Both ways converge to the same picture. Under suns and lamps the error falls severalfold for little time
    /// (docs/measurements/renderer-notes.md, light-paths).
    pub light_paths: bool,
    /// How the samples are spread over the pixels.
    pub budget: Budget,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            spp: 256,
            max_bounces: 6,
            guide_samples: 16,
            irradiance: false,
            light_groups: 0,
            filter: Filter::Box,
            bsdf: Mode::Conserving,
            direct: DirectLight::Mis,
            sampler: Sampler::Sobol,
            channels: Channels::ALL,
            skips: Skips::ALL,
            branches: 2,
            light_samples: None,
            clamp_indirect: None,
            light_paths: true,
            budget: Budget::Uniform,
        }
    }
}

impl Settings {
    /// Range of [`Self::spp`].
    pub const SPP: RangeInclusive<u32> = 1..=1 << 24;
    /// Range of [`Self::max_bounces`].
    pub const MAX_BOUNCES: RangeInclusive<u32> = 1..=1024;
    /// Range of [`Self::guide_samples`].
    pub const GUIDE_SAMPLES: RangeInclusive<u32> = 1..=1 << 16;
    /// Range of [`Self::branches`].
    pub const BRANCHES: RangeInclusive<u32> = 1..=64;
    /// Range of [`Self::light_samples`].
    pub const LIGHT_SAMPLES: RangeInclusive<u32> = 1..=64;
    /// Range of [`Self::light_groups`].
    pub const LIGHT_GROUPS: RangeInclusive<u32> = 0..=8;

    fn check(&self, scene: &RenderScene) -> Result<()> {
        let range = |name, value: u32, range: RangeInclusive<u32>| {
            if range.contains(&value) {
                Ok(())
            } else {
                Err(Error::Setting { name, value: value.into(), range: format!("{range:?}") })
            }
        };
        range("spp", self.spp, Self::SPP)?;
        range("max_bounces", self.max_bounces, Self::MAX_BOUNCES)?;
        range("branches", self.branches, Self::BRANCHES)?;
        range("light_samples", self.light_samples.unwrap_or(1), Self::LIGHT_SAMPLES)?;
        if let Some(limit) = self.clamp_indirect
            && !(limit > 0.0 && limit.is_finite())
        {
            return Err(Error::Inconsistent {
                place: "clamp_indirect".into(),
                reason: format!("{limit} is not a finite number > 0"),
            });
        }
        range("guide_samples", self.guide_samples, Self::GUIDE_SAMPLES)?;
        self.budget.check()?;
        if self.light_groups > 0 {
            LightGroups::new(self.light_groups as usize, scene.environment().rotation)?;
        }
        Ok(())
    }

    /// How samples are distributed, as the header of a frame stores it: `average 256`, `error 0.01 within 4096`, `time 5 within 4096`;
    /// empty for [`Budget::Uniform`].
    pub fn sampling(&self) -> String {
        match self.budget {
            Budget::Uniform => String::new(),
            Budget::Average => format!("average {}", self.spp),
            Budget::Error { millionths } => format!("error {} within {}", f64::from(millionths) / 1e6, self.spp),
            Budget::Time { milliseconds } => format!("time {} within {}", f64::from(milliseconds) / 1e3, self.spp),
        }
    }

    /// These settings with the budget and `spp` that [`Self::sampling`] describes by `text`; `None` where `text` is not such a
    /// description.
    pub fn with_sampling(self, text: &str) -> Option<Self> {
        let words: Vec<&str> = text.split(' ').collect();
        let whole = |number: &str, unit: f64| Some((number.parse::<f64>().ok()? * unit).round() as u32);
        let (budget, spp) = match words[..] {
            ["average", spp] => (Budget::Average, spp),
            ["error", target, "within", spp] => (Budget::Error { millionths: whole(target, 1e6)? }, spp),
            ["time", seconds, "within", spp] => (Budget::Time { milliseconds: whole(seconds, 1e3)? }, spp),
            _ => return None,
        };
        Some(Self { budget, spp: spp.parse().ok()?, ..self })
    }

    /// Whether the full feature set is used, whatever the scene needs.
    fn full(&self) -> bool {
        self.bsdf == Mode::Published || !self.skips.feature_sets
    }

    /// The features of the scene that the integrator needs.
    fn needed(&self, scene: &RenderScene) -> FeatureSet {
        let has = scene.features();
        FeatureSet {
            textures: has.textures || !self.skips.feature_sets,
            flat_environment: has.flat_environment && self.skips.flat_environment,
            ..has
        }
    }

    /// Checks that `samples` lie in `0..end` and make whole camera rays.
    fn check_range(&self, samples: &Range<u32>, end: u32) -> Result<()> {
        let whole = |number: u32| number.is_multiple_of(self.branches());
        if !samples.is_empty() && samples.end <= end && whole(samples.start) && whole(samples.end) {
            return Ok(());
        }
        let range = "a part of all samples that is not empty, its ends multiples of the samples that share a camera ray";
        Err(Error::Setting { name: "samples", value: samples.end.into(), range: range.into() })
    }

    /// How many samples share a camera ray: a power of two, at most [`Settings::branches`]. At least four camera rays are left in
    /// a pixel that may see geometry, for the sake of its edges and its variance.
    pub fn branches(&self) -> u32 {
        let (fewest, largest) =
            (self.budget.fewest(self.spp), if self.budget == Budget::Uniform { 64 } else { adaptive::BRANCHES });
        let possible = |&b: &u32| b <= self.branches.min(largest) && fewest.is_multiple_of(b) && fewest >= 4 * b;
        (0..7).map(|k| 64 >> k).find(possible).unwrap_or(1)
    }

    /// Whether coverage, albedo and normal of every pixel are means of enough camera rays for the denoiser to trust them.
    pub fn clean_guides(&self) -> bool {
        self.budget.fewest(self.spp) / self.branches() >= CLEAN_GUIDES
    }

    /// Camera rays per pixel; the mean where pixels have different counts.
    pub fn camera_samples(&self) -> u32 {
        self.spp.div_ceil(self.branches())
    }

    /// The light groups; `None` where the light is not split.
    fn groups(&self, scene: &RenderScene) -> Option<LightGroups> {
        let groups = LightGroups::new(self.light_groups as usize, scene.environment().rotation).ok()?;
        Some(if scene.features().emitters { groups.with_emitters() } else { groups })
    }

    /// BSDFs made before, by material.
    fn bsdfs(self, scene: &RenderScene) -> &[Option<Prepared>] {
        if self.bsdf == Mode::Conserving { scene.bsdfs() } else { &[] }
    }

    /// The random numbers of one pixel.
    fn random(&self, scene: &RenderScene, pixel: usize) -> PixelSampler {
        PixelSampler::of_kind(self.sampler, scene.seed, scene.frame() as u64, pixel as u64)
    }
}

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
        _ => adaptive::render(scene, settings, visible, progress, cancel),
    }
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

/// As [`render_with_stats`] with the number of samples of each pixel from `map`; `settings.budget` is ignored. The
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

/// As [`expose`] with the number of samples of each pixel from `map`: traces the samples whose number is in `samples`, a part of
/// 0 to the largest count.
///
/// # Errors
/// As [`expose`] and [`render_mapped`].
pub fn expose_mapped(
    scene: &RenderScene,
    settings: &Settings,
    map: &Image<u32>,
    samples: Range<u32>,
    progress: Progress<'_>,
    cancel: &AtomicBool,
) -> Result<(Film, Stats)> {
    settings.check(scene)?;
    settings.check_range(&samples, adaptive::largest(scene, settings, map)?)?;
    let visible = &Visible::new(scene, settings);
    expose_samples(Samples { scene, settings, visible, range: samples, map: Some(&map.pixels) }, progress, cancel)
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
    let work = Work::new(scene, settings, visible, casters.as_ref(), cancel);
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
    let (mut frame, stats) =
        with_features!(settings.needed(scene), settings.full(), gbuffer(scene, settings, visible, Some(film), cancel))?;
    beauty.store(&mut frame);
    if frame.samples.is_some() && settings.budget != Budget::Uniform {
        frame.info.sampling = settings.sampling();
    }
    frame.info.branches = Some(settings.branches()).filter(|&branches| branches > 1);
    frame.info.indirect_limit = settings.clamp_indirect;
    frame.info.bsdf = settings.bsdf.name().into();
    Ok((frame, stats))
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
    let frame = with_features!(settings.needed(scene), settings.full(), gbuffer(scene, settings, &visible, None, cancel));
    frame.map(|(frame, _)| frame)
}
