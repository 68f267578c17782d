//! Objects on a plain ground.

use super::body::{Body, GAP, Part, Role};
use super::clear;
use super::layout::{Context, Layout, Space};
use crate::draw::Draw;
use crate::error::Result;
use crate::shapes::Shape;
use glam::{Vec2, Vec3};
use rand_pcg::Pcg64;

/// Objects in a disc that do not touch, some of them on top of others.
pub(super) fn layout(context: &Context) -> Result<Layout> {
    let root = &context.root;
    let mut rng = root.child("layout", 0).rng();
    let count = context.count(&mut rng);
    let mut layout = Layout { structure: vec![], bodies: vec![], space: Space::Open, turn: None, wide: false };
    // Each object draws from a node of its own: another one more or less changes no neighbour.
    let mut bodies = vec![];
    for index in 0..count {
        let mut rng = root.child("object", u64::from(index)).rng();
        let size = rng.log(0.45, 1.35);
        let picked = context.picker.object(&mut rng, |_| true)?;
        bodies.push(Body::of(picked, &mut rng, size));
    }
    bodies.extend(clear::basin(context));
    // The place grows with what it has to hold, and further if something does not fit.
    let area: f32 = bodies.iter().map(|b| (b.radius + GAP).powi(2)).sum();
    let mut reach = Pcg64::tidy(area.sqrt() * rng.between(1.1, 1.6));
    for body in bodies {
        let left = if rng.chance(0.25) { layout.stack(body) } else { Some(body) };
        if let Some(body) = left {
            layout.scatter(&mut rng, body, Vec2::ZERO, &mut reach);
        }
    }
    let extent = layout.bodies.iter().map(|b| b.spot().length() + b.radius).fold(0.5, f32::max);
    let (shape, drop) = floor(&mut root.child("floor", 0).rng(), extent + 1.0);
    layout.structure.push(("ground".into(), Part::shape(shape, Role::Ground, Vec3::new(0.0, drop, 0.0))));
    Ok(layout)
}

/// A floor whose top lies at height 0, `extent` metres from the middle at least, and the height of its origin: mostly so wide
/// that its edge is the horizon, otherwise a plate with an edge to be seen.
fn floor(rng: &mut Pcg64, extent: f32) -> (Shape, f32) {
    match rng.weighted(&[0.7, 0.15, 0.15]) {
        0 => (Shape::Plane { size: Pcg64::tidy(extent * rng.between(40.0, 90.0)) }, 0.0),
        kind => {
            let thickness = rng.between(0.1, 0.4);
            let bevel = Pcg64::tidy(0.2 * thickness * rng.between(0.2, 1.0));
            let shape = if kind == 1 {
                Shape::Cylinder { radius: Pcg64::tidy(extent * rng.between(1.1, 2.0)), height: thickness, bevel }
            } else {
                let [width, depth] = [0; 2].map(|_| Pcg64::tidy(extent * rng.between(2.2, 3.5)));
                Shape::Box { size: [width, thickness, depth], bevel }
            };
            (shape, -0.5 * thickness)
        }
    }
}
