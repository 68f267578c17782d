//! Makes the pictures of one sequence by every method, one method after the other, and measures their seconds.

mod baseline;
mod fused;
mod mixture;
mod sessions;
mod traced;

use super::method::tracing::Samples;
use super::method::{Method, Part};
use crate::dataset::shading::BUFFERS;
use crate::dataset::{Sequence, keyframes};
use crate::util::cancel::Cancel;
use crate::util::clock::timed;
use anyhow::{Context, Result};
use baseline::{DeferredBaseline, Maps};
use fused::Fused;
use renderflow_frame::Frame;
use renderflow_frame::ibl;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_frame::warp::Keyframe;
use renderflow_model::fusion::Fusion;
use renderflow_model::renderer::Renderer;
use renderflow_renderer::{RenderScene, Settings, render_gbuffer};
use renderflow_scenes::{description::Scene, load};
use sessions::{NetworkSessions, Shaded};
use std::path::PathBuf;
use traced::{Current, Tracer};

/// Added to the seed of a sequence, so that path-traced rows do not contain the truth's own samples.
const OTHER_SEED: u64 = 1;

/// Camera rays for each pixel of the G-buffers that methods start from.
const GUIDE_SAMPLES: u32 = 16;

/// Name of the work that is done once for each keyframe.
const PREPARING: &str = "preparing keyframes";

/// The methods to evaluate, and what they need.
pub struct Options<'a> {
    /// Methods. A method whose time another one takes comes before it.
    pub methods: &'a [Method],
    /// The network that reads samples, if a method needs it.
    pub fusion: Option<&'a Fusion>,
    /// The paper's network, if a method needs it.
    pub wan: Option<&'a dyn Renderer>,
    /// How the paper's network draws.
    pub drawing: Drawing,
    /// Camera rays for each pixel of the anti-aliased G-buffer.
    pub guide_samples: u32,
    /// How often a path may scatter in path-traced rows.
    pub max_bounces: u32,
    /// More folders in which the scene of a sequence may name files.
    pub allowed: &'a [PathBuf],
    /// Whether seconds count. Then the first frame is made twice, so that its seconds hold nothing but its own work.
    pub timed: bool,
}

impl<'a> Options<'a> {
    /// These methods as the product compares them: without networks, which the caller adds, and with seconds that count.
    pub fn new(methods: &'a [Method]) -> Self {
        let (drawing, max_bounces) = (Drawing::default(), Settings::default().max_bounces);
        Self { methods, fusion: None, wan: None, drawing, guide_samples: GUIDE_SAMPLES, max_bounces, allowed: &[], timed: true }
    }
}

impl Options<'_> {
    /// Whether the paper's network begins with deferred shading.
    fn begins_shaded(&self) -> bool {
        self.wan.is_some_and(|wan| wan.about().shaded)
    }

    /// Whether a method of the paper's network begins with keyframes carried over deferred shading.
    fn begins_carried(&self, method: &Method) -> bool {
        let keyed = matches!(method, Method::Wan { keyframes: true, .. });
        keyed && self.begins_shaded() && self.wan.is_some_and(|wan| wan.about().keyframes)
    }
}

/// How the paper's network draws a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drawing {
    /// Euler steps, at least 1. The paper's network is trained for 1.
    pub steps: u32,
    /// Seed of the noise, for weights whose bridge begins with noise.
    pub seed: u64,
}

impl Default for Drawing {
    fn default() -> Self {
        Self { steps: 1, seed: 0 }
    }
}

/// A picture by one method.
pub struct Picture {
    /// Id of the method.
    pub id: String,
    /// Scene-linear radiance.
    pub linear: Rgb,
    /// Wall seconds from the scene in memory.
    pub seconds: f64,
    /// Samples for each pixel, for path tracing.
    pub spp: Option<u32>,
}

/// The G-buffer of the current frame, and its seconds.
#[derive(Clone, Copy)]
pub struct Buffer<'a> {
    /// Stored index of the frame.
    pub index: usize,
    /// The G-buffer with its camera.
    pub frame: &'a Frame,
    /// Wall seconds of making it.
    pub seconds: f64,
}

/// What all methods of a frame share.
struct Shared {
    index: usize,
    gbuffer: Frame,
    /// Seconds of the G-buffer.
    seconds: f64,
    /// Empty where no method needs them.
    maps: Maps,
}

/// Renders the frames of one sequence by all methods.
pub struct MethodRenderer<'a> {
    sequence: &'a Sequence,
    options: &'a Options<'a>,
    scene: RenderScene,
    /// The deferred renderer, if a method needs it.
    baseline: Option<DeferredBaseline<'a>>,
    /// Keyframes for methods that carry them over the split sum, by stored index.
    keyframes: Vec<(usize, Keyframe)>,
    sessions: NetworkSessions<'a>,
    tracer: Tracer<'a>,
    /// The network that reads samples, if a method needs it.
    fused: Option<Fused<'a>>,
    /// Whether the work that only the first frame needs is done.
    warm: bool,
    once: Vec<(String, f64)>,
}

impl<'a> MethodRenderer<'a> {
    /// Loads the scene, and does everything that is done once for a sequence.
    pub fn new(sequence: &'a Sequence, options: &'a Options<'a>) -> Result<Self> {
        let light = sequence.light()?;
        let file = sequence.folder.join("scene.json");
        let scene = Scene::read(&file)?;
        let loaded = load::load(&scene, &Reach::of(&file).allow(options.allowed)).with_context(|| file.display().to_string())?;
        let mut scene = RenderScene::compile(&loaded)?.with_seed(loaded.seed.wrapping_add(OTHER_SEED));
        let (_, prefilter) = timed(|| Ok(light.tables()))?;
        let mut once = vec![("prefiltering the environment".to_owned(), prefilter)];
        let methods = options.methods;
        let mut baseline = None;
        if methods.iter().any(|method| method.is_deferred() || (method.is_wan() && options.begins_shaded())) {
            let whole = methods.contains(&Method::Deferred(Some(Part::Lights)));
            let (made, seconds) = timed(|| DeferredBaseline::new(sequence, whole))?;
            once.push(("taking lights out of the environment, prefiltering the rest".to_owned(), seconds));
            let baseline = baseline.insert(made);
            let carries = |method: &Method| matches!(method, Method::Warp { deferred: true }) || options.begins_carried(method);
            if methods.iter().any(carries) {
                let ((), seconds) = timed(|| baseline.prepare_keyframes(&mut scene))?;
                once.push(("drawing keyframes by deferred shading".to_owned(), seconds));
            }
        }
        let mut keyframes = Vec::new();
        if methods.contains(&Method::Warp { deferred: false }) {
            let (prepared, seconds) = timed(|| {
                let draw = |_, frame: &Frame| Ok(Some(ibl::shade(frame, light).image));
                keyframes::prepare(sequence, &sequence.transforms.keyframes, draw)
            })?;
            keyframes = prepared;
            once.push((PREPARING.to_owned(), seconds));
        }
        let (sessions, beginning) = timed(|| NetworkSessions::new(sequence, options))?;
        if sessions.read_depths() {
            once.push(("reading the range of depths".to_owned(), beginning));
        }
        let tracer = Tracer::new(sequence, options)?;
        let mut fused = None;
        if methods.iter().any(Method::is_neural) {
            let network = options.fusion.context("the methods need weights of the network that reads samples")?;
            let fused = fused.insert(Fused::new(sequence, network));
            let carried = Method::Neural { keyframes: true };
            if let Some(baseline) = baseline.as_mut().filter(|_| methods.contains(&carried)) {
                let ((), seconds) = timed(|| {
                    fused.draw_keyframes(|index, frame| {
                        scene.set_frame(sequence.numbers[index]);
                        let maps = baseline.maps(&scene, frame)?;
                        Ok(baseline.parts(frame, &maps)?.0)
                    })
                })?;
                // Every frame pays for its own shadow maps.
                baseline.forget();
                once.push(("drawing keyframes by the network".to_owned(), seconds));
            }
            if methods.iter().any(|method| method.is_neural() && method.needs_keyframes() && *method != carried) {
                let ((), seconds) = timed(|| fused.light_keyframes())?;
                once.push(("shading keyframes by the split sum".to_owned(), seconds));
            }
        }
        Ok(Self { fused, sequence, options, scene, baseline, keyframes, sessions, tracer, warm: !options.timed, once })
    }

    /// Seconds of the work that was done once for the sequence, by the name of the work.
    pub fn once(mut self) -> Vec<(String, f64)> {
        // The networks prepare keyframes as they come near.
        match self.once.iter_mut().find(|(what, _)| what == PREPARING) {
            Some((_, seconds)) => *seconds += self.sessions.preparing,
            // Less is the clock's own.
            None if self.sessions.preparing > 1e-4 => self.once.push((PREPARING.to_owned(), self.sessions.preparing)),
            None => {}
        }
        self.once
    }

    /// The picture of stored frame `index` by every method.
    pub fn render(&mut self, index: usize, cancel: &Cancel) -> Result<Vec<Picture>> {
        let settings = Settings { guide_samples: self.options.guide_samples, channels: BUFFERS, ..Settings::default() };
        self.scene.set_frame(self.sequence.numbers[index]);
        if !self.warm {
            self.warm_up(&settings, index, cancel)?;
            self.warm = true;
        }
        // Clips need later frames before the current one can be finished.
        while let Some(next) = self.sessions.wanted(index) {
            self.scene.set_frame(self.sequence.numbers[next]);
            let frame = render_gbuffer(&self.scene, &settings)?;
            let in_clips = |method: &&Method| matches!(method, Method::Wan { stills: false, .. });
            let keyed = self.options.methods.iter().filter(in_clips).any(|method| self.options.begins_carried(method));
            let shaded = self.shaded(&frame, (next, keyed), None)?;
            self.sessions.push(next, &frame, shaded.as_ref())?;
            cancel.check()?;
        }
        self.scene.set_frame(self.sequence.numbers[index]);
        let shared = self.share(&settings, index)?;
        self.tracer.forget_before(index);
        let mut made: Vec<Picture> = Vec::new();
        for method in self.options.methods {
            let (linear, seconds, spp) = match method {
                Method::Traced(tracing) => {
                    if tracing.keyframes && self.sequence.transforms.keyframes.is_empty() {
                        continue;
                    }
                    let given = match &tracing.samples {
                        Samples::AsLongAs(to) => made.iter().find(|made| made.id == *to).map(|made| made.seconds),
                        _ => None,
                    };
                    if matches!(tracing.samples, Samples::AsLongAs(_)) && given.is_none() {
                        continue;
                    }
                    let current = Current { buffer: shared.buffer(), fused: self.fused.as_ref(), cancel };
                    let (picture, seconds, spp) = self.tracer.picture(&mut self.scene, tracing, given, current)?;
                    (picture, seconds, Some(spp))
                }
                method => {
                    let made = match method {
                        Method::Wan { stills, .. } => {
                            let place = (shared.index, self.options.begins_carried(method));
                            let shaded = || self.shaded(&shared.gbuffer, place, Some(&shared.maps));
                            let shaded = if *stills { shaded()? } else { None };
                            self.sessions.picture(method, shared.index, &shared.gbuffer, shaded.as_ref())?
                        }
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

    /// The picture of a method that starts from the G-buffer, and its seconds without the G-buffer's. `None` where it cannot be
    /// made.
    fn shade(&self, method: &Method, shared: &Shared) -> Result<Option<(Rgb, f64)>> {
        let (sequence, light, gbuffer) = (self.sequence, self.sequence.light()?, &shared.gbuffer);
        if method.needs_keyframes() && sequence.transforms.keyframes.is_empty() {
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
            Method::Ibl => timed(|| Ok(ibl::shade(gbuffer, light).image))?,
            Method::Warp { deferred: false } => timed(|| {
                let current = ibl::shade(gbuffer, light).image;
                Ok(keyframes::warp(sequence, &self.keyframes, shared.index, gbuffer, &current))
            })?,
            _ => return Ok(None),
        };
        Ok(Some(made))
    }

    /// What the paper's network begins with, if that is deferred shading, of stored frame `index` with the G-buffer `frame`; with
    /// carried keyframes too if `keyed`. `maps` are the shadow maps of the frame, if it is its turn.
    fn shaded(&self, frame: &Frame, (index, keyed): (usize, bool), maps: Option<&Maps>) -> Result<Option<Shaded>> {
        let Some(baseline) = self.baseline.as_ref().filter(|_| self.options.begins_shaded()) else { return Ok(None) };
        let alone = match maps {
            Some(maps) => baseline.picture(&self.scene, frame, maps, None),
            None => baseline.picture_ahead(&self.scene, frame),
        }?;
        let carried = keyed.then(|| baseline.carried(frame, index, &alone)).transpose()?;
        Ok(Some(Shaded { alone, carried }))
    }

    /// Makes what all methods of a frame start from.
    fn share(&self, settings: &Settings, index: usize) -> Result<Shared> {
        let (gbuffer, seconds) = timed(|| Ok(render_gbuffer(&self.scene, settings)?))?;
        let maps = self.baseline.as_ref().map(|baseline| baseline.maps(&self.scene, &gbuffer)).transpose()?.unwrap_or_default();
        Ok(Shared { index, gbuffer, seconds, maps })
    }

    /// Does what only the first frame would need: fills caches, builds the denoisers' networks, and measures how the time of path
    /// tracing grows with the samples.
    fn warm_up(&mut self, settings: &Settings, index: usize, cancel: &Cancel) -> Result<()> {
        let shared = self.share(settings, index)?;
        for method in self.options.methods {
            if method.is_wan() {
                let place = (index, self.options.begins_carried(method));
                let shaded = self.shaded(&shared.gbuffer, place, Some(&shared.maps))?;
                self.sessions.warm_up(method, index, &shared.gbuffer, shaded.as_ref())?;
            } else if !matches!(method, Method::Traced(_)) {
                self.shade(method, &shared)?;
            }
        }
        // The first frame makes its own shadow maps.
        if let Some(baseline) = &mut self.baseline {
            baseline.forget();
        }
        let current = Current { buffer: shared.buffer(), fused: self.fused.as_ref(), cancel };
        self.tracer.warm_up(&mut self.scene, self.options.methods, current)
    }
}

impl Shared {
    fn buffer(&self) -> Buffer<'_> {
        Buffer { index: self.index, frame: &self.gbuffer, seconds: self.seconds }
    }
}
