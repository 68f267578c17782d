//! Surfaces that let light through: a rough dielectric between two media (Walter et al. 2007, "Microfacet Models for Refraction
//! through Rough Surfaces"; the transmission of Burley 2015, "Extending the Disney BRDF to a BSDF with Integrated Subsurface
//! Scattering"), and a sheet of it.
//!
//! - A **body** has air outside. Fresnel's equations divide the light of a facet into what is mirrored and what is refracted.
//!   What crosses the surface is multiplied by the base colour, as glTF has it. Paths carry radiance, so crossing into index
//!   `n` divides it by `n^2` (Veach 1997, section 5.2).
//! - A **sheet** is a body so thin that its two sides are one. With all reflections between them it mirrors `2 F / (1 + F)` and
//!   passes `(1 - F) / (1 + F)` of the light of a facet, without bending it; a rough sheet spreads both alike.
//! - A **pane** is a smooth sheet. What it passes goes straight on, which the integrator does (`crate::clear`); here it only
//!   mirrors.
//!
//! In conserving mode the lobes are divided by their common albedo for the view, from a table: single scattering loses light
//! between facets (as Turquin 2019 does for conductors). Published mode leaves this out and takes masking and shadowing as
//! independent, as Mitsuba's `roughdielectric` does. The lobe is isotropic.

use super::albedo::{COSINES, ROUGHNESSES, Row, Table};
use super::ggx::{Ggx, alpha};
use super::{BsdfEval, BsdfSample, Mode, Principled, Side};
use glam::Vec3A;
use renderflow_frame::fresnel::MAX_F0;
use std::sync::OnceLock;

/// Smallest index of refraction: half vectors of refraction lose their digits at 1.
const MIN_IOR: f32 = 1.01;
/// Indices of the table, even in the root of the reflectance at normal incidence.
const INDICES: usize = 17;
/// Strata of the table's integration, (radial, azimuthal over half a turn).
const STRATA: [usize; 2] = [64, 24];

/// Index of refraction of a dielectric whose reflectance at normal incidence is `f0`.
fn index(f0: f32) -> f32 {
    let root = f0.clamp(0.0, MAX_F0).sqrt();
    ((1.0 + root) / (1.0 - root)).max(MIN_IOR)
}

/// Reflectance of a facet met at cosine `cos` > 0, where the index on the other side is `eta` times the index on this side: 1
/// where nothing can pass.
#[inline(always)]
pub(crate) fn fresnel(cos: f32, eta: f32) -> f32 {
    let g2 = eta * eta - 1.0 + cos * cos;
    if g2 <= 0.0 {
        return 1.0;
    }
    let g = g2.sqrt();
    let (sum, difference) = (g + cos, g - cos);
    let (a, b) = (difference / sum, (cos * sum - 1.0) / (cos * difference + 1.0));
    (0.5 * a * a * (1.0 + b * b)).min(1.0)
}

/// Index of refraction of a dielectric whose `specular` is 0..=1.
#[inline(always)]
pub fn refraction_index(specular: f32) -> f32 {
    index(MAX_F0 * specular)
}

/// What a pane of reflectance `specular` passes of light that meets it at cosine `cos`, without its colour.
#[inline(always)]
pub(crate) fn pane_transmittance(specular: f32, cos: f32) -> f32 {
    let f = fresnel(cos.clamp(1e-4, 1.0), index(MAX_F0 * specular));
    (1.0 - f) / (1.0 + f)
}

/// The clear part of one surface point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Glass {
    ggx: Ggx<false>,
    /// Index of the inside over that of the outside.
    ior: f32,
    color: Vec3A,
    /// In conserving mode, what finds the albedo.
    albedo: Option<Lookup>,
}

/// Rows of the tables that belong to a material.
#[derive(Clone, Copy, Debug)]
struct Lookup {
    row: Row,
    /// By side, index of refraction and roughness.
    rows: [[[&'static [f32; COSINES]; 2]; 2]; 2],
    /// Share of the upper index of refraction.
    share: f32,
}

impl Lookup {
    #[inline(always)]
    fn new(surface: &Principled) -> Self {
        let x = surface.specular.sqrt() * (INDICES - 1) as f32;
        let node = (x as usize).min(INDICES - 2);
        let row = Row::new(surface.roughness);
        let (first, _) = row.rows();
        let rows = [false, true].map(|inside| [0, 1].map(|i| [0, 1].map(|r| albedos(inside, node + i, first + r))));
        Self { row, rows, share: x - node as f32 }
    }

    /// Albedo at one cosine; `side` is 1 inside.
    #[inline(always)]
    fn at(&self, side: usize, cos: f32) -> f32 {
        let (i, s) = self.row.locate(cos);
        let (_, t) = self.row.rows();
        let along = |[low, high]: [&[f32; COSINES]; 2]| {
            let [low, high] = [low, high].map(|nodes| nodes[i] + (nodes[i + 1] - nodes[i]) * s);
            low + (high - low) * t
        };
        let [low, high] = self.rows[side].map(along);
        low + (high - low) * self.share
    }
}

impl Glass {
    /// `surface` has its parameters in range.
    #[inline(always)]
    pub fn new(surface: &Principled, mode: Mode) -> Self {
        let f0 = MAX_F0 * surface.specular;
        let albedo = (mode == Mode::Conserving).then(|| Lookup::new(surface));
        Self { ggx: Ggx::new(alpha(surface.roughness)), ior: index(f0), color: surface.base_color, albedo }
    }

    /// Seen from `wo`, above the horizon.
    #[inline(always)]
    pub fn view(&self, wo: Vec3A, side: Side) -> GlassView<'_> {
        let scale = self.albedo.as_ref().map_or(1.0, |lookup| match side {
            Side::Sheet | Side::Pane => 1.0 / lookup.row.at(wo.z).e,
            Side::Outside => 1.0 / lookup.at(0, wo.z),
            Side::Inside => 1.0 / lookup.at(1, wo.z),
        });
        let eta = if side == Side::Inside { 1.0 / self.ior } else { self.ior };
        GlassView { glass: self, wo, side, eta, smith: self.ggx.smith(wo), scale, separable: self.albedo.is_none() }
    }
}

/// A [`Glass`] seen from one direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct GlassView<'a> {
    glass: &'a Glass,
    wo: Vec3A,
    side: Side,
    /// Index of the other side over that of the viewer's.
    eta: f32,
    smith: f32,
    /// Factor that gives back what single scattering loses.
    scale: f32,
    separable: bool,
}

impl GlassView<'_> {
    /// Shares of a facet's light that are mirrored and passed, at cosine `cos` to it.
    #[inline(always)]
    fn split(&self, cos: f32) -> (f32, f32) {
        let f = fresnel(cos, self.eta);
        match self.side {
            Side::Outside | Side::Inside => (f, 1.0 - f),
            Side::Sheet => (2.0 * f / (1.0 + f), (1.0 - f) / (1.0 + f)),
            Side::Pane => (2.0 * f / (1.0 + f), 0.0),
        }
    }

    /// Masking and shadowing over `4 cos_o`, and the density of mirrored directions, for facets of density `d`; `cos_i` of `wi`
    /// is positive.
    #[inline(always)]
    fn facets(&self, wi: Vec3A, d: f32) -> (f32, f32) {
        let ggx = &self.glass.ggx;
        let visible = if self.separable {
            ggx.visibility_cos_separable(self.wo, wi, self.smith)
        } else {
            ggx.visibility_cos(self.wo, wi, self.smith)
        };
        (d * visible * self.scale, Ggx::<false>::pdf(self.wo, d, self.smith))
    }

    /// Chance of drawing what is mirrored where shares `mirrored` and `passed` are.
    #[inline(always)]
    fn chance(mirrored: f32, passed: f32) -> f32 {
        mirrored / (mirrored + passed)
    }

    #[inline(always)]
    fn mirrored(&self, wi: Vec3A, d: f32, cos: f32) -> BsdfEval {
        let (value, pdf) = self.facets(wi, d);
        let (mirrored, passed) = self.split(cos);
        BsdfEval { f_cos: Vec3A::splat(mirrored * value), pdf: Self::chance(mirrored, passed) * pdf }
    }

    /// Light that crosses a facet of density `d` met at cosine `cos` and leaves along `wi`, below the horizon; `spread` is the
    /// solid angle of facets over that of directions.
    #[inline(always)]
    fn passed(&self, wi: Vec3A, d: f32, cos: f32, spread: f32) -> BsdfEval {
        let above = Vec3A::new(wi.x, wi.y, -wi.z);
        let (value, pdf) = self.facets(above, d);
        let (mirrored, passed) = self.split(cos);
        let f_cos = self.glass.color * (passed * value * spread / self.radiance());
        BsdfEval { f_cos, pdf: (1.0 - Self::chance(mirrored, passed)) * pdf * spread }
    }

    /// What radiance is divided by that crosses from the other side.
    #[inline(always)]
    fn radiance(&self) -> f32 {
        if self.side == Side::Sheet { 1.0 } else { self.eta * self.eta }
    }

    /// Value (times cosine) and density for `wi`, on either side.
    #[inline(always)]
    pub fn eval(&self, wi: Vec3A) -> BsdfEval {
        let mirrors = |wi: Vec3A| {
            let h = self.wo + wi;
            let len2 = h.length_squared();
            // Two opposite directions on the horizon have no half vector, and no energy.
            (len2 >= 1e-30).then(|| (self.glass.ggx.distribution(h, len2), 0.5 * len2.sqrt()))
        };
        if wi.z > 0.0 {
            return mirrors(wi).map_or(BsdfEval::default(), |(d, cos)| self.mirrored(wi, d, cos));
        }
        if wi.z == 0.0 || self.side == Side::Pane {
            return BsdfEval::default();
        }
        if self.side == Side::Sheet {
            let above = Vec3A::new(wi.x, wi.y, -wi.z);
            return mirrors(above).map_or(BsdfEval::default(), |(d, cos)| self.passed(wi, d, cos, 1.0));
        }
        let h = self.wo + self.eta * wi;
        let h = if h.z < 0.0 { -h } else { h };
        let len2 = h.length_squared();
        let (along_o, along_i) = (self.wo.dot(h), wi.dot(h));
        // Facets that both directions see from the same side refract nothing.
        if !(along_o > 0.0 && along_i < 0.0 && h.z > 0.0) {
            return BsdfEval::default();
        }
        let length = len2.sqrt();
        let (cos_o, cos_i) = (along_o / length, -along_i / length);
        let d = self.glass.ggx.distribution(h, len2);
        self.passed(wi, d, cos_o, 4.0 * cos_o * cos_i * self.eta * self.eta / len2)
    }

    /// Draws a direction on either side. `None` where the drawn facet sends the light to the wrong side of the surface.
    #[inline(always)]
    pub fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        let (wo, eta) = (self.wo, self.eta);
        let h = self.glass.ggx.visible_normal(wo, u)?;
        let cos = wo.dot(h);
        let (mirrored, passed) = self.split(cos);
        let d = self.glass.ggx.distribution(h, 1.0);
        let mirror = 2.0 * cos * h - wo;
        let (wi, value) = if u_lobe < Self::chance(mirrored, passed) {
            (mirror.z > 0.0).then(|| (mirror, self.mirrored(mirror, d, cos)))?
        } else if self.side == Side::Sheet {
            let wi = Vec3A::new(mirror.x, mirror.y, -mirror.z);
            (wi.z < 0.0).then(|| (wi, self.passed(wi, d, cos, 1.0)))?
        } else {
            let cos_i = (1.0 - (1.0 - cos * cos) / (eta * eta)).max(0.0).sqrt();
            let bend = cos / eta - cos_i;
            let wi = (h * bend - wo / eta).normalize();
            (wi.z < 0.0).then(|| (wi, self.passed(wi, d, cos, 4.0 * cos * cos_i / (bend * bend))))?
        };
        // `<`, not `!(>=)`: a NaN must reach the caller.
        if value.pdf < super::MIN_PDF {
            return None;
        }
        Some(BsdfSample { wi, weight: value.f_cos / value.pdf, pdf: value.pdf })
    }
}

/// Albedo of rough bodies for all light together, mirrored and passed, at the cosines of row `row` of [`Table`] and for number
/// `index` of the indices of refraction. A row is made when it is first asked for, which takes some milliseconds: a scene needs
/// few.
fn albedos(inside: bool, index: usize, row: usize) -> &'static [f32; COSINES] {
    static ROWS: [OnceLock<[f32; COSINES]>; 2 * INDICES * ROUGHNESSES] = [const { OnceLock::new() }; 2 * INDICES * ROUGHNESSES];
    ROWS[(usize::from(inside) * INDICES + index) * ROUGHNESSES + row].get_or_init(|| {
        let (table, x) = (Table::get(), index as f32 / (INDICES - 1) as f32);
        let ior = self::index(MAX_F0 * x * x);
        let glass = Glass { ggx: Ggx::new(alpha(table.roughness(row))), ior, color: Vec3A::ONE, albedo: None };
        table.cosines[row].map(|cos| integrate(&glass, inside, cos))
    })
}

/// The albedo by the midpoint rule over visible normals, as [`super::albedo`] does it.
fn integrate(glass: &Glass, inside: bool, cos: f32) -> f32 {
    let cos = cos.clamp(1e-6, 1.0);
    let wo = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos);
    let eta = if inside { 1.0 / glass.ior } else { glass.ior };
    let mut sum = 0.0_f64;
    for i in 0..STRATA[0] {
        let s = (i as f32 + 0.5) / STRATA[0] as f32;
        for j in 0..STRATA[1] {
            let azimuth = 0.5 * (j as f32 + 0.5) / STRATA[1] as f32;
            let Some(h) = glass.ggx.visible_normal(wo, [1.0 - s * s, azimuth]) else { continue };
            let c = wo.dot(h);
            let f = fresnel(c, eta);
            let mirror = 2.0 * c * h - wo;
            if mirror.z > 0.0 {
                sum += f64::from(2.0 * s * f * glass.ggx.masking_ratio(wo, mirror));
            }
            let cos_i = (1.0 - (1.0 - c * c) / (eta * eta)).max(0.0).sqrt();
            let through = (h * (c / eta - cos_i) - wo / eta).normalize();
            if through.z < 0.0 {
                let above = Vec3A::new(through.x, through.y, -through.z);
                sum += f64::from(2.0 * s * (1.0 - f) * glass.ggx.masking_ratio(wo, above));
            }
        }
    }
    ((sum / (STRATA[0] * STRATA[1]) as f64) as f32).clamp(1e-3, 1.0)
}
