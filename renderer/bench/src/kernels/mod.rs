//! `renderflow-bench kernels`: ray queries on one thread, ours and Embree's by turns on the same rays.

mod find;
pub mod rays;
mod tracers;

use crate::embree::Embree;
use crate::scenes::{self, Subject};
use anyhow::Result;
use clap::Args;
use glam::Vec3A;
use rays::{Kind, Rays};
use renderflow::metrics::median;
use renderflow::util::cancel::Interrupted;
use renderflow::util::clock::{Of, Spent, Stopwatch};
use renderflow::util::progress::Progress;
use renderflow_frame::file;
use renderflow_renderer::accel::Accel;
use renderflow_scenes::LoadedScene;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use tracers::Tracer;

/// Rays a second of the traversal kernels, one thread, by turns with Embree where that is found.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  renderflow-bench kernels\n  renderflow-bench kernels --embree libembree4.so.4 --out kernels.json\n  renderflow-bench kernels --scene forest --scene interior --resolution 512\n\nEmbree 4 comes with `pip install embreex==4.4.0.post1`; docs/benchmarks.md says more."
)]
pub struct Options {
    /// Scene of the set, scene file or model; may be given several times; otherwise forest, million, interior and soft_sun
    #[arg(long, value_name = "NAME|FILE")]
    scene: Vec<String>,
    /// Pixels along both sides: as many primary rays, and about as many of the other kinds
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(8..=4096))]
    resolution: u32,
    /// Times that every tracer casts the rays, by turns; medians are reported
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Embree's shared library; otherwise RENDERFLOW_EMBREE, that of the Python package embreex, or the system's
    #[arg(long, value_name = "PATH")]
    embree: Option<PathBuf>,
    /// Interpreter that is asked for the package embreex
    #[arg(long, default_value = "python3", value_name = "PATH")]
    python: String,
    /// Ours only
    #[arg(long, conflicts_with = "embree")]
    no_embree: bool,
    /// Where to write the results (JSON)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Results of all scenes.
#[derive(Serialize)]
struct Results {
    /// Version of this program.
    version: String,
    /// Processes that ran or waited to run in the minute before, where the system tells.
    load_before: Option<f64>,
    resolution: u32,
    repeats: u32,
    /// Version of Embree, where there was one.
    embree: Option<String>,
    scenes: Vec<SceneResult>,
}

#[derive(Serialize)]
struct SceneResult {
    name: String,
    triangles: usize,
    structures: Vec<Structure>,
    rows: Vec<Row>,
}

/// What a tracer built.
#[derive(Serialize)]
struct Structure {
    tracer: String,
    build_seconds: f64,
    bytes_per_triangle: f64,
}

/// One tracer on one kind of rays.
#[derive(Clone, Serialize)]
struct Row {
    rays: Kind,
    tracer: String,
    count: usize,
    hits: usize,
    /// Rays on which hit or miss differs from our tracer of single rays.
    disagree: usize,
    /// Million rays a second of processor time, median.
    mrays_cpu: f64,
    /// Million rays a second of wall time, median.
    mrays_wall: f64,
    /// Rate against Embree's single rays of this kind; median over the turns of the ratio of processor times.
    ratio: Option<f64>,
    /// The same against our single rays.
    over_ours: f64,
    /// Processor seconds of each turn.
    seconds_cpu: Vec<f64>,
}

/// The scenes unless told otherwise.
const SCENES: [&str; 4] = ["forest", "million", "interior", "soft_sun"];

impl Options {
    /// Measures and prints.
    pub fn run(self, allowed: &[PathBuf], cancel: &AtomicBool) -> Result<()> {
        let embree = if self.no_embree { None } else { find::embree(self.embree.as_deref(), &self.python)? };
        let load_before = load();
        match load_before {
            Some(load) if load > 0.5 => {
                println!("note: the machine was not idle (load {load:.1}): trust ratios, and no rate in wall time");
            }
            _ => {}
        }
        let names: Vec<String> = if self.scene.is_empty() { SCENES.map(str::to_owned).into() } else { self.scene.clone() };
        let progress = Progress::new("kernels", names.len() as u64 * UNITS);
        let mut scenes = Vec::new();
        for (index, name) in names.iter().enumerate() {
            progress.message(name.clone());
            let subject = scenes::open(name, Some(self.resolution), allowed)?;
            let scene = self.measure(subject, embree.as_ref(), &progress, cancel)?;
            progress.set((index as u64 + 1) * UNITS);
            progress.hide(|| print(&scene));
            scenes.push(scene);
        }
        progress.finish();
        if let Some(out) = &self.out {
            let version = env!("CARGO_PKG_VERSION").to_owned();
            let (resolution, repeats, embree) = (self.resolution, self.repeats, embree.as_ref().map(Embree::version));
            file::write_json(out, &Results { version, load_before, resolution, repeats, embree, scenes })?;
        }
        Ok(())
    }

    fn measure(
        &self,
        subject: Subject,
        embree: Option<&Embree>,
        progress: &Progress,
        cancel: &AtomicBool,
    ) -> Result<SceneResult> {
        let Subject { name, loaded: scene } = subject;
        let triangles = flatten(&scene);
        let clock = Stopwatch::start_of(Of::Thread);
        let accel = Accel::build(&triangles);
        let build_seconds = clock.spent().seconds;
        let per_triangle = |bytes: usize| bytes as f64 / triangles.len().max(1) as f64;
        let ours = Structure { tracer: OURS.into(), build_seconds, bytes_per_triangle: per_triangle(accel.memory()) };
        let mut structures = vec![ours];
        let mut built = Vec::new();
        if let Some(embree) = embree {
            for robust in [false, true] {
                let (before, clock) = (embree.memory(), Stopwatch::start_of(Of::Thread));
                let scene = embree.scene(&triangles, robust)?;
                let build_seconds = clock.spent().seconds;
                let bytes_per_triangle = per_triangle(embree.memory().saturating_sub(before));
                structures.push(Structure { tracer: embree_name(embree, robust), build_seconds, bytes_per_triangle });
                built.push((embree_name(embree, robust), scene));
            }
        }
        let mut rows = Vec::new();
        let sets = rays::make(&scene.cameras[0], &triangles, &accel);
        let start = progress.position();
        for (index, set) in sets.iter().enumerate() {
            let mut tracers = tracers::for_rays(set.kind, &accel, &built);
            rows.extend(cast(set, &mut tracers, self.repeats, cancel)?);
            progress.set(start + UNITS * (index as u64 + 1) / sets.len() as u64);
        }
        Ok(SceneResult { name, triangles: triangles.len(), structures, rows })
    }
}

/// Progress units of a scene.
const UNITS: u64 = 100;
/// Our tracer of single rays.
const OURS: &str = "renderflow";

fn embree_name(embree: &Embree, robust: bool) -> String {
    format!("embree {}{}", embree.version(), if robust { " robust" } else { "" })
}

/// Casts `set` with every tracer by turns, `repeats` times after a first time that is not counted. The first tracer is the one
/// that the others are compared with hit by hit.
fn cast(set: &Rays, tracers: &mut [Tracer<'_>], repeats: u32, cancel: &AtomicBool) -> Result<Vec<Row>> {
    let count = set.rays.len();
    let mut found = vec![vec![false; count]; tracers.len()];
    let mut times: Vec<Vec<Spent>> = vec![Vec::new(); tracers.len()];
    for turn in 0..=repeats {
        for ((tracer, found), times) in tracers.iter_mut().zip(&mut found).zip(&mut times) {
            if cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            let clock = Stopwatch::start_of(Of::Thread);
            (tracer.cast)(&set.rays, found);
            if turn > 0 {
                times.push(clock.spent());
            }
        }
    }
    let yardstick = tracers.iter().position(|t| t.yardstick);
    let rate = |seconds: f64| 1e-6 * count as f64 / seconds.max(1e-9);
    let row = |(index, tracer): (usize, &Tracer<'_>)| {
        let middle = |of: &dyn Fn(&Spent) -> f64| median(&times[index].iter().map(of).collect::<Vec<_>>());
        let against = |y: usize| times[index].iter().zip(&times[y]).map(|(t, y)| y.cpu() / t.cpu().max(1e-9)).collect::<Vec<_>>();
        Row {
            rays: set.kind,
            tracer: tracer.name.clone(),
            count,
            hits: found[index].iter().filter(|hit| **hit).count(),
            disagree: found[index].iter().zip(&found[0]).filter(|(a, b)| a != b).count(),
            mrays_cpu: rate(middle(&|t| t.cpu())),
            mrays_wall: rate(middle(&|t| t.seconds)),
            ratio: yardstick.map(|y| median(&against(y))),
            over_ours: median(&against(0)),
            seconds_cpu: times[index].iter().map(|t| t.cpu()).collect(),
        }
    };
    Ok(tracers.iter().enumerate().map(row).collect())
}

/// Processes that ran or waited to run, averaged over a minute.
pub(super) fn load() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split(' ').next()?.parse().ok()
}

/// Every triangle of the scene at frame 0, relative to the scene's origin; those that no tracer can hit anyway left out.
fn flatten(scene: &LoadedScene) -> Vec<[Vec3A; 3]> {
    let mut triangles = Vec::new();
    for instance in &scene.instances {
        let (mesh, transform) = (&scene.meshes[instance.mesh], instance.transform(0));
        let place = |v: u32| transform.transform_point3a(mesh.positions[v as usize].into());
        triangles.extend(mesh.triangles.iter().map(|t| t.map(place)));
    }
    triangles.retain(|[a, b, c]| (a.is_finite() && b.is_finite() && c.is_finite()) && a != b && b != c && c != a);
    triangles
}

fn print(scene: &SceneResult) {
    println!("\n{}: {} triangles", scene.name, scene.triangles);
    for s in &scene.structures {
        println!("  {:22} built in {:.3} s, {:.1} bytes a triangle", s.tracer, s.build_seconds, s.bytes_per_triangle);
    }
    println!(
        "  {:9} {:30} {:>8} {:>8} {:>7} {:>6} {:>9} {:>7}",
        "rays", "tracer", "Mrays/s", "(wall)", "/embree", "/ours", "hits", "differ"
    );
    for row in &scene.rows {
        let ratio = row.ratio.map_or_else(|| "-".into(), |r| format!("{r:.2}"));
        println!(
            "  {:9} {:30} {:>8.2} {:>8.2} {:>7} {:>6.2} {:>9} {:>7}",
            row.rays.name(),
            row.tracer,
            row.mrays_cpu,
            row.mrays_wall,
            ratio,
            row.over_ours,
            row.hits,
            row.disagree
        );
    }
}
