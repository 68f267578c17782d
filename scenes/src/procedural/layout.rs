//! Where objects stand: bounding discs that do not overlap, on the floor or on top of one another.

use crate::description::{Motion, Transform, decimal};
use crate::draw::Draw;
use crate::seed::Seed;
use crate::shapes::{self, Shape};
use glam::{EulerRot, Mat3, Vec2, Vec3};
use rand_pcg::Pcg64;

/// Least distance between bounding discs, metres.
const GAP: f32 = 0.02;

/// A shape in the world.
pub(super) struct Placed {
    pub shape: Shape,
    pub transform: Transform,
    pub motion: Option<Motion>,
    /// Radius of the disc about the object's vertical axis that contains it, metres.
    pub radius: f32,
    /// Height of its top above the floor, metres.
    pub top: f32,
    /// Where the disc's centre goes during the sequence (equal for what stays), metres.
    path: [Vec2; 2],
    /// Radius of a level circle on its top that can carry something, metres; 0 = none.
    shelf: f32,
    /// Stands with its own axis upright, so that it can spin in its disc.
    upright: bool,
    /// Stands on another object or carries one.
    stacked: bool,
}

/// The floor and what stands on it.
pub(super) struct Layout {
    pub floor: Shape,
    pub floor_transform: Transform,
    pub objects: Vec<Placed>,
}

/// A shape with its turn and size, resting at height 0.
struct Candidate {
    shape: Shape,
    rotation: [f32; 3],
    scale: f32,
    radius: f32,
    /// Lowest point below the object's origin, metres, > 0.
    below: f32,
    above: f32,
    shelf: f32,
}

pub(super) fn layout(root: &Seed, [fewest, most]: [u32; 2]) -> Layout {
    let mut rng = root.child("layout", 0).rng();
    let fewest = fewest.clamp(1, 64);
    let count = fewest + rng.below(most.clamp(fewest, 64) - fewest + 1);
    let occluder = count > 2 && rng.chance(0.4);
    // Each object draws from a node of its own: another one more or less changes no neighbour.
    let candidate = |index: u32| {
        let mut rng = root.child("object", u64::from(index)).rng();
        if occluder && index == 0 { wall(&mut rng) } else { solid(&mut rng) }
    };
    let candidates: Vec<Candidate> = (0..count).map(candidate).collect();

    // The room grows with what it has to hold, and further if something does not fit.
    let area: f32 = candidates.iter().map(|c| (c.radius + GAP).powi(2)).sum();
    let mut reach = Pcg64::tidy(area.sqrt() * rng.between(1.15, 1.7));
    let mut objects: Vec<Placed> = Vec::new();
    for (index, candidate) in candidates.into_iter().enumerate() {
        let aside = occluder && index == 0;
        let carrier = (!aside && rng.chance(0.25))
            .then(|| objects.iter().position(|o| o.shelf >= candidate.radius && !o.stacked))
            .flatten();
        if let Some(below) = carrier {
            objects[below].stacked = true;
            let (spot, height) = (objects[below].path[0], objects[below].top);
            objects.push(candidate.at(spot, height, true));
            continue;
        }
        let place = loop {
            let spot = (0..40).map(|_| spot(&mut rng, reach, aside)).find(|&spot| {
                let free = |o: &Placed| o.path[0].distance(spot) >= o.radius + candidate.radius + GAP;
                objects.iter().all(free)
            });
            match spot {
                Some(spot) => break spot,
                None => reach *= 1.1,
            }
        };
        objects.push(candidate.at(place, 0.0, false));
    }
    centre(&mut objects);
    let extent = objects.iter().map(|o| o.path[0].length() + o.radius).fold(0.5, f32::max);
    let (floor, floor_transform) = floor(&mut root.child("floor", 0).rng(), extent);
    Layout { floor, floor_transform, objects }
}

/// A place within `reach`; a wall keeps away from the middle.
fn spot(rng: &mut Pcg64, reach: f32, aside: bool) -> Vec2 {
    let share = rng.between(if aside { 0.5 } else { 0.0 }, 1.0);
    let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
    reach * share.sqrt() * Vec2::new(sin, cos)
}

/// Moves everything so that the middle of the bounding rectangle is the origin, and rounds.
fn centre(objects: &mut [Placed]) {
    let low = objects.iter().map(|o| o.path[0] - o.radius).fold(Vec2::INFINITY, Vec2::min);
    let high = objects.iter().map(|o| o.path[0] + o.radius).fold(Vec2::NEG_INFINITY, Vec2::max);
    for object in objects {
        let spot = (object.path[0] - 0.5 * (low + high)).to_array().map(Pcg64::tidy);
        object.path = [Vec2::from(spot); 2];
        object.transform.translation = [decimal(spot[0]), object.transform.translation[1], decimal(spot[1])];
    }
}

impl Candidate {
    fn new(shape: Shape, rotation: [f32; 3], scale: f32) -> Self {
        let turn = Mat3::from_euler(EulerRot::ZYX, rotation[2].to_radians(), rotation[1].to_radians(), rotation[0].to_radians());
        let (mut radius, mut low, mut high) = (0.0f32, 0.0f32, 0.0f32);
        for &p in &shapes::points(&shape) {
            let q = turn * p * scale;
            radius = radius.max(q.x.hypot(q.z));
            (low, high) = (low.min(q.y), high.max(q.y));
        }
        let upright = rotation[0] == 0.0 && rotation[2] == 0.0;
        let level = level_top(&shape);
        // Rounded outwards, so that nothing sinks into its neighbour or the floor.
        let up = |v: f32| (v * 1e4).ceil() / 1e4;
        let shelf = if upright { level * scale } else { 0.0 };
        Self { shape, rotation, scale, radius: up(radius), below: up(-low), above: high, shelf }
    }

    fn at(self, spot: Vec2, height: f32, stacked: bool) -> Placed {
        let lift = ((height + self.below) * 1e4).ceil() / 1e4;
        let transform =
            Transform { translation: [spot.x, lift, spot.y].map(decimal), rotation: self.rotation, scale: [self.scale; 3] };
        Placed {
            shape: self.shape,
            transform,
            motion: None,
            radius: self.radius,
            top: lift + self.above,
            path: [spot; 2],
            shelf: self.shelf,
            upright: self.rotation[0] == 0.0 && self.rotation[2] == 0.0,
            stacked,
        }
    }
}

/// Radius of a level circle in the middle of an upright shape's top, metres; 0 = none.
pub(super) fn level_top(shape: &Shape) -> f32 {
    match shape {
        Shape::Box { size, bevel } => 0.5 * size[0].min(size[2]) - bevel,
        Shape::Cylinder { radius, bevel, .. } => radius - bevel,
        Shape::Cone { top_radius, .. } => *top_radius,
        Shape::Prism { radius, star: None, sides, taper, .. } => radius * taper * (std::f32::consts::PI / *sides as f32).cos(),
        _ => 0.0,
    }
}

fn solid(rng: &mut Pcg64) -> Candidate {
    let shape = Shape::random(rng);
    let yaw = rng.between(0.0, 360.0);
    let tilt = tilt(&shape, rng);
    Candidate::new(shape, [tilt[0], yaw, tilt[1]], rng.log(0.45, 1.35))
}

/// Degrees about x and z that a shape lies or leans.
pub(super) fn tilt(shape: &Shape, rng: &mut Pcg64) -> [f32; 2] {
    match shape {
        // A gear, ring or pipe also stands on its rim, long things lie, a boulder lies anyhow.
        Shape::Gear { .. } | Shape::Torus { .. } | Shape::Pipe { .. } | Shape::TorusKnot { .. } if rng.chance(0.4) => [90.0, 0.0],
        Shape::Cylinder { .. } | Shape::Capsule { .. } | Shape::Spring { .. } | Shape::Lathe { wall: 0.0, .. }
            if rng.chance(0.3) =>
        {
            [90.0, 0.0]
        }
        Shape::Rock { .. } | Shape::Supershape { .. } | Shape::Superellipsoid { .. } if rng.chance(0.5) => {
            [rng.between(0.0, 360.0), rng.between(0.0, 360.0)]
        }
        _ => [0.0, 0.0],
    }
}

/// A big box or slab that shades the others.
fn wall(rng: &mut Pcg64) -> Candidate {
    let size = if rng.chance(0.5) {
        [rng.between(1.0, 1.8), rng.between(0.9, 1.8), rng.between(0.08, 0.25)]
    } else {
        [rng.between(0.6, 1.1), rng.between(0.8, 1.6), rng.between(0.6, 1.1)]
    };
    Candidate::new(Shape::Box { size, bevel: 0.0 }, [0.0, rng.between(0.0, 360.0), 0.0], 1.0)
}

/// A floor whose top lies at height 0 and reaches at least `extent` metres from the middle.
pub(super) fn floor(rng: &mut Pcg64, extent: f32) -> (Shape, Transform) {
    match rng.weighted(&[0.6, 0.2, 0.2]) {
        0 => (Shape::Plane { size: Pcg64::tidy(extent * rng.between(6.0, 16.0)) }, Transform::default()),
        1 => (Shape::Disc { radius: Pcg64::tidy(extent * rng.between(1.15, 4.0)) }, Transform::default()),
        _ => {
            let (width, depth) = (extent * rng.between(2.2, 6.0), extent * rng.between(2.2, 6.0));
            let thickness = rng.between(0.05, 0.3);
            let bevel = Pcg64::tidy(0.2 * thickness * rng.between(0.2, 1.0));
            let shape = Shape::Box { size: [Pcg64::tidy(width), thickness, Pcg64::tidy(depth)], bevel };
            (shape, Transform { translation: [0.0, decimal(-0.5 * thickness), 0.0], ..Transform::default() })
        }
    }
}

/// Whether anything moves in the scene of this seed.
pub(super) fn wants_motion(root: &Seed, share: f64) -> bool {
    root.child("moves", 0).rng().chance(share)
}

impl Layout {
    /// Lets one to three objects spin or slide, without touching another at any frame.
    pub fn set_in_motion(&mut self, rng: &mut Pcg64, frames: u32) {
        let free: Vec<usize> = (0..self.objects.len()).filter(|&i| !self.objects[i].stacked).collect();
        let mut movers = 1 + rng.below(3) as usize;
        let start = rng.below(free.len().max(1) as u32) as usize;
        for k in 0..free.len() {
            if movers == 0 {
                return;
            }
            let index = free[(start + k) % free.len()];
            let slide = rng.chance(0.5).then(|| self.slide(rng, index, frames)).flatten();
            let spins = self.objects[index].upright && !symmetric(&self.objects[index].shape);
            let motion = match slide {
                Some(motion) => Some(motion),
                None if spins => {
                    let sense = if rng.chance(0.5) { 1.0 } else { -1.0 };
                    Some(Motion { translation: [0.0; 3], spin: sense * rng.between(1.5, 9.0), ..Motion::default() })
                }
                // What looks the same from all sides has to go somewhere, if it can.
                None => self.slide(rng, index, frames),
            };
            if motion.is_some() {
                self.objects[index].motion = motion;
                movers -= 1;
            }
        }
    }

    /// A straight way for object `index` that keeps clear of all others' ways; records it.
    fn slide(&mut self, rng: &mut Pcg64, index: usize, frames: u32) -> Option<Motion> {
        let from = self.objects[index].path[0];
        let reach = self.objects.iter().map(|o| o.path[0].length() + o.radius).fold(0.5, f32::max);
        for _ in 0..24 {
            let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
            let length = rng.between(0.15, 0.8);
            // Rounded a frame, then the way is exactly what the frames will show.
            let step = [sin, cos].map(|v| ((v * length / (frames - 1) as f32) * 1e5).round() / 1e5);
            let to = from + Vec2::from(step) * (frames - 1) as f32;
            let clear = self.objects.iter().enumerate().all(|(other, o)| {
                other == index || between_ways([from, to], o.path) >= o.radius + self.objects[index].radius + GAP
            });
            if clear && to.length() + self.objects[index].radius <= reach && step != [0.0; 2] {
                self.objects[index].path[1] = to;
                return Some(Motion { translation: [step[0], 0.0, step[1]].map(decimal), ..Motion::default() });
            }
        }
        None
    }

    /// Centre and radius of a sphere about every object during the whole sequence, metres.
    pub fn bounding_sphere(&self) -> (Vec3, f32) {
        let places = || self.objects.iter().flat_map(|o| o.path.map(|spot| (o, spot)));
        let low = places().map(|(o, spot)| spot - o.radius).fold(Vec2::INFINITY, Vec2::min);
        let high = places().map(|(o, spot)| spot + o.radius).fold(Vec2::NEG_INFINITY, Vec2::max);
        let middle = 0.5 * (low + high);
        // Tall things are few: look a little below half the height.
        let top = self.objects.iter().map(|o| o.top).fold(0.1, f32::max);
        let centre = Vec3::new(middle.x, 0.4 * top, middle.y);
        let reach = |(o, spot): (&Placed, Vec2)| {
            let rise = (o.top - centre.y).abs().max(centre.y);
            (spot.distance(middle) + o.radius).hypot(rise)
        };
        (centre, places().map(reach).fold(0.1, f32::max))
    }
}

/// Whether spinning about its axis leaves a shape as it is.
pub(super) fn symmetric(shape: &Shape) -> bool {
    matches!(
        shape,
        Shape::Sphere { .. }
            | Shape::Cylinder { .. }
            | Shape::Cone { .. }
            | Shape::Capsule { .. }
            | Shape::Torus { .. }
            | Shape::Lathe { .. }
            | Shape::Pipe { .. }
    )
}

/// Least distance between two straight ways (whenever they are walked).
pub(super) fn between_ways(a: [Vec2; 2], b: [Vec2; 2]) -> f32 {
    let to_way = |p: Vec2, way: [Vec2; 2]| {
        let d = way[1] - way[0];
        let t = (p - way[0]).dot(d) / d.length_squared().max(1e-12);
        p.distance(way[0] + d * t.clamp(0.0, 1.0))
    };
    let side = |p: Vec2, way: [Vec2; 2]| (way[1] - way[0]).perp_dot(p - way[0]);
    let crossing = side(a[0], b) * side(a[1], b) < 0.0 && side(b[0], a) * side(b[1], a) < 0.0;
    if crossing {
        return 0.0;
    }
    to_way(a[0], b).min(to_way(a[1], b)).min(to_way(b[0], a)).min(to_way(b[1], a))
}
