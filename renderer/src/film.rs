//! The film: what the samples of a picture add up to, all at once or in parts that are merged.

mod pixel;

pub use pixel::PixelStatistics;
pub(crate) use pixel::{FirstHit, GroupStatistics, GuideStatistics, LightStatistics, PathStatistics};

use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::settings::{Budget, Settings};
use bytemuck::zeroed_vec;
use glam::{DVec3, Vec3A};
use rayon::prelude::*;
use renderflow_frame::frame::LIGHT_GROUPS;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, Image};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The samples of a picture: sums of radiance, of its light groups, and of what camera rays hit first. Films of disjoint ranges
/// of samples merge into one film if they have the same scene, frame and settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Film {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Number of samples that share a camera ray; the sums of a pixel count them as one.
    #[serde(default = "one")]
    branches: u32,
    /// Hash of everything that must be equal for films to merge.
    key: String,
    /// Numbers of the samples: disjoint ranges in ascending order. In a film with a map each pixel has only the samples below its
    /// count.
    ranges: Vec<Range<u32>>,
    /// BLAKE3 of the map of counts; `None` where every pixel has the same samples.
    #[serde(default)]
    map: Option<String>,
    pub(crate) pixels: Vec<PixelStatistics>,
    pub(crate) guides: Vec<GuideStatistics>,
    /// Empty unless light groups were asked for.
    pub(crate) groups: Vec<GroupStatistics>,
    /// Empty unless [`crate::Channels::paths`] were asked for.
    #[serde(default)]
    pub(crate) paths: Vec<PathStatistics>,
    /// Contributions of light paths.
    #[serde(default)]
    light: LightPathSums,
}

/// The pictures of a film's samples.
pub(crate) struct Beauty {
    raw: Rgb,
    variance: Option<Rgb>,
    samples: Option<Image<u32>>,
    groups: [Option<Rgb>; LIGHT_GROUPS],
    /// Indirect and hidden light.
    paths: Option<[Rgb; 2]>,
    /// Mean number of samples per pixel.
    spp: u32,
    light_paths: bool,
}

impl Beauty {
    /// Stores the pictures in a frame, and how they were made in its header.
    pub fn store(self, frame: &mut Frame) {
        frame.beauty = Some(self.raw.clone());
        frame.raw = Some(self.raw);
        (frame.variance, frame.samples, frame.light) = (self.variance, self.samples, self.groups);
        (frame.indirect, frame.hidden) = self.paths.map(|[indirect, hidden]| (indirect, hidden)).unzip();
        (frame.info.spp, frame.info.light_paths) = (self.spp, self.light_paths);
    }
}

/// Contributions of the light paths of a picture.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct LightPathSums {
    /// Number of samples per pixel whose light paths were traced.
    samples: u32,
    /// One sum per pixel; empty without light paths.
    pixels: Vec<LightStatistics>,
    /// Empty unless light groups were asked for.
    groups: Vec<GroupStatistics>,
}

fn one() -> u32 {
    1
}

/// Hash of everything that the value of a sample depends on besides its number. `spp` is included, because the footprints of
/// texture look-ups depend on it.
fn key(scene: &RenderScene, settings: &Settings) -> String {
    let (channels, skips) = Default::default();
    // Samples that follow the G-buffer have random numbers of their own.
    let budget = if settings.budget == Budget::Detail { Budget::Detail } else { Budget::Uniform };
    let branches = settings.branches();
    let settings = Settings { guide_samples: 1, irradiance: false, budget, branches, channels, skips, ..*settings };
    let content = [&scene.hash[..], &scene.files].concat();
    let identity = (&content, scene.seed, scene.frame(), scene.camera().width, scene.camera().height, settings);
    blake3::hash(&serde_json::to_vec(&identity).expect("numbers and names")).to_hex().to_string()
}

fn map_hash(map: &[u32]) -> String {
    let mut hash = blake3::Hasher::new();
    map.iter().for_each(|count| _ = hash.update(&count.to_le_bytes()));
    hash.finalize().to_hex().to_string()
}

impl Film {
    /// An empty film for the samples `range` of every pixel; with `map`, only for the samples below the pixel's count in it.
    pub(crate) fn new(scene: &RenderScene, settings: &Settings, range: Range<u32>, map: Option<&[u32]>) -> Self {
        let (width, height) = (scene.camera().width, scene.camera().height);
        let count = width * height;
        Self {
            width,
            height,
            branches: settings.branches(),
            key: key(scene, settings),
            ranges: vec![range],
            map: map.map(map_hash),
            // Pages that the system clears when the threads that trace first write to them.
            pixels: zeroed_vec(count),
            guides: zeroed_vec(count),
            groups: zeroed_vec(if settings.light_groups > 0 { count } else { 0 }),
            paths: zeroed_vec(if settings.channels.paths { count } else { 0 }),
            light: LightPathSums::default(),
        }
    }

    /// Marks the film as complete: each pixel holds the number of samples that `map` states.
    pub(crate) fn complete_map(&mut self, map: &[u32]) {
        self.ranges = std::iter::once(0..map.iter().copied().max().unwrap_or(0)).collect();
        self.map = Some(map_hash(map));
    }

    /// The sums of light paths, to which the paths of `samples` more samples per pixel will be added.
    pub(crate) fn light_paths(&mut self, samples: u32) -> &mut LightPathSums {
        self.light.begin(samples, self.pixels.len(), self.groups.len());
        &mut self.light
    }

    /// Checks that [`crate::develop`] may use the film for this scene and these settings.
    pub(crate) fn check(&self, scene: &RenderScene, settings: &Settings) -> Result<()> {
        if self.key != key(scene, settings) {
            return Err(Error::Merge("the film is of another scene, frame or other settings".into()));
        }
        let count = scene.camera().width * scene.camera().height;
        if settings.channels.paths && self.paths.is_empty() && count > 0 {
            return Err(Error::Merge("the film holds no indirect and no hidden light".into()));
        }
        self.complete(count, if settings.light_groups > 0 { count } else { 0 }, self.paths.len())
    }

    /// Checks the number of pixels, since a film may come from a damaged file.
    fn complete(&self, pixels: usize, groups: usize, paths: usize) -> Result<()> {
        let found = (self.pixels.len(), self.guides.len(), self.groups.len(), self.paths.len());
        if found == (pixels, pixels, groups, paths) && (paths == 0 || paths == pixels) && self.light.is_of(pixels, groups) {
            return Ok(());
        }
        Err(Error::Merge(format!("a film holds {} pixels in place of {pixels}", self.pixels.len())))
    }

    /// The pictures of the samples.
    pub(crate) fn beauty(&self, settings: &Settings) -> Beauty {
        let image = |pixels: Vec<[f32; 3]>| Image { width: self.width, height: self.height, pixels };
        let whole = 0..self.pixels.len();
        let variance = settings.channels.variance.then(|| {
            let most = DVec3::splat(f32::MAX.into());
            image(whole.into_par_iter().map(|at| self.variance_of_mean(at).min(most).as_vec3().to_array()).collect())
        });
        let mut groups: [Option<Rgb>; LIGHT_GROUPS] = Default::default();
        for (group, light) in groups.iter_mut().enumerate().take(settings.light_groups as usize) {
            let paths = |at: usize| self.light.groups.get(at).map_or(DVec3::ZERO, |g| g.sum_over(group, self.light.samples));
            let pixel = |(at, g): (usize, &GroupStatistics)| (g.mean(group) + paths(at)).as_vec3().to_array();
            *light = Some(image(self.groups.par_iter().enumerate().map(pixel).collect()));
        }
        let paths = settings.channels.paths.then(|| {
            let positive = |rgb: [f32; 3]| rgb.map(|v| v.max(0.0));
            let indirect = |(at, sums): (usize, &PathStatistics)| {
                let of_light = self.of_light(at).as_vec3().to_array();
                let own = sums.indirect();
                positive([0, 1, 2].map(|c| own[c] + of_light[c]))
            };
            let indirect = self.paths.par_iter().enumerate().map(indirect).collect();
            [image(indirect), image(self.paths.par_iter().map(|sums| positive(sums.hidden())).collect())]
        });
        Beauty {
            paths,
            raw: self.mean(),
            variance,
            samples: self.map.as_ref().map(|_| Image { width: self.width, height: self.height, pixels: self.counts() }),
            groups,
            spp: self.samples(),
            light_paths: self.has_light_paths(),
        }
    }

    /// Frees the memory of everything except the guides.
    pub(crate) fn keep_guides_alone(&mut self) {
        (self.pixels, self.groups, self.paths, self.light) = Default::default();
    }

    /// Mean radiance of the samples so far; 0 without samples.
    pub fn mean(&self) -> Image<[f32; 3]> {
        let pixels = (0..self.pixels.len()).into_par_iter().map(|at| self.mean_of(at).as_vec3().to_array()).collect();
        Image { width: self.width, height: self.height, pixels }
    }

    /// Whether light paths were traced.
    pub(crate) fn has_light_paths(&self) -> bool {
        self.light.samples > 0
    }

    /// Mean radiance of a pixel.
    pub(crate) fn mean_of(&self, at: usize) -> DVec3 {
        self.pixels[at].mean_f64() + self.of_light(at)
    }

    /// The part of it that light paths brought.
    fn of_light(&self, at: usize) -> DVec3 {
        self.light.pixels.get(at).map_or(DVec3::ZERO, |light| light.mean(self.light.samples))
    }

    /// Variance of [`Self::mean_of`].
    pub(crate) fn variance_of_mean(&self, at: usize) -> DVec3 {
        let light = self.light.pixels.get(at).map_or(DVec3::ZERO, |light| light.variance_of_mean(self.light.samples));
        self.pixels[at].variance_of_mean_f64() + light
    }

    /// Number of samples per pixel so far; the mean where pixels have different counts.
    pub fn samples(&self) -> u32 {
        if self.map.is_some() {
            let sum: u64 = self.pixels.iter().map(|pixel| pixel.count() * u64::from(self.branches)).sum();
            let count = self.pixels.len().max(1) as u64;
            return u32::try_from((sum + count / 2) / count).unwrap_or(u32::MAX);
        }
        self.ranges.iter().map(|r| r.end - r.start).sum()
    }

    /// Number of samples of each pixel so far, row by row.
    pub fn counts(&self) -> Vec<u32> {
        let count = |pixel: &PixelStatistics| pixel.count().saturating_mul(self.branches.into());
        self.pixels.iter().map(|pixel| u32::try_from(count(pixel)).unwrap_or(u32::MAX)).collect()
    }

    /// Ranges of the sample numbers in the film.
    pub fn ranges(&self) -> &[Range<u32>] {
        &self.ranges
    }

    /// Adds the samples of `other`. Sums are exact to about sixteen digits, so that any division into parts gives the picture of
    /// one film.
    ///
    /// # Errors
    /// When `other` has another scene, frame or settings, or shares samples with this film. Then nothing is added.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        if self.key != other.key {
            return Err(Error::Merge("the other film is of another scene, frame or other settings".into()));
        }
        if self.map != other.map {
            return Err(Error::Merge("the other film is of another sample map".into()));
        }
        if self.paths.is_empty() != other.paths.is_empty() {
            return Err(Error::Merge("only one of the films holds indirect and hidden light".into()));
        }
        other.complete(self.pixels.len(), self.groups.len(), self.paths.len())?;
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
        self.paths.iter_mut().zip(&other.paths).for_each(|(a, b)| a.merge(b));
        self.light.merge(&other.light);
        Ok(())
    }
}

impl LightPathSums {
    /// Makes room for the light paths of `samples` more samples per pixel. The film has `pixels` pixels and `groups` sums of
    /// light groups.
    fn begin(&mut self, samples: u32, pixels: usize, groups: usize) {
        if self.samples == 0 {
            (self.pixels, self.groups) = (zeroed_vec(pixels), zeroed_vec(groups));
        }
        self.samples += samples;
    }

    /// Adds what one light path brings to pixel `at`, and to its light group where there are groups.
    pub fn push(&mut self, at: usize, radiance: Vec3A, group: Option<usize>) {
        self.pixels[at].push(radiance);
        if let Some((sums, group)) = self.groups.get_mut(at).zip(group) {
            sums.push_to(group, radiance);
        }
    }

    /// Whether the number of pixels is right, or 0 without light paths.
    fn is_of(&self, pixels: usize, groups: usize) -> bool {
        let found = (self.pixels.len(), self.groups.len());
        found == if self.samples == 0 { (0, 0) } else { (pixels, groups) }
    }

    fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        if other.pixels.is_empty() {
            return;
        }
        if self.pixels.is_empty() {
            (self.pixels, self.groups) = (other.pixels.clone(), other.groups.clone());
        } else {
            self.pixels.iter_mut().zip(&other.pixels).for_each(|(a, b)| a.merge(b));
            self.groups.iter_mut().zip(&other.groups).for_each(|(a, b)| a.merge(b));
        }
    }
}
