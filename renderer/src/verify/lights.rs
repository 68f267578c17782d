//! Environment light: every sample is drawn from the density claimed for it, and estimates have the mean known on paper.

use super::chi_square::{Counts, Random, judge};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::light::{EnvironmentLight, Sampling};
use glam::{DVec3, Vec3A};
use renderflow_frame::Environment;
use renderflow_frame::image::Rgb;
use std::f64::consts::{PI, TAU};

/// The checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "lights.environment_draws",
        about: "directions drawn from environment maps against their density, all of the radiance and compensated (chi-square)",
        run: environment_draws,
    },
    Check {
        name: "lights.environment_lookup",
        about: "samples of environment maps agree with the look-up, some density is wherever there is light, and none where there is none",
        run: environment_lookup,
    },
    Check {
        name: "lights.environment_means",
        about: "mean radiance over the sphere, estimated with and without multiple importance sampling, against the exact sum; \
                integrals of densities against 1",
        run: environment_means,
    },
    Check {
        name: "lights.environment_suns",
        about: "a single texel of 1e30 in a grey map of up to 8192 x 4096: densities, weights and estimates",
        run: environment_suns,
    },
];

/// Environments of every kind that a light must cope with: odd, tiny, flat, turned, with one-texel suns at poles and seams.
pub fn environments() -> Vec<(String, Environment)> {
    let map = |width, height, f: &dyn Fn(usize, usize) -> [f32; 3]| Environment {
        map: Rgb::from_fn(width, height, f),
        rotation: 0.0,
        intensity: 1.0,
    };
    let gradient = |width, height| map(width, height, &|x, y| [(x + 1) as f32, (y + 1) as f32 * 0.5, ((x * y) % 7) as f32]);
    let sun = |width, height, x, y, radiance: f32| {
        map(width, height, &|i, j| if (i, j) == (x, y) { [radiance, 0.9 * radiance, 0.5 * radiance] } else { [0.1, 0.2, 0.3] })
    };
    let mut all = vec![
        ("1 x 1".to_owned(), map(1, 1, &|_, _| [0.3, 0.2, 0.1])),
        ("flat".to_owned(), map(8, 4, &|_, _| [2.0; 3])),
        ("turned".to_owned(), Environment { rotation: 2.1, intensity: 3.0, ..gradient(32, 16) }),
        ("faint and bright".to_owned(), map(16, 8, &|x, y| [10.0_f32.powi((x as i32 - 8) * 3), y as f32 * 1e-3, 0.0])),
        ("sun alone".to_owned(), map(64, 32, &|x, y| if (x, y) == (40, 9) { [1e30, 9e29, 5e29] } else { [0.0; 3] })),
        ("sun at the seam, turned".to_owned(), Environment { rotation: 1.0, ..sun(64, 32, 63, 20, 1e5) }),
        ("sun of half the light".to_owned(), sun(64, 32, 11, 7, 300.0)),
    ];
    for (width, height) in [(2, 1), (1, 2), (1, 7), (3, 1), (5, 3), (33, 17)] {
        all.push((format!("{width} x {height}"), gradient(width, height)));
    }
    for (width, height) in [(64, 32), (31, 16)] {
        for y in [0, height - 1] {
            all.push((format!("sun at a pole, {width} x {height}, row {y}"), sun(width, height, 5, y, 1000.0)));
        }
    }
    all
}

/// Solid angle of the reach of one texel of row `row`: the integral over the sphere of its weight in the bilinear interpolation.
/// All texels sum to 4 pi.
pub fn texel_reach(width: usize, height: usize, row: usize) -> f64 {
    let h = PI / height as f64;
    let centre = (row as f64 + 0.5) * h;
    // Integrals over 0..h of (1 - x / h) cos x and (1 - x / h) sin x.
    let even = 2.0 * (0.5 * h).sin().powi(2) / h;
    // By its series where the difference would lose digits.
    let odd = if h < 0.05 { h * h / 6.0 * (1.0 - h * h / 20.0 * (1.0 - h * h / 42.0)) } else { 1.0 - h.sin() / h };
    let down = centre.sin() * even + centre.cos() * odd;
    let up = centre.sin() * even - centre.cos() * odd;
    // Beyond the first and last row the map continues half a turn away: on the average over azimuth the weight stays 1.
    let cap = 2.0 * (0.25 * h).sin().powi(2);
    let above = if row == 0 { cap } else { up };
    let below = if row + 1 == height { cap } else { down };
    TAU / width as f64 * (above + below)
}

/// Exact mean radiance over the sphere of the interpolated map, gain applied; channels averaged.
fn exact_mean(environment: &Environment) -> f64 {
    let map = &environment.map;
    let rows = map.pixels.chunks_exact(map.width).enumerate();
    let sum: f64 = rows
        .map(|(y, row)| {
            let sum: f64 = row.iter().flatten().map(|&v| f64::from(v)).sum();
            sum * texel_reach(map.width, map.height, y)
        })
        .sum();
    sum / 3.0 / (4.0 * PI) * f64::from(environment.intensity)
}

/// Integrals of a light's density over half texels, row by row, `2 * width` times `2 * height`. There the density is linear in
/// azimuth and in the cosine of the polar angle, so that its value in the middle times the solid angle is the integral.
fn half_texel_integrals(environment: &Environment, light: &EnvironmentLight) -> Vec<f64> {
    let (columns, rows) = (2 * environment.map.width, 2 * environment.map.height);
    let mut integrals = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        let edge = |j: usize| (PI * j as f64 / rows as f64).cos();
        let (y, extent) = (0.5 * (edge(j) + edge(j + 1)), edge(j) - edge(j + 1));
        let r = (1.0 - y * y).sqrt();
        for i in 0..columns {
            let phi = TAU * (i as f64 + 0.5) / columns as f64 - f64::from(environment.rotation);
            let wi = DVec3::new(r * phi.sin(), y, -r * phi.cos());
            integrals.push(f64::from(light.pdf(wi.as_vec3a())) * extent * TAU / columns as f64);
        }
    }
    integrals
}

/// `draws` directions of a light counted in cells of half texels, grouped to at most 64 x 32.
pub fn environment_counts(name: &str, environment: &Environment, light: &EnvironmentLight, draws: usize, seed: u64) -> Counts {
    let (columns, rows) = (2 * environment.map.width, 2 * environment.map.height);
    let divisor = |n: usize, limit: usize| (1..=limit.min(n)).rev().find(|&k| n.is_multiple_of(k)).unwrap_or(1);
    let (m, n) = (divisor(columns, 64), divisor(rows, 32));
    let mut expected = vec![0.0; m * n];
    for (i, integral) in half_texel_integrals(environment, light).into_iter().enumerate() {
        expected[(i / columns) * n / rows * m + (i % columns) * m / columns] += integral;
    }
    let mut counts = Counts::new(name, expected);
    let mut random = Random::new(seed);
    for _ in 0..draws {
        // A draw on the very rim of a light is none.
        let Some(drawn) = light.sample([random.next(), random.next()]) else { continue };
        // The map coordinates by the system's own functions, not by the look-up of the light.
        let d = drawn.wi.as_dvec3();
        let turns = (d.x.atan2(-d.z) + f64::from(environment.rotation)) / TAU;
        let v = d.x.hypot(d.z).atan2(d.y) / PI;
        let column = (((turns - turns.floor()) * m as f64) as usize).min(m - 1);
        counts.add(((v * n as f64) as usize).min(n - 1) * m + column);
    }
    counts
}

/// Both ways to sample.
const SAMPLINGS: [(&str, Sampling); 2] = [("plain", Sampling::Plain), ("compensated", Sampling::Compensated)];

/// Every environment as a light, both ways, with its name; environments that are refused are the worst of all.
fn lights(refused: &mut Vec<String>) -> Vec<(String, Environment, EnvironmentLight)> {
    let mut lights = Vec::new();
    for (name, environment) in environments() {
        for (way, sampling) in SAMPLINGS {
            match EnvironmentLight::with_sampling(&environment, sampling) {
                Ok(light) => lights.push((format!("{name}, {way}"), environment.clone(), light)),
                Err(error) => refused.push(format!("{name}: {error}")),
            }
        }
    }
    lights
}

fn environment_draws(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let mut refused = Vec::new();
    let lights = lights(&mut refused);
    ticker.expect(lights.len() as u64);
    let mut experiments = Vec::new();
    for (i, (name, environment, light)) in lights.iter().enumerate() {
        if ticker.cancelled() {
            break;
        }
        experiments.push(environment_counts(name, environment, light, effort.pick(50_000, 1_000_000), 100 + i as u64));
        ticker.add(1);
    }
    vec![
        judge("draws follow the density", &experiments),
        Outcome::at_most("environments refused", lights.len() as u64, refused.len() as f64, 0.0, refused.join("; ")),
    ]
}

fn environment_lookup(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let draws = effort.pick(20_000, 200_000);
    let all = environments();
    ticker.expect(all.len() as u64);
    let (mut radiances, mut densities, mut missing) = (Worst::default(), Worst::default(), Worst::default());
    for (name, environment) in &all {
        if ticker.cancelled() {
            break;
        }
        let Ok(light) = EnvironmentLight::with_sampling(environment, Sampling::Plain) else { continue };
        let largest = environment.map.pixels.iter().flatten().copied().fold(0.0, f32::max) * environment.intensity;
        // A step of a direction's rounding times the steepest slope between two texels.
        let slope = 4e-6 * environment.map.width.max(environment.map.height) as f32 * largest;
        let mut random = Random::new(5);
        for _ in 0..draws {
            let Some(drawn) = light.sample([random.next(), random.next()]) else { continue };
            let looked_up = Vec3A::from(environment.radiance(drawn.wi));
            let tolerance = 1e-3 * looked_up.max_element() + slope;
            let difference = (drawn.radiance - looked_up).abs().max_element();
            radiances.see(f64::from(difference / tolerance), || format!("{name}: {drawn:?}, not {looked_up}"));
            let (radiance, pdf) = light.radiance_and_pdf(drawn.wi);
            let same = (radiance, pdf) == (light.radiance(drawn.wi), light.pdf(drawn.wi));
            let tolerance = 1e-3 * pdf + slope * pdf.max(drawn.pdf) / looked_up.max_element().max(1e-37);
            let difference = if same && drawn.pdf > 0.0 { (pdf - drawn.pdf).abs() / tolerance } else { f32::NAN };
            densities.see(difference.into(), || format!("{name}: {drawn:?}, not {pdf}"));
        }
        let mut random = Random::new(6);
        for _ in 0..draws {
            let wi = random.direction().as_vec3a();
            let lit = Vec3A::from(environment.radiance(wi)).max_element() > 1e-5 * largest;
            missing.see(f64::from(u8::from(lit && light.pdf(wi) <= 0.0)), || format!("{name}: towards {wi}"));
        }
        ticker.add(1);
    }
    vec![
        radiances.at_most("radiance of samples, share of the tolerance", 1.0),
        densities.at_most("density of samples, share of the tolerance", 1.0),
        missing.at_most("directions with light and without density", 0.0),
        black_is_never_drawn(),
    ]
}

/// Black environments, and those without texels, are no lights.
fn black_is_never_drawn() -> Outcome {
    let map =
        |width, height, value: f32| Environment { map: Rgb::filled(width, height, [value; 3]), rotation: 0.0, intensity: 1.0 };
    let unlit = Environment { intensity: 0.0, ..map(16, 8, 5.0) };
    let mut worst = Worst::default();
    for (name, environment) in [
        ("constant", Environment::constant([0.0; 3])),
        ("map", map(16, 8, 0.0)),
        ("no gain", unlit),
        ("no texels", map(0, 0, 1.0)),
    ] {
        let dark = EnvironmentLight::with_sampling(&environment, Sampling::Plain).is_ok_and(|light| {
            let nothing = (light.pdf(Vec3A::Y), light.radiance(Vec3A::X)) == (0.0, Vec3A::ZERO);
            nothing && light.is_black() && light.sample([0.3, 0.6]).is_none()
        });
        worst.see(f64::from(u8::from(!dark)), || name.to_owned());
    }
    worst.at_most("black environments that are lights", 0.0)
}

/// Mean and its standard error of `draws` values.
pub(super) fn estimate(draws: usize, mut value: impl FnMut() -> f64) -> (f64, f64) {
    // Against the first value: the squares of 1e30 would otherwise cancel.
    let first = value();
    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 1..draws {
        let d = value() - first;
        sum += d;
        squares += d * d;
    }
    let n = draws as f64;
    let mean = sum / n;
    (first + mean, ((squares / n - mean * mean).max(0.0) / n).sqrt())
}

/// Distance of an estimate from the truth in standard errors; rounding of single precision (2e-5 of the truth) counts as one
/// more.
pub(super) fn standard_errors((mean, error): (f64, f64), truth: f64) -> f64 {
    (mean - truth).abs() / (error + 2e-5 * truth.abs()).max(f64::MIN_POSITIVE)
}

/// Power heuristic for a strategy with density `a` > 0 against `b`.
fn mis_weight(a: f64, b: f64) -> f64 {
    1.0 / (1.0 + (b / a) * (b / a))
}

fn environment_means(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let draws = effort.pick(40_000, 1_000_000);
    let lights = lights(&mut Vec::new());
    ticker.expect(lights.len() as u64);
    let (mut totals, mut alone, mut weighted) = (Worst::default(), Worst::default(), Worst::default());
    for (i, (name, environment, light)) in lights.iter().enumerate() {
        if ticker.cancelled() {
            break;
        }
        let total: f64 = half_texel_integrals(environment, light).iter().sum();
        totals.see((total - 1.0).abs(), || name.clone());
        let truth = exact_mean(environment);
        let mut random = Random::new(500 + i as u64);
        let average = |radiance: Vec3A| f64::from(radiance.x) / 3.0 + f64::from(radiance.y) / 3.0 + f64::from(radiance.z) / 3.0;
        let uniform = 0.25 / PI;
        if i % SAMPLINGS.len() == 0 {
            let found = estimate(draws, || {
                let drawn = light.sample([random.next(), random.next()]);
                drawn.map_or(0.0, |drawn| average(drawn.radiance) / f64::from(drawn.pdf) * uniform)
            });
            alone.see(standard_errors(found, truth), || format!("{name}: {found:?}, not {truth}"));
        }
        // One sample of the light and one of all directions.
        let found = estimate(draws, || {
            let drawn = light.sample([random.next(), random.next()]).map_or(0.0, |drawn| {
                let pdf = f64::from(drawn.pdf);
                average(drawn.radiance) / pdf * mis_weight(pdf, uniform)
            });
            let (radiance, pdf) = light.radiance_and_pdf(random.direction().as_vec3a());
            (drawn + average(radiance) / uniform * mis_weight(uniform, f64::from(pdf))) * uniform
        });
        weighted.see(standard_errors(found, truth), || format!("{name}: {found:?}, not {truth}"));
        ticker.add(1);
    }
    // Four standard errors for each of some forty means: together they hold with a probability of 99.7 %.
    vec![
        totals.at_most("integrals of densities, distance from 1", 1e-4),
        alone.at_most("light samples alone, standard errors", 4.0),
        weighted.at_most("with multiple importance sampling, standard errors", 4.0),
    ]
}

/// What is found of a light whose map of `width` x `height` texels of 1e-3 has a single one of 1e30 in the middle of row `row`.
#[derive(Clone, Copy, Debug)]
pub struct OneTexelSun {
    /// Samples, densities or weights of samples that were not finite, not positive or outside 0..=1.
    pub broken: usize,
    /// Distance of the estimate of mean radiance from the exact sum, in standard errors.
    pub standard_errors: f64,
}

/// Draws `draws` samples of a light with a one-texel sun; `None` if the map is refused.
pub fn one_texel_sun(width: usize, height: usize, row: usize, draws: usize) -> Option<OneTexelSun> {
    let mut map = Rgb::filled(width, height, [1e-3; 3]);
    *map.pixels.get_mut(row * width + width / 2)? = [1e30; 3];
    let environment = Environment { map, rotation: 0.4, intensity: 1.0 };
    let light = EnvironmentLight::with_sampling(&environment, Sampling::Plain).ok()?;
    let mut random = Random::new(row as u64);
    let mut broken = 0;
    let found = estimate(draws, || {
        let Some(drawn) = light.sample([random.next(), random.next()]) else { return 0.0 };
        let (radiance, pdf) = light.radiance_and_pdf(drawn.wi);
        // Against a diffuse lobe and a mirror-like one.
        let weights = [0.3, 1e6].map(|b| mis_weight(f64::from(drawn.pdf), b));
        let sound = drawn.wi.is_finite()
            && drawn.radiance.is_finite()
            && radiance.is_finite()
            && drawn.radiance.cmpge(Vec3A::ZERO).all()
            && drawn.pdf > 0.0
            && drawn.pdf.is_finite()
            && pdf.is_finite()
            && weights.iter().all(|w| (0.0..=1.0).contains(w));
        broken += usize::from(!sound);
        f64::from(drawn.radiance.x) / f64::from(drawn.pdf) * 0.25 / PI
    });
    Some(OneTexelSun { broken, standard_errors: standard_errors(found, exact_mean(&environment)) })
}

fn environment_suns(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let sizes = effort.pick(&[(512, 256), (1024, 512)][..], &[(1024, 512), (1023, 511), (8192, 4096)][..]);
    ticker.expect(3 * sizes.len() as u64);
    let (mut broken, mut means) = (Worst::default(), Worst::default());
    for &(width, height) in sizes {
        for row in [0, height / 3, height - 1] {
            if ticker.cancelled() {
                break;
            }
            let place = || format!("{width} x {height}, row {row}");
            match one_texel_sun(width, height, row, effort.pick(20_000, 1_000_000)) {
                Some(found) => {
                    broken.see(found.broken as f64, place);
                    means.see(found.standard_errors, place);
                }
                None => broken.see(f64::NAN, place),
            }
            ticker.add(1);
        }
    }
    vec![
        broken.at_most("samples that are not finite and positive", 0.0),
        means.at_most("mean radiance over the sphere, standard errors", 4.0),
    ]
}
