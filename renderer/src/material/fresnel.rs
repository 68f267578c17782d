//! Schlick's Fresnel reflectance.

use glam::Vec3A;

/// Schlick's weight `(1 - cos)^5` for `cos_d` in 0..=1.
#[inline(always)]
pub(super) fn schlick_weight(cos_d: f32) -> f32 {
    let m = (1.0 - cos_d).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// Fresnel reflectance `f0 + (f90 - f0) (1 - cos)^5` (Schlick 1994); `cos_d` is the cosine between a direction and the half vector.
#[inline(always)]
pub fn schlick(f0: Vec3A, f90: Vec3A, cos_d: f32) -> Vec3A {
    f0 + (f90 - f0) * schlick_weight(cos_d)
}

/// Reflectance of a dielectric at grazing incidence: 1 for every ordinary dielectric, fading to 0 below `f0` = 0.02.
///
/// Schlick's formula reflects everything at grazing incidence even where `f0 = 0`, that is where the coat has the refractive
/// index of air and cannot reflect at all. No solid has an `f0` below 0.02, so the fade only makes `specular = 0` mean
/// "no specular lobe", which then also costs nothing (Lagarde and de Rousiers 2014, section 3.1.2, use the same threshold).
#[inline(always)]
pub fn f90(f0: f32) -> f32 {
    (50.0 * f0).min(1.0)
}

/// Rec.709 luminance. Burley's `.3 .6 .1` belong to the monitor space he decodes his colours from; ours are linear Rec.709.
#[inline(always)]
pub(super) fn luminance(color: Vec3A) -> f32 {
    color.dot(Vec3A::new(0.2126, 0.7152, 0.0722))
}

/// Hue and saturation of a colour: divided by its luminance; white for black (Burley 2012, `Ctint`).
#[inline(always)]
pub(super) fn tint(color: Vec3A) -> Vec3A {
    let l = luminance(color);
    if l > 0.0 { color / l } else { Vec3A::ONE }
}
