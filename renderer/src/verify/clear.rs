//! Glass, panes and blended surfaces: random evaluations of their lobes, and scenes at the edge of what a scene can be.

mod hostile;

use super::bsdf::{Random, Worst as Found};
use super::materials::{MODES, collect};
use super::{Check, Effort, Outcome, Ticker};
use crate::clear::Medium;
use crate::material::glass::pane_transmittance;
use crate::material::{BsdfEval, ClearBsdf, Mode, Principled, Side, ggx, refraction_index};
use glam::Vec3A;

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "clear.evaluations",
        about: "random bodies, sheets and panes from outside and inside: nothing NaN, infinite or negative, samples equal eval",
        run: evaluations,
    },
    Check {
        name: "clear.media",
        about: "random and absurd absorption over any distance, and panes at any angle, leave a share of light between 0 and 1",
        run: |effort, ticker| {
            let (parts, count) = effort.pick((8, 50_000), (20, 500_000));
            collect(ticker, &MODES[..1], parts, ("share of light beyond 0..=1", 0.0), |_, part| media(count, 1 + part))
        },
    },
    Check {
        name: "clear.scenes",
        about: "nested, touching, thin and coplanar glass, rows of panes, deep stacks of blended surfaces, absurd absorption: nothing NaN or negative, white scenes keep their light",
        run: hostile::run,
    },
];

const SIDES: [Side; 4] = [Side::Outside, Side::Inside, Side::Sheet, Side::Pane];

fn evaluations(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let (parts, count) = effort.pick((8, 50_000), (100, 100_000));
    let claim = ("difference of sample and eval over what rounding may cause", 1.0);
    collect(ticker, &MODES, parts, claim, |mode, part| random_evaluations(mode, count, 1 + part))
}

/// `eval` and `sample` for `count` random clear materials, sides and pairs of directions above and below the surface. A failure
/// is a value, weight or density that is not finite or negative, a direction that is not unit, light through a pane, or a
/// sample that differs from `eval` of its direction by more than rounding may cause; the error is that difference over what
/// rounding may cause.
pub fn random_evaluations(mode: Mode, count: u64, seed: u64) -> Found {
    let (mut random, mut worst) = (Random::new(seed), Found::default());
    let fine = |v: f32| v.is_finite() && v >= 0.0;
    for i in 0..count {
        let mut surface = random.surface();
        // One half is clear as a whole; the share of metal is what takes the rest away.
        surface.transmission = if random.next() < 0.5 { 1.0 } else { random.parameter() };
        if random.next() < 0.5 {
            surface.metallic = 0.0;
        }
        let side = SIDES[i as usize % 4];
        let (wo, wi) = (random.direction(), random.direction());
        let below = |w: Vec3A| Vec3A::new(w.x, w.y, -w.z);
        // The formulae's corners are equal, mirrored, opposite and straight directions.
        let wi = match (i / 4) % 16 {
            0 => wo,
            1 => Vec3A::new(-wo.x, -wo.y, wo.z),
            2 => -wo,
            3 => below(wo),
            4 => Vec3A::new(wi.x, wi.y, 0.0).normalize_or(Vec3A::X),
            5..=10 => below(wi),
            _ => wi,
        };
        let u = [random.next(), random.next(), random.next()];
        let bsdf = ClearBsdf::new(&surface, mode);
        let view = bsdf.view(wo, side);
        let sound = |value: &BsdfEval| fine(value.pdf) && value.f_cos.to_array().into_iter().all(fine);
        let value = view.eval(wi);
        let mut failed = !sound(&value) || (side == Side::Pane && wi.z < 0.0 && value != BsdfEval::default());
        let mut error = 0.0;
        if let Some(drawn) = view.sample(u[0], [u[1], u[2]]) {
            let again = view.eval(drawn.wi);
            failed |= !fine(drawn.pdf) || drawn.pdf == 0.0 || !drawn.weight.to_array().into_iter().all(fine) || !sound(&again);
            failed |= (drawn.wi.length() - 1.0).abs() > 1e-5 || (side == Side::Pane && drawn.wi.z <= 0.0);
            let density = f64::from((again.pdf - drawn.pdf).abs() / drawn.pdf.max(again.pdf));
            let (value, again) = (drawn.weight.as_dvec3() * f64::from(drawn.pdf), again.f_cos.as_dvec3());
            let value = (value - again).abs().max_element() / value.max(again).max_element().max(1e-30);
            error = density.max(value) / rounding(&surface, side, wo, drawn.wi);
            failed |= error.is_nan() || error > 1.0;
        }
        worst.see(error, failed, || format!("{side:?} {surface:?} wo {wo} wi {wi} u {u:?}: {value:?}"));
    }
    worst
}

/// Relative difference that rounding of `wi` may cause. The half vector is the sum of two long vectors, or their difference where
/// light is refracted: it turns by as much more as it is shorter. A lobe of width alpha changes by as much more as it is sharper,
/// and so do cosines to the surface and, by its square, a cosine to the facet: where light begins to pass at the critical angle,
/// the share that passes rises at once, and the share that is mirrored falls as fast.
fn rounding(surface: &Principled, side: Side, wo: Vec3A, wi: Vec3A) -> f64 {
    const UNIT: f64 = 6e-8;
    let ior = f64::from(refraction_index(surface.specular));
    let (eta, wi) = match side {
        Side::Inside if wi.z < 0.0 => (1.0 / ior, wi),
        Side::Outside if wi.z < 0.0 => (ior, wi),
        _ => (1.0, Vec3A::new(wi.x, wi.y, wi.z.abs())),
    };
    let (wo, wi) = (wo.as_dvec3(), wi.as_dvec3());
    let half = wo + eta * wi;
    let length = half.length();
    // The clear coat's lobe may be far sharper, up to a width of 0.001 (Burley 2012, section 5.6), and a stretched one is so
    // across.
    let coat = if surface.clearcoat > 0.0 { 0.1 - 0.099 * f64::from(surface.clearcoat_gloss) } else { 1.0 };
    let stretched = (1.0 - 0.9 * f64::from(surface.anisotropic)).sqrt();
    let alpha = (stretched * f64::from(ggx::alpha(surface.roughness))).min(coat);
    let critical: f64 = [wo, wi].map(|w| (length / w.dot(half)).powi(2)).iter().sum();
    let falling =
        if side == Side::Inside && wi.z > 0.0 { mirrored_near_critical(0.5 * length, 1.0 / ior, 16.0 * UNIT) } else { 0.0 };
    1e-4 + falling
        + 16.0 * UNIT * (1.0 + eta) / length * (1.0 / alpha + 1.0 / length + 1.0 / wi.z.abs() + length / half.z.abs() + critical)
}

/// How far a share of mirrored light near 1 may be off at cosine `cos` to the facet, where the other side's index is `eta` < 1
/// times this one's and squares of cosines are off by `error`. The share falls as `1 - 2 g / (cos eta^2)` with the root `g` of
/// Fresnel's equations, and a root changes most at 0: from there it becomes the root of the error.
fn mirrored_near_critical(cos: f64, eta: f64, error: f64) -> f64 {
    let square = (eta * eta - 1.0 + cos * cos).abs();
    2.0 / (cos * eta * eta) * error / (square.sqrt() + error.sqrt())
}

/// Shares of light that are left after random distances in random media, those beyond all limits among them, and behind random
/// panes. A failure is a share outside 0..=1; the error is how far.
fn media(count: u64, seed: u64) -> Found {
    let (mut random, mut worst) = (Random::new(seed), Found::default());
    let outside = |v: f32| if (0.0..=1.0).contains(&v) { 0.0 } else { f64::from((v - 0.5).abs()) };
    for _ in 0..count {
        let mut number = || match (random.next() * 8.0) as u32 {
            0 => 0.0,
            1 => f32::MAX,
            2 => f32::INFINITY,
            3 => f32::MIN_POSITIVE,
            _ => 10.0_f32.powf(76.0 * random.next() - 38.0),
        };
        let (absorption, distance) = (Vec3A::new(number(), number(), number()).min(Vec3A::splat(f32::MAX)), number());
        let left = Medium::of(absorption, 1.0).over(distance);
        let error = left.to_array().into_iter().map(outside).fold(0.0, |a: f64, b| if b.is_nan() { b } else { a.max(b) });
        worst.see(error, error != 0.0, || format!("absorption {absorption} over {distance}: {left}"));
        let (specular, cos) = (random.parameter(), random.direction().z);
        let passed = pane_transmittance(specular, cos);
        worst.see(outside(passed), outside(passed) != 0.0, || format!("specular {specular} cosine {cos}: {passed}"));
    }
    worst
}
