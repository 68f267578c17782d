//! What the G-buffer of camera rays costs, and how far its guides are from the truth's, with and without `Skips::plain_pixels`.
//!
//! `cargo run --release -p renderflow-renderer --example gbuffer_cost -- SCENE.json ... [--size 256] [--repeats 7] [--threads 1]`
//!
//! Seconds are medians of runs by turns. Errors are root mean squares over pixels and channels: of coverage, guide albedo and guide
//! normal of 16 rays against guides of 256 rays with other random numbers; "truth" is the error of such guides themselves, from two
//! of them. "apart" is the difference between the pictures with and without.

use renderflow_frame::Frame;
use renderflow_frame::reach::Reach;
use renderflow_renderer::{RenderScene, Settings, Skips, render_gbuffer};
use renderflow_scenes::LoadedScene;
use renderflow_scenes::description::Scene;
use renderflow_scenes::load::load;
use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    let (mut size, mut repeats, mut threads, mut paths) = (256u32, 7usize, 1usize, Vec::new());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--size" => size = value()?.parse()?,
            "--repeats" => repeats = value()?.parse()?,
            "--threads" => threads = value()?.parse()?,
            _ => paths.push(PathBuf::from(argument)),
        }
    }
    println!(
        "{:28} {:>8} {:>8} {:>6}  coverage, albedo, normal: with | without | truth | apart",
        "scene", "with", "without", "ratio"
    );
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    for path in paths {
        let mut description = Scene::read(&path)?;
        description.resolution = [size; 2];
        let loaded = load(&description, &Reach::of(&path).allow(["/"]))?;
        let name = path.parent().and_then(|p| p.file_name()).unwrap_or_default().to_string_lossy().into_owned();
        pool.install(|| measure(&name, loaded, repeats))?;
    }
    Ok(())
}

fn measure(name: &str, mut loaded: LoadedScene, repeats: usize) -> Result<()> {
    let scene = RenderScene::compile(&loaded)?;
    let with = Settings::default();
    let without = Settings { skips: Skips { plain_pixels: false, ..Skips::ALL }, ..with };
    let mut seconds = [Vec::new(), Vec::new()];
    let mut frames = [None, None];
    for _ in 0..repeats {
        for (settings, (seconds, frame)) in [with, without].iter().zip(seconds.iter_mut().zip(&mut frames)) {
            let begin = Instant::now();
            *frame = Some(render_gbuffer(&scene, settings)?);
            seconds.push(begin.elapsed().as_secs_f64());
        }
    }
    let [with, plain] = seconds.map(|mut seconds| {
        seconds.sort_by(f64::total_cmp);
        seconds[seconds.len() / 2]
    });
    let [Some(a), Some(b)] = frames else { return Err("no repeats".into()) };
    let mut truth = || {
        loaded.seed += 1;
        let other = RenderScene::compile(&loaded)?;
        render_gbuffer(&other, &Settings { guide_samples: 256, ..without })
    };
    let (first, second) = (truth()?, truth()?);
    let row = |a: &Frame, b: &Frame, scale: f64| {
        let [x, y, z] = differences(a, b).map(|d| d * scale);
        format!("{x:.4} {y:.4} {z:.4}")
    };
    let half = 0.5f64.sqrt();
    println!(
        "{name:28} {with:8.4} {plain:8.4} {:6.2}  {} | {} | {} | {}",
        with / plain,
        row(&a, &first, 1.0),
        row(&b, &first, 1.0),
        row(&first, &second, half),
        row(&a, &b, 1.0)
    );
    Ok(())
}

/// Root mean square differences of coverage, guide albedo and guide normal.
fn differences(a: &Frame, b: &Frame) -> [f64; 3] {
    let mean = |pairs: Vec<(f32, f32)>| {
        let count = pairs.len().max(1) as f64;
        (pairs.into_iter().map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / count).sqrt()
    };
    let flat = |frame: &Frame, normal: bool| {
        let image = if normal { &frame.guide_normal } else { &frame.guide_albedo };
        image.iter().flat_map(|image| image.pixels.iter().flatten().copied()).collect::<Vec<f32>>()
    };
    let pairs = |normal| flat(a, normal).into_iter().zip(flat(b, normal)).collect();
    let coverage = a.alpha.pixels.iter().copied().zip(b.alpha.pixels.iter().copied()).collect();
    [mean(coverage), mean(pairs(false)), mean(pairs(true))]
}
