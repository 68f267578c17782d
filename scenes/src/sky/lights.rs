//! Groups of lamps and stars.

use super::canvas::{Emitter, Point, disc, flat_by, luminance, rgb, toward};
use super::horizon::heading;
use super::parts::{Layout, LightGroup, Palette, Stars};
use crate::seed::Seed;
use glam::DVec3;
use rand::RngExt;
use rand_pcg::Pcg64;
use std::f64::consts::{PI, TAU};

/// One lamp before it is dimmed to the group's total: direction, angular radius in radians, colour of its energy.
struct Lit {
    axis: DVec3,
    radius: f64,
    energy: DVec3,
    /// Height over width of a panel; `None` = round.
    panel: Option<f64>,
}

fn color(palette: Palette, rng: &mut Pcg64) -> DVec3 {
    const SODIUM: [f32; 3] = [1.0, 0.45, 0.08];
    const WARM: [f32; 3] = [1.0, 0.7, 0.4];
    const WHITE: [f32; 3] = [1.0, 0.92, 0.82];
    const COOL: [f32; 3] = [0.72, 0.87, 1.0];
    let choices: &[[f32; 3]] = match palette {
        Palette::Sodium => &[SODIUM, [1.0, 0.55, 0.16]],
        Palette::Warm => &[WARM, [1.0, 0.78, 0.52]],
        Palette::Cool => &[COOL, [0.85, 0.94, 1.0]],
        Palette::Neon => {
            &[[1.0, 0.1, 0.07], [0.1, 0.85, 1.0], [1.0, 0.12, 0.8], [0.25, 1.0, 0.3], [1.0, 0.75, 0.1], [0.3, 0.2, 1.0], WHITE]
        }
        Palette::Mixed => &[SODIUM, WARM, WHITE, COOL],
        Palette::Flame => &[[1.0, 0.42, 0.1], [1.0, 0.5, 0.16], [1.0, 0.33, 0.05]],
        Palette::Bulbs => &[[1.0, 0.15, 0.1], [1.0, 0.7, 0.2], [0.2, 0.9, 0.25], [0.2, 0.35, 1.0], WARM],
    };
    let base = rgb(choices[rng.random_range(0..choices.len())]);
    base * rng.random_range(0.85..1.15f64) / luminance(base)
}

/// The lamps of `group`; together they bring its luminance whatever the draw.
pub(super) fn lamps(group: &LightGroup) -> Vec<Emitter> {
    let mut rng = Seed::root(u64::from(group.seed)).child("lamps", 0).rng();
    let radius = f64::from(group.radius).to_radians();
    let count = group.count as usize;
    let mut lit = Vec::with_capacity(count);
    for k in 0..count {
        let tone = color(group.palette, &mut rng);
        let (a, b, c): (f64, f64, f64) = (rng.random(), rng.random(), rng.random());
        lit.push(match group.layout {
            Layout::Scattered => {
                // Most stand low; a few do most of the work.
                let elevation = (f64::from(group.elevation) * 3.0 * a * a + 1.0).min(85.0);
                let axis = toward(elevation as f32, (360.0 * b) as f32);
                Lit { axis, radius: radius * (0.5 + c), energy: tone * (c.powi(3) + 0.05), panel: None }
            }
            Layout::Street => street(group, k, radius, tone, [a, b]),
            Layout::Strings => {
                // Lines of bulbs that sag between posts, at the given elevation overhead.
                let lines = (count / 12).clamp(1, 5);
                let (line, place) = (k % lines, (k / lines) as f64 / (count / lines).max(1) as f64);
                let height = f64::from(group.elevation).to_radians().tan().max(0.1);
                let along = heading(f64::from(group.azimuth) / 360.0);
                let side = (line as f64 - 0.5 * (lines as f64 - 1.0)) * 1.1 + 0.2;
                let sag = 0.35 * height * (1.0 - (2.0 * place - 1.0).powi(2));
                let p = along * (5.0 * (place - 0.5)) + DVec3::new(-along.z, 0.0, along.x) * side + DVec3::Y * (height - sag);
                let near = 1.0 / p.length_squared().max(0.1);
                Lit { axis: p.normalize_or(DVec3::Y), radius: radius * near.sqrt().min(2.0), energy: tone * near, panel: None }
            }
            Layout::Signs => {
                let elevation = f64::from(group.elevation) * (0.2 + 1.6 * a);
                let axis = toward(elevation as f32, (360.0 * b) as f32);
                let size = radius * (0.6 + 1.4 * c);
                Lit { axis, radius: size, energy: tone * size * size, panel: Some(0.3 + 2.4 * a) }
            }
            Layout::Fire => {
                // Flames flicker about one place; the low ones are wide and bright.
                let spread = f64::from(group.radius) * 1.6;
                let axis = toward(
                    (f64::from(group.elevation) + spread * (1.5 * a - 0.4)) as f32,
                    (f64::from(group.azimuth) + spread * 1.6 * (b - 0.5)) as f32,
                );
                Lit { axis, radius: radius * (1.1 - 0.7 * a), energy: tone * (1.3 - a), panel: None }
            }
        });
    }
    let total: f64 = lit.iter().map(|lamp| luminance(lamp.energy)).sum();
    let scale = if total > 0.0 { 4.0 * PI * f64::from(group.luminance) / total } else { 0.0 };
    lit.into_iter().filter(|_| scale > 0.0).map(|lamp| emitter(&lamp, scale)).collect()
}

/// Lamp `k` of two rows of posts along the street, as high as the elevation says where they are nearest.
fn street(group: &LightGroup, k: usize, radius: f64, tone: DVec3, [a, b]: [f64; 2]) -> Lit {
    let along = heading(f64::from(group.azimuth) / 360.0);
    let across = DVec3::new(-along.z, 0.0, along.x);
    let side = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
    let pairs = (group.count as usize).div_ceil(2) as f64;
    let place = ((k / 2) as f64 - 0.4 * pairs) * 3.2 + 0.3 * (a - 0.5);
    let height = f64::from(group.elevation).to_radians().tan().max(0.05);
    let p = across * (side * (1.0 + 0.1 * b)) + along * place + DVec3::Y * height;
    let near = 1.0 / p.length_squared();
    Lit { axis: p.normalize_or(DVec3::Y), radius: (radius * near.sqrt()).max(0.002), energy: tone * near, panel: None }
}

fn emitter(lamp: &Lit, scale: f64) -> Emitter {
    let energy = lamp.energy * scale;
    match lamp.panel {
        None => {
            let radiance = energy / (TAU * (1.0 - lamp.radius.cos()));
            disc(lamp.axis, lamp.radius, move |_| radiance)
        }
        Some(aspect) => {
            let right = DVec3::Y.cross(lamp.axis).normalize_or(DVec3::X);
            let (half_u, half_v) = (right * lamp.radius.tan(), lamp.axis.cross(right) * (lamp.radius.tan() * aspect));
            // A tube along the rim and a weaker face.
            let profile = |a: f64, b: f64| if a.abs().max(b.abs()) > 0.72 { 1.0 } else { 0.45 };
            let mut emitter = flat_by(24, lamp.axis, half_u, half_v, move |a, b| energy * profile(a, b));
            let factor = luminance(energy) / luminance(emitter.energy).max(1e-12);
            emitter.energy *= factor;
            emitter
        }
    }
}

/// Stars above the horizon as points; together with those below it they bring the group's luminance.
pub(super) fn stars(stars: &Stars) -> Vec<Point> {
    let mut rng = Seed::root(u64::from(stars.seed)).child("stars", 0).rng();
    let mut points: Vec<Point> = (0..stars.count)
        .map(|_| {
            // The poles' texels are too small for a star.
            let y = rng.random_range(-0.99..0.99f64);
            let (d, warm) = (heading(rng.random::<f64>()) * (1.0 - y * y).sqrt(), rng.random::<f64>());
            let tint = DVec3::new(1.0, 0.78, 0.55).lerp(DVec3::new(0.7, 0.84, 1.0), warm);
            (d.with_y(y), tint / (0.015 + rng.random::<f64>()))
        })
        .collect();
    let total: f64 = points.iter().map(|(_, energy)| luminance(*energy)).sum();
    let scale = if total > 0.0 { 4.0 * PI * f64::from(stars.luminance) / total } else { 0.0 };
    points.retain(|(d, _)| d.y > 0.0);
    points.iter_mut().for_each(|(_, energy)| *energy *= scale);
    points
}
