//! Renders the ground truth of a sequence: path tracing, denoising, G-buffers, one file for each frame. The work can be resumed.

pub mod around;
pub mod clean;
mod decide;
mod map;
pub(crate) mod memory;
pub mod watch;

use crate::dataset::layout::{ENVIRONMENT, SCENE, TIMING, TRANSFORMS, frame_file};
pub use decide::{Existing, Work};

use super::around::Neighbours;
use super::denoise::Denoise;
use super::plan::is_keyframe;
use super::shading::TRACED;
use crate::util::cancel::Cancel;
use crate::util::machine;
use crate::util::output;
use crate::util::progress::Progress;
use crate::util::stop;
use crate::util::text::plural;
use anyhow::{Context, Result};
use clean::Cleaner;
use glam::Affine3A;
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::reach::Reach;
use renderflow_frame::tracks::Tracks;
use renderflow_frame::{Frame, file, hdr, transforms};
use renderflow_model::device::NetworkDevice;
use renderflow_model::fusion::Fusion;
use renderflow_renderer::denoise::Denoiser;
use renderflow_renderer::{
    RenderScene, Settings, Shutter, Stats, render_gbuffer_until, render_mapped, render_with_shutter, render_with_stats,
};
use renderflow_scenes::description::{EnvironmentSource, Geometry, LightKind, Scene};
use renderflow_scenes::{Instance, LoadedScene, load};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use watch::Watch;

/// Why the network cannot make truth.
pub const NO_TRUTH: &str = "is for pictures to look at: truth that a network is compared with must not be its own";

/// How truth is rendered. One denoiser serves all frames.
pub struct TruthSettings {
    /// The settings of the renderer. 0 samples for each pixel stand for G-buffers only.
    pub render: Settings,
    /// A frame, or a folder of a sequence's frames, from which to take the number of samples of every pixel. It replaces
    /// `render.spp` and `render.budget`.
    pub sample_map: Option<PathBuf>,
    /// Shutter that is open while things move; `None` for pictures of one moment.
    pub shutter: Option<Shutter>,
    /// Whether frames hold the Euclidean distance as well as the depth.
    pub distance: bool,
    /// Whether frames keep indirect and hidden light.
    keeps_paths: bool,
    /// Looks at the picture while it is rendered.
    pub watch: Option<Watch>,
    denoiser: Option<Cleaner>,
    /// The frames whose samples the denoiser reads as well.
    neighbours: Neighbours,
}

impl TruthSettings {
    /// Opens the denoiser that `mode` asks for; `device` is that of the network. Without samples there is nothing to denoise.
    ///
    /// # Errors
    /// When the mode asks for a denoiser that is not found.
    pub fn new(render: Settings, mode: Denoise, device: &NetworkDevice) -> Result<Self> {
        let denoiser = if render.spp == 0 { None } else { Cleaner::open(mode, &render, device)? };
        Ok(Self::of(render, denoiser))
    }

    /// As [`Self::new`], but without a warning: for rows beside a truth that has already warned.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn quiet(render: Settings, mode: Denoise) -> Result<Self> {
        match mode {
            Denoise::Auto if Denoiser::new().is_err() => Self::new(render, Denoise::None, &NetworkDevice::cpu()),
            mode => Self::new(render, mode, &NetworkDevice::cpu()),
        }
    }

    /// Denoises with `network`, which also reads what `oidn` makes of the samples. `render` has at least one sample per pixel.
    pub fn with_network(render: Settings, network: Arc<Fusion>, oidn: Option<Denoiser>) -> Self {
        Self::of(render, Some(Cleaner::neural(network, oidn)))
    }

    fn of(render: Settings, denoiser: Option<Cleaner>) -> Self {
        let neighbours = Neighbours::Alone;
        let (mut render, keeps_paths) = (render, render.channels.paths);
        if denoiser.as_ref().is_some_and(Cleaner::reads_paths) {
            (render.channels.paths, render.channels.variance) = (TRACED.paths, TRACED.variance);
        }
        Self { keeps_paths, render, sample_map: None, shutter: None, distance: false, watch: None, denoiser, neighbours }
    }

    /// Refuses frames of `scene` that take more memory than is available. `storage` is how they are stored.
    ///
    /// # Errors
    /// The message has both numbers, and ways to need less.
    pub fn ensure_memory(&self, scene: &RenderScene, storage: Profile) -> Result<()> {
        let camera = scene.camera();
        memory::ensure(self, [camera.width, camera.height], scene.has_light_paths(&self.render), storage)
    }

    /// Name of the denoiser in use.
    pub fn denoiser_name(&self) -> Option<String> {
        self.denoiser.as_ref().map(|denoiser| format!("{}{}", denoiser.name(), self.neighbours.label()))
    }

    /// Whether frames are denoised once all are rendered.
    pub fn denoises_later(&self) -> bool {
        self.neighbours != Neighbours::Alone
    }

    /// Bytes that denoising a picture of this many pixels takes beyond its channels, and how many of them are kept for the next
    /// picture.
    pub(crate) fn denoising(&self, pixels: u64) -> [u64; 2] {
        self.denoiser.as_ref().map_or([0; 2], |denoiser| denoiser.bytes(pixels))
    }

    /// Path-traces and denoises the current frame of `scene`, or makes only its G-buffer where there are no samples. Also returns
    /// the wall seconds of both steps.
    pub fn frame(&self, scene: &RenderScene, progress: &(dyn Fn(u64, u64) + Sync), cancel: &Cancel) -> Result<(Frame, [f64; 2])> {
        let started = Instant::now();
        let traced = self.trace(scene, progress, cancel);
        cancel.check()?;
        self.finish(scene, traced?, started, cancel)
    }

    /// As [`Self::frame`], while the scene's shutter is open where it has one. The scene stands at its frame afterwards.
    pub fn frame_with_shutter(
        &self,
        scene: &mut RenderScene,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &Cancel,
    ) -> Result<(Frame, [f64; 2])> {
        if scene.shutter().is_none() {
            return self.frame(scene, progress, cancel);
        }
        let started = Instant::now();
        let traced = render_with_shutter(scene, &self.render, progress, cancel);
        cancel.check()?;
        self.finish(scene, traced?, started, cancel)
    }

    fn trace(&self, scene: &RenderScene, progress: &(dyn Fn(u64, u64) + Sync), cancel: &Cancel) -> Result<(Frame, Stats)> {
        if self.render.spp == 0 {
            // Coverage and guides need camera rays of their own; their number is the default.
            let frame = render_gbuffer_until(scene, &Settings { spp: 1, ..self.render }, cancel)?;
            return Ok((frame, Stats::default()));
        }
        match (&self.sample_map, &self.watch) {
            (None, None) => render_with_stats(scene, &self.render, progress, cancel).map_err(anyhow::Error::from),
            (None, Some(watch)) => watch.render(scene, &self.render, progress, cancel),
            (Some(path), watch) => {
                let (settings, frame) = self.mapped(path, scene.frame(), scene.frames())?;
                let map = frame.samples.with_context(|| format!("{}: {NO_MAP}", path.display()))?;
                let render = || render_mapped(scene, &settings, &map, progress, cancel);
                match watch {
                    None => render().map_err(anyhow::Error::from),
                    Some(watch) => watch.whole(scene, render),
                }
            }
        }
    }

    /// Denoises a frame whose tracing began at `started`, and adds what else was asked for.
    fn finish(
        &self,
        scene: &RenderScene,
        (mut frame, stats): (Frame, Stats),
        started: Instant,
        cancel: &Cancel,
    ) -> Result<(Frame, [f64; 2])> {
        if stats.non_finite_samples > 0 {
            eprintln!("warning: {} made black: not finite", plural(stats.non_finite_samples, "sample"));
        }
        let traced = started.elapsed().as_secs_f64();
        if let Some(denoiser) = self.denoiser.as_ref().filter(|_| self.neighbours == Neighbours::Alone) {
            frame.beauty = None;
            frame.beauty = Some(denoiser.clean(scene, &frame, None, &self.used(scene)?, cancel)?);
            frame.info.denoiser = self.denoiser_name();
            self.drop_paths(&mut frame);
            if let (Some(watch), Some(beauty)) = (&self.watch, &frame.beauty) {
                watch.after("denoised", beauty, scene.exposure())?;
            }
        }
        if let Some(watch) = self.watch.as_ref().filter(|_| self.render.spp > 0) {
            watch.finish(scene, &frame);
        }
        if self.distance {
            frame.fill_distance();
        }
        Ok((frame, [traced, started.elapsed().as_secs_f64() - traced]))
    }
}

/// One sequence to render into a folder.
pub struct SequenceJob {
    /// The scene.
    pub scene: Scene,
    /// The folder that relative paths in `scene` start from, and the files that it may name.
    pub base: Reach,
    /// Folder to write to.
    pub out: PathBuf,
    /// Frames 0, gap, 2 gap, ... are keyframes; 0 = no frame is.
    pub keyframe_gap: u32,
    /// Only frames 0, step, 2 step, ... are rendered.
    pub frame_step: u32,
    /// How frames are stored.
    pub storage: Profile,
}

/// Seconds of rendering and denoising each frame of truth, stored beside the frames.
#[derive(Default, Serialize, Deserialize)]
struct Timing {
    seconds: Vec<Option<f64>>,
}

/// Said of a frame that has no numbers of samples.
const NO_MAP: &str = "has no channel samples.N";

/// Wall seconds of the frames of truth in `folder`, as far as they were stored.
pub fn seconds(folder: &Path) -> Vec<f64> {
    let timing: Option<Timing> = file::read_json(&folder.join(TIMING)).ok();
    timing.map(|t| t.seconds.into_iter().flatten().collect()).unwrap_or_default()
}

/// Wall seconds of the frames `numbers` of truth in `folder`, as far as they were stored.
pub fn seconds_of(folder: &Path, numbers: &[usize]) -> Vec<f64> {
    let timing: Timing = file::read_json(&folder.join(TIMING)).unwrap_or_default();
    numbers.iter().filter_map(|&number| *timing.seconds.get(number)?).collect()
}

/// What one frame cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Moving what moves; for the first frame also compiling the scene. Seconds.
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

/// A sequence whose scene is loaded; it is compiled when the first frame is rendered. Nothing is written before that.
pub struct OpenSequence<'a> {
    job: &'a SequenceJob,
    /// The scene.
    pub loaded: LoadedScene,
    compiled: Option<RenderScene>,
    timing: Timing,
    /// Whether the descriptions in the folder belong to this sequence.
    described: bool,
}

impl SequenceJob {
    /// Numbers of the frames to render, of a sequence of `frames`.
    fn numbers(&self, frames: usize) -> impl Iterator<Item = usize> + use<> {
        (0..frames).step_by(self.frame_step.max(1) as usize)
    }

    /// Loads the scene. Nothing is written yet.
    pub fn open(&self) -> Result<OpenSequence<'_>> {
        let started = Instant::now();
        let loaded = load::load(&self.scene, &self.base)?;
        let triangles: usize = loaded.instances.iter().map(|i| loaded.meshes[i.mesh].triangles.len()).sum();
        let (instances, materials, textures) = (loaded.instances.len(), loaded.materials.len(), loaded.textures.len());
        tracing::info!(seconds = started.elapsed().as_secs_f64(), instances, triangles, materials, textures, "loaded");
        // The seconds are not worth a failure: a broken file starts again.
        let mut timing: Timing = file::read_json(&self.out.join(TIMING)).unwrap_or_default();
        timing.seconds.resize(loaded.cameras.len(), None);
        Ok(OpenSequence { job: self, loaded, compiled: None, timing, described: false })
    }
}

impl OpenSequence<'_> {
    /// File of frame `number`.
    pub fn path(&self, number: usize) -> PathBuf {
        self.job.out.join(frame_file(number, self.job.storage))
    }

    /// Makes the frames of a shorter sequence part of this one: their headers name this scene. They are rendered no more, and are
    /// denoised again where they may get samples of later frames.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub fn lengthen(&self, work: &Work, settings: &TruthSettings) -> Result<()> {
        for &number in &work.lengthened {
            let path = self.path(number);
            let mut frame = frame_file::read(&path)?;
            frame.info.scene_hash.clone_from(&self.loaded.hash);
            if settings.neighbours == Neighbours::Around {
                // Until then it is as it was traced, as its header says.
                frame.info.denoiser = None;
                if frame.raw.is_some() {
                    frame.beauty.clone_from(&frame.raw);
                }
            }
            let (bytes, _) = self.job.storage.encode(&path, &frame)?;
            stop::hold(|| file::write_atomic(&path, &bytes))?;
        }
        Ok(())
    }

    /// Does `work`: renders the frames that are missing and writes the descriptions. Every frame of the sequence takes 1000
    /// units of `progress`.
    ///
    /// # Errors
    /// When stopped ([`Interrupted`](crate::util::cancel::Interrupted)), when a frame cannot be rendered, or when a file cannot
    /// be written.
    pub fn make(&mut self, work: &Work, settings: &TruthSettings, progress: &Progress, cancel: &Cancel) -> Result<()> {
        self.lengthen(work, settings)?;
        let kept = self.job.numbers(self.loaded.cameras.len()).count() - work.missing.len();
        progress.resume(1000 * kept as u64);
        for &number in &work.missing {
            self.render(number, settings, progress, cancel)?;
        }
        self.describe()
    }

    /// Cameras, files and light for `transforms.json`.
    fn sequence(&self) -> Result<transforms::Sequence> {
        let (job, loaded) = (self.job, &self.loaded);
        let environment = &loaded.environment;
        let numbers: Vec<usize> = job.numbers(loaded.cameras.len()).collect();
        Ok(transforms::Sequence {
            cameras: numbers.iter().map(|&n| loaded.cameras[n]).collect(),
            files: numbers.iter().map(|&n| frame_file(n, job.storage)).collect(),
            keyframes: (0..numbers.len()).filter(|&i| is_keyframe(job.keyframe_gap, numbers[i])).collect(),
            exposure: renderflow_frame::ibl::exposure(environment),
            environment: ENVIRONMENT.into(),
            environment_rotation: environment.rotation,
            environment_intensity: environment.intensity,
            tracks: tracks(loaded, &numbers),
        })
    }

    /// Paths and bytes of the descriptions.
    fn descriptions(&self) -> Result<[(PathBuf, Vec<u8>); 3]> {
        let [environment, cameras, scene] = [ENVIRONMENT, TRANSFORMS, SCENE].map(|name| self.job.out.join(name));
        let map = hdr::encode(&self.loaded.environment.map);
        let sequence = transforms::encode(&cameras, &self.sequence()?)?;
        let text = file::json(&scene, &with_absolute_paths(&self.job.scene, self.job.base.base())?)?;
        Ok([(environment, map), (cameras, sequence), (scene, text)])
    }

    /// Writes the descriptions that are missing or differ.
    ///
    /// # Errors
    /// When one cannot be written.
    pub fn describe(&mut self) -> Result<()> {
        if !self.described {
            stop::hold(|| output::write(&self.descriptions()?, true))?;
            self.described = true;
        }
        Ok(())
    }

    /// Writes the descriptions, then renders and writes frame `number`, in 1000 units of `progress`.
    ///
    /// # Errors
    /// As [`make`](Self::make).
    pub fn render(&mut self, number: usize, settings: &TruthSettings, progress: &Progress, cancel: &Cancel) -> Result<Cost> {
        let started = Instant::now();
        self.compile(settings)?;
        let mut scene = self.compiled.take().context("the scene is not compiled")?;
        scene.set_frame(number);
        settings.ensure_memory(&scene, self.job.storage)?;
        self.describe()?;
        let compile = started.elapsed().as_secs_f64();
        let before = progress.position();
        let rendered =
            settings.frame_with_shutter(&mut scene, &|done, total| progress.set(before + 1000 * done / total.max(1)), cancel);
        self.compiled = Some(scene);
        let (frame, [render, denoise]) = rendered?;
        progress.set(before + 1000);
        let cost = self.write(number, &frame)?;
        tracing::debug!(
            frame = number,
            compile,
            render,
            denoise,
            write = cost.write,
            bytes = cost.bytes,
            "seconds of the frame's stages"
        );
        self.timing.seconds[number] = Some(render + denoise);
        self.write_timing()?;
        Ok(Cost { compile, render, denoise, ..cost })
    }

    /// Writes the seconds that the frames took.
    fn write_timing(&self) -> Result<()> {
        Ok(stop::hold(|| file::write_json(&self.job.out.join(TIMING), &self.timing))?)
    }

    /// Compiles the scene, if it is not compiled yet.
    fn compile(&mut self, settings: &TruthSettings) -> Result<()> {
        if self.compiled.is_some() {
            return Ok(());
        }
        let started = Instant::now();
        let compiled = match settings.shutter {
            None => RenderScene::compile(&self.loaded)?,
            Some(shutter) => {
                // Of the scene with its moments, and of what is compiled from it.
                let needed = self.loaded.moments_memory(shutter.moments as usize).saturating_mul(2);
                machine::ensure_memory("the movement of all frames", needed, "fewer frames take less")?;
                RenderScene::compile_with_shutter(&self.loaded, shutter)?
            }
        };
        let seconds = started.elapsed().as_secs_f64();
        tracing::info!(seconds, features = ?compiled.features(), "compiled");
        let limited = compiled.environment_repairs().limited;
        if limited > 0 {
            eprintln!("note: {} of the environment beyond 1e32 set to that", plural(limited, "component"));
        }
        self.compiled = Some(compiled);
        Ok(())
    }

    /// Writes frame `number`; the cost has the seconds and the bytes of that.
    fn write(&self, number: usize, frame: &Frame) -> Result<Cost> {
        let written = Instant::now();
        let path = self.path(number);
        let (bytes, clamped) = self.job.storage.encode(&path, frame)?;
        if clamped > 0 {
            eprintln!("warning: {}: {} beyond 65504 clamped", path.display(), plural(clamped, "value"));
        }
        stop::hold(|| file::write_atomic(&path, &bytes))?;
        Ok(Cost { write: written.elapsed().as_secs_f64(), bytes: bytes.len() as u64, ..Cost::default() })
    }
}

/// Matrices of instances that move alike differ by at most this share of their largest entry ...
const ALIKE: f64 = 1e-4;
/// ... and positions by this share of the distances from the origin. Transforms are in single precision.
const SAME_PLACE: f64 = 1e-5;

/// Transforms of the moving objects at the frames `numbers`; none for those whose instances move against each other or change
/// their shape.
pub(crate) fn tracks(loaded: &LoadedScene, numbers: &[usize]) -> Tracks {
    let moving = loaded.instances.iter().filter(|instance| instance.transforms.len() > 1);
    let track = |instance: &Instance| (instance.object_id, numbers.iter().map(|&n| instance.transform(n)).collect());
    let mut objects: BTreeMap<u32, Vec<Affine3A>> = moving.map(track).collect();
    // Only differences between frames count, so one instance stands for all that move along with it.
    for instance in &loaded.instances {
        if loaded.meshes[instance.mesh].deformation.is_some() {
            objects.insert(instance.object_id, Vec::new());
        } else if let Some(track) = objects.get_mut(&instance.object_id)
            && !moves_along(instance, numbers, track)
        {
            track.clear();
        }
    }
    Tracks { objects }
}

/// Whether `instance` keeps its place, at the frames `numbers`, relative to what has the transforms `track` at these frames; true
/// where `track` is empty.
fn moves_along(instance: &Instance, numbers: &[usize], track: &[Affine3A]) -> bool {
    let pairs = || numbers.iter().map(move |&number| instance.transform(number)).zip(track.iter().copied());
    // The instance that the track is of, whatever its transforms are.
    if pairs().all(|(own, other)| own == other) {
        return true;
    }
    let wide = |(own, other): (Affine3A, Affine3A)| (own.as_daffine3(), other.as_daffine3());
    let Some((own_first, other_first)) = pairs().next().map(wide) else { return true };
    let relative = other_first.inverse() * own_first;
    pairs().map(wide).all(|(own, other)| {
        let expected = other * relative;
        let largest = own.matrix3.to_cols_array().into_iter().fold(0.0, |largest: f64, v| largest.max(v.abs()));
        let reach: f64 = [own_first, other_first, own, other].map(|t| t.translation.abs().max_element()).iter().sum();
        // NaN is not alike.
        (expected.matrix3 - own.matrix3).to_cols_array().iter().all(|v| v.abs() <= ALIKE * largest)
            && (expected.translation - own.translation).to_array().iter().all(|v| v.abs() <= SAME_PLACE * reach)
    })
}

/// The scene with the full path of every file, so that a copy in another folder still finds them. Relative names start from
/// `base`.
///
/// # Errors
/// When there is no working folder.
pub fn with_absolute_paths(scene: &Scene, base: &Path) -> Result<Scene> {
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
    for light in &mut scene.lights {
        if let LightKind::Point { ies, .. } | LightKind::Spot { ies, .. } = &mut light.kind {
            files.extend(ies);
        }
    }
    for file in files {
        let full = std::path::absolute(base.join(&*file)).with_context(|| file.clone())?;
        *file = full.to_string_lossy().into_owned();
    }
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};
    use renderflow_renderer::verify::scenes::{self, Part};
    use renderflow_scenes::loaded::{Poses, Shape};
    use renderflow_scenes::{Material, Mesh};

    /// The transforms of objects whose instances have the transforms `parts`; the last part of each deforms if that is asked for.
    fn followed(objects: &[(&[Vec<Affine3A>], bool)], numbers: &[usize]) -> Tracks {
        let empty = || Part { mesh: Mesh::default(), material: Material::default(), transform: Affine3A::IDENTITY };
        let count: usize = objects.iter().map(|(parts, _)| parts.len()).sum();
        let parts = (0..count).map(|_| empty()).collect();
        let mut loaded = scenes::scene(parts, vec![], renderflow_frame::Environment::constant([1.0; 3]), Default::default());
        let mut next = 0;
        for (id, (parts, deforms)) in (1..).zip(objects) {
            for transforms in *parts {
                loaded.instances[next].object_id = id;
                loaded.instances[next].transforms.clone_from(transforms);
                next += 1;
            }
            if *deforms {
                let poses = Poses::new(2, vec![0.0, 1.0], Arc::default());
                loaded.meshes[next - 1] = Mesh::default().deformed(&Arc::new(Shape::default()), poses);
            }
        }
        tracks(&loaded, numbers)
    }

    #[test]
    fn objects_are_followed_where_all_of_their_parts_move_alike() {
        let place = |frame: usize, turn: f32| {
            let t = frame as f32;
            Affine3A::from_rotation_translation(Quat::from_rotation_y(turn * t), Vec3::new(3.0 + 0.2 * t, 0.4, -1.0))
        };
        let part = |x: f32, size: f32| {
            let turn = Quat::from_rotation_z(x);
            Affine3A::from_scale_rotation_translation(Vec3::new(size, 2.0 * size, size), turn, Vec3::new(x, 0.3, -x))
        };
        let moving = |turn: f32, part: Affine3A| (0..4).map(|frame| place(frame, turn) * part).collect::<Vec<_>>();
        let [rigid, single] = [moving(0.7, part(0.3, 0.01)), moving(0.0, part(-4.0, 20.0))];
        let parts = [moving(0.7, part(-0.6, 1.0)), moving(0.7, part(0.9, 30.0)), rigid.clone()];
        let apart = [moving(0.7, part(0.3, 1.0)), moving(0.71, part(0.3, 1.0))];
        let half = [single.clone(), vec![part(0.3, 1.0)]];
        let still = [vec![part(0.3, 1.0)], vec![part(0.9, 1.0)]];
        let found = followed(
            &[
                (&parts, false),
                (std::slice::from_ref(&single), false),
                (&apart, false),
                (&half, false),
                (&still, false),
                (&still, true),
                (&parts, true),
            ],
            &[0, 2, 3],
        );
        let kept = |track: &[Affine3A]| [0, 2, 3].map(|frame: usize| track[frame]).to_vec();
        let expected = [(1, kept(&rigid)), (2, kept(&single)), (3, vec![]), (4, vec![]), (6, vec![]), (7, vec![])];
        assert_eq!(found.objects, BTreeMap::from(expected));
        // A part that is flat at the first frame is followed by itself, and no other is known to move along with it.
        let mut flat = single.clone();
        flat[0] = Affine3A::from_scale(Vec3::ZERO);
        let alone = [flat.clone()];
        let found = followed(&[(&alone, false), (&[single, flat.clone()], false)], &[0, 1]);
        assert_eq!(found.objects, BTreeMap::from([(1, flat[..2].to_vec()), (2, vec![])]));
    }
}
