//! `renderflow-bench scaling`: speed over threads, triangles and resolutions; seconds of building and bytes a triangle.

use super::models::{self, Model};
use super::{Machine, scenes};
use anyhow::{Context, Result};
use clap::Args;
use renderflow::metrics::median;
use renderflow::util::cancel::Interrupted;
use renderflow::util::clock::{Spent, Stopwatch};
use renderflow::util::progress::Progress;
use renderflow_frame::file;
use renderflow_renderer::{RenderScene, Settings, Stats, render_with_stats};
use renderflow_scenes::LoadedScene;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Ten million triangles are measured by themselves where this many bytes are free: reading, building and tracing them takes
/// about 4e9.
const ROOMY: u64 = 8 << 30;
/// Edge of the pictures of the rows over triangles, pixels.
const TRIANGLES_RESOLUTION: u32 = 256;

/// Speed over threads, triangles and resolutions. Writes scaling.json and prints tables.
#[derive(Args)]
#[command(after_help = "Example: renderflow-bench scaling --out bench")]
pub struct Options {
    /// Scene of the rows over threads and resolutions: of the set, a scene file or a model
    #[arg(long, default_value = "soft_sun", value_name = "NAME|FILE")]
    scene: String,
    /// Samples a pixel
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    spp: u32,
    /// Pictures of every row; medians are shown
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Largest picture, pixels along both sides
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=16384))]
    max_resolution: u32,
    /// Most triangles; ten million where memory allows, or else one million
    #[arg(long, value_parser = clap::value_parser!(u64).range(1000..=100_000_000))]
    max_triangles: Option<u64>,
    /// Folder for the results
    #[arg(long, default_value = "bench")]
    out: PathBuf,
}

/// The JSON file.
#[derive(Serialize)]
struct Results {
    machine: Machine,
    scene: String,
    spp: u32,
    threads: Vec<ThreadsRow>,
    triangles: Vec<TrianglesRow>,
    resolutions: Vec<ResolutionRow>,
}

/// Rendering, medians of the repeats.
#[derive(Clone, Copy, Serialize)]
struct Speed {
    seconds: f64,
    processor: Option<f64>,
    megasamples: f64,
    megarays: f64,
}

#[derive(Serialize)]
struct ThreadsRow {
    threads: usize,
    #[serde(flatten)]
    speed: Speed,
}

#[derive(Serialize)]
struct TrianglesRow {
    triangles: usize,
    build: Spent,
    /// Trees, and vertex attributes placed for them.
    bytes: usize,
    #[serde(flatten)]
    speed: Speed,
}

#[derive(Serialize)]
struct ResolutionRow {
    resolution: u32,
    #[serde(flatten)]
    speed: Speed,
}

impl Speed {
    fn of(runs: &[(Spent, Stats)]) -> Self {
        let seconds = median(&runs.iter().map(|r| r.0.seconds).collect::<Vec<_>>());
        let processor: Vec<f64> = runs.iter().filter_map(|r| r.0.processor).collect();
        let rate = |count: fn(&Stats) -> u64| 1e-6 * runs.first().map_or(0.0, |r| count(&r.1) as f64) / seconds;
        Self {
            seconds,
            processor: (!processor.is_empty()).then(|| median(&processor)),
            megasamples: rate(|s| s.samples),
            megarays: rate(|s| s.camera_rays + s.bounce_rays + s.shadow_rays),
        }
    }
}

/// 1, 2, 4, ... below `most`, then `most`.
fn doublings(first: u64, most: u64) -> Vec<u64> {
    let mut list: Vec<u64> = std::iter::successors(Some(first), |n| n.checked_mul(2)).take_while(|&n| n < most).collect();
    list.push(most);
    list
}

/// Bytes that programs can still take, `None` where the system does not tell.
fn free_memory() -> Option<u64> {
    let info = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = info.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib << 10)
}

/// A lens of displaced triangles, nearly all of the picture, under the soft sun.
struct Dense {
    loaded: LoadedScene,
    mesh: usize,
}

impl Dense {
    fn new(resolution: u32) -> Result<Self> {
        let loaded = scenes::body_on_plane(resolution).load()?;
        let instance = loaded.instances.iter().find(|i| i.name == scenes::BODY).context("the scene lost its body")?;
        let mesh = instance.mesh;
        Ok(Self { loaded, mesh })
    }

    /// The scene with a body of about `triangles`.
    fn with(&mut self, triangles: u64) -> &LoadedScene {
        let cells = ((triangles as f64 / 2.0).sqrt().round() as usize).max(4);
        let model: Model = models::displaced_sphere(scenes::BODY_RADIUS, cells);
        self.loaded.meshes[self.mesh] = model.into_mesh(scenes::BODY);
        &self.loaded
    }
}

impl Options {
    /// Measures everything, writes the results and prints tables.
    ///
    /// # Errors
    /// When the scene cannot be read, or it was interrupted.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let cores = rayon::current_num_threads() as u64;
        let roomy = free_memory().is_some_and(|free| free >= ROOMY);
        let most = self.max_triangles.unwrap_or(if roomy { 10_000_000 } else { 1_000_000 });
        let sizes: Vec<u64> = (3..=8).map(|decade| 10u64.pow(decade)).take_while(|&n| n <= most).collect();
        let resolutions = doublings(128.min(self.max_resolution.into()), self.max_resolution.into());
        let threads = doublings(1, cores);
        let progress = Progress::new("scaling", (threads.len() + sizes.len() + resolutions.len()) as u64);
        let subject = scenes::open(&self.scene, Some(512.min(self.max_resolution)), allowed)?;
        let mut scene = RenderScene::compile(&subject.loaded)?;

        let threads = self.over_threads(&scene, &threads, &progress, cancel)?;
        let mut dense = Dense::new(TRIANGLES_RESOLUTION.min(self.max_resolution))?;
        let mut triangles = Vec::new();
        for &size in &sizes {
            progress.message(format!("{size} triangles"));
            let loaded = dense.with(size);
            let clock = Stopwatch::start();
            let scene = RenderScene::compile(loaded)?;
            let build = clock.spent();
            let speed = self.speed(&scene, cancel)?;
            triangles.push(TrianglesRow { triangles: scene.triangle_count(), build, bytes: scene.geometry_memory(), speed });
            progress.add(1);
        }
        drop(dense);
        let mut by_size = Vec::new();
        for &size in &resolutions {
            let resolution = size as u32;
            progress.message(format!("{resolution} x {resolution} pixels"));
            scene.set_resolution(resolution as usize, resolution as usize);
            by_size.push(ResolutionRow { resolution, speed: self.speed(&scene, cancel)? });
            progress.add(1);
        }
        progress.finish();
        let results =
            Results { machine: Machine::current(), scene: subject.name, spp: self.spp, threads, triangles, resolutions: by_size };
        let path = self.out.join("scaling.json");
        file::write_json(&path, &results)?;
        print!("{}", tables(&results));
        println!("{}", path.display());
        Ok(())
    }

    /// Rounds over all numbers of threads take turns: what changes on the machine meanwhile meets all of them.
    fn over_threads(
        &self,
        scene: &RenderScene,
        threads: &[u64],
        progress: &Progress,
        cancel: &AtomicBool,
    ) -> Result<Vec<ThreadsRow>> {
        progress.message("threads");
        let pools: Vec<rayon::ThreadPool> = threads
            .iter()
            .map(|&n| rayon::ThreadPoolBuilder::new().num_threads(n as usize).build().context("cannot start threads"))
            .collect::<Result<_>>()?;
        let mut runs = vec![Vec::new(); pools.len()];
        self.picture(scene, 1, cancel)?;
        for round in 0..self.repeats {
            for (pool, runs) in pools.iter().zip(&mut runs) {
                runs.push(pool.install(|| self.picture(scene, self.spp, cancel))?);
                if round == 0 {
                    progress.add(1);
                }
            }
        }
        let row = |(&n, runs): (&u64, &Vec<_>)| ThreadsRow { threads: n as usize, speed: Speed::of(runs) };
        Ok(threads.iter().zip(&runs).map(row).collect())
    }

    fn speed(&self, scene: &RenderScene, cancel: &AtomicBool) -> Result<Speed> {
        self.picture(scene, 1, cancel)?;
        let runs: Vec<_> = (0..self.repeats).map(|_| self.picture(scene, self.spp, cancel)).collect::<Result<_>>()?;
        Ok(Speed::of(&runs))
    }

    fn picture(&self, scene: &RenderScene, spp: u32, cancel: &AtomicBool) -> Result<(Spent, Stats)> {
        let settings = Settings { spp, ..Settings::default() };
        let clock = Stopwatch::start();
        let rendered = render_with_stats(scene, &settings, &|_, _| (), cancel);
        let spent = clock.spent();
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let (_, stats) = rendered?;
        Ok((spent, stats))
    }
}

fn tables(results: &Results) -> String {
    let first = results.threads.first().map_or(f64::NAN, |row| row.speed.seconds);
    let optional = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
    let scene = &results.scene;
    let mut text = format!(
        "{:>10}  {:>8}  {:>8}  {:>7}  {:>7}  {:>8}  ({scene})\n",
        "threads", "seconds", "cpu s", "Msamp/s", "Mrays/s", "speed-up"
    );
    for ThreadsRow { threads, speed } in &results.threads {
        text += &format!(
            "{threads:>10}  {:>8.3}  {:>8}  {:>7.2}  {:>7.2}  {:>8.2}\n",
            speed.seconds,
            optional(speed.processor),
            speed.megasamples,
            speed.megarays,
            first / speed.seconds
        );
    }
    text += &format!(
        "\n{:>10}  {:>8}  {:>8}  {:>7}  {:>7}  {:>8}  {:>7}  {:>10}\n",
        "triangles", "seconds", "cpu s", "Msamp/s", "Mrays/s", "build s", "bytes", "a triangle"
    );
    for row in &results.triangles {
        text += &format!(
            "{:>10}  {:>8.3}  {:>8}  {:>7.2}  {:>7.2}  {:>8.3}  {:>7}  {:>10.1}\n",
            row.triangles,
            row.speed.seconds,
            optional(row.speed.processor),
            row.speed.megasamples,
            row.speed.megarays,
            row.build.seconds,
            short(row.bytes),
            row.bytes as f64 / row.triangles.max(1) as f64,
        );
    }
    text += &format!("\n{:>10}  {:>8}  {:>8}  {:>7}  {:>7}  ({scene})\n", "pixels", "seconds", "cpu s", "Msamp/s", "Mrays/s");
    for ResolutionRow { resolution, speed } in &results.resolutions {
        let pixels = format!("{resolution}^2");
        text += &format!(
            "{pixels:>10}  {:>8.3}  {:>8}  {:>7.2}  {:>7.2}\n",
            speed.seconds,
            optional(speed.processor),
            speed.megasamples,
            speed.megarays
        );
    }
    text
}

/// Bytes with a decimal prefix.
fn short(bytes: usize) -> String {
    let bytes = bytes as f64;
    match bytes {
        b if b >= 1e9 => format!("{:.2} G", b / 1e9),
        b if b >= 1e6 => format!("{:.1} M", b / 1e6),
        b => format!("{:.0} k", b / 1e3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_end_where_they_should() {
        assert_eq!(doublings(1, 1), [1]);
        assert_eq!(doublings(1, 6), [1, 2, 4, 6]);
        assert_eq!(doublings(128, 1024), [128, 256, 512, 1024]);
        assert_eq!([short(900), short(12_300_000), short(2_340_000_000)], ["1 k", "12.3 M", "2.34 G"]);
    }
}
