//! Tangents for normal maps, where a file brings none.
//!
//! The method is that of MikkTSpace (Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited"), which glTF 2.0 asks for
//! (section 3.7.2.1): the direction in which u grows on each triangle, projected into the plane of the vertex normal, summed over
//! the triangles of a vertex with the corner angle as weight. Triangles with mirrored coordinates never share a tangent with
//! others.
//!
//! The coordinates are those with which the normal map is looked up, its transform (KHR_texture_transform) included: where the
//! map is turned on the surface, the normals in it turn along.

use crate::Mesh;
use glam::{Affine2, DVec3, Mat2, Vec2, Vec3, Vec4};
use std::sync::Arc;

/// What a transform of texture coordinates does to tangents: the turn, or turn and mirroring, to whose coordinates the same
/// tangents belong. Exactly the identity where axes keep their directions, and where the transform leaves no area.
pub(crate) fn turn(transform: &Affine2) -> Mat2 {
    // u grows where v stays the same, so the second row alone says where; the determinant says on which side v is.
    let matrix = transform.matrix2;
    let (across, det) = (Vec2::new(matrix.x_axis.y, matrix.y_axis.y), matrix.determinant());
    let along = across.normalize_or(Vec2::Y);
    if det == 0.0 || !det.is_finite() || across.x == 0.0 && across.y > 0.0 && det > 0.0 {
        return Mat2::IDENTITY;
    }
    let first = Vec2::new(along.y, -along.x) * det.signum();
    Mat2::from_cols(Vec2::new(first.x, along.x), Vec2::new(first.y, along.y))
}

/// Gives `mesh` a tangent for every vertex, for coordinates that `turn` is applied to; does nothing when it has tangents already.
/// Flat-shaded meshes get a normal for every corner first. Vertices between mirrored and unmirrored coordinates are split.
///
/// Returns false, and leaves the mesh alone, when there are no texture coordinates.
pub(crate) fn generate(mesh: &mut Mesh, turn: Mat2) -> bool {
    if !mesh.tangents.is_empty() {
        return true;
    }
    if mesh.uvs.is_empty() {
        return false;
    }
    if mesh.normals.is_empty() {
        unweld(mesh);
    }
    split_mirrored(mesh, turn);
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    let mut signs = vec![1.0_f32; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let (direction, sign) = u_direction(mesh, turn, *triangle);
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
fn u_direction(mesh: &Mesh, turn: Mat2, triangle: [u32; 3]) -> (Vec3, f32) {
    let [a, b, c] = triangle.map(|i| i as usize);
    let (e1, e2) = (mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]);
    let (e1, e2) = (e1.as_dvec3(), e2.as_dvec3());
    let (d1, d2) = (turn * (mesh.uvs[b] - mesh.uvs[a]), turn * (mesh.uvs[c] - mesh.uvs[a]));
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
fn split_mirrored(mesh: &mut Mesh, turn: Mat2) {
    let mut seen = vec![0.0_f32; mesh.positions.len()];
    let mut order: Vec<usize> = (0..mesh.positions.len()).collect();
    let mut copies = std::collections::HashMap::new();
    for t in 0..mesh.triangles.len() {
        let (_, sign) = u_direction(mesh, turn, mesh.triangles[t]);
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
    use crate::texture::uv_transform;

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
            assert!(generate(&mut mesh, Mat2::IDENTITY));
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
    /// Tangents are where u grows in the coordinates of the look-up, bitangents where v falls there, on a surface that the
    /// coordinates stretch. What axes keep their directions in changes no bit.
    #[test]
    fn tangents_follow_the_coordinates_of_the_look_up() {
        // u along x and v along y, a whole tile in two metres and in one.
        let plain = Mesh {
            positions: [(0.0, 0.0), (2.0, 0.0), (0.0, 1.0), (2.0, 1.0)].map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(Vec2::from).to_vec(),
            triangles: vec![[0, 1, 2], [1, 3, 2]],
            ..Mesh::default()
        };
        let made = |transform: &Affine2| {
            let mut mesh = plain.clone();
            assert!(generate(&mut mesh, turn(transform)));
            mesh.tangents
        };
        let unturned = made(&Affine2::IDENTITY);
        for (degrees, scale) in [(0.0, [3.0, 0.7]), (360.0, [1.0; 2]), (90.0, [1.0; 2]), (180.0, [0.3; 2]), (-35.0, [2.0, 5.0])]
            .into_iter()
            .chain([(0.0, [1.0, -1.0]), (0.0, [-2.0, 1.0]), (20.0, [-1.0, 3.0]), (0.0, [1e-6, 1e-6]), (70.0, [1e6, 1e6])])
        {
            let transform = uv_transform([0.3, 0.9], f32::to_radians(degrees), scale);
            let inverse = transform.matrix2.as_dmat2().inverse();
            // Metres for a step of the look-up's u, and of its v.
            let step = |uv: glam::DVec2| Vec3::new(2.0 * uv.x as f32, uv.y as f32, 0.0).normalize();
            let (along, down) = (step(inverse.x_axis), step(inverse.y_axis));
            let tangents = made(&transform);
            if degrees == 0.0 && scale[0] > 0.0 && scale[1] > 0.0 {
                assert_eq!(tangents, unturned);
            }
            for tangent in tangents {
                assert!(tangent.truncate().distance(along) < 1e-5, "{degrees} {scale:?}: {tangent} for {along}");
                let bitangent = Vec3::Z.cross(tangent.truncate()) * tangent.w;
                assert!(bitangent.dot(down) < 0.0, "{degrees} {scale:?}: {bitangent} against {down}");
            }
        }
        // Nothing is known of coordinates without area.
        assert_eq!(made(&uv_transform([0.0; 2], 1.0, [0.0, 1.0])), unturned);
    }
}
