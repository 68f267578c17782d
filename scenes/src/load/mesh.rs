//! Repairs that every loaded mesh goes through: a renderer may rely on finite, in-range, non-degenerate triangles.

use crate::Mesh;
use glam::{Vec2, Vec3};

/// Drops triangles that cannot be rendered, mends normals, coordinates and tangents, and returns how many triangles went.
pub(crate) fn clean(mesh: &mut Mesh) -> usize {
    let before = mesh.triangles.len();
    let positions = &mesh.positions;
    mesh.triangles.retain(|t| t.iter().all(|&i| (i as usize) < positions.len()) && has_area(t.map(|i| positions[i as usize])));
    // Vertices nobody uses any more must not poison bounds computed over all vertices.
    for p in &mut mesh.positions {
        if !p.is_finite() {
            *p = Vec3::ZERO;
        }
    }
    // An attribute that not every vertex has cannot be looked up.
    let vertices = mesh.positions.len();
    if mesh.normals.len() != vertices {
        mesh.normals.clear();
    }
    if mesh.uvs.len() != vertices {
        mesh.uvs.clear();
    }
    if mesh.tangents.len() != vertices {
        mesh.tangents.clear();
    }
    for uv in &mut mesh.uvs {
        if !uv.is_finite() {
            *uv = Vec2::ZERO;
        }
    }
    mend_normals(mesh);
    let unit = |v: Vec3| v.is_finite() && (v.length_squared() - 1.0).abs() < 0.1;
    if mesh.tangents.iter().any(|t| !unit(t.truncate())) {
        // Broken tangents are made anew where a normal map needs them.
        mesh.tangents.clear();
    }
    for t in &mut mesh.tangents {
        *t = t.truncate().normalize().extend(if t.w < 0.0 { -1.0 } else { 1.0 });
    }
    before - mesh.triangles.len()
}

/// Does the triangle have a normal in single precision? False for NaN, infinities, and products that over- or underflow.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    (b - a).cross(c - a).length_squared().is_normal()
}

/// Makes normals unit; those without a direction become the mean of their triangles' geometric normals.
fn mend_normals(mesh: &mut Mesh) {
    let unit = |n: Vec3| n.try_normalize();
    if mesh.normals.iter().all(|&n| unit(n).is_some()) {
        mesh.normals.iter_mut().for_each(|n| *n = n.normalize());
        return;
    }
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        let n = (b - a).cross(c - a).normalize_or_zero();
        t.iter().for_each(|&i| sums[i as usize] += n);
    }
    for (n, sum) in mesh.normals.iter_mut().zip(sums) {
        *n = unit(*n).or_else(|| unit(sum)).unwrap_or(Vec3::Y);
    }
}

/// The mesh with reversed winding, for instances whose transform mirrors: seen in the world, triangles stay counter-clockwise
/// from outside. Tangents stay as they are: who moves them to the world multiplies `w` with the sign of the determinant.
pub(crate) fn mirrored(mesh: &Mesh) -> Mesh {
    let mut copy = mesh.clone();
    copy.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    copy
}
