//! What a path does between its rays, each alone: `cargo bench -p renderflow-renderer --bench shading`.
//!
//! Inputs are different every time and the results of one call do not enter the next, so these are costs of throughput; in a path each
//! step waits for the one before. What all of them together cost is for `examples/shading_cost.rs`.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use glam::Vec3A;
use renderflow_frame::{Environment, Image};
use renderflow_renderer::light::EnvironmentLight;
use renderflow_renderer::material::{Bsdf, Mode, Surface};
use renderflow_renderer::sampler::{PixelSampler, Points, hash};
use std::hint::black_box;

/// Different inputs, more than a branch predictor learns by heart.
const INPUTS: usize = 4096;

fn unit(i: usize, k: u64) -> f32 {
    (hash::child(i as u64, k) >> 40) as f32 / (1 << 24) as f32
}

fn directions(z: f32) -> Vec<Vec3A> {
    let direction = |i: usize| Vec3A::new(unit(i, 0) - 0.5, unit(i, 1) - 0.5, unit(i, 2) + z).normalize();
    (0..INPUTS).map(direction).collect()
}

/// Calls `f` with the numbers of the inputs in turn.
fn each<R>(criterion: &mut Criterion, name: &str, mut f: impl FnMut(usize) -> R) {
    let mut i = 0;
    criterion.bench_function(name, |bencher| {
        bencher.iter_batched(
            || {
                i = (i + 1) % INPUTS;
                i
            },
            &mut f,
            BatchSize::SmallInput,
        );
    });
}

fn sampler(criterion: &mut Criterion) {
    let samplers: Vec<PixelSampler> = (0..INPUTS as u64).map(|pixel| PixelSampler::new(1, 0, pixel)).collect();
    each(criterion, "sampler/one point", |i| samplers[i / 64].point((i % 64) as u32, 3));
    let mut points = Points::default();
    each(criterion, "sampler/points in order", |i| points.point(&samplers[i / 64], (i % 64) as u32, 3));
}

fn environment(criterion: &mut Criterion) {
    // A sun of some ten degrees in a bright sky, as in the scene that renderers are compared on.
    let (width, height) = (1024, 512);
    let texel = |i: usize| {
        let (x, y) = ((i % width) as f32 - 300.0, (i / width) as f32 - 120.0);
        let sky = 0.3 + 0.5 * (1.0 - (i / width) as f32 / height as f32);
        if x * x + y * y < 200.0 { [40.0, 36.0, 30.0] } else { [0.8 * sky, 0.9 * sky, sky] }
    };
    let map = Image { width, height, pixels: (0..width * height).map(texel).collect() };
    let light = EnvironmentLight::new(&Environment { map, rotation: 0.7, intensity: 1.0 }).expect("a map of finite texels");
    let (u, wi) = ((0..INPUTS).map(|i| [unit(i, 3), unit(i, 4)]).collect::<Vec<_>>(), directions(0.2));
    each(criterion, "environment/sample", |i| light.sample(u[i]));
    each(criterion, "environment/radiance", |i| light.radiance(wi[i]));
    each(criterion, "environment/radiance and pdf", |i| light.radiance_and_pdf(wi[i]));
}

fn bsdf(criterion: &mut Criterion) {
    let (wo, wi) = (directions(0.05), directions(0.3));
    let u: Vec<[f32; 3]> = (0..INPUTS).map(|i| [unit(i, 5), unit(i, 6), unit(i, 7)]).collect();
    for (name, metallic, roughness) in [("dielectric", 0.0, 0.4), ("metal", 1.0, 0.3)] {
        let surface = Surface { base_color: Vec3A::new(0.8, 0.5, 0.2), metallic, roughness, ..Surface::default() };
        let bsdf = Bsdf::<false>::new(&surface, Mode::Conserving);
        each(criterion, &format!("{name}/new"), |_| Bsdf::<false>::new(black_box(&surface), Mode::Conserving));
        each(criterion, &format!("{name}/view and eval"), |i| bsdf.view(wo[i]).eval(wi[i]));
        each(criterion, &format!("{name}/view and sample"), |i| bsdf.view(wo[i]).sample(u[i][0], [u[i][1], u[i][2]]));
    }
}

criterion_group!(benches, sampler, environment, bsdf);
criterion_main!(benches);
