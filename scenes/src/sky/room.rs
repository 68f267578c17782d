//! Light in rooms: studios with lamps, interiors with windows.

use super::canvas::{Dome, Emitter, flat, rgb, smoothstep, toward};
use super::fields::{Lamp, LampShape, Mask, Wall, Window};
use super::parts::Backdrop;
use crate::noise;
use glam::DVec3;
use std::f64::consts::PI;

pub(super) fn studio(lamps: &[Lamp], fill: [f32; 3], floor: [f32; 3], backdrop: Option<&Backdrop>) -> Dome {
    let (fill, floor) = (rgb(fill), rgb(floor));
    let paper = backdrop.map(paper);
    let background = move |d: DVec3| {
        let room = floor.lerp(fill, smoothstep(-0.15, 0.15, d.y));
        match &paper {
            Some(paper) => {
                let (share, radiance) = paper(d);
                room.lerp(radiance, share)
            }
            None => room,
        }
    };
    Dome { background: Box::new(background), emitters: lamps.iter().map(lamp).collect(), points: Vec::new() }
}

/// Share (0..=1) and radiance of a lit backdrop by direction; its sides are a degree or two soft.
fn paper(backdrop: &Backdrop) -> impl Fn(DVec3) -> (f64, DVec3) + Sync + 'static {
    let middle = toward(0.0, backdrop.azimuth);
    let (base, rise) = (rgb(backdrop.base), rgb(backdrop.rise));
    let half = 0.5 * f64::from(backdrop.width).to_radians();
    let (bottom, top) = (f64::from(backdrop.bottom).to_radians(), f64::from(backdrop.top).to_radians());
    move |d| {
        let level = (d.x * d.x + d.z * d.z).sqrt().max(1e-9);
        let aside = ((d.x * middle.x + d.z * middle.z) / level).clamp(-1.0, 1.0).acos();
        let elevation = d.y.clamp(-1.0, 1.0).asin();
        let across = if half >= 3.1 { 1.0 } else { 1.0 - smoothstep(half - 0.03, half + 0.01, aside) };
        let upright = smoothstep(bottom - 0.02, bottom + 0.02, elevation) * (1.0 - smoothstep(top - 0.02, top + 0.02, elevation));
        // A light at the foot of the paper fades upwards.
        (across * upright, base.lerp(rise, smoothstep(bottom, top, elevation)))
    }
}

/// Open share of a mask at a, b in -1..=1.
fn cut(mask: &Mask, a: f64, b: f64) -> f64 {
    let gap = |x: f64, open: f32| f64::from((x - x.floor() - 0.5).abs() < 0.5 * f64::from(open));
    match mask {
        Mask::Ring { inner } => f64::from(a.hypot(b) >= f64::from(*inner)),
        Mask::Slats { count, open } => gap((0.5 + 0.5 * b) * f64::from(*count), *open),
        Mask::Cells { cells, open } => {
            gap((0.5 + 0.5 * a) * f64::from(cells[0]), *open) * gap((0.5 + 0.5 * b) * f64::from(cells[1]), *open)
        }
        Mask::Leaves { open, seed } => {
            let wool = 0.5 + 0.5 * noise::fractal(DVec3::new(2.4 * a, 2.4 * b, 0.5), 3, *seed) / 0.45;
            let edge = 1.15 - 1.3 * f64::from(*open);
            smoothstep(edge - 0.08, edge + 0.08, wool)
        }
    }
}

fn lamp(lamp: &Lamp) -> Emitter {
    let centre = rgb(lamp.position);
    let facing = centre.normalize_or(DVec3::Y);
    let level = DVec3::Y.cross(facing).normalize_or(DVec3::X);
    let (sin, cos) = f64::from(lamp.roll).to_radians().sin_cos();
    let above = facing.cross(level);
    let (right, up) = (level * cos + above * sin, above * cos - level * sin);
    let [width, height] = lamp.size.map(|s| 0.5 * f64::from(s));
    let radiance = rgb(lamp.color) * f64::from(lamp.power);
    let (softness, shape, mask) = (f64::from(lamp.softness), lamp.shape, lamp.mask.clone());
    let fade =
        move |x: f64| if softness > 0.0 { 1.0 - smoothstep(1.0 - softness, 1.0, x.abs()) } else { f64::from(x.abs() <= 1.0) };
    flat(centre, right * width, up * height, move |a, b| {
        let open = mask.as_ref().map_or(1.0, |mask| cut(mask, a, b));
        radiance
            * open
            * match shape {
                LampShape::Rectangle => fade(a) * fade(b),
                LampShape::Ellipse => fade(a.hypot(b)),
            }
    })
}

/// Centre and half extents of a window, seen from the eye in the middle of the room.
pub(super) fn place(window: &Window, size: DVec3, eye_height: f64) -> (DVec3, DVec3, DVec3) {
    let half = 0.5 * size;
    let (out, right, up) = match window.wall {
        Wall::North => (-DVec3::Z, DVec3::X, DVec3::Y),
        Wall::East => (DVec3::X, DVec3::Z, DVec3::Y),
        Wall::South => (DVec3::Z, -DVec3::X, DVec3::Y),
        Wall::West => (-DVec3::X, -DVec3::Z, DVec3::Y),
        Wall::Ceiling => (DVec3::Y, DVec3::X, DVec3::Z),
    };
    let middle = DVec3::Y * (half.y - eye_height);
    let [across, along] = window.offset.map(f64::from);
    let [width, height] = window.size.map(|s| 0.5 * f64::from(s));
    (middle + out * half + right * across + up * along, right * width, up * height)
}

pub(super) fn interior(size: [f32; 3], eye_height: f32, walls: [f32; 3], floor: [f32; 3], windows: &[Window]) -> Dome {
    let (size, eye) = (rgb(size), f64::from(eye_height));
    let (walls, floor) = (rgb(walls), rgb(floor));
    let panes: Vec<_> = windows.iter().map(|w| (place(w, size, eye), rgb(w.radiance))).collect();
    let emitters = panes.iter().map(|&((centre, u, v), radiance)| flat(centre, u, v, move |_, _| radiance)).collect();

    // Light that has bounced often fills the room evenly: what enters, times rho / (1 - rho), over the area of all faces.
    let entering: DVec3 = panes.iter().map(|&((_, u, v), radiance)| radiance * PI * 4.0 * u.cross(v).length()).sum();
    let area = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
    let share = (size.x * size.z) / area;
    let rho = (walls * (1.0 - share) + floor * share).min(DVec3::splat(0.95));
    let bounced = entering * rho / (DVec3::ONE - rho) / area;

    let background = move |d: DVec3| {
        // Where the view meets the box, and which face that is.
        let far = |direction: f64, low: f64, high: f64| {
            if direction > 0.0 {
                high / direction
            } else if direction < 0.0 {
                low / direction
            } else {
                f64::INFINITY
            }
        };
        let t = DVec3::new(
            far(d.x, -0.5 * size.x, 0.5 * size.x),
            far(d.y, -eye, size.y - eye),
            far(d.z, -0.5 * size.z, 0.5 * size.z),
        );
        let p = d * t.min_element();
        let (normal, reflectance) = if t.y <= t.x && t.y <= t.z {
            (DVec3::Y * -d.y.signum(), if d.y < 0.0 { floor } else { walls })
        } else if t.x <= t.z {
            (DVec3::X * -d.x.signum(), walls)
        } else {
            (DVec3::Z * -d.z.signum(), walls)
        };
        let direct: DVec3 = panes.iter().map(|&((centre, u, v), radiance)| radiance * form_factor(p, normal, centre, u, v)).sum();
        reflectance / PI * (direct + bounced)
    };
    Dome { background: Box::new(background), emitters, points: Vec::new() }
}

/// Integral of cos over solid angle of the window seen from `p` on a face with `normal`, by 6 x 6 patches.
pub(super) fn form_factor(p: DVec3, normal: DVec3, centre: DVec3, u: DVec3, v: DVec3) -> f64 {
    let facing = u.cross(v);
    let patch = 4.0 / 36.0;
    let mut sum = 0.0;
    for j in 0..6 {
        for i in 0..6 {
            let mark = |k: i32| (2.0 * f64::from(k) + 1.0) / 6.0 - 1.0;
            let to = centre + u * mark(i) + v * mark(j) - p;
            let squared = to.length_squared();
            // Half a patch's size keeps points beside the window finite.
            let soft = squared + facing.length() * patch;
            sum += (to.dot(normal).max(0.0) * to.dot(facing).abs()) / (soft * soft) * patch;
        }
    }
    sum
}
