use super::scene::{SceneArgs, Wanted, any_resolution};
use super::{OpenArgs, TraceArgs};
use crate::dataset::around::Neighbours;
use crate::dataset::contact;
use crate::dataset::denoise::Denoise;
use crate::dataset::job::around::Window;
use crate::dataset::job::watch::{Target, Watch};
use crate::dataset::job::{SequenceJob, TruthSettings};
use crate::dataset::layout::{ANIMATION, SHEET};
use crate::dataset::plan::{Keyframes, Plan};
use crate::util::cancel::Cancel;
use crate::util::device::DeviceArgs;
use crate::util::output::{self, Hold};
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::ranges::{Resolution, within};
use crate::util::stop;
use crate::util::tev::Tev;
use crate::util::text::plural;
use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use renderflow_frame::frame_file::Profile;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, Frame, exr, file};
use renderflow_model::device::NetworkDevice;
use renderflow_renderer::denoise::Denoiser;
use renderflow_renderer::{Budget, Mode, RenderScene, Settings, Shutter, ThinLens, render_gbuffer};
use renderflow_scenes::LoadedScene;
use renderflow_scenes::description::Scene;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Fewer moments of an open shutter can be told apart.
const FEWEST_MOMENTS: u32 = 8;
/// Pictures of the animation have at most this many pixels along their longer side.
const ANIMATED: usize = 640;
/// Units of progress for denoising a frame once all frames are rendered; rendering it has 1000.
const DENOISING: u64 = 100;
/// Milliseconds that it shows each frame.
const SHOWN: u32 = 100;

/// Path-trace a scene or a model file: one EXR (and PNG) a frame
///
/// Every frame becomes an EXR with beauty and G-buffer, and a PNG. Finished frames stay. A labelled sheet shows the channels of
/// the first frame, and an animation shows all frames.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  renderflow render model.glb -o out\n  renderflow render model.glb --hdri sky.hdr --frames 17 -o out\n  \
renderflow render model.glb --animation Walk --camera Front -o out\n  \
renderflow render scene.json --resolution 1280x720 --set materials/0/roughness=.2 -o out"
)]
pub struct Render {
    #[command(flatten)]
    scene: SceneArgs,
    /// Seed. With a file, it replaces the scene's seed for random sampling. Otherwise it composes the scene (1 by default)
    #[arg(long, help_heading = "Input")]
    seed: Option<u64>,
    /// Number of frames. By default, a scene file keeps its own number, and a model is rendered once; --cameras and --animation
    /// bring theirs. A sequence that is there gets longer
    #[arg(long, value_parser = within(Plan::FRAMES), help_heading = "Input")]
    frames: Option<u32>,
    #[command(flatten)]
    trace: TraceArgs,
    /// Denoise each frame with the samples of frames around it as well, as far as they agree. Less error and less flicker remain.
    /// Frames are denoised once all are rendered. With --denoise neural, they also hold the channels of --indirect
    #[arg(long, value_enum, help_heading = "Denoising",
        conflicts_with_all = ["target_error", "time_budget", "sample_map", "reference", "tev"])]
    neighbours: Option<Neighbours>,
    /// Weights of the network of --denoise neural; those inside the program without it
    #[arg(long, value_name = "FILE", help_heading = "Network")]
    weights: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    adaptive: AdaptiveArgs,
    /// Form of the BRDF: energy-conserving, or with the formulae as Burley published them
    #[arg(long, value_enum, default_value_t, help_heading = "Sampling")]
    bsdf: Mode,
    /// The most samples for each pixel, on average, with --target-error or --time-budget
    #[arg(long, default_value_t = 4096, value_parser = within(Settings::SPP), help_heading = "Sampling")]
    max_spp: u32,
    /// The most samples that share a camera ray, a power of two. Pixels keep at least four camera rays, so fewer may share one.
    /// None do where --adaptive spreads fewer than 32 samples for a denoiser
    #[arg(long, default_value_t = Settings::default().branches, value_parser = within(Settings::BRANCHES), conflicts_with = "sample_map",
        help_heading = "Sampling")]
    branches: u32,
    /// Limit the light that a sample gets after two or more scattering events. The limit makes pictures too dark and less noisy;
    /// use it only for pictures to look at. There is no limit by default
    #[arg(long, value_name = "RADIANCE", value_parser = limit, help_heading = "Sampling")]
    clamp_indirect: Option<f32>,
    /// Trace paths from the camera only, not from lights; caustics get noisier
    #[arg(long, conflicts_with = "sample_map", help_heading = "Sampling")]
    no_light_paths: bool,
    #[command(flatten)]
    lens: LensArgs,
    /// Folder to write to
    #[arg(long, short, help_heading = "Output")]
    out: PathBuf,
    /// Replace frames and descriptions of an earlier render in the folder; other files stay
    #[arg(long, help_heading = "Output")]
    overwrite: bool,
    /// Size of the pictures in pixels: 640x480, or 512 for a square. By default, a scene file keeps its own size
    #[arg(long, value_name = "WxH", value_parser = any_resolution(), help_heading = "Output")]
    resolution: Option<Resolution>,
    /// Split the light into this many groups by direction: channels light.0 to light.7
    #[arg(long, default_value_t = 0, value_parser = within(Settings::LIGHT_GROUPS), help_heading = "Output")]
    light_groups: u32,
    /// Also write the Euclidean distance
    #[arg(long, help_heading = "Output")]
    distance: bool,
    /// Also write indirect light (channel indirect) and what light samples would have added without shadows (channel hidden)
    #[arg(long, help_heading = "Output")]
    indirect: bool,
    /// Also write the unoccluded irradiance
    #[arg(long, help_heading = "Output")]
    irradiance: bool,
    /// Write neither the labelled sheet of the first frame's channels (sheet.png) nor the animation of all frames (frames.gif)
    #[arg(long, help_heading = "Output")]
    no_sheet: bool,
    /// Distance between keyframes, in frames
    #[arg(long, default_value_t = Keyframes::GAP, value_parser = within(Plan::FRAMES), help_heading = "Output")]
    keyframe_gap: u32,
    /// Print the frames, and the errors against --reference, as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
    /// Show the pictures in tev while they are rendered; by itself, tev listens at 127.0.0.1:14158
    #[arg(long, value_name = "HOST:PORT", help_heading = "Output")]
    tev: Option<String>,
    #[command(flatten)]
    open: OpenArgs,
    /// Reference picture. Seconds and error are printed each time the samples have doubled, six times up to --spp. It may be a
    /// frame of this program (its raw beauty is used), any RGB .exr or .hdr of radiance, or a .png or .jpg of display values, and
    /// the scene must have one frame. If the reference was sampled with the same seed, the render takes another seed, so that
    /// both have independent noise; --seed prevents that
    #[arg(long, value_name = "IMAGE", help_heading = "Comparison")]
    reference: Option<PathBuf>,
}

/// A lens in place of the pinhole, and a shutter that stays open.
#[derive(Args)]
#[command(next_help_heading = "Sampling")]
struct LensArgs {
    /// Radius of the lens in metres, for pictures that are sharp at one distance only. Without it, the camera is a pinhole. The
    /// G-buffer stays sharp everywhere; coverage and guides are as blurred as the picture
    #[arg(long, value_name = "METRES", value_parser = limit, conflicts_with = "sample_map")]
    aperture: Option<f32>,
    /// Distance that is sharp, along the view, in metres; by default, that of the surface in the middle of the first frame
    #[arg(long, value_name = "METRES", value_parser = limit, requires = "aperture")]
    focus: Option<f32>,
    /// Blur what moves, the camera's own movement included: the shutter is open for this share of the time from one frame to the
    /// next, half of it before and half of it after the frame. 0.5 is the usual one of a film camera. The G-buffer and the motion
    /// vectors stay those of the frame itself; coverage and guides are as blurred as the picture
    #[arg(long, value_name = "SHARE", value_parser = share,
        conflicts_with_all = ["sample_map", "adaptive", "target_error", "time_budget", "reference", "tev"])]
    shutter: Option<f32>,
}

impl LensArgs {
    /// The lens; `middle` finds the distance of what is in the middle of the first frame.
    fn lens(&self, middle: impl FnOnce() -> Result<Option<f32>>) -> Result<Option<ThinLens>> {
        let Some(aperture) = self.aperture else { return Ok(None) };
        let focus = match self.focus {
            Some(focus) => focus,
            None => middle()?.context("--focus is needed: there is no surface in the middle of the first frame")?,
        };
        Ok(Some(ThinLens { aperture, focus }))
    }

    /// The shutter for `frames` frames of `rays` camera rays a pixel.
    fn shutter(&self, frames: usize, rays: u32) -> Option<Shutter> {
        let open = self.shutter?;
        if frames < 2 {
            eprintln!("note: --shutter: the scene has one frame, so nothing moves");
            return None;
        }
        let shutter = Shutter::new(open, rays);
        if shutter.moments < FEWEST_MOMENTS {
            let (moments, plural) = (shutter.moments, if shutter.moments == 1 { "" } else { "s" });
            eprintln!(
                "note: with so few samples the shutter shows {moments} moment{plural} of the movement; a larger --spp shows more"
            );
        }
        Some(shutter)
    }
}

/// Distance, along the view, of what is in the middle of the first frame.
fn middle(loaded: &LoadedScene) -> Result<Option<f32>> {
    let mut scene = RenderScene::compile(loaded)?;
    let camera = *scene.camera();
    // One pixel that sees what the middle of the picture shows.
    let [x, y] = [0.5 * camera.width as f32, 0.5 * camera.height as f32];
    scene.look_with(Camera { width: 1, height: 1, cx: camera.cx - x + 0.5, cy: camera.cy - y + 0.5, ..camera });
    let depth = render_gbuffer(&scene, &Settings::default())?.depth.pixels[0];
    Ok(depth.is_finite().then_some(depth))
}

/// How samples are spread over the pixels. Without any of these options, every pixel gets the same number.
#[derive(Args)]
#[command(next_help_heading = "Sampling")]
#[group(multiple = false)]
struct AdaptiveArgs {
    /// Spend --spp samples for each pixel on average, and more where the picture is noisier. Fewer than 32 samples say too little
    /// about noise: a picture that is denoised gets more of them where its G-buffer shows detail, without --branches, and any
    /// other the same number everywhere
    #[arg(long)]
    adaptive: bool,
    /// Sample until the estimated relMSE of a frame is this small, with at most --max-spp for each pixel on average
    #[arg(long, value_name = "RELMSE", value_parser = whole_units::<1_000_000>, conflicts_with = "spp")]
    target_error: Option<u32>,
    /// Sample for this many seconds a frame, with at most --max-spp for each pixel on average; the frame stores how many samples
    /// each pixel got
    #[arg(long, value_name = "SECONDS", value_parser = whole_units::<1000>, conflicts_with = "spp")]
    time_budget: Option<u32>,
    /// Give every pixel the number of samples that it has in this frame (EXR) or this folder of frames; the picture comes out the
    /// same
    #[arg(long, value_name = "FRAME")]
    sample_map: Option<PathBuf>,
}

/// A positive number in units of 1 / `PER_ONE`.
fn whole_units<const PER_ONE: u32>(text: &str) -> std::result::Result<u32, String> {
    let number: f64 = text.parse().map_err(|e| format!("{e}"))?;
    let units = (number * f64::from(PER_ONE)).round();
    if (1.0..=f64::from(u32::MAX)).contains(&units) {
        return Ok(units as u32);
    }
    Err(format!("must be from {} to {}", 1.0 / f64::from(PER_ONE), f64::from(u32::MAX) / f64::from(PER_ONE)))
}

/// A number above 0, 1 at most.
fn share(text: &str) -> std::result::Result<f32, String> {
    let share: f32 = text.parse().map_err(|e| format!("{e}"))?;
    if share > 0.0 && share <= 1.0 { Ok(share) } else { Err("must be above 0, and 1 at most".into()) }
}

/// A finite number above 0.
fn limit(text: &str) -> std::result::Result<f32, String> {
    let limit: f32 = text.parse().map_err(|e| format!("{e}"))?;
    if limit > 0.0 && limit.is_finite() { Ok(limit) } else { Err("must be finite and above 0".into()) }
}

/// The reference at `path`, which must fit `scene`. With equal seeds, the two pictures share noise and the error looks too small.
/// So `scene` gets another seed, unless `chosen` is the user's own.
fn target(path: &Path, scene: &mut Scene, chosen: Option<u64>) -> Result<Target> {
    if scene.frames != 1 {
        bail!("--reference compares one picture, but the scene has {} frames; --frames 1 renders the first", scene.frames);
    }
    let target = Target::read(path)?;
    let [width, height] = scene.resolution.map(|v| v as usize);
    target.check_size(width, height).with_context(|| path.display().to_string())?;
    if target.seed() == Some(scene.seed) {
        let (path, seed) = (path.display(), scene.seed);
        if chosen.is_some() {
            eprintln!(
                "warning: {path}: was sampled with the same seed {seed}; its noise is partly that of this picture, and errors look too small"
            );
        } else {
            scene.seed = seed ^ 1;
            eprintln!(
                "note: {path}: was sampled with the seed {seed} of this scene, so the picture is sampled with {} (--seed {seed} keeps it)",
                scene.seed
            );
        }
    }
    Ok(target)
}

impl Render {
    /// The same command makes whatever is not stored yet, so nothing is lost where a signal ends it at once.
    pub fn run(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        stop::at_once(stop::RESUMABLE, || self.render(allowed, cancel))
    }

    fn render(self, allowed: &[PathBuf], cancel: &Cancel) -> Result<()> {
        let wanted = Wanted { seed: self.seed, composed: 1, resolution: self.resolution, frames: self.frames };
        let (mut scene, base) = self.scene.describe(allowed, &wanted)?;
        let target = self.reference.as_deref().map(|path| target(path, &mut scene, self.seed)).transpose()?;
        let usual = self.trace.settings(Settings::default().spp);
        let denoised = match self.trace.denoise {
            Denoise::None => false,
            Denoise::Auto => Denoiser::new().is_ok(),
            Denoise::Oidn | Denoise::Neural => true,
        };
        let (spp, budget) = match &self.adaptive {
            AdaptiveArgs { adaptive: true, .. } => (usual.spp, Budget::adaptive(usual.spp, denoised)),
            AdaptiveArgs { target_error: Some(millionths), .. } => (self.max_spp, Budget::Error { millionths: *millionths }),
            AdaptiveArgs { time_budget: Some(milliseconds), .. } => (self.max_spp, Budget::Time { milliseconds: *milliseconds }),
            _ => (usual.spp, Budget::Uniform),
        };
        let render = Settings {
            spp,
            budget,
            bsdf: self.bsdf,
            branches: self.branches,
            clamp_indirect: self.clamp_indirect,
            light_paths: !self.no_light_paths,
            light_groups: self.light_groups,
            irradiance: self.irradiance,
            ..usual
        };
        // No other denoiser is a network of this program.
        let neural = self.trace.denoise == Denoise::Neural;
        ensure!(neural || self.weights.is_none(), "--weights: is for --denoise neural");
        let device = if neural { self.device.open()? } else { NetworkDevice::cpu() };
        let mut settings = match &self.weights {
            Some(path) => {
                let network = Arc::new(super::fusion(Some(path), &device)?);
                TruthSettings::with_network(render, network, Denoiser::new().ok())
            }
            None => TruthSettings::new(render, self.trace.denoise, &device)?,
        };
        if let Some(neighbours) = self.neighbours {
            ensure!(scene.frames > 1, "--neighbours: the scene has one frame; --frames makes more");
            ensure!(self.trace.denoise != Denoise::None, "--neighbours: is for a denoiser, and --denoise none has none");
            settings = settings.with_neighbours(neighbours, scene.frames as usize)?;
        }
        let later = settings.denoises_later();
        settings.distance = self.distance;
        if self.indirect {
            settings = settings.with_paths();
        }
        if let Some(map) = self.adaptive.sample_map {
            settings = settings.with_sample_map(map, scene.frames as usize)?;
        }
        let viewer = self.tev.as_deref().map(Tev::connect).transpose()?;
        let each = if later { 1000 + DENOISING } else { 1000 };
        let progress = Arc::new(Progress::new("render", u64::from(scene.frames) * each));
        let rows = Arc::new(Mutex::new(Vec::new()));
        if target.is_some() || viewer.is_some() {
            let mut watch = Watch::default();
            if let Some(target) = target {
                let (printer, rows, json) = (Arc::clone(&progress), Arc::clone(&rows), self.json);
                watch = watch.compare(target, move |line| match json {
                    true => rows.lock().unwrap_or_else(PoisonError::into_inner).extend(line.json()),
                    false => printer.print(&line.to_string()),
                });
            }
            if let Some(viewer) = viewer {
                watch = watch.show(viewer);
            }
            settings.watch = Some(watch);
        }
        let job = SequenceJob {
            scene,
            base,
            out: self.out.clone(),
            keyframe_gap: self.keyframe_gap,
            frame_step: 1,
            storage: Profile::Full,
        };
        let mut hold = Hold::new(&self.out)?;
        let mut sequence = job.open()?;
        settings.render.lens = self.lens.lens(|| middle(&sequence.loaded))?;
        settings.shutter = self.lens.shutter(sequence.loaded.cameras.len(), settings.render.camera_samples());
        let work = sequence.decide(&settings, Some(self.overwrite))?;
        let frames = sequence.loaded.cameras.len();
        let [sheet, animation] = [SHEET, ANIMATION].map(|name| self.out.join(name));
        let (with_sheet, with_animation) = (!self.no_sheet, !self.no_sheet && frames > 1);
        let beside = [(with_sheet, &sheet), (with_animation, &animation)];
        let (made, not_made): (Vec<_>, Vec<_>) = beside.into_iter().partition(|(made, _)| *made);
        sequence.check_beside(&work, &made.into_iter().map(|(_, path)| path.clone()).collect::<Vec<_>>())?;
        for (_, path) in not_made.into_iter().filter(|(_, path)| self.overwrite && !work.missing.is_empty() && path.exists()) {
            eprintln!("note: {}: stays as it is, and does not show this render", path.display());
        }
        hold.begin()?;
        sequence.lengthen(&work, &settings)?;
        progress.resume(1000 * (frames - work.missing.len()) as u64);
        let mut written = Vec::new();
        if later {
            for &index in &work.missing {
                sequence.render(index, &settings, &progress, cancel)?;
            }
        }
        let mut window = Window::default();
        for index in 0..frames {
            let made = work.missing.contains(&index);
            if later {
                sequence.denoise(index, &settings, &mut window, cancel)?;
                progress.add(DENOISING);
            } else if made {
                sequence.render(index, &settings, &progress, cancel)?;
            }
            let path = sequence.path(index);
            let frame = finish(&path, (!made).then_some(settings.watch.as_ref()).flatten())?;
            if !self.json {
                progress.print(&match frame.info.sampling.as_str() {
                    "" => path.display().to_string(),
                    sampling => format!("{} ({sampling}: {} per pixel)", path.display(), plural(frame.info.spp, "sample")),
                });
            }
            written.push(json!({ "file": path.to_string_lossy(), "spp": frame.info.spp, "sampling": frame.info.sampling }));
            if index == 0 && with_sheet {
                replace(&sheet, contact::sheet(&frame)?)?;
            }
        }
        sequence.describe()?;
        if with_animation {
            let picture = |index: usize| picture::display_values(&sequence.path(index).with_extension("png"));
            let small = |picture: Rgb| picture::reduced(&picture, ANIMATED);
            replace(&animation, picture::gif((0..frames).map(|index| picture(index).map(small)), SHOWN)?)?;
        }
        progress.finish();
        if self.json {
            let errors = std::mem::take(&mut *rows.lock().unwrap_or_else(PoisonError::into_inner));
            println!("{}", serde_json::to_string_pretty(&json!({ "frames": written, "errors": errors }))?);
        }
        super::print_report(&sequence.loaded.report);
        self.open.open(&sequence.path(0).with_extension("png"));
        Ok(())
    }
}

/// Writes a file that follows from the frames, unless it is there with these bytes.
fn replace(path: &Path, bytes: Vec<u8>) -> Result<()> {
    stop::hold(|| output::write(&[(path.to_owned(), bytes)], true))
}

/// Writes the picture of a stored frame, and returns the frame. If `watch` is given, the frame is compared with its reference.
fn finish(path: &Path, watch: Option<&Watch>) -> Result<Frame> {
    let frame = exr::read(path)?;
    if let (Some(watch), Some(raw)) = (watch, &frame.raw) {
        watch.stored(frame.info.spp, raw, frame.info.exposure)?;
    }
    if let Some(picture) = contact::display(&frame) {
        let bytes = picture::png(&picture)?;
        stop::hold(|| file::write_atomic(&path.with_extension("png"), &bytes))?;
    }
    Ok(frame)
}
