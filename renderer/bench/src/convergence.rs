//! `renderflow-bench convergence`: seconds against error while samples a pixel double.

mod report;
pub mod results;

use super::reference::{Reference, References, raw};
use super::{Machine, scenes};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use renderflow::metrics::displayed::displayed;
use renderflow::metrics::relmse::{RelMse, reference_noise, relmse};
use renderflow::util::cancel::Interrupted;
use renderflow::util::clock::Stopwatch;
use renderflow::util::progress::Progress;
use renderflow::util::ranges::within;
use renderflow_frame::file;
use renderflow_renderer::{Budget, RenderScene, Settings, Stats, render_with_stats};
use renderflow_scenes::LoadedScene;
use results::{Conditions, Results, Run, SceneResult};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// The error that times are compared at.
pub const GOAL: f64 = 1e-2;

/// A way to spend samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The same number of samples in every pixel
    Uniform,
    /// As many on average, more where the picture is noisier
    Adaptive,
}

impl Method {
    fn name(self) -> &'static str {
        match self {
            Self::Uniform => "uniform",
            Self::Adaptive => "adaptive",
        }
    }

    fn settings(self, spp: u32, max_bounces: u32) -> Settings {
        let budget = match self {
            Self::Uniform => Budget::Uniform,
            Self::Adaptive => Budget::Average,
        };
        Settings { spp, max_bounces, budget, ..Settings::default() }
    }
}

/// Time against error over samples a pixel. Writes convergence.json and plots; run again with the same settings, it goes on
/// where it was stopped.
#[derive(Args)]
#[command(after_help = "Examples:\n  renderflow-bench convergence --out bench\n  \
    renderflow-bench convergence --scene soft_sun --scene my/scene.json --resolution 256 --max-spp 256 --out bench_small")]
pub struct Options {
    /// Scene of the set (`renderflow-bench scenes`; `composed` stands for sixteen), scene file or model; may be given several
    /// times. Without it all of the set but the composed ones
    #[arg(long, value_name = "NAME|FILE")]
    scene: Vec<String>,
    /// Pixels along both sides
    #[arg(long, default_value_t = scenes::RESOLUTION, value_parser = clap::value_parser!(u32).range(1..=16384))]
    resolution: u32,
    /// Samples a pixel to start with
    #[arg(long, default_value_t = 4, value_parser = within(Settings::SPP))]
    min_spp: u32,
    /// Samples a pixel to stop at
    #[arg(long, default_value_t = 1024, value_parser = within(Settings::SPP))]
    max_spp: u32,
    /// Pictures of every row, each with its own seed: median seconds, mean errors
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Samples a pixel of the references
    #[arg(long, default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..=1 << 24))]
    reference_spp: u32,
    /// Scattering events of a path
    #[arg(long, default_value_t = Settings::default().max_bounces, value_parser = within(Settings::MAX_BOUNCES))]
    max_bounces: u32,
    /// Ways to spend samples; may be given several times
    #[arg(long, value_enum, default_values_t = [Method::Uniform, Method::Adaptive])]
    method: Vec<Method>,
    /// Folder for results and, in `references`, the references
    #[arg(long, default_value = "bench")]
    out: PathBuf,
    /// Measure everything again (references are kept)
    #[arg(long)]
    again: bool,
}

impl Options {
    /// Measures what is missing, writes the results and prints a table.
    ///
    /// # Errors
    /// When a scene cannot be read, results of other conditions are in the way, or it was interrupted (exit code 75).
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        if self.min_spp > self.max_spp {
            bail!("--min-spp {} is above --max-spp {}", self.min_spp, self.max_spp);
        }
        let names = match self.scene.as_slice() {
            [] => scenes::ALL.iter().map(|scene| scene.name.to_owned()).collect(),
            given => scenes::expand(given),
        };
        names.iter().try_for_each(|name| scenes::exists(name))?;
        let settings = Settings { max_bounces: self.max_bounces, ..Settings::default() };
        let references = References { folder: self.out.join("references"), spp: self.reference_spp, settings };
        let path = self.out.join("convergence.json");
        let mut results = self.earlier(&path, references.total_spp())?;
        let spp: Vec<u32> = self.levels();
        let rounds = u64::from(self.repeats) * self.method.len() as u64;
        let of_scene = u64::from(references.total_spp()) + rounds * spp.iter().map(|&n| u64::from(n)).sum::<u64>();
        let progress = Progress::new("convergence", of_scene * names.len() as u64);
        let mut shown = Vec::new();
        for (number, name) in names.iter().enumerate() {
            let base = of_scene * number as u64;
            let subject = scenes::open(name, Some(self.resolution), allowed)?;
            progress.message(format!("{}: reference", subject.name));
            let tell = |done: u64| progress.set(base + done);
            let reference = references.get(&subject.name, &subject.loaded, &tell, cancel)?;
            let mut measurement = Measurement {
                options: &self,
                spp: &spp,
                loaded: &subject.loaded,
                reference: &reference,
                progress: &progress,
                done: base + u64::from(references.total_spp()),
            };
            shown.push(measurement.scene(&subject.name, &mut results, &path, cancel)?);
        }
        progress.finish();
        let rows: Vec<&SceneResult> = shown.iter().map(|&i| &results.scenes[i]).collect();
        print!("{}", report::table(&rows));
        println!();
        print!("{}", report::summary(&rows));
        let machine = &results.machine;
        for (file, form, title) in [
            ("convergence.svg", (|e: &RelMse| e.mean) as fn(&RelMse) -> f64, "relMSE"),
            ("convergence_trimmed.svg", |e| e.trimmed, "relMSE of the best 99 % of pixels"),
        ] {
            let picture = report::picture(&rows, machine, form, title);
            file::write_atomic(&self.out.join(file), picture.as_bytes())?;
            println!("{}", self.out.join(file).display());
        }
        println!("{}", path.display());
        Ok(())
    }

    /// Samples a pixel by doublings, the last one included.
    fn levels(&self) -> Vec<u32> {
        std::iter::successors(Some(self.min_spp), |n| n.checked_mul(2)).take_while(|&n| n <= self.max_spp).collect()
    }

    fn earlier(&self, path: &Path, reference_spp: u32) -> Result<Results> {
        let conditions = Conditions { resolution: self.resolution, max_bounces: self.max_bounces, reference_spp };
        let fresh = Results { machine: Machine::current(), conditions, scenes: Vec::new() };
        if self.again || !path.exists() {
            return Ok(fresh);
        }
        let found: Results = file::read_json(path).context("not results of this benchmark; choose another folder with --out")?;
        if (&found.machine, &found.conditions) != (&fresh.machine, &fresh.conditions) {
            bail!("{}: measured under other conditions; --again replaces it, --out chooses another folder", path.display());
        }
        Ok(found)
    }
}

/// One scene being measured.
struct Measurement<'a> {
    options: &'a Options,
    spp: &'a [u32],
    loaded: &'a LoadedScene,
    reference: &'a Reference,
    progress: &'a Progress,
    /// Progress so far.
    done: u64,
}

impl Measurement<'_> {
    /// Measures what is missing; returns the scene's place in the results.
    fn scene(&mut self, name: &str, results: &mut Results, path: &Path, cancel: &AtomicBool) -> Result<usize> {
        let at = match results.scenes.iter().position(|s| s.name == name) {
            Some(at) if results.scenes[at].hash == self.loaded.hash => at,
            Some(_) => bail!("{}: holds another scene called {name}; --again replaces it", path.display()),
            None => {
                results.scenes.push(self.describe(name)?);
                results.scenes.len() - 1
            }
        };
        for repeat in 0..self.options.repeats {
            let seed = u64::from(repeat) + 1;
            let mut scene: Option<RenderScene> = None;
            for &spp in self.spp {
                // Methods take turns: what changes on the machine meanwhile meets all of them.
                for &method in &self.options.method {
                    if results.scenes[at].has(method, spp, seed) {
                        self.done += u64::from(spp);
                        self.progress.resume(0);
                        self.progress.set(self.done);
                        continue;
                    }
                    self.progress.message(format!(
                        "{name}: {} {spp} spp, {} of {}",
                        method.name(),
                        repeat + 1,
                        self.options.repeats
                    ));
                    let ready = match &scene {
                        Some(ready) => ready,
                        None => scene.insert(self.ready(seed, cancel)?),
                    };
                    let run = self.measure(ready, method, spp, seed, cancel)?;
                    results.scenes[at].row(method, spp).runs.push(run);
                    results.scenes[at].rows.sort_by_key(|row| (row.method as u32, row.spp));
                    self.done += u64::from(spp);
                    self.progress.set(self.done);
                    // After every picture: an interruption loses the one under way only.
                    file::write_json(path, results)?;
                }
            }
        }
        Ok(at)
    }

    fn describe(&self, name: &str) -> Result<SceneResult> {
        let clock = Stopwatch::start();
        let compiled = RenderScene::compile(self.loaded)?;
        let compile = clock.spent();
        let noise = reference_noise(&self.reference.mean, &self.reference.variance)?;
        Ok(SceneResult {
            name: name.into(),
            hash: self.loaded.hash.clone(),
            triangles: compiled.triangle_count(),
            compile,
            reference_seconds: self.reference.seconds,
            reference_noise: noise.iter().sum::<f64>() / noise.len() as f64,
            rows: Vec::new(),
        })
    }

    /// The scene with `seed`, after a first picture: tables made on first use are not what is measured.
    fn ready(&self, seed: u64, cancel: &AtomicBool) -> Result<RenderScene> {
        let scene = RenderScene::compile(self.loaded)?.with_seed(seed);
        self.render(&scene, &Settings { spp: 1, ..Settings::default() }, &|_, _| (), cancel)?;
        Ok(scene)
    }

    fn render(
        &self,
        scene: &RenderScene,
        settings: &Settings,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<(renderflow_frame::Frame, Stats)> {
        let rendered = render_with_stats(scene, settings, progress, cancel);
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        Ok(rendered?)
    }

    fn measure(&self, scene: &RenderScene, method: Method, spp: u32, seed: u64, cancel: &AtomicBool) -> Result<Run> {
        let tell = |done: u64, total: u64| self.progress.set(self.done + u64::from(spp) * done / total.max(1));
        let settings = method.settings(spp, self.options.max_bounces);
        let clock = Stopwatch::start();
        let (frame, stats) = self.render(scene, &settings, &tell, cancel)?;
        let time = clock.spent();
        let picture = raw(frame)?;
        Ok(Run {
            seed,
            time,
            spp: stats.samples as f64 / picture.pixels.len() as f64,
            stats,
            relmse: relmse(&picture, &self.reference.mean, Some(&self.reference.variance))?,
            displayed: displayed(&picture, &self.reference.mean, scene.exposure())?,
        })
    }
}
