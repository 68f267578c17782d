//! What a path costs beyond its rays, on one thread: the time of a render less that of tracing exactly its rays again.
//!
//! `cargo run --release -p renderflow-bench --features record --example shading_cost -- SCENE.json [--spp 16] [--size 256]
//! [--repeats 5] [--branches 2] [--no-light-paths]`
//!
//! Times are processor time of the thread. The rays are asked for in the order of the render and together where
//! they were, from memory, with nothing in between. Where paths split, each branch counts.
//! `--render` only renders, as often as `--repeats` says, for `perf stat` and for comparisons of two versions.

use renderflow::util::clock::{Of, Stopwatch};
use renderflow_frame::reach::Reach;
use renderflow_renderer::accel::Scratch;
use renderflow_renderer::ray::Ray;
use renderflow_renderer::record::{Recorded, record};
use renderflow_renderer::{RenderScene, Settings, Stats, develop, expose};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load::load;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    let mut path = None;
    let (mut spp, mut size, mut repeats, mut only_render) = (16u32, 256u32, 5usize, false);
    let mut settings = Settings::default();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--spp" => spp = value()?.parse()?,
            "--size" => size = value()?.parse()?,
            "--repeats" => repeats = value()?.parse()?,
            "--branches" => settings.branches = value()?.parse()?,
            "--no-light-paths" => settings.light_paths = false,
            "--render" => only_render = true,
            _ => path = Some(PathBuf::from(argument)),
        }
    }
    let path = path.ok_or(
        "usage: shading_cost SCENE.json [--spp N] [--size N] [--repeats N] [--branches N] [--no-light-paths] [--render]",
    )?;
    let mut description = Scene::read(&path)?;
    description.resolution = [size; 2];
    let loaded = load(&description, &Reach::of(&path).allow(["/"]))?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    // All on the one worker: what it runs is what its clock counts.
    pool.install(|| measure(&RenderScene::compile(&loaded)?, &Settings { spp, ..settings }, repeats, only_render))
}

fn measure(scene: &RenderScene, settings: &Settings, repeats: usize, only_render: bool) -> Result<()> {
    let never = AtomicBool::new(false);
    let render = || expose(scene, settings, 0..settings.spp, &|_, _| (), &never);
    let (film, stats) = render()?;
    let (frame, _) = develop(scene, settings, &film)?;
    let bytes: Vec<u8> = frame.raw.iter().flat_map(|raw| &raw.pixels).flatten().flat_map(|v| v.to_le_bytes()).collect();
    println!("{stats:?}, picture {}", &blake3::hash(&bytes).to_hex()[..16]);
    if only_render {
        let mut best = f64::INFINITY;
        for _ in 1..repeats {
            let clock = Stopwatch::start_of(Of::Thread);
            std::hint::black_box(render()?);
            best = best.min(clock.spent().cpu());
        }
        println!("{:.3} us a path", best / stats.samples as f64 * 1e6);
        return Ok(());
    }

    let mut failure = None;
    let rays = record(|| failure = render().err());
    if let Some(error) = failure {
        return Err(error.into());
    }
    let (mut whole, mut alone) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..repeats {
        let clock = Stopwatch::start_of(Of::Thread);
        std::hint::black_box(render()?);
        whole = whole.min(clock.spent().cpu());
        let clock = Stopwatch::start_of(Of::Thread);
        std::hint::black_box(trace(scene, &rays));
        alone = alone.min(clock.spent().cpu());
    }
    report(&stats, &rays, whole, alone);
    Ok(())
}

fn trace(scene: &RenderScene, rays: &[Recorded]) -> usize {
    let mut scratch = Scratch::default();
    let (mut packet, mut found) = (Vec::new(), Vec::new());
    let mut hits = 0;
    for (i, r) in rays.iter().enumerate() {
        let ray = Ray::new(r.origin, r.direction);
        match r.together {
            0 => {}
            1 if r.any => hits += usize::from(scene.occluded(&ray, &mut scratch)),
            1 => hits += usize::from(scene.closest(&ray, &mut scratch).is_some()),
            count => {
                packet.clear();
                packet.extend(rays[i..i + count].iter().map(|r| Ray::new(r.origin, r.direction)));
                found.resize(count, None);
                scene.closest_packet(&packet, &mut found, &mut scratch);
                hits += found.iter().flatten().count();
            }
        }
    }
    hits
}

fn report(stats: &Stats, rays: &[Recorded], whole: f64, alone: f64) {
    let samples = stats.samples as f64;
    let micro = |seconds: f64| seconds / samples * 1e6;
    println!("{:.2} rays a path, {:.2} of them shadow rays", rays.len() as f64 / samples, stats.shadow_rays as f64 / samples);
    println!(
        "{:.3} us a path: {:.3} rays alone ({:.1} Mrays/s), {:.3} beyond rays",
        micro(whole),
        micro(alone),
        rays.len() as f64 / alone / 1e6,
        micro(whole - alone)
    );
}
