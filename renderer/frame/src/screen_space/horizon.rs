//! Ambient occlusion and bent normal of one pixel from the horizons of a few slices through the view direction.

use super::Surface;
use glam::Vec3A;
use std::f32::consts::{FRAC_PI_2, PI};

/// Slices a pixel; the pattern and its filter make 16 times as many.
const SLICES: usize = 3;
/// Depth samples on each side of a slice.
const STEPS: usize = 10;
/// Reach of occluders in units of the pixel's depth. The whole environment lights the scene, so large occluders count from afar.
const RADIUS: f32 = 0.5;
/// Share of the radius over which occlusion fades out.
const FADE: f32 = 0.4;
/// How far a horizon falls back (share of the way, per sample) when what lies behind its occluder is seen again:
/// depth tells nothing of thickness, and this lets light pass behind thin things.
const THIN: f32 = 0.1;

/// Visible share of the cosine-weighted hemisphere and the (unnormalised) cosine-weighted mean open direction in camera space.
pub fn occlusion(surface: &Surface, x: usize, y: usize, (turn, step): (f32, f32)) -> (f32, Vec3A) {
    let i = y * surface.width + x;
    let p = surface.point(x, y);
    let depth = -p.z;
    let v = -p.normalize();
    // A filtered normal may face away; the horizons are taken about the nearest one that does not.
    let n = Vec3A::from_array(surface.normal[i]);
    let n = (n + v * (1e-3 - n.dot(v)).max(0.0)).normalize_or(v);
    let radius = RADIUS * depth;

    let (mut open, mut weight, mut bent) = (0.0, 0.0, Vec3A::ZERO);
    for slice in 0..SLICES {
        let (sin, cos) = ((slice as f32 + turn) * PI / SLICES as f32).sin_cos();
        // In the slice's plane: v, and the tangent `t` on the side of (cos, sin).
        let across = Vec3A::new(cos, sin, 0.0);
        let Some(t) = (across - v * across.dot(v)).try_normalize() else { continue };
        let axis = t.cross(v);
        let flat = n - axis * n.dot(axis);
        let length = flat.length();
        if length < 1e-4 {
            continue;
        }
        let tilt = flat.dot(t).atan2(flat.dot(v));
        let right = horizon(surface, p, v, radius, (cos, sin), step, (tilt + FRAC_PI_2).min(PI).cos());
        let left = horizon(surface, p, v, radius, (-cos, -sin), step, (tilt - FRAC_PI_2).max(-PI).cos());
        // Angles from v, left negative, kept inside the normal's hemisphere.
        let h0 = (-left.acos()).max(tilt - FRAC_PI_2);
        let h1 = right.acos().min(tilt + FRAC_PI_2);
        let (sin_n, cos_n) = tilt.sin_cos();
        // Integrals over the open arc of cos(a - n) |sin a| da, times 1, cos a and sin a.
        let arc = |h: f32| 0.25 * (cos_n - (2.0 * h - tilt).cos() + 2.0 * h * sin_n);
        let along_v = |h: f32| (4.0 * cos_n - (3.0 * h - tilt).cos() - 3.0 * (h + tilt).cos()) / 12.0;
        let along_t = |h: f32| (6.0 * (h - tilt).sin() - (3.0 * h - tilt).sin() - 3.0 * (h + tilt).sin() + 8.0 * sin_n) / 12.0;
        open += length * (arc(h0) + arc(h1));
        bent += (v * (along_v(h0) + along_v(h1)) + t * (along_t(h0) + along_t(h1))) * length;
        // A slice's unoccluded value, so that few slices of a tilted normal still give 1 in the open.
        let (free0, free1) = (tilt - FRAC_PI_2, tilt + FRAC_PI_2);
        weight += length * (arc(free0) + arc(free1));
    }
    if weight > 1e-6 { ((open / weight).clamp(0.0, 1.0), bent) } else { (1.0, n) }
}

/// Cosine from `v` of the highest occluder towards (`cos`, `sin`) in the picture (+y up), at least `lowest`.
fn horizon(surface: &Surface, p: Vec3A, v: Vec3A, radius: f32, (cos, sin): (f32, f32), step: f32, lowest: f32) -> f32 {
    let camera = surface.camera;
    let depth = -p.z;
    // The reach in pixels, of a segment parallel to the picture.
    let (reach_x, reach_y) = (camera.fl_x * cos * radius / depth, -camera.fl_y * sin * radius / depth);
    let (start_x, start_y) = (camera.cx + camera.fl_x * p.x / depth, camera.cy - camera.fl_y * p.y / depth);
    let pixels = (reach_x * reach_x + reach_y * reach_y).sqrt();
    if pixels.is_nan() || pixels < 1.0 {
        return lowest;
    }
    let mut highest = lowest;
    for k in 0..STEPS {
        // Denser near the pixel, the first one at least one pixel away.
        let s = (k as f32 + step) / STEPS as f32;
        let s = 1.0 / pixels + s * s * (1.0 - 1.0 / pixels);
        let Some((x, y)) = surface.pixel(start_x + reach_x * s, start_y + reach_y * s) else { break };
        if !surface.depth[y * surface.width + x].is_finite() {
            continue;
        }
        let to = surface.point(x, y) - p;
        let distance2 = to.length_squared();
        if distance2 < 1e-12 * depth * depth {
            continue;
        }
        let distance = distance2.sqrt();
        let cosine = to.dot(v) / distance;
        if cosine > highest {
            let fade = ((radius - distance) / (FADE * radius)).clamp(0.0, 1.0);
            highest += (cosine - highest) * fade;
        } else {
            highest += (cosine.max(lowest) - highest) * THIN;
        }
    }
    highest.clamp(-1.0, 1.0)
}
