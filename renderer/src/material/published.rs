//! The principled material as Burley printed it ("Physically Based Shading at Disney", 2012, and the code of his BRDF explorer).
//!
//! Its diffuse part gains and loses energy by design; this form exists to be compared with other renderers. One later change of
//! his own is taken over (2014 revision of the notes): masking uses the lobe's own widths, not the earlier `(0.5 + roughness /
//! 2)^2`. Colours are linear Rec.709, so that the luminance in `Ctint` is Rec.709's.

use super::albedo::Row;
use super::clearcoat::Clearcoat;
use super::fresnel::{schlick, tint};
use super::ggx::{Ggx, alpha_xy};
use super::{BsdfEval, Lobes, Principled, sheen, subsurface};
use glam::Vec3A;
use renderflow_frame::fresnel::schlick_weight;
use std::f32::consts::FRAC_1_PI;

/// The published scattering function of one surface point.
#[derive(Clone, Copy)]
pub(super) struct Published {
    /// Diffuse and sheen colour, `1 - metallic` applied.
    base: Vec3A,
    sheen: Vec3A,
    roughness: f32,
    subsurface: f32,
    ggx: Ggx<true>,
    row: Row,
    /// `Cspec0`.
    f0: Vec3A,
    clearcoat: Option<Clearcoat<false>>,
}

impl Published {
    /// `surface` has its parameters in range.
    pub fn new(surface: &Principled) -> Self {
        let Principled { base_color, metallic, roughness, .. } = *surface;
        let hue = tint(base_color);
        let dielectric = Vec3A::ONE.lerp(hue, surface.specular_tint) * (0.08 * surface.specular);
        Self {
            base: base_color * (1.0 - metallic),
            sheen: Vec3A::ONE.lerp(hue, surface.sheen_tint) * (surface.sheen * (1.0 - metallic)),
            roughness,
            subsurface: surface.subsurface,
            ggx: Ggx::with_widths(alpha_xy(roughness, surface.anisotropic)),
            row: Row::new(roughness),
            f0: dielectric.lerp(base_color, metallic),
            clearcoat: (surface.clearcoat > 0.0).then(|| Clearcoat::new(surface.clearcoat, surface.clearcoat_gloss)),
        }
    }

    /// Probabilities of drawing each lobe: about the light it reflects towards `wo` under a white sky.
    pub fn lobes(&self, wo: Vec3A) -> Lobes {
        let albedo = self.row.at(wo.z);
        let clearcoat = self.clearcoat.as_ref().map_or(0.0, |lobe| lobe.albedo(wo.z));
        let cosine = self.base.max_element() + self.sheen.max_element() * sheen::albedo(wo.z);
        Lobes::new(albedo.reflected(self.f0.max_element(), albedo.schlick(wo.z)), clearcoat, cosine)
    }

    /// The GGX lobe.
    pub fn ggx(&self) -> &Ggx<true> {
        &self.ggx
    }

    /// The clearcoat lobe.
    pub fn clearcoat(&self) -> Option<&Clearcoat<false>> {
        self.clearcoat.as_ref()
    }

    /// Value (times cosine) and density of all lobes; both directions lie above the horizon.
    pub fn eval(&self, lobes: &Lobes, wo: Vec3A, wi: Vec3A) -> BsdfEval {
        let dot = wo.dot(wi);
        let cosine_pdf = wi.z * FRAC_1_PI;
        let mut pdf = lobes.cosine * cosine_pdf;
        let mut f_cos = Vec3A::ZERO;
        if self.base != Vec3A::ZERO {
            f_cos += self.base * (self.diffuse(wo.z, wi.z, dot) * cosine_pdf);
        }
        if self.sheen != Vec3A::ZERO {
            f_cos += self.sheen * (sheen::value(dot) * wi.z);
        }
        let h = wo + wi;
        let len2 = h.length_squared();
        if len2 >= 1e-30 {
            let d = self.ggx.distribution(h, len2);
            let fresnel = schlick(self.f0, Vec3A::ONE, 0.5 * len2.sqrt());
            let smith = self.ggx.smith(wo);
            f_cos += fresnel * (d * self.ggx.visibility_cos_separable(wo, wi, smith));
            pdf += lobes.ggx * Ggx::<true>::pdf(wo, d, smith);
        }
        if let Some(lobe) = &self.clearcoat {
            let (value, density) = lobe.eval(wo, wi);
            f_cos += Vec3A::splat(value);
            pdf += lobes.clearcoat * density;
        }
        BsdfEval { f_cos, pdf }
    }

    /// `mix(Fd, ss, subsurface)`: retro-reflective diffuse (2012, section 5.3) and its subsurface approximation.
    fn diffuse(&self, cos_o: f32, cos_i: f32, dot: f32) -> f32 {
        let (fo, fi) = (schlick_weight(cos_o), schlick_weight(cos_i));
        // 2 roughness cos^2 theta_d + 0.5, with cos^2 theta_d = (1 + wo . wi) / 2.
        let f90 = 0.5 + self.roughness * (1.0 + dot).max(0.0);
        let diffuse = (1.0 + (f90 - 1.0) * fi) * (1.0 + (f90 - 1.0) * fo);
        if self.subsurface == 0.0 {
            return diffuse;
        }
        let bulk = subsurface::shape(self.roughness, fo, fi, cos_o, cos_i, dot);
        diffuse + (bulk - diffuse) * self.subsurface
    }
}
