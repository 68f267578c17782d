//! Random skies over all families, continuous in their parameters.

use super::{Lamp, LampShape, Sky, Sun, Wall, Window};
use crate::draw::Draw;
use rand_pcg::Pcg64;

/// A random sky. Outdoor families come most often, and half of their suns stand below 20 degrees: what a network must learn
/// about light are hard, low suns, and those are where it fails first when they are rare.
pub fn random(rng: &mut Pcg64) -> Sky {
    match rng.weighted(&[0.24, 0.20, 0.16, 0.07, 0.15, 0.08, 0.07, 0.03]) {
        0 => Sky::Daylight { sun: sun(rng), turbidity: rng.log(1.6, 9.0), ground: ground(rng), luminance: rng.log(0.2, 0.7) },
        1 => Sky::Cloudy {
            sun: sun(rng),
            turbidity: rng.log(1.6, 7.0),
            coverage: rng.between(0.1, 0.85),
            scale: rng.log(0.5, 2.5),
            seed: rng.below(1 << 30),
            ground: ground(rng),
            luminance: rng.log(0.2, 0.7),
        },
        2 => {
            let low = Sun { elevation: rng.between(-3.0, 14.0), ..sun(rng) };
            Sky::Sunset {
                sun: low,
                turbidity: rng.log(2.0, 7.0),
                bands: rng.between(0.0, 1.0),
                seed: rng.below(1 << 30),
                ground: ground(rng),
                luminance: rng.log(0.15, 0.6),
            }
        }
        3 => {
            let level = rng.log(0.3, 1.5);
            Sky::Overcast {
                zenith: tint(rng, level, 0.12),
                ground: ground(rng),
                glow: if rng.chance(0.5) { rng.between(0.2, 4.0) } else { 0.0 },
                glow_elevation: rng.between(10.0, 80.0),
                glow_azimuth: rng.between(0.0, 360.0),
            }
        }
        4 => studio(rng),
        5 => {
            let level = rng.log(0.003, 0.06);
            Sky::Night {
                zenith: tint(rng, 0.4 * level, 0.4),
                horizon: tint(rng, level, 0.4),
                ground: tint(rng, 0.5 * level, 0.2),
                lights: 3 + rng.below(28),
                light_radius: rng.log(0.5, 4.0),
                luminance: rng.log(0.1, 0.5),
                seed: rng.below(1 << 30),
            }
        }
        6 => interior(rng),
        _ => {
            let (high, low) = (rng.log(0.15, 1.2), rng.log(0.15, 1.2));
            Sky::Gradient {
                zenith: tint(rng, high, 0.4),
                horizon: tint(rng, low, 0.4),
                ground: tint(rng, 0.3 * low, 0.3),
                sharpness: rng.log(0.3, 2.0),
            }
        }
    }
}

pub(super) fn sun(rng: &mut Pcg64) -> Sun {
    let elevation = if rng.chance(0.5) { rng.between(2.0, 20.0) } else { rng.between(20.0, 85.0) };
    Sun { elevation, azimuth: rng.between(0.0, 360.0), radius: rng.log(0.27, 5.0), gain: rng.log(0.3, 3.0) }
}

pub(super) fn ground(rng: &mut Pcg64) -> [f32; 3] {
    let level = rng.log(0.05, 0.5);
    tint(rng, level, 0.35).map(|v| v.min(0.9))
}

/// A colour of about the given level whose channels differ by up to the share `spread`.
pub(super) fn tint(rng: &mut Pcg64, level: f32, spread: f32) -> [f32; 3] {
    [0; 3].map(|_| Pcg64::tidy(level * rng.between(1.0 - spread, 1.0 + spread)))
}

/// Light colours between candle and blue sky, sometimes saturated.
pub(super) fn lamp_color(rng: &mut Pcg64) -> [f32; 3] {
    if rng.chance(0.2) {
        let hue = rng.between(0.0, 360.0);
        let saturation = rng.between(0.3, 0.95);
        return Pcg64::hsv(hue, saturation, 1.0);
    }
    let warmth = rng.between(-1.0, 1.0);
    let (red, blue) = if warmth > 0.0 { (1.0, 1.0 - 0.6 * warmth) } else { (1.0 + 0.4 * warmth, 1.0) };
    [red, 1.0 - 0.22 * warmth.abs(), blue].map(Pcg64::tidy)
}

fn studio(rng: &mut Pcg64) -> Sky {
    let count = 2 + rng.below(5);
    let hard = rng.chance(0.4);
    let lamps = (0..count)
        .map(|index| {
            let (azimuth, elevation) = (rng.between(0.0, 360.0).to_radians(), rng.between(5.0, 80.0).to_radians());
            let distance = rng.between(1.5, 4.0);
            let across = distance * elevation.cos();
            let position = [across * azimuth.sin(), distance * elevation.sin(), -across * azimuth.cos()].map(Pcg64::tidy);
            let key = index == 0;
            let size = if key && hard { [rng.log(0.15, 0.4); 2] } else { [rng.log(0.3, 2.4), rng.log(0.3, 2.4)] };
            // Power by the light that arrives, so that small lamps are bright ones; the key lamp leads.
            let irradiance = if key { rng.log(1.0, 4.0) } else { rng.log(0.1, 1.5) };
            let power = Pcg64::tidy(irradiance * distance * distance / (size[0] * size[1]));
            let shape = if rng.chance(0.35) { LampShape::Ellipse } else { LampShape::Rectangle };
            Lamp {
                position,
                size,
                roll: rng.between(0.0, 90.0),
                shape,
                color: lamp_color(rng),
                power,
                softness: rng.between(0.0, 0.6),
                mask: None,
            }
        })
        .collect();
    let dim = rng.log(0.01, 0.15);
    Sky::Studio { lamps, fill: tint(rng, dim, 0.2), floor: tint(rng, 0.6 * dim, 0.2), backdrop: None }
}

fn interior(rng: &mut Pcg64) -> Sky {
    let size = [rng.between(3.0, 12.0), rng.between(2.4, 5.0), rng.between(3.0, 12.0)];
    let level = rng.between(0.3, 0.75);
    let mut windows: Vec<Window> = (0..1 + rng.below(4))
        .map(|_| {
            let wall = [Wall::North, Wall::East, Wall::South, Wall::West, Wall::Ceiling][rng.below(5) as usize];
            let face = match wall {
                Wall::North | Wall::South => [size[0], size[1]],
                Wall::East | Wall::West => [size[2], size[1]],
                Wall::Ceiling => [size[0], size[2]],
            };
            let extent = face.map(|f| Pcg64::tidy(f * rng.between(0.2, 0.6)));
            let offset = [0, 1].map(|k| {
                let play = 0.48 * (face[k] - extent[k]);
                rng.between(-play, play)
            });
            Window { wall, offset, size: extent, radiance: tint(rng, 1.0, 0.25) }
        })
        .collect();
    // Large windows let in more light than small ones; the room's mean radiance is drawn and the windows' follows.
    let faces = 2.0 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0]);
    let open: f32 = windows.iter().map(|w| w.size[0] * w.size[1]).sum();
    let light = (rng.log(0.3, 1.5) * (1.0 - level) * faces / open).clamp(1.0, 40.0);
    for window in &mut windows {
        window.radiance = window.radiance.map(|v| Pcg64::tidy(v * light));
    }
    Sky::Interior {
        size,
        eye_height: Pcg64::tidy(rng.between(0.3, 0.6) * size[1]),
        walls: tint(rng, level, 0.15),
        floor: tint(rng, 0.5 * level, 0.3),
        windows,
    }
}
