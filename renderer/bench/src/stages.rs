//! Where the time of a frame goes.

use anyhow::Result;
use renderflow::util::cancel::Interrupted;
use renderflow::util::clock::{Spent, Stopwatch};
use renderflow_frame::{Frame, exr};
use renderflow_renderer::denoise::{DenoiseError, Denoiser, Options};
use renderflow_renderer::{RenderScene, Settings, Stats, develop, expose_whole};
use serde::Serialize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Time of each stage. A stage that did not run took none.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Stages {
    /// Reading files, making shapes and the sky.
    pub load: Spent,
    /// Trees, light and material tables.
    pub compile: Spent,
    /// Moving to the frame.
    pub place: Spent,
    /// Path tracing, guides included.
    pub beauty: Spent,
    /// Everything at pixel centres.
    pub gbuffer: Spent,
    /// Denoising.
    pub denoise: Spent,
    /// Encoding and writing the file.
    pub write: Spent,
}

impl Stages {
    /// Names and times, in the order of the work.
    pub fn list(&self) -> [(&'static str, Spent); 7] {
        [
            ("load", self.load),
            ("compile", self.compile),
            ("place", self.place),
            ("beauty", self.beauty),
            ("g-buffer", self.gbuffer),
            ("denoise", self.denoise),
            ("write", self.write),
        ]
    }

    /// All together.
    pub fn total(&self) -> Spent {
        self.list().iter().fold(Spent::NONE, |sum, (_, spent)| sum + *spent)
    }

    /// Applies `f` to the same stage of each of `all`.
    pub fn combine(all: &[Self], f: impl Fn(&[Spent]) -> Spent) -> Self {
        let stage = |get: fn(&Self) -> Spent| f(&all.iter().map(get).collect::<Vec<_>>());
        Self {
            load: stage(|s| s.load),
            compile: stage(|s| s.compile),
            place: stage(|s| s.place),
            beauty: stage(|s| s.beauty),
            gbuffer: stage(|s| s.gbuffer),
            denoise: stage(|s| s.denoise),
            write: stage(|s| s.write),
        }
    }
}

/// `f`, and its time.
pub fn timed<T>(f: impl FnOnce() -> Result<T>) -> Result<(T, Spent)> {
    let clock = Stopwatch::start();
    let value = f()?;
    Ok((value, clock.spent()))
}

/// A denoiser for pictures of these settings, `None` where the library is not found.
///
/// # Errors
/// What the library reports.
pub fn denoiser(settings: &Settings) -> Result<Option<Denoiser>> {
    match Denoiser::with_options(Options { clean_guides: settings.clean_guides(), ..Options::default() }) {
        Ok(denoiser) => Ok(Some(denoiser)),
        Err(DenoiseError::NotFound(_)) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// Renders the current frame of `scene` to the file `path`, a stage at a time.
///
/// # Errors
/// When a stage fails, or `cancel` was set.
pub fn frame(
    scene: &RenderScene,
    settings: &Settings,
    denoiser: Option<&mut Denoiser>,
    path: &Path,
    stages: &mut Stages,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    let clock = Stopwatch::start();
    let film = expose_whole(scene, settings, &|_, _| (), cancel);
    if cancel.load(Ordering::Relaxed) {
        return Err(Interrupted.into());
    }
    let (film, mut stats) = film?;
    stages.beauty = clock.spent();
    let ((mut frame, more), spent) = timed(|| Ok(develop(scene, settings, &film)?))?;
    stages.gbuffer = spent;
    stats += more;
    finish(&mut frame, denoiser, path, stages)?;
    Ok((frame, stats))
}

/// Denoises and writes a frame.
pub fn finish(frame: &mut Frame, denoiser: Option<&mut Denoiser>, path: &Path, stages: &mut Stages) -> Result<()> {
    if let (Some(denoiser), Some(raw)) = (denoiser, &frame.raw) {
        let guides = (frame.guide_albedo.as_ref(), frame.guide_normal.as_ref());
        let (denoised, spent) = timed(|| Ok(denoiser.denoise(raw, guides.0, guides.1)?))?;
        frame.beauty = Some(denoised);
        frame.info.denoiser = Some("oidn".into());
        stages.denoise = spent;
    }
    let (_, spent) = timed(|| Ok(exr::write(path, frame)?))?;
    stages.write = spent;
    Ok(())
}
