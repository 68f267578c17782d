//! One bounce of indirect light from what the picture shows: the horizon search, with the colour of what raises the horizon.

use super::Surface;
use super::horizon::{RADIUS, Sector, Slice, THIN, Walk, slices};
use glam::{Vec3A, Vec4};
use std::f32::consts::{FRAC_PI_2, PI};

/// Number of slices per pixel; the pattern's filter combines the slices of 16 pixels.
const SLICES: usize = 2;

/// Irradiance over pi that pixel `i` receives from the pixels around it, whose radiance is `lit`, and the share of its
/// cosine-weighted hemisphere that they fill. Each sample that raises the horizon of its slice covers a sector of the hemisphere
/// with its colour (as in Mayaux 2018, "Horizon-based indirect lighting").
pub fn gather(surface: &Surface, lit: &[Vec3A], i: usize, (turn, step): (f32, f32)) -> Vec4 {
    let p = surface.points[i];
    let v = -p.normalize();
    let n = surface.normal(i);
    let n = (n + v * (1e-3 - n.dot(v)).max(0.0)).normalize_or(v);
    let (mut sum, mut weight) = (Vec4::ZERO, 0.0);
    for Slice { towards: (cos, sin), tilt, length, .. } in slices(n, v, turn, SLICES) {
        let (sin_n, cos_n) = tilt.sin_cos();
        weight += length * (cos_n + tilt * sin_n);
        for side in [1.0, -1.0] {
            // The signed angle of the horizon from `v`; a sample covers the area between two horizons.
            let limit = if side > 0.0 { (tilt + FRAC_PI_2).min(PI) } else { (tilt - FRAC_PI_2).max(-PI) };
            let area = |cosine: f32| {
                let h = side * cosine.clamp(-1.0, 1.0).acos();
                Sector::new(if side > 0.0 { h.min(limit) } else { h.max(limit) }, sin_n, cos_n).area
            };
            let radius = RADIUS * -p.z;
            let towards = (side * cos, side * sin);
            let lowest = limit.cos();
            let (mut open, mut counted) = (area(lowest), lowest);
            Walk { p, n, v, radius, thin: THIN, towards, step, lowest }.highest(surface, |under, to, highest| {
                if highest > counted {
                    let left = area(highest);
                    // A surface that faces away does not send its visible colour here.
                    if surface.normal(under).dot(to) < 0.0 {
                        sum += lit[under].extend(1.0) * ((open - left).max(0.0) * length);
                    }
                    (open, counted) = (left, highest);
                }
            });
        }
    }
    if weight > 1e-6 { (sum / weight).max(Vec4::ZERO) } else { Vec4::ZERO }
}
