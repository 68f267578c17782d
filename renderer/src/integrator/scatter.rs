//! Scattering at a surface point in world space: the BSDF in its shading frame, kept above the true surface.
//!
//! A shading normal that leans away from the geometric one (interpolated, or from a map) makes the BSDF scatter some light below
//! the true surface, where it would pass through. Dropping that part loses energy: a white object under a white sky gets dark
//! seams. Here it is folded back: a direction below the surface stands for its mirror image above it,
//!
//! `f(wi) = f_s(wi) + f_s(wi - 2 (n . wi) n)`, both terms with their own cosine, the second where its direction is above the
//! shading horizon,
//!
//! and the density in the same way. All light that the BSDF reflects leaves the surface for any normals, so a furnace closes.
//! Only directions whose angle from the horizon is below the tilt of the normal are affected. The result is not reciprocal: paths
//! are weighted as seen from the camera.
//!
//! In published mode such directions are dropped, as Mitsuba and others do, so that pictures agree on coarse smooth models too
//! (docs/measurements/renderer-notes.md, small).

use crate::features::{Brdf, BrdfView, Features};
use crate::interaction::Interaction;
use crate::material::{BsdfEval, Mode, Side};
use glam::Vec3A;

/// A direction drawn by [`Scatterer::sample`].
pub(super) struct Scattered {
    /// Unit, world space; above the true surface, or below it where light is let through.
    pub wi: Vec3A,
    /// BSDF times cosine over density.
    pub weight: Vec3A,
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}

/// The BSDF of one surface point seen from one direction.
pub(super) struct Scatterer<'a, F: Features + 'a> {
    frame: ShadingFrame,
    /// Geometric normal on the viewer's side.
    n: Vec3A,
    /// `n . ns`.
    lean: f32,
    mode: Mode,
    side: Side,
    view: <F::Bsdf as Brdf>::View<'a>,
}

impl<'a, F: Features> Scatterer<'a, F> {
    /// For the point `surface`, with its BSDF in form `mode`, seen from the world-space unit direction `wo`.
    #[inline(always)]
    pub fn new(surface: &Interaction, bsdf: &'a F::Bsdf, wo: Vec3A, mode: Mode) -> Self {
        let frame = if F::FULL && surface.tangent != Vec3A::ZERO {
            ShadingFrame::with_tangent(surface.ns, surface.tangent)
        } else {
            ShadingFrame::new(surface.ns)
        };
        Self {
            n: surface.n,
            lean: surface.n.dot(surface.ns),
            mode,
            view: bsdf.view(frame.to_local(wo), surface.side),
            side: surface.side,
            frame,
        }
    }

    /// Whether nothing is reflected towards the viewer from any direction.
    #[inline]
    pub fn is_black(&self) -> bool {
        self.view.is_black()
    }

    /// Value (times cosine) and density for the world-space direction `wi`; zero below the true surface unless that lets light
    /// through.
    #[inline(always)]
    pub fn eval(&self, wi: Vec3A) -> BsdfEval {
        self.eval_seen(&self.view, wi)
    }

    #[inline(always)]
    fn eval_seen(&self, view: &<F::Bsdf as Brdf>::View<'_>, wi: Vec3A) -> BsdfEval {
        let cos = self.n.dot(wi);
        if cos <= 0.0 && !(F::CLEAR && cos < 0.0) {
            return BsdfEval::default();
        }
        let local = self.frame.to_local(wi);
        // What is mirrored above the shading horizon stays above the surface, and what is let through stays below.
        let direct = if F::CLEAR && local.z * cos <= 0.0 { BsdfEval::default() } else { view.eval(local) };
        match self.folded(wi, cos) {
            None => direct,
            Some(mirrored) => {
                let folded = view.eval(mirrored);
                BsdfEval { f_cos: direct.f_cos + folded.f_cos, pdf: direct.pdf + folded.pdf }
            }
        }
    }

    /// Density of drawing `wo`, from where this is seen, if it were seen from `wi`, with its shading normal as it is.
    #[inline(always)]
    pub fn reversed_pdf(&self, bsdf: &F::Bsdf, wo: Vec3A, wi: Vec3A) -> f32 {
        if F::CLEAR && self.n.dot(wi) < 0.0 {
            // From the other side everything is turned over. What is folded is left out: only weights ask.
            return bsdf.view(-self.frame.to_local(wi), self.side.across()).pdf(-self.frame.to_local(wo));
        }
        self.eval_seen(&bsdf.view(self.frame.to_local(wi), self.side), wo).pdf
    }

    /// The mirror image, below the true surface, of a direction above it; `None` where the shading horizon hides it. The same
    /// with both sides exchanged for light that is let through.
    #[inline(always)]
    fn folded(&self, wi: Vec3A, cos: f32) -> Option<Vec3A> {
        if F::FULL && self.mode == Mode::Published {
            return None;
        }
        let cos_shading = self.frame.n.dot(wi) - 2.0 * cos * self.lean;
        let shown = if F::CLEAR { cos_shading * cos > 0.0 } else { cos_shading > 0.0 };
        shown.then(|| self.frame.to_local(wi - self.n * (2.0 * cos)))
    }

    /// Draws a direction. `None` where the sample has no energy.
    #[inline(always)]
    pub fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<Scattered> {
        let drawn = self.view.sample(u_lobe, u)?;
        let wi = self.frame.to_world(drawn.wi);
        let cos = self.n.dot(wi);
        let through = F::CLEAR && drawn.wi.z < 0.0;
        let kept = |cos: f32| if through { cos < 0.0 } else { cos > 0.0 };
        // The estimate is over the directions of the BSDF; folding only moves where they lead.
        let (wi, other) = if kept(cos) {
            (wi, self.folded(wi, cos).map_or(0.0, |mirrored| self.view.pdf(mirrored)))
        } else if F::FULL && self.mode == Mode::Published {
            return None;
        } else {
            let above = (wi - self.n * (2.0 * cos)).normalize();
            (above, if kept(self.frame.n.dot(above)) { self.view.pdf(self.frame.to_local(above)) } else { 0.0 })
        };
        // Exactly along the surface nothing is reached.
        kept(self.n.dot(wi)).then_some(Scattered { wi, weight: drawn.weight, pdf: drawn.pdf + other })
    }
}

/// Orthonormal frame with the shading normal as +z.
#[derive(Clone, Copy)]
struct ShadingFrame {
    t: Vec3A,
    b: Vec3A,
    n: Vec3A,
}

impl ShadingFrame {
    /// Duff et al. 2017, branchless and exact at both poles.
    #[inline(always)]
    fn new(n: Vec3A) -> Self {
        let sign = 1f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let c = n.x * n.y * a;
        Self { t: Vec3A::new(1.0 + sign * n.x * n.x * a, sign * c, -sign * n.x), b: Vec3A::new(c, sign + n.y * n.y * a, -n.y), n }
    }

    /// +x along `tangent` as far as it is perpendicular to `n`.
    #[inline(always)]
    fn with_tangent(n: Vec3A, tangent: Vec3A) -> Self {
        match (tangent - n * n.dot(tangent)).try_normalize() {
            Some(t) => Self { t, b: n.cross(t), n },
            None => Self::new(n),
        }
    }

    #[inline(always)]
    fn to_local(self, v: Vec3A) -> Vec3A {
        Vec3A::new(self.t.dot(v), self.b.dot(v), self.n.dot(v))
    }

    #[inline(always)]
    fn to_world(self, v: Vec3A) -> Vec3A {
        (self.t * v.x + self.b * v.y + self.n * v.z).normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::Compiled;
    use crate::material::{Bsdf, Principled};

    #[test]
    fn shading_frames_are_orthonormal() {
        for i in 0..1000 {
            let t = i as f32 * 0.37;
            let z = (i as f32 / 499.5 - 1.0).clamp(-1.0, 1.0);
            let r = (1.0 - z * z).max(0.0).sqrt();
            let n = Vec3A::new(r * t.cos(), r * t.sin(), z).normalize();
            for frame in [ShadingFrame::new(n), ShadingFrame::with_tangent(n, Vec3A::new(0.3, 0.9, -0.2))] {
                assert!(
                    frame.t.dot(frame.b).abs() < 1e-5 && frame.t.dot(frame.n).abs() < 1e-5 && frame.b.dot(frame.n).abs() < 1e-5
                );
                assert!((frame.t.length() - 1.0).abs() < 1e-5 && frame.t.cross(frame.b).dot(frame.n) > 0.999);
                let v = Vec3A::new(0.3, -0.5, 0.81);
                assert!(frame.to_world(frame.to_local(v)).distance(v.normalize()) < 1e-5);
            }
        }
    }

    /// However the shading normal leans, what the BSDF reflects leaves the surface: the mean weight of samples is the BSDF's
    /// albedo, and the same integral over `eval` agrees, as does the density's.
    #[test]
    fn folding_keeps_the_energy_of_leaning_normals() {
        let wo = Vec3A::new(0.5, 0.2, 0.7).normalize();
        for lean in [0.0f32, 0.3, 0.8, 1.2] {
            let surface = Principled { base_color: Vec3A::splat(0.8), roughness: 0.6, metallic: 0.5, ..Principled::default() };
            let ns = Vec3A::new(lean.sin(), 0.0, lean.cos());
            let upright = Bsdf::<false>::new(&surface, Mode::Conserving);
            let point = Interaction::for_tests(Vec3A::Z, ns, surface);
            let scatterer = Scatterer::<Compiled<false, false, false>>::new(&point, &upright, wo, Mode::Conserving);
            let wo_local = ShadingFrame::new(ns).to_local(wo);
            let n = 64;
            let grid = |i: usize| [(i % n) as f32 + 0.5, (i / n) as f32 + 0.5].map(|v| v / n as f32);
            let (mut drawn, mut bare, mut value, mut density) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
            for i in 0..n * n {
                for lobe in [0.1, 0.3, 0.5, 0.7, 0.9] {
                    drawn += scatterer.sample(lobe, grid(i)).map_or(0.0, |s| f64::from(s.weight.x)) / 5.0;
                    bare += upright.sample(wo_local, lobe, grid(i)).map_or(0.0, |s| f64::from(s.weight.x)) / 5.0;
                }
                let [u, v] = grid(i);
                let (sin, cos) = ((1.0 - u * u).sqrt(), u);
                let (s, c) = (std::f32::consts::TAU * v).sin_cos();
                let eval = scatterer.eval(Vec3A::new(sin * c, sin * s, cos));
                value += std::f64::consts::TAU * f64::from(eval.f_cos.x);
                density += std::f64::consts::TAU * f64::from(eval.pdf);
            }
            let total = (n * n) as f64;
            let [drawn, bare, value, density] = [drawn, bare, value, density].map(|v| v / total);
            assert!((drawn / bare - 1.0).abs() < 1e-3, "lean {lean}: {drawn} of {bare}");
            assert!((value / drawn - 1.0).abs() < 0.01, "lean {lean}: {value} by values, {drawn} by samples");
            assert!(density < 1.01 && density > 0.9, "lean {lean}: {density}");
        }
    }
}
