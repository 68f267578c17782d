//! Whether a model brings its own floor: a ground plane at the same height would fight with it for the pixels.

use super::mesh;
use super::model::Model;
use glam::{DVec2, DVec3};

/// A floor lies within this share of the model's radius above its lowest vertex.
pub(super) const THICKNESS: f64 = 1e-3;
/// A floor covers this share of the rectangle, along x and z, that the model stands on.
pub(super) const SHARE: f64 = 0.5;
/// Cells along each side of that rectangle in which the share is counted.
const CELLS: usize = 64;

/// The share of the rectangle on which the model (of radius `radius`) stands that its own triangles cover at the lowest height,
/// `lowest`; from [`SHARE`] on they are a floor. Counted is what can be seen from above: what has no other triangle of the model
/// above it, and what faces up in a mesh that is not closed, such as the floor of a room. So the underside of a box is no floor.
pub(super) fn share(model: &Model, lowest: f64, radius: f64) -> f64 {
    let top = lowest + THICKNESS * radius;
    let at_bottom = |corners: &[DVec3; 3]| corners.iter().all(|p| p.y <= top);
    if !triangles(model).any(|(_, corners)| at_bottom(&corners)) {
        return 0.0;
    }
    let flat = |p: DVec3| DVec2::new(p.x, p.z);
    let points = || triangles(model).flat_map(|(_, corners)| corners).map(flat);
    let (low, high) = points().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let cell = (high - low) / CELLS as f64;
    if cell.min_element().partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
        return 0.0;
    }
    let mut closed = vec![None; model.meshes.len()];
    let mut is_closed = |index: usize| *closed[index].get_or_insert_with(|| mesh::is_closed(&model.meshes[index]));
    // Of each cell: whether its centre is in the floor, in floor that faces up, and below something.
    let mut cells = vec![[false; 3]; CELLS * CELLS];
    for (part, corners) in triangles(model) {
        let place = &model.parts[part];
        let up = (corners[1] - corners[0]).cross(corners[2] - corners[0]).y * place.transform.matrix3.determinant() > 0.0;
        let marks = if at_bottom(&corners) { [true, up && !is_closed(place.mesh), false] } else { [false, false, true] };
        for_centres(corners.map(|p| (flat(p) - low) / cell), |at| {
            cells[at].iter_mut().zip(marks).for_each(|(cell, mark)| *cell |= mark);
        });
    }
    let seen = cells.iter().filter(|[floor, up, below]| *up || *floor && !below).count();
    seen as f64 / (CELLS * CELLS) as f64
}

/// Part and corners, in the model's space, of every triangle.
fn triangles(model: &Model) -> impl Iterator<Item = (usize, [DVec3; 3])> + '_ {
    model.parts.iter().enumerate().flat_map(|(index, part)| {
        let mesh = &model.meshes[part.mesh];
        let place = |v: u32| part.transform.transform_point3(mesh.positions[v as usize].as_dvec3());
        mesh.triangles.iter().map(move |triangle| (index, triangle.map(place)))
    })
}

/// Calls `mark` with the number of every cell whose centre is in the triangle, edges included; corners are in cells.
fn for_centres([a, b, c]: [DVec2; 3], mut mark: impl FnMut(usize)) {
    let range = |low: f64, high: f64| {
        (low - 0.5).ceil().max(0.0) as usize..((high - 0.5).floor() + 1.0).clamp(0.0, CELLS as f64) as usize
    };
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    for row in range(low.y, high.y) {
        for column in range(low.x, high.x) {
            let p = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
            let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| (to - from).perp_dot(p - from));
            if sides.iter().all(|&s| s >= 0.0) || sides.iter().all(|&s| s <= 0.0) {
                mark(row * CELLS + column);
            }
        }
    }
}
