//! Tangents for normal maps, where a file brings none.
//!
//! The method is that of MikkTSpace (Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited"), which glTF 2.0 asks for
//! (section 3.7.2.1): the direction in which u grows on each triangle, projected into the plane of the vertex normal, summed over
//! the triangles of a vertex with the corner angle as weight. Triangles with mirrored coordinates never share a tangent with
//! others.

use crate::Mesh;
use glam::{DVec3, Vec3, Vec4};
use std::sync::Arc;

/// Gives `mesh` a tangent for every vertex; does nothing when it has tangents already.
/// Flat-shaded meshes get a normal for every corner first. Vertices between mirrored and unmirrored coordinates are split.
///
/// Returns false, and leaves the mesh alone, when there are no texture coordinates.
pub(crate) fn generate(mesh: &mut Mesh) -> bool {
    if !mesh.tangents.is_empty() {
        return true;
    }
    if mesh.uvs.is_empty() {
        return false;
    }
    if mesh.normals.is_empty() {
        unweld(mesh);
    }
    split_mirrored(mesh);
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    let mut signs = vec![1.0_f32; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let (direction, sign) = u_direction(mesh, *triangle);
        let corners = triangle.map(|i| mesh.positions[i as usize]);
        for k in 0..3 {
            let vertex = triangle[k] as usize;
            let n = mesh.normals[vertex];
            let flat = |v: Vec3| (v - n * n.dot(v)).normalize_or_zero();
            let edge = |to: usize| flat((corners[to % 3] - corners[k]).as_dvec3().normalize_or_zero().as_vec3());
            let (a, b) = (edge(k + 1), edge(k + 2));
            let angle = a.dot(b).clamp(-1.0, 1.0).acos();
            sums[vertex] += flat(direction) * angle;
            if sign != 0.0 {
                signs[vertex] = sign;
            }
        }
    }
    mesh.tangents = sums
        .iter()
        .zip(&signs)
        .zip(&mesh.normals)
        .map(|((sum, &w), n)| {
            // Coordinates without area have no direction: any unit vector across the normal is as good.
            sum.try_normalize().unwrap_or_else(|| n.any_orthonormal_vector()).extend(w)
        })
        .collect::<Vec<Vec4>>();
    true
}

/// Direction of growing u on a triangle (unnormalised in size, exact in direction), and glTF's handedness: `w` of
/// `bitangent = cross(normal, tangent) * w`. The bitangent points to where v falls, because v runs down the image
/// and the green of a glTF normal map points up. Both are 0 where the coordinates have no area.
fn u_direction(mesh: &Mesh, triangle: [u32; 3]) -> (Vec3, f32) {
    let [a, b, c] = triangle.map(|i| i as usize);
    let (e1, e2) = (mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]);
    let (e1, e2) = (e1.as_dvec3(), e2.as_dvec3());
    let (d1, d2) = (mesh.uvs[b] - mesh.uvs[a], mesh.uvs[c] - mesh.uvs[a]);
    let area = d1.perp_dot(d2);
    if area == 0.0 {
        return (Vec3::ZERO, 0.0);
    }
    // In double precision: of edges of a micrometre and coordinates as close the products would underflow.
    let direction = (e1 * f64::from(d2.y) - e2 * f64::from(d1.y)) * f64::from(area.signum());
    (direction.normalize_or_zero().as_vec3(), -area.signum())
}

/// Own vertices for every triangle, with its geometric normal.
fn unweld(mesh: &mut Mesh) {
    let order: Vec<usize> = mesh.triangles.iter().flatten().map(|&i| i as usize).collect();
    take_vertices(mesh, &order);
    mesh.normals = mesh
        .positions
        .chunks_exact(3)
        .flat_map(|p| {
            let [a, b, c] = [p[0], p[1], p[2]].map(Vec3::as_dvec3);
            [(b - a).cross(c - a).normalize_or(DVec3::Y).as_vec3(); 3]
        })
        .collect();
    mesh.triangles = (0..mesh.triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
}

/// Copies the vertices that mirrored triangles share with others, so that each vertex has one handedness.
fn split_mirrored(mesh: &mut Mesh) {
    let mut seen = vec![0.0_f32; mesh.positions.len()];
    let mut order: Vec<usize> = (0..mesh.positions.len()).collect();
    let mut copies = std::collections::HashMap::new();
    for t in 0..mesh.triangles.len() {
        let (_, sign) = u_direction(mesh, mesh.triangles[t]);
        if sign == 0.0 {
            continue;
        }
        for corner in &mut mesh.triangles[t] {
            let vertex = *corner as usize;
            let first = &mut seen[vertex];
            if *first == 0.0 {
                *first = sign;
            } else if *first != sign {
                *corner = *copies.entry(vertex).or_insert_with(|| {
                    order.push(vertex);
                    (order.len() - 1) as u32
                });
            }
        }
    }
    if order.len() > mesh.positions.len() {
        take_vertices(mesh, &order);
    }
}

/// Makes vertex `i` what vertex `order[i]` was.
fn take_vertices(mesh: &mut Mesh, order: &[usize]) {
    fn take<T: Copy>(values: &mut Vec<T>, order: &[usize]) {
        if !values.is_empty() {
            *values = order.iter().map(|&i| values[i]).collect();
        }
    }
    take(&mut mesh.positions, order);
    take(&mut mesh.normals, order);
    take(&mut mesh.uvs, order);
    mesh.more_uvs.iter_mut().for_each(|uvs| take(uvs, order));
    take(&mut mesh.colors, order);
    if let Some(deformation) = &mut mesh.deformation {
        Arc::make_mut(deformation).reorder(order);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// Two triangles with a common edge. The coordinates of the second one are mirrored.
    fn mirrored() -> Mesh {
        let places = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
        Mesh {
            positions: places.map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec(),
            uvs: [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0)].map(Vec2::from).to_vec(),
            more_uvs: vec![places.map(Vec2::from).to_vec()],
            colors: [0.1, 0.2, 0.3, 0.4].map(Vec4::splat).to_vec(),
            triangles: vec![[0, 1, 2], [1, 3, 2]],
            ..Mesh::default()
        }
    }

    /// Whether vertices are copied because of mirrored coordinates or because each triangle needs a normal of its own, a copy has
    /// the attributes of the vertex that it comes from.
    #[test]
    fn copied_vertices_keep_their_attributes() {
        let original = mirrored();
        for normals in [vec![Vec3::Z; 4], vec![]] {
            let mut mesh = Mesh { normals, ..original.clone() };
            assert!(generate(&mut mesh));
            assert_eq!([mesh.positions.len(), mesh.normals.len(), mesh.tangents.len()], [6; 3]);
            for (before, after) in original.triangles.iter().flatten().zip(mesh.triangles.iter().flatten()) {
                let (before, after) = (*before as usize, *after as usize);
                assert_eq!(mesh.positions[after], original.positions[before]);
                assert_eq!(mesh.uvs[after], original.uvs[before]);
                assert_eq!(mesh.more_uvs[0][after], original.more_uvs[0][before]);
                assert_eq!(mesh.colors[after], original.colors[before]);
            }
            let handed = mesh.triangles.iter().map(|t| t.map(|v| mesh.tangents[v as usize].w)).collect::<Vec<_>>();
            assert!(handed[0].iter().all(|w| *w == handed[0][0]) && handed[1].iter().all(|w| *w == -handed[0][0]));
        }
    }
}
