//! `renderflow-bench frame`: where the time of one frame with everything goes.

use super::orbit::middle;
use super::reference::{Reference, References, raw};
use super::stages::{self, Stages, timed};
use super::{Machine, scenes};
use anyhow::Result;
use clap::Args;
use renderflow::metrics::median;
use renderflow::metrics::relmse::relmse;
use renderflow::util::clock::Spent;
use renderflow::util::progress::Progress;
use renderflow_frame::file;
use renderflow_frame::image::Rgb;
use renderflow_frame::reach::Reach;
use renderflow_renderer::{Budget, RenderScene, Settings};
use renderflow_scenes::LoadedScene;
use renderflow_scenes::load;
use renderflow_scenes::procedural::{Composition, Split, compose_one};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// A frame with all channels, denoised and written: seconds by stage, error, and the share of pixels that show geometry; once
/// with even samples and once with as many adaptive ones as make the same error. Writes frame.json and prints a table.
#[derive(Args)]
#[command(after_help = "Example: renderflow-bench frame --out bench")]
pub struct Options {
    /// Seed of a composed scene; may be given several times
    #[arg(long, default_values_t = [1, 2, 3, 4])]
    seed: Vec<u64>,
    /// Scene of the set, scene file or model beside those; may be given several times
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
    /// Seconds of all stages over those of the uniform row.
    ratio: f64,
    /// The same of processor seconds.
    processor_ratio: Option<f64>,
}

impl Row {
    /// Medians of seconds and means of errors; ratios are to `uniform`, or 1.
    fn new(scene: &str, method: &'static str, runs: &[Run], reference: &Reference, uniform: Option<&Self>) -> Result<Self> {
        let error = |pictures: Vec<&Rgb>| -> Result<f64> {
            let errors = pictures.iter().map(|p| Ok(relmse(p, &reference.mean, Some(&reference.variance))?.mean));
            Ok(errors.collect::<Result<Vec<f64>>>()?.iter().sum::<f64>() / pictures.len() as f64)
        };
        let denoised: Option<Vec<_>> = runs.iter().map(|run| run.denoised.as_ref()).collect();
        let stages = Stages::combine(&runs.iter().map(|run| run.stages).collect::<Vec<_>>(), middle);
        let total = stages.total();
        let than = uniform.map_or(total, |row| row.stages.total());
        Ok(Self {
            scene: scene.into(),
            method,
            hits: median(&runs.iter().map(|run| run.hits).collect::<Vec<_>>()),
            spp: runs.iter().map(|run| run.spp).sum::<f64>() / runs.len() as f64,
            stages,
            relmse: error(runs.iter().map(|run| &run.raw).collect())?,
            denoised: denoised.map(error).transpose()?,
            ratio: total.seconds / than.seconds,
            processor_ratio: total.processor.zip(than.processor).map(|(a, b)| a / b),
        })
    }
}

impl Options {
    /// Measures all scenes.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let settings = Settings { spp: self.spp, ..Settings::default() };
        let references = References { folder: self.out.join("references"), spp: self.reference_spp, settings };
        let mut rows = Vec::new();
        println!("{}", heading());
        let composed = self.seed.iter().map(|seed| (format!("composed_{seed}"), Some(*seed)));
        let scenes: Vec<_> = composed.chain(self.scene.iter().map(|name| (name.clone(), None))).collect();
        for (name, seed) in scenes {
            let open = || match seed {
                Some(seed) => self.composed(seed),
                None => Ok(scenes::open(&name, Some(self.resolution), allowed)?.loaded),
            };
            let stem = Path::new(&name).file_stem().map_or_else(|| name.clone(), |stem| stem.to_string_lossy().into_owned());
            let (loaded, load) = timed(open)?;
            let progress = Progress::new(&format!("{stem}: reference"), references.total_spp().into());
            let reference = references.get(&stem, &loaded, &|done| progress.set(done), cancel)?;
            progress.finish();
            let measure = |settings: Settings| self.runs(&loaded, load, &settings, cancel);
            let uniform = Row::new(&stem, "uniform", &measure(settings)?, &reference, None)?;
            println!("{}", line(&uniform));
            // Error falls about as one over the samples: half as many tell how many make the same error.
            let average = |spp: f64| Settings { spp: step(spp, 2 * self.spp), budget: Budget::Average, ..settings };
            let tried = Row::new(&stem, "adaptive", &measure(average(0.5 * f64::from(self.spp)))?, &reference, Some(&uniform))?;
            let adaptive = measure(average(tried.spp * tried.relmse / uniform.relmse))?;
            let adaptive = Row::new(&stem, "adaptive", &adaptive, &reference, Some(&uniform))?;
            println!("{}", line(&adaptive));
            rows.extend([uniform, adaptive]);
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
        let scene = compose_one(seed, Split::Test, resolution, 1, &Composition::default())?;
        Ok(load::load(&scene, &Reach::folder("."))?)
    }

    /// A frame for each of the seeds.
    fn runs(&self, loaded: &LoadedScene, load: Spent, settings: &Settings, cancel: &AtomicBool) -> Result<Vec<Run>> {
        let run = |seed: u32| {
            let (scene, compile) = timed(|| Ok(RenderScene::compile(loaded)?.with_seed(seed.into())))?;
            frame(&scene, settings, Stages { load, compile, ..Stages::default() }, cancel)
        };
        (0..self.repeats).map(run).collect()
    }
}

/// The number of samples next to `spp` that adaptive sampling can spread well, at most `most`.
fn step(spp: f64, most: u32) -> u32 {
    // What an error that is not known gives becomes the least number.
    8 * ((spp / 8.0).round().min(f64::from(most / 8)) as u32).max(1)
}

/// One frame, denoised and written.
fn frame(scene: &RenderScene, settings: &Settings, mut stages: Stages, cancel: &AtomicBool) -> Result<Run> {
    let folder = tempfile::tempdir()?;
    let mut denoiser = stages::denoiser(settings)?;
    let path = folder.path().join("frame.exr");
    let (mut frame, stats) = stages::frame(scene, settings, denoiser.as_mut(), &path, &mut stages, cancel)?;
    let pixels = frame.width * frame.height;
    let hits = frame.depth.pixels.iter().filter(|depth| depth.is_finite()).count();
    let denoised = if frame.info.denoiser.is_some() { frame.beauty.take() } else { None };
    Ok(Run { stages, hits: hits as f64 / pixels as f64, spp: stats.samples as f64 / pixels as f64, raw: raw(frame)?, denoised })
}

/// One frame.
struct Run {
    stages: Stages,
    hits: f64,
    spp: f64,
    raw: Rgb,
    denoised: Option<Rgb>,
}

fn heading() -> String {
    let stages = Stages::default().list().map(|(stage, _)| format!("{stage:>8}")).join("  ");
    format!(
        "{:12}  {:8}  {:>5}  {:>6}  {stages}  {:>8}  {:>8}  {:>9}  {:>9}  {:>6}  {:>6}",
        "scene", "method", "hits", "spp", "seconds", "cpu s", "relMSE", "denoised", "ratio", "cpu"
    )
}

fn line(row: &Row) -> String {
    let stages = row.stages.list().map(|(_, spent)| format!("{:>8.3}", spent.seconds)).join("  ");
    let total = row.stages.total();
    let cpu = total.processor.map_or_else(|| "-".into(), |p| format!("{p:.3}"));
    let ratio = row.processor_ratio.map_or_else(|| "-".into(), |r| format!("{r:.3}"));
    let denoised = row.denoised.map_or_else(|| "-".into(), |e| format!("{e:.2e}"));
    format!(
        "{:12}  {:8}  {:>5.3}  {:>6.1}  {stages}  {:>8.3}  {cpu:>8}  {:>9.2e}  {denoised:>9}  {:>6.3}  {ratio:>6}",
        row.scene, row.method, row.hits, row.spp, total.seconds, row.relmse, row.ratio
    )
}
