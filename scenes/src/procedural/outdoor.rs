//! Open country: a clear place with the subject, and trees, stones and buildings around it.

use super::body::{Body, GAP, Part, Role};
use super::clear;
use super::layout::{Context, Layout, Space};
use crate::draw::Draw;
use crate::error::Result;
use crate::shapes::Shape;
use glam::{Vec2, Vec3};
use rand_pcg::Pcg64;

/// Distance of scenery from the middle in radii of the subject's disc: cameras come no nearer than this.
const CLEAR: f32 = 2.4;

pub(super) fn layout(context: &Context) -> Result<Layout> {
    let root = &context.root;
    let mut rng = root.child("layout", 0).rng();
    let count = context.count(&mut rng);
    let mut layout = Layout { structure: vec![], bodies: vec![], space: Space::Open, turn: None, wide: true };
    let subjects = ((count as f32 * rng.between(0.45, 0.75)).round() as u32).clamp(1, 12);
    let mut bodies = vec![];
    for index in 0..count {
        let mut rng = root.child("object", u64::from(index)).rng();
        if index < subjects {
            let size = rng.log(0.4, 1.3);
            let picked = context.picker.object(&mut rng, |_| true)?;
            bodies.push(Body::of(picked, &mut rng, size));
            continue;
        }
        // What stands around is what stands in the open, in its own size.
        let picked =
            context.picker.object(&mut rng, |group| matches!(group, "plant" | "mineral" | "architecture" | "terrain"))?;
        let size = match picked.group() {
            "plant" => rng.log(0.7, 4.0),
            "architecture" => rng.log(2.0, 6.0),
            "terrain" => rng.log(4.0, 9.0),
            _ => rng.log(0.5, 2.0),
        };
        bodies.push(Body::of(picked, &mut rng, size));
    }
    let strays = bodies.split_off((subjects as usize).min(bodies.len()));
    bodies.extend(clear::basin(context));
    let area: f32 = bodies.iter().map(|b| (b.radius + GAP).powi(2)).sum();
    let mut reach = Pcg64::tidy(area.sqrt() * rng.between(1.0, 1.5));
    for body in bodies {
        if let Some(body) = if rng.chance(0.2) { layout.stack(body) } else { Some(body) } {
            layout.scatter(&mut rng, body, Vec2::ZERO, &mut reach);
        }
    }
    let group = layout.bodies.iter().map(|b| b.spot().length() + b.radius).fold(0.8, f32::max);
    let clear = CLEAR * group + 1.0;
    // A way through the scenery along which one sees far.
    let way = rng.between(0.0, 180.0);
    for mut body in strays {
        body.subject = false;
        ring(&mut layout, &mut rng, body, [clear, 1.8 * clear], way, 0.0);
    }
    let designs: Vec<Body> = (0..4).map(|k| tree(&mut root.child("tree", k).rng())).collect();
    for _ in 0..8 + rng.below(16) {
        let design = &designs[rng.below(4) as usize];
        let body = grown(design, rng.between(0.6, 1.3), rng.between(0.0, 360.0));
        ring(&mut layout, &mut rng, body, [clear, 3.5 * clear], way, 1.0);
    }
    for index in 0..rng.below(4) {
        let body = building(&mut root.child("building", u64::from(index)).rng());
        ring(&mut layout, &mut rng, body, [1.4 * clear, 3.0 * clear], way, 2.0);
    }
    let far = Pcg64::tidy(clear * rng.between(12.0, 25.0));
    layout.structure.push(("ground".into(), Part::shape(Shape::Plane { size: 2.0 * far }, Role::Ground, Vec3::ZERO)));
    hills(&mut layout, &mut root.child("hills", 0).rng(), clear, far);
    Ok(layout)
}

/// Finds a place in a ring, `beside` metres at least from the way through; leaves the body out where there is none.
fn ring(layout: &mut Layout, rng: &mut Pcg64, mut body: Body, [near, far]: [f32; 2], way: f32, beside: f32) {
    let (sin, cos) = way.to_radians().sin_cos();
    let along = Vec2::new(sin, cos);
    for attempt in 0..60 {
        // The nearest places are tried first more often: what is far away is small in the picture.
        let share = rng.between(0.0, 1.0).powi(2);
        let grown = 1.0 + attempt as f32 / 60.0;
        let distance = body.radius + near + (far - near) * share * grown;
        let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
        body.place(distance * Vec2::new(sin, cos), 0.0);
        let aside = body.spot().perp_dot(along).abs() >= beside + body.radius || beside == 0.0;
        if aside && layout.fits(&body, GAP) {
            layout.bodies.push(body);
            return;
        }
    }
}

/// A design at another size, turned.
fn grown(design: &Body, scale: f32, yaw: f32) -> Body {
    let parts = design.parts.iter().map(|part| {
        let part = Part { offset: part.offset * scale, scale: part.scale.map(|s| Pcg64::tidy(s * scale)), ..part.clone() };
        part.turned(yaw)
    });
    Body { subject: false, ..Body::composed(&design.label, parts.collect(), design.radius * scale + 1e-3, design.height * scale) }
}

/// A trunk with cones or balls of leaves about a foot at the origin, or a bush.
fn tree(rng: &mut Pcg64) -> Body {
    let kind = rng.below(3);
    let mut parts = vec![];
    let (mut radius, mut height) = (0.0f32, 0.0f32);
    let mut ball = |parts: &mut Vec<Part>, middle: Vec3, size: Vec3| {
        let part = Part::shape(Shape::Sphere { radius: 1.0 }, Role::Foliage, middle);
        radius = radius.max(Vec2::new(middle.x, middle.z).length() + size.x.max(size.z));
        height = height.max(middle.y + size.y);
        parts.push(Part { scale: size.to_array().map(Pcg64::tidy), ..part });
    };
    let label = match kind {
        0 => {
            let size = rng.between(0.5, 1.0);
            for _ in 0..2 + rng.below(3) {
                let r = size * rng.between(0.4, 0.7);
                let middle = Vec3::new(size * rng.between(-0.5, 0.5), r * rng.between(0.6, 0.9), size * rng.between(-0.5, 0.5));
                ball(&mut parts, middle, Vec3::new(r, r * rng.between(0.8, 1.0), r));
            }
            "bush"
        }
        1 => {
            let (trunk, crown) = (rng.between(1.2, 2.4), rng.between(0.8, 1.5));
            let stem = Shape::Cone { radius: rng.between(0.12, 0.2), top_radius: 0.08, height: trunk };
            parts.push(Part::shape(stem, Role::Trunk, Vec3::new(0.0, 0.5 * trunk, 0.0)));
            for _ in 0..3 + rng.below(4) {
                let r = crown * rng.between(0.5, 0.8);
                let middle =
                    Vec3::new(crown * rng.between(-0.6, 0.6), trunk + r * rng.between(0.5, 1.5), crown * rng.between(-0.6, 0.6));
                ball(&mut parts, middle, Vec3::new(r, r * rng.between(0.7, 1.0), r));
            }
            "tree"
        }
        _ => {
            let (trunk, tall, wide) = (rng.between(0.5, 1.0), rng.between(2.5, 5.0), rng.between(0.7, 1.3));
            let stem = Shape::Cylinder { radius: rng.between(0.1, 0.16), height: Pcg64::tidy(trunk + 0.5), bevel: 0.0 };
            parts.push(Part::shape(stem, Role::Trunk, Vec3::new(0.0, 0.5 * (trunk + 0.5), 0.0)));
            let levels = 3 + rng.below(2);
            for level in 0..levels {
                let share = level as f32 / levels as f32;
                let cone = Shape::Cone {
                    radius: Pcg64::tidy(wide * (1.0 - 0.75 * share)),
                    top_radius: 0.0,
                    height: Pcg64::tidy(0.5 * tall),
                };
                let base = trunk + 0.62 * tall * share;
                parts.push(Part::shape(cone, Role::Foliage, Vec3::new(0.0, base + 0.25 * tall, 0.0)));
                height = height.max(base + 0.5 * tall);
            }
            radius = wide;
            "fir"
        }
    };
    Body::composed(label, parts, radius + 0.01, height)
}

/// A plain house: a block, a flat roof that stands over, and a wing.
fn building(rng: &mut Pcg64) -> Body {
    let (half, height) = (Vec2::new(rng.between(2.0, 4.5), rng.between(2.0, 3.5)), rng.between(2.8, 7.0));
    let yaw = rng.between(0.0, 360.0);
    let block = |low: Vec3, high: Vec3, role| Part::block(low, high, role).turned(yaw);
    let eaves = half + 0.25;
    let mut parts = vec![
        block(Vec3::new(-half.x, 0.0, -half.y), Vec3::new(half.x, height, half.y), Role::Wall),
        block(Vec3::new(-eaves.x, height, -eaves.y), Vec3::new(eaves.x, height + 0.25, eaves.y), Role::Furniture),
    ];
    let mut radius = eaves.length();
    if rng.chance(0.6) {
        let (out, low) = (rng.between(1.5, 3.0), height * rng.between(0.4, 0.7));
        parts.push(block(Vec3::new(half.x, 0.0, -0.6 * half.y), Vec3::new(half.x + out, low, 0.6 * half.y), Role::Wall));
        radius = radius.max(Vec2::new(half.x + out, 0.6 * half.y).length());
    }
    Body { subject: false, ..Body::composed("house", parts, radius, height + 0.25) }
}

/// Low rises far away, which end the view before the ground does.
fn hills(layout: &mut Layout, rng: &mut Pcg64, clear: f32, far: f32) {
    for index in 0..3 + rng.below(6) {
        let radius = clear * rng.between(1.5, 5.0);
        let distance = (4.0 * clear + radius + clear * rng.between(0.0, 4.0)).min(0.95 * far);
        let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
        let middle = Vec3::new(distance * sin, 0.0, distance * cos);
        let part = Part::shape(Shape::Sphere { radius: 1.0 }, Role::Ground, middle);
        let scale = [radius, radius * rng.between(0.06, 0.22), radius * rng.between(0.7, 1.0)].map(Pcg64::tidy);
        layout.structure.push((format!("hill_{}", index + 1), Part { scale, ..part }));
    }
}
