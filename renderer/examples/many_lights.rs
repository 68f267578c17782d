//! Error at equal time of the tree of lights against drawing by power, in a hall with 1, 100 and 10,000 small lamps, and the time
//! that it takes to make each.
//!
//! `cargo run --release -p renderflow-renderer --example many_lights -- [--seconds 4] [--runs 3] [--size 96] [--reference 4096]`
//!
//! Everything runs on one thread, and times are that thread's processor time. Runs of both alternate. relMSE is
//! mean((picture - truth)^2 / (truth^2 + 0.01)), scaled from the seconds that a run took to those asked for; the truth is drawn
//! with the tree and other random numbers.

use glam::{Affine3A, Vec3, Vec3A};
use renderflow_frame::image::Rgb;
use renderflow_renderer::light::{EmissiveTriangle, EmitterLight, Selection};
use renderflow_renderer::verify::chi_square::Random;
use renderflow_renderer::verify::scenes::{Part, camera, diffuse, scene};
use renderflow_renderer::{Channels, RenderScene, Settings, render};
use renderflow_scenes::shapes::{self, Shape};
use renderflow_scenes::{LoadedScene, Material, Mesh};
use std::error::Error;
use std::sync::atomic::AtomicBool;

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    let (mut seconds, mut runs, mut size, mut reference) = (4.0, 3_u64, 96_usize, 4096_u32);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let value = arguments.next().ok_or(format!("{argument} needs a value"))?;
        match argument.as_str() {
            "--seconds" => seconds = value.parse()?,
            "--runs" => runs = value.parse()?,
            "--size" => size = value.parse()?,
            "--reference" => reference = value.parse()?,
            _ => return Err(format!("{argument} is not known").into()),
        }
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    // All on the one worker: what it runs is what its clock counts.
    pool.install(|| -> Result<()> {
        println!(
            "| emitters | relMSE, power | relMSE, tree | ratio | samples, power | samples, tree |\n|---|---|---|---|---|---|"
        );
        for count in [1, 100, 10_000] {
            measure(&hall(count, size), count, seconds, runs, reference)?;
        }
        println!("\n| triangles | seconds, power | seconds, tree |\n|---|---|---|");
        for count in [10_000, 1_000_000] {
            let [power, tree] = [Selection::Power, Selection::Tree].map(|selection| making(count, selection));
            println!("| {count} | {power:.3} | {tree:.3} |");
        }
        Ok(())
    })
}

/// Processor seconds of this thread.
fn clock() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A hall of 40 x 6 x 40 m with boxes, and `count` triangles of some centimetres below the ceiling, one kilowatt together.
fn hall(count: u32, size: usize) -> LoadedScene {
    let mut random = Random::new(7);
    let grey = || diffuse([0.6; 3]);
    let walls = Mesh { normals: vec![], ..shapes::mesh(&Shape::Box { size: [40.0, 6.0, 40.0], bevel: 0.0 }) };
    let at = |x: f32, y: f32, z: f32| Affine3A::from_translation(Vec3::new(x, y, z));
    let mut parts = vec![Part { mesh: walls, material: grey(), transform: at(0.0, 3.0, 0.0) }];
    for _ in 0..60 {
        let [x, z, height] = [38.0 * (random.next() - 0.5), 38.0 * (random.next() - 0.5), 0.3 + 2.0 * random.next()];
        let shape = Shape::Box { size: [0.8, height, 0.8], bevel: 0.0 };
        parts.push(Part::new(shape, grey(), at(x, 0.5 * height, z)));
    }
    let mut lamps = Mesh { name: "lamps".into(), ..Mesh::default() };
    for k in 0..count {
        let place = match count {
            1 => Vec3::new(1.0, 4.0, 2.0),
            _ => Vec3::new(38.0 * (random.next() - 0.5), 3.0 + 2.5 * random.next(), 38.0 * (random.next() - 0.5)),
        };
        // Facing down, more or less.
        let tilt = 0.5 * (random.next() - 0.5);
        let first = 3 * k;
        lamps.positions.extend([(0.0, 0.0), (0.05, 0.0), (0.0, 0.05)].map(|(x, z)| place + Vec3::new(x, tilt * x, z)));
        lamps.triangles.push([first, first + 1, first + 2]);
    }
    let area = 0.5 * 0.05 * 0.05 * count as f32;
    let radiance = 1000.0 / (std::f32::consts::PI * area);
    let glowing = Material { emissive: [radiance; 3], double_sided: true, ..diffuse([0.0; 3]) };
    parts.push(Part { mesh: lamps, material: glowing, transform: Affine3A::IDENTITY });
    // No lamp is in the picture: their edges would be most of the noise.
    let look = camera([0.0, 2.9, 14.0], [0.0, 0.0, 8.0], 50.0, size, size * 3 / 4);
    scene(parts, Vec::new(), renderflow_frame::Environment::constant([0.0; 3]), look)
}

fn picture(scene: &RenderScene, spp: u32) -> Result<(Rgb, f64)> {
    let settings = Settings { spp, channels: Channels::BEAUTY, max_bounces: 3, ..Settings::default() };
    let from = clock();
    let frame = render(scene, &settings, &|_, _| (), &AtomicBool::new(false))?;
    Ok((frame.raw.ok_or("a picture has radiance")?, clock() - from))
}

fn relmse(picture: &Rgb, truth: &Rgb) -> f64 {
    let pairs = picture.pixels.iter().flatten().zip(truth.pixels.iter().flatten());
    let error = |(a, b): (&f32, &f32)| {
        let (a, b) = (f64::from(*a), f64::from(*b));
        (a - b).powi(2) / (b * b + 0.01)
    };
    pairs.map(error).sum::<f64>() / (3 * truth.pixels.len()) as f64
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn measure(loaded: &LoadedScene, count: u32, seconds: f64, runs: u64, reference: u32) -> Result<()> {
    let compiled = |selection, seed| -> Result<RenderScene> {
        let mut scene = RenderScene::compile(loaded)?.with_seed(seed);
        scene.set_light_selection(selection);
        Ok(scene)
    };
    let (truth, _) = picture(&compiled(Selection::Tree, 1000)?, reference)?;
    let ways = [Selection::Power, Selection::Tree];
    let mut found = [vec![], vec![]];
    let mut samples = [0, 0];
    for (k, selection) in ways.into_iter().enumerate() {
        let (_, taken) = picture(&compiled(selection, 999)?, 16)?;
        samples[k] = ((16.0 * seconds / taken / 8.0).round() as u32).max(1) * 8;
    }
    for run in 0..runs {
        for (k, selection) in ways.into_iter().enumerate() {
            let (drawn, taken) = picture(&compiled(selection, run)?, samples[k])?;
            found[k].push(relmse(&drawn, &truth) * taken / seconds);
        }
    }
    let [power, tree] = found.map(median);
    println!("| {count} | {power:.3e} | {tree:.3e} | {:.3} | {} | {} |", tree / power, samples[0], samples[1]);
    Ok(())
}

/// Seconds to make the tables of `count` triangles.
fn making(count: u32, selection: Selection) -> f64 {
    let mut random = Random::new(3);
    let triangles: Vec<EmissiveTriangle> = (0..count)
        .map(|id| {
            let place = Vec3A::new(random.next(), random.next(), random.next()) * 50.0;
            let corners = [place, place + random.direction().as_vec3a() * 0.05, place + random.direction().as_vec3a() * 0.05];
            EmissiveTriangle { corners, radiance: Vec3A::splat(random.next()), two_sided: id % 2 == 0, id }
        })
        .collect();
    let times = (0..3).map(|_| {
        let from = clock();
        let made = EmitterLight::new(triangles.iter().copied(), selection);
        let taken = clock() - from;
        assert!(made.is_some());
        taken
    });
    median(times.collect())
}
