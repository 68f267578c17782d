//! Objects that spin, slide, hop and circle without touching another at any frame.

use super::body::{Body, GAP};
use super::layout::{Layout, Space};
use crate::description::{Bounce, Circle, Motion, decimal};
use crate::draw::Draw;
use glam::{Vec2, Vec3};
use rand_pcg::Pcg64;

/// Corners of the polygon that stands for a circle's way.
const CORNERS: u32 = 48;

/// Lets one to four objects move; returns how many do.
pub(super) fn set_in_motion(layout: &mut Layout, rng: &mut Pcg64, frames: u32) -> u32 {
    // Subjects first: what moves behind the camera moves for nobody.
    let mut free: Vec<usize> = (0..layout.bodies.len())
        .filter(|&i| layout.bodies[i].subject && layout.bodies[i].origin.is_some() && !layout.bodies[i].stacked)
        .collect();
    for k in 1..free.len() {
        free.swap(k, rng.below(k as u32 + 1) as usize);
    }
    let wanted = 1 + rng.below(4);
    let mut moving = 0;
    for index in free {
        if moving == wanted {
            break;
        }
        let spins = layout.bodies[index].spins;
        let done = match rng.weighted(&[0.35, 0.25, 0.2, if spins { 0.4 } else { 0.0 }]) {
            0 => slide(layout, rng, index, frames),
            1 => circle(layout, rng, index, frames),
            2 => bounce(layout, rng, index),
            _ => spin(layout, rng, index),
        };
        moving += u32::from(done || spin(layout, rng, index) || bounce(layout, rng, index));
    }
    moving
}

fn spin(layout: &mut Layout, rng: &mut Pcg64, index: usize) -> bool {
    let body = &mut layout.bodies[index];
    if !body.spins {
        return false;
    }
    let sense = if rng.chance(0.5) { 1.0 } else { -1.0 };
    body.motion = Some(Motion { spin: sense * rng.between(1.5, 9.0), ..Motion::default() });
    true
}

fn bounce(layout: &mut Layout, rng: &mut Pcg64, index: usize) -> bool {
    let body = &layout.bodies[index];
    let height = rng.between(0.15, 0.9);
    let low = match layout.space {
        Space::Open => height,
        Space::Room { height: ceiling, .. } => height.min(ceiling - body.top() - 0.1),
    };
    if low < 0.05 {
        return false;
    }
    let bounce = Bounce { height: Pcg64::tidy(low), frames: rng.between(8.0, 30.0) };
    let spin = if body.spins && rng.chance(0.3) { rng.between(-6.0, 6.0) } else { 0.0 };
    let mut moved = layout.bodies[index].clone();
    moved.rise = low;
    moved.motion = Some(Motion { bounce: Some(bounce), spin, ..Motion::default() });
    take(layout, index, moved)
}

fn slide(layout: &mut Layout, rng: &mut Pcg64, index: usize, frames: u32) -> bool {
    for _ in 0..24 {
        let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
        let length = rng.between(0.15, 1.0);
        // Rounded a frame, then the way is exactly what the frames will show.
        let step = [sin, cos].map(|v| ((v * length / (frames - 1) as f32) * 1e5).round() / 1e5);
        let mut moved = layout.bodies[index].clone();
        moved.way = vec![moved.spot(), moved.spot() + Vec2::from(step) * (frames - 1) as f32];
        let spin = if moved.spins && rng.chance(0.4) { rng.between(-5.0, 5.0) } else { 0.0 };
        moved.motion = Some(Motion { translation: [step[0], 0.0, step[1]].map(decimal), spin, ..Motion::default() });
        if step != [0.0; 2] && take(layout, index, moved) {
            return true;
        }
    }
    false
}

fn circle(layout: &mut Layout, rng: &mut Pcg64, index: usize, frames: u32) -> bool {
    for _ in 0..24 {
        let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
        let center = [sin, cos].map(|v| Pcg64::tidy(v * rng.between(0.2, 0.9)));
        let sense = if rng.chance(0.5) { 1.0 } else { -1.0 };
        let circle = Circle { center, degrees: sense * rng.between(1.0, 7.0) };
        let turned = (circle.degrees.abs() * (frames - 1) as f32).min(360.0) * circle.degrees.signum();
        let mut moved = layout.bodies[index].clone();
        let start = moved.spot();
        let middle = start + Vec2::from(center);
        // Corners outside the circle, so that its arcs are inside the polygon's reach.
        let out = 1.0 / (0.5 * turned.to_radians().abs() / CORNERS as f32).cos().max(0.5);
        moved.way = (0..=CORNERS)
            .map(|k| {
                let turn = glam::Mat3::from_rotation_y((turned * k as f32 / CORNERS as f32).to_radians());
                let from = (start - middle) * if k == 0 { 1.0 } else { out };
                let at = turn * Vec3::new(from.x, 0.0, from.y);
                middle + Vec2::new(at.x, at.z)
            })
            .collect();
        moved.motion = Some(Motion { circle: Some(circle), ..Motion::default() });
        if take(layout, index, moved) {
            return true;
        }
    }
    false
}

/// Keeps the motion if the body stays clear of the others and within the walls, and not far from the rest.
fn take(layout: &mut Layout, index: usize, moved: Body) -> bool {
    let clear = layout.bodies.iter().enumerate().all(|(other, body)| other == index || moved.clear_of(body, GAP));
    let (centre, radius) = layout.subject();
    let centre = Vec2::new(centre.x, centre.z);
    let inside = |spot: &Vec2| match layout.space {
        Space::Open => spot.distance(centre) + moved.radius <= radius.max(1.0) * 1.15,
        Space::Room { half, .. } => (half - spot.abs() - moved.radius).min_element() > 0.02,
    };
    let fine = clear && moved.way.iter().all(inside);
    if fine {
        layout.bodies[index] = moved;
    }
    fine
}
