//! Cameras that never stand in anything and see enough of the subject.

use super::body::{Body, ways_apart};
use super::layout::{Context, Layout, Space};
use super::paths;
use crate::description::CameraPath;
use glam::{DVec3, Vec2, Vec3};

/// Least distance of the eye from cylinders, walls and floors, metres.
pub(super) const CLEARANCE: f32 = 0.15;
/// Share of the picture that bodies shall cover, and the least that subjects shall.
const COVERAGE: [f32; 2] = [0.18, 0.75];
const SUBJECT: f32 = 0.1;
/// Greatest share of a single body: more of it would be a wall before all others.
const SINGLE: f32 = 0.4;
/// Draws before the best so far is taken.
const DRAWS: u32 = 48;
/// Rays along each edge of the picture.
const RAYS: usize = 16;

/// Angles of view as the picture's shape allows.
#[derive(Clone, Copy)]
pub(super) struct Lens {
    /// Degrees.
    pub vertical_fov: f32,
    /// Width over height.
    pub aspect: f32,
}

impl Lens {
    pub fn new(vertical_fov: f32, [width, height]: [u32; 2]) -> Self {
        Self { vertical_fov, aspect: width.max(1) as f32 / height.max(1) as f32 }
    }

    /// Half the narrower angle of view, radians.
    pub fn narrow(self) -> f32 {
        let half = (0.5 * self.vertical_fov).to_radians();
        half.min((half.tan() * self.aspect).atan())
    }
}

/// A camera of the context's kind for a layout.
pub(super) fn camera(context: &Context, layout: &Layout, resolution: [u32; 2]) -> CameraPath {
    let mut best: Option<(f32, CameraPath)> = None;
    let look = |path: CameraPath, best: &mut Option<(f32, CameraPath)>| {
        if !stands_free(&path, layout, context.frames) {
            return false;
        }
        let fault = fault(&path, layout, context.frames, resolution);
        if best.as_ref().is_none_or(|(least, _)| fault < *least) {
            *best = Some((fault, path));
        }
        fault == 0.0
    };
    for draw in 0..DRAWS {
        let mut rng = context.root.child("camera", u64::from(draw)).rng();
        let path = paths::draw(&mut rng, context, layout, resolution, draw as f32 / DRAWS as f32);
        if look(path, &mut best) {
            break;
        }
    }
    if best.is_none() {
        // Crowded: above everything there is room, and a room's ceiling is higher than what stands in it.
        for place in 0..8 * 81 {
            look(paths::refuge(context, layout, place), &mut best);
        }
    }
    best.map_or_else(|| paths::refuge(context, layout, 0), |(_, path)| path)
}

/// Frames that stand for all of them.
pub(super) fn samples(frames: u32, most: u32) -> impl Iterator<Item = u32> {
    let step = frames.div_ceil(most).max(1);
    (0..frames).step_by(step as usize).chain(std::iter::once(frames - 1))
}

/// Does the eye keep out of everything at all frames?
pub(super) fn stands_free(path: &CameraPath, layout: &Layout, frames: u32) -> bool {
    samples(frames, 400).all(|frame| {
        let eye = path.view(frame).eye.as_vec3();
        let spot = Vec2::new(eye.x, eye.z);
        let inside = match layout.space {
            Space::Open => true,
            Space::Room { half, height } => (half - spot.abs()).min_element() > CLEARANCE && eye.y < height - CLEARANCE,
        };
        let clear = |b: &Body| eye.y > b.top() + b.rise + CLEARANCE || ways_apart(&b.way, &[spot]) > b.radius + CLEARANCE;
        inside && eye.y > CLEARANCE && layout.bodies.iter().all(clear)
    })
}

/// How far the picture is from what it should show, 0 = it shows it.
fn fault(path: &CameraPath, layout: &Layout, frames: u32, resolution: [u32; 2]) -> f32 {
    [0, frames / 2, frames - 1]
        .into_iter()
        .map(|frame| {
            let [all, subject, single] = coverage(path, layout, frame, resolution);
            let extent = (COVERAGE[0] - all).max(0.0) + (all - COVERAGE[1]).max(0.0);
            extent + 2.0 * (SUBJECT - subject).max(0.0) + (single - SINGLE).max(0.0)
        })
        .sum()
}

/// Shares of the picture covered by the cylinders of all bodies, by those of subjects with nothing before them, and by the
/// largest.
pub(super) fn coverage(path: &CameraPath, layout: &Layout, frame: u32, resolution: [u32; 2]) -> [f32; 3] {
    let view = path.view(frame);
    let lens = Lens::new(view.vertical_fov, resolution);
    let eye = view.eye.as_vec3();
    let ahead = (view.target - view.eye).normalize_or(DVec3::NEG_Z).as_vec3();
    let right = ahead.cross(view.up.into()).normalize_or(Vec3::X);
    let upward = right.cross(ahead);
    let tall = (0.5 * lens.vertical_fov).to_radians().tan();
    let feet: Vec<(Vec3, &Body)> = (layout.bodies.iter())
        .map(|b| (b.foot + b.motion.as_ref().map_or(Vec3::ZERO, |m| m.shift(frame).as_vec3()), b))
        .collect();
    let mut seen = vec![0; feet.len()];
    for row in 0..RAYS {
        for column in 0..RAYS {
            let at = |k: usize| (k as f32 + 0.5) / RAYS as f32 * 2.0 - 1.0;
            let along = ahead + right * (at(column) * tall * lens.aspect) + upward * (at(row) * tall);
            let hits =
                feet.iter().enumerate().filter_map(|(k, (foot, b))| Some((cylinder(eye - *foot, along, b.radius, b.height)?, k)));
            if let Some((_, nearest)) = hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
                seen[nearest] += 1;
            }
        }
    }
    let subject = seen.iter().zip(&feet).filter(|(_, (_, b))| b.subject).map(|(count, _)| *count).sum();
    [seen.iter().sum(), subject, seen.iter().copied().max().unwrap_or(0)].map(|count: usize| count as f32 / (RAYS * RAYS) as f32)
}

/// Where a ray enters an upright cylinder that stands on the origin.
fn cylinder(from: Vec3, along: Vec3, radius: f32, height: f32) -> Option<f32> {
    let (p, d) = (Vec2::new(from.x, from.z), Vec2::new(along.x, along.z));
    let (a, b, c) = (d.length_squared().max(1e-12), p.dot(d), p.length_squared() - radius * radius);
    let root = (b * b - a * c).max(-1.0);
    if root < 0.0 {
        return None;
    }
    let (near, far) = ((-b - root.sqrt()) / a, (-b + root.sqrt()) / a);
    let steep = if along.y.abs() < 1e-9 { 1e-9 } else { along.y };
    let (one, two) = (-from.y / steep, (height - from.y) / steep);
    let (near, far) = (near.max(one.min(two)).max(0.0), far.min(one.max(two)));
    (near <= far).then_some(near)
}
