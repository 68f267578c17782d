//! Schlick's Fresnel reflectance, and tints. [`renderflow_frame::fresnel`] has Fresnel's equations for dielectrics.

use glam::Vec3A;
use renderflow_frame::fresnel::schlick_weight;

/// Fresnel reflectance `f0 + (f90 - f0) (1 - cos)^5` (Schlick 1994); `cos_d` is the cosine between a direction and the half
/// vector.
#[inline(always)]
pub fn schlick(f0: Vec3A, f90: Vec3A, cos_d: f32) -> Vec3A {
    f0 + (f90 - f0) * schlick_weight(cos_d)
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
