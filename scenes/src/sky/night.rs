//! A dark sky with street lamps, signs and windows around the horizon.

use super::canvas::{Dome, disc, luminance, rgb, toward};
use crate::seed::Seed;
use glam::DVec3;
use rand::RngExt;
use std::f64::consts::PI;

/// Which lights there are.
pub(super) struct Lights {
    pub count: u32,
    pub radius: f32,
    pub luminance: f32,
    pub seed: u32,
}

/// Sodium, warm white, neutral, cool white, neon red, cyan, magenta, green.
const COLORS: [[f32; 3]; 8] = [
    [1.0, 0.45, 0.08],
    [1.0, 0.72, 0.42],
    [1.0, 0.92, 0.82],
    [0.75, 0.88, 1.0],
    [1.0, 0.12, 0.08],
    [0.1, 0.85, 1.0],
    [1.0, 0.15, 0.8],
    [0.25, 1.0, 0.3],
];

pub(super) fn night(zenith: [f32; 3], horizon: [f32; 3], ground: [f32; 3], lights: &Lights) -> Dome {
    let (zenith, horizon, ground) = (rgb(zenith), rgb(horizon), rgb(ground));
    let background = move |d: DVec3| if d.y > 0.0 { horizon.lerp(zenith, d.y.sqrt()) } else { ground };
    let mut rng = Seed::root(u64::from(lights.seed)).child("night lights", 0).rng();
    let mut drawn = Vec::new();
    for _ in 0..lights.count {
        // Most lights stand low; the square of a uniform number thins them out upwards.
        let height: f32 = rng.random();
        let elevation = 2.0 + 58.0 * height * height;
        let azimuth = rng.random_range(0.0..360.0f32);
        let radius = lights.radius * rng.random_range(0.5..1.5f32);
        let color = rgb(COLORS[rng.random_range(0..COLORS.len() as u32) as usize]);
        // A few lights do most of the work, as in a street.
        let strength = f64::from(rng.random_range(0.0..1.0f32)).powi(3) + 0.05;
        drawn.push((toward(elevation, azimuth), f64::from(radius).to_radians(), color * (strength / luminance(color))));
    }
    let total: f64 = drawn.iter().map(|light| luminance(light.2)).sum();
    let flux = 4.0 * PI * f64::from(lights.luminance);
    let emitters = drawn
        .into_iter()
        .map(|(axis, radius, power)| {
            let radiance = power * (flux / total) / (2.0 * PI * (1.0 - radius.cos()));
            disc(axis, radius, move |_| radiance)
        })
        .collect();
    Dome { background: Box::new(background), emitters, points: Vec::new() }
}
