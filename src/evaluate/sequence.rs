//! Evaluates every method on one sequence: IBL, neural without and with keyframes, path tracing at few samples.

use crate::dataset::SequenceFolder;
use crate::evaluate::psnr::{psnr, psnr_masked};
use crate::evaluate::ssim::ssim;
use crate::progress::Progress;
use crate::truth::{Interrupted, TruthSettings};
use anyhow::{Context, Result};
use renderflow_frame::ibl::{self, IblTables};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, file};
use renderflow_model::infer::{Keyframe, NeuralRenderer, PreparedKeyframe, warp_only};
use renderflow_model::lpips::Lpips;
use renderflow_renderer::{RenderScene, Settings, render_gbuffer};
use renderflow_scenes::{description::Scene, load};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A way to get a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Split-sum image-based lighting.
    Ibl,
    /// The network from G-buffer and environment alone.
    Neural,
    /// Keyframes carried along by depth and camera, split sum in the holes; no network.
    Warp,
    /// The network with keyframes.
    NeuralKeyframes,
    /// Path tracing at so many samples a pixel, denoised like the truth.
    PathTraced(u32),
}

impl Method {
    /// Label in tables.
    pub fn label(self) -> String {
        match self {
            Self::Ibl => "IBL (split sum)".into(),
            Self::Neural => "neural".into(),
            Self::Warp => "keyframes warped, no network".into(),
            Self::NeuralKeyframes => "neural + keyframes".into(),
            Self::PathTraced(spp) => format!("path traced, {spp} spp"),
        }
    }
}

/// Metrics of one method on one frame.
#[derive(Clone, Debug, Serialize)]
pub struct Score {
    /// The method.
    pub method: Method,
    /// Frame index.
    pub frame: usize,
    /// Whether this frame is a keyframe.
    pub key: bool,
    /// dB over pixels with coverage above 0; `None` where nothing is covered.
    pub psnr: Option<f64>,
    /// dB over the full frame.
    pub psnr_full: f64,
    /// Full frame; `None` below 11x11.
    pub ssim: Option<f64>,
    /// LPIPS (AlexNet), full frame; `None` without weights.
    pub lpips: Option<f64>,
    /// Wall seconds for this picture from the scene in memory: G-buffer, shading, network, or rays and denoiser.
    pub seconds: f64,
}

/// What to evaluate.
pub struct Options<'a> {
    /// The network.
    pub renderer: &'a NeuralRenderer,
    /// LPIPS where its weights are there.
    pub lpips: Option<&'a Lpips>,
    /// Sample counts of path-traced rows.
    pub path_traced: &'a [u32],
    /// Camera rays a pixel for the anti-aliased G-buffer.
    pub guide_samples: u32,
    /// Scattering events of path-traced rows.
    pub max_bounces: u32,
    /// Denoiser of path-traced rows, as the truth's.
    pub denoise: crate::truth::DenoiseMode,
}

impl<'a> Options<'a> {
    /// No LPIPS, no path-traced rows, 16 camera rays a pixel.
    pub fn new(renderer: &'a NeuralRenderer) -> Self {
        Self {
            renderer,
            lpips: None,
            path_traced: &[],
            guide_samples: 16,
            max_bounces: 6,
            denoise: crate::truth::DenoiseMode::Auto,
        }
    }
}

/// Called with every picture: method (`None` = truth), frame index, display values.
pub type PictureSink<'a> = dyn FnMut(Option<Method>, usize, &Rgb) + 'a;

/// Scores of one sequence.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// Folder name.
    pub sequence: String,
    /// One entry a method and frame.
    pub scores: Vec<Score>,
    /// Seconds to prefilter the environment, once a sequence.
    pub prefilter_seconds: f64,
}

struct Truth {
    picture: Rgb,
    frame: Frame,
}

/// Evaluates all methods on every frame of `folder`.
pub fn evaluate(
    folder: &SequenceFolder,
    options: &Options,
    sink: &mut PictureSink,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<Evaluation> {
    let scene: Scene = file::read_json(&folder.path.join("scene.json"))?;
    let loaded = load::load(&scene, &folder.path)?;
    let mut compiled = RenderScene::compile(&loaded)?;
    let exposure = folder.sequence.exposure;
    let started = Instant::now();
    let tables = IblTables::new(&folder.environment);
    let prefilter_seconds = started.elapsed().as_secs_f64();
    let keyframes = prepare_keyframes(folder, &tables)?;
    let low: Vec<(u32, TruthSettings)> = options
        .path_traced
        .iter()
        .map(|&spp| Ok((spp, TruthSettings::quiet(spp, options.max_bounces, options.denoise)?)))
        .collect::<Result<_>>()?;
    let mut scores = Vec::new();
    for index in 0..folder.len() {
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        compiled.set_frame(folder.numbers[index]);
        let truth = read_truth(folder, index)?;
        sink(None, index, &truth.picture);
        let camera = folder.camera(index);
        let mut add = |method: Method, linear: &Rgb, seconds: f64| -> Result<()> {
            let picture = linear.map(|p| color::display(*p, exposure));
            sink(Some(method), index, &picture);
            scores.push(Score {
                method,
                frame: index,
                key: folder.sequence.keyframes.contains(&index),
                psnr: psnr_masked(&picture, &truth.picture, &truth.frame.alpha),
                psnr_full: psnr(&picture, &truth.picture),
                ssim: ssim(&picture, &truth.picture),
                lpips: options.lpips.map(|l| l.distance(&picture, &truth.picture)).transpose()?.map(f64::from),
                seconds,
            });
            Ok(())
        };

        // The G-buffer every screen-space method starts from: camera rays only.
        let settings = Settings { guide_samples: options.guide_samples, ..Settings::default() };
        let (gbuffer, gbuffer_seconds) = timed(|| Ok(render_gbuffer(&compiled, &settings)?))?;
        let (shading, ibl_seconds) = timed(|| Ok(ibl::shade(&gbuffer, camera, &folder.environment, &tables)))?;
        add(Method::Ibl, &shading.image, gbuffer_seconds + ibl_seconds)?;

        let network = |keys: &[Keyframe]| {
            timed(|| Ok(options.renderer.render(&gbuffer, camera, &folder.environment, &tables, exposure, keys)?))
        };
        let (picture, seconds) = network(&[])?;
        add(Method::Neural, &picture, gbuffer_seconds + seconds)?;

        let keys = keyframes_for(folder, &keyframes, index);
        if !keys.is_empty() && options.renderer.accepts_keyframes() {
            let (picture, seconds) = timed(|| Ok(warp_only(&gbuffer, camera, &folder.environment, &tables, exposure, &keys)?))?;
            add(Method::Warp, &picture, gbuffer_seconds + seconds)?;
            let (picture, seconds) = network(&keys)?;
            add(Method::NeuralKeyframes, &picture, gbuffer_seconds + seconds)?;
        }
        for (spp, settings) in &low {
            let ((frame, _), seconds) = timed(|| settings.frame(&compiled, &|_, _| (), cancel))?;
            let picture = frame.beauty.as_ref().or(frame.raw.as_ref()).context("the path tracer made no picture")?;
            add(Method::PathTraced(*spp), picture, seconds)?;
        }
        progress.add(1);
    }
    Ok(Evaluation { sequence: folder.name(), scores, prefilter_seconds })
}

fn timed<T>(work: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let started = Instant::now();
    let value = work()?;
    Ok((value, started.elapsed().as_secs_f64()))
}

fn read_truth(folder: &SequenceFolder, index: usize) -> Result<Truth> {
    let frame = folder.frame(index)?;
    let beauty = frame.beauty.as_ref().with_context(|| format!("{}: frame {index} has no beauty", folder.path.display()))?;
    let picture = beauty.map(|p| color::display(*p, folder.sequence.exposure));
    Ok(Truth { picture, frame })
}

/// Truth of every keyframe of `folder`, ready to be carried to other frames; in the order of `sequence.keyframes`.
pub fn prepare_keyframes(folder: &SequenceFolder, tables: &IblTables) -> Result<Vec<PreparedKeyframe>> {
    let prepare = |&key: &usize| -> Result<PreparedKeyframe> {
        let frame = folder.frame(key)?;
        Ok(PreparedKeyframe::new(&frame, folder.camera(key), &folder.environment, tables, folder.sequence.exposure)?)
    };
    folder.sequence.keyframes.iter().map(prepare).collect()
}

/// The keyframes as seen from stored frame `index`: all of them, with their distance in frames.
pub fn keyframes_for<'a>(folder: &'a SequenceFolder, prepared: &'a [PreparedKeyframe], index: usize) -> Vec<Keyframe<'a>> {
    let here = folder.numbers[index] as f32;
    let keys = folder.sequence.keyframes.iter().zip(prepared);
    keys.map(|(&key, prepared)| Keyframe {
        prepared,
        distance: folder.numbers[key] as f32 - here,
        movement: folder.sequence.tracks.between(index, key),
    })
    .collect()
}

/// Samples a pixel and median seconds of the truth of these sequences.
pub fn truth_cost(folders: &[SequenceFolder]) -> Option<(u32, f64)> {
    let spp = folders.first()?.frame(0).ok()?.info.spp;
    let seconds: Vec<f64> = folders.iter().flat_map(|f| crate::truth::seconds(&f.path)).collect();
    Some((spp, super::table::median(seconds)))
}
