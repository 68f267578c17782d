//! `renderflow bench frame`: where the time of one frame with everything goes.

use super::metrics::{median, relmse};
use super::orbit::middle;
use super::reference::{References, compile_seeded, raw};
use super::stages::{self, Stages, timed};
use super::{Machine, scenes};
use crate::progress::Progress;
use anyhow::Result;
use clap::Args;
use renderflow_frame::file;
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::LoadedScene;
use renderflow_scenes::load;
use renderflow_scenes::procedural::{ComposeOptions, Split, compose};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// A frame with all channels, denoised and written: seconds by stage, error, and the share of pixels that show geometry. Writes
/// frame.json and prints tables.
#[derive(Args)]
#[command(after_help = "Example: renderflow bench frame --out bench")]
pub struct Options {
    /// Seed of a composed scene; may be given several times
    #[arg(long, default_values_t = [1, 2, 3, 4])]
    seed: Vec<u64>,
    /// Scene of the set or scene file beside those; may be given several times
    #[arg(long, value_name = "NAME|FILE")]
    scene: Vec<String>,
    /// Pixels along both sides
    #[arg(long, default_value_t = scenes::RESOLUTION, value_parser = clap::value_parser!(u32).range(1..=16384))]
    resolution: u32,
    /// Samples a pixel
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    spp: u32,
    /// Frames, each with its own seed; medians of seconds and means of errors are shown
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Samples a pixel of the references
    #[arg(long, default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..=1 << 24))]
    reference_spp: u32,
    /// Folder for results and, in `references`, the references
    #[arg(long, default_value = "bench")]
    out: PathBuf,
}

/// The JSON file.
#[derive(Serialize)]
struct Results {
    machine: Machine,
    resolution: u32,
    reference_spp: u32,
    rows: Vec<Row>,
}

/// One scene, one way to spend samples.
#[derive(Serialize)]
struct Row {
    scene: String,
    method: &'static str,
    /// Share of pixels whose centre shows geometry.
    hits: f64,
    /// Samples a pixel, on average.
    spp: f64,
    stages: Stages,
    /// relMSE of the raw picture, what the reference adds taken off.
    relmse: f64,
    /// Of the denoised picture, if there was a denoiser.
    denoised: Option<f64>,
}

impl Options {
    /// Measures all scenes.
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let settings = Settings { spp: self.spp, ..Settings::default() };
        let references = References { folder: self.out.join("references"), spp: self.reference_spp, settings };
        let mut rows = Vec::new();
        println!("{}", heading());
        let composed = self.seed.iter().map(|seed| (format!("composed_{seed}"), Some(*seed)));
        let scenes: Vec<_> = composed.chain(self.scene.iter().map(|name| (name.clone(), None))).collect();
        for (name, seed) in scenes {
            let open = || match seed {
                Some(seed) => self.composed(seed),
                None => Ok(scenes::open(&name, Some(self.resolution))?.loaded),
            };
            let stem = Path::new(&name).file_stem().map_or_else(|| name.clone(), |stem| stem.to_string_lossy().into_owned());
            let (loaded, load) = timed(open)?;
            let progress = Progress::new(&format!("{stem}: reference"), references.total_spp().into());
            let reference = references.get(&stem, &loaded, &|done| progress.set(done), cancel)?;
            progress.finish();
            let mut runs = Vec::new();
            for run in 0..self.repeats {
                let (scene, compile) = timed(|| compile_seeded(&loaded, u64::from(run)))?;
                runs.push(self.uniform(&scene, &settings, Stages { load, compile, ..Stages::default() }, cancel)?);
            }
            let error = |picture: fn(&Run) -> Option<&renderflow_frame::image::Rgb>| -> Result<Option<f64>> {
                let errors: Option<Vec<_>> = runs.iter().map(picture).collect();
                let Some(pictures) = errors else { return Ok(None) };
                let errors: Result<Vec<f64>> =
                    pictures.iter().map(|p| Ok(relmse(p, &reference.mean, Some(&reference.variance))?.mean)).collect();
                let errors = errors?;
                Ok(Some(errors.iter().sum::<f64>() / errors.len() as f64))
            };
            let row = Row {
                scene: stem,
                method: "uniform",
                hits: median(&runs.iter().map(|run| run.hits).collect::<Vec<_>>()),
                spp: runs.iter().map(|run| run.spp).sum::<f64>() / runs.len() as f64,
                stages: Stages::combine(&runs.iter().map(|run| run.stages).collect::<Vec<_>>(), middle),
                relmse: error(|run| Some(&run.raw))?.unwrap_or(f64::NAN),
                denoised: error(|run| run.denoised.as_ref())?,
            };
            println!("{}", line(&row));
            rows.push(row);
        }
        let machine = Machine::current();
        let results = Results { machine, resolution: self.resolution, reference_spp: references.total_spp(), rows };
        let path = self.out.join("frame.json");
        file::write_json(&path, &results)?;
        println!("{}", path.display());
        Ok(())
    }

    /// A composed scene with light that training never sees.
    fn composed(&self, seed: u64) -> Result<LoadedScene> {
        let resolution = [self.resolution; 2];
        let scene = compose(&ComposeOptions { seed, split: Split::Test, resolution, frames: 1, ..ComposeOptions::default() });
        Ok(load::load(&scene, Path::new("."))?)
    }

    fn uniform(&self, scene: &RenderScene, settings: &Settings, mut stages: Stages, cancel: &AtomicBool) -> Result<Run> {
        let folder = tempfile::tempdir()?;
        let mut denoiser = stages::denoiser(self.spp)?;
        let (mut frame, stats) =
            stages::frame(scene, settings, denoiser.as_mut(), &folder.path().join("frame.exr"), &mut stages, cancel)?;
        let pixels = frame.width * frame.height;
        let hits = frame.depth.pixels.iter().filter(|depth| depth.is_finite()).count();
        let denoised = if frame.info.denoiser.is_some() { frame.beauty.take() } else { None };
        Ok(Run {
            stages,
            hits: hits as f64 / pixels as f64,
            spp: stats.samples as f64 / pixels as f64,
            raw: raw(frame)?,
            denoised,
        })
    }
}

/// One frame.
struct Run {
    stages: Stages,
    hits: f64,
    spp: f64,
    raw: renderflow_frame::image::Rgb,
    denoised: Option<renderflow_frame::image::Rgb>,
}

fn heading() -> String {
    let stages = Stages::default().list().map(|(stage, _)| format!("{stage:>8}")).join("  ");
    format!(
        "{:12}  {:8}  {:>5}  {:>6}  {stages}  {:>8}  {:>8}  {:>9}  {:>9}",
        "scene", "method", "hits", "spp", "seconds", "cpu s", "relMSE", "denoised"
    )
}

fn line(row: &Row) -> String {
    let stages = row.stages.list().map(|(_, spent)| format!("{:>8.3}", spent.seconds)).join("  ");
    let total = row.stages.total();
    let cpu = total.processor.map_or_else(|| "-".into(), |p| format!("{p:.3}"));
    let denoised = row.denoised.map_or_else(|| "-".into(), |e| format!("{e:.2e}"));
    format!(
        "{:12}  {:8}  {:>5.3}  {:>6.1}  {stages}  {:>8.3}  {cpu:>8}  {:>9.2e}  {denoised:>9}",
        row.scene, row.method, row.hits, row.spp, total.seconds, row.relmse
    )
}
