//! Shape of the diffuse lobe, and its coupling to a coat that conserves energy.
//!
//! The shape is `s(wo, wi) = 1 + f_retro` with Burley's retro-reflection as he split it off later (2015, "Extending the Disney
//! BRDF to a BSDF", equation 4): `f_retro = R (Fo + Fi + Fo Fi (R - 1))`, `R = 2 roughness cos^2 theta_d`, `F = (1 - cos)^5`. His
//! other factor `(1 - Fo/2)(1 - Fi/2)` is the loss through the coat, for which the coat's own transmittance `T` stands here.
//!
//! With the transmittance coupled reciprocally (Kelemen and Szirmay-Kalos 2001) and what the shape does not spread evenly given
//! to a second lobe of the same form, the base is
//!
//! `base / (pi (Tm + h_max)) T(wo) T(wi) [ s(wo, wi) + d(wo) d(wi) / mean(T d) ]`,
//!
//! where `h(wo) = integral of T(wi) (s - 1) cos / pi dwi`, `d = h_max - h >= 0`, and `Tm`, `mean` are cosine-weighted means. Its
//! albedo is `base T(wo)` exactly, it is reciprocal, and with a constant shape it is the plain coupled Lambertian lobe.
//!
//! `f_retro` is a polynomial in `wo . wi`, so `h` needs five moments of `T` and no table of its own.

use super::albedo::Moments;
use super::subsurface;
use glam::Vec3A;
use renderflow_frame::fresnel::schlick_weight;

/// `f_retro` of the module's text for Schlick weights `fo`, `fi` and `dot` = `wo . wi`.
#[inline(always)]
fn retro(roughness: f32, fo: f32, fi: f32, dot: f32) -> f32 {
    let r = roughness * (1.0 + dot).max(0.0);
    r * (fo + fi + fo * fi * (r - 1.0))
}

/// `d` and the factors of the module's text, for one roughness and coat. `FULL = false` knows no subsurface part.
#[derive(Clone, Copy)]
pub(super) struct Diffuse<const FULL: bool> {
    roughness: f32,
    /// `h_retro / roughness` = `a + b c + F (c0 + c1 c + c2 c^2)` for a cosine `c`. It is largest at grazing view, `a + c0`, so
    /// that `a` drops out of what it lacks there.
    b: f32,
    c: [f32; 3],
    /// Factor of the second lobe.
    second: f32,
    /// `1 / (Tm + h_max)`.
    norm: f32,
    /// Share of the subsurface shape, and what belongs to it.
    subsurface: f32,
    scattering: Option<subsurface::Shape>,
}

impl<const FULL: bool> Diffuse<FULL> {
    /// The lobe of a material without a base.
    pub const BLACK: Self =
        Self { roughness: 0.0, b: 0.0, c: [0.0; 3], second: 0.0, norm: 0.0, subsurface: 0.0, scattering: None };

    /// `moments` are the moments of `T`; `coat` gives what the subsurface shape needs to know about it.
    #[inline(always)]
    pub fn new(roughness: f32, subsurface: f32, moments: &Moments, coat: impl FnOnce() -> subsurface::Coat) -> Self {
        let [m0, m1, f0, f1, f2] = *moments;
        if roughness == 0.0 && !(FULL && subsurface > 0.0) {
            return Self { norm: m0.recip(), ..Self::BLACK };
        }
        let (a, b) = (f0, f1);
        let c = [m0 - f0 + roughness * (1.5 * f0 - 0.5 * f2), m1 - f1 + 2.0 * roughness * f1, roughness * (1.5 * f2 - 0.5 * f0)];
        // Mean of T d / roughness.
        let mean = c[0] * (m0 - f0) - (b * m1 + c[1] * f1 + c[2] * f2);
        let retro_max = roughness * (a + c[0]);
        let mut diffuse = Self { roughness, b, c, ..Self::BLACK };
        if FULL && subsurface > 0.0 {
            let shape = subsurface::Shape::new(coat(), subsurface);
            let retro_share = 1.0 - subsurface;
            let mean = retro_share * roughness * mean + shape.mean(m0);
            diffuse.subsurface = subsurface;
            diffuse.second = if mean > 0.0 { mean.recip() } else { 0.0 };
            diffuse.norm = (m0 + retro_share * retro_max + shape.max()).recip();
            diffuse.scattering = Some(shape);
            return diffuse;
        }
        diffuse.second = if mean > 0.0 { roughness / mean } else { 0.0 };
        diffuse.norm = (m0 + retro_max).recip();
        diffuse
    }

    /// What `h_retro / roughness` lacks of its maximum.
    #[inline(always)]
    fn deficit(&self, cos: f32, f: f32) -> f32 {
        let [c0, c1, c2] = self.c;
        (c0 * (1.0 - f) - cos * (self.b + f * (c1 + cos * c2))).max(0.0)
    }

    /// What depends on one direction alone.
    #[inline(always)]
    pub fn slant(&self, cos: f32) -> Slant {
        if self.roughness == 0.0 && !(FULL && self.scattering.is_some()) {
            return Slant::default();
        }
        let weight = schlick_weight(cos);
        let mut deficit = self.deficit(cos, weight);
        if FULL && let Some(shape) = &self.scattering {
            deficit = (1.0 - self.subsurface) * self.roughness * deficit + shape.deficit(cos);
        }
        Slant { weight, deficit }
    }

    /// The bracket of the module's text times `1 / (Tm + h_max)`; `base T(wo) T(wi) / pi` is left to the caller. `outgoing` is
    /// the [`Self::slant`] of `wo`.
    #[inline(always)]
    pub fn eval(&self, outgoing: &Slant, wo: Vec3A, wi: Vec3A) -> f32 {
        if self.roughness == 0.0 && !(FULL && self.scattering.is_some()) {
            return self.norm;
        }
        let incoming = self.slant(wi.z);
        let (fo, fi, dot) = (outgoing.weight, incoming.weight, wo.dot(wi));
        let retro = retro(self.roughness, fo, fi, dot);
        let mut shaped = 1.0 + retro;
        if FULL && self.scattering.is_some() {
            let bulk = subsurface::shape(self.roughness.max(subsurface::MIN_ROUGHNESS), fo, fi, wo.z, wi.z, dot) - 1.0;
            shaped += (bulk - retro) * self.subsurface;
        }
        self.norm * (shaped + outgoing.deficit * (self.second * incoming.deficit))
    }
}

/// What a diffuse lobe makes of one direction.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slant {
    /// Schlick's weight.
    weight: f32,
    /// `d` of the module's text, in the lobe's units.
    deficit: f32,
}
