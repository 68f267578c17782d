//! Objects on a plain ground.

use super::body::{Body, GAP, Part, Role};
use super::layout::{Context, Layout, Space};
use crate::draw::Draw;
use crate::error::Result;
use crate::procedural::layout::floor;
use glam::{Vec2, Vec3};
use rand_pcg::Pcg64;

/// Objects in a disc that do not touch, some of them on top of others.
pub(super) fn layout(context: &Context) -> Result<Layout> {
    let root = &context.root;
    let mut rng = root.child("layout", 0).rng();
    let count = context.count(&mut rng);
    let mut layout = Layout { structure: vec![], bodies: vec![], space: Space::Open };
    // Each object draws from a node of its own: another one more or less changes no neighbour.
    let mut bodies = vec![];
    for index in 0..count {
        let mut rng = root.child("object", u64::from(index)).rng();
        let size = rng.log(0.45, 1.35);
        let picked = context.picker.object(&mut rng, |_| true)?;
        bodies.push(Body::of(picked, &mut rng, size));
    }
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
    let (shape, transform) = floor(&mut root.child("floor", 0).rng(), extent + 1.0);
    let drop = Vec3::new(0.0, transform.translation[1] as f32, 0.0);
    layout.structure.push(("ground".into(), Part::shape(shape, Role::Ground, drop)));
    Ok(layout)
}
