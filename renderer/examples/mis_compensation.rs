//! Does MIS compensation lower the error? Renders scenes under several skies at equal samples, with light samples that follow all of
//! the radiance (share 0) or what exceeds a share of its mean, and prints relMSE against a converged picture, as ratios to share 0.
//!
//! `cargo run --release -p renderflow-renderer --example mis_compensation [map.hdr ...]`

#[path = "../tests/common/mod.rs"]
mod common;

use glam::{Affine3A, Vec3, Vec3A};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Camera, Environment, hdr};
use renderflow_renderer::light::Sampling;
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::{LoadedScene, Material};
use std::error::Error;

const SIDE: usize = 64;
const SPP: u32 = 16;
const SEEDS: u64 = 6;
const REFERENCE_SPP: u32 = 1024;
const SHARES: [f32; 4] = [0.0, 0.5, 0.8, 1.0];

fn main() -> Result<(), Box<dyn Error>> {
    let mut skies = vec![
        ("sun and sky".to_owned(), sky(|d| 0.3 + 0.7 * d.y.max(0.0) + 3000.0 * sun(d, 0.9995))),
        ("wide sun".to_owned(), sky(|d| 0.3 + 0.7 * d.y.max(0.0) + 20.0 * sun(d, 0.97))),
        ("overcast".to_owned(), sky(|d| if d.y > 0.0 { (1.0 + 2.0 * d.y) / 3.0 } else { 0.2 })),
        ("one-sided".to_owned(), sky(|d| 1.0 + 0.5 * d.x)),
    ];
    for path in std::env::args().skip(1) {
        let map = hdr::read(path.as_ref())?.map;
        skies.push((path.rsplit('/').next().unwrap_or(&path).to_owned(), Environment { map, rotation: 0.0, intensity: 1.0 }));
    }
    let material = |roughness, metallic| Material { base_color: [0.7; 3], roughness, metallic, ..Material::default() };
    let materials = [
        ("diffuse", Material { specular: 0.0, ..material(1.0, 0.0) }),
        ("plastic", material(0.3, 0.0)),
        ("metal", material(0.15, 1.0)),
    ];
    println!("{SIDE} x {SIDE}, {SPP} spp, {SEEDS} seeds, 3 bounces; relMSE at share 0, then ratios");
    println!("{:28} {:8} {:8} {:>9} {:>7} {:>7} {:>7}", "sky", "scene", "material", "share 0", "0.5", "0.8", "1.0");
    let mut logs = [0.0f64; SHARES.len()];
    let mut cases = 0;
    for (sky_name, environment) in &skies {
        for (material_name, material) in &materials {
            for (scene_name, loaded) in [("open", open(material, environment)), ("room", room(material, environment))] {
                let errors = errors(loaded)?;
                let ratios: Vec<f64> = errors.iter().map(|e| e / errors[0]).collect();
                print!("{sky_name:28} {scene_name:8} {material_name:8} {:9.5}", errors[0]);
                ratios[1..].iter().for_each(|r| print!(" {r:7.3}"));
                println!();
                logs.iter_mut().zip(&ratios).for_each(|(l, r)| *l += r.ln());
                cases += 1;
            }
        }
    }
    let means = logs.map(|l| (l / f64::from(cases)).exp());
    println!("geometric means of the ratios: {:.3} {:.3} {:.3}", means[1], means[2], means[3]);
    Ok(())
}

/// relMSE for every share: mean over pixels and seeds of the squared error over the squared reference, the worst 0.1 % left out.
fn errors(mut loaded: LoadedScene) -> Result<Vec<f64>, Box<dyn Error>> {
    loaded.seed = 1_000_000;
    let reference = picture(&mut RenderScene::compile(&loaded)?, Sampling::Less(0.5), REFERENCE_SPP)?;
    let mean: f64 = reference.iter().sum::<f64>() / reference.len() as f64;
    let mut errors = vec![Vec::new(); SHARES.len()];
    for seed in 0..SEEDS {
        loaded.seed = seed;
        let mut scene = RenderScene::compile(&loaded)?;
        for (share, errors) in SHARES.iter().zip(&mut errors) {
            let found = picture(&mut scene, Sampling::Less(*share), SPP)?;
            errors.extend(found.iter().zip(&reference).map(|(f, r)| (f - r).powi(2) / (r * r + 1e-4 * mean * mean)));
        }
    }
    Ok(errors
        .into_iter()
        .map(|mut all| {
            all.sort_by(f64::total_cmp);
            all.truncate(all.len() - all.len() / 1000);
            all.iter().sum::<f64>() / all.len() as f64
        })
        .collect())
}

fn picture(scene: &mut RenderScene, sampling: Sampling, spp: u32) -> Result<Vec<f64>, Box<dyn Error>> {
    scene.set_environment_sampling(sampling)?;
    let (frame, _) = common::render_with(scene, &Settings { spp, max_bounces: 3, ..Settings::default() });
    let raw = frame.raw.ok_or("a beauty was asked for")?;
    Ok(raw.pixels.iter().zip(&frame.alpha.pixels).filter(|(_, a)| **a == 1.0).map(|(p, _)| f64::from(p[1])).collect())
}

fn sky(f: impl Fn(Vec3A) -> f32) -> Environment {
    let blank = Environment { map: Rgb::filled(256, 128, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Image::from_fn(256, 128, |x, y| [f(blank.texel_direction(x, y)); 3]);
    Environment { map, ..blank }
}

/// 1 within a cone around the sun's direction.
fn sun(d: Vec3A, cos: f32) -> f32 {
    f32::from(u8::from(d.dot(Vec3A::new(0.48, 0.6, 0.64)) > cos))
}

fn camera(eye: [f32; 3], target: [f32; 3], degrees: f32) -> Camera {
    common::camera(eye, target, degrees, SIDE, SIDE)
}

/// A sphere on a plane.
fn open(material: &Material, environment: &Environment) -> LoadedScene {
    let parts = vec![
        (common::plane(4.0), material.clone(), Affine3A::IDENTITY),
        (common::sphere(24, true), material.clone(), Affine3A::from_translation(Vec3::Y)),
    ];
    common::scene(parts, environment.clone(), camera([0.0, 2.5, 5.0], [0.0, 0.6, 0.0], 35.0))
}

/// A room of 4 x 3 x 6 m whose only opening is a window of 1.6 x 1.2 m towards the sun.
fn room(material: &Material, environment: &Environment) -> LoadedScene {
    let parts = vec![
        (common::walls(), Material { specular: 0.0, ..Material::default() }, Affine3A::IDENTITY),
        (common::sphere(24, true), material.clone(), Affine3A::from_translation(Vec3::Y)),
    ];
    common::scene(parts, environment.clone(), camera([-1.6, 1.6, -2.6], [0.0, 1.0, 0.0], 60.0))
}
