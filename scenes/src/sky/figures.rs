//! The family `abstract`: light without a place, for colours and shapes that no sky has.

use super::canvas::{Dome, rgb, smoothstep, toward};
use super::parts::Figure;
use crate::family::family;
use crate::noise;
use crate::seed::Seed;
use glam::{DVec3, Vec3Swizzles};
use rand::RngExt;
use std::f64::consts::{FRAC_PI_2, PI};

family! {
    /// Colours and shapes that no sky has.
    pub struct Abstract {
        /// What it is made of.
        figure: Figure;
        /// Radiances.
        colors: Vec<[f32; 3]> [0, 10000; count 2, 8];
        /// How many shapes: 1 = few.
        scale: f32 [0.3, 10];
        /// Width of transitions.
        softness: f32 [0, 1];
        /// Elevation of the axis, degrees.
        elevation: f32 [-90, 90];
        /// Azimuth of the axis, degrees.
        azimuth: f32 [-3600, 3600];
        /// Where the shapes are.
        seed: u32;
    }
}

/// A square wave of period 2 between -1 and 1 whose flanks take `soft` of it.
fn wave(x: f64, soft: f64) -> f64 {
    let s = (PI * x).sin();
    let flank = (FRAC_PI_2 * soft).sin().max(0.02);
    2.0 * smoothstep(-flank, flank, s) - 1.0
}

/// Colours blended around a ring or along a line at the real index `x`; flanks take the share `soft`.
fn blend(colors: &[DVec3], x: f64, soft: f64) -> DVec3 {
    let n = colors.len();
    let (i, f) = (x.floor(), x - x.floor());
    let at = |k: f64| colors[(k.rem_euclid(n as f64) as usize).min(n - 1)];
    let half = 0.5 * soft.max(0.02);
    at(i)
        .lerp(at(i + 1.0), 0.5 * smoothstep(1.0 - half, 1.0 + half, f))
        .lerp(at(i - 1.0), 0.5 * (1.0 - smoothstep(-half, half, f)))
}

pub(super) fn figure(a: &Abstract) -> Dome {
    let colors: Vec<DVec3> = a.colors.iter().map(|&c| rgb(c)).collect();
    let Some(&first) = colors.first() else {
        return Dome { background: Box::new(|_| DVec3::ZERO), emitters: Vec::new(), points: Vec::new() };
    };
    let axis = toward(a.elevation, a.azimuth);
    let (right, front) = axis.any_orthonormal_pair();
    let (scale, soft, seed) = (f64::from(a.scale), f64::from(a.softness), a.seed);
    let background: super::canvas::Radiance = match a.figure {
        Figure::Gradient => Box::new(move |d| {
            let x = (0.5 - 0.5 * d.dot(axis)) * (colors.len() - 1) as f64;
            let i = (x as usize).min(colors.len().saturating_sub(2));
            let f = x - i as f64;
            let sharp = smoothstep(0.5 - 0.5 * soft.max(0.04), 0.5 + 0.5 * soft.max(0.04), f);
            colors[i].lerp(colors[(i + 1).min(colors.len() - 1)], sharp)
        }),
        Figure::Quadrants => Box::new(move |d| {
            // Four sectors about the axis above, four others below.
            let sector = |shift: f64| {
                let (a, b) = (wave(0.5 + 0.5 * d.dot(right), soft), wave(0.5 + 0.5 * d.dot(front), soft));
                let corner = |k: usize| colors[(k + shift as usize) % colors.len()];
                let (x, y) = (0.5 + 0.5 * a * d.dot(right).signum(), 0.5 + 0.5 * b * d.dot(front).signum());
                corner(0).lerp(corner(1), x).lerp(corner(3).lerp(corner(2), x), y)
            };
            let up = smoothstep(-0.3 * soft.max(0.03), 0.3 * soft.max(0.03), d.dot(axis));
            sector(2.0 + f64::from(seed % 3)).lerp(sector(0.0), up)
        }),
        Figure::Checker => Box::new(move |d| {
            let s = 1.1 * scale;
            let cell = wave(d.dot(right) * s, soft) * wave(d.dot(front) * s, soft) * wave(d.dot(axis) * s + 0.5, soft);
            let pair = if colors.len() > 3 && d.dot(axis) < 0.0 { 2 } else { 0 };
            colors[pair].lerp(colors[(pair + 1) % colors.len()], 0.5 + 0.5 * cell)
        }),
        Figure::Blobs | Figure::Spots => {
            let mut rng = Seed::root(u64::from(seed)).child("blobs", 0).rng();
            let count = (4.0 * scale).round().clamp(2.0, 40.0) as usize;
            let blobs: Vec<(DVec3, f64, DVec3)> = (0..count)
                .map(|k| {
                    let y = rng.random_range(-0.75..1.0f64);
                    let turn = std::f64::consts::TAU * rng.random::<f64>();
                    let d = DVec3::new(turn.sin(), 0.0, turn.cos()) * (1.0 - y * y).sqrt();
                    let width = rng.random_range(0.12..0.55f64) / scale.sqrt().max(0.6);
                    let color = if colors.len() > 1 { colors[1 + k % (colors.len() - 1)] } else { first };
                    (d.with_y(y), width, color)
                })
                .collect();
            let sharp = matches!(a.figure, Figure::Spots);
            Box::new(move |d| {
                blobs.iter().fold(first, |sum, &(axis, width, color)| {
                    let off = (d - axis).length() / width;
                    if sharp {
                        sum.lerp(color, 1.0 - smoothstep(1.0 - 0.5 * soft.max(0.05), 1.0, off))
                    } else if off < 4.0 {
                        sum + color * (-off * off).exp()
                    } else {
                        sum
                    }
                })
            })
        }
        Figure::Bands => Box::new(move |d| {
            let x = d.dot(axis).clamp(-1.0, 1.0).acos() / FRAC_PI_2 * 1.7 * scale + 0.5;
            blend(&colors, x, soft)
        }),
        Figure::Marble => Box::new(move |d| {
            let bend = noise::fractal(d * (1.2 * scale), 4, seed);
            let more = noise::fractal(d.yzx() * (0.9 * scale) + DVec3::splat(bend), 3, seed ^ 77);
            blend(&colors, 0.5 * colors.len() as f64 * (1.0 + 2.2 * bend + 1.6 * more) + d.dot(axis), 0.3 + 1.7 * soft)
        }),
    };
    Dome { background, emitters: Vec::new(), points: Vec::new() }
}
