//! What lets light through: objects of glass, basins of water, panes in windows and crowns of leaves with holes.

use super::body::{Body, Part, Role};
use super::layout::{Context, Layout};
use crate::description::{Geometry, Material, TextureTransform};
use crate::draw::Draw;
use crate::pattern::random;
use crate::seed::Seed;
use crate::shapes::Shape;
use glam::Vec3;
use rand_pcg::Pcg64;

/// Share of the suitable objects of a scene with glass that are of glass, beside the first.
const MORE: f64 = 0.3;

/// A basin of water for a scene that has one.
pub(super) fn basin(context: &Context) -> Option<Body> {
    if !context.root.child("water", 0).rng().chance(context.knobs.water) {
        return None;
    }
    let rng = &mut context.root.child("water", 1).rng();
    let (radius, height) = (rng.log(0.25, 0.9), rng.between(0.12, 0.45));
    let wall = Pcg64::tidy(radius * rng.between(0.05, 0.12));
    let base = 0.02;
    let rim = Shape::Pipe { radius, inner_radius: radius - wall, height };
    let floor = Shape::Cylinder { radius: radius - 0.5 * wall, height: base, bevel: 0.0 };
    // The water ends inside the walls and the floor, so that there is no gap that would mirror. Its surface stays below the rim.
    let level = Pcg64::tidy((height - base) * rng.between(0.5, 0.92));
    let water = Shape::Cylinder { radius: radius - 0.5 * wall, height: level, bevel: 0.0 };
    let parts = vec![
        Part::shape(rim, Role::Furniture, Vec3::new(0.0, 0.5 * height, 0.0)),
        Part::shape(floor, Role::Furniture, Vec3::new(0.0, 0.5 * base, 0.0)),
        Part::shape(water, Role::Water, Vec3::new(0.0, 0.5 * base + 0.5 * level, 0.0)),
    ];
    Some(Body::composed("basin", parts, radius, height))
}

/// Makes some objects glass.
pub(super) fn cast_in_glass(layout: &mut Layout, root: &Seed) {
    let mut suited: Vec<usize> = (0..layout.bodies.len()).filter(|&i| can_be_glass(&layout.bodies[i])).collect();
    // What the camera looks at comes first.
    suited.sort_by_key(|&i| !layout.bodies[i].subject);
    let subjects = suited.iter().filter(|&&i| layout.bodies[i].subject).count();
    if suited.is_empty() {
        return;
    }
    let mut rng = root.child("glass", 1).rng();
    let first = rng.below(if subjects > 0 { subjects } else { suited.len() } as u32) as usize;
    for (k, &i) in suited.iter().enumerate() {
        let more = rng.chance(MORE);
        if k == first || more {
            layout.bodies[i].parts[0].role = Role::Glass;
        }
    }
}

/// Whether a body is one closed surface: light would lose its way in several that run into one another.
fn can_be_glass(body: &Body) -> bool {
    let [Part { geometry: Geometry::Shape(shape), role: Role::Object, .. }] = body.parts.as_slice() else { return false };
    shape.is_single() && shape.group() != "architecture"
}

/// The glass of an object: clear, tinted through, or frosted.
pub(super) fn glass(rng: &mut Pcg64) -> Material {
    let kind = rng.weighted(&[0.5, 0.35, 0.15]);
    let attenuation_color = if kind == 1 {
        let (hue, saturation) = (rng.between(0.0, 360.0), rng.between(0.2, 0.85));
        Pcg64::hsv(hue, saturation, rng.between(0.5, 0.95)).map(|v| v.max(0.02))
    } else {
        [1.0; 3]
    };
    let roughness = if kind == 2 { rng.log(0.1, 0.5) } else { 0.0 };
    Material {
        base_color: [1.0; 3],
        roughness,
        // Indices of refraction from 1.4 to 1.7.
        specular: rng.between(0.35, 0.84),
        transmission: 1.0,
        attenuation_color,
        attenuation_distance: Pcg64::tidy(rng.log(0.08, 0.6)),
        ..Material::default()
    }
}

/// Clear or murky water.
pub(super) fn water(rng: &mut Pcg64) -> Material {
    let (blue, murk) = (rng.between(0.85, 0.98), rng.between(0.5, 1.0));
    let color = [0.55 * murk, 0.8 * murk, blue * murk];
    Material {
        base_color: [1.0; 3],
        roughness: 0.0,
        // An index of refraction of 1.33.
        specular: 0.25,
        transmission: 1.0,
        attenuation_color: color.map(Pcg64::tidy),
        attenuation_distance: Pcg64::tidy(rng.log(0.3, 3.0)),
        ..Material::default()
    }
}

/// The panes of a room: clear, rarely tinted or frosted.
pub(super) fn pane(rng: &mut Pcg64) -> Material {
    let tint = if rng.chance(0.2) { Pcg64::hsv(rng.between(0.0, 360.0), rng.between(0.05, 0.4), 0.9) } else { [1.0; 3] };
    let roughness = if rng.chance(0.08) { rng.between(0.25, 0.5) } else { 0.0 };
    Material { base_color: tint, roughness, specular: 0.5, transmission: 1.0, thin_walled: true, ..Material::default() }
}

/// Leaves with holes between them: light passes the holes, and sometimes the leaves too.
pub(super) fn leaves(rng: &mut Pcg64) -> Material {
    let soft = rng.chance(0.5);
    let repeat = [2.0, 3.0, 4.0][rng.below(3) as usize];
    let lit_through = rng.chance(0.3);
    Material {
        base_color: [1.0; 3],
        roughness: 1.0,
        specular: rng.between(0.2, 0.5),
        pattern: Some(random::leaves(rng)),
        texture_transform: TextureTransform { scale: [repeat; 2], ..TextureTransform::default() },
        opacity: soft.then_some(1.0),
        alpha_cutoff: (!soft).then_some(0.5),
        transmission: if lit_through { rng.between(0.2, 0.5) } else { 0.0 },
        thin_walled: lit_through,
        ..Material::default()
    }
}
