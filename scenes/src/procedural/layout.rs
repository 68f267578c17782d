//! What every layout has: structure, bodies, and the space a camera may be in.

use super::body::{Body, GAP, Part};
use super::pick::Picker;
use super::{CameraKind, Composition};
use crate::draw::Draw;
use crate::seed::Seed;
use glam::{Mat3, Vec2, Vec3};
use rand_pcg::Pcg64;

/// What a layout is made from.
pub(super) struct Context<'a> {
    pub root: Seed,
    pub knobs: &'a Composition,
    pub picker: &'a Picker<'a>,
    pub frames: u32,
    /// Kind of camera that will look at it.
    pub camera: CameraKind,
}

impl Context<'_> {
    /// How many objects the scene shall have.
    pub fn count(&self, rng: &mut Pcg64) -> u32 {
        let [fewest, most] = self.knobs.objects;
        fewest + rng.below(most - fewest + 1)
    }
}

/// Where a camera may be.
#[derive(Clone, Copy, Debug)]
pub(super) enum Space {
    /// Anywhere above the ground.
    Open,
    /// Within walls at +-half along x and z, below the ceiling; metres.
    Room { half: Vec2, height: f32 },
}

/// A scene before it has a camera and materials.
pub(super) struct Layout {
    /// Floors and walls: names and parts about the world's origin.
    pub structure: Vec<(String, Part)>,
    pub bodies: Vec<Body>,
    pub space: Space,
    /// Whether there is something to see above and beyond the subject.
    pub wide: bool,
    /// Degrees the environment has to be turned; any where `None`.
    pub turn: Option<f32>,
}

impl Layout {
    /// Centre and radius of a sphere about every subject during the whole sequence, metres.
    pub fn subject(&self) -> (Vec3, f32) {
        let places = || self.bodies.iter().filter(|b| b.subject).flat_map(|b| b.way.iter().map(move |&spot| (b, spot)));
        let low = places().map(|(b, spot)| spot - b.radius).fold(Vec2::INFINITY, Vec2::min);
        let high = places().map(|(b, spot)| spot + b.radius).fold(Vec2::NEG_INFINITY, Vec2::max);
        if low.x > high.x {
            return (Vec3::new(0.0, 0.5, 0.0), 1.0);
        }
        let middle = 0.5 * (low + high);
        let top = places().map(|(b, _)| b.top() + b.rise).fold(0.1, f32::max);
        let base = places().map(|(b, _)| b.foot.y).fold(top, f32::min);
        // Tall things are few: look a little below half the height.
        let centre = Vec3::new(middle.x, base + 0.4 * (top - base), middle.y);
        let reach = |(b, spot): (&Body, Vec2)| {
            let rise = (b.top() - centre.y).abs().max((centre.y - b.foot.y).abs());
            (spot.distance(middle) + b.radius).hypot(rise)
        };
        (centre, places().map(reach).fold(0.1, f32::max))
    }

    /// Does a body there keep clear of all others?
    pub fn fits(&self, body: &Body, gap: f32) -> bool {
        self.bodies.iter().all(|other| body.clear_of(other, gap))
    }

    /// Puts a body on the floor of a disc about `middle`, which grows until it fits.
    pub fn scatter(&mut self, rng: &mut Pcg64, mut body: Body, middle: Vec2, reach: &mut f32) {
        loop {
            for _ in 0..40 {
                let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
                body.place(middle + *reach * rng.between(0.0, 1.0).sqrt() * Vec2::new(sin, cos), 0.0);
                if self.fits(&body, GAP) {
                    self.bodies.push(body);
                    return;
                }
            }
            *reach *= 1.1;
        }
    }

    /// Puts a body on a table or another plain top beside what stands there; gives it back where there is no room.
    pub fn put_on(&mut self, rng: &mut Pcg64, mut body: Body) -> Option<Body> {
        let roomy = |b: &Body| b.deck.min_element() > body.radius;
        let carriers: Vec<usize> = (0..self.bodies.len()).filter(|&i| roomy(&self.bodies[i])).collect();
        if carriers.is_empty() {
            return Some(body);
        }
        for _ in 0..16 {
            let index = carriers[rng.below(carriers.len() as u32) as usize];
            let below = &self.bodies[index];
            let room = below.deck - body.radius;
            let at = Vec3::new(room.x * rng.between(-1.0, 1.0), 0.0, room.y * rng.between(-1.0, 1.0));
            let at = below.foot + Mat3::from_rotation_y(below.turn.to_radians()) * at;
            body.place(Vec2::new(at.x, at.z), super::body::up(below.top()));
            if self.fits(&body, 0.5 * GAP) {
                body.stacked = true;
                body.subject = below.subject;
                self.bodies[index].stacked = true;
                self.bodies.push(body);
                return None;
            }
        }
        Some(body)
    }

    /// Puts a body on top of another that has room for it; gives it back where there is none.
    pub fn stack(&mut self, mut body: Body) -> Option<Body> {
        let carrier = self.bodies.iter().position(|b| b.shelf >= body.radius && !b.stacked);
        let Some(carrier) = carrier else { return Some(body) };
        let below = &mut self.bodies[carrier];
        below.stacked = true;
        body.place(below.spot(), super::body::up(below.top()));
        body.stacked = true;
        self.bodies.push(body);
        None
    }
}
