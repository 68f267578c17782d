//! Numerical checks of the material: finiteness, reciprocity, densities, energy.
//!
//! Each check returns a [`Worst`]: how many cases it tried, the largest error, and the parameters that gave it. All are
//! deterministic in their seed.

use super::chi_square::DirectionGrid;
use crate::material::{Bsdf, Mode, Principled};
use glam::{DVec3, Vec3A};

/// The outcome of a check.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Worst {
    /// Number of cases tried.
    pub cases: u64,
    /// Number of cases beyond the check's own notion of wrong (not finite, negative, above its bound).
    pub failures: u64,
    /// Largest error; its meaning is the check's.
    pub error: f64,
    /// The parameters that gave it.
    pub parameters: String,
}

impl Worst {
    pub(super) fn see(&mut self, error: f64, failed: bool, parameters: impl FnOnce() -> String) {
        self.cases += 1;
        // Not a number is worse than any number.
        let error = if error.is_nan() { f64::INFINITY } else { error };
        // The first failure is kept before any error that is none.
        let first = failed && self.failures == 0;
        self.failures += u64::from(failed);
        if first || (error > self.error && (failed || self.failures == 0)) {
            self.error = error;
            self.parameters = parameters();
        }
    }
}

/// Random numbers in 0..1: PCG-XSH-RR (O'Neill 2014), independent of the renderer's own samplers.
pub(super) struct Random(u64);

/// Numbers of a material without transmission, which comes last.
const OPAQUE: u32 = 13;

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        random.next();
        random
    }

    pub(super) fn next(&mut self) -> f32 {
        let old = self.0;
        self.0 = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let bits = ((((old >> 18) ^ old) >> 27) as u32).rotate_right((old >> 59) as u32);
        (bits >> 8) as f32 / 16_777_216.0
    }

    /// A parameter 0..=1, often at a limit.
    pub(super) fn parameter(&mut self) -> f32 {
        match (self.next() * 8.0) as u32 {
            0 | 1 => 0.0,
            2 => 1.0,
            3 => 10.0_f32.powf(-12.0 * self.next()),
            _ => self.next(),
        }
    }

    pub(super) fn surface(&mut self) -> Principled {
        // The opaque form ignores the last one, transmission: the numbers drawn are those of before there was any.
        let mut drawn = 0;
        Principled::from_fn(|| {
            drawn += 1;
            if drawn <= OPAQUE { self.parameter() } else { 0.0 }
        })
    }

    /// A direction above the horizon; a third graze it, down to cosines of 1e-7.
    pub(super) fn direction(&mut self) -> Vec3A {
        let cos = if self.next() < 0.33 { 10.0_f32.powf(-7.0 * self.next()) } else { self.next().max(1e-7) };
        view(cos, std::f32::consts::TAU * self.next())
    }
}

/// Unit direction of a cosine and an azimuth.
pub fn view(cos: f32, phi: f32) -> Vec3A {
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    Vec3A::new(sin * phi.cos(), sin * phi.sin(), cos)
}

/// `eval` and `sample` for `count` random materials and pairs of directions. A failure is a value, weight or density that is not
/// finite or negative, a direction that is not unit or not above the horizon, or a weight that is not value over density. The
/// error is the largest relative difference between a sample and `eval` of its direction.
pub fn random_evaluations(mode: Mode, count: u64, seed: u64) -> Worst {
    let (mut random, mut worst) = (Random::new(seed), Worst::default());
    for i in 0..count {
        let surface = random.surface();
        let (wo, wi) = (random.direction(), random.direction());
        // Opposite and equal directions are the formulae's corners.
        let wi = match i % 16 {
            0 => wo,
            1 => Vec3A::new(-wo.x, -wo.y, wo.z),
            _ => wi,
        };
        let u = [random.next(), random.next(), random.next()];
        let bsdf = Bsdf::<true>::new(&surface, mode);
        let value = bsdf.eval(wo, wi);
        let fine = |v: f32| v.is_finite() && v >= 0.0;
        let mut failed = !fine(value.pdf) || !value.f_cos.to_array().into_iter().all(fine);
        let mut error = 0.0;
        if let Some(drawn) = bsdf.sample(wo, u[0], [u[1], u[2]]) {
            let again = bsdf.eval(wo, drawn.wi);
            failed |= !fine(drawn.pdf) || !drawn.weight.to_array().into_iter().all(fine);
            failed |= drawn.wi.z <= 0.0 || (drawn.wi.length() - 1.0).abs() > 1e-5;
            error = f64::from((again.pdf - drawn.pdf).abs() / drawn.pdf);
            let weight = (drawn.weight.as_dvec3() * f64::from(drawn.pdf) - again.f_cos.as_dvec3()).abs().max_element();
            error = error.max(weight / f64::from(again.f_cos.max_element().max(1e-30)));
            failed |= error.is_nan() || error > 1e-4;
        }
        worst.see(error, failed, || format!("{surface:?} wo {wo} wi {wi} u {u:?}"));
    }
    worst
}

/// As [`random_evaluations`], at every corner of directions and random numbers, and with parameters beyond their ranges. A weight
/// above 10 is a failure, too. There is no error.
pub fn corners() -> Worst {
    let cosines = [0.0, f32::MIN_POSITIVE, 1e-30, 1e-20, 1e-9, 1e-4, 0.5, 1.0];
    let numbers = [0.0, 1e-30, 6e-8, 0.25, 0.5, 0.75, 1.0 - 6e-8];
    let fine = |v: f32| v.is_finite() && v >= 0.0;
    let mut worst = Worst::default();
    for metallic in [0.0, 0.5, 1.0] {
        for roughness in [0.0, 1e-3, 0.3, 1.0, -1.0, 7.0] {
            for (base, specular) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (5.0, -1.0)] {
                let base_color = Vec3A::splat(base);
                let surface = Principled { base_color, metallic, roughness, specular, ..Principled::default() };
                let bsdf = Bsdf::<false>::new(&surface, Mode::Conserving);
                for wo in cosines.map(|cos| view(cos, 0.0)) {
                    for wi in cosines.into_iter().flat_map(|cos| [0.0, 1.0, std::f32::consts::PI].map(|phi| view(cos, phi))) {
                        let value = bsdf.eval(wo, wi);
                        let failed = !fine(value.pdf) || !value.f_cos.to_array().into_iter().all(fine);
                        worst.see(0.0, failed, || format!("{surface:?} wo {wo} wi {wi}: {value:?}"));
                    }
                    for (a, u) in
                        numbers.into_iter().flat_map(|a| numbers.map(|b| (a, b))).flat_map(|(a, b)| numbers.map(|c| (a, [b, c])))
                    {
                        let Some(drawn) = bsdf.sample(wo, a, u) else { continue };
                        let weights = drawn.weight.to_array();
                        let sound = drawn.wi.is_finite() && fine(drawn.pdf) && drawn.pdf > 0.0;
                        let failed = !sound || !weights.into_iter().all(|w| fine(w) && w < 10.0);
                        worst.see(0.0, failed, || format!("{surface:?} wo {wo} u {a} {u:?}: {drawn:?}"));
                    }
                }
            }
        }
    }
    worst
}

/// The form that plain materials are compiled to beside the general one, on `count` random plain materials and pairs of
/// directions. The error is the largest difference of a value or density, relative to the larger; a failure is one beyond 1e-4.
pub fn plain_form(count: u64, seed: u64) -> Worst {
    let (mut random, mut worst) = (Random::new(seed), Worst::default());
    for _ in 0..count {
        let Principled { base_color, metallic, roughness, specular, .. } = random.surface();
        let surface = Principled { base_color, metallic, roughness, specular, ..Principled::default() };
        let (wo, wi) = (random.direction(), random.direction());
        let (a, b) = (
            Bsdf::<false>::new(&surface, Mode::Conserving).eval(wo, wi),
            Bsdf::<true>::new(&surface, Mode::Conserving).eval(wo, wi),
        );
        let value = f64::from((a.f_cos - b.f_cos).abs().max_element() / a.f_cos.max(b.f_cos).max_element().max(1e-30));
        let error = value.max(f64::from((a.pdf - b.pdf).abs() / a.pdf.max(b.pdf).max(1e-30)));
        worst.see(error, error.is_nan() || error > 1e-4, || format!("{surface:?} wo {wo} wi {wi}: {a:?} {b:?}"));
    }
    worst
}

/// Reciprocity of conserving conductors but for their compensation, a factor of `wo` alone: it cancels around a triangle of
/// directions. The error is the largest relative difference of the products around it both ways; a failure is one beyond 1e-4, or
/// a factor of more than ten.
pub fn conductors(count: u64, seed: u64) -> Worst {
    let (mut random, mut worst) = (Random::new(seed), Worst::default());
    for _ in 0..count {
        let Principled { base_color, roughness, .. } = random.surface();
        let surface = Principled { base_color, roughness, metallic: 1.0, ..Principled::default() };
        let bsdf = Bsdf::<true>::new(&surface, Mode::Conserving);
        let [a, b, c] = [(); 3].map(|()| random.direction());
        let value = |wo: Vec3A, wi: Vec3A| (bsdf.eval(wo, wi).f_cos / wi.z).as_dvec3();
        let (around, back) = (value(a, b) * value(b, c) * value(c, a), value(b, a) * value(c, b) * value(a, c));
        let error = (around - back).abs().max_element() / around.max_element().max(1e-26);
        let ratio = value(a, b).x / value(b, a).x;
        let failed = error.is_nan() || error > 1e-4 || !(ratio.is_nan() || (0.1..10.0).contains(&ratio));
        worst.see(error, failed, || format!("{surface:?} {a} {b} {c}: {around} {back}, ratio {ratio}"));
    }
    worst
}

/// Values known on paper: a Lambertian surface, a mirror seen straight and at 60 degrees (Schlick's approximation), and nothing
/// below the horizon or of a black surface. The error is the largest distance from them; a failure is one beyond 2e-3.
pub fn known_values() -> Worst {
    let mut worst = Worst::default();
    let color = Vec3A::new(0.2, 0.5, 0.9);
    let lambert = Principled { base_color: color, metallic: 0.0, roughness: 0.0, specular: 0.0, ..Principled::default() };
    let (wo, wi) = (view(0.4, 1.0), view(0.6, 3.0));
    let value = Bsdf::<false>::new(&lambert, Mode::Conserving).eval(wo, wi);
    let cosine = wi.z * std::f32::consts::FRAC_1_PI;
    let error = (value.f_cos - color * cosine).abs().max_element().max((value.pdf - cosine).abs());
    // These are exact but for rounding.
    worst.see(error.into(), error > 1e-7, || format!("Lambertian: {value:?}"));
    let mirror = Principled { metallic: 1.0, ..lambert };
    let mirror = Bsdf::<false>::new(&mirror, Mode::Conserving);
    for (cos, wanted) in [(1.0, color), (0.5, color + (Vec3A::ONE - color) * 0.5_f32.powi(5))] {
        let found = albedo(&mirror, view(cos, 0.0), 128);
        let error = (found - wanted.as_dvec3()).abs().max_element();
        worst.see(error, error.is_nan() || error > 2e-3, || format!("mirror at cosine {cos}: {found}, not {wanted}"));
    }
    let below = Vec3A::new(0.6, 0.0, -0.8);
    for (wo, wi) in [(below, Vec3A::Z), (Vec3A::Z, below), (Vec3A::X, Vec3A::Z), (below, below)] {
        let value = mirror.eval(wo, wi);
        let nothing = value.f_cos == Vec3A::ZERO && value.pdf == 0.0;
        worst.see(0.0, !nothing, || format!("below the horizon: {wo} {wi} {value:?}"));
    }
    let black = Principled { base_color: Vec3A::ZERO, roughness: 0.5, ..lambert };
    let black = Bsdf::<false>::new(&black, Mode::Conserving);
    for (bsdf, wo) in [(&mirror, below), (&mirror, Vec3A::X), (&black, Vec3A::Z)] {
        let drawn = bsdf.sample(wo, 0.1, [0.2, 0.3]);
        worst.see(0.0, drawn.is_some(), || format!("drawn where nothing is reflected: {wo} {drawn:?}"));
    }
    worst
}

/// Largest weight over `count` random draws of random materials; half of them have a tint as strong as any. A failure is one
/// beyond 25, which would show as fireflies; 50 in `published` mode, whose blue sheen of `1 / 0.0722` is reached by
/// cosine-weighted draws (`pi` times as much). Subsurface scattering takes no part: its `1 / (cos_o + cos_i)` has no bound,
/// though its square has a mean, and one draw in a million weighs more.
pub fn weights(mode: Mode, count: u64, seed: u64) -> Worst {
    let (mut random, mut worst) = (Random::new(seed), Worst::default());
    let bound = if mode == Mode::Published { 50.0 } else { 25.0 };
    for _ in 0..count {
        let (mut surface, wo) = (Principled { subsurface: 0.0, ..random.surface() }, random.direction());
        if random.next() < 0.5 {
            (surface.base_color, surface.metallic) = (Vec3A::new(0.0, 0.0, surface.base_color.z), 0.0);
            (surface.specular, surface.specular_tint) = (surface.specular.max(0.5), 1.0);
        }
        let u = [random.next(), random.next(), random.next()];
        let drawn = Bsdf::<true>::new(&surface, mode).sample(wo, u[0], [u[1], u[2]]);
        let weight = drawn.map_or(0.0, |drawn| f64::from(drawn.weight.max_element()));
        worst.see(weight, weight.is_nan() || weight > bound, || format!("{surface:?} wo {wo} u {u:?}"));
    }
    worst
}

/// Largest relative difference of `f(wo, wi)` and `f(wi, wo)` over `count` random pairs. In `published` mode all materials take
/// part; in `conserving` mode dielectrics without sheen and clearcoat (the module [`crate::material`] says why the others are not
/// reciprocal).
pub fn reciprocity(mode: Mode, count: u64, seed: u64) -> Worst {
    let (mut random, mut worst) = (Random::new(seed), Worst::default());
    for _ in 0..count {
        let mut surface = random.surface();
        if mode == Mode::Conserving {
            (surface.metallic, surface.sheen, surface.clearcoat) = (0.0, 0.0, 0.0);
        }
        let (wo, wi) = (random.direction(), random.direction());
        let bsdf = Bsdf::<true>::new(&surface, mode);
        let a = bsdf.eval(wo, wi).f_cos.as_dvec3() / f64::from(wi.z);
        let b = bsdf.eval(wi, wo).f_cos.as_dvec3() / f64::from(wo.z);
        let error = (a - b).abs().max_element() / a.max_element().max(1e-9);
        worst.see(error, error.is_nan() || error > 1e-4, || format!("{surface:?} wo {wo} wi {wi}: {a} {b}"));
    }
    worst
}

/// The materials of [`furnace`] and [`pdf_integrals`]: every lobe alone and mixed, white or coloured.
pub fn grid(white: bool) -> Vec<Principled> {
    let base_color = if white { Vec3A::ONE } else { Vec3A::new(0.8, 0.4, 0.1) };
    let plain = Principled { base_color, sheen_tint: 0.5, ..Principled::default() };
    let mut surfaces = Vec::new();
    for roughness in [0.0, 0.03, 0.05, 0.1, 0.17, 0.25, 0.33, 0.5, 0.62, 0.75, 0.9, 1.0] {
        let plain = Principled { roughness, ..plain };
        for specular in [0.0, 0.1, 0.25, 0.5, 1.0] {
            surfaces.push(Principled { specular, ..plain });
        }
        surfaces.push(Principled { metallic: 1.0, ..plain });
        surfaces.push(Principled { metallic: 0.4, specular: 0.8, ..plain });
        for subsurface in [0.3, 1.0] {
            surfaces.push(Principled { subsurface, specular: 0.0, ..plain });
            surfaces.push(Principled { subsurface, specular: 1.0, ..plain });
        }
        surfaces.push(Principled { specular_tint: 1.0, specular: 1.0, ..plain });
        surfaces.push(Principled { sheen: 1.0, sheen_tint: 1.0, ..plain });
        for clearcoat_gloss in [0.0, 0.7, 1.0] {
            surfaces.push(Principled { clearcoat: 1.0, clearcoat_gloss, ..plain });
        }
        surfaces.push(Principled { clearcoat: 1.0, metallic: 1.0, ..plain });
        for anisotropic in [0.3, 0.8, 1.0] {
            surfaces.push(Principled { anisotropic, metallic: 1.0, ..plain });
            surfaces.push(Principled { anisotropic, ..plain });
        }
        let all = Principled { sheen: 1.0, clearcoat: 1.0, clearcoat_gloss: 0.5, subsurface: 0.5, anisotropic: 0.6, ..plain };
        surfaces.push(Principled { metallic: 0.3, specular_tint: 0.5, ..all });
    }
    surfaces
}

/// Every lobe alone, at roughnesses that matter to it.
pub fn lobes() -> Vec<Principled> {
    let none = Principled { base_color: Vec3A::ZERO, roughness: 0.3, specular: 0.0, sheen_tint: 0.0, ..Principled::default() };
    let base_color = Vec3A::new(0.8, 0.4, 0.1);
    let mut surfaces = vec![Principled { sheen: 1.0, ..none }];
    for roughness in [0.0, 0.4, 1.0] {
        let none = Principled { roughness, ..none };
        surfaces.push(Principled { base_color, ..none });
        surfaces.push(Principled { specular: 1.0, ..none });
        surfaces.push(Principled { base_color, subsurface: 1.0, ..none });
    }
    for roughness in [0.0, 0.1, 0.3, 0.6, 1.0] {
        for anisotropic in [0.0, 0.5, 1.0] {
            surfaces.push(Principled { base_color, metallic: 1.0, roughness, anisotropic, ..none });
        }
    }
    surfaces.extend([0.0, 0.5, 1.0].map(|clearcoat_gloss| Principled { clearcoat: 1.0, clearcoat_gloss, ..none }));
    surfaces
}

/// Cosines of the views that [`furnace`] tries.
pub const VIEWS: [f32; 11] = [1.0, 0.9, 0.7, 0.5, 0.25, 0.1, 0.06, 0.03, 0.01, 0.003, 0.0005];

/// Share of white light that a material reflects towards `wo`, by a midpoint rule over each lobe's own draws, weighed as the
/// balance heuristic does (Veach 1995): an estimate from random draws of the mixture would hide errors of a thousandth. `rings`
/// and twice as many sectors a lobe.
pub fn albedo<const FULL: bool>(bsdf: &Bsdf<FULL>, wo: Vec3A, rings: u32) -> DVec3 {
    let view = bsdf.view(wo);
    let sectors = 2 * rings;
    let mut sum = DVec3::ZERO;
    let mut below = 0.0;
    for (lobe, share) in view.shares().into_iter().enumerate() {
        let u_lobe = (below + 0.5 * share).min(1.0 - f32::EPSILON);
        below += share;
        if share <= 0.0 {
            continue;
        }
        for ring in 0..rings {
            let t = (ring as f32 + 0.5) / rings as f32;
            for sector in 0..sectors {
                let u = (sector as f32 + 0.5) / sectors as f32;
                if lobe == 2 {
                    // Not the lobe's own draws: what lies near the horizon needs more rings. Its density is cos / pi.
                    let wi = self::view(t * t, std::f32::consts::TAU * u);
                    let value = view.eval(wi);
                    let balance = share * wi.z * std::f32::consts::FRAC_1_PI / value.pdf;
                    sum += value.f_cos.as_dvec3() * f64::from(balance * 4.0 * std::f32::consts::PI * t);
                } else {
                    // The lobe of visible normals meets the horizon at u[0] = 1, and clearcoat's peak at 0: finer at both.
                    let rest = 1.0 - t * t;
                    let (u0, weight) = if lobe == 0 { (rest * rest, 4.0 * t * rest) } else { (t, 1.0) };
                    if let Some(drawn) = view.sample(u_lobe, [u0, u]) {
                        sum += drawn.weight.as_dvec3() * f64::from(share * weight);
                    }
                }
            }
        }
    }
    sum / f64::from(rings * sectors)
}

/// How far from 1 the albedo of a white material may lie: 0.5 %, and below 1 by 2 % for anisotropic ones, whose table errs high.
pub fn furnace_tolerance(surface: &Principled) -> f64 {
    if surface.anisotropic > 0.0 { 2e-2 } else { 5e-3 }
}

/// Directional albedo of the conserving form under a white sky, by [`albedo`] with `rings` (128 resolve a thousandth everywhere).
/// The error is `|albedo - 1|` for white materials and the excess over 1 for others; a failure is an albedo above `1 + 1e-3`, or
/// for white ones one further than [`furnace_tolerance`] from 1.
pub fn furnace(surfaces: &[Principled], rings: u32) -> Worst {
    let mut worst = Worst::default();
    for surface in surfaces {
        let white = surface.base_color == Vec3A::ONE;
        let bsdf = Bsdf::<true>::new(surface, Mode::Conserving);
        for (i, cos) in VIEWS.into_iter().enumerate() {
            let reflected = albedo(&bsdf, view(cos, 0.3 + i as f32), rings);
            let above = reflected.max_element() - 1.0;
            let error = if white { (reflected - 1.0).abs().max_element() } else { above };
            let failed = !reflected.is_finite() || above > 1e-3 || (white && error > furnace_tolerance(surface));
            worst.see(error, failed, || format!("{surface:?} cos {cos}: {reflected}"));
        }
    }
    worst
}

/// The density's integral over the hemisphere plus the share of `draws` draws that are `None` (mirrored below the horizon), less
/// 1. The error is that difference; a failure is one beyond 1e-3 and four standard errors of the share.
pub fn pdf_integrals(mode: Mode, surfaces: &[Principled], draws: u32, seed: u64) -> Worst {
    let (mut random, mut worst) = (Random::new(seed), Worst::default());
    for surface in surfaces {
        let bsdf = Bsdf::<true>::new(surface, mode);
        for cos in [1.0, 0.6, 0.2, 0.02] {
            let wo = view(cos, 0.7);
            let seen = bsdf.view(wo);
            let lost = (0..draws).filter(|_| seen.sample(random.next(), [random.next(), random.next()]).is_none()).count();
            let lost = lost as f64 / f64::from(draws);
            let deviation = (lost * (1.0 - lost) / f64::from(draws)).sqrt();
            let error = (integrate(&|wi| f64::from(seen.pdf(wi)), wo, surface) + lost - 1.0).abs();
            worst.see(error, error.is_nan() || error > 1e-3 + 4.0 * deviation, || format!("{surface:?} cos {cos}: lost {lost}"));
        }
    }
    worst
}

/// Integral over the hemisphere by adaptive cubature about the mirror direction, in cells as fine as the sharpest lobe.
fn integrate(density: &dyn Fn(Vec3A) -> f64, wo: Vec3A, surface: &Principled) -> f64 {
    let axis = DVec3::new(f64::from(-wo.x), f64::from(-wo.y), f64::from(wo.z));
    let width = f64::from(surface.roughness.max(0.032)).powi(2) * f64::from(1.0 - 0.9 * surface.anisotropic).sqrt();
    let spread = if surface.clearcoat > 0.0 { 1e-7 } else { (width * width * 0.1).min(f64::from(wo.z * wo.z)).max(1e-8) };
    // Seen at grazing angles a lobe is as much narrower across as the cosine is small.
    let columns = if wo.z < 0.1 { 48 } else { 32 };
    DirectionGrid::new(axis, spread, 24, columns)
        .integrate(&|wi| if wi.z > 0.0 { density(wi.as_vec3a()) } else { 0.0 })
        .iter()
        .sum()
}
