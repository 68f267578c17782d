//! Rates of the ray-casting kernels on generated scenes: `cargo bench -p renderflow-renderer --bench kernels`.
//!
//! `LEVELS=1` runs every set of instructions that the processor has, `SCENES=forest,room` only some of the scenes. Rays of a
//! set are the elements of criterion's throughput.

mod scenes;

use criterion::{Criterion, Throughput};
use renderflow_renderer::accel::{Accel, Level, Scratch};
use std::hint::black_box;
use std::time::Duration;

/// Pixels along an edge of the picture whose camera rays are traced.
const SIZE: u32 = 256;

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(800))
        .configure_from_args();
    let levels = if std::env::var_os("LEVELS").is_some() { Level::available() } else { &[Level::best()] };
    let wanted = std::env::var("SCENES").unwrap_or_default();
    for (name, triangles, eye, at) in scenes::all() {
        if !wanted.is_empty() && !wanted.split(',').any(|w| w == name) {
            continue;
        }
        for &level in levels {
            scene(&mut criterion, name, level, &triangles, eye, at);
        }
    }
    criterion.final_summary();
}

fn scene(criterion: &mut Criterion, name: &str, level: Level, triangles: &[[glam::Vec3A; 3]], eye: glam::Vec3A, at: glam::Vec3A) {
    let mut tree = Accel::build_for(triangles, level);
    let mut scratch = Scratch::default();
    println!("{name}: {} triangles, {:.1} bytes each", triangles.len(), tree.memory() as f64 / triangles.len() as f64);
    let mut group = criterion.benchmark_group(format!("{name}/{}", level.name()));
    for (set, rays) in &scenes::rays(&tree, eye, at, SIZE) {
        group.throughput(Throughput::Elements(rays.len() as u64));
        group.bench_function(*set, |b| {
            b.iter(|| match *set {
                "shadow" => rays.iter().filter(|ray| tree.occluded(ray, &mut scratch)).count(),
                _ => rays.iter().filter(|ray| tree.closest(ray, &mut scratch).is_some()).count(),
            });
        });
        if *set == "primary" {
            let mut hits = vec![None; rays.len()];
            group.bench_function("packets", |b| b.iter(|| tree.closest_packet(rays, black_box(&mut hits), &mut scratch)));
        }
    }
    group.throughput(Throughput::Elements(triangles.len() as u64));
    group.bench_function("build", |b| b.iter(|| Accel::build_for(black_box(triangles), level).memory()));
    group.bench_function("refit", |b| b.iter(|| tree.refit(black_box(triangles))));
    group.finish();
}
