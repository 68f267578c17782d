//! Draws of camera paths: orbits, drives along a line, walks with a camera in the hand, and tripods.

use super::CameraKind;
use super::camera::{CLEARANCE, Lens};
use super::layout::{Context, Layout, Space};
use crate::description::{CameraPath, Pose, decimal};
use crate::draw::Draw;
use glam::{Vec2, Vec3};
use rand_pcg::Pcg64;

/// A path of the context's kind; `late` grows from 0 to 1 with the number of the draw and lifts the camera.
pub(super) fn draw(rng: &mut Pcg64, context: &Context, layout: &Layout, resolution: [u32; 2], late: f32) -> CameraPath {
    if context.camera == CameraKind::Orbit {
        return orbit(rng, layout, resolution, context.knobs.degrees_per_frame, late);
    }
    let (vertical_fov, eye, target) = stand(rng, layout, resolution, late);
    let frames = context.frames;
    let poses = match context.camera {
        CameraKind::Dolly => dolly(rng, eye, target, frames),
        CameraKind::Handheld => handheld(rng, eye, target, frames),
        CameraKind::Orbit | CameraKind::Fixed => vec![pose(eye, target)],
    };
    CameraPath::Poses { poses, vertical_fov }
}

fn exact(v: Vec3) -> [f64; 3] {
    v.to_array().map(|v| (v * 1e4).round() / 1e4).map(decimal)
}

fn pose(eye: Vec3, target: Vec3) -> Pose {
    Pose { eye: exact(eye), target: exact(target), up: [0.0, 1.0, 0.0] }
}

/// An orbit whose distance lets the subject fill the view, within the walls where there are any.
fn orbit(rng: &mut Pcg64, layout: &Layout, resolution: [u32; 2], degrees_per_frame: f32, late: f32) -> CameraPath {
    let (mut centre, sphere) = layout.subject();
    let high = if layout.wide { 20.0 } else { 42.0 };
    let mut elevation = Pcg64::tidy(rng.between(4.0, high) + 20.0 * late);
    let (vertical_fov, distance) = match layout.space {
        Space::Open => {
            let vertical_fov = if layout.wide { rng.between(40.0, 65.0) } else { rng.between(30.0, 55.0) };
            if layout.wide {
                centre.y += 0.25 * sphere;
            }
            let narrow = Lens::new(vertical_fov, resolution).narrow();
            (vertical_fov, (sphere / narrow.sin() * rng.between(0.6, 0.95)).max(1.05 * sphere + 0.1))
        }
        Space::Room { half, height } => {
            (centre.x, centre.z) = (0.0, 0.0);
            let across = (half.min_element() - CLEARANCE) * rng.between(0.86, 0.99);
            let most = ((height - CLEARANCE - 0.05 - centre.y) / across).max(0.05).atan().to_degrees();
            elevation = Pcg64::tidy(elevation.min(most));
            (rng.between(50.0, 75.0), across / elevation.to_radians().cos())
        }
    };
    CameraPath::Orbit {
        target: exact(centre),
        distance: decimal(Pcg64::tidy(distance)),
        elevation,
        azimuth: rng.between(0.0, 360.0),
        degrees_per_frame,
        vertical_fov,
    }
}

/// Angle of view, eye and target of someone who looks at the subject.
fn stand(rng: &mut Pcg64, layout: &Layout, resolution: [u32; 2], late: f32) -> (f32, Vec3, Vec3) {
    let (centre, sphere) = layout.subject();
    let aside = Vec3::new(rng.between(-1.0, 1.0), rng.between(-0.4, 0.4), rng.between(-1.0, 1.0)) * 0.25 * sphere.min(2.0);
    let above = if layout.wide { 0.25 * sphere } else { 0.0 };
    let target = centre + Vec3::new(aside.x, above + aside.y.max(0.1 - centre.y), aside.z);
    match layout.space {
        Space::Open => {
            let vertical_fov = if layout.wide { rng.between(40.0, 70.0) } else { rng.between(30.0, 60.0) };
            let narrow = Lens::new(vertical_fov, resolution).narrow();
            let distance = (sphere / narrow.sin() * rng.between(0.6, 0.95)).max(1.05 * sphere + 0.1);
            let elevation = (rng.between(2.0, if layout.wide { 18.0 } else { 35.0 }) + 25.0 * late).to_radians();
            let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
            let eye = centre + distance * Vec3::new(elevation.cos() * sin, elevation.sin(), elevation.cos() * cos);
            (vertical_fov, eye.max(Vec3::new(f32::MIN, 0.25, f32::MIN)), target)
        }
        Space::Room { half, height } => {
            let room = half - CLEARANCE - 0.05;
            let spot = Vec2::new(rng.between(-1.0, 1.0), rng.between(-1.0, 1.0)) * room;
            // From the edge rather than from the middle.
            let spot = if rng.chance(0.75) { spot / (spot / room).abs().max_element().max(0.2) } else { spot };
            let top = height - CLEARANCE - 0.1;
            let eye = rng.between(0.8, 1.9) + late * (top - 1.9).max(0.0);
            (rng.between(45.0, 75.0), Vec3::new(spot.x, eye.min(top), spot.y), target)
        }
    }
}

/// Along a line: in, out, to the side or upwards, evenly or with a soft start and stop.
fn dolly(rng: &mut Pcg64, eye: Vec3, target: Vec3, frames: u32) -> Vec<Pose> {
    let ahead = target - eye;
    let side = ahead.cross(Vec3::Y).normalize_or(Vec3::X) * ahead.length();
    let way = match rng.weighted(&[0.4, 0.15, 0.3, 0.15]) {
        0 => ahead * rng.between(0.15, 0.45),
        1 => ahead * -rng.between(0.1, 0.3),
        2 => side * rng.between(0.15, 0.6) * if rng.chance(0.5) { 1.0 } else { -1.0 },
        _ => Vec3::Y * ahead.length() * rng.between(0.1, 0.35) + ahead * rng.between(0.0, 0.2),
    };
    // Slowly enough for short sequences: not above a thirtieth of the distance a frame.
    let most = ahead.length() * (frames - 1) as f32 / 30.0;
    let way = way * (most / way.length().max(1e-6)).min(1.0);
    let soft = rng.chance(0.5);
    (0..frames)
        .map(|frame| {
            let t = frame as f32 / (frames - 1).max(1) as f32;
            let t = if soft { t * t * (3.0 - 2.0 * t) } else { t };
            pose(eye + way * t, target)
        })
        .collect()
}

/// A smooth walk through a few places, with the small movements of hands on top.
fn handheld(rng: &mut Pcg64, eye: Vec3, target: Vec3, frames: u32) -> Vec<Pose> {
    let distance = eye.distance(target);
    let stride = rng.between(0.04, 0.16) * distance;
    let knots = 4 + frames as usize / 24;
    let mut eyes = vec![eye];
    let mut targets = vec![target];
    for _ in 1..knots {
        let mut step = || Vec3::new(rng.between(-1.0, 1.0), rng.between(-0.25, 0.25), rng.between(-1.0, 1.0));
        let (walk, glance) = (step() * stride, step() * 0.06 * distance);
        eyes.push(eyes[eyes.len() - 1] + walk);
        targets.push(target + glance);
    }
    let waves: Vec<(f32, f32, Vec3)> = (0..5)
        .map(|_| {
            let (period, phase) = (rng.between(7.0, 26.0), rng.between(0.0, 360.0).to_radians());
            let size = distance * 0.0035 * period / 26.0;
            (period, phase, Vec3::new(rng.between(-1.0, 1.0), rng.between(-1.0, 1.0), rng.between(-1.0, 1.0)) * size)
        })
        .collect();
    (0..frames)
        .map(|frame| {
            let t = frame as f32 / 24.0;
            let shake = |late: f32| -> Vec3 {
                waves
                    .iter()
                    .map(|&(period, phase, way)| way * (std::f32::consts::TAU * frame as f32 / period + phase + late).sin())
                    .sum()
            };
            // The target shakes more and otherwise: hands turn more than they move.
            pose(spline(&eyes, t) + shake(0.0), spline(&targets, t) + 2.0 * shake(1.0))
        })
        .collect()
}

/// The uniform Catmull-Rom curve through knots at t = 0, 1, 2, ... (Catmull and Rom 1974), its ends doubled.
fn spline(knots: &[Vec3], t: f32) -> Vec3 {
    let last = knots.len() - 1;
    let first = (t.floor() as usize).min(last);
    let knot = |offset: isize| knots[(first as isize + offset).clamp(0, last as isize) as usize];
    let (a, b, c, d) = (knot(-1), knot(0), knot(1), knot(2));
    let t = t - first as f32;
    0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t + (3.0 * b - a - 3.0 * c + d) * t * t * t)
}

/// Place number `place` of those above everything: high over the subject in the open, under the ceiling of a room.
pub(super) fn refuge(context: &Context, layout: &Layout, place: u32) -> CameraPath {
    let (centre, radius) = layout.subject();
    let top = layout.bodies.iter().map(|b| b.top() + b.rise).fold(centre.y + radius, f32::max);
    let (sin, cos) = (place as f32 * 45.0).to_radians().sin_cos();
    let eye = match layout.space {
        Space::Open => {
            let distance = (top + 0.5).max(1.2 * radius);
            Vec3::new(centre.x + 0.6 * distance * sin, top + 0.5, centre.z + 0.6 * distance * cos)
        }
        Space::Room { half, height } => {
            let cell = place / 8;
            let share = |k: u32| (k as f32 + 0.5) / 9.0 * 2.0 - 1.0;
            let spot = Vec2::new(share(cell % 9), share(cell / 9)) * (half - CLEARANCE - 0.02);
            let low = 1.2f32.min(height - CLEARANCE - 0.02);
            Vec3::new(spot.x, low + (place % 8) as f32 / 7.0 * (height - CLEARANCE - 0.02 - low), spot.y)
        }
    };
    // Straight down there is no up: look a little aside.
    let target = if Vec2::new(eye.x - centre.x, eye.z - centre.z).length() < 0.05 { centre + 0.1 * Vec3::X } else { centre };
    match (context.camera, layout.space) {
        (CameraKind::Orbit, Space::Open) => CameraPath::Orbit {
            target: exact(centre),
            distance: decimal(Pcg64::tidy(eye.distance(centre) + 0.5)),
            elevation: 58.0,
            azimuth: 45.0 * (place % 8) as f32,
            degrees_per_frame: context.knobs.degrees_per_frame,
            vertical_fov: 50.0,
        },
        (CameraKind::Orbit, Space::Room { .. }) => CameraPath::Orbit {
            target: exact(Vec3::new(0.0, centre.y.min(eye.y - 0.3), 0.0)),
            distance: decimal(Pcg64::tidy(eye.distance(Vec3::new(0.0, centre.y.min(eye.y - 0.3), 0.0)).max(0.2))),
            elevation: Pcg64::tidy(
                ((eye.y - centre.y.min(eye.y - 0.3)) / Vec2::new(eye.x, eye.z).length().max(0.05)).atan().to_degrees(),
            )
            .min(85.0),
            azimuth: 0.0,
            degrees_per_frame: context.knobs.degrees_per_frame,
            vertical_fov: 70.0,
        },
        _ => CameraPath::Poses { poses: vec![pose(eye, target)], vertical_fov: 65.0 },
    }
}
