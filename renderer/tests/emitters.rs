//! Emissive triangles as lights: degenerate and extreme lists, exact probabilities, and the checks of the library.

use glam::Vec3A;
use renderflow_frame::Environment;
use renderflow_renderer::light::{EmissiveTriangle, EmitterLight, EnvironmentLight, LightSampler, MAX_RADIANCE, Source};
use renderflow_renderer::verify::chi_square::Random;
use renderflow_renderer::verify::{Effort, emitters};

fn triangle(id: u32, size: f32, radiance: f32) -> EmissiveTriangle {
    let corners = [Vec3A::ZERO, Vec3A::new(size, 0.0, 0.0), Vec3A::new(0.0, size, 0.0)];
    EmissiveTriangle { corners, radiance: Vec3A::splat(radiance), two_sided: false, id }
}

#[test]
fn checks_of_emitters_pass() {
    for check in emitters::CHECKS {
        for outcome in check.outcomes(Effort::Quick) {
            println!("{}: {}: {} of {} ({} cases)", check.name, outcome.name, outcome.worst, outcome.limit, outcome.cases);
            assert!(outcome.passed, "{}: {outcome:?}", check.name);
        }
    }
}

#[test]
fn what_cannot_emit_is_ignored_and_counted() {
    let flat = EmissiveTriangle { corners: [Vec3A::ZERO, Vec3A::X, Vec3A::X * 2.0], ..triangle(1, 1.0, 1.0) };
    let point = triangle(2, 0.0, 1.0);
    let black = triangle(3, 1.0, 0.0);
    let broken = [f32::NAN, f32::INFINITY, -1.0].map(|radiance| triangle(4, 1.0, radiance));
    let mut far = triangle(7, 1.0, 1.0);
    far.corners[1].x = f32::INFINITY;
    let all = [flat, point, black, broken[0], broken[1], broken[2], far];
    assert!(EmitterLight::new(all).is_none());
    let light = EmitterLight::new(all.into_iter().chain([triangle(8, 1.0, 1.0)])).expect("one emits");
    assert_eq!((light.count(), light.ignored()), (1, all.len()));
    assert_eq!(light.pdf(3, 1.0, 1.0), 0.0, "a black triangle is no light");
    assert!((light.pdf(8, 1.0, 1.0) - 2.0).abs() < 1e-6 && light.pdf(8, 1.0, -1.0) == 0.0);
}

#[test]
fn radiance_beyond_the_limit_is_limited_and_counted() {
    let light = EmitterLight::new([triangle(0, 1.0, 1e30), triangle(1, 1.0, f32::MAX)]).expect("both emit");
    assert_eq!((light.count(), light.limited()), (2, 1));
    // The second is drawn as one of the largest radiance allowed, not as one of 3e38.
    assert!((light.pdf(0, 1.0, 1.0) / 2.0 / (1e30 / (1e30 + MAX_RADIANCE)) - 1.0).abs() < 1e-4);
}

/// A million triangles of a thousand different powers: every one is drawn exactly as often as its density says.
#[test]
fn probabilities_are_exact_for_a_million_triangles() {
    let count = 1_000_000;
    let size = |id: u32| 1e-3 * (1.0 + (id % 1000) as f32);
    let light = EmitterLight::new((0..count).map(|id| triangle(id, size(id), 1.0))).expect("all emit");
    let mut expected: Vec<f64> = Vec::new();
    let mut total = 0.0;
    for id in 0..count {
        let area = 0.5 * f64::from(size(id)) * f64::from(size(id));
        let probability = f64::from(light.pdf(id, 1.0, 1.0)) * area;
        total += probability;
        expected.push(probability);
    }
    assert!((total - 1.0).abs() < 1e-6, "{total}");
    // All 2^23 random numbers that a generator of 23 bits has.
    let units = 1_u32 << 23;
    let mut drawn = vec![0_u32; count as usize];
    for unit in 0..units {
        let choice = unit as f32 / units as f32;
        if let Some(sample) = light.sample(Vec3A::new(0.1, 0.1, 2.0), choice, [0.3, 0.4]) {
            drawn[sample.id as usize] += 1;
        }
    }
    for (id, (&drawn, expected)) in drawn.iter().zip(expected).enumerate() {
        let found = f64::from(drawn) / f64::from(units);
        assert!((found - expected).abs() < 1e-6 * expected + 1e-12, "{id}: drawn {found}, claimed {expected}");
    }
}

#[test]
fn points_of_a_triangle_are_uniform() {
    let light = EmitterLight::new([triangle(0, 1.0, 1.0)]).expect("it emits");
    let mut random = Random::new(2);
    let mut sums = [0.0; 3];
    let n = 100_000;
    for _ in 0..n {
        let drawn = light.sample(Vec3A::new(0.2, 0.2, 3.0), 0.0, [random.next(), random.next()]).expect("it is in sight");
        assert!((drawn.barycentrics.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        sums.iter_mut().zip(drawn.barycentrics).for_each(|(s, b)| *s += f64::from(b * b));
    }
    // The mean of a squared barycentric coordinate is 1/6, its variance 7/180; four standard errors.
    let limit = 4.0 * (7.0_f64 / 180.0 / f64::from(n)).sqrt();
    assert!(sums.iter().all(|s| (s / f64::from(n) - 1.0 / 6.0).abs() < limit), "{sums:?}");
}

#[test]
fn one_kind_of_light_gets_all_samples() {
    let dark = || EnvironmentLight::new(&Environment::constant([0.0; 3])).expect("finite");
    let bright = || EnvironmentLight::new(&Environment::constant([1.0; 3])).expect("finite");
    let p = Vec3A::new(0.1, 0.1, 2.0);
    let sources = |sampler: &LightSampler| {
        let samples = (0..64).map(|i| sampler.sample(p, i as f32 / 64.0, [0.2, 0.3]));
        let (mut sky, mut emitter, mut none) = (0, 0, 0);
        for sample in samples {
            match sample.map(|s| s.source) {
                Some(Source::Environment { .. }) => sky += 1,
                Some(Source::Emitter { .. }) => emitter += 1,
                None => none += 1,
            }
        }
        (sky, emitter, none)
    };
    assert_eq!(sources(&LightSampler::new(dark(), [triangle(0, 1.0, 1.0)])), (0, 64, 0));
    assert_eq!(sources(&LightSampler::new(bright(), [])), (64, 0, 0));
    assert_eq!(sources(&LightSampler::new(dark(), [])), (0, 0, 64));
    let both = LightSampler::new(bright(), [triangle(0, 1.0, 1.0)]);
    assert_eq!(sources(&both), (32, 32, 0));
    assert!((both.pdf_environment(Vec3A::Y) - 0.125 / std::f32::consts::PI).abs() < 1e-7);
    assert!((both.pdf_emitter(0, 2.0, 0.5) - 8.0).abs() < 1e-5 && both.pdf_emitter(1, 2.0, 0.5) == 0.0);
}
