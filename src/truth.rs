//! Ground truth of a sequence: path tracing, denoising, G-buffers, one EXR a frame, resumable.

use crate::bench::watch::Watch;
use crate::dataset::folder::frame_file;
use crate::progress::Progress;
use anyhow::{Context, Result, bail};
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::tracks::Tracks;
use renderflow_frame::{Frame, exr, file, hdr, transforms};
use renderflow_renderer::denoise::{Denoiser, Options};
use renderflow_renderer::{Budget, Mode, RenderScene, Settings, render_gbuffer, render_mapped, render_with_stats};
use renderflow_scenes::description::{EnvironmentSource, Geometry, Scene};
use renderflow_scenes::{Instance, LoadedScene, load};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The user stopped the work; what is finished is kept, the same command goes on (exit code 75).
#[derive(Debug)]
pub struct Interrupted;

impl std::fmt::Display for Interrupted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("interrupted; run the same command again to go on")
    }
}

impl std::error::Error for Interrupted {}

/// Whether beauty is denoised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum DenoiseMode {
    /// OIDN where it is there; otherwise one warning and the raw picture.
    #[default]
    Auto,
    /// OIDN, or an error that says how to get it.
    Oidn,
    /// The raw picture.
    None,
}

/// How truth is rendered. One denoiser serves all frames.
pub struct TruthSettings {
    /// Samples a pixel.
    pub spp: u32,
    /// How they are spread over the pixels.
    pub budget: Budget,
    /// Frame to take the samples of every pixel from, in place of `spp` and `budget`: a file, or a folder of a sequence's frames.
    pub sample_map: Option<PathBuf>,
    /// Scattering events of a path.
    pub max_bounces: u32,
    /// Form of the principled BRDF.
    pub bsdf: Mode,
    /// Largest number of samples that share a camera ray ([`Settings::branches`]).
    pub branches: u32,
    /// Limit of indirect light ([`Settings::clamp_indirect`]): biased, for no data set.
    pub clamp_indirect: Option<f32>,
    /// Whether light is followed from the environment as well ([`Settings::light_paths`]).
    pub light_paths: bool,
    /// Groups to split the light into, 0..=8.
    pub light_groups: u32,
    /// Whether frames hold the unoccluded irradiance.
    pub irradiance: bool,
    /// Whether frames hold the Euclidean distance beside the depth.
    pub distance: bool,
    /// What compares the picture with a reference while it is rendered.
    pub watch: Option<Watch>,
    denoiser: Option<Mutex<Denoiser>>,
}

impl TruthSettings {
    /// Opens the denoiser as `mode` asks; `spp` samples in every pixel.
    pub fn new(spp: u32, max_bounces: u32, mode: DenoiseMode) -> Result<Self> {
        Self::spread(spp, Budget::Uniform, max_bounces, mode)
    }

    /// As [`Self::new`] with the samples spread as `budget` says.
    pub fn spread(spp: u32, budget: Budget, max_bounces: u32, mode: DenoiseMode) -> Result<Self> {
        let clean_guides = Settings { spp, budget, ..Settings::default() }.clean_guides();
        let open = || Denoiser::with_options(Options { clean_guides, ..Options::default() });
        let denoiser = match mode {
            DenoiseMode::None => None,
            DenoiseMode::Oidn => Some(open()?),
            DenoiseMode::Auto => match open() {
                Ok(denoiser) => Some(denoiser),
                Err(error) => {
                    eprintln!("warning: pictures stay noisy: {error}");
                    None
                }
            },
        };
        let plain = Settings::default();
        Ok(Self {
            spp,
            budget,
            sample_map: None,
            max_bounces,
            bsdf: plain.bsdf,
            branches: plain.branches,
            clamp_indirect: plain.clamp_indirect,
            light_paths: plain.light_paths,
            light_groups: plain.light_groups,
            irradiance: plain.irradiance,
            distance: false,
            watch: None,
            denoiser: denoiser.map(Mutex::new),
        })
    }

    /// As [`Self::new`], without the warning: for rows beside a truth that has warned already.
    pub fn quiet(spp: u32, max_bounces: u32, mode: DenoiseMode) -> Result<Self> {
        match mode {
            DenoiseMode::Auto if Denoiser::new().is_err() => Self::new(spp, max_bounces, DenoiseMode::None),
            mode => Self::new(spp, max_bounces, mode),
        }
    }

    /// Name of the denoiser in use.
    pub fn denoiser_name(&self) -> Option<String> {
        self.denoiser.as_ref().map(|_| "oidn".to_owned())
    }

    fn of_renderer(&self) -> Settings {
        Settings {
            spp: self.spp,
            max_bounces: self.max_bounces,
            bsdf: self.bsdf,
            branches: self.branches,
            clamp_indirect: self.clamp_indirect,
            light_paths: self.light_paths,
            light_groups: self.light_groups,
            irradiance: self.irradiance,
            budget: self.budget,
            ..Settings::default()
        }
    }

    /// The frame that holds the sample map of frame `index` of `frames`, and the settings it was made with.
    fn mapped(&self, path: &Path, index: usize, frames: usize) -> Result<(Settings, Frame)> {
        let path = if path.is_dir() { path.join(frame_file(index, Profile::Full)) } else { path.to_owned() };
        if frames > 1 && path.file_name() != Some(frame_file(index, Profile::Full).as_ref()) {
            bail!("{}: is the map of one frame, the sequence has {frames}; name a folder of frames", path.display());
        }
        let map = exr::read(&path)?;
        let settings = self.of_renderer().with_sampling(&map.info.sampling);
        let settings = settings.with_context(|| format!("{}: was not sampled adaptively", path.display()))?;
        // Counts are multiples of it, and another number would make another picture.
        let (branches, light_paths) = (map.info.branches.unwrap_or(1), map.info.light_paths);
        Ok((Settings { branches, light_paths, ..settings }, map))
    }

    /// Path-traces and denoises the current frame of `scene`; without samples its G-buffer alone. Also the seconds of both.
    pub fn frame(
        &self,
        scene: &RenderScene,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<(Frame, [f64; 2])> {
        let (mut frame, seconds) = self.picture(scene, progress, cancel)?;
        if self.distance {
            frame.fill_distance();
        }
        Ok((frame, seconds))
    }

    fn picture(
        &self,
        scene: &RenderScene,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<(Frame, [f64; 2])> {
        let started = Instant::now();
        if self.spp == 0 {
            // Coverage and guides want camera rays of their own; there are as many as by default.
            let frame = render_gbuffer(scene, &Settings { spp: 1, ..self.of_renderer() })?;
            return Ok((frame, [started.elapsed().as_secs_f64(), 0.0]));
        }
        let rendered = match (&self.sample_map, &self.watch) {
            (None, None) => render_with_stats(scene, &self.of_renderer(), progress, cancel).map_err(anyhow::Error::from),
            (None, Some(watch)) => watch.render(scene, &self.of_renderer(), progress, cancel),
            (Some(path), watch) => {
                let (settings, frame) = self.mapped(path, scene.frame(), scene.frames())?;
                let map = frame.samples.with_context(|| format!("{}: has no channel samples.N", path.display()))?;
                let render = || render_mapped(scene, &settings, &map, progress, cancel);
                match watch {
                    None => render().map_err(anyhow::Error::from),
                    Some(watch) => watch.whole(scene, render),
                }
            }
        };
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let (mut frame, stats) = rendered?;
        if stats.non_finite_samples > 0 {
            eprintln!("warning: {} samples were not finite and count as black", stats.non_finite_samples);
        }
        let traced = started.elapsed().as_secs_f64();
        if let (Some(denoiser), Some(raw)) = (&self.denoiser, &frame.raw) {
            let mut denoiser = denoiser.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            frame.beauty = Some(denoiser.denoise(raw, frame.guide_albedo.as_ref(), frame.guide_normal.as_ref())?);
            frame.info.denoiser = self.denoiser_name();
            if let (Some(watch), Some(beauty)) = (&self.watch, &frame.beauty) {
                watch.after("denoised", beauty, scene.exposure())?;
            }
        }
        Ok((frame, [traced, started.elapsed().as_secs_f64() - traced]))
    }
}

/// One sequence to render into a folder.
pub struct SequenceJob {
    /// The scene.
    pub scene: Scene,
    /// Folder that relative paths in `scene` start from.
    pub base: PathBuf,
    /// Folder to write to.
    pub out: PathBuf,
    /// Frames 0, gap, 2 gap, ... are keyframes; 0 = none is.
    pub keyframe_gap: u32,
    /// Only frames 0, step, 2 step, ... are rendered.
    pub frame_step: u32,
    /// How frames are stored.
    pub storage: Profile,
}

/// Seconds spent on each frame of truth, kept beside the frames.
#[derive(Default, Serialize, Deserialize)]
struct Timing {
    seconds: Vec<Option<f64>>,
}

/// File with the seconds of each frame of truth.
const TIMING: &str = "timing.json";

/// Seconds of the frames of truth in `folder` whose making was timed.
pub fn seconds(folder: &Path) -> Vec<f64> {
    let timing: Option<Timing> = file::read_json(&folder.join(TIMING)).ok();
    timing.map(|t| t.seconds.into_iter().flatten().collect()).unwrap_or_default()
}

/// Whether frame `number` is a keyframe where frames 0, gap, 2 gap, ... are; with a gap of 0 none is.
pub fn is_keyframe(gap: u32, number: usize) -> bool {
    gap > 0 && number.is_multiple_of(gap as usize)
}

/// What one frame cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Moving what moves, the first time compiling the scene; seconds.
    pub compile: f64,
    /// Path tracing, G-buffer included; seconds.
    pub render: f64,
    /// Denoising; seconds.
    pub denoise: f64,
    /// Encoding and writing; seconds.
    pub write: f64,
    /// Bytes of the file.
    pub bytes: u64,
}

impl Cost {
    /// Seconds in all.
    pub fn seconds(&self) -> f64 {
        self.compile + self.render + self.denoise + self.write
    }
}

/// A sequence whose scene is loaded; it is compiled when the first frame is rendered.
pub struct OpenSequence<'a> {
    job: &'a SequenceJob,
    /// The scene.
    pub loaded: LoadedScene,
    compiled: Option<RenderScene>,
    timing: Timing,
}

impl SequenceJob {
    /// Numbers of the frames to render, of a sequence of `frames`.
    fn numbers(&self, frames: usize) -> impl Iterator<Item = usize> + use<> {
        (0..frames).step_by(self.frame_step.max(1) as usize)
    }

    /// Loads the scene and writes its descriptions.
    pub fn open(&self) -> Result<OpenSequence<'_>> {
        let loaded = load::load(&self.scene, &self.base)?;
        self.write_descriptions(&loaded)?;
        let path = self.out.join(TIMING);
        // A clock is no reason to fail: a broken file starts again.
        let mut timing: Timing = file::read_json(&path).unwrap_or_default();
        timing.seconds.resize(loaded.cameras.len(), None);
        Ok(OpenSequence { job: self, loaded, compiled: None, timing })
    }

    /// Renders what is missing; 1000 units of `progress` a frame. Returns the loaded scene.
    pub fn run(&self, settings: &TruthSettings, progress: &Progress, cancel: &AtomicBool) -> Result<LoadedScene> {
        let mut sequence = self.open()?;
        for number in self.numbers(sequence.loaded.cameras.len()) {
            match sequence.found(number, settings)? {
                Found::Same => progress.resume(1000),
                Found::Other(what) => bail!(what),
                Found::Broken(error) => return Err(error),
                Found::Nothing => {
                    sequence.render(number, settings, progress, cancel)?;
                }
            }
        }
        Ok(sequence.loaded)
    }

    fn write_descriptions(&self, loaded: &LoadedScene) -> Result<()> {
        let environment = &loaded.environment;
        let numbers: Vec<usize> = self.numbers(loaded.cameras.len()).collect();
        let sequence = transforms::Sequence {
            cameras: numbers.iter().map(|&n| loaded.cameras[n]).collect(),
            files: numbers.iter().map(|&n| frame_file(n, self.storage)).collect(),
            keyframes: (0..numbers.len()).filter(|&i| is_keyframe(self.keyframe_gap, numbers[i])).collect(),
            exposure: renderflow_frame::ibl::exposure(environment),
            environment: "env.hdr".into(),
            environment_rotation: environment.rotation,
            environment_intensity: environment.intensity,
            tracks: tracks(loaded, &numbers),
        };
        file::write_atomic(&self.out.join("env.hdr"), &hdr::encode(&environment.map))?;
        transforms::write(&self.out.join("transforms.json"), &sequence)?;
        Ok(file::write_json(&self.out.join("scene.json"), &with_absolute_paths(&self.scene, &self.base)?)?)
    }
}

impl OpenSequence<'_> {
    /// File of frame `number`.
    pub fn path(&self, number: usize) -> PathBuf {
        self.job.out.join(frame_file(number, self.job.storage))
    }

    /// Renders and writes frame `number`; 1000 units of `progress`.
    pub fn render(&mut self, number: usize, settings: &TruthSettings, progress: &Progress, cancel: &AtomicBool) -> Result<Cost> {
        let started = Instant::now();
        let scene = match &mut self.compiled {
            Some(scene) => scene,
            none => {
                let compiled = RenderScene::compile(&self.loaded)?;
                let limited = compiled.environment_repairs().limited;
                if limited > 0 {
                    eprintln!("note: {limited} components of the environment were beyond 1e32 and count as that");
                }
                none.insert(compiled)
            }
        };
        scene.set_frame(number);
        let compile = started.elapsed().as_secs_f64();
        let before = progress.position();
        let (frame, [render, denoise]) =
            settings.frame(scene, &|done, total| progress.set(before + 1000 * done / total.max(1)), cancel)?;
        progress.set(before + 1000);
        let written = Instant::now();
        let path = self.path(number);
        let (bytes, clamped) = self.job.storage.encode(&path, &frame)?;
        if clamped > 0 {
            eprintln!("warning: {}: {clamped} values beyond 65504 were clamped", path.display());
        }
        file::write_atomic(&path, &bytes)?;
        let write = written.elapsed().as_secs_f64();
        self.timing.seconds[number] = Some(started.elapsed().as_secs_f64());
        file::write_json(&self.job.out.join(TIMING), &self.timing)?;
        Ok(Cost { compile, render, denoise, write, bytes: bytes.len() as u64 })
    }

    /// What is at the place of frame `number`: a frame of this scene at these settings, or one that would make the sequence a mixture,
    /// or nothing that can be read.
    pub fn found(&self, number: usize, settings: &TruthSettings) -> Result<Found> {
        let path = self.path(number);
        if !path.exists() {
            return Ok(Found::Nothing);
        }
        let frame = match frame_file::read(&path) {
            Ok(frame) => frame,
            Err(error) => return Ok(Found::Broken(error.into())),
        };
        let info = &frame.info;
        let groups = frame.light.iter().flatten().count();
        let mut wanted = settings.of_renderer();
        let samples = match &settings.sample_map {
            None if settings.budget == Budget::Uniform => info.sampling.is_empty() && info.spp == settings.spp,
            None => info.sampling == wanted.sampling(),
            Some(map) => {
                let (mapped, other) = settings.mapped(map, number, self.loaded.cameras.len())?;
                wanted = mapped;
                frame.samples == other.samples
            }
        };
        let branches = info.branches.unwrap_or(1);
        let traced = || {
            samples
                && info.denoiser == settings.denoiser_name()
                && info.bsdf == settings.bsdf.name()
                && branches == wanted.branches()
                && info.indirect_limit == settings.clamp_indirect
                // Where there are none, the scene may have no use for them.
                && (wanted.light_paths || !info.light_paths)
                && (groups == settings.light_groups as usize || self.job.storage == Profile::Compact)
        };
        let same = info.scene_hash == self.loaded.hash
            && if settings.spp == 0 { info.spp == 0 && frame.beauty.is_none() } else { traced() }
            && frame.irradiance.is_some() == settings.irradiance
            && (frame.distance.is_some() == settings.distance || self.job.storage == Profile::Compact);
        Ok(if same {
            Found::Same
        } else {
            Found::Other(format!(
                "{}: is of another scene or other settings ({} spp{}{}, {branches} a camera ray, {}{} BRDF, {groups} light groups, denoiser {}); remove the folder or choose another",
                path.display(),
                info.spp,
                if info.sampling.is_empty() { "" } else { ", " },
                info.sampling,
                info.indirect_limit.map_or_else(String::new, |limit| format!("indirect light within {limit}, ")),
                info.bsdf,
                info.denoiser.as_deref().unwrap_or("none")
            ))
        })
    }
}

/// What is at the place of a frame.
pub enum Found {
    /// The frame.
    Same,
    /// A frame of another scene or of other settings, in words.
    Other(String),
    /// Something that cannot be read as a frame.
    Broken(anyhow::Error),
    /// Nothing.
    Nothing,
}

/// Transforms of the moving objects at the frames `numbers`.
fn tracks(loaded: &LoadedScene, numbers: &[usize]) -> Tracks {
    let moving = loaded.instances.iter().filter(|instance| instance.transforms.len() > 1);
    // All instances of an object move alike, and only differences between frames count: any of them tells.
    let track = |instance: &Instance| (instance.object_id, numbers.iter().map(|&n| instance.transform(n)).collect());
    Tracks { objects: moving.map(track).collect() }
}

/// The scene with every file named in full, so that its copy beside the frames still finds them.
fn with_absolute_paths(scene: &Scene, base: &Path) -> Result<Scene> {
    let mut scene = scene.clone();
    let mut files: Vec<&mut String> = Vec::new();
    if let EnvironmentSource::File(path) = &mut scene.environment.source {
        files.push(path);
    }
    for material in &mut scene.materials {
        files.extend(&mut material.base_color_texture);
        files.extend(&mut material.metallic_roughness_texture);
        files.extend(&mut material.normal_texture);
        files.extend(&mut material.emissive_texture);
    }
    for object in &mut scene.objects {
        if let Geometry::File(path) = &mut object.geometry {
            files.push(path);
        }
    }
    for file in files {
        let full = std::path::absolute(base.join(&*file)).with_context(|| file.clone())?;
        *file = full.to_string_lossy().into_owned();
    }
    Ok(scene)
}
