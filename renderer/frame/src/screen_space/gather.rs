//! One bounce of indirect light from what the picture shows: the horizon search, with the colour of what raises the horizon.

use super::Surface;
use super::horizon::{ABOVE, Arc, FADE, RADIUS, THIN};
use glam::{Vec3A, Vec4};
use std::f32::consts::{FRAC_PI_2, PI};

/// Slices a pixel; the pattern and its filter make 16 times as many.
const SLICES: usize = 2;
/// Depth samples on each side of a slice.
const STEPS: usize = 12;

/// Irradiance over pi that pixel `i` receives from the pixels around it, which send out `lit`, and the share of its cosine-weighted hemisphere
/// that they fill: each sample that raises the
/// horizon of its slice covers a sector of the hemisphere with its colour (as Mayaux 2018, "Horizon-based indirect lighting").
pub fn gather(surface: &Surface, lit: &[Vec3A], i: usize, (turn, step): (f32, f32)) -> Vec4 {
    let p = surface.points[i];
    let v = -p.normalize();
    let n = surface.normal(i);
    let n = (n + v * (1e-3 - n.dot(v)).max(0.0)).normalize_or(v);
    let (mut sum, mut weight) = (Vec4::ZERO, 0.0);
    for slice in 0..SLICES {
        let (sin, cos) = ((slice as f32 + turn) * PI / SLICES as f32).sin_cos();
        let across = Vec3A::new(cos, sin, 0.0);
        let Some(t) = (across - v * across.dot(v)).try_normalize() else { continue };
        let axis = t.cross(v);
        let flat = n - axis * n.dot(axis);
        let length = flat.length();
        if length < 1e-4 {
            continue;
        }
        let tilt = flat.dot(t).atan2(flat.dot(v));
        let (sin_n, cos_n) = tilt.sin_cos();
        weight += length * (cos_n + tilt * sin_n);
        for side in [1.0, -1.0] {
            // The horizon's angle from `v`, signed; the area between two of them is what a sample covers.
            let limit = if side > 0.0 { (tilt + FRAC_PI_2).min(PI) } else { (tilt - FRAC_PI_2).max(-PI) };
            let area = |cosine: f32| {
                let h = side * cosine.clamp(-1.0, 1.0).acos();
                Arc::new(if side > 0.0 { h.min(limit) } else { h.max(limit) }, sin_n, cos_n).area
            };
            sum += side_light(surface, lit, (p, n, v), (side * cos, side * sin), step, limit.cos(), area) * length;
        }
    }
    if weight > 1e-6 { (sum / weight).max(Vec4::ZERO) } else { Vec4::ZERO }
}

fn side_light(
    surface: &Surface,
    lit: &[Vec3A],
    (p, n, v): (Vec3A, Vec3A, Vec3A),
    (cos, sin): (f32, f32),
    step: f32,
    lowest: f32,
    area: impl Fn(f32) -> f32,
) -> Vec4 {
    let camera = surface.camera;
    let depth = -p.z;
    let radius = RADIUS * depth;
    let (reach_x, reach_y) = (camera.fl_x * cos * radius / depth, -camera.fl_y * sin * radius / depth);
    let (start_x, start_y) = (camera.cx + camera.fl_x * p.x / depth, camera.cy - camera.fl_y * p.y / depth);
    let pixels = (reach_x * reach_x + reach_y * reach_y).sqrt();
    let mut light = Vec4::ZERO;
    if pixels.is_nan() || pixels < 1.0 {
        return light;
    }
    let (mut highest, mut counted) = (lowest, lowest);
    let mut open = area(lowest);
    for k in 0..STEPS {
        let s = (k as f32 + step) / STEPS as f32;
        let s = 1.0 / pixels + s * s * (1.0 - 1.0 / pixels);
        let Some(under) = surface.pixel(start_x + reach_x * s, start_y + reach_y * s) else { break };
        if !surface.known(under) {
            continue;
        }
        let to = surface.points[under] - p;
        let distance2 = to.length_squared();
        if distance2 < 1e-12 * depth * depth {
            continue;
        }
        let distance = distance2.sqrt();
        let cosine = to.dot(v) / distance;
        if cosine > highest && to.dot(n) > ABOVE * distance {
            let fade = ((radius - distance) / (FADE * radius)).clamp(0.0, 1.0);
            highest += (cosine - highest) * fade;
            if highest > counted {
                let left = area(highest);
                // A surface that turns away shows this side's colour to nobody here.
                if surface.normal(under).dot(to) < 0.0 {
                    light += lit[under].extend(1.0) * (open - left).max(0.0);
                }
                (open, counted) = (left, highest);
            }
        } else {
            highest += (cosine.max(lowest) - highest) * THIN;
        }
    }
    light
}
