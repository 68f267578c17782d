//! Path tracing on one sequence: traces only the channels that a row needs, carries the samples of neighbouring frames, denoises,
//! and measures the seconds.

use super::Buffer;
use super::Options;
use super::fused::Fused;
use crate::dataset::Sequence;
use crate::dataset::around::{Carried, Neighbours, REACH, Traced, add_up, paths, surface};
use crate::dataset::shading::{OWN_BUFFER, TRACED};
use crate::evaluate::method::Method;
use crate::evaluate::method::tracing::{Clean, Guides, Samples, Tracing};
use crate::evaluate::results::BUDGET_PIXELS;
use crate::metrics::median;
use crate::util::cancel::Cancel;
use crate::util::clock::timed;
use anyhow::{Context, Result};

use renderflow_frame::image::Rgb;

use renderflow_frame::Frame;
use renderflow_renderer::denoise::{self, Denoiser, Quality};
use renderflow_renderer::{Budget, Channels, RenderScene, Settings, detail_map, render, render_gbuffer, render_mapped};
use std::collections::BTreeMap;

/// Two renders with these numbers of samples for each pixel give the time of any number.
const PROBES: [u32; 2] = [2, 16];
/// From this number of camera rays for each pixel on, neighbours included, OIDN is told that the guides are clean. It then keeps
/// the noise that they have.
const CLEAN_GUIDES: u32 = 4;
/// Seconds are turned into at most this many samples for each pixel.
const MOST: u32 = 65536;

/// The channels that are needed besides the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Needs {
    /// Guides of the samples' own camera rays.
    guides: bool,
    /// What the samples are made of, if the network reads it.
    paths: bool,
    /// The surfaces that the pixels' centres see.
    surfaces: bool,
    /// Samples under [`Budget::Detail`].
    adaptive: bool,
    /// Whether the row pays for a G-buffer of its own, which also says how the samples are spread.
    paid: bool,
}

impl Needs {
    /// Of a picture of `spp` samples for each pixel.
    fn of(tracing: &Tracing, spp: u32) -> Self {
        let adaptive = tracing.adaptive;
        // The network divides samples by the albedo that they saw. Spread samples also make its G-buffer, if they are not too
        // few.
        if tracing.clean.is_neural() {
            let surfaces = adaptive && spp >= OWN_BUFFER && tracing.neighbours == Neighbours::Alone;
            return Self { guides: true, paths: true, surfaces, adaptive, paid: adaptive && !surfaces };
        }
        // A G-buffer holds both.
        let own = tracing.guides == Guides::Own;
        Self {
            guides: own && tracing.clean != Clean::Raw,
            paths: false,
            surfaces: own && tracing.neighbours != Neighbours::Alone,
            adaptive,
            paid: adaptive && !own,
        }
    }
}

/// Stored index, needs, and samples for each pixel of a frame.
type Key = (usize, Needs, u32);
/// How a picture is denoised, and whether OIDN is told that the guides are clean.
type Effort = (Clean, bool);

/// The frame that is being made.
#[derive(Clone, Copy)]
pub struct Current<'a> {
    /// Its G-buffer.
    pub buffer: Buffer<'a>,
    /// The network that reads samples, if a method needs it.
    pub fused: Option<&'a Fused<'a>>,
    /// Asks for a stop.
    pub cancel: &'a Cancel,
}

/// Path tracing on one sequence.
pub struct Tracer<'a> {
    sequence: &'a Sequence,
    max_bounces: u32,
    /// Whether the network reads what samples are made of.
    reads_paths: bool,
    /// By effort, and by whether they are told that the guides are clean.
    denoisers: BTreeMap<(Quality, bool), Denoiser>,
    /// Seconds of path tracing with 0 samples, and of each further sample.
    rates: BTreeMap<Needs, [f64; 2]>,
    /// Seconds of each denoiser so far.
    denoised: BTreeMap<Effort, Vec<f64>>,
    /// Seconds of carrying and adding the samples of neighbours so far.
    gathered: BTreeMap<Neighbours, Vec<f64>>,
    /// Samples for each pixel of a frame, for rows with given seconds: a frame is traced once only.
    counts: BTreeMap<(String, usize), u32>,
    /// Seconds that the frames so far have left over, by row, for rows with given seconds.
    left: BTreeMap<String, f64>,
    /// By stored index, by needs, and by samples for each pixel.
    traced: BTreeMap<Key, Traced>,
    /// The surfaces that the pixels' centres see, in frames whose samples are carried.
    surfaces: BTreeMap<usize, Frame>,
}

impl<'a> Tracer<'a> {
    /// Opens the denoisers that the methods ask for.
    pub fn new(sequence: &'a Sequence, options: &Options) -> Result<Self> {
        let mut denoisers = BTreeMap::new();
        for tracing in tracings(options.methods) {
            let Some(quality) = tracing.clean.oidn() else { continue };
            for clean_guides in [true, false] {
                let effort = (quality, clean_guides);
                let noisy = tracing.guides == Guides::Own && !tracing.clean.is_neural();
                if !denoisers.contains_key(&effort) && (clean_guides || noisy) {
                    let options = denoise::Options { quality, clean_guides };
                    let denoiser = Denoiser::with_options(options).context("path tracing + OIDN is among the methods")?;
                    denoisers.insert(effort, denoiser);
                }
            }
        }
        Ok(Self {
            sequence,
            max_bounces: options.max_bounces,
            reads_paths: options.fusion.is_some_and(|network| network.header().fusion.paths),
            denoisers,
            rates: BTreeMap::new(),
            denoised: BTreeMap::new(),
            gathered: BTreeMap::new(),
            counts: BTreeMap::new(),
            left: BTreeMap::new(),
            traced: BTreeMap::new(),
            surfaces: BTreeMap::new(),
        })
    }

    /// Does what only the first frame would need: fills caches, builds the denoisers' networks, and measures how the time of path
    /// tracing grows with the samples.
    pub fn warm_up(&mut self, scene: &mut RenderScene, methods: &[Method], current: Current) -> Result<()> {
        let buffer = current.buffer;
        for needs in tracings(methods).flat_map(|tracing| [1, OWN_BUFFER].map(|spp| Needs::of(tracing, spp))) {
            if self.rates.contains_key(&needs) {
                continue;
            }
            let mut seconds = [f64::INFINITY; 2];
            // The first round fills the caches. The faster one counts, since other processes may delay either.
            for _ in 0..2 {
                for (seconds, spp) in seconds.iter_mut().zip(PROBES) {
                    *seconds = seconds.min(self.trace(scene, (buffer.index, needs, spp), current)?.seconds);
                }
            }
            // Samples are not free, even if another process delayed the first render.
            let least = (seconds[1] / f64::from(8 * PROBES[1])).max(1e-6);
            let each = ((seconds[1] - seconds[0]) / f64::from(PROBES[1] - PROBES[0])).max(least);
            self.rates.insert(needs, [(seconds[0] - f64::from(PROBES[0]) * each).max(0.0), each]);
        }
        for tracing in tracings(methods) {
            let frames = 1 + tracing.others(buffer.index, self.sequence.len()).len();
            for spp in [1, CLEAN_GUIDES] {
                let effort = effort(tracing, frames as u32 * camera_rays(spp));
                let known = self.denoised.contains_key(&effort) || tracing.clean == Clean::Raw;
                if known && (tracing.neighbours == Neighbours::Alone || self.gathered.contains_key(&tracing.neighbours)) {
                    continue;
                }
                // A keyframe is given, so with keyframes the network might not run.
                let probe = Tracing { samples: Samples::Count(spp), keyframes: false, ..tracing.clone() };
                // The first run of a denoiser builds its network.
                for _ in 0..2 {
                    self.denoised.remove(&effort);
                    self.gathered.remove(&tracing.neighbours);
                    self.picture(scene, &probe, None, current)?;
                }
            }
        }
        self.traced.clear();
        Ok(())
    }

    /// The picture that `tracing` makes of the current frame, its seconds, and its samples for each pixel. `given` are the
    /// seconds of the other method, if `tracing` may take its time. `scene` stays at that frame.
    pub fn picture(
        &mut self,
        scene: &mut RenderScene,
        tracing: &Tracing,
        given: Option<f64>,
        current: Current,
    ) -> Result<(Rgb, f64, u32)> {
        let made = self.make(scene, tracing, given, current)?;
        if let Some(budget) = self.budget(tracing, current.buffer.index, given) {
            let left = self.left.entry(Method::Traced(tracing.clone()).id()).or_default();
            *left = carry_over(*left, budget, made.1);
        }
        Ok(made)
    }

    /// [`Self::picture`], without the account of what the frame leaves.
    fn make(
        &mut self,
        scene: &mut RenderScene,
        tracing: &Tracing,
        given: Option<f64>,
        current: Current,
    ) -> Result<(Rgb, f64, u32)> {
        let Current { buffer, fused, .. } = current;
        let others = tracing.others(buffer.index, self.sequence.len());
        let frames: Vec<usize> = std::iter::once(buffer.index).chain(others).collect();
        let mut keys = Vec::with_capacity(frames.len());
        let id = Method::Traced(tracing.clone()).id();
        // Frames that are traced now share what is left.
        let fresh = frames.iter().filter(|&&index| !self.counts.contains_key(&(id.clone(), index))).count();
        let more = self.left.get(&id).copied().unwrap_or(0.0) / fresh.max(1) as f64;
        for &index in &frames {
            let spp = match (&tracing.samples, self.budget(tracing, index, given)) {
                (Samples::Count(spp), _) => *spp,
                (_, budget) => {
                    let spp = self.samples_within(tracing, index, budget.unwrap_or(0.0) + more, buffer);
                    *self.counts.entry((id.clone(), index)).or_insert(spp)
                }
            };
            let needs = Needs::of(tracing, spp);
            let key = (index, needs, spp);
            if !self.traced.contains_key(&key) {
                let traced = self.trace(scene, key, current)?;
                self.learn(needs, &traced);
                self.traced.insert(key, traced);
            }
            if let Some(traced) = self.traced.get_mut(&key).filter(|_| tracing.neighbours != Neighbours::Alone) {
                traced.carry(self.sequence.exposure())?;
            }
            keys.push(key);
        }
        if tracing.neighbours != Neighbours::Alone {
            self.see(scene, buffer, &frames)?;
        }
        scene.set_frame(self.sequence.numbers[buffer.index]);
        if tracing.clean.is_neural() {
            let network = fused.context("the methods need weights of the network that reads samples (--weights)")?;
            // Taken out while samples are borrowed.
            let key = tracing.clean.oidn().map(|quality| (quality, true));
            let mut denoiser = key.and_then(|key| self.denoisers.remove(&key));
            let own = &self.traced[&keys[0]];
            let (others, gathering) = timed(|| Ok(self.carried(&keys)))?;
            let mut buffer = buffer;
            if let Some(frame) = &own.gbuffer {
                buffer = Buffer { frame, seconds: 0.0, ..buffer };
            }
            let drawn = network.traced(buffer, own, (&frames[1..], &others), tracing.keyframes, denoiser.as_mut());
            let (seconds, spp) = (own.seconds + own.preparing(), own.spp);
            self.denoisers.extend(key.zip(denoiser));
            let (picture, drawing) = drawn?;
            // A keyframe is given, so it says nothing about other frames.
            if !(tracing.keyframes && self.sequence.transforms.keyframes.contains(&buffer.index)) {
                self.denoised.entry((tracing.clean, true)).or_default().push(gathering + drawing);
            }
            return Ok((picture, seconds + buffer.seconds + gathering + drawing, spp));
        }
        let own = &self.traced[&keys[0]];
        let mut seconds = own.seconds + own.preparing();
        let carried;
        let (raw, guides) = if frames.len() > 1 {
            let (gathered, gathering) = timed(|| Ok(self.gather(&keys)))?;
            self.gathered.entry(tracing.neighbours).or_default().push(gathering);
            seconds += gathering;
            carried = gathered;
            (&carried.0, carried.1.as_ref())
        } else {
            (&own.raw, own.guides.as_ref())
        };
        let spp = own.spp;
        let effort = effort(tracing, keys.iter().map(|key| camera_rays(key.2)).sum());
        let denoiser = tracing.clean.oidn().and_then(|quality| self.denoisers.get_mut(&(quality, effort.1)));
        let Some(denoiser) = denoiser else { return Ok((raw.clone(), seconds, spp)) };
        let [albedo, normal] = match (tracing.guides, guides) {
            (Guides::Own, Some([albedo, normal])) => [Some(albedo), Some(normal)],
            _ => {
                seconds += buffer.seconds;
                [buffer.frame.guide_albedo.as_ref(), buffer.frame.guide_normal.as_ref()]
            }
        };
        let (picture, denoising) = timed(|| Ok(denoiser.denoise(raw, albedo, normal)?))?;
        self.denoised.entry(effort).or_default().push(denoising);
        Ok((picture, seconds + denoising, spp))
    }

    /// Forgets what frame `index` and later frames cannot use.
    pub fn forget_before(&mut self, index: usize) {
        let near = |other: usize| other + REACH >= index;
        self.traced.retain(|(other, ..), traced| near(*other) && traced.carried.is_some());
        self.surfaces.retain(|other, _| near(*other));
        self.counts.retain(|(_, other), _| near(*other));
    }

    /// Path-traces a frame with the channels that are needed. `current` is the frame that is being made.
    fn trace(&mut self, scene: &mut RenderScene, (index, needs, spp): Key, current: Current) -> Result<Traced> {
        let cancel = current.cancel;
        let channels = if needs.paths && self.reads_paths { TRACED } else { Channels::BEAUTY };
        let channels = Channels { gbuffer: needs.surfaces, guides: needs.guides, ..channels };
        let budget = if needs.adaptive { Budget::Detail } else { Budget::Uniform };
        let settings = Settings { spp, max_bounces: self.max_bounces, channels, budget, ..Settings::default() };
        scene.set_frame(self.sequence.numbers[index]);
        // A row that pays for the G-buffer of a frame does so where it makes that frame.
        let other = if needs.paid && index != current.buffer.index {
            let channels = Channels { gbuffer: true, ..Channels::BEAUTY };
            Some(render_gbuffer(scene, &Settings { guide_samples: 1, channels, ..Settings::default() })?)
        } else {
            None
        };
        let rendered = timed(|| {
            Ok(if needs.paid {
                let map = detail_map(other.as_ref().unwrap_or(current.buffer.frame), spp)?;
                render_mapped(scene, &settings, &map, &|_, _| (), cancel)?.0
            } else {
                render(scene, &settings, &|_, _| (), cancel)?
            })
        });
        cancel.check()?;
        let (mut frame, seconds) = rendered?;
        let raw = frame.raw.take().context("the path tracer made no picture")?;
        let alpha = std::mem::take(&mut frame.alpha);
        let paths = paths(&mut frame);
        // The network reads it.
        let own = needs.adaptive && needs.surfaces && needs.guides;
        let (samples, gbuffer) = (frame.samples.take(), own.then(|| Box::new(Frame { alpha: alpha.clone(), ..frame.clone() })));
        let guides = frame.guide_albedo.take().zip(frame.guide_normal.take()).map(|(albedo, normal)| [albedo, normal]);
        if needs.surfaces {
            self.surfaces.entry(index).or_insert_with(|| surface(&frame));
        }
        let guides = guides.filter(|_| needs.guides);
        Ok(Traced { raw, alpha, guides, spp, counts: samples, paths, gbuffer, seconds, carried: None })
    }

    /// Finds the surfaces that the pixels' centres see in `frames`. Where samples did not record them, a G-buffer is made,
    /// outside of the row's seconds.
    fn see(&mut self, scene: &mut RenderScene, buffer: Buffer, frames: &[usize]) -> Result<()> {
        let channels = Channels { gbuffer: true, ..Channels::BEAUTY };
        for &index in frames {
            if self.surfaces.contains_key(&index) {
                continue;
            }
            let seen = if index == buffer.index {
                surface(buffer.frame)
            } else {
                scene.set_frame(self.sequence.numbers[index]);
                let frame = render_gbuffer(scene, &Settings { guide_samples: 1, channels, ..Settings::default() })?;
                surface(&frame)
            };
            self.surfaces.insert(index, seen);
        }
        Ok(())
    }

    /// The samples of the first frame together with those of the others, weighted by their numbers; likewise the guides.
    fn gather(&self, keys: &[Key]) -> (Rgb, Option<[Rgb; 2]>) {
        add_up(&self.traced[&keys[0]], &self.carried(keys), &self.surfaces[&keys[0].0].object_id)
    }

    /// The samples of all but the first frame, ready to be carried to it.
    fn carried(&self, keys: &[Key]) -> Vec<Carried<'_>> {
        if keys.len() < 2 {
            return Vec::new();
        }
        let index = keys[0].0;
        let current = &self.surfaces[&index];
        let own = &self.traced[&keys[0]];
        let others = keys[1..].iter().map(|key| {
            let movement = self.sequence.transforms.tracks.between(index, key.0);
            Carried::new((current, own), (&self.surfaces[&key.0], &self.traced[key]), movement, key.0.abs_diff(index))
        });
        others.collect()
    }

    /// The seconds that a row may take for frame `index`; `None` if its number of samples is given.
    fn budget(&self, tracing: &Tracing, index: usize, given: Option<f64>) -> Option<f64> {
        let size = self.sequence.camera(index);
        match tracing.samples {
            Samples::Count(_) => None,
            Samples::Within(milliseconds) => {
                Some(f64::from(milliseconds) / 1e3 * (size.width * size.height) as f64 / BUDGET_PIXELS)
            }
            Samples::AsLongAs(_) => Some(given.unwrap_or(0.0)),
        }
    }

    /// The samples for each pixel of frame `index` that `budget` seconds allow.
    fn samples_within(&self, tracing: &Tracing, index: usize, budget: f64, buffer: Buffer) -> u32 {
        let many = self.samples_with(Needs::of(tracing, OWN_BUFFER), tracing, index, budget, buffer);
        let few = Needs::of(tracing, 1);
        if many >= OWN_BUFFER || few == Needs::of(tracing, OWN_BUFFER) {
            return many;
        }
        self.samples_with(few, tracing, index, budget, buffer).min(OWN_BUFFER - 1)
    }

    /// The same, with these needs.
    fn samples_with(&self, needs: Needs, tracing: &Tracing, index: usize, budget: f64, buffer: Buffer) -> u32 {
        let Some(&rate) = self.rates.get(&needs) else { return 1 };
        let usual = |seconds: Option<&Vec<f64>>| seconds.map(|seconds| median(seconds)).filter(|s| s.is_finite());
        // The network's seconds include those of gathering.
        let gathered = self.gathered.get(&tracing.neighbours).filter(|_| !tracing.clean.is_neural());
        let mut others = usual(gathered).unwrap_or(0.0);
        if tracing.guides == Guides::GBuffer || (tracing.clean.is_neural() && !needs.surfaces) {
            others += buffer.seconds;
        }
        let frames = 1 + tracing.others(index, self.sequence.len()).len() as u32;
        let clean = |spp: u32| effort(tracing, frames * camera_rays(spp)).1;
        let after = |clean: bool| usual(self.denoised.get(&(tracing.clean, clean))).unwrap_or(0.0) + others;
        let mut spp = affordable(budget - after(true), rate);
        if !clean(spp) {
            // Guides that are not clean are denoised faster; that alone must not raise the number of samples until the guides
            // count as clean.
            spp = affordable(budget - after(false), rate);
            while spp > 1 && clean(spp) {
                spp -= 1;
            }
        }
        spp
    }

    /// Updates the rates after a render, since the cost of scenes changes from frame to frame.
    fn learn(&mut self, needs: Needs, traced: &Traced) {
        let Some([start, each]) = self.rates.get_mut(&needs) else { return };
        let expected = *start + *each * f64::from(traced.spp);
        let factor = (traced.seconds / expected.max(1e-9)).clamp(0.5, 2.0).sqrt();
        (*start, *each) = (*start * factor, (*each * factor).max(1e-6));
    }
}

/// Camera rays of a picture with this many samples for each pixel.
fn camera_rays(spp: u32) -> u32 {
    Settings { spp, ..Settings::default() }.camera_samples()
}

/// How to denoise a picture whose guides have this many camera rays for each pixel.
fn effort(tracing: &Tracing, rays: u32) -> Effort {
    (tracing.clean, tracing.guides == Guides::GBuffer || tracing.clean.is_neural() || rays >= CLEAN_GUIDES)
}

/// The path-traced methods among `methods`.
pub fn tracings(methods: &[Method]) -> impl Iterator<Item = &Tracing> {
    methods.iter().filter_map(|method| if let Method::Traced(tracing) = method { Some(tracing) } else { None })
}

/// The samples for each pixel that `seconds` allow, if a render takes `start` seconds and `each` more for every sample; at least
/// 1.
fn affordable(seconds: f64, [start, each]: [f64; 2]) -> u32 {
    ((seconds - start) / each).floor().clamp(1.0, f64::from(MOST)) as u32
}

/// What frames leave over, or have taken too much (below 0), after one more that was given `budget` and took `seconds`. One frame
/// gets or pays at most half as much again as it has.
fn carry_over(left: f64, budget: f64, seconds: f64) -> f64 {
    (left + budget - seconds).clamp(-0.5 * budget, 0.5 * budget)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_the_time() {
        assert_eq!(affordable(1.1, [0.1, 0.01]), 100);
        assert_eq!(affordable(0.5, [0.1, 0.1]), 4);
        // At least one sample, even where there is no time for it.
        assert_eq!([affordable(0.05, [0.1, 0.1]), affordable(-1.0, [0.0, 0.1])], [1, 1]);
        assert_eq!(affordable(1e9, [0.0, 1e-6]), MOST);
    }

    #[test]
    fn frames_pay_for_those_before() {
        // A frame takes 30 % more than expected, and a sample takes a quarter of the time that is given.
        let (budget, mut left, mut total) = (1.0, 0.0, 0.0);
        for _ in 0..40 {
            let seconds = 1.3 * 0.25 * f64::from(affordable(budget + left, [0.0, 0.25]));
            left = carry_over(left, budget, seconds);
            total += seconds;
        }
        assert!((total / 40.0 - budget).abs() < 0.02, "{total}");
        // One slow frame is not paid for by all that follow.
        assert_eq!([carry_over(0.0, 1.0, 9.0), carry_over(0.3, 1.0, 0.1)], [-0.5, 0.5]);
    }

    #[test]
    fn rows_ask_for_what_they_read() {
        let needs = |id: &str| {
            let Method::Traced(tracing) = Method::parse(id).unwrap() else { unreachable!() };
            let Samples::Count(spp) = tracing.samples else { unreachable!() };
            let Needs { guides, surfaces, paid, paths, .. } = Needs::of(&tracing, spp);
            assert!(tracing.adaptive || !paid);
            assert_eq!(paths, id.contains("neural"));
            [guides, surfaces]
        };
        assert_eq!(needs("pt4"), [false, false]);
        assert_eq!(needs("pt4+oidn"), [true, false]);
        assert_eq!(needs("pt4+oidn+around"), [true, true]);
        // A G-buffer has both.
        assert_eq!([needs("pt4+oidn+gbuffer"), needs("pt4+oidn+gbuffer+before")], [[false; 2]; 2]);
        // Eight spread samples have guides that are good enough, and four do not.
        assert_eq!([needs("pt4+adaptive+neural"), needs("pt8+neural")], [[true, false]; 2]);
        assert_eq!([needs("pt8+adaptive+oidn+neural"), needs("pt8+adaptive+neural+around")], [[true; 2], [true, false]]);
    }
}
