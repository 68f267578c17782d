//! Split-sum tables against integrals known in closed form or taken numerically in f64.

use glam::Vec3A;
use renderflow_frame::environment::Environment;
use renderflow_frame::fresnel::Dielectric;
use renderflow_frame::ibl::{IblTables, LEVELS, dielectric, environment_brdf, exposure, f0};
use renderflow_frame::image::Rgb;
use std::f64::consts::PI;

fn map(width: usize, height: usize, radiance: impl Fn(Vec3A) -> [f32; 3]) -> Environment {
    let plain = Environment { map: Rgb::filled(width, height, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
    let map = Rgb::from_fn(width, height, |x, y| radiance(plain.texel_direction(x, y)));
    Environment { map, ..plain }
}

fn directions(count: usize) -> impl Iterator<Item = Vec3A> {
    (0..count).map(move |i| {
        let y = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
        let phi = 2.399_963 * i as f32;
        let r = (1.0 - y * y).sqrt();
        Vec3A::new(r * phi.cos(), y, r * phi.sin())
    })
}

/// D(h) (n.l) with n = v, unnormalised, as a function of c = n.l.
fn lobe(c: f64, roughness: f64) -> f64 {
    let a2 = roughness.powi(4);
    let n_dot_h2 = 0.5 * (1.0 + c);
    a2 / (PI * (n_dot_h2 * (a2 - 1.0) + 1.0).powi(2)) * c.max(0.0)
}

/// Integral of `f(c) * lobe(c)` over the sphere; substitution 1 - c = t^3 resolves the peak.
fn lobe_moment(roughness: f64, f: impl Fn(f64) -> f64) -> f64 {
    let steps = 20_000;
    (0..steps)
        .map(|i| {
            let t = (f64::from(i) + 0.5) / f64::from(steps);
            let c = 1.0 - t.powi(3);
            2.0 * PI * f(c) * lobe(c, roughness) * 3.0 * t * t / f64::from(steps)
        })
        .sum()
}

fn level_roughness(level: usize) -> f32 {
    level as f32 / (LEVELS - 1) as f32
}

#[test]
fn constant_environment_stays_constant() {
    // A hair off constant, so that the convolution runs and is not skipped.
    let mut nearly = map(256, 128, |_| [2.0, 1.0, 0.5]);
    nearly.map.pixels[0] = [2.000_001, 1.0, 0.5];
    nearly.intensity = 3.0;
    for env in [nearly, Environment { intensity: 3.0, rotation: 0.3, ..Environment::constant([2.0, 1.0, 0.5]) }] {
        let tables = IblTables::new(&env);
        assert_eq!(tables.prefiltered_maps.len(), LEVELS);
        for d in directions(200) {
            let mut found = vec![tables.irradiance(d)];
            found.extend((0..=20).map(|i| tables.prefiltered(d, i as f32 / 20.0)));
            for value in found {
                assert!(
                    (value[0] - 6.0).abs() < 1e-4 && (value[1] - 3.0).abs() < 5e-5 && (value[2] - 1.5).abs() < 5e-5,
                    "{value:?}"
                );
            }
        }
        assert!((exposure(&env) * 3.0 * (0.2126 * 2.0 + 0.7152 + 0.0722 * 0.5) - 0.8).abs() < 1e-5);
    }
}

#[test]
fn exposure_reads_the_upper_hemisphere_only() {
    let grey = 0.25;
    assert!((exposure(&Environment::constant([grey; 3])) - 0.8 / grey).abs() < 1e-5);
    assert_eq!(exposure(&Environment::constant([0.0; 3])), 1.0);
    // L = y above the horizon: E = integral of y^2 = 2 pi / 3. What lies below does not count.
    let env = map(1024, 512, |d| [if d.y > 0.0 { d.y } else { 100.0 }; 3]);
    assert!((exposure(&env) - 0.8 * 1.5).abs() < 1e-4, "{}", exposure(&env));
    // An odd number of rows: the equator runs through a row, half of which counts.
    let odd = map(3, 5, |_| [1.0; 3]);
    assert!((exposure(&odd) - 0.8).abs() < 1e-5);
    assert_eq!(exposure(&Environment { map: Rgb::default(), rotation: 0.0, intensity: 1.0 }), 1.0);
}

#[test]
fn linear_environment_has_known_moments() {
    // Convolving 2 + a.w with a symmetric lobe of mean cosine m gives 2 + m a.r; m = 2/3 for the cosine.
    let slope = Vec3A::new(0.9, -0.5, 0.6);
    let env = Environment { rotation: 0.8, ..map(512, 256, |d| [2.0 + slope.dot(d), 1.0, 2.0]) };
    let tables = IblTables::new(&env);
    let turned = |d: Vec3A| glam::Mat3A::from_rotation_y(0.8) * d;
    for level in 0..LEVELS {
        let roughness = level_roughness(level);
        let mean =
            if level == 0 { 1.0 } else { lobe_moment(f64::from(roughness), |c| c) / lobe_moment(f64::from(roughness), |_| 1.0) };
        for d in directions(300) {
            let found = tables.prefiltered(turned(d), roughness);
            let expected = 2.0 + mean as f32 * slope.dot(d);
            assert!((found[0] - expected).abs() < 6e-3, "level {level} {d}: {} against {expected}", found[0]);
            assert!((found[1] - 1.0).abs() < 5e-4 && (found[2] - 2.0).abs() < 1e-3, "{found:?}");
        }
    }
    for d in directions(300) {
        let found = tables.irradiance(turned(d))[0];
        let expected = 2.0 + 2.0 / 3.0 * slope.dot(d);
        assert!((found - expected).abs() < 4e-3, "{d}: {found} against {expected}");
    }
}

#[test]
fn a_small_sun_is_neither_lost_nor_aliased() {
    // One texel of a 1k map at three places, one near a pole; the lobes' shape and energy are known.
    for (column, row) in [(300, 150), (777, 260), (5, 12)] {
        let mut env = map(1024, 512, |_| [0.0; 3]);
        env.map.pixels[row * 1024 + column] = [1e5; 3];
        let flux = 1e5 * f64::from(env.texel_solid_angle(row));
        let sun = env.texel_direction(column, row);
        let tables = IblTables::new(&env);
        let mut worst_irradiance = 0.0_f64;
        for d in directions(2000) {
            let expected = flux / PI * f64::from(d.dot(sun).max(0.0));
            worst_irradiance = worst_irradiance.max((f64::from(tables.irradiance(d)[0]) - expected).abs() * PI / flux);
        }
        // The kink at the terminator is rounded by half a texel (2.8 degrees).
        assert!(worst_irradiance < 0.025, "irradiance off by {worst_irradiance} of its peak");
        for level in 1..LEVELS {
            let roughness = level_roughness(level);
            let norm = lobe_moment(f64::from(roughness), |_| 1.0);
            let peak = flux * lobe(1.0, f64::from(roughness)) / norm;
            let across = sun.any_orthonormal_vector();
            let along = sun.cross(across);
            let width = 2.0 * roughness * roughness;
            let mut worst = 0.0_f64;
            for i in 0..400 {
                // Directions around the sun, from its centre out to several widths of the lobe.
                let (angle, turn) = (width * 0.01 * i as f32, 2.4 * i as f32);
                let d = sun * angle.cos() + (across * turn.cos() + along * turn.sin()) * angle.sin();
                let expected = flux * lobe(f64::from(d.dot(sun)), f64::from(roughness)) / norm;
                worst = worst.max((f64::from(tables.prefiltered(d, roughness)[0]) - expected).abs() / peak);
            }
            println!("texel ({column}, {row}) level {level}: worst {:.2} % of the peak", 100.0 * worst);
            let tolerance = if level == 1 { 0.1 } else { 0.03 };
            assert!(worst < tolerance, "texel ({column}, {row}) level {level}: off by {worst} of the peak");
            // Every direction receives its part: the mean over the sphere is the sun's flux.
            let table = &tables.prefiltered_maps[level];
            let total: f64 = (0..table.map.pixels.len())
                .map(|i| f64::from(table.map.pixels[i][0]) * f64::from(table.texel_solid_angle(i / table.map.width)))
                .sum();
            assert!((total / flux - 1.0).abs() < 0.02, "level {level}: {} of the energy", total / flux);
        }
    }
}

/// Unpolarised reflectance from outside, by Snell's law and Fresnel's two equations.
fn exact_fresnel(cos: f64, index: f64) -> f64 {
    let inside = (1.0 - (1.0 - cos * cos) / (index * index)).sqrt();
    let s = (cos - index * inside) / (cos + index * inside);
    let p = (index * cos - inside) / (index * cos + inside);
    0.5 * (s * s + p * p)
}

const INDICES: [f64; 4] = [1.07, 1.2, 1.5, 1.75];

/// Shares of white light that reflectances of 1, Schlick's weight and dielectrics of [`INDICES`] return, by summing over half
/// vectors in polar coordinates of the normal: no code or sampling scheme shared with the table.
fn brdf_by_quadrature(nv: f64, roughness: f64) -> [f64; 6] {
    let alpha = roughness * roughness;
    let v = [(1.0 - nv * nv).sqrt(), 0.0, nv];
    let lambda = |c: f64| 0.5 * ((1.0 + alpha * alpha * (1.0 / (c * c) - 1.0)).sqrt() - 1.0);
    let (steps, turns) = (800, 400);
    let mut sums = [0.0; 6];
    for i in 0..steps {
        // tan(theta_h) = alpha t / (1 - t) spreads the points over the lobe.
        let t = (f64::from(i) + 0.5) / f64::from(steps);
        let tangent = alpha * t / (1.0 - t);
        let cos = 1.0 / (1.0 + tangent * tangent).sqrt();
        let sin = tangent * cos;
        let d_theta = alpha / (1.0 - t).powi(2) * cos * cos / f64::from(steps);
        let d = alpha * alpha / (PI * (cos * cos * (alpha * alpha - 1.0) + 1.0).powi(2));
        for j in 0..turns {
            let phi = 2.0 * PI * (f64::from(j) + 0.5) / f64::from(turns);
            let vh = v[0] * sin * phi.cos() + v[2] * cos;
            let nl = 2.0 * vh * cos - nv;
            if vh > 0.0 && nl > 0.0 {
                let g = 1.0 / (1.0 + lambda(nv) + lambda(nl));
                // f cos(l) dl with dl = 4 v.h dh; f = D G / (4 n.v n.l).
                let weight = d * g * vh / nv * sin * d_theta * 2.0 * PI / f64::from(turns);
                let [a, b, c, d] = INDICES.map(|index| exact_fresnel(vh.min(1.0), index));
                for (sum, fresnel) in sums.iter_mut().zip([1.0, (1.0 - vh).powi(5), a, b, c, d]) {
                    *sum += weight * fresnel;
                }
            }
        }
    }
    sums
}

#[test]
fn brdf_table_agrees_with_quadrature() {
    let mut worst = 0.0_f64;
    for roughness in [0.1, 0.23, 0.4, 0.61, 0.8, 1.0] {
        for nv in [0.02, 0.06, 0.15, 0.33, 0.57, 0.81, 1.0] {
            let expected = brdf_by_quadrature(nv, roughness);
            let brdf = environment_brdf(nv as f32, roughness as f32);
            let [a, b, c, d] = INDICES.map(|index| brdf.dielectric(&of_index(index)));
            for (found, expected) in [brdf.whole, brdf.parts.x, a, b, c, d].into_iter().zip(expected) {
                let error = (f64::from(found) - expected).abs();
                worst = worst.max(error);
                assert!(error < 2e-3, "n.v {nv} roughness {roughness}: {found} against {expected}");
            }
        }
    }
    println!("worst difference {worst:.5}");
    // A mirror reflects Schlick's share of F0 and Fresnel's of a dielectric exactly.
    for nv in [0.1_f32, 0.4, 0.9, 1.0] {
        let brdf = environment_brdf(nv, 0.0);
        let schlick = 0.3 + 0.7 * (1.0 - nv).powi(5);
        assert!((brdf.conductor(Vec3A::splat(0.3)).y - schlick).abs() < 2e-3, "{brdf:?} at {nv}");
        for index in INDICES {
            let (found, expected) = (brdf.dielectric(&of_index(index)), exact_fresnel(f64::from(nv), index));
            assert!((f64::from(found) - expected).abs() < 2e-3, "index {index}: {found} for {expected} at {nv}");
        }
    }
}

fn of_index(index: f64) -> Dielectric {
    Dielectric::new(((index - 1.0) / (index + 1.0)).powi(2) as f32)
}

/// Scale and bias on the mixed f0 give what the two parts of a mixture give.
#[test]
fn a_mixture_is_that_of_its_parts() {
    for metallic in [0.0, 0.3, 1.0] {
        for specular in [0.0, 0.004, 0.3, 1.0] {
            for (nv, roughness) in [(0.02, 0.3), (0.3, 0.0), (0.6, 1.0)] {
                let albedo = Vec3A::new(0.9, 0.4, 0.0);
                let (brdf, surface) = (environment_brdf(nv, roughness), dielectric(specular));
                let expected = brdf.conductor(albedo) * metallic + brdf.dielectric(&surface) * (1.0 - metallic);
                let [scale, bias] = brdf.mixture(&surface, metallic);
                let found = Vec3A::from_array(f0(albedo.to_array(), metallic, specular)) * scale + bias;
                assert!((found - expected).abs().max_element() < 1e-6, "{metallic} {specular} {nv}: {found} {expected}");
                // Their own sum may pass 1: the dielectric's f0 is never that large.
                assert!(scale >= 0.0 && bias >= 0.0 && found.max_element() <= brdf.whole + 1e-6, "{scale} {bias}: {found}");
                // Without any dielectric nothing but the conductor reflects.
                assert!(specular > 0.0 || metallic > 0.0 || found == Vec3A::ZERO, "{found}");
            }
        }
    }
}

#[test]
fn brdf_never_creates_energy() {
    for i in 0..=100 {
        for j in 0..=100 {
            let brdf = environment_brdf(i as f32 / 100.0, j as f32 / 100.0);
            let inside = brdf.parts.min_element() >= 0.0 && brdf.parts.max_element() <= brdf.whole;
            assert!(inside && brdf.whole <= 1.0 + 1e-5, "{brdf:?} at {i}, {j}");
        }
    }
    for outside in [-1.0, 2.0, f32::INFINITY] {
        let brdf = environment_brdf(outside, outside);
        assert!(brdf.whole.is_finite() && brdf.parts.is_finite());
    }
}

#[test]
fn a_black_environment_gives_no_light() {
    let mut env = map(64, 32, |_| [0.0; 3]);
    env.map.pixels[7] = [0.0, 0.0, 1e-30];
    let tables = IblTables::new(&env);
    for d in directions(50) {
        assert!(tables.irradiance(d).iter().chain(&tables.prefiltered(d, 0.4)).all(|v| v.is_finite() && *v < 1e-20));
    }
}
