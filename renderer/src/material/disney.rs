//! Burley's principled material (2012) in its energy-conserving form.
//!
//! - Conductor: single-scattering GGX with Schlick's Fresnel, times `1 + F0 (1 - E(wo)) / E(wo)` for the light that leaves after
//!   several reflections (Turquin 2019). `E` is the directional albedo at reflectance 1. Kulla and Conty's separate lobe (2017)
//!   is reciprocal where this factor is not, but for smooth metals it is hard to draw (weights in the thousands at grazing view),
//!   and it needs a second look-up and a second lobe for every metal; paths are only ever traced from the camera.
//! - Dielectric: single-scattering GGX over a Lambertian base that receives, reciprocally, what the coat lets through (Kelemen
//!   and Szirmay-Kalos 2001).
//!
//! With base colour 1 the dielectric and the conductor each reflect exactly what they receive. `metallic` blends the two.
//!
//! The base is Lambertian and not Burley's diffuse: that one shapes the loss through the coat by hand (its Fresnel factors),
//! which the coupling above already does from the coat's own albedo, and its retro-reflection adds energy at grazing view.

use super::albedo::{Albedo, Row};
use super::fresnel::{f90, schlick};
use super::ggx::{Ggx, alpha};
use super::{BsdfEval, BsdfSample, Surface};
use glam::Vec3A;
use std::f32::consts::{FRAC_1_PI, PI};

/// The scattering function of one surface point.
#[derive(Clone, Copy)]
pub struct Bsdf {
    /// BSDF of the base, before what the coat takes from it.
    base: Vec3A,
    /// Whether `base` is not black.
    has_base: bool,
    /// `None` when nothing reflects specularly: then the material is Lambertian and the GGX code is never reached.
    coat: Option<Coat>,
}

/// The GGX lobe of coat and conductor together, and what the coat takes from the base.
#[derive(Clone, Copy)]
struct Coat {
    ggx: Ggx,
    row: Row,
    /// Reflectance at normal and at grazing incidence of the dielectric alone.
    f0_dielectric: f32,
    f90_dielectric: f32,
    /// Colour of the conductor, and its share.
    f0_metal: Vec3A,
    metallic: f32,
}

/// What depends on `wo` alone.
#[derive(Clone, Copy)]
struct Outgoing {
    /// Fresnel reflectances of the GGX lobe, shares and compensation applied.
    f0: Vec3A,
    f90: Vec3A,
    /// Share of `wo`'s light that the coat lets through.
    transmitted: f32,
    /// Probability of drawing the GGX lobe.
    share: f32,
}

impl Coat {
    /// What the dielectric coat lets through to the base.
    #[inline]
    fn transmitted(&self, albedo: Albedo) -> f32 {
        1.0 - (self.f0_dielectric * (albedo.e - albedo.b) + self.f90_dielectric * albedo.b)
    }

    #[inline]
    fn outgoing(&self, base: Vec3A, has_base: bool, cos: f32) -> Outgoing {
        let albedo = self.row.at(cos);
        let compensation = Vec3A::ONE + self.f0_metal * ((1.0 - albedo.e) / albedo.e);
        let metal = compensation * self.metallic;
        let f0 = metal * self.f0_metal + Vec3A::splat(self.f0_dielectric * (1.0 - self.metallic));
        let f90 = metal + Vec3A::splat(self.f90_dielectric * (1.0 - self.metallic));
        if !has_base {
            return Outgoing { f0, f90, transmitted: 0.0, share: 1.0 };
        }
        // Each lobe by the light it reflects towards `wo` under a white sky.
        let transmitted = self.transmitted(albedo);
        let single = (f0 * (albedo.e - albedo.b) + f90 * albedo.b).max_element();
        let diffuse = base.max_element() * transmitted * self.transmitted(self.row.mean) * PI;
        Outgoing { f0, f90, transmitted, share: single / (single + diffuse) }
    }

    /// GGX value (times cosine) and density.
    #[inline]
    fn specular(&self, outgoing: &Outgoing, wo: Vec3A, wi: Vec3A) -> (Vec3A, f32) {
        let h = wo + wi;
        let len2 = h.length_squared();
        // Two opposite directions on the horizon: no half vector, and no energy.
        if len2 < 1e-30 {
            return (Vec3A::ZERO, 0.0);
        }
        let d = self.ggx.distribution(h, len2);
        // For unit directions the cosine to the half vector is half the length of their sum.
        let fresnel = schlick(outgoing.f0, outgoing.f90, 0.5 * len2.sqrt());
        (fresnel * (d * self.ggx.visibility_cos(wo.z, wi.z)), self.ggx.pdf(wo.z, d))
    }

    /// Value (times cosine) and density of all lobes.
    #[inline]
    fn eval(&self, base: Vec3A, outgoing: &Outgoing, wo: Vec3A, wi: Vec3A) -> BsdfEval {
        let (specular, pdf) = self.specular(outgoing, wo, wi);
        // A conductor has no base: its second look-up is skipped.
        if outgoing.share == 1.0 {
            return BsdfEval { f_cos: specular, pdf };
        }
        let through = outgoing.transmitted * self.transmitted(self.row.at(wi.z));
        let cosine_pdf = wi.z * FRAC_1_PI;
        BsdfEval { f_cos: specular + base * (through * wi.z), pdf: outgoing.share * pdf + (1.0 - outgoing.share) * cosine_pdf }
    }
}

impl Bsdf {
    /// Prepares the lobes that `surface` has. Parameters beyond their range are taken at its end.
    #[inline]
    pub fn new(surface: &Surface) -> Self {
        let color = surface.base_color.clamp(Vec3A::ZERO, Vec3A::ONE);
        let metallic = surface.metallic.clamp(0.0, 1.0);
        let roughness = surface.roughness.clamp(0.0, 1.0);
        let f0_dielectric = 0.08 * surface.specular.clamp(0.0, 1.0);
        let base = color * ((1.0 - metallic) * FRAC_1_PI);
        let has_base = base != Vec3A::ZERO;
        if metallic == 0.0 && f0_dielectric == 0.0 {
            return Self { base, has_base, coat: None };
        }
        let coat = Coat {
            ggx: Ggx::new(alpha(roughness)),
            row: Row::new(roughness),
            f0_dielectric,
            f90_dielectric: f90(f0_dielectric),
            f0_metal: color,
            metallic,
        };
        // The coat's mean transmittance normalises the base: what enters leaves again where the base is white.
        let base = base / coat.transmitted(coat.row.mean);
        Self { base, has_base, coat: Some(coat) }
    }

    /// Value (times cosine) and density for two directions; zero when either lies on or below the shading horizon.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> BsdfEval {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return BsdfEval::default();
        }
        match &self.coat {
            None => BsdfEval { f_cos: self.base * wi.z, pdf: if self.has_base { wi.z * FRAC_1_PI } else { 0.0 } },
            Some(coat) => coat.eval(self.base, &coat.outgoing(self.base, self.has_base, wo.z), wo, wi),
        }
    }

    /// Density of [`Self::sample`], per steradian.
    #[inline]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        self.eval(wo, wi).pdf
    }

    /// Draws a direction; `u_lobe` and `u` are in 0..1. `None` when `wo` lies on or below the shading horizon, when the drawn
    /// facet mirrors `wo` below it, or when the material reflects nothing: the estimate is then zero.
    #[inline]
    pub fn sample(&self, wo: Vec3A, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        if wo.z <= 0.0 {
            return None;
        }
        let Some(coat) = &self.coat else {
            let wi = cosine_hemisphere(u);
            let pdf = wi.z * FRAC_1_PI;
            return (self.has_base && pdf > 0.0).then(|| BsdfSample { wi, weight: self.base * PI, pdf });
        };
        let outgoing = coat.outgoing(self.base, self.has_base, wo.z);
        let wi = if u_lobe < outgoing.share { coat.ggx.sample(wo, u)? } else { cosine_hemisphere(u) };
        if wi.z <= 0.0 {
            return None;
        }
        let BsdfEval { f_cos, pdf } = coat.eval(self.base, &outgoing, wo, wi);
        let weight = f_cos / pdf;
        // So small a density is rounded beyond use; its draw does not happen in practice.
        (pdf > 1e-30 && weight.is_finite()).then_some(BsdfSample { wi, weight, pdf })
    }
}

/// Cosine-weighted direction about +z: Shirley and Chiu's concentric disk, lifted.
#[inline]
fn cosine_hemisphere(u: [f32; 2]) -> Vec3A {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if a == 0.0 && b == 0.0 {
        return Vec3A::Z;
    }
    let (r, phi) = if a.abs() > b.abs() {
        (a, std::f32::consts::FRAC_PI_4 * (b / a))
    } else {
        (b, std::f32::consts::FRAC_PI_2 - std::f32::consts::FRAC_PI_4 * (a / b))
    };
    let (sin, cos) = phi.sin_cos();
    Vec3A::new(r * cos, r * sin, (1.0 - r * r).max(0.0).sqrt())
}
