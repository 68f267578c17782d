//! Bodies: what stands in a scene, each in an upright cylinder of its own.

use super::pick::Picked;
use crate::description::{Geometry, Motion, Transform, decimal};
use crate::draw::Draw;
use crate::shapes::{self, Shape, Stance};
use glam::{EulerRot, Mat3, Vec2, Vec3};
use rand_pcg::Pcg64;

/// Least distance between the cylinders of two bodies, metres.
pub(super) const GAP: f32 = 0.02;

/// What a part is made to look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Something to look at.
    Object,
    Ground,
    Wall,
    Ceiling,
    /// Plain tables and shelves.
    Furniture,
    Foliage,
    Trunk,
    Lamp,
    Glass,
    Water,
    Pane,
}

/// One object of the description.
#[derive(Clone, Debug)]
pub(super) struct Part {
    pub geometry: Geometry,
    pub role: Role,
    /// From the body's foot to the object's origin, metres.
    pub offset: Vec3,
    pub rotation: [f32; 3],
    pub scale: [f32; 3],
}

impl Part {
    /// A shape whose origin is the foot itself.
    pub fn shape(shape: Shape, role: Role, offset: Vec3) -> Self {
        Self { geometry: Geometry::Shape(shape), role, offset, rotation: [0.0; 3], scale: [1.0; 3] }
    }

    /// A box by its lowest and highest corner.
    pub fn block(low: Vec3, high: Vec3, role: Role) -> Self {
        let size = (high - low).to_array().map(Pcg64::tidy);
        Self::shape(Shape::Box { size, bevel: 0.0 }, role, 0.5 * (low + high))
    }

    /// Turned about the foot's vertical axis.
    pub fn turned(mut self, degrees: f32) -> Self {
        self.offset = Mat3::from_rotation_y(degrees.to_radians()) * self.offset;
        self.rotation[1] = Pcg64::tidy(self.rotation[1] + degrees);
        self
    }

    /// Turned about its own vertical axis.
    pub fn spun(mut self, degrees: f32) -> Self {
        self.rotation[1] = Pcg64::tidy(self.rotation[1] + degrees);
        self
    }

    pub fn transform(&self, foot: Vec3) -> Transform {
        let at = foot + self.offset;
        let translation = [Pcg64::tidy(at.x), (at.y * 1e4).round() / 1e4, Pcg64::tidy(at.z)].map(decimal);
        Transform { translation, rotation: self.rotation, scale: self.scale }
    }
}

/// Which mesh or file a body is.
#[derive(Clone, Debug)]
pub(super) struct Origin {
    pub family: String,
    pub mesh: Option<u32>,
    pub file: Option<String>,
}

/// Something that stands in an upright cylinder about its foot.
#[derive(Clone, Debug)]
pub(super) struct Body {
    /// What its name begins with.
    pub label: String,
    pub parts: Vec<Part>,
    /// `None` for plain structure.
    pub origin: Option<Origin>,
    /// Middle of its lowest point's level, metres.
    pub foot: Vec3,
    /// Of the cylinder, metres.
    pub radius: f32,
    pub height: f32,
    /// Radius of a level circle on its top that can carry something, metres; 0 = none.
    pub shelf: f32,
    /// Half the extents of a level rectangle on its top that can carry several, metres; 0 = none.
    pub deck: Vec2,
    /// Degrees that the rectangle is turned about the vertical axis.
    pub turn: f32,
    /// Stands on another body or carries one.
    pub stacked: bool,
    /// Looks different when it spins about its own axis, which stands upright.
    pub spins: bool,
    pub motion: Option<Motion>,
    /// Where the foot goes during the sequence, corner by corner.
    pub way: Vec<Vec2>,
    /// Belongs to what the camera looks at.
    pub subject: bool,
    /// How far it leaves its foot's height, metres.
    pub rise: f32,
}

/// Five significant digits: the files of users are of any size.
fn five_digits(v: f64) -> f32 {
    let unit = 10f64.powi(v.log10().floor() as i32 - 4);
    ((v / unit).round() * unit) as f32
}

/// Rounded outwards, so that nothing sinks into its neighbour or the floor.
pub(super) fn up(v: f32) -> f32 {
    (v * 1e4).ceil() / 1e4
}

impl Body {
    /// A body of several parts about a foot at the origin.
    pub fn composed(label: &str, parts: Vec<Part>, radius: f32, height: f32) -> Self {
        Self {
            label: label.into(),
            parts,
            origin: None,
            foot: Vec3::ZERO,
            radius: up(radius),
            height,
            shelf: 0.0,
            deck: Vec2::ZERO,
            turn: 0.0,
            stacked: false,
            spins: false,
            motion: None,
            way: vec![Vec2::ZERO],
            subject: true,
            rise: 0.0,
        }
    }

    /// A shape, turned and scaled, resting on its foot.
    pub fn of_shape(shape: Shape, role: Role, rotation: [f32; 3], scale: f32) -> Self {
        let turn = Mat3::from_euler(EulerRot::ZYX, rotation[2].to_radians(), rotation[1].to_radians(), rotation[0].to_radians());
        let (mut radius, mut low, mut high) = (0.0f32, f32::INFINITY, f32::NEG_INFINITY);
        for &p in &shapes::points(&shape) {
            let q = turn * p * scale;
            radius = radius.max(q.x.hypot(q.z));
            (low, high) = (low.min(q.y), high.max(q.y));
        }
        let upright = rotation[0] == 0.0 && rotation[2] == 0.0;
        let (lift, shelf) = (up(-low), if upright { level_top(&shape) * scale } else { 0.0 });
        let spins = upright && !symmetric(&shape);
        let label = shape.family().to_owned();
        let part =
            Part { geometry: Geometry::Shape(shape), role, offset: Vec3::new(0.0, lift, 0.0), rotation, scale: [scale; 3] };
        Self { shelf, spins, ..Self::composed(&label, vec![part], radius, lift + high) }
    }

    /// What was picked from a pool, about `size` metres large.
    pub fn of(picked: Picked, rng: &mut Pcg64, size: f32) -> Self {
        let yaw = rng.between(0.0, 360.0);
        match picked {
            Picked::Mesh { shape, family, number } => {
                let [x, z] = tilt(shape.stance(), rng);
                let body = Self::of_shape(shape, Role::Object, [x, yaw, z], size);
                Self { origin: Some(Origin { family: family.into(), mesh: Some(number), file: None }), ..body }
            }
            Picked::Model { path, extent } => {
                let largest = (extent.high - extent.low).max_element();
                let scale = five_digits(f64::from(size) / largest);
                let middle = (0.5 * (extent.low + extent.high)).as_vec3();
                let centre = Vec3::new(middle.x, extent.low.y as f32, middle.z) * scale;
                let mut offset = -(Mat3::from_rotation_y(yaw.to_radians()) * centre);
                offset.y = up(offset.y);
                let part = Part {
                    geometry: Geometry::File(path.clone()),
                    role: Role::Object,
                    offset,
                    rotation: [0.0, yaw, 0.0],
                    scale: [scale; 3],
                };
                let height = scale * (extent.high.y - extent.low.y) as f32;
                // A thousandth for the rounding of the offset.
                let radius = scale * extent.radius as f32 + 1e-3;
                let origin = Some(Origin { family: "file".into(), mesh: None, file: Some(path) });
                Self { origin, ..Self::composed("model", vec![part], radius, height) }
            }
        }
    }

    /// Height of its top, metres.
    pub fn top(&self) -> f32 {
        self.foot.y + self.height
    }

    pub fn spot(&self) -> Vec2 {
        Vec2::new(self.foot.x, self.foot.z)
    }

    /// Puts the foot to a place, rounded.
    pub fn place(&mut self, spot: Vec2, height: f32) {
        let spot = spot.to_array().map(Pcg64::tidy);
        self.foot = Vec3::new(spot[0], height, spot[1]);
        self.way = vec![Vec2::from(spot)];
    }

    /// Do the two keep clear of each other in every frame?
    pub fn clear_of(&self, other: &Self, gap: f32) -> bool {
        let above = |a: &Self, b: &Self| a.foot.y >= b.top() + b.rise - 1e-4;
        above(self, other) || above(other, self) || ways_apart(&self.way, &other.way) >= self.radius + other.radius + gap
    }
}

/// Least distance between two ways, whenever they are walked.
pub(super) fn ways_apart(a: &[Vec2], b: &[Vec2]) -> f32 {
    let pieces = |way: &[Vec2]| -> Vec<[Vec2; 2]> {
        if way.len() < 2 { vec![[way[0]; 2]] } else { way.windows(2).map(|w| [w[0], w[1]]).collect() }
    };
    let (a, b) = (pieces(a), pieces(b));
    a.iter().flat_map(|&p| b.iter().map(move |&q| between_ways(p, q))).fold(f32::INFINITY, f32::min)
}

/// Radius of a level circle in the middle of an upright shape's top, metres; 0 = none.
fn level_top(shape: &Shape) -> f32 {
    match shape {
        Shape::Box { size, bevel } => 0.5 * size[0].min(size[2]) - bevel,
        Shape::Cylinder { radius, bevel, .. } => radius - bevel,
        Shape::Cone { top_radius, .. } => *top_radius,
        Shape::Prism { radius, star: None, sides, taper, .. } => radius * taper * (std::f32::consts::PI / *sides as f32).cos(),
        _ => 0.0,
    }
}

/// Degrees about x and z by which a body of this stance leans or lies.
fn tilt(stance: Stance, rng: &mut Pcg64) -> [f32; 2] {
    match stance {
        Stance::Rim if rng.chance(0.4) => [90.0, 0.0],
        Stance::Lying if rng.chance(0.3) => [90.0, 0.0],
        Stance::Rolled if rng.chance(0.5) => [rng.between(0.0, 360.0), rng.between(0.0, 360.0)],
        Stance::Any if rng.chance(0.35) => [rng.between(0.0, 360.0), rng.between(0.0, 360.0)],
        _ => [0.0, 0.0],
    }
}

/// Whether spinning about its axis leaves a shape as it is.
fn symmetric(shape: &Shape) -> bool {
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
fn between_ways(a: [Vec2; 2], b: [Vec2; 2]) -> f32 {
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
