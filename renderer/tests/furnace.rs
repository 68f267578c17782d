//! Energy, reciprocity and finiteness of the material.

#[path = "common/chi_square.rs"]
#[allow(dead_code)]
mod chi_square;

use chi_square::Random;
use glam::Vec3A;
use renderflow_renderer::material::{Mode, Surface};
use renderflow_renderer::verify::bsdf as checks;

type Bsdf = renderflow_renderer::material::Bsdf<false>;

#[test]
fn every_lobe_closes_the_furnace() {
    let surfaces: Vec<_> = checks::grid(true).into_iter().step_by(11).collect();
    let worst = checks::furnace(&surfaces, 128);
    println!("{worst:?}");
    assert!(worst.failures == 0, "{worst:?}");
    let surfaces: Vec<_> = checks::grid(false).into_iter().step_by(23).collect();
    let worst = checks::furnace(&surfaces, 128);
    assert!(worst.failures == 0, "{worst:?}");
}

#[test]
#[ignore = "a minute"]
fn every_lobe_closes_the_furnace_on_the_whole_grid() {
    for white in [true, false] {
        let worst = checks::furnace(&checks::grid(white), 128);
        println!("{white} {worst:?}");
        assert!(worst.failures == 0, "{worst:?}");
    }
}

const ROUGHNESSES: [f32; 10] = [0.05, 0.1, 0.17, 0.25, 0.33, 0.5, 0.62, 0.75, 0.9, 1.0];
const COSINES: [f32; 8] = [1.0, 0.9, 0.7, 0.5, 0.25, 0.1, 0.03, 0.01];

fn view(cos: f32, phi: f32) -> Vec3A {
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    Vec3A::new(sin * phi.cos(), sin * phi.sin(), cos)
}

fn surface(base: f32, metallic: f32, roughness: f32, specular: f32) -> Surface {
    Surface { base_color: Vec3A::splat(base), metallic, roughness, specular, ..Surface::default() }
}

fn albedo(bsdf: &Bsdf, wo: Vec3A) -> Vec3A {
    checks::albedo(bsdf, wo, 128).as_vec3a()
}

#[test]
fn white_furnace_closes() {
    let mut worst = (0.0, String::new());
    for (kind, metallic, specular) in [
        ("diffuse", 0.0, 0.0),
        ("metal", 1.0, 0.5),
        ("coated diffuse", 0.0, 0.5),
        ("strongly coated diffuse", 0.0, 1.0),
        ("mixture", 0.4, 0.8),
        ("faintly coated diffuse", 0.0, 0.1),
    ] {
        for roughness in ROUGHNESSES {
            for cos in COSINES {
                let reflected =
                    albedo(&Bsdf::new(&surface(1.0, metallic, roughness, specular), Mode::Conserving), view(cos, 0.3)).x;
                let error = (reflected - 1.0).abs();
                if error > worst.0 {
                    worst = (error, format!("{kind}, roughness {roughness}, cos {cos}: {reflected}"));
                }
            }
        }
    }
    println!("worst: {}", worst.1);
    assert!(worst.0 < 0.002, "{}", worst.1);
}

#[test]
fn no_material_gains_energy() {
    for metallic in [0.0, 0.3, 1.0] {
        for specular in [0.0, 0.1, 0.5, 1.0] {
            for base in [0.0, 0.5, 1.0] {
                for roughness in [0.0, 0.2, 0.6, 1.0] {
                    for cos in COSINES {
                        let reflected =
                            albedo(&Bsdf::new(&surface(base, metallic, roughness, specular), Mode::Conserving), view(cos, 2.0)).x;
                        assert!(
                            (0.0..=1.001).contains(&reflected),
                            "{metallic} {specular} {base} {roughness} {cos}: {reflected}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn lambert_is_exact() {
    let bsdf = Bsdf::new(
        &Surface { base_color: Vec3A::new(0.2, 0.5, 0.9), metallic: 0.0, roughness: 0.0, specular: 0.0, ..Surface::default() },
        Mode::Conserving,
    );
    let (wo, wi) = (view(0.4, 1.0), view(0.6, 3.0));
    let value = bsdf.eval(wo, wi);
    let expected = Vec3A::new(0.2, 0.5, 0.9) * (wi.z * std::f32::consts::FRAC_1_PI);
    assert!((value.f_cos - expected).abs().max_element() < 1e-7, "{value:?}");
    assert!((value.pdf - wi.z * std::f32::consts::FRAC_1_PI).abs() < 1e-7);
}

#[test]
fn a_mirror_reflects_its_colour() {
    let color = Vec3A::new(0.9, 0.6, 0.2);
    let bsdf = Bsdf::new(
        &Surface { base_color: color, metallic: 1.0, roughness: 0.0, specular: 0.5, ..Surface::default() },
        Mode::Conserving,
    );
    assert!((albedo(&bsdf, view(1.0, 0.0)) - color).abs().max_element() < 1e-3);
    // Schlick at 60 degrees.
    let at_60 = color + (Vec3A::ONE - color) * 0.5_f32.powi(5);
    assert!((albedo(&bsdf, view(0.5, 0.0)) - at_60).abs().max_element() < 2e-3);
}

fn random_surface(random: &mut Random) -> Surface {
    let mut pick = |values: [f32; 4]| {
        let choice = (random.next() * 5.0) as usize;
        values.get(choice).copied().unwrap_or_else(|| random.next())
    };
    let (metallic, roughness, specular) = (pick([0.0, 1.0, 0.5, 1e-6]), pick([0.0, 1.0, 0.3, 0.05]), pick([0.0, 0.5, 1.0, 1e-4]));
    let base_color = Vec3A::new(pick([0.0, 1.0, 0.5, 0.8]), pick([0.0, 1.0, 0.5, 0.8]), pick([0.0, 1.0, 0.1, 0.8]));
    Surface { base_color, metallic, roughness, specular, ..Surface::default() }
}

fn random_direction(random: &mut Random) -> Vec3A {
    // A third of the directions graze the surface.
    let cos = match (random.next() * 3.0) as u32 {
        0 => 10.0_f32.powf(-8.0 * random.next()),
        _ => random.next().max(1e-6),
    };
    view(cos, std::f32::consts::TAU * random.next())
}

#[test]
fn dielectrics_are_reciprocal() {
    let mut random = Random::new(3);
    for _ in 0..200_000 {
        let bsdf = Bsdf::new(&Surface { metallic: 0.0, ..random_surface(&mut random) }, Mode::Conserving);
        let (wo, wi) = (random_direction(&mut random), random_direction(&mut random));
        let (a, b) = (bsdf.eval(wo, wi).f_cos / wi.z, bsdf.eval(wi, wo).f_cos / wo.z);
        let error = (a - b).abs().max_element();
        assert!(error <= 1e-4 * a.max_element() + 1e-12, "{wo} {wi}: {a} {b}");
    }
}

/// The compensation of a conductor is a factor of `wo` alone, so it cancels around a triangle of directions.
#[test]
fn conductors_are_reciprocal_but_for_a_factor() {
    let mut random = Random::new(8);
    for _ in 0..100_000 {
        let bsdf = Bsdf::new(&Surface { metallic: 1.0, ..random_surface(&mut random) }, Mode::Conserving);
        let [a, b, c] = [(); 3].map(|()| random_direction(&mut random));
        let value = |wo: Vec3A, wi: Vec3A| (bsdf.eval(wo, wi).f_cos / wi.z).as_dvec3();
        let (around, back) = (value(a, b) * value(b, c) * value(c, a), value(b, a) * value(c, b) * value(a, c));
        let error = (around - back).abs().max_element();
        assert!(error <= 1e-4 * around.max_element() + 1e-30, "{a} {b} {c}: {around} {back}");
        // And the factor is small: at most the energy that single scattering loses.
        let ratio = value(a, b).x / value(b, a).x;
        assert!(ratio.is_nan() || (0.1..10.0).contains(&ratio), "{ratio}");
    }
}

#[test]
fn weight_is_value_over_density() {
    let mut random = Random::new(4);
    let mut drawn_count = 0;
    for _ in 0..300_000 {
        let bsdf = Bsdf::new(&random_surface(&mut random), Mode::Conserving);
        let wo = random_direction(&mut random);
        let (lobe, u) = (random.next(), [random.next(), random.next()]);
        let Some(drawn) = bsdf.sample(wo, lobe, u) else { continue };
        drawn_count += 1;
        let value = bsdf.eval(wo, drawn.wi);
        assert!((drawn.pdf - value.pdf).abs() <= 1e-5 * value.pdf, "{drawn:?} {value:?}");
        let weight = value.f_cos / value.pdf;
        assert!((drawn.weight - weight).abs().max_element() <= 1e-4 * weight.max_element() + 1e-7, "{drawn:?} {weight}");
        assert!(drawn.wi.z > 0.0 && (drawn.wi.length() - 1.0).abs() < 1e-5 && drawn.pdf > 0.0);
        assert_eq!(bsdf.pdf(wo, drawn.wi), value.pdf);
    }
    assert!(drawn_count > 200_000, "{drawn_count}");
}

#[test]
fn everything_is_finite() {
    let edges = [0.0, f32::MIN_POSITIVE, 1e-30, 1e-20, 1e-9, 1e-4, 0.5, 1.0];
    let numbers = [0.0, 1e-30, 6e-8, 0.25, 0.5, 0.75, 1.0 - 6e-8];
    for metallic in [0.0, 0.5, 1.0] {
        for roughness in [0.0, 1e-3, 0.3, 1.0, -1.0, 7.0] {
            for (base, specular) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (5.0, -1.0)] {
                let bsdf = Bsdf::new(&surface(base, metallic, roughness, specular), Mode::Conserving);
                for cos_o in edges {
                    let wo = view(cos_o, 0.0);
                    for cos_i in edges {
                        for phi in [0.0, 1.0, std::f32::consts::PI] {
                            let value = bsdf.eval(wo, view(cos_i, phi));
                            assert!(value.f_cos.is_finite() && value.f_cos.min_element() >= 0.0, "{value:?}");
                            assert!(value.pdf.is_finite() && value.pdf >= 0.0, "{value:?}");
                        }
                    }
                    for a in numbers {
                        for b in numbers {
                            for c in numbers {
                                let Some(drawn) = bsdf.sample(wo, a, [b, c]) else { continue };
                                let valid = drawn.wi.is_finite() && drawn.weight.is_finite() && drawn.pdf.is_finite();
                                assert!(valid && drawn.weight.min_element() >= 0.0 && drawn.pdf > 0.0, "{drawn:?}");
                                assert!(drawn.weight.max_element() < 10.0, "{drawn:?} cos {cos_o} roughness {roughness}");
                            }
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn nothing_below_the_horizon() {
    let bsdf = Bsdf::new(&surface(1.0, 0.5, 0.5, 0.5), Mode::Conserving);
    let below = Vec3A::new(0.6, 0.0, -0.8);
    for (wo, wi) in [(below, Vec3A::Z), (Vec3A::Z, below), (Vec3A::X, Vec3A::Z), (below, below)] {
        let value = bsdf.eval(wo, wi);
        assert_eq!((value.f_cos, value.pdf), (Vec3A::ZERO, 0.0));
    }
    assert!(bsdf.sample(below, 0.1, [0.2, 0.3]).is_none());
    assert!(bsdf.sample(Vec3A::X, 0.1, [0.2, 0.3]).is_none());
    let black = Bsdf::new(&surface(0.0, 0.0, 0.5, 0.0), Mode::Conserving);
    assert!(black.sample(Vec3A::Z, 0.1, [0.2, 0.3]).is_none());
}
