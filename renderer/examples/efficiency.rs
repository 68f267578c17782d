//! How much error a second of work buys: renders a set of scenes at equal samples and prints, for each, relMSE times samples (mean,
//! lowest 99 %, median pixel), CPU microseconds a sample on one thread, and efficiency = 1 / (relMSE times CPU time).
//!
//! `cargo run --release -p renderflow-renderer --example efficiency -- [--spp 64] [--seeds 4] [--size 96] [--bounces 6] [--branches 4] [--clamp X]
//! [--reference FOLDER] [--reference-spp 4096] [--only NAME,...] [scene.json ...]`
//!
//! relMSE = mean of (I - R)^2 / (R^2 + 0.01) over pixels, channels and seeds. References are kept in the folder, so that variants of the code are
//! compared with the same ones: an estimator that is not unbiased shows.

#[path = "../tests/common/mod.rs"]
mod common;

use glam::{Affine3A, Quat, Vec3, Vec3A};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::reach::Reach;
use renderflow_frame::{Camera, Environment};
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load::load;
use renderflow_scenes::{LoadedScene, Material};
use std::error::Error;
use std::f32::consts::FRAC_PI_2;
use std::path::PathBuf;
use std::time::Instant;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

struct Options {
    spp: u32,
    seeds: u64,
    size: usize,
    bounces: u32,
    branches: u32,
    clamp: Option<f32>,
    reference: PathBuf,
    reference_spp: u32,
    only: Vec<String>,
    files: Vec<PathBuf>,
}

fn main() -> Outcome<()> {
    let options = options()?;
    std::fs::create_dir_all(&options.reference)?;
    let settings = Settings {
        spp: options.spp,
        max_bounces: options.bounces,
        branches: options.branches,
        clamp_indirect: options.clamp,
        ..Settings::default()
    };
    let mut scenes = built(options.size);
    for file in &options.files {
        let description = Scene::read(file)?;
        let name = file.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        scenes.push((name, load(&description, &Reach::of(file).allow(["/"]))?));
    }
    let single = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    println!("{0} x {0}, {1} spp, {2} seeds, {3} bounces", options.size, options.spp, options.seeds, options.bounces);
    println!(
        "{:12} {:>10} {:>9} {:>9} {:>9} {:>10} {:>8}",
        "scene", "relMSE*spp", "low 99 %", "median", "us/sample", "efficiency", "bias %"
    );
    let (mut logs, mut count) = ([0.0f64; 5], 0);
    for (name, mut loaded) in scenes {
        if !options.only.is_empty() && !options.only.contains(&name) {
            continue;
        }
        let reference = reference(&options, &name, &mut loaded)?;
        let mut errors = Vec::new();
        let (mut sum, mut sum_of_reference) = (0.0f64, 0.0f64);
        let mut scene = None;
        for seed in 0..options.seeds {
            loaded.seed = 100 + seed;
            let mut compiled = RenderScene::compile(&loaded)?;
            compiled.set_resolution(options.size, options.size);
            let found = picture(&compiled, &settings)?;
            let error = |(f, r): (&[f32; 3], &[f32; 3])| {
                let part = |i: usize| (f64::from(f[i]) - f64::from(r[i])).powi(2) / (f64::from(r[i]).powi(2) + 0.01);
                (part(0) + part(1) + part(2)) / 3.0
            };
            let total = |pixels: &[[f32; 3]]| pixels.iter().flatten().map(|&v| f64::from(v)).sum::<f64>();
            sum += total(&found);
            sum_of_reference += total(&reference);
            errors.extend(found.iter().zip(&reference).map(error));
            scene = Some(compiled);
        }
        let Some(scene) = scene else { return Err("at least one seed".into()) };
        let seconds = (0..3).map(|_| single.install(|| cpu_seconds(&scene, &settings))).collect::<Outcome<Vec<f64>>>()?;
        let per_sample = seconds.iter().copied().fold(f64::INFINITY, f64::min) * 1e6;
        errors.sort_by(f64::total_cmp);
        let spp = f64::from(options.spp);
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let all = spp * mean(&errors);
        let row = [
            all,
            spp * mean(&errors[..errors.len() * 99 / 100]),
            spp * errors[errors.len() / 2],
            per_sample,
            1.0 / (all * per_sample),
        ];
        let bias = 100.0 * (sum / sum_of_reference - 1.0);
        println!("{name:12} {:10.4} {:9.4} {:9.5} {:9.3} {:10.4} {bias:8.3}", row[0], row[1], row[2], row[3], row[4]);
        logs.iter_mut().zip(row).for_each(|(l, r)| *l += r.ln());
        count += 1;
    }
    let means = logs.map(|l| (l / f64::from(count.max(1))).exp());
    println!("{:12} {:10.4} {:9.4} {:9.5} {:9.3} {:10.4}", "geom. mean", means[0], means[1], means[2], means[3], means[4]);
    Ok(())
}

fn options() -> Outcome<Options> {
    let mut options = Options {
        spp: 64,
        seeds: 4,
        size: 96,
        bounces: 6,
        branches: Settings::default().branches,
        clamp: None,
        reference: std::env::temp_dir().join("renderflow-efficiency"),
        reference_spp: 4096,
        only: Vec::new(),
        files: Vec::new(),
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--spp" => options.spp = value()?.parse()?,
            "--seeds" => options.seeds = value()?.parse()?,
            "--size" => options.size = value()?.parse()?,
            "--bounces" => options.bounces = value()?.parse()?,
            "--clamp" => options.clamp = Some(value()?.parse()?),
            "--branches" => options.branches = value()?.parse()?,
            "--reference" => options.reference = value()?.into(),
            "--reference-spp" => options.reference_spp = value()?.parse()?,
            "--only" => options.only = value()?.split(',').map(str::to_owned).collect(),
            _ => options.files.push(argument.into()),
        }
    }
    Ok(options)
}

fn picture(scene: &RenderScene, settings: &Settings) -> Outcome<Vec<[f32; 3]>> {
    let (frame, _) = common::render_with(scene, settings);
    Ok(frame.raw.ok_or("a beauty was asked for")?.pixels)
}

/// The converged picture, from the folder or rendered into it.
fn reference(options: &Options, name: &str, loaded: &mut LoadedScene) -> Outcome<Vec<[f32; 3]>> {
    let file = options.reference.join(format!("{name}-{}-{}-{}.f32", options.size, options.bounces, options.reference_spp));
    if let Ok(bytes) = std::fs::read(&file)
        && bytes.len() == 12 * options.size * options.size
    {
        let number = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        return Ok(bytes.chunks_exact(12).map(|p| [number(p), number(&p[4..]), number(&p[8..])]).collect());
    }
    loaded.seed = 1_000_000;
    let mut scene = RenderScene::compile(loaded)?;
    scene.set_resolution(options.size, options.size);
    let settings = Settings { spp: options.reference_spp, max_bounces: options.bounces, ..Settings::default() };
    let pixels = picture(&scene, &settings)?;
    std::fs::write(file, pixels.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())?;
    Ok(pixels)
}

/// CPU seconds a sample, start-up apart: the difference of two renders. Called on the only thread of a pool.
fn cpu_seconds(scene: &RenderScene, settings: &Settings) -> Outcome<f64> {
    let side = scene.camera().width;
    let mut spent = [0.0; 2];
    let counts = [settings.spp / 4, settings.spp];
    for (seconds, spp) in spent.iter_mut().zip(counts) {
        let begin = clock();
        picture(scene, &Settings { spp, ..*settings })?;
        *seconds = clock() - begin;
    }
    Ok((spent[1] - spent[0]) / (f64::from(counts[1] - counts[0]) * (side * side) as f64))
}

/// CPU seconds of this thread where the system tells (Linux), else seconds.
fn clock() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split_whitespace().next()?.parse::<u64>().ok());
    thread_local!(static START: Instant = Instant::now());
    nanoseconds.map_or_else(|| START.with(|s| s.elapsed().as_secs_f64()), |ns| ns as f64 * 1e-9)
}

fn built(size: usize) -> Vec<(String, LoadedScene)> {
    let sun = |d: Vec3A, degrees: f32| f32::from(u8::from(d.dot(Vec3A::new(0.48, 0.6, 0.64)) > degrees.to_radians().cos()));
    let blue = |d: Vec3A| Vec3A::new(0.25, 0.4, 0.7) * (0.4 + 0.6 * d.y.max(0.0));
    let clear = |radiance: f32, degrees: f32| sky(move |d| blue(d) + Vec3A::new(1.0, 0.92, 0.8) * (radiance * sun(d, degrees)));
    let lamp = |d: Vec3A, at: Vec3A, half: f32| {
        let off = d / d.dot(at.normalize()).max(1e-3) - at.normalize();
        f32::from(u8::from(off.abs().max_element() < half && d.dot(at) > 0.0))
    };
    let studio = sky(move |d| {
        Vec3A::splat(0.02)
            + Vec3A::new(1.0, 0.95, 0.9) * (18.0 * lamp(d, Vec3A::new(0.8, 0.7, 0.6), 0.25))
            + Vec3A::new(0.8, 0.9, 1.0) * (6.0 * lamp(d, Vec3A::new(-1.0, 0.5, 0.4), 0.35))
            + Vec3A::splat(9.0 * lamp(d, Vec3A::new(0.1, 0.8, -1.0), 0.2))
    });
    let overcast = sky(|d| Vec3A::splat(if d.y > 0.0 { (1.0 + 2.0 * d.y) / 3.0 } else { 0.2 }));
    let look = common::camera([2.6, 2.2, 4.6], [0.0, 0.45, 0.1], 36.0, size, size);
    let inside = common::camera([-1.6, 1.6, -2.6], [0.0, 1.0, 0.0], 60.0, size, size);
    vec![
        ("soft sun".to_owned(), balls(&clear(150.0, 5.0), look)),
        ("hard sun".to_owned(), balls(&clear(1600.0, 1.5), look)),
        ("studio".to_owned(), balls(&studio, look)),
        ("overcast".to_owned(), balls(&overcast, look)),
        ("interior".to_owned(), room(&clear(150.0, 5.0), inside)),
        ("glossy".to_owned(), corner(&clear(150.0, 5.0), look)),
        ("lamps".to_owned(), lamps(&clear(4.0, 5.0), inside)),
    ]
}

fn sky(f: impl Fn(Vec3A) -> Vec3A) -> Environment {
    let blank = Environment { map: Rgb::filled(512, 256, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Image::from_fn(512, 256, |x, y| f(blank.texel_direction(x, y)).to_array());
    Environment { map, ..blank }
}

fn material(base_color: [f32; 3], metallic: f32, roughness: f32) -> Material {
    Material { base_color, metallic, roughness, ..Material::default() }
}

/// Shiny and dull spheres, and a box, on grey ground: the kinds of surfaces of the usual comparison scenes.
fn balls(environment: &Environment, camera: Camera) -> LoadedScene {
    let at =
        |x: f32, z: f32, r: f32| Affine3A::from_scale_rotation_translation(Vec3::splat(r), Quat::IDENTITY, Vec3::new(x, r, z));
    let mut parts = vec![(common::plane(12.0), material([0.45, 0.42, 0.38], 0.0, 0.8), Affine3A::IDENTITY)];
    for (color, metallic, roughness, x, z, r) in [
        ([0.75, 0.08, 0.06], 0.0, 0.25, -1.5, 0.2, 0.45),
        ([1.0, 0.72, 0.3], 1.0, 0.15, -0.5, -0.4, 0.5),
        ([0.9, 0.9, 0.92], 1.0, 0.05, 0.6, 0.3, 0.5),
        ([0.85, 0.85, 0.85], 0.0, 1.0, 1.6, -0.5, 0.45),
        ([0.05, 0.12, 0.6], 0.0, 0.08, -0.5, 1.2, 0.35),
        ([0.95, 0.55, 0.4], 1.0, 0.35, 0.7, -1.5, 0.6),
        ([0.55, 0.56, 0.58], 1.0, 0.5, -1.5, -1.5, 0.5),
        ([0.1, 0.45, 0.12], 0.0, 0.6, 1.4, 1.0, 0.3),
    ] {
        parts.push((common::sphere(48, true), material(color, metallic, roughness), at(x, z, r)));
    }
    common::scene(parts, environment.clone(), camera)
}

/// A gold and a chrome wall facing each other, a dull ball between.
fn corner(environment: &Environment, camera: Camera) -> LoadedScene {
    let stand = |x: f32, turn: f32| {
        Affine3A::from_rotation_translation(
            Quat::from_rotation_y(turn) * Quat::from_rotation_x(FRAC_PI_2),
            Vec3::new(x, 0.9, -0.6),
        )
    };
    let parts = vec![
        (common::plane(12.0), material([0.5, 0.5, 0.5], 0.0, 0.3), Affine3A::IDENTITY),
        (common::plane(1.8), material([1.0, 0.72, 0.3], 1.0, 0.2), stand(-1.0, 0.6)),
        (common::plane(1.8), material([0.9, 0.9, 0.92], 1.0, 0.3), stand(1.0, -0.6)),
        (
            common::sphere(32, true),
            material([0.7, 0.2, 0.2], 0.0, 0.4),
            Affine3A::from_scale_rotation_translation(Vec3::splat(0.45), Quat::IDENTITY, Vec3::new(0.0, 0.45, 0.4)),
        ),
    ];
    common::scene(parts, environment.clone(), camera)
}

/// A dull ball and a metal one in a room with a window.
fn room(environment: &Environment, camera: Camera) -> LoadedScene {
    let small =
        |x: f32, z: f32| Affine3A::from_scale_rotation_translation(Vec3::splat(0.6), Quat::IDENTITY, Vec3::new(x, 0.6, z));
    let parts = vec![
        (common::walls(), material([0.7, 0.68, 0.62], 0.0, 0.9), Affine3A::IDENTITY),
        (common::sphere(24, true), material([0.8, 0.3, 0.2], 0.0, 0.3), small(-0.7, 0.4)),
        (common::sphere(24, true), material([0.9, 0.9, 0.92], 1.0, 0.15), small(0.7, 0.0)),
    ];
    common::scene(parts, environment.clone(), camera)
}

/// The room with a faint window and two lamps.
fn lamps(environment: &Environment, camera: Camera) -> LoadedScene {
    let mut scene = room(environment, camera);
    for (place, size, radiance) in [(Vec3::new(-1.0, 2.95, 0.0), 0.6, 12.0), (Vec3::new(0.9, 2.95, 1.5), 0.2, 60.0)] {
        let index = scene.meshes.len();
        scene.meshes.push(common::plane(size));
        scene.materials.push(Material { emissive: [radiance; 3], ..common::diffuse([0.0; 3]) });
        scene.instances.push(common::instance(index, index, Affine3A::from_translation(place)));
    }
    scene
}
