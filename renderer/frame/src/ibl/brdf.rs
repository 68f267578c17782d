//! The environment BRDF, the factor of the prefiltered radiance in the split sum.

use crate::fresnel::{self, Dielectric};
use glam::{DVec4, Vec3A, Vec4};
use std::f32::consts::TAU;
use std::sync::OnceLock;

/// Table points along n.v and along roughness, both from 0 to 1.
const N_DOT_V_STEPS: usize = 64;
const ROUGHNESS_STEPS: usize = 64;
/// Quadrature points along each of the two random numbers of a visible normal.
const QUADRATURE: usize = 24;

/// Shares of uniform light that one reflection off a microfacet surface returns, for any Fresnel reflectance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnvironmentBrdf {
    /// Where the facets reflect everything, 0..=1.
    pub whole: f32,
    /// Where they reflect each of the four functions of [`fresnel::basis`], 0..=`whole`.
    pub parts: Vec4,
}

impl EnvironmentBrdf {
    /// Share that a conductor of reflectance `f0` at normal incidence returns, by Schlick's approximation.
    #[inline]
    pub fn conductor(&self, f0: Vec3A) -> Vec3A {
        f0 * (self.whole - self.parts.x) + self.parts.x
    }

    /// Share that a dielectric returns, within 4e-4 of Fresnel's equations.
    #[inline]
    pub fn dielectric(&self, surface: &Dielectric) -> f32 {
        let rise = self.rise(surface);
        surface.f0() * (self.whole - rise) + rise
    }

    /// Share that facets return which reflect `W` of [`Dielectric::weight`].
    #[inline]
    pub fn rise(&self, surface: &Dielectric) -> f32 {
        self.parts.dot(surface.coefficients()).clamp(0.0, self.whole)
    }

    /// Scale and bias of the split sum for a mixture with the share `metallic` (0..=1) of a conductor: `f0 * scale + bias` with
    /// the `f0` of [`super::f0`] is the same mixture of [`Self::conductor`] and [`Self::dielectric`].
    #[inline]
    pub fn mixture(&self, surface: &Dielectric, metallic: f32) -> [f32; 2] {
        let schlick = self.parts.x;
        // The scale of the conductor serves both: the dielectric's other one goes into its bias.
        let rise = self.rise(surface);
        let bias = rise + surface.f0() * (schlick - rise);
        [self.whole - schlick, bias + (schlick - bias) * metallic]
    }

    fn lerp(&self, other: &Self, t: f32) -> Self {
        Self { whole: self.whole + (other.whole - self.whole) * t, parts: self.parts + (other.parts - self.parts) * t }
    }
}

/// The environment BRDF for n.v and roughness, each 0..=1 (clamped): GGX with alpha = roughness^2, height-correlated Smith
/// masking.
#[inline]
pub fn environment_brdf(n_dot_v: f32, roughness: f32) -> EnvironmentBrdf {
    static TABLE: OnceLock<Vec<EnvironmentBrdf>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        // One thread: a rayon worker that waits here would pick up a row of pixels, ask for the table again and wait for itself.
        (0..N_DOT_V_STEPS * ROUGHNESS_STEPS)
            .map(|i| {
                let (column, row) = (i % N_DOT_V_STEPS, i / N_DOT_V_STEPS);
                integrate(grid_n_dot_v(column as f32), row as f32 / (ROUGHNESS_STEPS - 1) as f32)
            })
            .collect()
    });
    let x = n_dot_v.clamp(0.0, 1.0).sqrt() * (N_DOT_V_STEPS - 1) as f32;
    let y = roughness.clamp(0.0, 1.0) * (ROUGHNESS_STEPS - 1) as f32;
    let (column, row) = ((x as usize).min(N_DOT_V_STEPS - 2), (y as usize).min(ROUGHNESS_STEPS - 2));
    let (s, t) = (x - column as f32, y - row as f32);
    let first = row * N_DOT_V_STEPS + column;
    let along = |i: usize| table[i].lerp(&table[i + 1], s);
    along(first).lerp(&along(first + N_DOT_V_STEPS), t)
}

/// n.v of a table column: squared steps, since all shares change fastest at grazing angles.
fn grid_n_dot_v(column: f32) -> f32 {
    (column / (N_DOT_V_STEPS - 1) as f32).powi(2)
}

/// Mean of G2/G1, alone and times each function of v.h, over normals visible from v (Heitz 2018).
fn integrate(n_dot_v: f32, roughness: f32) -> EnvironmentBrdf {
    let alpha = (roughness * roughness).max(1e-4);
    let nv = n_dot_v.max(1e-4);
    let v = glam::Vec3A::new((1.0 - nv * nv).max(0.0).sqrt(), 0.0, nv);
    // Lambda of Smith's masking for the angle with this cosine.
    let lambda = |cosine: f32| {
        let c2 = cosine * cosine;
        0.5 * ((1.0 + alpha * alpha * (1.0 - c2).max(0.0) / c2).sqrt() - 1.0)
    };
    let lambda_v = lambda(nv);
    // The hemisphere stretched to roughness 1, seen from v.
    let vh = glam::Vec3A::new(alpha * v.x, 0.0, v.z).normalize();
    let across = glam::Vec3A::Y;
    let up = vh.cross(across);
    let (mut whole, mut parts) = (0.0_f64, DVec4::ZERO);
    for i in 0..QUADRATURE {
        // The height q = s^(3/2) of the disc's hemisphere instead of its radius: points gather near the rim, where GGX has its
        // long tail.
        let s = (i as f32 + 0.5) / QUADRATURE as f32;
        let q = s * s.sqrt();
        let radius = (1.0 - q * q).sqrt();
        let measure = f64::from(3.0 * s * s);
        for j in 0..QUADRATURE {
            let (sin, cos) = (TAU * (j as f32 + 0.5) / QUADRATURE as f32).sin_cos();
            let t1 = radius * cos;
            let tilt = 0.5 * (1.0 + vh.z);
            let t2 = (1.0 - tilt) * (1.0 - t1 * t1).max(0.0).sqrt() + tilt * radius * sin;
            let nh = across * t1 + up * t2 + vh * (1.0 - t1 * t1 - t2 * t2).max(0.0).sqrt();
            let h = glam::Vec3A::new(alpha * nh.x, alpha * nh.y, nh.z.max(0.0)).normalize();
            let v_dot_h = v.dot(h).clamp(0.0, 1.0);
            let l_z = 2.0 * v_dot_h * h.z - v.z;
            if l_z > 0.0 {
                let weight = measure * f64::from((1.0 + lambda_v) / (1.0 + lambda_v + lambda(l_z)));
                whole += weight;
                parts += fresnel::basis(v_dot_h).as_dvec4() * weight;
            }
        }
    }
    let norm: f64 = (0..QUADRATURE).map(|i| 3.0 * ((i as f64 + 0.5) / QUADRATURE as f64).powi(2) * QUADRATURE as f64).sum();
    EnvironmentBrdf { whole: (whole / norm) as f32, parts: (parts / norm).as_vec4() }
}
