//! Burley's principled material (2012) in its energy-conserving form.
//!
//! Three lobes, each reciprocal: single-scattering GGX with Schlick's Fresnel; its multiple-scattering compensation (Kulla and
//! Conty 2017); and a Lambertian base under the dielectric coat, which receives what the coat does not reflect (Kelemen and
//! Szirmay-Kalos 2001). With base colour 1 the dielectric and the conductor each reflect exactly what they receive.
//!
//! The base is Lambertian and not Burley's diffuse: that one shapes the loss through the coat by hand (its Fresnel factors),
//! which the coupling above already does from the coat's own albedo, and its retro-reflection adds energy at grazing view.

use super::albedo::{Albedo, Row};
use super::fresnel::{f90, multiple_scattering, schlick};
use super::ggx::{Ggx, alpha};
use super::{BsdfEval, BsdfSample, Surface};
use glam::Vec3A;
use std::f32::consts::FRAC_1_PI;

/// The scattering function of one surface point.
#[derive(Clone, Copy)]
pub struct Bsdf {
    /// Radiance factor of the base, before the coat's losses.
    diffuse: Vec3A,
    /// `None` when nothing reflects specularly: then the material is Lambertian and the GGX code is never reached.
    coat: Option<Coat>,
}

/// The GGX lobe of coat and conductor together, and what it takes from the base.
#[derive(Clone, Copy)]
struct Coat {
    ggx: Ggx,
    row: Row,
    f0: Vec3A,
    f90: f32,
    /// Factor of `(1 - e(wo)) (1 - e(wi))` in the multiple-scattering lobe.
    multiple: Vec3A,
    /// Albedo of the dielectric coat alone is `a e + b b + c`.
    dielectric: [f32; 3],
}

impl Coat {
    /// What the dielectric coat lets through to the base.
    #[inline]
    fn transmitted(&self, albedo: Albedo) -> f32 {
        let [a, b, c] = self.dielectric;
        (1.0 - (a * albedo.e + b * albedo.b + c)).max(0.0)
    }

    /// Base and multiple scattering: the part that is drawn by the cosine. BSDF value without the cosine.
    #[inline]
    fn broad(&self, diffuse: Vec3A, o: Albedo, i: Albedo) -> Vec3A {
        self.multiple * ((1.0 - o.e) * (1.0 - i.e)) + diffuse * (self.transmitted(o) * self.transmitted(i))
    }

    /// Probability of drawing the GGX lobe: its share of the light reflected towards `wo` under a white sky.
    #[inline]
    fn share(&self, diffuse: Vec3A, o: Albedo) -> f32 {
        let single = self.f0 * (o.e - o.b) + Vec3A::splat(self.f90 * o.b);
        let multiple = self.multiple * ((1.0 - o.e) * (1.0 - self.row.mean.e));
        let base = diffuse * (self.transmitted(o) * self.transmitted(self.row.mean));
        let single = single.max_element();
        let broad = (multiple + base).max_element() * std::f32::consts::PI;
        if broad > 0.0 { single / (single + broad) } else { 1.0 }
    }

    /// Single-scattering value (times cosine) and density.
    #[inline]
    fn single(&self, wo: Vec3A, wi: Vec3A) -> (Vec3A, f32) {
        let h = wo + wi;
        let len2 = h.length_squared();
        // Two opposite directions on the horizon: no half vector, and no energy.
        if len2 < 1e-30 {
            return (Vec3A::ZERO, 0.0);
        }
        let d = self.ggx.distribution(h, len2);
        // For unit directions the cosine to the half vector is half the length of their sum.
        let fresnel = schlick(self.f0, self.f90, 0.5 * len2.sqrt());
        (fresnel * (d * self.ggx.visibility_cos(wo.z, wi.z)), self.ggx.pdf(wo.z, d))
    }
}

impl Bsdf {
    /// Prepares the lobes that `surface` has. Parameters beyond their range are taken at its end.
    #[inline]
    pub fn new(surface: &Surface) -> Self {
        let base = surface.base_color.clamp(Vec3A::ZERO, Vec3A::ONE);
        let metallic = surface.metallic.clamp(0.0, 1.0);
        let roughness = surface.roughness.clamp(0.0, 1.0);
        let f0_dielectric = 0.08 * surface.specular.clamp(0.0, 1.0);
        let f90_dielectric = f90(f0_dielectric);
        let diffuse = base * ((1.0 - metallic) * FRAC_1_PI);
        if metallic == 0.0 && f0_dielectric == 0.0 {
            return Self { diffuse, coat: None };
        }

        let row = Row::new(roughness);
        let mean = row.mean;
        let multiple_dielectric = multiple_scattering(f0_dielectric, f90_dielectric, mean.e);
        let multiple_metal = Vec3A::from(base.to_array().map(|f0| multiple_scattering(f0, 1.0, mean.e)));
        let multiple = multiple_metal * metallic + Vec3A::splat(multiple_dielectric * (1.0 - metallic));
        let coat = Coat {
            ggx: Ggx::new(alpha(roughness)),
            row,
            f0: base * metallic + Vec3A::splat(f0_dielectric * (1.0 - metallic)),
            f90: metallic + f90_dielectric * (1.0 - metallic),
            multiple: multiple * (FRAC_1_PI / (1.0 - mean.e).max(1e-6)),
            dielectric: [f0_dielectric - multiple_dielectric, f90_dielectric - f0_dielectric, multiple_dielectric],
        };
        // The coat's mean transmittance normalises the base: what enters leaves again where the base is white.
        let diffuse = diffuse / coat.transmitted(mean).max(1e-6);
        Self { diffuse, coat: Some(coat) }
    }

    /// Value (times cosine) and density for two directions; zero when either lies on or below the shading horizon.
    #[inline]
    pub fn eval(&self, wo: Vec3A, wi: Vec3A) -> BsdfEval {
        if wo.z <= 0.0 || wi.z <= 0.0 {
            return BsdfEval::default();
        }
        let cosine_pdf = wi.z * FRAC_1_PI;
        let Some(coat) = &self.coat else {
            return BsdfEval { f_cos: self.diffuse * wi.z, pdf: cosine_pdf };
        };
        let o = coat.row.at(wo.z);
        let i = coat.row.at(wi.z);
        let share = coat.share(self.diffuse, o);
        let (single, single_pdf) = coat.single(wo, wi);
        BsdfEval { f_cos: single + coat.broad(self.diffuse, o, i) * wi.z, pdf: share * single_pdf + (1.0 - share) * cosine_pdf }
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
            if self.diffuse == Vec3A::ZERO {
                return None;
            }
            let wi = cosine_hemisphere(u);
            // f cos / pdf = (diffuse cos) / (cos / pi)
            let pdf = wi.z * FRAC_1_PI;
            return (pdf > 0.0).then(|| BsdfSample { wi, weight: self.diffuse * std::f32::consts::PI, pdf });
        };
        let o = coat.row.at(wo.z);
        let share = coat.share(self.diffuse, o);
        let wi = if u_lobe < share { coat.ggx.sample(wo, u)? } else { cosine_hemisphere(u) };
        if wi.z <= 0.0 {
            return None;
        }
        let i = coat.row.at(wi.z);
        let (single, single_pdf) = coat.single(wo, wi);
        let pdf = share * single_pdf + (1.0 - share) * (wi.z * FRAC_1_PI);
        let f_cos = single + coat.broad(self.diffuse, o, i) * wi.z;
        let weight = f_cos / pdf;
        (pdf > 0.0 && weight.is_finite()).then_some(BsdfSample { wi, weight, pdf })
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
