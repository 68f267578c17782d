//! Environment maps at their limits: what is refused, what is repaired and counted, one-texel suns, sizes of every kind.

mod common;

use glam::{Affine3A, Vec3, Vec3A};
use renderflow_frame::Environment;
use renderflow_frame::image::Rgb;
use renderflow_renderer::light::{EnvironmentLight, MAX_RADIANCE, Repairs, Sampling};
use renderflow_renderer::verify::chi_square::Random;
use renderflow_renderer::verify::{Effort, lights};

fn environment(width: usize, height: usize, f: impl FnMut(usize, usize) -> [f32; 3]) -> Environment {
    Environment { map: Rgb::from_fn(width, height, f), rotation: 0.0, intensity: 1.0 }
}

fn grey(width: usize, height: usize) -> Environment {
    environment(width, height, |x, y| [((x * 7 + y * 3) % 5) as f32 * 0.25; 3])
}

#[test]
fn checks_of_environments_pass() {
    for check in lights::CHECKS {
        for outcome in check.outcomes(Effort::Quick) {
            println!("{}: {}: {} of {} ({} cases)", check.name, outcome.name, outcome.worst, outcome.limit, outcome.cases);
            assert!(outcome.passed, "{}: {outcome:?}", check.name);
        }
    }
}

#[test]
fn broken_settings_are_refused_by_name() {
    for intensity in [f32::NAN, f32::INFINITY, -1.0] {
        let error = EnvironmentLight::new(&Environment { intensity, ..grey(4, 2) }).expect_err("refused").to_string();
        assert!(error.starts_with("/environment/intensity: "), "{error}");
    }
    for rotation in [f32::NAN, f32::NEG_INFINITY] {
        let error = EnvironmentLight::new(&Environment { rotation, ..grey(4, 2) }).expect_err("refused").to_string();
        assert!(error.starts_with("/environment/rotation: "), "{error}");
    }
    let mut cut = grey(4, 2);
    cut.map.pixels.pop();
    let error = EnvironmentLight::new(&cut).expect_err("refused").to_string();
    assert_eq!(error, "/environment/map: 7 texels for 4 x 2");
}

#[test]
fn texels_that_are_no_radiance_are_counted() {
    let mut broken = grey(16, 8);
    broken.map.pixels[3] = [f32::NAN, -1.0, 1.0];
    broken.map.pixels[50] = [f32::INFINITY, 1e31, f32::NEG_INFINITY];
    broken.map.pixels[70] = [f32::MAX, -0.0, 0.0];
    for (intensity, limited) in [(1.0, 2), (100.0, 3), (1e-38, 1), (f32::MAX, 3 + grey_components(&broken))] {
        let light = EnvironmentLight::new(&Environment { intensity, ..broken.clone() }).expect("repaired");
        assert_eq!(light.repairs(), Repairs { black: 3, limited }, "intensity {intensity}");
        let infinite = light.radiance(broken.texel_direction(50 % 16, 50 / 16)).x;
        assert!((infinite / MAX_RADIANCE - 1.0).abs() < 1e-3, "intensity {intensity}: {infinite}");
        let mut random = Random::new(1);
        for _ in 0..2000 {
            let (radiance, pdf) = light.radiance_and_pdf(random.direction().as_vec3a());
            assert!(radiance.is_finite() && radiance.cmpge(Vec3A::ZERO).all() && radiance.max_element() <= MAX_RADIANCE);
            assert!(pdf.is_finite() && pdf >= 0.0);
            if let Some(drawn) = light.sample([random.next(), random.next()]) {
                assert!(drawn.radiance.is_finite() && drawn.pdf > 0.0 && drawn.pdf.is_finite());
                assert!((drawn.radiance / drawn.pdf).is_finite());
            }
        }
    }
    assert_eq!(EnvironmentLight::new(&grey(16, 8)).expect("sound").repairs(), Repairs::default());
    let nothing = environment(4, 2, |x, _| [if x == 0 { f32::NAN } else { -1.0 }; 3]);
    let light = EnvironmentLight::new(&nothing).expect("repaired");
    assert!(light.is_black() && light.repairs().black == 24);
}

/// Positive components of [`grey`] that are left in a map; all of them overflow with the largest gain.
fn grey_components(environment: &Environment) -> usize {
    environment.map.pixels.iter().flatten().filter(|v| (0.1..=1.0).contains(*v)).count()
}

#[test]
fn sums_of_the_brightest_texels_stay_finite() {
    let bright = environment(64, 32, |x, _| if x % 2 == 0 { [1e30, 9e29, 1e30] } else { [1e29, 1e30, 1e30] });
    for sampling in [Sampling::Plain, Sampling::Compensated] {
        let light = EnvironmentLight::with_sampling(&bright, sampling).expect("in range");
        assert_eq!(light.repairs(), Repairs::default(), "1e30 is no overflow");
        let mut random = Random::new(4);
        for _ in 0..10_000 {
            let (radiance, pdf) = light.radiance_and_pdf(random.direction().as_vec3a());
            assert!(radiance.is_finite() && pdf.is_finite());
        }
    }
}

/// The reach of texels is a partition of the sphere.
#[test]
fn reaches_of_texels_sum_to_the_sphere() {
    for (width, height) in [(1, 1), (2, 1), (1, 2), (5, 3), (1024, 512), (8192, 4096)] {
        let sum: f64 = (0..height).map(|row| lights::texel_reach(width, height, row) * width as f64).sum();
        assert!((sum / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-12, "{width} x {height}: {sum}");
    }
}

/// Irradiance of a plane under one bright texel: its radiance times its reach times the cosine at its centre.
#[test]
fn one_texel_lights_a_plane_by_its_reach() {
    let (width, height, row) = (512, 256, 60);
    let radiance = 5e6;
    let sun = environment(width, height, |x, y| if (x, y) == (100, row) { [radiance; 3] } else { [0.0; 3] });
    let cos = f64::from(sun.texel_direction(100, row).y);
    let truth = f64::from(radiance) * lights::texel_reach(width, height, row) * cos;
    for sampling in [Sampling::Plain, Sampling::Compensated] {
        let light = EnvironmentLight::with_sampling(&sun, sampling).expect("in range");
        let mut random = Random::new(8);
        let draws = 20_000;
        let mut values = Vec::with_capacity(draws);
        for _ in 0..draws {
            let drawn = light.sample([random.next(), random.next()]);
            values.push(drawn.map_or(0.0, |d| f64::from(d.radiance.x) * f64::from(d.wi.y.max(0.0)) / f64::from(d.pdf)));
        }
        let mean = values.iter().sum::<f64>() / draws as f64;
        let error = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / draws as f64 / draws as f64).sqrt();
        // Compensation cuts off 4e-6 of the peak. The cosine over the reach differs from that at its centre by 1e-4 at most.
        println!("{sampling:?}: {mean} of {truth}, standard error {error}");
        assert!((mean - truth).abs() < 4.0 * error + 2e-4 * truth, "{sampling:?}: {mean} of {truth}, standard error {error}");
    }
}

/// Leaving faint directions to samples of the material changes the noise of a picture, not its mean.
#[test]
fn compensated_pictures_have_the_mean_of_plain_ones() {
    use common::{camera, compile, diffuse, plane, render, scene, sphere, sunny};
    use renderflow_scenes::{Material, Principled};
    let lobes = [
        diffuse([0.7; 3]),
        Material::from(Principled { roughness: 0.05, ..Principled::default() }),
        Material { surface: Principled { metallic: 1.0, roughness: 0.5, ..diffuse([0.9; 3]).surface }, ..diffuse([0.9; 3]) },
    ];
    for material in lobes {
        let parts = vec![
            (plane(4.0), material.clone(), Affine3A::IDENTITY),
            (sphere(12, true), material, Affine3A::from_translation(Vec3::Y)),
        ];
        let view = camera([0.0, 2.5, 5.0], [0.0, 0.6, 0.0], 35.0, 16, 16);
        let mut pictures = Vec::new();
        for (seed, sampling) in [(1, Sampling::Plain), (2, Sampling::Compensated)] {
            let mut loaded = scene(parts.clone(), sunny(), view);
            loaded.seed = seed;
            let mut compiled = compile(&loaded);
            compiled.set_environment_sampling(sampling).expect("compiled already");
            let (frame, _) = render(&compiled, 256);
            let sum = |pixels: &[[f32; 3]]| pixels.iter().map(|p| f64::from(p[1])).sum::<f64>();
            pictures.push((sum(&frame.raw.expect("rendered").pixels), sum(&frame.variance.expect("rendered").pixels)));
        }
        let [(a, va), (b, vb)] = pictures[..] else { unreachable!("two ways") };
        // The variance of stratified samples is overestimated: this is less than the standard error it is called.
        let errors = (a - b).abs() / (va + vb).sqrt();
        println!("{a} {b}: {errors} standard errors");
        assert!(errors < 4.0 && (a / b - 1.0).abs() < 0.01, "{a} {b}: {errors} standard errors");
    }
}

#[test]
fn tables_do_not_depend_on_threads() {
    let map = grey(301, 77);
    let draws = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let light = pool.install(|| EnvironmentLight::new(&map).expect("in range"));
        let mut random = Random::new(9);
        (0..500).map(|_| light.sample([random.next(), random.next()])).collect::<Vec<_>>()
    };
    let one = draws(1);
    assert_eq!(one, draws(3));
    assert_eq!(one, draws(7));
}
