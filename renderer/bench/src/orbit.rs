//! `renderflow-bench orbit`: what a frame of a sequence costs against a frame alone.

use super::stages::{self, Stages, timed};
use super::{Machine, scenes};
use anyhow::Result;
use clap::Args;
use glam::{Affine3A, Quat, Vec3A};
use renderflow::metrics::median;
use renderflow::util::clock::Spent;
use renderflow::util::progress::Progress;
use renderflow_frame::file;
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::LoadedScene;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// Frames of a whole turn.
const TURN: f32 = 100.0;

/// The cost of a frame of a sequence, by stage, against a frame rendered alone. Writes orbit.json and prints tables.
#[derive(Args)]
#[command(after_help = "Example: renderflow-bench orbit --frames 100 --out bench")]
pub struct Options {
    /// Scene of the set (`renderflow-bench scenes`), scene file or model; may be given several times
    #[arg(long, default_values_t = ["soft_sun".to_owned(), "million".to_owned()], value_name = "NAME|FILE")]
    scene: Vec<String>,
    /// Frames of each sequence; 100 are a whole turn
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(2..=10_000))]
    frames: u32,
    /// Frames rendered alone; medians are shown
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Pixels along both sides
    #[arg(long, default_value_t = scenes::RESOLUTION, value_parser = clap::value_parser!(u32).range(1..=16384))]
    resolution: u32,
    /// Samples a pixel
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    spp: u32,
    /// Folder for the results
    #[arg(long, default_value = "bench")]
    out: PathBuf,
}

/// The JSON file.
#[derive(Serialize)]
struct Results {
    machine: Machine,
    resolution: u32,
    spp: u32,
    sequences: Vec<Sequence>,
}

/// One sequence.
#[derive(Serialize)]
struct Sequence {
    scene: String,
    /// What changes from frame to frame.
    motion: &'static str,
    triangles: usize,
    frames: u32,
    /// A frame alone, everything included: medians.
    alone: Stages,
    /// A frame of the sequence: the mean, loading and compiling shared out.
    frame: Stages,
    /// Share of the time of a frame alone that a frame of the sequence does not take.
    saved: f64,
    /// The same of processor seconds.
    processor_saved: Option<f64>,
}

/// `loaded` seen by a camera that goes around it, 3.6 degrees a frame.
pub(super) fn orbit(loaded: &LoadedScene, frames: usize) -> LoadedScene {
    let mut scene = loaded.clone();
    let camera = loaded.cameras[0];
    let centre = Affine3A::from_translation((-loaded.origin).as_vec3());
    scene.cameras = (0..frames)
        .map(|frame| {
            let turn = Quat::from_rotation_y(std::f32::consts::TAU / TURN * frame as f32);
            let around = centre * Affine3A::from_quat(turn) * centre.inverse();
            renderflow_frame::Camera { camera_to_world: around * camera.camera_to_world, ..camera }
        })
        .collect();
    scene
}

/// `loaded` with every third object but the first, which is the ground, on its way and turning.
pub(super) fn moving(loaded: &LoadedScene, frames: usize) -> LoadedScene {
    let mut scene = loaded.clone();
    scene.cameras = vec![loaded.cameras[0]; frames];
    for (i, instance) in scene.instances.iter_mut().enumerate().filter(|(i, _)| i % 3 == 1) {
        let (sin, cos) = (2.4 * i as f32).sin_cos();
        let start = instance.transforms[0];
        instance.transforms = (0..frames)
            .map(|frame| {
                let frame = frame as f32;
                let mut moved = Affine3A::from_quat(Quat::from_rotation_y(0.06 * frame)) * start;
                moved.translation = start.translation + Vec3A::new(cos, 0.0, sin) * (0.01 * frame);
                moved
            })
            .collect();
    }
    scene
}

impl Options {
    /// Measures all sequences.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let mut sequences = Vec::new();
        for name in &self.scene {
            for (motion, move_it) in [("camera", orbit as fn(&LoadedScene, usize) -> LoadedScene), ("objects", moving)] {
                let measured = self.sequence(name, motion, move_it, allowed, cancel)?;
                println!("{}", table(&measured));
                sequences.push(measured);
            }
        }
        let results = Results { machine: Machine::current(), resolution: self.resolution, spp: self.spp, sequences };
        let path = self.out.join("orbit.json");
        file::write_json(&path, &results)?;
        println!("{}", path.display());
        Ok(())
    }

    fn sequence(
        &self,
        name: &str,
        motion: &'static str,
        move_it: fn(&LoadedScene, usize) -> LoadedScene,
        allowed: &[PathBuf],
        cancel: &AtomicBool,
    ) -> Result<Sequence> {
        let settings = Settings { spp: self.spp, ..Settings::default() };
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("frame.exr");
        let open = || Ok(move_it(&scenes::open(name, Some(self.resolution), allowed)?.loaded, self.frames as usize));
        let progress = Progress::new(&format!("{name}, {motion}"), u64::from(self.repeats + self.frames));

        let mut alone = Vec::new();
        // A frame from the middle, so that going there counts. The first run warms the tables of the process and is not counted.
        for run in 0..=self.repeats {
            let mut stages = Stages::default();
            let (loaded, spent) = timed(open)?;
            stages.load = spent;
            let (mut scene, spent) = timed(|| Ok(RenderScene::compile(&loaded)?))?;
            stages.compile = spent;
            let (_, spent) = timed(|| {
                scene.set_frame(self.frames as usize / 2);
                Ok(())
            })?;
            stages.place = spent;
            let (mut denoiser, opening) = timed(|| stages::denoiser(&settings))?;
            stages::frame(&scene, &settings, denoiser.as_mut(), &path, &mut stages, cancel)?;
            stages.denoise = stages.denoise + opening;
            if run > 0 {
                alone.push(stages);
                progress.add(1);
            }
        }

        let (loaded, load) = timed(open)?;
        let (mut scene, compile) = timed(|| Ok(RenderScene::compile(&loaded)?))?;
        let (mut denoiser, opening) = timed(|| stages::denoiser(&settings))?;
        let mut all = vec![Stages { load, compile, denoise: opening, ..Stages::default() }];
        for frame in 0..self.frames as usize {
            let mut stages = Stages::default();
            let (_, spent) = timed(|| {
                scene.set_frame(frame);
                Ok(())
            })?;
            stages.place = spent;
            stages::frame(&scene, &settings, denoiser.as_mut(), &path, &mut stages, cancel)?;
            all.push(stages);
            progress.add(1);
        }
        progress.finish();

        let alone = Stages::combine(&alone, middle);
        let frame =
            Stages::combine(&all, |list| list.iter().fold(Spent::NONE, |sum, s| sum + *s).times(1.0 / f64::from(self.frames)));
        let (one, mean) = (alone.total(), frame.total());
        Ok(Sequence {
            scene: name.to_owned(),
            motion,
            triangles: scene.triangle_count(),
            frames: self.frames,
            alone,
            frame,
            saved: 1.0 - mean.seconds / one.seconds,
            processor_saved: mean.processor.zip(one.processor).map(|(mean, one)| 1.0 - mean / one),
        })
    }
}

/// Medians of both times.
pub(super) fn middle(list: &[Spent]) -> Spent {
    let processor: Option<Vec<f64>> = list.iter().map(|s| s.processor).collect();
    Spent { seconds: median(&list.iter().map(|s| s.seconds).collect::<Vec<_>>()), processor: processor.map(|list| median(&list)) }
}

fn table(sequence: &Sequence) -> String {
    let Sequence { scene, motion, triangles, frames, alone, frame, .. } = sequence;
    let mut text = format!("{scene}: {frames} frames, {motion} moving, {triangles} triangles\n");
    text += &format!("{:>10}  {:>12}  {:>12}  {:>12}  {:>12}\n", "ms", "alone", "in sequence", "alone, cpu", "in seq., cpu");
    let all = ("total", alone.total(), frame.total());
    let rows = alone.list().into_iter().zip(frame.list()).map(|((stage, alone), (_, frame))| (stage, alone, frame));
    for (stage, alone, frame) in rows.chain([all]) {
        let cpu = [alone, frame].map(|s| s.processor.map_or_else(|| "-".into(), |p| format!("{:.2}", 1e3 * p)));
        let wall = [alone, frame].map(|s| 1e3 * s.seconds);
        text += &format!("{stage:>10}  {:>12.2}  {:>12.2}  {:>12}  {:>12}\n", wall[0], wall[1], cpu[0], cpu[1]);
    }
    let cpu = sequence.processor_saved.map_or_else(String::new, |share| format!(", {:.1} % of processor time", 100.0 * share));
    text + &format!("saved: {:.1} % of wall time{cpu}\n", 100.0 * sequence.saved)
}
