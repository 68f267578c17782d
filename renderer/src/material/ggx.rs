//! GGX microfacets: distribution, height-correlated Smith masking, visible-normal sampling; isotropic and anisotropic.
//!
//! Written so that no intermediate overflows or cancels for any width in [`MIN_ALPHA`]`..=1` and any pair of directions above
//! the horizon, however grazing.

use crate::angle::sin_cos_turns;
use glam::Vec3A;

/// Smallest GGX width. A smoother surface reflects within 0.12 degrees, a third of a texel of a 1k environment map: below this
/// the picture no longer changes, and `f32` half vectors stay 1e4 times finer than the lobe.
pub const MIN_ALPHA: f32 = 1e-3;

/// GGX width of a perceptual roughness 0..=1.
#[inline(always)]
pub fn alpha(roughness: f32) -> f32 {
    (roughness * roughness).max(MIN_ALPHA)
}

/// GGX widths along tangent and bitangent: `roughness^2` divided and multiplied by the aspect `sqrt(1 - 0.9 anisotropic)`
/// (Burley 2012, section 5.4).
#[inline(always)]
pub fn alpha_xy(roughness: f32, anisotropic: f32) -> [f32; 2] {
    let aspect = (1.0 - 0.9 * anisotropic).sqrt();
    let alpha = roughness * roughness;
    // The wider side reaches 3.16 at roughness 1: every formula below holds for widths beyond 1 too.
    [(alpha / aspect).max(MIN_ALPHA), (alpha * aspect).max(MIN_ALPHA)]
}

/// A GGX surface. With `ANISOTROPIC = false` the compiled code knows one width.
#[derive(Clone, Copy, Debug)]
pub struct Ggx<const ANISOTROPIC: bool> {
    alpha: [f32; 2],
    alpha2: [f32; 2],
}

impl Ggx<false> {
    /// `alpha` >= [`MIN_ALPHA`].
    #[inline(always)]
    pub fn new(alpha: f32) -> Self {
        Self { alpha: [alpha; 2], alpha2: [alpha * alpha; 2] }
    }
}

impl<const ANISOTROPIC: bool> Ggx<ANISOTROPIC> {
    /// Widths along tangent (+x) and bitangent (+y), each >= [`MIN_ALPHA`]; an isotropic surface takes the first.
    #[inline(always)]
    pub fn with_widths(alpha: [f32; 2]) -> Self {
        Self { alpha, alpha2: alpha.map(|a| a * a) }
    }

    #[inline(always)]
    fn width(&self, axis: usize) -> f32 {
        self.alpha[if ANISOTROPIC { axis } else { 0 }]
    }

    /// Normal distribution (Walter et al. 2007; Burley 2012 for two widths) for the direction of `h`, which need not be unit but
    /// has `h.z > 0`; `len2 = |h|^2`.
    #[inline(always)]
    pub fn distribution(&self, h: Vec3A, len2: f32) -> f32 {
        // sin^2 from x and y: 1 - cos^2 would lose the whole lobe to rounding for small alpha.
        let slope2 = if ANISOTROPIC {
            h.x * h.x / self.alpha2[0] + h.y * h.y / self.alpha2[1]
        } else {
            (h.x * h.x + h.y * h.y) / self.alpha2[0]
        };
        let t = (slope2 + h.z * h.z) / len2;
        std::f32::consts::FRAC_1_PI / (self.width(0) * self.width(1) * t * t)
    }

    /// `sqrt(ax^2 x^2 + ay^2 y^2 + z^2)` of a unit direction: the common term of Smith's masking.
    #[inline(always)]
    pub fn smith(&self, w: Vec3A) -> f32 {
        if ANISOTROPIC {
            (self.alpha2[0] * w.x * w.x + self.alpha2[1] * w.y * w.y + w.z * w.z).sqrt()
        } else {
            (self.alpha2[0] + (1.0 - self.alpha2[0]) * w.z * w.z).sqrt()
        }
    }

    /// `G2(wo, wi) / (4 cos_o cos_i) * cos_i` with height-correlated masking (Heitz 2014), given `smith` of `wo`. Bounded by
    /// `1 / (2 alpha)`.
    #[inline(always)]
    pub fn visibility_cos(&self, wo: Vec3A, wi: Vec3A, smith: f32) -> f32 {
        let denominator = wo.z * self.smith(wi) + wi.z * smith;
        // Both terms underflow for cosines below 1e-38; the tiny addend turns 0 / 0 into 0.
        0.5 * wi.z / (denominator + f32::MIN_POSITIVE)
    }

    /// `G1(wo) G1(wi) / (4 cos_o cos_i) * cos_i` with masking and shadowing taken as independent, as Burley printed it,
    /// given `smith` of `wo`.
    #[inline(always)]
    pub fn visibility_cos_separable(&self, wo: Vec3A, wi: Vec3A, smith: f32) -> f32 {
        wi.z / ((wo.z + smith) * (wi.z + self.smith(wi)))
    }

    /// Ratio of the lobe's two widths; 1 for isotropic and for smooth lobes.
    pub(super) fn stretch(&self) -> f32 {
        if ANISOTROPIC { ((1.0 + self.alpha2[1]) / (1.0 + self.alpha2[0])).sqrt() } else { 1.0 }
    }

    /// `G2(wo, wi) / G1(wo)`: what a visible-normal sample of a perfect mirror weighs.
    #[inline(always)]
    pub fn masking_ratio(&self, wo: Vec3A, wi: Vec3A) -> f32 {
        let smith = self.smith(wo);
        2.0 * self.visibility_cos(wo, wi, smith) * (wo.z + smith)
    }

    /// Density of [`Self::sample`]: `G1(wo) D(h) / (4 cos_o)`, given `d = D(h)` and `smith` of `wo`.
    #[inline(always)]
    pub fn pdf(wo: Vec3A, d: f32, smith: f32) -> f32 {
        0.5 * d / (wo.z + smith)
    }

    /// Mirrors `wo` (above the horizon) in a visible normal: spherical caps (Dupuy and Benyoub 2023). The result may lie below
    /// the horizon, where a single reflection carries nothing. `None` on the measure-zero failure of the construction.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3A, u: [f32; 2]) -> Option<Vec3A> {
        let h = self.visible_normal(wo, u)?;
        Some(2.0 * wo.dot(h) * h - wo)
    }

    /// The visible normal that [`Self::sample`] mirrors in, of density `4 (wo . h)` times the density of [`Self::sample`].
    #[inline(always)]
    pub fn visible_normal(&self, wo: Vec3A, u: [f32; 2]) -> Option<Vec3A> {
        let caps = self.caps(wo);
        let Caps { stretched, .. } = caps;
        let (z, r) = caps.ring(u[0]);
        let (sin, cos) = sin_cos_turns(u[1]);
        let h = Vec3A::new(r * cos, r * sin, z) + stretched;
        let h = Vec3A::new(self.width(0) * h.x, self.width(1) * h.y, h.z.max(0.0));
        h.try_normalize()
    }

    /// The caps that [`Self::sample`] draws from for one view.
    #[inline(always)]
    pub(super) fn caps(&self, wo: Vec3A) -> Caps {
        Caps { stretched: Vec3A::new(self.width(0) * wo.x, self.width(1) * wo.y, wo.z).normalize() }
    }

    /// What [`Self::sample`] draws, by its components, from the ring and the azimuth of its numbers. It is below the horizon or
    /// NaN where that is `None`. There are no branches in it, for loops over many azimuths.
    #[inline(always)]
    pub(super) fn mirrored(&self, wo: Vec3A, caps: &Caps, (z, r): (f32, f32), (sin, cos): (f32, f32)) -> [f32; 3] {
        let x = self.width(0) * (r * cos + caps.stretched.x);
        let y = self.width(1) * (r * sin + caps.stretched.y);
        let z = (z + caps.stretched.z).max(0.0);
        let inverse = (x * x + y * y + z * z).sqrt().recip();
        let (x, y, z) = (x * inverse, y * inverse, z * inverse);
        let twice = 2.0 * (wo.x * x + wo.y * y + wo.z * z);
        [twice * x - wo.x, twice * y - wo.y, twice * z - wo.z]
    }
}

/// The directions that half vectors mirror one view into, in the space where the surface is as rough as a sphere.
#[derive(Clone, Copy)]
pub(super) struct Caps {
    /// The view in that space, unit.
    stretched: Vec3A,
}

impl Caps {
    /// Height and radius of the ring of directions that the random number `u` stands for.
    #[inline(always)]
    pub fn ring(&self, u: f32) -> (f32, f32) {
        let z = (1.0 - u) * (1.0 + self.stretched.z) - self.stretched.z;
        (z, (1.0 - z * z).max(0.0).sqrt())
    }
}
