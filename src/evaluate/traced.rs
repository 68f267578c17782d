//! Path tracing for the rows that have it: samples with no more channels than a row needs, those of neighbouring frames carried along, the
//! denoiser, and the seconds of all of it.

use super::fused::Fused;
use super::method::Method;
use super::renderer::{Options, timed};
use super::results::BUDGET_PIXELS;
use super::tracing::{Clean, Guides, Neighbours, REACH, Samples, Tracing};
use crate::dataset::SequenceFolder;
use crate::truth::Interrupted;
use anyhow::{Context, Result};
use glam::Mat3A;
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;
use renderflow_frame::{Frame, FrameInfo, warp};
use renderflow_renderer::denoise::{self, Denoiser, Quality};
use renderflow_renderer::{Channels, RenderScene, Settings, render, render_gbuffer};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Samples a pixel of the two renders from which the time of any number is told.
const PROBES: [u32; 2] = [2, 16];
/// Camera rays a pixel, neighbours' included, from which on OIDN is told that guides are clean. Told so, it keeps what noise they have; on 32
/// frames of the synthetic set not telling it is worth 1.6 dB at one ray and .2 at two, and costs .35 dB at four.
const CLEAN_GUIDES: u32 = 4;
/// Largest number of samples a pixel that seconds are turned into.
const MOST: u32 = 65536;

/// What is filled beside the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Needs {
    /// Guides of the samples' own camera rays.
    guides: bool,
    /// What the pixels' centres see.
    surfaces: bool,
}

impl Needs {
    fn of(tracing: &Tracing) -> Self {
        // Samples are divided by the albedo that they saw.
        if tracing.clean.is_neural() {
            return Self { guides: true, surfaces: false };
        }
        // A G-buffer has both.
        let own = tracing.guides == Guides::Own;
        Self { guides: own && tracing.clean != Clean::Raw, surfaces: own && tracing.neighbours != Neighbours::Alone }
    }
}

/// A denoiser, and whether it is told that the guides are clean.
type Effort = (Clean, bool);

/// Samples of one frame.
pub struct Traced {
    pub raw: Rgb,
    /// Coverage by their camera rays.
    pub alpha: Image<f32>,
    /// Albedo and normal over the pixels, where they were asked for.
    pub guides: Option<[Rgb; 2]>,
    /// Samples a pixel.
    pub spp: u32,
    seconds: f64,
    /// Whether it is kept for the frames near by.
    carried: bool,
}

/// The G-buffer of the frame that is painted, and its seconds.
#[derive(Clone, Copy)]
pub struct Buffer<'a> {
    /// Index among the stored frames.
    pub index: usize,
    /// With its camera.
    pub frame: &'a Frame,
    /// Wall seconds.
    pub seconds: f64,
}

/// Everything that lasts for a sequence.
pub struct Tracer<'a> {
    folder: &'a SequenceFolder,
    max_bounces: u32,
    /// By effort, and by whether they are told that the guides are clean.
    denoisers: BTreeMap<(Quality, bool), Denoiser>,
    /// Seconds of path tracing with 0 samples, and of each more.
    rates: BTreeMap<Needs, [f64; 2]>,
    /// Seconds of each denoiser so far.
    denoised: BTreeMap<Effort, Vec<f64>>,
    /// Seconds of carrying and adding up neighbours' samples so far.
    gathered: BTreeMap<Neighbours, Vec<f64>>,
    /// Samples a pixel of each frame for the rows that are given seconds: once traced, a frame is not traced again.
    counts: BTreeMap<(String, usize), u32>,
    /// By index of the frame, what was filled, samples a pixel.
    traced: BTreeMap<(usize, Needs, u32), Traced>,
    /// What the pixels' centres see of frames whose samples are carried.
    surfaces: BTreeMap<usize, Frame>,
}

impl<'a> Tracer<'a> {
    /// Opens the denoisers that the methods ask for.
    pub fn new(folder: &'a SequenceFolder, options: &Options) -> Result<Self> {
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
            folder,
            max_bounces: options.max_bounces,
            denoisers,
            rates: BTreeMap::new(),
            denoised: BTreeMap::new(),
            gathered: BTreeMap::new(),
            counts: BTreeMap::new(),
            traced: BTreeMap::new(),
            surfaces: BTreeMap::new(),
        })
    }

    /// What the first frame would pay for all: caches, the denoisers' networks; and how path tracing's time grows with the samples.
    pub fn warm_up(
        &mut self,
        scene: &mut RenderScene,
        methods: &[Method],
        buffer: Buffer,
        fused: Option<&Fused>,
        cancel: &AtomicBool,
    ) -> Result<()> {
        for needs in tracings(methods).map(Needs::of) {
            if self.rates.contains_key(&needs) {
                continue;
            }
            let mut seconds = [0.0; 2];
            // The first round warms the caches, the second counts.
            for _ in 0..2 {
                for (seconds, spp) in seconds.iter_mut().zip(PROBES) {
                    *seconds = self.trace(scene, buffer.index, needs, spp, cancel)?.seconds;
                }
            }
            let each = ((seconds[1] - seconds[0]) / f64::from(PROBES[1] - PROBES[0])).max(1e-6);
            self.rates.insert(needs, [(seconds[0] - f64::from(PROBES[0]) * each).max(0.0), each]);
        }
        for tracing in tracings(methods) {
            let frames = 1 + tracing.neighbours.of(buffer.index, self.folder.len()).len();
            for spp in [1, CLEAN_GUIDES] {
                let effort = effort(tracing, frames as u32 * camera_rays(spp));
                let known = self.denoised.contains_key(&effort) || tracing.clean == Clean::Raw;
                if known && (tracing.neighbours == Neighbours::Alone || self.gathered.contains_key(&tracing.neighbours)) {
                    continue;
                }
                let probe = Tracing { samples: Samples::Count(spp), ..tracing.clone() };
                // The first run of a denoiser builds its network.
                for _ in 0..2 {
                    self.denoised.remove(&effort);
                    self.gathered.remove(&tracing.neighbours);
                    self.picture(scene, &probe, None, buffer, fused, cancel)?;
                }
            }
        }
        self.traced.clear();
        Ok(())
    }

    /// The picture that `tracing` makes of the frame of `buffer`, its seconds and its samples a pixel; `given` are the seconds of the
    /// method that it may take as long as. Leaves `scene` at that frame.
    pub fn picture(
        &mut self,
        scene: &mut RenderScene,
        tracing: &Tracing,
        given: Option<f64>,
        buffer: Buffer,
        fused: Option<&Fused>,
        cancel: &AtomicBool,
    ) -> Result<(Rgb, f64, u32)> {
        let needs = Needs::of(tracing);
        let others = tracing.neighbours.of(buffer.index, self.folder.len());
        let frames: Vec<usize> = std::iter::once(buffer.index).chain(others).collect();
        let mut keys = Vec::with_capacity(frames.len());
        for &index in &frames {
            let spp = self.count(tracing, index, given, buffer);
            let key = (index, needs, spp);
            if !self.traced.contains_key(&key) {
                let traced = self.trace(scene, index, needs, spp, cancel)?;
                self.learn(needs, &traced);
                self.traced.insert(key, traced);
            }
            if let Some(traced) = self.traced.get_mut(&key) {
                traced.carried |= tracing.neighbours != Neighbours::Alone;
            }
            keys.push(key);
        }
        if tracing.neighbours != Neighbours::Alone {
            self.see(scene, buffer, &frames)?;
        }
        scene.set_frame(self.folder.numbers[buffer.index]);
        if tracing.clean.is_neural() {
            let network = fused.context("the methods need weights of the network that reads samples (--weights)")?;
            // Taken out for as long as samples are borrowed.
            let key = tracing.clean.oidn().map(|quality| (quality, true));
            let mut denoiser = key.and_then(|key| self.denoisers.remove(&key));
            let own = &self.traced[&keys[0]];
            let (others, gathering) = timed(|| Ok(self.carried(&keys)))?;
            let others: Vec<(usize, Carried)> = keys[1..].iter().map(|key| key.0).zip(others).collect();
            let drawn = network.traced(buffer, own, &others, tracing.keyframes, denoiser.as_mut());
            let (seconds, spp) = (own.seconds, own.spp);
            self.denoisers.extend(key.zip(denoiser));
            let (picture, drawing) = drawn?;
            self.denoised.entry((tracing.clean, true)).or_default().push(gathering + drawing);
            return Ok((picture, seconds + buffer.seconds + gathering + drawing, spp));
        }
        let own = &self.traced[&keys[0]];
        let mut seconds = own.seconds;
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

    /// Forgets what frame `index`, which is next, and those after it cannot ask for.
    pub fn forget_before(&mut self, index: usize) {
        let near = |other: usize| other + REACH >= index;
        self.traced.retain(|(other, ..), traced| near(*other) && traced.carried);
        self.surfaces.retain(|other, _| near(*other));
        self.counts.retain(|(_, other), _| near(*other));
    }

    /// Path-traces a frame with what is needed of it.
    fn trace(&mut self, scene: &mut RenderScene, index: usize, needs: Needs, spp: u32, cancel: &AtomicBool) -> Result<Traced> {
        let channels = Channels { gbuffer: needs.surfaces, guides: needs.guides, ..Channels::BEAUTY };
        let settings = Settings { spp, max_bounces: self.max_bounces, channels, ..Settings::default() };
        scene.set_frame(self.folder.numbers[index]);
        let rendered = timed(|| Ok(render(scene, &settings, &|_, _| (), cancel)?));
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let (mut frame, seconds) = rendered?;
        let raw = frame.raw.take().context("the path tracer made no picture")?;
        let alpha = std::mem::take(&mut frame.alpha);
        let guides = frame.guide_albedo.take().zip(frame.guide_normal.take()).map(|(albedo, normal)| [albedo, normal]);
        if needs.surfaces {
            self.surfaces.entry(index).or_insert_with(|| surface(&frame));
        }
        Ok(Traced { raw, alpha, guides: guides.filter(|_| needs.guides), spp, seconds, carried: false })
    }

    /// What the pixels' centres see of `frames`. Where their samples did not tell, they have G-buffers, which their own rows pay for.
    fn see(&mut self, scene: &mut RenderScene, buffer: Buffer, frames: &[usize]) -> Result<()> {
        let channels = Channels { gbuffer: true, ..Channels::BEAUTY };
        for &index in frames {
            if self.surfaces.contains_key(&index) {
                continue;
            }
            let seen = if index == buffer.index {
                surface(buffer.frame)
            } else {
                scene.set_frame(self.folder.numbers[index]);
                let frame = render_gbuffer(scene, &Settings { guide_samples: 1, channels, ..Settings::default() })?;
                surface(&frame)
            };
            self.surfaces.insert(index, seen);
        }
        Ok(())
    }

    /// Samples of the first frame with those of the others added, as many as each has; and its guides likewise.
    fn gather(&self, keys: &[(usize, Needs, u32)]) -> (Rgb, Option<[Rgb; 2]>) {
        add_up(&self.traced[&keys[0]], &self.carried(keys), &self.surfaces[&keys[0].0].object_id)
    }

    /// Samples of all but the first frame, to be carried to it.
    fn carried(&self, keys: &[(usize, Needs, u32)]) -> Vec<Carried<'_>> {
        if keys.len() < 2 {
            return Vec::new();
        }
        let index = keys[0].0;
        let current = &self.surfaces[&index];
        let others = keys[1..].iter().map(|key| {
            let there = &self.surfaces[&key.0];
            let movement = self.folder.sequence.tracks.between(index, key.0);
            let cameras = [index, key.0].map(|index| self.folder.camera(index).camera_to_world.matrix3);
            Carried {
                samples: &self.traced[key],
                source: warp::nearest(current, there, Some(&|id| movement.of(id))),
                movement,
                turn: cameras[0].inverse() * cameras[1],
                to_world: cameras[1],
            }
        });
        others.collect()
    }

    /// Samples a pixel for frame `index`: those of the row, or what its seconds allow.
    fn count(&mut self, tracing: &Tracing, index: usize, given: Option<f64>, buffer: Buffer) -> u32 {
        let size = self.folder.camera(index);
        let budget = match tracing.samples {
            Samples::Count(spp) => return spp,
            Samples::Within(milliseconds) => f64::from(milliseconds) / 1e3 * (size.width * size.height) as f64 / BUDGET_PIXELS,
            Samples::AsLongAs(_) => given.unwrap_or(0.0),
        };
        let Some(&rate) = self.rates.get(&Needs::of(tracing)) else { return 1 };
        let usual = |seconds: Option<&Vec<f64>>| seconds.map(|seconds| crate::metrics::median(seconds)).filter(|s| s.is_finite());
        let mut others = usual(self.gathered.get(&tracing.neighbours)).unwrap_or(0.0);
        if tracing.guides == Guides::GBuffer || tracing.clean.is_neural() {
            others += buffer.seconds;
        }
        let frames = 1 + tracing.neighbours.of(index, self.folder.len()).len() as u32;
        let clean = |spp: u32| effort(tracing, frames * camera_rays(spp)).1;
        let after = |clean: bool| usual(self.denoised.get(&(tracing.clean, clean))).unwrap_or(0.0) + others;
        let mut spp = affordable(budget - after(true), rate);
        if !clean(spp) {
            // Guides that are not clean are denoised in less time, which is no reason to have more of them than that.
            spp = affordable(budget - after(false), rate);
            while spp > 1 && clean(spp) {
                spp -= 1;
            }
        }
        *self.counts.entry((Method::Traced(tracing.clone()).id(), index)).or_insert(spp)
    }

    /// What a render took says how many samples the next one may have: scenes cost differently from frame to frame.
    fn learn(&mut self, needs: Needs, traced: &Traced) {
        let Some([start, each]) = self.rates.get_mut(&needs) else { return };
        let expected = *start + *each * f64::from(traced.spp);
        let factor = (traced.seconds / expected.max(1e-9)).clamp(0.5, 2.0).sqrt();
        (*start, *each) = (*start * factor, (*each * factor).max(1e-6));
    }
}

/// Camera rays of a picture with this many samples a pixel.
fn camera_rays(spp: u32) -> u32 {
    Settings { spp, ..Settings::default() }.camera_samples()
}

/// How a picture is denoised whose guides are of this many camera rays a pixel.
fn effort(tracing: &Tracing, rays: u32) -> Effort {
    (tracing.clean, tracing.guides == Guides::GBuffer || tracing.clean.is_neural() || rays >= CLEAN_GUIDES)
}

/// The path-traced methods.
pub fn tracings(methods: &[Method]) -> impl Iterator<Item = &Tracing> {
    methods.iter().filter_map(|method| if let Method::Traced(tracing) = method { Some(tracing) } else { None })
}

/// Samples a pixel that `seconds` allow where a render takes `start` seconds and `each` more for a sample; 1 at least.
fn affordable(seconds: f64, [start, each]: [f64; 2]) -> u32 {
    ((seconds - start) / each).floor().clamp(1.0, f64::from(MOST)) as u32
}

/// What samples are carried by, of all that a frame may hold.
fn surface(frame: &Frame) -> Frame {
    Frame {
        width: frame.width,
        height: frame.height,
        albedo: frame.albedo.clone(),
        normal: frame.normal.clone(),
        depth: frame.depth.clone(),
        object_id: frame.object_id.clone(),
        info: FrameInfo { camera: frame.info.camera, ..FrameInfo::default() },
        ..Frame::default()
    }
}

/// Samples of another frame, to be added.
pub struct Carried<'a> {
    pub samples: &'a Traced,
    /// Of each pixel the one there that shows its surface.
    pub source: Image<Option<u32>>,
    /// From here to there.
    movement: Movement<'a>,
    /// From that camera's space to this one's.
    turn: Mat3A,
    /// From that camera's space to the world's.
    to_world: Mat3A,
}

impl Carried<'_> {
    /// From normals of object `id` there, in camera space, to here.
    fn turn(&self, id: u32) -> Mat3A {
        match self.movement.of(id) {
            // Objects move rigidly, or scale evenly.
            Some(motion) => self.turn * self.to_world.inverse() * motion.matrix3.inverse() * self.to_world,
            None => self.turn,
        }
    }
}

/// Means over a frame's own samples and those carried to it, each as often as there are samples of it. `ids` are the objects at the
/// pixels' centres.
fn add_up(own: &Traced, others: &[Carried], ids: &Image<u32>) -> (Rgb, Option<[Rgb; 2]>) {
    let mean = |of: &(dyn Fn(&Traced) -> Option<&Rgb> + Sync), turned: bool| -> Option<Rgb> {
        let picture = of(own)?;
        let mut out = picture.clone();
        let row = |(y, row): (usize, &mut [[f32; 3]])| {
            // The turn of the object that was met last, for each of the others.
            let mut turns: Vec<Option<(u32, Mat3A)>> = vec![None; others.len()];
            for (x, value) in row.iter_mut().enumerate() {
                let i = y * picture.width + x;
                let (mut sum, mut count) = (glam::Vec3A::from_array(*value) * own.spp as f32, own.spp as f32);
                for (other, turn) in others.iter().zip(&mut turns) {
                    let (Some(source), Some(there)) = (other.source.pixels[i], of(other.samples)) else { continue };
                    let mut added = glam::Vec3A::from_array(there.pixels[source as usize]);
                    if turned {
                        let id = ids.pixels[i];
                        let known = turn.filter(|(known, _)| *known == id);
                        let (_, turn) = *turn.insert(known.unwrap_or_else(|| (id, other.turn(id))));
                        added = turn * added;
                    }
                    sum += added * other.samples.spp as f32;
                    count += other.samples.spp as f32;
                }
                *value = (sum / count).to_array();
            }
        };
        out.pixels.par_chunks_mut(picture.width.max(1)).enumerate().for_each(row);
        Some(out)
    };
    let raw = mean(&|traced| Some(&traced.raw), false);
    let albedo = mean(&|traced| traced.guides.as_ref().map(|guides| &guides[0]), false);
    let normal = mean(&|traced| traced.guides.as_ref().map(|guides| &guides[1]), true);
    (raw.unwrap_or_default(), albedo.zip(normal).map(|(albedo, normal)| [albedo, normal]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Quat};
    use renderflow_frame::tracks::Tracks;

    #[test]
    fn samples_fill_the_time() {
        assert_eq!(affordable(1.1, [0.1, 0.01]), 100);
        assert_eq!(affordable(0.5, [0.1, 0.1]), 4);
        // One is the least, even where there is no time for it.
        assert_eq!([affordable(0.05, [0.1, 0.1]), affordable(-1.0, [0.0, 0.1])], [1, 1]);
        assert_eq!(affordable(1e9, [0.0, 1e-6]), MOST);
    }

    #[test]
    fn rows_ask_for_what_they_read() {
        let needs = |id: &str| {
            let Method::Traced(tracing) = Method::parse(id).unwrap() else { unreachable!() };
            let Needs { guides, surfaces } = Needs::of(&tracing);
            [guides, surfaces]
        };
        assert_eq!(needs("pt4"), [false, false]);
        assert_eq!(needs("pt4+oidn"), [true, false]);
        assert_eq!(needs("pt4+oidn+around"), [true, true]);
        // A G-buffer has both.
        assert_eq!([needs("pt4+oidn+gbuffer"), needs("pt4+oidn+gbuffer+before")], [[false; 2]; 2]);
    }

    fn traced(spp: u32, value: f32, normal: [f32; 3]) -> Traced {
        let flat = |value| Rgb::filled(2, 1, value);
        Traced {
            raw: flat([value; 3]),
            alpha: Image::filled(2, 1, 1.0),
            guides: Some([flat([0.5; 3]), flat(normal)]),
            spp,
            seconds: 0.0,
            carried: false,
        }
    }

    #[test]
    fn every_sample_counts_as_much() {
        let (own, other) = (traced(2, 1.0, [0.0, 0.0, 1.0]), traced(6, 5.0, [0.0, 0.0, 1.0]));
        let carried = |source| Carried {
            samples: &other,
            source: Image { width: 2, height: 1, pixels: source },
            movement: Movement::default(),
            turn: Mat3A::from_quat(Quat::from_rotation_y(0.5)),
            to_world: Mat3A::IDENTITY,
        };
        let (raw, guides) = add_up(&own, &[carried(vec![Some(1), None])], &Image::filled(2, 1, 7));
        assert_eq!(raw.pixels, [[4.0; 3], [1.0; 3]]);
        let [albedo, normal] = guides.unwrap();
        assert_eq!(albedo.pixels, [[0.5; 3]; 2]);
        // Six of eight normals are turned with their camera.
        let expected = glam::Vec3A::new(0.75 * 0.5_f32.sin(), 0.0, 0.25 + 0.75 * 0.5_f32.cos());
        assert!(glam::Vec3A::from_array(normal.pixels[0]).abs_diff_eq(expected, 1e-6), "{normal:?}");
        assert_eq!(normal.pixels[1], [0.0, 0.0, 1.0]);
    }

    #[test]
    fn normals_turn_back_with_their_object() {
        // Object 7 turned by 0.3 about y between the frames, the camera by 0.2.
        let place = |angle: f32| Affine3A::from_quat(Quat::from_rotation_y(angle));
        let tracks = Tracks { objects: BTreeMap::from([(7, vec![place(0.1), place(0.4)])]) };
        let cameras = [0.5_f32, 0.7].map(|angle| Mat3A::from_quat(Quat::from_rotation_y(angle)));
        let n_object = glam::Vec3A::new(0.6, 0.0, 0.8);
        let seen = |frame: usize, angle: f32| cameras[frame].inverse() * (place(angle).matrix3 * n_object);
        let samples = traced(1, 0.0, [0.0; 3]);
        let carried = Carried {
            samples: &samples,
            source: Image::filled(2, 1, Some(0)),
            movement: tracks.between(0, 1),
            turn: cameras[0].inverse() * cameras[1],
            to_world: cameras[1],
        };
        assert!((carried.turn(7) * seen(1, 0.4)).abs_diff_eq(seen(0, 0.1), 1e-5));
        // Others stand still in the world.
        assert!((carried.turn(8) * seen(1, 0.4)).abs_diff_eq(seen(0, 0.4), 1e-5));
    }
}
