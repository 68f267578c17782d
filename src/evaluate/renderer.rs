//! Makes the pictures of one sequence by every method, one after the other, each with its seconds.

use super::baseline::{DeferredBaseline, Maps};
use super::fused::Fused;
use super::keyframes;
use super::method::{Method, Part};
use super::sessions::NetworkSessions;
use super::traced::{Buffer, Tracer};
use super::tracing::Samples;
use crate::dataset::{SequenceFolder, SequenceView};
use crate::truth::Interrupted;
use anyhow::{Context, Result};
use renderflow_frame::Frame;
use renderflow_frame::ibl;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_frame::warp::Keyframe;
use renderflow_model::fusion::Fusion;
use renderflow_model::renderer::Renderer;
use renderflow_renderer::{RenderScene, Settings, render_gbuffer};
use renderflow_scenes::{description::Scene, load};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Added to the seed of a sequence: path-traced rows must not have the truth's own samples in them.
const OTHER_SEED: u64 = 1;

/// What is done once for a keyframe.
const PREPARING: &str = "preparing keyframes";

/// The methods that pictures are made by, and what they need.
pub struct Options<'a> {
    /// Methods, those whose time another one is given before it.
    pub methods: &'a [Method],
    /// The network that reads samples, where a method needs it.
    pub fusion: Option<&'a Fusion>,
    /// The paper's network, where a method needs it.
    pub wan: Option<&'a dyn Renderer>,
    /// Camera rays a pixel for the anti-aliased G-buffer.
    pub guide_samples: u32,
    /// Scattering events of path-traced rows.
    pub max_bounces: u32,
    /// Folders beside a sequence's own that its scene may name files of.
    pub allowed: &'a [PathBuf],
    /// Whether seconds count: the first frame is made twice then, so that it pays for nothing but itself.
    pub timed: bool,
}

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
pub struct MethodRenderer<'a> {
    folder: &'a SequenceFolder,
    options: &'a Options<'a>,
    scene: RenderScene,
    /// Where a method starts from the deferred picture.
    baseline: Option<DeferredBaseline<'a>>,
    /// Where keyframes are carried into the split sum.
    keyframes: Vec<(usize, Keyframe)>,
    sessions: NetworkSessions<'a>,
    tracer: Tracer<'a>,
    /// Where a method needs the network that reads samples.
    fused: Option<Fused<'a>>,
    /// Whether the first frame pays for nothing but itself.
    warm: bool,
    once: Vec<(String, f64)>,
}

/// The result of `work` and its wall seconds.
pub(super) fn timed<T>(work: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let started = Instant::now();
    let value = work()?;
    Ok((value, started.elapsed().as_secs_f64()))
}

impl<'a> MethodRenderer<'a> {
    /// Loads the scene and does what is done once a sequence.
    pub fn new(view: &'a SequenceView<'a>, options: &'a Options<'a>) -> Result<Self> {
        let folder = view.folder;
        let file = folder.path.join("scene.json");
        let scene = Scene::read(&file)?;
        let loaded = load::load(&scene, &Reach::of(&file).allow(options.allowed)).with_context(|| file.display().to_string())?;
        let mut scene = RenderScene::compile(&loaded)?.with_seed(loaded.seed.wrapping_add(OTHER_SEED));
        let (_, prefilter) = timed(|| Ok(folder.light.tables()))?;
        let mut once = vec![("prefiltering the environment".to_owned(), prefilter)];
        let methods = options.methods;
        let mut baseline = None;
        if methods.iter().any(Method::is_deferred) {
            let whole = methods.contains(&Method::Deferred(Some(Part::Lights)));
            let (made, seconds) = timed(|| Ok(DeferredBaseline::new(folder, whole)))?;
            once.push(("taking lights out of the environment, prefiltering the rest".to_owned(), seconds));
            let baseline = baseline.insert(made);
            if methods.iter().any(|method| matches!(method, Method::Warp { deferred: true } | Method::Neural { keyframes: true }))
            {
                let ((), seconds) = timed(|| baseline.prepare_keyframes(&mut scene))?;
                once.push(("drawing keyframes by deferred shading".to_owned(), seconds));
            }
        }
        let mut keyframes = Vec::new();
        if methods.contains(&Method::Warp { deferred: false }) {
            let (prepared, seconds) = timed(|| {
                let draw = |_, frame: &Frame| Ok(Some(ibl::shade(frame, &folder.light).image));
                keyframes::prepare(folder, draw)
            })?;
            keyframes = prepared;
            once.push((PREPARING.to_owned(), seconds));
        }
        let (sessions, beginning) = timed(|| NetworkSessions::new(view, options))?;
        if sessions.read_depths() {
            once.push(("reading the range of depths".to_owned(), beginning));
        }
        let tracer = Tracer::new(folder, options)?;
        let mut fused = None;
        if methods.iter().any(Method::is_neural) {
            let network = options.fusion.context("the methods need weights of the network that reads samples")?;
            let fused = fused.insert(Fused::new(folder, network));
            if methods.iter().any(|method| method.is_neural() && method.needs_keyframes()) {
                fused.prepare_keyframes(|index| baseline.as_ref().and_then(|baseline| baseline.keyframe(index)).cloned())?;
            }
        }
        Ok(Self { fused, folder, options, scene, baseline, keyframes, sessions, tracer, warm: !options.timed, once })
    }

    /// Seconds spent once a sequence, by what they were spent on.
    pub fn once(mut self) -> Vec<(String, f64)> {
        // Keyframes are made ready when they come near.
        match self.once.iter_mut().find(|(what, _)| what == PREPARING) {
            Some((_, seconds)) => *seconds += self.sessions.preparing,
            None if self.sessions.preparing > 0.0 => self.once.push((PREPARING.to_owned(), self.sessions.preparing)),
            None => {}
        }
        self.once
    }

    /// The picture of stored frame `index` by every method.
    pub fn render(&mut self, index: usize, cancel: &AtomicBool) -> Result<Vec<Picture>> {
        let settings = Settings { guide_samples: self.options.guide_samples, ..Settings::default() };
        self.scene.set_frame(self.folder.numbers[index]);
        if !self.warm {
            self.warm_up(&settings, index, cancel)?;
            self.warm = true;
        }
        // Clips take in frames that are not painted yet, or never.
        while let Some(next) = self.sessions.wanted(index) {
            self.scene.set_frame(self.folder.numbers[next]);
            let frame = render_gbuffer(&self.scene, &settings)?;
            self.sessions.push(next, &frame)?;
            if cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
        }
        self.scene.set_frame(self.folder.numbers[index]);
        let shared = self.share(&settings, index)?;
        self.tracer.forget_before(index);
        let mut made: Vec<Picture> = Vec::new();
        for method in self.options.methods {
            let (linear, seconds, spp) = match method {
                Method::Traced(tracing) => {
                    if tracing.keyframes && self.folder.sequence.keyframes.is_empty() {
                        continue;
                    }
                    let given = match &tracing.samples {
                        Samples::AsLongAs(to) => made.iter().find(|made| made.id == *to).map(|made| made.seconds),
                        _ => None,
                    };
                    if matches!(tracing.samples, Samples::AsLongAs(_)) && given.is_none() {
                        continue;
                    }
                    let (picture, seconds, spp) =
                        self.tracer.picture(&mut self.scene, tracing, given, shared.buffer(), self.fused.as_ref(), cancel)?;
                    (picture, seconds, Some(spp))
                }
                method => {
                    let made = match method {
                        Method::Wan { .. } => self.sessions.picture(method, shared.index, &shared.gbuffer)?,
                        method => self.shade(method, &shared)?,
                    };
                    let Some((picture, seconds)) = made else { continue };
                    (picture, shared.seconds + seconds, None)
                }
            };
            made.push(Picture { id: method.id(), linear, seconds, spp });
        }
        Ok(made)
    }

    /// The picture of a method that starts from the G-buffer, and its seconds without that; `None` where it cannot be made.
    fn shade(&self, method: &Method, shared: &Shared) -> Result<Option<(Rgb, f64)>> {
        let (folder, gbuffer) = (self.folder, &shared.gbuffer);
        if method.needs_keyframes() && folder.sequence.keyframes.is_empty() {
            return Ok(None);
        }
        let made = match method {
            Method::Deferred(without) => {
                let baseline = self.baseline.as_ref().context("the deferred renderer")?;
                baseline.picture(&self.scene, gbuffer, &shared.maps, *without)?
            }
            Method::Warp { deferred: true } => {
                let baseline = self.baseline.as_ref().context("the deferred renderer")?;
                baseline.warped(&self.scene, gbuffer, shared.index, &shared.maps)?
            }
            Method::Neural { keyframes } => {
                let baseline = self.baseline.as_ref().context("the deferred renderer")?;
                let fused = self.fused.as_ref().context("the network")?;
                let (parts, shading) = baseline.parts(gbuffer, &shared.maps)?;
                let (picture, drawing) = fused.shaded(shared.buffer(), &parts, *keyframes)?;
                (picture, shading + drawing)
            }
            Method::Ibl => timed(|| Ok(ibl::shade(gbuffer, &folder.light).image))?,
            Method::Warp { deferred: false } => timed(|| {
                let current = ibl::shade(gbuffer, &folder.light).image;
                Ok(keyframes::warp(folder, &self.keyframes, shared.index, gbuffer, &current))
            })?,
            _ => return Ok(None),
        };
        Ok(Some(made))
    }

    /// What all methods start from.
    fn share(&self, settings: &Settings, index: usize) -> Result<Shared> {
        let (gbuffer, seconds) = timed(|| Ok(render_gbuffer(&self.scene, settings)?))?;
        let maps = self.baseline.as_ref().map(|baseline| baseline.maps(&self.scene, &gbuffer)).transpose()?.unwrap_or_default();
        Ok(Shared { index, gbuffer, seconds, maps })
    }

    /// What the first frame would pay for all: caches, the denoisers' networks; and how path tracing's time grows with the samples.
    fn warm_up(&mut self, settings: &Settings, index: usize, cancel: &AtomicBool) -> Result<()> {
        let shared = self.share(settings, index)?;
        for method in self.options.methods {
            if method.is_wan() {
                self.sessions.warm_up(method, index, &shared.gbuffer)?;
            } else if !matches!(method, Method::Traced(_)) {
                self.shade(method, &shared)?;
            }
        }
        // The first frame pays for its own shadow maps.
        if let Some(baseline) = &mut self.baseline {
            baseline.forget();
        }
        self.tracer.warm_up(&mut self.scene, self.options.methods, shared.buffer(), self.fused.as_ref(), cancel)
    }
}

impl Shared {
    fn buffer(&self) -> Buffer<'_> {
        Buffer { index: self.index, frame: &self.gbuffer, seconds: self.seconds }
    }
}
