//! Every `sample` draws from the density that `pdf` claims: chi-square tests over materials, views and environments.

#[path = "common/chi_square.rs"]
mod chi_square;

use chi_square::{Counts, DirectionGrid, Random, assert_all, upper_gamma};
use glam::{DVec3, Vec3A};
use renderflow_frame::Environment;
use renderflow_frame::image::Rgb;
use renderflow_renderer::light::{EnvironmentLight, Sampling};
use renderflow_renderer::material::{Mode, Surface};
use renderflow_renderer::verify::lights;

type Bsdf = renderflow_renderer::material::Bsdf<true>;

const DRAWS: usize = 100_000;

fn surface(metallic: f32, roughness: f32, specular: f32) -> Surface {
    Surface { base_color: Vec3A::new(0.8, 0.4, 0.1), metallic, roughness, specular, ..Surface::default() }
}

fn view(cos: f32, phi: f32) -> Vec3A {
    let sin = (1.0 - cos * cos).sqrt();
    Vec3A::new(sin * phi.cos(), sin * phi.sin(), cos).normalize()
}

/// Counts of `sampler`'s draws in cells around the mirror direction against the density of `claimed`.
fn bsdf_counts(name: String, sampler: &Bsdf, claimed: &Bsdf, wo: Vec3A, spread: f64, seed: u64) -> Counts {
    let mirror = DVec3::new(f64::from(-wo.x), f64::from(-wo.y), f64::from(wo.z));
    let grid = DirectionGrid::new(mirror, spread, 20, 24);
    let mut expected = grid.integrate(&|wi| f64::from(claimed.pdf(wo, wi.as_vec3a())));
    // The last cell holds draws that carry nothing (below the horizon).
    expected.push(1.0 - expected.iter().sum::<f64>());
    let mut observed = vec![0.0; expected.len()];
    let mut random = Random::new(seed);
    for _ in 0..DRAWS {
        let (lobe, u) = (random.next(), [random.next(), random.next()]);
        let cell = sampler.sample(wo, lobe, u).map_or(grid.cells(), |drawn| grid.cell(drawn.wi.as_dvec3()));
        observed[cell] += 1.0;
    }
    let lost = expected[grid.cells()];
    assert!(lost > -2e-3, "{name}: the density integrates to {}", 1.0 - lost);
    expected[grid.cells()] = lost.max(0.0);
    let total: f64 = expected.iter().sum();
    let expected = expected.iter().map(|p| p / total * DRAWS as f64).collect();
    Counts { name, observed, expected }
}

#[test]
fn materials_are_drawn_from_their_density() {
    let mut experiments = Vec::new();
    for (metallic, specular) in [(0.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.5, 0.5), (1.0, 0.5)] {
        for roughness in [0.0_f32, 0.1, 0.3, 0.6, 1.0] {
            for (cos, phi) in [(1.0, 0.0), (0.8, 1.0), (0.4, 4.0), (0.1, 2.5)] {
                let wo = view(cos, phi);
                let bsdf = Bsdf::new(&surface(metallic, roughness, specular), Mode::Conserving);
                // Cells as fine as the lobe.
                let spread = f64::from(roughness.max(0.032)).powi(4);
                let name = format!("metallic {metallic} specular {specular} roughness {roughness} cos {cos}");
                let seed = experiments.len() as u64;
                experiments.push(bsdf_counts(name, &bsdf, &bsdf, wo, spread, seed));
            }
        }
    }
    assert_all(&experiments);
}

#[test]
fn a_wrong_density_is_refuted() {
    let sampler = Bsdf::new(&surface(1.0, 0.30, 0.5), Mode::Conserving);
    let claimed = Bsdf::new(&surface(1.0, 0.31, 0.5), Mode::Conserving);
    let counts = bsdf_counts("0.30 as 0.31".into(), &sampler, &claimed, view(0.8, 1.0), 0.02, 1);
    assert!(counts.p_value() < 1e-6, "{}", counts.p_value());
}

#[test]
fn incomplete_gamma_agrees_with_scipy() {
    // scipy.special.gammaincc of SciPy 1.17.1.
    for (a, x, q) in [
        (0.5, 0.5, 0.317_310_507_862_911_15),
        (10.0, 12.0, 0.242_392_161_670_512_47),
        (100.0, 80.0, 0.982_891_686_964_866_8),
        (250.0, 300.0, 0.001_377_471_877_528_201),
    ] {
        let computed = upper_gamma(a, x);
        assert!((computed - q).abs() < 1e-9 * q.max(1e-3), "Q({a}, {x}) = {computed}, not {q}");
    }
}

fn map(width: usize, height: usize, f: impl FnMut(usize, usize) -> [f32; 3]) -> Environment {
    Environment { map: Rgb::from_fn(width, height, f), rotation: 0.0, intensity: 1.0 }
}

fn sun(width: usize, height: usize, x: usize, y: usize, radiance: f32) -> Environment {
    map(width, height, |i, j| if (i, j) == (x, y) { [radiance, 0.9 * radiance, 0.5 * radiance] } else { [0.0; 3] })
}

/// Maps made here, and photographs where they are at hand.
fn environments() -> Vec<(String, Environment)> {
    let mut all = lights::environments();
    all.extend(photographs());
    all
}

fn photographs() -> Vec<(String, Environment)> {
    let mut all = Vec::new();
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/hdri");
    for name in ["potsdamer_platz_1k.hdr", "dikhololo_night_1k.hdr", "studio_small_03_1k.hdr"] {
        let path = folder.join(name);
        if !path.exists() {
            println!("{name} is skipped: not in {}", folder.display());
            continue;
        }
        let map = renderflow_frame::hdr::read(&path).unwrap_or_else(|error| panic!("{error}")).map;
        all.push((name.to_owned(), Environment { map, rotation: 0.7, intensity: 1.5 }));
    }
    all
}

/// Those made here are among the library's own checks.
#[test]
fn photographs_are_drawn_from_their_density() {
    let mut experiments = Vec::new();
    for (name, environment) in photographs() {
        for sampling in [Sampling::Plain, Sampling::Compensated] {
            let light = EnvironmentLight::with_sampling(&environment, sampling).expect("finite rotation and intensity");
            let name = format!("{name}, {sampling:?}");
            experiments.push(lights::environment_counts(&name, &environment, &light, DRAWS, experiments.len() as u64));
        }
    }
    assert_all(&experiments);
}

#[test]
fn environment_samples_agree_with_the_look_up() {
    for (name, environment) in environments() {
        let light = sampled(&environment);
        let largest = light_maximum(&environment);
        let mut random = Random::new(5);
        for _ in 0..20_000 {
            let Some(drawn) = light.sample([random.next(), random.next()]) else { continue };
            let looked_up = Vec3A::from(environment.radiance(drawn.wi));
            let difference = (drawn.radiance - looked_up).abs().max_element();
            // A step of a direction's rounding times the steepest slope between two texels.
            let slope = 4e-6 * environment.map.width.max(environment.map.height) as f32 * largest;
            assert!(difference <= 1e-3 * looked_up.max_element() + slope, "{name}: {drawn:?}, not {looked_up}");
            let (radiance, pdf) = light.radiance_and_pdf(drawn.wi);
            assert_eq!((radiance, pdf), (light.radiance(drawn.wi), light.pdf(drawn.wi)));
            let tolerance = 1e-3 * pdf + slope * pdf.max(drawn.pdf) / looked_up.max_element().max(1e-37);
            assert!((pdf - drawn.pdf).abs() <= tolerance, "{name}: {} not {pdf}", drawn.pdf);
            // Along the drawn direction the estimate of the whole sky's light stays bounded: no fireflies.
            assert!(drawn.pdf > 0.0 && drawn.radiance.is_finite());
        }
    }
}

fn sampled(environment: &Environment) -> EnvironmentLight {
    EnvironmentLight::with_sampling(environment, Sampling::Plain).expect("finite rotation and intensity")
}

fn light_maximum(environment: &Environment) -> f32 {
    environment.map.pixels.iter().flatten().copied().fold(0.0, f32::max) * environment.intensity
}

#[test]
fn density_covers_all_light() {
    for (name, environment) in environments() {
        let light = sampled(&environment);
        let largest = f64::from(light_maximum(&environment));
        let mut random = Random::new(6);
        for _ in 0..20_000 {
            let (z, phi) = (2.0 * random.next() - 1.0, std::f32::consts::TAU * random.next());
            let r = (1.0 - z * z).max(0.0).sqrt();
            let wi = Vec3A::new(r * phi.cos(), z, r * phi.sin());
            let radiance = f64::from(Vec3A::from(environment.radiance(wi)).max_element());
            if radiance > 1e-5 * largest {
                assert!(light.pdf(wi) > 0.0, "{name}: no density towards {wi}, radiance {radiance}");
            }
        }
    }
}

#[test]
fn the_estimate_of_irradiance_is_unbiased() {
    for (name, environment) in environments() {
        let light = sampled(&environment);
        let (m, n) = (1024_usize, 512_usize);
        // Average radiance over the sphere: the map integrated directly, and estimated from samples.
        let mut direct = 0.0;
        for j in 0..n * 2 {
            let v = (j as f64 + 0.5) / (2 * n) as f64;
            let weight = (std::f64::consts::PI * v).sin() * std::f64::consts::FRAC_PI_2 / (4 * m * n) as f64;
            for i in 0..m * 2 {
                let u = (i as f64 + 0.5) / (2 * m) as f64;
                direct +=
                    weight * f64::from(Vec3A::from(environment.radiance_uv(glam::Vec2::new(u as f32, v as f32))).element_sum());
            }
        }
        let side = 160;
        let mut estimate = 0.0;
        for k in 0..side * side {
            let u = [((k % side) as f32 + 0.5) / side as f32, ((k / side) as f32 + 0.5) / side as f32];
            if let Some(drawn) = light.sample(u) {
                estimate += f64::from(drawn.radiance.element_sum()) / f64::from(drawn.pdf);
            }
        }
        estimate /= (side * side) as f64 * 4.0 * std::f64::consts::PI;
        assert!((estimate / direct - 1.0).abs() < 4e-3, "{name}: {estimate} not {direct}");
    }
}

#[test]
fn black_environments_are_never_drawn() {
    for environment in [
        Environment::constant([0.0; 3]),
        map(16, 8, |_, _| [0.0; 3]),
        Environment { intensity: 0.0, ..sun(16, 8, 3, 3, 5.0) },
        map(0, 0, |_, _| [1.0; 3]),
    ] {
        let light = sampled(&environment);
        assert!(light.is_black() && light.sample([0.3, 0.6]).is_none());
        assert_eq!((light.pdf(Vec3A::Y), light.radiance(Vec3A::X)), (0.0, Vec3A::ZERO));
    }
    assert!(!sampled(&sun(16, 8, 3, 3, 5.0)).is_black());
}
