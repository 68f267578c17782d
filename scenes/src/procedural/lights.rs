//! Spots and points that light the subject.

use super::layout::{Layout, Space};
use crate::description::{Light, LightKind, Transform, decimal};
use crate::draw::Draw;
use glam::Vec3;
use rand_pcg::Pcg64;

/// One to three lights about the subject, above it, as bright there as `gain` makes an environment.
pub(super) fn lights(layout: &Layout, rng: &mut Pcg64, gain: f32) -> Vec<Light> {
    let (middle, radius) = layout.subject();
    let count = 1 + rng.below(3);
    (0..count).map(|number| light(layout, rng, (middle, radius), gain, number)).collect()
}

fn light(layout: &Layout, rng: &mut Pcg64, (middle, radius): (Vec3, f32), gain: f32, number: u32) -> Light {
    let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
    let away = rng.between(1.2, 2.5) * radius;
    let slope = rng.between(30.0, 80.0).to_radians();
    let mut at = middle + away * Vec3::new(slope.cos() * sin, slope.sin(), slope.cos() * cos);
    if let Space::Room { half, height } = layout.space {
        let inside = |v: f32, half: f32| v.clamp(0.15 - half, half - 0.15);
        at = Vec3::new(inside(at.x, half.x), at.y.min(height - 0.1), inside(at.z, half.y));
    }
    let translation = at.to_array().map(Pcg64::tidy).map(decimal);
    let distance = at.distance(middle).max(0.3);
    // The light of a surface that faces it, in units of a white sky's.
    let intensity = Pcg64::tidy(std::f32::consts::PI * gain * distance * distance * rng.log(0.3, 3.0));
    let spot = rng.chance(0.6);
    let outer_angle = rng.between(20.0, 60.0);
    let inner_angle = Pcg64::tidy(outer_angle * rng.between(0.0, 0.9));
    let warmth = rng.between(0.0, 1.0);
    let aim = [0; 3].map(|_| 0.3 * radius * rng.between(-1.0, 1.0));
    let target = (middle + Vec3::from(aim)).to_array().map(Pcg64::tidy).map(decimal);
    Light {
        name: format!("{}_{}", if spot { "spot" } else { "point" }, number + 1),
        kind: if spot {
            LightKind::Spot { intensity, inner_angle, outer_angle, ies: None }
        } else {
            LightKind::Point { intensity, ies: None }
        },
        color: [1.0, 1.0 - 0.3 * warmth, 1.0 - 0.65 * warmth].map(Pcg64::tidy),
        transform: Transform { translation, ..Transform::default() },
        target: spot.then_some(target),
        motion: None,
    }
}
