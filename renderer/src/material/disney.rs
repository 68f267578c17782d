//! Burley's principled material (2012): one interface over its two forms.

use super::clear::ClearBsdf;
use super::conserving::{Conserving, Outgoing};
use super::published::Published;
use super::{BsdfEval, BsdfSample, MIN_PDF, Mode, Principled};
use crate::angle::sin_cos_eighth;
use glam::Vec3A;
use std::f32::consts::FRAC_PI_4;

/// Probabilities of drawing each lobe; they sum to 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lobes {
    pub ggx: f32,
    pub clearcoat: f32,
    /// Cosine-weighted: diffuse and sheen.
    pub cosine: f32,
}

impl Lobes {
    /// From the light each lobe reflects. All go to the cosine when none reflects any.
    #[inline(always)]
    pub fn new(ggx: f32, clearcoat: f32, cosine: f32) -> Self {
        let sum = ggx + clearcoat + cosine;
        if sum == 0.0 {
            return Self { ggx: 0.0, clearcoat: 0.0, cosine: 1.0 };
        }
        Self { ggx: ggx / sum, clearcoat: clearcoat / sum, cosine: cosine / sum }
    }
}

/// The scattering function of one surface point, in its local frame: shading normal +z, tangent of anisotropic lobes +x.
///
/// With `FULL = false` the compiled code knows base colour, metallic, roughness and specular of [`Mode::Conserving`] alone and
/// ignores everything else; it is for scenes whose materials have no more ([`Principled::is_plain`]), and gives the values of
/// `FULL = true` there. With `FULL = true` lobes that a material lacks are skipped by a branch.
#[derive(Clone, Copy)]
pub struct Bsdf<const FULL: bool>(Form<FULL>);

#[derive(Clone, Copy)]
#[allow(clippy::large_enum_variant)] // It lives on the stack of one path vertex.
enum Form<const FULL: bool> {
    Conserving(Conserving<FULL>),
    Published(Published),
}

impl<const FULL: bool> Bsdf<FULL> {
    /// Prepares the lobes that `surface` has. Parameters beyond their range are taken at its end; NaN stays NaN and shows in the
    /// values. Where `FULL = false`, `mode` is ignored and taken as [`Mode::Conserving`].
    #[inline(always)]
    pub fn new(surface: &Principled, mode: Mode) -> Self {
        let surface = if FULL { surface.clamped() } else { surface.clamped_plain() };
        Self(match mode {
            Mode::Published if FULL => Form::Published(Published::new(&surface)),
            _ => Form::Conserving(Conserving::new(&surface)),
        })
    }

    /// Prepares what depends on `wo` alone, for several calls with one view: a path vertex weighs its light and draws its next
    /// direction from one. Nothing is reflected towards a `wo` on or below the shading horizon.
    #[inline(always)]
    pub fn view(&self, wo: Vec3A) -> View<'_, FULL> {
        let seen = match &self.0 {
            _ if wo.z <= 0.0 => Seen::Nothing,
            Form::Published(form) if FULL => Seen::Published(form, form.lobes(wo)),
            Form::Published(_) => Seen::Nothing,
            Form::Conserving(form) if form.is_black() => Seen::Nothing,
            Form::Conserving(form) => Seen::Conserving(form, form.outgoing(wo)),
        };
        View { wo, seen }
    }

    /// [`View::eval`] for one view.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> BsdfEval {
        self.view(wo).eval(wi)
    }

    /// [`View::pdf`] for one view.
    #[inline(always)]
    pub fn pdf(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        self.view(wo).pdf(wi)
    }

    /// [`View::sample`] for one view.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3A, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        self.view(wo).sample(u_lobe, u)
    }
}

/// All forms of the conserving BSDF of a material without textures. They are made once, so that a vertex prepares only its view.
#[derive(Clone, Copy)]
pub struct Prepared {
    pub(crate) plain: Bsdf<false>,
    pub(crate) full: Bsdf<true>,
    pub(crate) clear: ClearBsdf,
}

impl Prepared {
    /// For a surface that is the same everywhere.
    pub fn new(surface: &Principled) -> Self {
        let mode = Mode::Conserving;
        Self { plain: Bsdf::new(surface, mode), full: Bsdf::new(surface, mode), clear: ClearBsdf::new(surface, mode) }
    }
}

/// A [`Bsdf`] seen from one direction; see [`Bsdf::view`].
#[derive(Clone, Copy)]
pub struct View<'a, const FULL: bool> {
    wo: Vec3A,
    seen: Seen<'a, FULL>,
}

#[derive(Clone, Copy)]
#[allow(clippy::large_enum_variant)] // As above.
enum Seen<'a, const FULL: bool> {
    /// The material is black, or seen from below.
    Nothing,
    Conserving(&'a Conserving<FULL>, Outgoing),
    Published(&'a Published, Lobes),
}

impl<const FULL: bool> View<'_, FULL> {
    /// Whether nothing is reflected from any direction: the material has no lobe, or is seen from below.
    #[inline(always)]
    pub fn is_black(&self) -> bool {
        matches!(self.seen, Seen::Nothing)
    }

    /// Value (times cosine) and density for `wi`; zero when it lies on or below the shading horizon.
    #[inline(always)]
    pub fn eval(&self, wi: Vec3A) -> BsdfEval {
        if wi.z <= 0.0 {
            return BsdfEval::default();
        }
        match &self.seen {
            Seen::Published(form, lobes) if FULL => form.eval(lobes, self.wo, wi),
            Seen::Conserving(form, outgoing) => form.eval(outgoing, self.wo, wi),
            _ => BsdfEval::default(),
        }
    }

    /// Density of [`Self::sample`], per steradian.
    #[inline(always)]
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        self.eval(wi).pdf
    }

    /// Draws a direction; `u_lobe` and `u` are in 0..1. `None` when the drawn facet mirrors `wo` below the shading horizon, when
    /// nothing is reflected, or when the density is below 1e-30 per steradian (such draws do not happen in practice): the
    /// estimate is then zero. A weight that is not finite is handed on to be counted.
    #[inline(always)]
    pub fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        let wo = self.wo;
        let wi = match &self.seen {
            Seen::Published(form, lobes) if FULL => {
                if u_lobe < lobes.ggx {
                    form.ggx().sample(wo, u)?
                } else if let Some(lobe) = form.clearcoat()
                    && u_lobe < lobes.ggx + lobes.clearcoat
                {
                    lobe.sample(wo, u)
                } else {
                    cosine_hemisphere(u)
                }
            }
            Seen::Conserving(form, Outgoing { lobes, .. }) => {
                if let Some(ggx) = form.ggx()
                    && u_lobe < lobes.ggx
                {
                    ggx.sample(wo, u)?
                } else if FULL
                    && let Some(lobe) = form.clearcoat()
                    && u_lobe < lobes.ggx + lobes.clearcoat
                {
                    lobe.sample(wo, u)
                } else {
                    cosine_hemisphere(u)
                }
            }
            _ => return None,
        };
        if wi.z <= 0.0 {
            return None;
        }
        let value = self.eval(wi);
        // `<`, not `!(>=)`: a NaN must reach the caller.
        if value.pdf < MIN_PDF {
            return None;
        }
        Some(BsdfSample { wi, weight: value.f_cos / value.pdf, pdf: value.pdf })
    }

    /// Shares of `u_lobe` that draw from the GGX lobe, the clearcoat and the cosine-weighted lobe, in this order; all 0 where
    /// nothing is reflected.
    pub fn shares(&self) -> [f32; 3] {
        match &self.seen {
            Seen::Nothing => [0.0; 3],
            Seen::Conserving(_, Outgoing { lobes, .. }) | Seen::Published(_, lobes) => [lobes.ggx, lobes.clearcoat, lobes.cosine],
        }
    }
}

/// Cosine-weighted direction about +z: Shirley and Chiu's concentric disk, lifted.
#[inline(always)]
fn cosine_hemisphere(u: [f32; 2]) -> Vec3A {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    // Which half of the square it is cannot be foreseen, and the compiler makes a branch of a choice.
    let exchange = u32::from(a.abs() > b.abs()).wrapping_sub(1);
    let exchanged = |a: f32, b: f32| {
        let difference = (a.to_bits() ^ b.to_bits()) & exchange;
        (f32::from_bits(a.to_bits() ^ difference), f32::from_bits(b.to_bits() ^ difference))
    };
    let (r, other) = exchanged(a, b);
    let (sin, cos) = sin_cos_eighth(FRAC_PI_4 * (other / if r == 0.0 { 1.0 } else { r }));
    let (x, y) = exchanged(r * cos, r * sin);
    Vec3A::new(x, y, (1.0 - r * r).max(0.0).sqrt())
}
