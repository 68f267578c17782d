//! What to render, and at which quality: every option of the path tracer, with its default and its range.

use crate::camera::{Filter, ThinLens};
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::features::FeatureSet;
use crate::light::LightGroups;
use crate::material::{Mode, Prepared};
use crate::sampler::{PixelSampler, Sampler, Sharing};
use crate::skips::{Channels, Skips};
use serde::{Deserialize, Serialize};
use std::ops::{Range, RangeInclusive};

/// How the light that reaches a surface directly is found. All converge to the same picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DirectLight {
    /// By light samples and scattering, weighed by multiple importance sampling.
    #[default]
    Mis,
    /// By scattering alone: small lights are noise, and lights without an area are not found at all.
    Scattering,
    /// By light samples alone: sharp reflections are noise. Needs an environment that is sampled everywhere it shines
    /// ([`crate::light::Sampling::Plain`]).
    Lights,
}

/// Camera rays a pixel from which on guides count as clean.
const CLEAN_GUIDES: u32 = 16;
/// The same on average, where more go to what shows detail.
const CLEAN_DETAIL: u32 = 4;

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
    /// Whether to fill [`renderflow_frame::Frame::irradiance`].
    pub irradiance: bool,
    /// Groups to split the light into ([`renderflow_frame::Frame::light`]), 0..=8; 0 = no split. See [`LightGroups`] for which is
    /// which.
    pub light_groups: u32,
    /// Pixel filter of beauty, coverage and guides.
    pub filter: Filter,
    /// Lens of beauty, coverage and guides; `None` = a pinhole. With a lens, no light paths are traced. The G-buffer at pixel
    /// centres stays that of a pinhole in the middle of the lens: sharp everywhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<ThinLens>,
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
    /// this picture (4 where it has few samples). All converge to the same picture. Several pay for themselves on most scenes
    /// (docs/measurements/renderer-notes.md, light-samples).
    pub light_samples: Option<u32>,
    /// Largest contribution of light that was scattered at two or more surfaces, in any channel, > 0; `None` = no limit, the only
    /// setting without bias. It is for pictures to look at, never for references or data sets: a limit darkens the picture by
    /// some per cent and takes most of its noise (docs/measurements/renderer-notes.md, clamp-indirect).
    /// [`crate::Stats::clamped_contributions`] counts.
    pub clamp_indirect: Option<f32>,
    /// Whether light is followed from the environment and from lamps, over shiny and clear bodies, to what the camera sees,
    /// besides paths from the camera: what casts caustics is found from both sides and weighed. Off by itself where it would
    /// bring nothing: no shiny or clear bodies, no concentrated light, another filter than [`Filter::Box`], a lens, `direct`
    /// other than [`DirectLight::Mis`], a limit on indirect light. Both ways converge to the same picture. Under suns and lamps
    /// the error falls severalfold for little time (docs/measurements/renderer-notes.md, light-paths).
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
            lens: None,
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

    pub(crate) fn check(&self, scene: &RenderScene) -> Result<()> {
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
        if let Some(lens) = &self.lens {
            for (field, value) in [("aperture", lens.aperture), ("focus", lens.focus)] {
                if !(value > 0.0 && value.is_finite()) {
                    return Err(Error::inconsistent(format!("lens/{field}"), format!("{value} is not a finite number > 0")));
                }
            }
        }
        range("guide_samples", self.guide_samples, Self::GUIDE_SAMPLES)?;
        self.budget.check()?;
        if self.light_groups > 0 {
            LightGroups::new(self.light_groups as usize, scene.environment().rotation)?;
        }
        Ok(())
    }

    /// How samples are distributed, as the header of a frame stores it: `average 256`, `detail 4`, `error 0.01 within 4096`,
    /// `time 5 within 4096`; empty for [`Budget::Uniform`].
    pub fn sampling(&self) -> String {
        match self.budget {
            Budget::Uniform => String::new(),
            Budget::Average => format!("average {}", self.spp),
            Budget::Detail => format!("detail {}", self.spp),
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
            ["detail", spp] => (Budget::Detail, spp),
            ["error", target, "within", spp] => (Budget::Error { millionths: whole(target, 1e6)? }, spp),
            ["time", seconds, "within", spp] => (Budget::Time { milliseconds: whole(seconds, 1e3)? }, spp),
            _ => return None,
        };
        Some(Self { budget, spp: spp.parse().ok()?, ..self })
    }

    /// Whether the full feature set is used, whatever the scene needs.
    pub(crate) fn full(&self) -> bool {
        self.bsdf == Mode::Published || !self.skips.feature_sets
    }

    /// The features of the scene that the integrator needs.
    pub(crate) fn needed(&self, scene: &RenderScene) -> FeatureSet {
        let has = scene.features();
        FeatureSet {
            textures: has.textures || !self.skips.feature_sets,
            flat_environment: has.flat_environment && self.skips.flat_environment,
            ..has
        }
    }

    /// Checks that `samples` lie in `0..end` and make whole camera rays.
    pub(crate) fn check_range(&self, samples: &Range<u32>, end: u32) -> Result<()> {
        let whole = |number: u32| number.is_multiple_of(self.branches());
        if !samples.is_empty() && samples.end <= end && whole(samples.start) && whole(samples.end) {
            return Ok(());
        }
        let range = "a part of all samples that is not empty, its ends multiples of the samples that share a camera ray";
        Err(Error::Setting { name: "samples", value: samples.end.into(), range: range.into() })
    }

    /// How many samples share a camera ray: a power of two, at most [`Settings::branches`]. At least four camera rays are left in
    /// a pixel that may see geometry, for the sake of its edges and its variance. Under [`Budget::Detail`] none do, for the sake
    /// of the denoiser's guides (docs/measurements/renderer-notes.md, detail).
    pub fn branches(&self) -> u32 {
        let largest = match self.budget {
            Budget::Uniform => 64,
            Budget::Detail => 1,
            Budget::Average | Budget::Error { .. } | Budget::Time { .. } => BRANCHES,
        };
        let fewest = self.budget.fewest(self.spp);
        let possible = |&b: &u32| b <= self.branches.min(largest) && fewest.is_multiple_of(b) && fewest >= 4 * b;
        (0..7).map(|k| 64 >> k).find(possible).unwrap_or(1)
    }

    /// Whether coverage, albedo and normal of every pixel are means of enough camera rays for the denoiser to trust them.
    pub fn clean_guides(&self) -> bool {
        match self.budget {
            // There are more rays where normals and albedo change, if these are sharp.
            Budget::Detail if self.lens.is_none() => self.spp >= CLEAN_DETAIL,
            _ => self.budget.fewest(self.spp) / self.branches() >= CLEAN_GUIDES,
        }
    }

    /// Camera rays per pixel; the mean where pixels have different counts.
    pub fn camera_samples(&self) -> u32 {
        self.spp.div_ceil(self.branches())
    }

    /// The number of equal shares of a pixel, and of a lobe, of which sample `number` covers one: textures are filtered over it.
    ///
    /// With a budget of error or time, nobody knows how many samples there will be. The shares then follow from the samples up to
    /// this one, rounded up to a power of two. If they followed from the largest number that is allowed, a few samples would look
    /// textures up too finely, and the picture would be noisy. Later samples have smaller shares, so it converges all the same.
    pub(crate) fn shares(&self, number: u32) -> u32 {
        match self.budget {
            Budget::Uniform | Budget::Average | Budget::Detail => self.spp,
            Budget::Error { .. } | Budget::Time { .. } => {
                (number + 1).next_power_of_two().max(self.budget.fewest(self.spp)).min(self.spp)
            }
        }
    }

    /// Of the camera ray that sample `number` belongs to, the same of the pixel alone.
    pub(crate) fn camera_shares(&self, number: u32) -> u32 {
        self.shares(number).div_ceil(self.branches())
    }

    /// The light groups; `None` where the light is not split.
    pub fn groups(&self, scene: &RenderScene) -> Option<LightGroups> {
        let groups = LightGroups::new(self.light_groups as usize, scene.environment().rotation).ok()?;
        Some(if scene.features().lights() { groups.with_emitters() } else { groups })
    }

    /// BSDFs made before, by material.
    pub(crate) fn bsdfs(self, scene: &RenderScene) -> &[Option<Prepared>] {
        if self.bsdf == Mode::Conserving { scene.bsdfs() } else { &[] }
    }

    /// How pixels share sequences, if all have `rays` camera rays with `lights` light samples each.
    pub(crate) fn sharing(&self, rays: u32, lights: u32) -> Sharing {
        Sharing::new(rays, lights, self.branches())
    }

    /// The random numbers of pixel (x, y); without `sharing`, all are its own.
    pub(crate) fn random(&self, scene: &RenderScene, (x, y): (usize, usize), sharing: Option<Sharing>) -> PixelSampler {
        let (kind, seed, frame, width) = (self.sampler, scene.seed, scene.frame() as u64, scene.camera().width);
        match sharing {
            Some(sharing) => PixelSampler::shared(kind, seed, frame, (x as u32, y as u32), width as u32, sharing),
            None => PixelSampler::of_kind(kind, seed, frame, (y * width + x) as u64),
        }
    }
}

/// How the samples of a picture are spread over its pixels.
///
/// But for [`Self::Uniform`], pixels get counts of their own, told by [`renderflow_frame::Frame::samples`]. But for
/// [`Self::Detail`], they are multiples of 4, at least half the average where geometry may be seen, and pixels that see the
/// environment alone count a sixteenth: what they do not need is not spent on others, so that such a picture takes about as long
/// as a uniform one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Budget {
    /// As many in every pixel: [`Settings::spp`].
    #[default]
    Uniform,
    /// A fixed sum: at most [`Settings::spp`] a pixel on average, and no fewer where pixels that may see geometry need them.
    /// Below 32 all that may see geometry have as many.
    Average,
    /// At most [`Settings::spp`] a pixel on average over what surfaces cover, for pictures that are denoised: more where the
    /// G-buffer shows detail. Counts are powers of two, known before the first sample ([`crate::detail_map`]). What sees the
    /// environment alone has the usual number.
    Detail,
    /// Until the relMSE of the picture, mean((picture - truth)^2 / (truth^2 + 0.01)), is estimated to be at most a target; at
    /// most
    /// [`Settings::spp`] a pixel on average.
    Error {
        /// The target in millionths, at least 1.
        millionths: u32,
    },
    /// For a time; at most [`Settings::spp`] a pixel on average. The picture depends on the machine's speed;
    /// [`crate::render_mapped`] makes it again.
    Time {
        /// Milliseconds of tracing, at least 1. The pilot and rounds under way are finished.
        milliseconds: u32,
    },
}

impl Budget {
    fn check(self) -> Result<()> {
        match self {
            Self::Error { millionths: 0 } => {
                Err(Error::Setting { name: "budget.error", value: 0, range: "1.. millionths".into() })
            }
            Self::Time { milliseconds: 0 } => {
                Err(Error::Setting { name: "budget.time", value: 0, range: "1.. milliseconds".into() })
            }
            _ => Ok(()),
        }
    }

    /// The way to spread `spp` samples on average by need. Few samples say too little about their own noise; for a picture that
    /// will be denoised, the G-buffer says more.
    pub fn adaptive(spp: u32, denoised: bool) -> Self {
        if denoised && spp < FEWEST_SPREAD { Self::Detail } else { Self::Average }
    }

    /// Fewest samples of a pixel that may see geometry, where `spp` samples are asked for.
    pub fn fewest(self, spp: u32) -> u32 {
        match self {
            Self::Uniform => spp,
            Self::Average if spp < FEWEST_SPREAD => spp,
            Self::Average => pilot(spp, FLOOR),
            Self::Detail => *detail_range(spp).start(),
            // A small pilot: nobody knows how much is needed.
            Self::Error { .. } | Self::Time { .. } => pilot(spp.min(STEP * STEP), 1.0),
        }
    }
}

/// How far counts under [`Budget::Detail`] may lie above and below the average, as powers of two. A wrong prediction costs little
/// that way.
const ABOVE: u32 = 2;
const BELOW: u32 = 1;

/// The numbers of samples that pixels may have under [`Budget::Detail`], if they have `spp` on average.
pub(crate) fn detail_range(spp: u32) -> RangeInclusive<u32> {
    let most = *Settings::SPP.end();
    let usual: u32 = 1 << spp.clamp(1, most).ilog2();
    (usual >> BELOW).max(1)..=(usual << ABOVE).min(most)
}

/// First samples of a pixel that shall have at least a share of `spp`.
pub(crate) fn pilot(spp: u32, share: f64) -> u32 {
    ((f64::from(spp) * share) as u32 / STEP * STEP).max(STEP).min(spp)
}

/// Counts are multiples of this: the shortest runs of the low-discrepancy points that are well spread.
pub(crate) const STEP: u32 = 4;
/// Most samples that share a camera ray. Where many samples go, what the camera sees is a part of the noise, and 2 are better
/// than 4 (docs/measurements/renderer-notes.md, adaptive).
const BRANCHES: u32 = 2;
/// Share of the average that the pilot has, and that no pixel which may see geometry goes below. An eighth is a little better
/// where the noise stays in its places, and far worse where rare bright samples may come anywhere
/// (docs/measurements/renderer-notes.md, adaptive).
pub(crate) const FLOOR: f64 = 1.0 / 2.0;
/// Fewer samples on average are not spread: the pilot tells too little, and a round costs too much
/// (docs/measurements/renderer-notes.md, adaptive).
const FEWEST_SPREAD: u32 = 32;
