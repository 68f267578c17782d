//! Every `sample` draws from the density that `pdf` claims: chi-square tests over materials, views and environments.

#[path = "common/chi_square.rs"]
mod chi_square;

use chi_square::{Counts, DirectionGrid, Random, assert_all, upper_gamma};
use glam::{DVec3, Vec3A};
use renderflow_frame::Environment;
use renderflow_frame::image::Rgb;
use renderflow_renderer::light::EnvironmentLight;
use renderflow_renderer::material::{Mode, Surface};

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

/// Counts in cells of the map's own coordinates, found by the environment's look-up and not by the sampler's.
fn environment_counts(name: &str, environment: &Environment, seed: u64) -> Counts {
    let light = EnvironmentLight::new(environment);
    let (width, height) = (environment.map.width, environment.map.height);
    // The density has its kinks at texel centres and is integrated on half texels; cells are groups of these.
    let (columns, rows) = (2 * width, 2 * height);
    let (cell_columns, cell_rows) = (divisor(columns, 64), divisor(rows, 32));
    let steps = (1024 / columns).clamp(1, 32);
    let mut expected = vec![0.0; cell_columns * cell_rows];
    let (m, n) = (columns * steps, rows * steps);
    for j in 0..n {
        let v = (j as f64 + 0.5) / n as f64;
        let solid_angle = (std::f64::consts::PI * v).sin() * 2.0 * std::f64::consts::PI.powi(2) / (m * n) as f64;
        for i in 0..m {
            let uv = glam::DVec2::new((i as f64 + 0.5) / m as f64, v);
            let pdf = light.pdf(environment.direction(uv.as_vec2()));
            expected[j * cell_rows / n * cell_columns + i * cell_columns / m] += f64::from(pdf) * solid_angle;
        }
    }
    let total: f64 = expected.iter().sum();
    assert!((total - 1.0).abs() < 4e-3, "{name}: the density integrates to {total}");

    let mut observed = vec![0.0; expected.len()];
    let mut random = Random::new(seed);
    for _ in 0..DRAWS {
        // A draw on the very rim of a light is none; it has probability zero but for the rounding of `u`.
        let drawn = std::iter::repeat_with(|| light.sample([random.next(), random.next()])).take(3).flatten().next();
        let drawn = drawn.unwrap_or_else(|| panic!("{name} is not black"));
        assert!((drawn.wi.length() - 1.0).abs() < 1e-5, "{name}: {drawn:?}");
        let uv = environment.uv(drawn.wi);
        let column = ((uv.x * cell_columns as f32) as usize).min(cell_columns - 1);
        let row = ((uv.y * cell_rows as f32) as usize).min(cell_rows - 1);
        observed[row * cell_columns + column] += 1.0;
    }
    let expected = expected.iter().map(|p| p / total * DRAWS as f64).collect();
    Counts { name: name.into(), observed, expected }
}

/// The largest divisor of `n` that is at most `limit`.
fn divisor(n: usize, limit: usize) -> usize {
    (1..=limit.min(n)).rev().find(|&k| n.is_multiple_of(k)).unwrap_or(1)
}

fn map(width: usize, height: usize, f: impl FnMut(usize, usize) -> [f32; 3]) -> Environment {
    Environment { map: Rgb::from_fn(width, height, f), rotation: 0.0, intensity: 1.0 }
}

fn sun(width: usize, height: usize, x: usize, y: usize, radiance: f32) -> Environment {
    map(width, height, |i, j| if (i, j) == (x, y) { [radiance, 0.9 * radiance, 0.5 * radiance] } else { [0.0; 3] })
}

/// Environments of every kind the light must cope with.
fn environments() -> Vec<(String, Environment)> {
    let gradient = |width: usize, height: usize| {
        map(width, height, move |x, y| [(x + 1) as f32, (y + 1) as f32 * 0.5, ((x * y) % 7) as f32])
    };
    let mut all = vec![
        ("constant".to_owned(), Environment::constant([0.2, 0.4, 0.6])),
        ("flat map".to_owned(), map(8, 4, |_, _| [2.0; 3])),
        ("gradient".to_owned(), gradient(32, 16)),
        ("gradient, turned".to_owned(), Environment { rotation: 2.1, intensity: 3.0, ..gradient(32, 16) }),
        ("gradient, turned back".to_owned(), Environment { rotation: -7.3, ..gradient(16, 8) }),
        ("odd width".to_owned(), gradient(5, 3)),
        ("two texels".to_owned(), gradient(2, 1)),
        ("one column".to_owned(), gradient(1, 4)),
        ("sun".to_owned(), sun(64, 32, 40, 9, 1e5)),
        ("sun over the seam, turned".to_owned(), Environment { rotation: 1.0, ..sun(64, 32, 63, 20, 1e5) }),
        ("sun in the zenith".to_owned(), sun(64, 32, 5, 0, 1.0)),
        ("sun in the nadir, odd width".to_owned(), sun(31, 16, 0, 15, 1.0)),
        ("sun of 1e30".to_owned(), sun(64, 32, 10, 10, 1e30)),
        ("faint and bright".to_owned(), map(16, 8, |x, y| [10.0_f32.powi((x as i32 - 8) * 3), y as f32 * 1e-3, 0.0])),
    ];
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/hdri");
    for name in ["potsdamer_platz_1k.hdr", "dikhololo_night_1k.hdr", "studio_small_03_1k.hdr"] {
        let path = folder.join(name);
        if !path.exists() {
            println!("skipped {name}: not in {}", folder.display());
            continue;
        }
        let map = renderflow_frame::hdr::read(&path).unwrap_or_else(|error| panic!("{error}")).map;
        all.push((name.to_owned(), Environment { map, rotation: 0.7, intensity: 1.5 }));
    }
    all
}

#[test]
fn environments_are_drawn_from_their_density() {
    let experiments: Vec<Counts> = environments()
        .iter()
        .enumerate()
        .map(|(i, (name, environment))| environment_counts(name, environment, 1000 + i as u64))
        .collect();
    assert_all(&experiments);
}

#[test]
fn environment_samples_agree_with_the_look_up() {
    for (name, environment) in environments() {
        let light = EnvironmentLight::new(&environment);
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

fn light_maximum(environment: &Environment) -> f32 {
    environment.map.pixels.iter().flatten().copied().fold(0.0, f32::max) * environment.intensity
}

#[test]
fn density_covers_all_light() {
    for (name, environment) in environments() {
        let light = EnvironmentLight::new(&environment);
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
        let light = EnvironmentLight::new(&environment);
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
        let light = EnvironmentLight::new(&environment);
        assert!(light.is_black() && light.sample([0.3, 0.6]).is_none());
        assert_eq!((light.pdf(Vec3A::Y), light.radiance(Vec3A::X)), (0.0, Vec3A::ZERO));
    }
    assert!(!EnvironmentLight::new(&sun(16, 8, 3, 3, 5.0)).is_black());
}
