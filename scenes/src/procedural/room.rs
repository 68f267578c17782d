//! Rooms with openings to the environment, furnished along the walls and in the middle.

use super::CameraKind;
use super::body::{Body, GAP, Part, Role};
use super::clear;
use super::daylight::{Daylight, Opening};
use super::layout::{Context, Layout, Space};
use crate::description::EnvironmentSource;
use crate::draw::Draw;
use crate::error::Result;
use crate::shapes::Shape;
use glam::{Vec2, Vec3};
use rand_pcg::Pcg64;

/// Thickness of walls, floors and ceilings, metres.
const WALL: f32 = 0.15;
/// Distance of the two sheets of a pane, metres; bars stand out of it.
const PANE: f32 = 0.02;
/// Openings as a share of the room's inner surface, to begin with.
const OPEN: [f32; 2] = [0.14, 0.3];
/// Mean light inside over that on level ground outside, below which a room gets more openings or another turn of the sky: the
/// exposure follows the environment alone, and a tenth of it made two rooms of three too dark to see what stands in them.
const BRIGHT: f32 = 0.3;
/// Reflectance of walls and floor that the estimate takes.
const REFLECTANCE: f32 = 0.5;

/// A rectangle: low and high corner.
type Rect = [Vec2; 2];

pub(super) fn layout(context: &Context, source: &EnvironmentSource) -> Result<Layout> {
    let root = &context.root;
    let mut rng = root.child("layout", 0).rng();
    let count = context.count(&mut rng);
    let height = rng.between(2.5, 3.6);
    let tables = 1 + rng.below(2);
    let cabinets = 1 + rng.below(3);
    let mut layout = Layout { structure: vec![], bodies: vec![], space: Space::Open, turn: None, wide: false };

    // The middle: a table or a group on the floor.
    let centre_table = rng.chance(0.4);
    let mut waiting = vec![];
    for index in 0..count {
        let mut rng = root.child("object", u64::from(index)).rng();
        // Every third piece is one that rooms are furnished with, where the pool has any.
        let furnishing = index % 3 == 0;
        let picked = context.picker.object(&mut rng, |group| {
            if furnishing { matches!(group, "furniture" | "vessel" | "plant") } else { group != "terrain" }
        })?;
        let size = if picked.group() == "furniture" { rng.log(0.7, 1.3) } else { rng.log(0.35, 1.0) };
        waiting.push(Body::of(picked, &mut rng, size));
    }
    let middle = (count as usize).div_ceil(2);
    let wall_side = waiting.split_off(middle.min(waiting.len()));
    waiting.extend(clear::basin(context));
    if centre_table {
        layout.bodies.push(table(&mut root.child("table", 0).rng()));
    }
    let area: f32 = waiting.iter().map(|b| (b.radius + GAP).powi(2)).sum();
    let mut reach = Pcg64::tidy(area.sqrt() * rng.between(0.9, 1.4));
    let stacked = |layout: &mut Layout, rng: &mut Pcg64, body: Body, share: f64| -> Option<Body> {
        if rng.chance(share) { layout.put_on(rng, body) } else { Some(body) }
    };
    for body in waiting {
        if let Some(body) = stacked(&mut layout, &mut rng, body, if centre_table { 0.6 } else { 0.2 }) {
            layout.scatter(&mut rng, body, Vec2::ZERO, &mut reach);
        }
    }
    let group = layout.bodies.iter().map(|b| b.spot().length() + b.radius).fold(0.8, f32::max);

    // Room for the group, for what stands at the walls and for a camera between them.
    let passage = if context.camera == CameraKind::Orbit { rng.between(1.9, 2.8) } else { rng.between(1.2, 2.2) };
    let half = Vec2::new(group + passage, group + passage * rng.between(0.8, 1.3)).map(Pcg64::tidy);
    layout.space = Space::Room { half, height };

    let mut furniture = vec![];
    for index in 0..tables {
        furniture.push(table(&mut root.child("table", 1 + u64::from(index)).rng()));
    }
    for index in 0..cabinets {
        furniture.push(cabinet(&mut root.child("cabinet", u64::from(index)).rng()));
    }
    for mut body in furniture {
        body.subject = false;
        along_wall(&mut layout, &mut rng, body, half, group);
    }
    for mut body in wall_side {
        body.subject = false;
        let left = stacked(&mut layout, &mut rng, body, 0.75);
        if let Some(body) = left
            && let Some(mut body) = along_wall(&mut layout, &mut rng, body, half, group)
        {
            // No wall has room left: it joins the group as closely as it can, or shrinks out of nobody's way.
            body.subject = true;
            let mut reach = group;
            layout.scatter(&mut rng, body, Vec2::ZERO, &mut reach);
        }
    }
    // What had to join may have pushed the walls outwards.
    let extent = |axis: fn(Vec2) -> f32| layout.bodies.iter().map(|b| axis(b.spot()).abs() + b.radius).fold(0.0, f32::max);
    let half = half.max(Vec2::new(extent(|v| v.x), extent(|v| v.y)) + 0.01).map(Pcg64::tidy);
    let tallest = layout.bodies.iter().map(Body::top).fold(0.0, f32::max);
    let height = height.max(Pcg64::tidy(tallest + 0.5));
    layout.space = Space::Room { half, height };
    let daylight = Daylight::of(source);
    let glazed = root.child("pane", 1).rng().chance(context.knobs.panes);
    layout.turn = Some(shell(&mut layout, &mut root.child("shell", 0).rng(), &daylight, (half, height), glazed));
    if root.child("lamps", 0).rng().chance(context.knobs.lamps) {
        lamps(&mut layout, &mut root.child("lamps", 1).rng(), half, height);
    }
    Ok(layout)
}

/// Finds a place for a body beside a wall, out of the middle; gives it back where there is none.
fn along_wall(layout: &mut Layout, rng: &mut Pcg64, mut body: Body, half: Vec2, group: f32) -> Option<Body> {
    for _ in 0..60 {
        let room = half - body.radius - 0.03;
        if room.min_element() <= 0.0 {
            return Some(body);
        }
        let along = rng.between(-1.0, 1.0);
        let away = rng.between(0.0, 0.12);
        let spot = match rng.below(4) {
            0 => Vec2::new(along * room.x, room.y - away),
            1 => Vec2::new(along * room.x, away - room.y),
            2 => Vec2::new(room.x - away, along * room.y),
            _ => Vec2::new(away - room.x, along * room.y),
        };
        body.place(spot, 0.0);
        if body.spot().length() > group + body.radius + 0.1 && layout.fits(&body, GAP) {
            layout.bodies.push(body);
            return None;
        }
    }
    Some(body)
}

/// A plain table about a foot at the origin: square with four legs, or round with one.
fn table(rng: &mut Pcg64) -> Body {
    let (height, thick) = (rng.between(0.42, 0.8), rng.between(0.03, 0.06));
    if rng.chance(0.35) {
        let radius = rng.between(0.4, 0.65);
        let plate = Shape::Cylinder { radius, height: thick, bevel: 0.0 };
        let leg = Shape::Cylinder { radius: rng.between(0.04, 0.09), height: Pcg64::tidy(height - thick - 0.02), bevel: 0.0 };
        let base = Shape::Cylinder { radius: Pcg64::tidy(0.55 * radius), height: 0.02, bevel: 0.0 };
        let parts = vec![
            Part::shape(plate, Role::Furniture, Vec3::new(0.0, height - 0.5 * thick, 0.0)),
            Part::shape(leg, Role::Furniture, Vec3::new(0.0, 0.5 * (height - thick + 0.02), 0.0)),
            Part::shape(base, Role::Furniture, Vec3::new(0.0, 0.01, 0.0)),
        ];
        return Body { deck: Vec2::splat(0.7 * radius), ..Body::composed("table", parts, radius, height) };
    }
    let half = Vec2::new(rng.between(0.4, 0.8), rng.between(0.3, 0.45));
    let leg = rng.between(0.04, 0.07);
    let yaw = rng.between(0.0, 180.0);
    let top = Part::block(Vec3::new(-half.x, height - thick, -half.y), Vec3::new(half.x, height, half.y), Role::Furniture);
    let mut parts = vec![top.turned(yaw)];
    for (x, z) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let middle = Vec2::new(x, z) * (half - 0.6 * leg - 0.02);
        let (low, high) = (middle - 0.5 * leg, middle + 0.5 * leg);
        let post = Part::block(Vec3::new(low.x, 0.0, low.y), Vec3::new(high.x, height - thick, high.y), Role::Furniture);
        parts.push(post.turned(yaw));
    }
    Body { deck: half, turn: yaw, ..Body::composed("table", parts, half.length(), height) }
}

/// A plain cabinet: a block on a base, with a top that stands over.
fn cabinet(rng: &mut Pcg64) -> Body {
    let half = Vec2::new(rng.between(0.3, 0.6), rng.between(0.2, 0.28));
    let height = if rng.chance(0.3) { rng.between(1.3, 1.9) } else { rng.between(0.45, 0.95) };
    // Square to the walls.
    let yaw = 90.0 * rng.below(2) as f32;
    let level = |inset: f32, low: f32, high: f32| {
        let half = half - inset;
        Part::block(Vec3::new(-half.x, low, -half.y), Vec3::new(half.x, high, half.y), Role::Furniture).turned(yaw)
    };
    let parts = vec![level(0.01, 0.06, height - 0.03), level(0.03, 0.0, 0.06), level(0.0, height - 0.03, height)];
    Body { deck: half, turn: yaw, ..Body::composed("cabinet", parts, half.length(), height) }
}

/// Sides of a room: -z, +z, -x, +x, ceiling.
const SIDES: [(&str, Vec3); 5] = [
    ("wall_north", Vec3::NEG_Z),
    ("wall_south", Vec3::Z),
    ("wall_west", Vec3::NEG_X),
    ("wall_east", Vec3::X),
    ("ceiling", Vec3::Y),
];

/// Openings of each side; `None` = the side is not there at all.
type Openings = [Option<Vec<Rect>>; 5];

/// Openings for a share of the room's surface, and the light's way to see them.
fn openings(rng: &mut Pcg64, half: Vec2, height: f32, share: f32) -> (Openings, Vec<Opening>) {
    let lengths = [half.x, half.x, half.y, half.y];
    let wanted = share * surface(half, height);
    let mut sides: Openings = std::array::from_fn(|_| Some(vec![]));
    let mut faces = vec![];
    let mut order = [0, 1, 2, 3, 4];
    for k in 0..4 {
        order.swap(k, k + rng.below(5 - k as u32) as usize);
    }
    let mut open = 0.0;
    for side in order {
        if open >= wanted {
            break;
        }
        let whole = if side == 4 { 4.0 * half.x * half.y } else { 2.0 * lengths[side] * height };
        let (rects, area) = if side == 4 {
            let (rects, area) = skylights(rng, half);
            (Some(rects), area)
        } else if wanted - open > 0.6 * whole && rng.chance(0.6) {
            (None, whole)
        } else {
            let (rects, area) = windows(rng, lengths[side], height);
            (Some(rects), area)
        };
        sides[side] = rects;
        open += area;
        faces.push(Opening { faces: SIDES[side].1, area });
    }
    (sides, faces)
}

/// Inner surface of a room, square metres.
fn surface(half: Vec2, height: f32) -> f32 {
    8.0 * half.x * half.y + 4.0 * (half.x + half.y) * height
}

/// Floor, walls and ceiling, open as far as the environment's light asks for; returns the degrees the environment is turned.
fn shell(layout: &mut Layout, rng: &mut Pcg64, daylight: &Daylight, (half, height): (Vec2, f32), glazed: bool) -> f32 {
    let mut share = rng.between(OPEN[0], OPEN[1]);
    let mut best: Option<(f32, Openings, f32)> = None;
    for _ in 0..12 {
        let (sides, faces) = openings(rng, half, height, share);
        let degrees = rng.between(0.0, 360.0);
        let light = daylight.inside(degrees, &faces, surface(half, height), REFLECTANCE);
        if best.as_ref().is_none_or(|(most, ..)| light > *most) {
            best = Some((light, sides, degrees));
        }
        if light > BRIGHT {
            break;
        }
        share = (share * 1.12).min(0.7);
    }
    // The loop above runs at least once.
    let Some((_, sides, degrees)) = best else { return 0.0 };
    let outer = half + WALL;
    let floor = Part::block(Vec3::new(-outer.x, -WALL, -outer.y), Vec3::new(outer.x, 0.0, outer.y), Role::Ground);
    layout.structure.push(("ground".into(), floor));
    for (side, (name, _)) in SIDES.into_iter().enumerate() {
        let Some(openings) = &sides[side] else { continue };
        let whole = match side {
            0 | 1 => [Vec2::new(-outer.x, 0.0), Vec2::new(outer.x, height)],
            2 | 3 => [Vec2::new(-half.y, 0.0), Vec2::new(half.y, height)],
            _ => [-outer, outer],
        };
        // A wall is made along x and turned: textures run along their box's first axis.
        let block = |[low, high]: Rect, near: f32, far: f32, role: Role| match side {
            4 => Part::block(Vec3::new(low.x, height + near, low.y), Vec3::new(high.x, height + far, high.y), role),
            _ => {
                let reach = if side < 2 { half.y } else { half.x };
                let part = Part::block(Vec3::new(low.x, low.y, reach + near), Vec3::new(high.x, high.y, reach + far), role);
                part.turned([180.0, 0.0, 270.0, 90.0][side])
            }
        };
        for (number, piece) in pieces(whole, openings).into_iter().enumerate() {
            let name = if number == 0 { name.to_owned() } else { format!("{name}_{number}") };
            layout.structure.push((name, block(piece, 0.0, WALL, if side == 4 { Role::Ceiling } else { Role::Wall })));
        }
        if glazed {
            for (number, opening) in openings.iter().enumerate() {
                let pane = block(*opening, 0.5 * (WALL - PANE), 0.5 * (WALL + PANE), Role::Pane);
                layout.structure.push((format!("{name}_pane_{number}"), pane));
            }
        }
        if rng.chance(0.6) {
            for (number, bar) in openings.iter().flat_map(bars).enumerate() {
                layout.structure.push((format!("{name}_bar_{number}"), block(bar, 0.3 * WALL, 0.7 * WALL, Role::Furniture)));
            }
        }
    }
    degrees
}

/// One to three windows of a wall that reaches `along` to both sides, and their area.
fn windows(rng: &mut Pcg64, along: f32, height: f32) -> (Vec<Rect>, f32) {
    let count = 1 + rng.below(3);
    let (sill, head) = (if rng.chance(0.3) { 0.0 } else { rng.between(0.3, 0.9) }, height - rng.between(0.2, 0.5));
    let step = 2.0 * along / count as f32;
    let width = step * rng.between(0.55, 0.85);
    let rect = |k: u32| {
        let middle = (k as f32 + 0.5) * step - along;
        [Vec2::new(middle - 0.5 * width, sill), Vec2::new(middle + 0.5 * width, head)].map(|v| v.map(Pcg64::tidy))
    };
    ((0..count).map(rect).collect(), count as f32 * width * (head - sill))
}

/// One or two openings of the ceiling, and their area.
fn skylights(rng: &mut Pcg64, half: Vec2) -> (Vec<Rect>, f32) {
    let count = 1 + rng.below(2);
    let step = 2.0 * half.x / count as f32;
    let size = Vec2::new(step * rng.between(0.5, 0.8), 2.0 * half.y * rng.between(0.5, 0.8));
    let rect = |k: u32| {
        let middle = Vec2::new((k as f32 + 0.5) * step - half.x, 0.0);
        [middle - 0.5 * size, middle + 0.5 * size].map(|v| v.map(Pcg64::tidy))
    };
    ((0..count).map(rect).collect(), count as f32 * size.x * size.y)
}

/// A rectangle without its openings, which follow one another from left to right.
fn pieces([low, high]: Rect, openings: &[Rect]) -> Vec<Rect> {
    let mut left = low.x;
    let mut pieces = vec![];
    for &[from, to] in openings {
        pieces.push([Vec2::new(left, low.y), Vec2::new(from.x, high.y)]);
        pieces.push([Vec2::new(from.x, low.y), Vec2::new(to.x, from.y)]);
        pieces.push([Vec2::new(from.x, to.y), Vec2::new(to.x, high.y)]);
        left = to.x;
    }
    pieces.push([Vec2::new(left, low.y), high]);
    // Shapes are a centimetre at least.
    pieces.retain(|[a, b]| (*b - *a).min_element() >= 0.01);
    pieces
}

/// A cross of bars in a window.
fn bars([low, high]: &Rect) -> [Rect; 2] {
    let middle = 0.5 * (*low + *high);
    [
        [Vec2::new(middle.x - 0.025, low.y), Vec2::new(middle.x + 0.025, high.y)],
        [Vec2::new(low.x, middle.y - 0.02), Vec2::new(middle.x - 0.025, middle.y + 0.02)],
    ]
}

/// Flat panels under the ceiling.
fn lamps(layout: &mut Layout, rng: &mut Pcg64, half: Vec2, height: f32) {
    for index in 0..1 + rng.below(3) {
        let size = Vec2::new(rng.between(0.2, 0.5), rng.between(0.1, 0.3));
        let room = half - size - 0.1;
        let spot = Vec2::new(room.x * rng.between(-0.8, 0.8), room.y * rng.between(-0.8, 0.8));
        let (low, high) = (spot - size, spot + size);
        let part = Part::block(Vec3::new(low.x, height - 0.06, low.y), Vec3::new(high.x, height - 0.002, high.y), Role::Lamp);
        layout.structure.push((format!("lamp_{}", index + 1), part));
    }
}
