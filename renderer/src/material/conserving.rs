//! The principled material in its energy-conserving form.
//!
//! - Conductor: single-scattering GGX with Schlick's Fresnel, times `1 + F0 (1 - E(wo)) / E(wo)` for the light that leaves after
//!   several reflections (Turquin 2019). `E` is the directional albedo at reflectance 1. Kulla and Conty's separate lobe (2017)
//!   is reciprocal where this factor is not, but for smooth metals it is hard to draw (weights in the thousands at grazing view),
//!   and it needs a second look-up and a second lobe for every metal; paths are only ever traced from the camera.
//! - Dielectric: single-scattering GGX with the reflectance of Fresnel's equations ([`renderflow_frame::fresnel`]) over a diffuse
//!   base that receives, reciprocally, what the coat lets through: see [`super::diffuse`]. A tint scales the reflectance at
//!   normal incidence alone; its rise from there follows the untinted index.
//! - Sheen and clearcoat lie on top and scale everything below by `1 - E(wo)` of their own albedo. A factor of `wo` alone is not
//!   reciprocal; but with it the sum is exact for every view, where the reciprocal coupling of the base would need one second
//!   lobe a layer, and paths are only ever traced from the camera.
//!
//! With base colour 1 every material reflects exactly what it receives. `metallic` blends conductor and dielectric.

use super::albedo::{Albedo, AlbedoMoments, Row, UNIT_MOMENTS};
use super::anisotropy::Anisotropy;
use super::clearcoat::Clearcoat;
use super::diffuse::{Diffuse, Slant};
use super::fresnel::tint;
use super::ggx::{Ggx, alpha, alpha_xy};
use super::{BsdfEval, Lobes, Principled, sheen, subsurface};
use glam::Vec3A;
use renderflow_frame::fresnel::{Dielectric, MAX_F0, schlick_weight};
use std::f32::consts::FRAC_1_PI;

/// Largest reflectance at normal incidence that a tint may give a dielectric. A saturated blue over its luminance would reach 1
/// and leave the base nothing but grazing light, drawn with weights in the hundreds; no dielectric comes near.
const MAX_TINTED: f32 = 0.8;

/// The energy-conserving scattering function of one surface point.
#[derive(Clone, Copy)]
pub(super) struct Conserving<const FULL: bool> {
    /// Diffuse colour, `1 - metallic` applied.
    base: Vec3A,
    /// Whether `base` is not black.
    has_base: bool,
    diffuse: Diffuse<FULL>,
    /// `None` when neither coat nor conductor reflects: the GGX code is then never reached.
    coat: Option<Coat<FULL>>,
    /// Colour of the sheen, and whether it is not black.
    sheen: Vec3A,
    has_sheen: bool,
    clearcoat: Option<Clearcoat<true>>,
}

/// The GGX lobe of coat and conductor together, and what the coat takes from the base.
#[derive(Clone, Copy)]
struct Coat<const FULL: bool> {
    ggx: Ggx<FULL>,
    row: Row,
    anisotropy: Option<Anisotropy>,
    /// The dielectric without its tint; its tinted reflectance at normal incidence, and the largest channel of it.
    dielectric: Dielectric,
    f0_dielectric: Vec3A,
    f0_max: f32,
    /// Colour of the conductor, and its share.
    f0_metal: Vec3A,
    metallic: f32,
}

/// What depends on `wo` alone.
#[derive(Clone, Copy)]
pub(super) struct Outgoing {
    /// Fresnel reflectance of the GGX lobe, shares and compensation applied: `f0` plus Schlick's weight times `conductor` plus
    /// the dielectric's weight times `dielectric`.
    f0: Vec3A,
    conductor: Vec3A,
    dielectric: Vec3A,
    /// What Smith's masking makes of `wo`.
    smith: f32,
    /// What the coat lets through of `wo`'s light.
    transmitted: f32,
    /// What the diffuse lobe makes of `wo`.
    diffuse: Slant,
    /// Probabilities of drawing each lobe.
    pub lobes: Lobes,
    /// Share of `wo`'s light that the layers on top let through: clearcoat, and the sheen below it.
    below_clearcoat: f32,
    below_sheen: Vec3A,
}

impl<const FULL: bool> Coat<FULL> {
    #[inline(always)]
    fn albedo(&self, w: Vec3A) -> Albedo {
        match &self.anisotropy {
            Some(anisotropy) if FULL => anisotropy.at(w),
            _ => self.row.at(w.z),
        }
    }

    #[inline(always)]
    fn moments(&self) -> AlbedoMoments {
        match &self.anisotropy {
            Some(anisotropy) if FULL => anisotropy.moments(),
            _ => self.row.moments(),
        }
    }

    /// What the dielectric coat lets through to the base, in the channel it lets through least.
    #[inline(always)]
    fn transmitted(&self, albedo: &Albedo, cos: f32) -> f32 {
        (1.0 - albedo.reflected(self.f0_max, albedo.dielectric(&self.dielectric, cos))).max(0.0)
    }

    /// GGX value (times cosine) and density.
    #[inline(always)]
    fn specular(&self, outgoing: &Outgoing, wo: Vec3A, wi: Vec3A) -> (Vec3A, f32) {
        let h = wo + wi;
        let len2 = h.length_squared();
        // Two opposite directions on the horizon: no half vector, and no energy.
        if len2 < 1e-30 {
            return (Vec3A::ZERO, 0.0);
        }
        let d = self.ggx.distribution(h, len2);
        // For unit directions the cosine to the half vector is half the length of their sum.
        let cos_d = 0.5 * len2.sqrt();
        let mut fresnel = outgoing.f0 + outgoing.conductor * schlick_weight(cos_d);
        if self.metallic < 1.0 {
            fresnel += outgoing.dielectric * self.dielectric.weight(cos_d);
        }
        (fresnel * (d * self.ggx.visibility_cos(wo, wi, outgoing.smith)), Ggx::<FULL>::pdf(wo, d, outgoing.smith))
    }
}

impl<const FULL: bool> Conserving<FULL> {
    /// `surface` has its parameters in range.
    #[inline(always)]
    pub fn new(surface: &Principled) -> Self {
        let color = surface.base_color;
        let Principled { metallic, roughness, .. } = *surface;
        let base = color * (1.0 - metallic);
        let f0_untinted = MAX_F0 * surface.specular;
        let mut f0_dielectric = Vec3A::splat(f0_untinted);
        if FULL && surface.specular_tint > 0.0 {
            f0_dielectric = (f0_dielectric * Vec3A::ONE.lerp(tint(color), surface.specular_tint)).min(Vec3A::splat(MAX_TINTED));
        }
        let f0_max = if FULL { f0_dielectric.max_element() } else { f0_untinted };
        let coat = (metallic > 0.0 || f0_max > 0.0).then(|| {
            let (ggx, anisotropy) = if FULL && surface.anisotropic > 0.0 {
                let lobe = Anisotropy::new(roughness, surface.anisotropic);
                (Ggx::with_widths(alpha_xy(roughness, surface.anisotropic)), Some(lobe))
            } else {
                (Ggx::with_widths([alpha(roughness); 2]), None)
            };
            let row = Row::new(roughness);
            let dielectric = if metallic < 1.0 { Dielectric::new(f0_untinted) } else { Dielectric::AIR };
            Coat { ggx, row, anisotropy, dielectric, f0_dielectric, f0_max, f0_metal: color, metallic }
        });
        let has_base = base != Vec3A::ZERO;
        let diffuse = if has_base { Self::diffuse(surface, coat.as_ref()) } else { Diffuse::BLACK };
        let mut bsdf = Self { base, has_base, diffuse, coat, sheen: Vec3A::ZERO, has_sheen: false, clearcoat: None };
        if FULL && surface.sheen > 0.0 && metallic < 1.0 {
            let hue = Vec3A::ONE.lerp(tint(color), surface.sheen_tint);
            // A saturated dark colour divided by its luminance goes far beyond 1, and its sheen would gain energy.
            bsdf.sheen = hue * ((1.0 - metallic) * surface.sheen / hue.max_element().max(1.0));
            bsdf.has_sheen = true;
        }
        if FULL && surface.clearcoat > 0.0 {
            bsdf.clearcoat = Some(Clearcoat::new(surface.clearcoat, surface.clearcoat_gloss));
        }
        bsdf
    }

    #[inline(always)]
    fn diffuse(surface: &Principled, coat: Option<&Coat<FULL>>) -> Diffuse<FULL> {
        let (moments, f0, dielectric) = match coat {
            Some(coat) => (coat.moments().transmitted(coat.f0_max, &coat.dielectric), coat.f0_max, coat.dielectric),
            None => (UNIT_MOMENTS, 0.0, Dielectric::AIR),
        };
        let share = if FULL { surface.subsurface } else { 0.0 };
        Diffuse::new(surface.roughness, share, &moments, || subsurface::Coat {
            row: coat.map_or_else(|| Row::new(surface.roughness), |coat| coat.row),
            f0,
            surface: dielectric,
        })
    }

    /// What depends on `wo` alone.
    #[inline(always)]
    pub fn outgoing(&self, wo: Vec3A) -> Outgoing {
        let mut outgoing = Outgoing {
            f0: Vec3A::ZERO,
            conductor: Vec3A::ZERO,
            dielectric: Vec3A::ZERO,
            smith: 1.0,
            transmitted: 1.0,
            diffuse: Slant::default(),
            lobes: Lobes { ggx: 0.0, clearcoat: 0.0, cosine: 1.0 },
            below_clearcoat: 1.0,
            below_sheen: Vec3A::ONE,
        };
        // Each lobe by the light it reflects towards `wo` under a white sky.
        let mut specular = 0.0;
        if self.has_base {
            outgoing.diffuse = self.diffuse.slant(wo.z);
        }
        if let Some(coat) = &self.coat {
            outgoing.smith = coat.ggx.smith(wo);
            let albedo = coat.albedo(wo);
            let compensation = Vec3A::ONE + coat.f0_metal * ((1.0 - albedo.e) / albedo.e);
            let metal = compensation * coat.metallic;
            outgoing.f0 = metal * coat.f0_metal + coat.f0_dielectric * (1.0 - coat.metallic);
            outgoing.conductor = metal * (Vec3A::ONE - coat.f0_metal);
            outgoing.dielectric = (Vec3A::ONE - coat.f0_dielectric) * (1.0 - coat.metallic);
            outgoing.lobes = Lobes { ggx: 1.0, clearcoat: 0.0, cosine: 0.0 };
            if !self.has_base && !(FULL && (self.has_sheen || self.clearcoat.is_some())) {
                return outgoing;
            }
            let rise = albedo.dielectric(&coat.dielectric, wo.z);
            outgoing.transmitted = (1.0 - albedo.reflected(coat.f0_max, rise)).max(0.0);
            let reflected = outgoing.f0 * albedo.e + outgoing.conductor * albedo.schlick(wo.z) + outgoing.dielectric * rise;
            specular = reflected.max_element();
        }
        let diffuse = self.base.max_element() * outgoing.transmitted;
        if FULL && (self.has_sheen || self.clearcoat.is_some()) {
            let sheen = if self.has_sheen { self.sheen * sheen::albedo(wo.z) } else { Vec3A::ZERO };
            let clearcoat = self.clearcoat.as_ref().map_or(0.0, |lobe| lobe.albedo(wo.z));
            outgoing.below_sheen = Vec3A::ONE - sheen;
            outgoing.below_clearcoat = 1.0 - clearcoat;
            let through = outgoing.below_sheen.max_element() * outgoing.below_clearcoat;
            let cosine = outgoing.below_clearcoat * sheen.max_element() + through * diffuse;
            outgoing.lobes = Lobes::new(through * specular, clearcoat, cosine);
        } else if self.coat.is_some() {
            outgoing.lobes = Lobes::new(specular, 0.0, diffuse);
        }
        outgoing
    }

    /// Whether nothing is reflected at all.
    #[inline(always)]
    pub fn is_black(&self) -> bool {
        !self.has_base && self.coat.is_none() && !(FULL && (self.has_sheen || self.clearcoat.is_some()))
    }

    /// The GGX lobe.
    #[inline(always)]
    pub fn ggx(&self) -> Option<&Ggx<FULL>> {
        self.coat.as_ref().map(|coat| &coat.ggx)
    }

    /// The clearcoat lobe.
    #[inline(always)]
    pub fn clearcoat(&self) -> Option<&Clearcoat<true>> {
        self.clearcoat.as_ref()
    }

    /// Value (times cosine) and density of all lobes; both directions lie above the horizon.
    #[inline(always)]
    pub fn eval(&self, outgoing: &Outgoing, wo: Vec3A, wi: Vec3A) -> BsdfEval {
        let (mut f_cos, mut pdf) = (Vec3A::ZERO, 0.0);
        if let Some(coat) = &self.coat {
            (f_cos, pdf) = coat.specular(outgoing, wo, wi);
            // A conductor has no base: its second look-up is skipped.
            if !self.has_base && !(FULL && (self.has_sheen || self.clearcoat.is_some())) {
                return BsdfEval { f_cos, pdf };
            }
        }
        let cosine_pdf = wi.z * FRAC_1_PI;
        pdf = outgoing.lobes.ggx * pdf + outgoing.lobes.cosine * cosine_pdf;
        if self.has_base {
            let through = match &self.coat {
                Some(coat) => outgoing.transmitted * coat.transmitted(&coat.albedo(wi), wi.z),
                None => 1.0,
            };
            f_cos += self.base * (through * self.diffuse.eval(&outgoing.diffuse, wo, wi) * cosine_pdf);
        }
        if FULL && self.has_sheen {
            f_cos = f_cos * outgoing.below_sheen + self.sheen * (sheen::value(wo.dot(wi)) * wi.z);
        }
        if FULL && let Some(lobe) = &self.clearcoat {
            let (value, density) = lobe.eval(wo, wi);
            f_cos = f_cos * outgoing.below_clearcoat + Vec3A::splat(value);
            pdf += outgoing.lobes.clearcoat * density;
        }
        BsdfEval { f_cos, pdf }
    }
}
