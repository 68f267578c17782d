//! Makes the pictures of one sequence by every method, one after the other, each with its seconds.

use super::engine::{Engine, Maps};
use super::keyframes::{keyframes_for, prepare_keyframes};
use super::method::{Clean, Part, Way};
use super::players::Players;
use super::run::{Options, median};
use crate::bench::reference::compile_seeded;
use crate::dataset::{SequenceFolder, SequenceView};
use crate::truth::Interrupted;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::ibl;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_model::infer::{PreparedKeyframe, warp_only};
use renderflow_model::renderer::Sequence;
use renderflow_renderer::denoise::{self, Denoiser, Quality};
use renderflow_renderer::{RenderScene, Settings, render, render_gbuffer};
use renderflow_scenes::{description::Scene, load};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Added to the seed of a sequence: path-traced rows must not have the truth's own samples in them.
const OTHER_SEED: u64 = 1;
/// Samples a pixel of the two renders from which the time of any number is told.
const PROBES: [u32; 2] = [2, 16];

/// What is done once for a keyframe.
const PREPARING: &str = "preparing keyframes";

/// A picture by one method.
pub struct Picture {
    /// Of the method.
    pub id: String,
    /// Scene-linear radiance.
    pub linear: Rgb,
    /// Wall seconds from the scene in memory.
    pub seconds: f64,
    /// Samples a pixel, for path tracing.
    pub spp: Option<u32>,
}

/// What all methods share of one frame.
struct Shared {
    index: usize,
    gbuffer: Frame,
    /// Seconds of the G-buffer.
    seconds: f64,
    /// None where no method needs them.
    maps: Maps,
}

/// Everything that lasts for a sequence.
pub struct Painter<'a> {
    folder: &'a SequenceFolder,
    view: &'a SequenceView<'a>,
    options: &'a Options<'a>,
    scene: RenderScene,
    /// Where a method starts from the deferred picture.
    engine: Option<Engine<'a>>,
    /// Where keyframes are carried into the split sum.
    keyframes: Vec<PreparedKeyframe>,
    players: Players<'a>,
    denoisers: BTreeMap<&'static str, Denoiser>,
    /// Seconds of path tracing with 0 samples, and of each more.
    rate: Option<[f64; 2]>,
    /// Seconds of each denoiser so far.
    denoised: BTreeMap<&'static str, Vec<f64>>,
    once: Vec<(String, f64)>,
}

/// The result of `work` and its wall seconds.
pub(super) fn timed<T>(work: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let started = Instant::now();
    let value = work()?;
    Ok((value, started.elapsed().as_secs_f64()))
}

fn name(clean: Clean) -> &'static str {
    match clean {
        Clean::Raw => "none",
        Clean::High => "OIDN",
        Clean::Fast => "OIDN fast",
    }
}

impl<'a> Painter<'a> {
    /// Loads the scene and does what is done once a sequence.
    pub fn new(view: &'a SequenceView<'a>, options: &'a Options<'a>) -> Result<Self> {
        let folder = view.folder;
        let file = folder.path.join("scene.json");
        let scene = Scene::read(&file)?;
        let loaded = load::load(&scene, &Reach::of(&file).allow(options.allowed)).with_context(|| file.display().to_string())?;
        let mut scene = compile_seeded(&loaded, loaded.seed.wrapping_add(OTHER_SEED))?;
        let (tables, prefilter) = timed(|| Ok(view.tables()))?;
        let mut once = vec![("prefiltering the environment".to_owned(), prefilter)];
        let ways = options.ways;
        let mut engine = None;
        if ways.iter().any(Way::is_deferred) {
            let whole = ways.contains(&Way::Deferred(Some(Part::Lights)));
            let (made, seconds) = timed(|| Ok(Engine::new(folder, whole)))?;
            once.push(("taking lights out of the environment, prefiltering the rest".to_owned(), seconds));
            let engine = engine.insert(made);
            if ways.contains(&Way::Warp { deferred: true }) {
                let ((), seconds) = timed(|| engine.prepare_keyframes(&mut scene))?;
                once.push(("drawing keyframes by deferred shading".to_owned(), seconds));
            }
        }
        let mut keyframes = Vec::new();
        if ways.contains(&Way::Warp { deferred: false }) {
            let (prepared, seconds) = timed(|| prepare_keyframes(folder, tables))?;
            keyframes = prepared;
            once.push((PREPARING.to_owned(), seconds));
        }
        let (players, beginning) = timed(|| Players::new(view, options))?;
        if players.read_depths() {
            once.push(("reading the range of depths".to_owned(), beginning));
        }
        let mut denoisers = BTreeMap::new();
        for clean in [Clean::High, Clean::Fast] {
            let wanted = |way: &Way| matches!(way, Way::Traced { clean: c, .. } | Way::Equal { clean: c, .. } if *c == clean);
            if ways.iter().any(wanted) {
                let quality = if clean == Clean::Fast { Quality::Fast } else { Quality::High };
                let options = denoise::Options { quality, clean_guides: true };
                let denoiser = Denoiser::with_options(options).context("path tracing + OIDN is among the methods")?;
                denoisers.insert(name(clean), denoiser);
            }
        }
        let denoised = BTreeMap::new();
        Ok(Self { folder, view, options, scene, engine, keyframes, players, denoisers, rate: None, denoised, once })
    }

    /// Seconds spent once a sequence, by what they were spent on.
    pub fn once(mut self) -> Vec<(String, f64)> {
        // Keyframes are made ready when they come near.
        match self.once.iter_mut().find(|(what, _)| what == PREPARING) {
            Some((_, seconds)) => *seconds += self.players.preparing,
            None if self.players.preparing > 0.0 => self.once.push((PREPARING.to_owned(), self.players.preparing)),
            None => {}
        }
        self.once
    }

    /// The picture of stored frame `index` by every method.
    pub fn paint(&mut self, index: usize, cancel: &AtomicBool) -> Result<Vec<Picture>> {
        let settings = Settings { guide_samples: self.options.guide_samples, ..Settings::default() };
        self.scene.set_frame(self.folder.numbers[index]);
        if self.rate.is_none() {
            self.warm_up(&settings, index, cancel)?;
        }
        // Clips take in frames that are not painted yet, or never.
        while let Some(next) = self.players.wanted(index) {
            self.scene.set_frame(self.folder.numbers[next]);
            let mut frame = render_gbuffer(&self.scene, &settings)?;
            frame.info.camera = Some(*self.folder.camera(next));
            self.players.push(next, &frame)?;
            if cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
        }
        self.scene.set_frame(self.folder.numbers[index]);
        let shared = self.share(&settings, index)?;
        let mut traced: BTreeMap<u32, (Frame, f64)> = BTreeMap::new();
        let mut made: Vec<Picture> = Vec::new();
        for way in self.options.ways {
            let (linear, seconds, spp) = match way {
                Way::Traced { spp, clean } => {
                    let (picture, seconds) = self.trace(&shared, *spp, *clean, &mut traced, cancel)?;
                    (picture, seconds, Some(*spp))
                }
                Way::Equal { to, clean } => {
                    let Some(budget) = made.iter().find(|made| made.id == *to).map(|made| made.seconds) else { continue };
                    let spp = self.affordable(budget, &shared, *clean);
                    let (picture, seconds) = self.trace(&shared, spp, *clean, &mut traced, cancel)?;
                    self.learn(spp, &traced);
                    (picture, seconds, Some(spp))
                }
                way => {
                    let made = match way.network() {
                        Some(_) => self.players.picture(way, shared.index, &shared.gbuffer)?,
                        None => self.shade(way, &shared)?,
                    };
                    let Some((picture, seconds)) = made else { continue };
                    (picture, shared.seconds + seconds, None)
                }
            };
            made.push(Picture { id: way.id(), linear, seconds, spp });
        }
        Ok(made)
    }

    /// The picture of a method that starts from the G-buffer, and its seconds without that; `None` where it cannot be made.
    fn shade(&self, way: &Way, shared: &Shared) -> Result<Option<(Rgb, f64)>> {
        let (folder, gbuffer) = (self.folder, &shared.gbuffer);
        let (camera, environment, tables) = (folder.camera(shared.index), &folder.environment, self.view.tables());
        let exposure = folder.sequence.exposure;
        let keys = keyframes_for(folder, &self.keyframes, shared.index);
        if way.needs_keyframes() && folder.sequence.keyframes.is_empty() {
            return Ok(None);
        }
        let made = match way {
            Way::Deferred(without) => {
                let engine = self.engine.as_ref().context("the deferred renderer")?;
                engine.picture(&self.scene, gbuffer, shared.index, &shared.maps, *without)?
            }
            Way::Warp { deferred: true } => {
                let engine = self.engine.as_ref().context("the deferred renderer")?;
                engine.warped(&self.scene, gbuffer, shared.index, &shared.maps)?
            }
            Way::Ibl => timed(|| Ok(ibl::shade(gbuffer, camera, environment, tables).image))?,
            Way::Warp { deferred: false } => timed(|| Ok(warp_only(gbuffer, camera, environment, tables, exposure, &keys)?))?,
            _ => return Ok(None),
        };
        Ok(Some(made))
    }

    /// What all methods start from.
    fn share(&self, settings: &Settings, index: usize) -> Result<Shared> {
        let (mut gbuffer, seconds) = timed(|| Ok(render_gbuffer(&self.scene, settings)?))?;
        gbuffer.info.camera = Some(*self.folder.camera(index));
        let maps = self.engine.as_ref().map(|engine| engine.maps(&self.scene, &gbuffer, index)).transpose()?.unwrap_or_default();
        Ok(Shared { index, gbuffer, seconds, maps })
    }

    /// Path-traces and cleans a frame. What is rendered with as many samples for another method is not rendered again.
    fn trace(
        &mut self,
        shared: &Shared,
        spp: u32,
        clean: Clean,
        traced: &mut BTreeMap<u32, (Frame, f64)>,
        cancel: &AtomicBool,
    ) -> Result<(Rgb, f64)> {
        let settings = Settings { spp, max_bounces: self.options.max_bounces, ..Settings::default() };
        let (frame, rendering) = &*match traced.entry(spp) {
            Entry::Occupied(there) => there.into_mut(),
            Entry::Vacant(place) => {
                let rendered = timed(|| Ok(render(&self.scene, &settings, &|_, _| (), cancel)?));
                if cancel.load(Ordering::Relaxed) {
                    return Err(Interrupted.into());
                }
                place.insert(rendered?)
            }
        };
        let mut seconds = *rendering;
        let raw = frame.raw.as_ref().context("the path tracer made no picture")?;
        let Some(denoiser) = self.denoisers.get_mut(name(clean)) else { return Ok((raw.clone(), seconds)) };
        // Few camera rays make noisy guides; then those of the G-buffer, which all else starts from, serve and count.
        let guides = if settings.clean_guides() { frame } else { &shared.gbuffer };
        if !settings.clean_guides() {
            seconds += shared.seconds;
        }
        let (picture, denoising) =
            timed(|| Ok(denoiser.denoise(raw, guides.guide_albedo.as_ref(), guides.guide_normal.as_ref())?))?;
        self.denoised.entry(name(clean)).or_default().push(denoising);
        Ok((picture, seconds + denoising))
    }

    /// Samples a pixel that path tracing and denoising in `budget` seconds allow; 1 at least.
    fn affordable(&self, budget: f64, shared: &Shared, clean: Clean) -> u32 {
        let Some(rate) = self.rate else { return 1 };
        let denoising = self.denoised.get(name(clean)).map_or(0.0, |seconds| median(seconds.clone()));
        // Where it takes fewer samples than make clean guides, those of the G-buffer cost their time.
        let guides = if clean == Clean::Raw { 0.0 } else { shared.seconds };
        samples(budget - denoising, rate, guides)
    }

    /// What a render took says how many samples the next one may have: scenes cost differently from frame to frame.
    fn learn(&mut self, spp: u32, traced: &BTreeMap<u32, (Frame, f64)>) {
        if let (Some([start, each]), Some((_, seconds))) = (&mut self.rate, traced.get(&spp)) {
            // Few samples tell more of what is done once a frame.
            let weight = if spp < 8 { 0.0 } else { 0.5 };
            *each += weight * ((seconds - *start).max(0.0) / f64::from(spp) - *each);
            *each = each.max(1e-6);
        }
    }

    /// What the first frame would pay for all: caches, the denoisers' networks; and how path tracing's time grows with the samples.
    fn warm_up(&mut self, settings: &Settings, index: usize, cancel: &AtomicBool) -> Result<()> {
        let shared = self.share(settings, index)?;
        for way in self.options.ways {
            if way.network().is_some() {
                self.players.warm_up(way, index, &shared.gbuffer)?;
            } else if !matches!(way, Way::Traced { .. } | Way::Equal { .. }) {
                self.shade(way, &shared)?;
            }
        }
        let mut seconds = [0.0; 2];
        // The first round warms the caches, the second counts.
        for _ in 0..2 {
            let mut traced = BTreeMap::new();
            for (seconds, spp) in seconds.iter_mut().zip(PROBES) {
                (_, *seconds) = self.trace(&shared, spp, Clean::Raw, &mut traced, cancel)?;
            }
            for clean in [Clean::High, Clean::Fast] {
                if self.denoisers.contains_key(name(clean)) {
                    self.trace(&shared, PROBES[0], clean, &mut traced, cancel)?;
                }
            }
        }
        // The first frame pays for its own shadow maps.
        if let Some(engine) = &mut self.engine {
            engine.forget();
        }
        // The first run of a denoiser builds its network.
        for seconds in self.denoised.values_mut() {
            seconds.remove(0);
        }
        let each = ((seconds[1] - seconds[0]) / f64::from(PROBES[1] - PROBES[0])).max(1e-6);
        self.rate = Some([(seconds[0] - f64::from(PROBES[0]) * each).max(0.0), each]);
        Ok(())
    }
}

/// Samples a pixel that `seconds` allow where a render takes `start` seconds and `each` more for a sample, 1 at least; `guides`
/// seconds go where the samples make no guides of their own.
fn samples(seconds: f64, [start, each]: [f64; 2], guides: f64) -> u32 {
    let count = |seconds: f64| ((seconds - start) / each).floor().clamp(1.0, 65536.0) as u32;
    let own = count(seconds);
    if (Settings { spp: own, ..Settings::default() }).clean_guides() { own } else { count(seconds - guides) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_fill_the_time() {
        // Many samples make their own guides; few pay for those of the G-buffer; one is the least.
        assert_eq!(samples(1.1, [0.1, 0.01], 0.3), 100);
        assert_eq!(samples(0.5, [0.1, 0.1], 0.1), 3);
        assert_eq!(samples(0.5, [0.1, 0.1], 0.0), 4);
        assert_eq!(samples(0.05, [0.1, 0.1], 0.1), 1);
        assert_eq!(samples(1e9, [0.0, 1e-6], 0.0), 65536);
    }
}
