//! Speed of the path tracer on a scene of the size the composer makes: ten objects, 50k triangles, ground and sky.
//!
//! `cargo bench -p renderflow-renderer` prints millions of camera samples a second by wall clock and by the processor time of this
//! process; on a machine with other work only the latter means something. `THREADS`, `SPP` and `REPEATS` change the defaults.

#[path = "../tests/common/mod.rs"]
mod common;

use glam::{Affine3A, Quat, Vec3};
use renderflow_renderer::Settings;
use renderflow_renderer::accel::{Hit, Scratch};
use renderflow_renderer::ray::Ray;
use renderflow_scenes::Material;
use std::time::Instant;

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// Processor seconds of all threads of this process so far, `None` where the system does not say.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Fields 14 and 15 (user, system) in ticks of 1/100 s; the name in field 2 may hold spaces.
    let ticks: Vec<f64> = stat.rsplit_once(')')?.1.split_whitespace().skip(11).take(2).filter_map(|v| v.parse().ok()).collect();
    Some(ticks.iter().sum::<f64>() / 100.0)
}

fn main() {
    let mut parts = vec![(common::plane(12.0), common::diffuse([0.5; 3]), Affine3A::IDENTITY)];
    for i in 0..10u8 {
        let f = f32::from(i);
        let (angle, reach) = (f * 2.4, 0.6 + 0.25 * f);
        let size = 0.35 + 0.05 * (f * 1.7).sin();
        let place = Vec3::new(reach * angle.cos(), size, reach * angle.sin());
        let transform = Affine3A::from_scale_rotation_translation(
            Vec3::new(size, size * (1.0 + 0.3 * f.cos()), size),
            Quat::from_rotation_y(f),
            place,
        );
        let material = Material {
            name: format!("material {i}"),
            base_color: [0.2 + 0.07 * f, 0.8 - 0.05 * f, 0.5],
            metallic: if i % 3 == 0 { 1.0 } else { 0.0 },
            roughness: 0.1 + 0.09 * f,
            ..Material::default()
        };
        parts.push((common::sphere(36, true), material, transform));
    }
    let camera = common::camera([3.0, 2.2, 5.0], [0.0, 0.3, 0.0], 40.0, 256, 256);
    let mut loaded = common::scene(parts, common::sunny(), camera);
    let threads = number("THREADS", std::thread::available_parallelism().map_or(1, |n| n.get()));
    let repeats = number("REPEATS", 5);
    let settings = Settings { spp: number("SPP", 64) as u32, ..Settings::default() };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().expect("first use of the pool");

    for (name, intensity) in [("ten objects under a sunny sky", 1.0), ("the same, flat sky", 0.0)] {
        if intensity == 0.0 {
            loaded.environment = renderflow_frame::Environment::constant([1.0; 3]);
        }
        let begin = Instant::now();
        let scene = common::compile(&loaded);
        println!("{name}: {} triangles, compiled in {:.1?}", scene.triangle_count(), begin.elapsed());
        let (mut best_wall, mut best_processor) = (0.0f64, 0.0f64);
        for _ in 0..repeats {
            let (begin, before) = (Instant::now(), processor_seconds());
            let (frame, stats) = common::render_with(&scene, &settings);
            let wall = begin.elapsed().as_secs_f64();
            let processor = processor_seconds().zip(before).map_or(f64::NAN, |(a, b)| a - b);
            best_wall = best_wall.max(stats.samples as f64 / wall / 1e6);
            best_processor = best_processor.max(stats.samples as f64 / processor / 1e6);
            std::hint::black_box(&frame);
        }
        println!(
            "  {best_wall:.2} Msamples/s by wall clock on {threads} threads, {best_processor:.2} per processor second ({:.2} on four free cores)",
            4.0 * best_processor
        );
        let (_, stats) = common::render_with(&scene, &Settings { spp: 4, ..settings });
        println!("  {stats:?}");
        rays(&scene);
    }
}

/// Rays alone, one thread: camera rays in order, and rays that start on what they hit in a fixed set of directions.
fn rays(scene: &renderflow_renderer::RenderScene) {
    let camera = scene.camera();
    let mut scratch = Scratch::default();
    let primary: Vec<Ray> = (0..camera.width * camera.height)
        .map(|i| glam::Vec2::new((i % camera.width) as f32 + 0.5, (i / camera.width) as f32 + 0.5))
        .map(|p| renderflow_renderer::camera::ray(camera, p))
        .collect();
    let mut bounced = Vec::new();
    for (i, ray) in primary.iter().enumerate() {
        if let Some(Hit { t, .. }) = scene.closest(ray, &mut scratch) {
            let a = i as f32 * 2.399;
            let up = glam::Vec3A::new(a.cos(), 1.0, a.sin()).normalize();
            bounced.push(Ray::new(ray.at(t) + up * 1e-4, up));
        }
    }
    for (name, set) in [("primary", &primary), ("bounced", &bounced)] {
        let (mut closest, mut any) = (f64::INFINITY, f64::INFINITY);
        let mut hits = 0usize;
        for _ in 0..5 {
            let begin = Instant::now();
            hits = set.iter().filter(|r| scene.closest(r, &mut scratch).is_some()).count();
            closest = closest.min(begin.elapsed().as_secs_f64());
            let begin = Instant::now();
            let occluded = set.iter().filter(|r| scene.occluded(r, &mut scratch)).count();
            any = any.min(begin.elapsed().as_secs_f64());
            assert_eq!(hits, occluded);
        }
        let rate = |s: f64| set.len() as f64 / s / 1e6;
        println!("  {name}: {:.1} Mrays/s nearest, {:.1} any; {hits} of {} hit", rate(closest), rate(any), set.len());
    }
}
