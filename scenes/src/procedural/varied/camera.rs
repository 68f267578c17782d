//! Cameras that never stand in anything and see enough of the subject.

use super::body::ways_apart;
use super::layout::{Context, Layout, Space};
use crate::description::{CameraPath, decimal};
use crate::draw::Draw;
use glam::{DVec3, Vec2, Vec3};
use rand_pcg::Pcg64;

/// Least distance of the eye from cylinders, walls and floors, metres.
const CLEARANCE: f32 = 0.15;
/// Share of the picture that bodies shall cover, and the least that subjects shall.
const COVERAGE: [f32; 2] = [0.18, 0.75];
const SUBJECT: f32 = 0.1;
/// Draws before the best so far is taken.
const DRAWS: u32 = 48;
/// Rays along each edge of the picture.
const RAYS: usize = 16;

/// Angles of view as the picture's shape allows, radians.
#[derive(Clone, Copy)]
pub(super) struct Lens {
    pub vertical_fov: f32,
    /// Width over height.
    pub aspect: f32,
}

impl Lens {
    fn new(vertical_fov: f32, [width, height]: [u32; 2]) -> Self {
        Self { vertical_fov, aspect: width.max(1) as f32 / height.max(1) as f32 }
    }

    /// Half the narrower angle of view, radians.
    fn narrow(self) -> f32 {
        let half = (0.5 * self.vertical_fov).to_radians();
        half.min((half.tan() * self.aspect).atan())
    }
}

/// A camera of `kind` for a layout.
pub(super) fn camera(context: &Context, layout: &Layout, resolution: [u32; 2]) -> CameraPath {
    let mut best: Option<(f32, CameraPath)> = None;
    for draw in 0..DRAWS {
        let mut rng = context.root.child("camera", u64::from(draw)).rng();
        let path = orbit(&mut rng, layout, resolution, context.knobs.degrees_per_frame, draw as f32 / DRAWS as f32);
        if !stands_free(&path, layout, context.frames) {
            continue;
        }
        let fault = fault(&path, layout, context.frames, resolution);
        if fault == 0.0 {
            return path;
        }
        if best.as_ref().is_none_or(|(least, _)| fault < *least) {
            best = Some((fault, path));
        }
    }
    match best {
        Some((_, path)) => path,
        None => refuge(layout, context.knobs.degrees_per_frame),
    }
}

/// An orbit so high that nothing stands in its way.
fn refuge(layout: &Layout, degrees_per_frame: f32) -> CameraPath {
    let (centre, radius) = layout.subject();
    let top = layout.bodies.iter().map(|b| b.top() + b.rise).fold(centre.y + radius, f32::max);
    let distance = ((top - centre.y + 0.5) / 60f32.to_radians().sin()).max(2.0 * radius);
    CameraPath::Orbit {
        target: centre.to_array().map(Pcg64::tidy).map(decimal),
        distance: decimal(Pcg64::tidy(distance)),
        elevation: 60.0,
        azimuth: 0.0,
        degrees_per_frame,
        vertical_fov: 50.0,
    }
}

/// An orbit whose distance lets the subject fill the view; the later the draw, the higher.
fn orbit(rng: &mut Pcg64, layout: &Layout, resolution: [u32; 2], degrees_per_frame: f32, late: f32) -> CameraPath {
    let (centre, sphere) = layout.subject();
    let vertical_fov = rng.between(30.0, 55.0);
    let lens = Lens::new(vertical_fov, resolution);
    let distance = Pcg64::tidy(sphere / lens.narrow().sin() * rng.between(0.65, 1.0));
    CameraPath::Orbit {
        target: centre.to_array().map(Pcg64::tidy).map(decimal),
        distance: decimal(distance.max(Pcg64::tidy(1.05 * sphere + 0.1))),
        elevation: Pcg64::tidy(rng.between(6.0, 42.0) + 20.0 * late),
        azimuth: rng.between(0.0, 360.0),
        degrees_per_frame,
        vertical_fov,
    }
}

/// Frames that stand for all of them.
fn samples(frames: u32, most: u32) -> impl Iterator<Item = u32> {
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
        let clear =
            |b: &super::body::Body| eye.y > b.top() + b.rise + CLEARANCE || ways_apart(&b.way, &[spot]) > b.radius + CLEARANCE;
        inside && eye.y > CLEARANCE && layout.bodies.iter().all(clear)
    })
}

/// How far the picture is from what it should show, 0 = it shows it.
fn fault(path: &CameraPath, layout: &Layout, frames: u32, resolution: [u32; 2]) -> f32 {
    [0, frames / 2, frames - 1]
        .into_iter()
        .map(|frame| {
            let [all, subject] = coverage(path, layout, frame, resolution);
            (COVERAGE[0] - all).max(0.0) + (all - COVERAGE[1]).max(0.0) + 2.0 * (SUBJECT - subject).max(0.0)
        })
        .sum()
}

/// Shares of the picture covered by the cylinders of all bodies, and by those of subjects with nothing before them.
pub(super) fn coverage(path: &CameraPath, layout: &Layout, frame: u32, resolution: [u32; 2]) -> [f32; 2] {
    let view = path.view(frame);
    let lens = Lens::new(view.vertical_fov, resolution);
    let eye = view.eye.as_vec3();
    let ahead = (view.target - view.eye).normalize_or(DVec3::NEG_Z).as_vec3();
    let right = ahead.cross(view.up.into()).normalize_or(Vec3::X);
    let upward = right.cross(ahead);
    let tall = (0.5 * lens.vertical_fov).to_radians().tan();
    let feet: Vec<(Vec3, &super::body::Body)> = (layout.bodies.iter())
        .map(|b| (b.foot + b.motion.as_ref().map_or(Vec3::ZERO, |m| m.shift(frame).as_vec3()), b))
        .collect();
    let (mut all, mut subject) = (0, 0);
    for row in 0..RAYS {
        for column in 0..RAYS {
            let at = |k: usize| (k as f32 + 0.5) / RAYS as f32 * 2.0 - 1.0;
            let along = ahead + right * (at(column) * tall * lens.aspect) + upward * (at(row) * tall);
            let hits = feet.iter().filter_map(|(foot, b)| Some((cylinder(eye - *foot, along, b.radius, b.height)?, b.subject)));
            if let Some((_, looked_at)) = hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
                all += 1;
                subject += usize::from(looked_at);
            }
        }
    }
    [all, subject].map(|count| count as f32 / (RAYS * RAYS) as f32)
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
