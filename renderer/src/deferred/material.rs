//! The path tracer's energy-conserving material, as far as a G-buffer stores it: base colour, roughness, metallic, specular.
//!
//! A conductor is single-scattering GGX with Schlick's Fresnel term, times `1 + F0 (1 - E) / E` (Turquin 2019). A dielectric
//! reflects by Fresnel's equations and is a coat on a diffuse base. The base receives, reciprocally, what the coat lets through.
//! It has Burley's retro-reflection (2015), and a second lobe that restores what this shape does not spread evenly. Under even
//! light the base therefore reflects `base T(wo)`, with the coat's transmittance `T`.

use crate::material::Principled;
use glam::{DVec4, Vec3A, Vec4};
use renderflow_frame::fresnel::{Dielectric, schlick_weight};
use renderflow_frame::ibl::{dielectric, environment_brdf};
use std::f32::consts::FRAC_1_PI;
use std::sync::OnceLock;

/// Smallest GGX width, as in the path tracer.
const MIN_ALPHA: f32 = 1e-3;
/// Rows of the table of means, along roughness.
const ROUGHNESS_STEPS: usize = 33;
/// Quadrature points of a mean.
const QUADRATURE: usize = 48;

/// `2 * integral of k(c) w(c) c dc` over 0..=1 for the weights `w` = `1, c, F, F c, F c^2` with `F = (1 - c)^5`.
type Moments = [f32; 5];
/// Moments of `k = 1`.
const UNIT: Moments = [1.0, 2.0 / 3.0, 1.0 / 21.0, 1.0 / 84.0, 1.0 / 252.0];

/// Moments of the environment BRDF for a roughness: of its whole, and of its four parts.
fn moments(roughness: f32) -> (Moments, [Vec4; 5]) {
    static TABLE: OnceLock<Vec<(Moments, [Vec4; 5])>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        let row = |r: usize| {
            let (mut whole, mut parts) = ([0.0_f64; 5], [DVec4::ZERO; 5]);
            for i in 0..QUADRATURE {
                // Squared steps, as the factors change fastest at grazing angles: dc = 2 x dx.
                let x = (i as f32 + 0.5) / QUADRATURE as f32;
                let c = x * x;
                let weight = f64::from(2.0 * c * 2.0 * x) / QUADRATURE as f64;
                let f = schlick_weight(c);
                let brdf = environment_brdf(c, r as f32 / (ROUGHNESS_STEPS - 1) as f32);
                for (k, w) in [1.0, c, f, f * c, f * c * c].into_iter().enumerate() {
                    whole[k] += weight * f64::from(brdf.whole * w);
                    parts[k] += (brdf.parts * w).as_dvec4() * weight;
                }
            }
            (whole.map(|v| v as f32), parts.map(|v| v.as_vec4()))
        };
        (0..ROUGHNESS_STEPS).map(row).collect()
    });
    let at = roughness.clamp(0.0, 1.0) * (ROUGHNESS_STEPS - 1) as f32;
    let i = (at as usize).min(ROUGHNESS_STEPS - 2);
    let t = at - i as f32;
    let ((whole, parts), (whole_next, parts_next)) = (&table[i], &table[i + 1]);
    (
        std::array::from_fn(|k| whole[k] + (whole_next[k] - whole[k]) * t),
        std::array::from_fn(|k| parts[k] + (parts_next[k] - parts[k]) * t),
    )
}

/// A material seen from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Material {
    /// Diffuse colour, `albedo * (1 - metallic)`.
    pub base: Vec3A,
    /// GGX width.
    pub alpha: f32,
    roughness: f32,
    /// Reflectance of the GGX lobe with the compensation for `wo`: `f0`, plus Schlick's weight times `conductor`, plus the coat's
    /// weight times `share`.
    f0: Vec3A,
    conductor: Vec3A,
    share: f32,
    /// The dielectric coat alone.
    coat: Dielectric,
    /// Share of light along `wo` that reaches the base.
    pub transmitted: f32,
    /// Share of even light that the GGX lobe reflects.
    pub reflected: Vec3A,
    n_dot_v: f32,
    retro: Retro,
}

/// Constants of the diffuse shape, see the path tracer's diffuse lobe.
#[derive(Clone, Copy, Debug, Default)]
struct Retro {
    b: f32,
    c: [f32; 3],
    second: f32,
    norm: f32,
    /// `F`, and the shape's deficit from its maximum, for `wo`.
    weight: f32,
    deficit: f32,
}

/// Outgoing radiance for a light that gives an irradiance of 1 to a surface facing it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Response {
    /// Radiance from the base, its colour included.
    pub diffuse: Vec3A,
    /// Radiance from the GGX lobe.
    pub specular: Vec3A,
}

impl Material {
    /// The plain part of `surface` (base colour, metallic, roughness, specular) at a cosine `n_dot_v`, 0..=1, between normal and
    /// view.
    pub fn new(surface: &Principled, n_dot_v: f32) -> Self {
        let Principled { base_color: albedo, metallic, roughness, specular, .. } = *surface;
        let brdf = environment_brdf(n_dot_v, roughness);
        let coat = dielectric(specular);
        let compensation = Vec3A::ONE + albedo * ((1.0 - brdf.whole).max(0.0) / brdf.whole.max(1e-3));
        let metal = compensation * metallic;
        let f0 = metal * albedo + Vec3A::splat(coat.f0() * (1.0 - metallic));
        let base = albedo * (1.0 - metallic);
        let mut material = Self {
            base,
            alpha: (roughness * roughness).max(MIN_ALPHA),
            roughness,
            f0,
            conductor: metal * (Vec3A::ONE - albedo),
            share: (1.0 - metallic) * (1.0 - coat.f0()),
            coat,
            transmitted: (1.0 - brdf.dielectric(&coat)).max(0.0),
            reflected: metal * brdf.conductor(albedo) + brdf.dielectric(&coat) * (1.0 - metallic),
            n_dot_v,
            retro: Retro::default(),
        };
        if base != Vec3A::ZERO {
            material.retro = Retro::new(roughness, &coat, n_dot_v);
        }
        material
    }

    /// Response to a light in direction `l`, a disc of `angular_radius` radians. `cosine` is the mean cosine between normal and
    /// disc, where parts below the horizon count as 0. `n`, `v` and `l` are unit vectors in one space.
    pub fn respond(&self, n: Vec3A, v: Vec3A, l: Vec3A, cosine: f32, angular_radius: f32) -> Response {
        if cosine <= 0.0 {
            return Response::default();
        }
        let mut diffuse = Vec3A::ZERO;
        if self.base != Vec3A::ZERO {
            let brdf = environment_brdf(cosine, self.roughness);
            let through = self.transmitted * (1.0 - brdf.dielectric(&self.coat)).max(0.0);
            diffuse = self.base * (FRAC_1_PI * cosine * through * self.retro.shape(self.roughness, cosine, v.dot(l)));
        }
        let h = v + l;
        let length2 = h.length_squared();
        if length2 < 1e-12 {
            return Response { diffuse, specular: Vec3A::ZERO };
        }
        let h = h / length2.sqrt();
        let n_dot_h = n.dot(h).clamp(0.0, 1.0);
        // A disc spreads half vectors over half its radius; the wider lobe keeps its energy, as each is normalised.
        let spread = 0.5 * angular_radius;
        let alpha2 = (self.alpha * self.alpha + spread * spread).min(1.0);
        // 1 - cos^2 would lose a narrow lobe to rounding.
        let sin2 = n.cross(h).length_squared();
        let t = sin2 + alpha2 * n_dot_h * n_dot_h;
        let distribution = FRAC_1_PI * alpha2 / (t * t).max(1e-20);
        let a2 = self.alpha * self.alpha;
        let smith = |c: f32| (a2 + (1.0 - a2) * c * c).sqrt();
        let masking = 0.5 / (self.n_dot_v * smith(cosine) + cosine * smith(self.n_dot_v)).max(1e-9);
        let v_dot_h = v.dot(h).clamp(0.0, 1.0);
        let fresnel = self.f0 + self.conductor * schlick_weight(v_dot_h) + self.share * self.coat.weight(v_dot_h);
        Response { diffuse, specular: fresnel * (distribution * masking * cosine) }
    }
}

impl Retro {
    fn new(roughness: f32, coat: &Dielectric, cosine: f32) -> Self {
        let (whole, parts) = moments(roughness);
        let rise = 1.0 - coat.f0();
        let [m0, m1, f0, f1, f2] =
            std::array::from_fn(|k| UNIT[k] - coat.f0() * whole[k] - rise * parts[k].dot(coat.coefficients()));
        let c = [m0 - f0 + roughness * (1.5 * f0 - 0.5 * f2), m1 - f1 + 2.0 * roughness * f1, roughness * (1.5 * f2 - 0.5 * f0)];
        let mean = c[0] * (m0 - f0) - (f1 * m1 + c[1] * f1 + c[2] * f2);
        let second = if mean > 1e-6 { roughness / mean } else { 0.0 };
        let mut retro =
            Self { b: f1, c, second, norm: (m0 + roughness * (f0 + c[0])).max(1e-3).recip(), weight: 0.0, deficit: 0.0 };
        retro.weight = schlick_weight(cosine);
        retro.deficit = retro.deficit(cosine, retro.weight);
        retro
    }

    fn deficit(&self, cosine: f32, f: f32) -> f32 {
        let [c0, c1, c2] = self.c;
        (c0 * (1.0 - f) - cosine * (self.b + f * (c1 + cosine * c2))).max(0.0)
    }

    fn shape(&self, roughness: f32, cosine: f32, v_dot_l: f32) -> f32 {
        let f = schlick_weight(cosine);
        let r = roughness * (1.0 + v_dot_l).max(0.0);
        let retro = r * (self.weight + f + self.weight * f * (r - 1.0));
        self.norm * (1.0 + retro + self.deficit * self.second * self.deficit(cosine, f))
    }
}
