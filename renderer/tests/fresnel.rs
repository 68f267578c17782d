//! Reflectance of dielectrics: Fresnel's equations in the conserving form, Schlick's approximation in the published one.

use glam::{DVec3, Vec3A};
use renderflow_renderer::material::{Bsdf, Mode, Principled};
use renderflow_renderer::verify::bsdf as checks;
use renderflow_renderer::verify::chi_square::Random;
use std::f64::consts::PI;

/// A black dielectric that does not reflect.
fn black() -> Principled {
    Principled { base_color: Vec3A::ZERO, roughness: 0.3, specular: 0.0, clearcoat_gloss: 0.0, ..Principled::default() }
}

/// Snell's law and Fresnel's two equations, unpolarised, from outside.
fn fresnel(f0: f64, cos: f64) -> f64 {
    let index = (1.0 + f0.sqrt()) / (1.0 - f0.sqrt());
    let inside = (1.0 - (1.0 - cos * cos) / (index * index)).sqrt();
    let s = (cos - index * inside) / (cos + index * inside);
    let p = (index * cos - inside) / (index * cos + inside);
    0.5 * (s * s + p * p)
}

fn schlick(f0: f64, cos: f64) -> f64 {
    f0 + (1.0 - f0) * (1.0 - cos).powi(5)
}

/// Smith's `L` of GGX.
fn lambda(v: DVec3, alpha: f64) -> f64 {
    0.5 * ((1.0 + alpha * alpha * (1.0 / (v.z * v.z) - 1.0)).sqrt() - 1.0)
}

/// `D G / (4 cos_o)` of GGX, the masking correlated with the height or separable.
fn ggx(wo: DVec3, wi: DVec3, roughness: f64, correlated: bool) -> f64 {
    let h = (wo + wi).normalize();
    let alpha = (roughness * roughness).max(0.001);
    let d = 1.0 / (PI * alpha * alpha * ((h.x * h.x + h.y * h.y) / (alpha * alpha) + h.z * h.z).powi(2));
    let (lo, li) = (lambda(wo, alpha), lambda(wi, alpha));
    let masking = if correlated { 1.0 + lo + li } else { (1.0 + lo) * (1.0 + li) };
    d / (4.0 * wo.z * masking)
}

/// Burley's clearcoat of strength 1 times cosine, for a reflectance.
fn clearcoat(wo: DVec3, wi: DVec3, gloss: f64, reflectance: f64) -> f64 {
    let h = (wo + wi).normalize();
    let a2 = (0.1 + (0.001 - 0.1) * gloss).powi(2);
    let d = (a2 - 1.0) / (PI * a2.ln() * (a2 * h.z * h.z + h.x * h.x + h.y * h.y));
    let visibility = |cos: f64| 1.0 / (cos + (0.0625 + 0.9375 * cos * cos).sqrt());
    0.25 * d * reflectance * visibility(wo.z) * visibility(wi.z) * wi.z
}

fn direction(random: &mut Random) -> Vec3A {
    checks::view(random.next().max(0.01), std::f32::consts::TAU * random.next())
}

/// Largest relative difference of `f_cos` of a coat over black from `expected`, over many directions and parameters.
fn worst_difference(mode: Mode, expected: impl Fn(&Principled, DVec3, DVec3) -> f64) -> f64 {
    let (mut random, mut worst) = (Random::new(11), 0.0_f64);
    for i in 0..20_000 {
        // From an index of 1.06 on.
        let specular = 0.01 + 0.99 * random.next();
        let coated = Principled { specular, roughness: 0.1 + 0.9 * random.next(), ..black() };
        let lacquered = Principled { clearcoat: random.next(), clearcoat_gloss: 0.5 * random.next(), ..black() };
        let surface = if i % 2 == 0 { coated } else { lacquered };
        let (wo, wi) = (direction(&mut random), direction(&mut random));
        let found = Bsdf::<true>::new(&surface, mode).eval(wo, wi).f_cos;
        let expected = expected(&surface, wo.as_dvec3(), wi.as_dvec3());
        assert!(found.x == found.y && found.x == found.z);
        worst = worst.max((f64::from(found.x) - expected).abs() / (expected + 1e-6));
    }
    worst
}

#[test]
fn conserving_coats_reflect_by_fresnels_equations() {
    let worst = worst_difference(Mode::Conserving, |surface, wo, wi| {
        let cos = (wo + wi).normalize().dot(wi);
        if surface.clearcoat > 0.0 {
            return f64::from(surface.clearcoat) * clearcoat(wo, wi, surface.clearcoat_gloss.into(), fresnel(0.04, cos));
        }
        fresnel(0.08 * f64::from(surface.specular), cos) * ggx(wo, wi, surface.roughness.into(), true)
    });
    println!("worst: {worst:.1e}");
    assert!(worst < 1e-4, "{worst}");
}

#[test]
fn published_coats_reflect_by_schlicks_formula() {
    let worst = worst_difference(Mode::Published, |surface, wo, wi| {
        let cos = (wo + wi).normalize().dot(wi);
        let coat = f64::from(surface.clearcoat) * clearcoat(wo, wi, surface.clearcoat_gloss.into(), schlick(0.04, cos));
        coat + schlick(0.08 * f64::from(surface.specular), cos) * ggx(wo, wi, surface.roughness.into(), false)
    });
    println!("worst: {worst:.1e}");
    assert!(worst < 1e-4, "{worst}");
}

/// A tint scales the reflectance at normal incidence, and what rises from there is that of the untinted index.
#[test]
fn a_tint_keeps_the_rise_of_the_index() {
    let (mut random, mut worst) = (Random::new(5), 0.0_f64);
    for _ in 0..5_000 {
        // A green so dark that the base hardly shows: its hue is that of any green.
        let color = Vec3A::new(0.0, 1e-12, 0.0);
        let surface = Principled { base_color: color, specular: 0.5, specular_tint: random.next(), roughness: 0.3, ..black() };
        let (wo, wi) = (direction(&mut random), direction(&mut random));
        let found = Bsdf::<true>::new(&surface, Mode::Conserving).eval(wo, wi).f_cos.as_dvec3();
        let (wo, wi) = (wo.as_dvec3(), wi.as_dvec3());
        let rise = (fresnel(0.04, (wo + wi).normalize().dot(wi)) - 0.04) / 0.96;
        let tint = f64::from(surface.specular_tint);
        let f0 = DVec3::new(0.04 * (1.0 - tint), 0.04 * (1.0 + tint * (1.0 / 0.7152 - 1.0)), 0.04 * (1.0 - tint));
        let expected = (f0 + (1.0 - f0) * rise) * ggx(wo, wi, 0.3, true);
        worst = worst.max(((found - expected).abs() / (expected + 1e-6)).max_element());
    }
    println!("worst: {worst:.1e}");
    assert!(worst < 1e-4, "{worst}");
}

#[test]
fn a_smooth_dielectric_reflects_what_fresnel_says() {
    for specular in [0.02_f32, 0.25, 0.5, 1.0] {
        for degrees in [0.0_f32, 30.0, 45.0, 56.3, 65.0, 75.0, 85.0] {
            let cos = degrees.to_radians().cos();
            let bsdf = Bsdf::<false>::new(&Principled { specular, roughness: 0.0, ..black() }, Mode::Conserving);
            let found = checks::albedo(&bsdf, checks::view(cos, 0.4), 128).x;
            let expected = fresnel(f64::from(0.08 * specular), f64::from(cos));
            assert!((found - expected).abs() < 5e-4, "specular {specular}, {degrees} degrees: {found} for {expected}");
        }
    }
}

/// Where `W` fades to air too, and under a tint and a mixture.
#[test]
fn white_dielectrics_of_every_index_close_the_furnace() {
    let white = Principled { base_color: Vec3A::ONE, ..black() };
    let mut surfaces = Vec::new();
    for specular in [1e-6, 1e-3, 0.0099, 0.0101, 0.02, 0.1, 0.35, 1.0] {
        for roughness in [0.0, 0.3, 1.0] {
            surfaces.push(Principled { specular, roughness, ..white });
        }
        surfaces.push(Principled { specular, subsurface: 1.0, ..white });
        surfaces.push(Principled { specular, metallic: 0.5, ..white });
        surfaces.push(Principled { specular, anisotropic: 0.7, roughness: 0.75, ..white });
    }
    let worst = checks::furnace(&surfaces, 128);
    println!("{worst:?}");
    assert!(worst.failures == 0, "{worst:?}");
    // Colours, and with them tints and the maxima of the subsurface shape, gain nothing.
    let colored = |surface: &Principled| Principled { base_color: Vec3A::new(0.1, 0.2, 1.0), specular_tint: 1.0, ..*surface };
    let surfaces: Vec<_> = surfaces.iter().map(colored).collect();
    let worst = checks::furnace(&surfaces, 128);
    println!("{worst:?}");
    assert!(worst.failures == 0, "{worst:?}");
}

#[test]
fn values_are_continuous_down_to_no_coat() {
    let mut random = Random::new(7);
    for _ in 0..200 {
        let surface = Principled { base_color: Vec3A::splat(0.5), roughness: 0.1 + 0.9 * random.next(), ..black() };
        let (wo, wi) = (direction(&mut random), direction(&mut random));
        let value = |specular| Bsdf::<true>::new(&Principled { specular, ..surface }, Mode::Conserving).eval(wo, wi).f_cos.x;
        let (mut last, bare) = (value(0.0), value(0.0));
        let peak = value(0.02);
        for i in 1..=400 {
            // Even in the root, in which the fade is linear, up to an index of 1.08.
            let next = value(0.02 * (i as f32 / 400.0).powi(2));
            let step = (next - last).abs();
            assert!(step <= 0.02 * (peak - bare).abs() + 2e-3 * bare, "{step} at {i}: {last} {next}, {bare} to {peak}");
            last = next;
        }
        assert!((value(1e-12) - bare).abs() < 1e-4 * (bare + peak), "{} {bare}", value(1e-12));
    }
}
