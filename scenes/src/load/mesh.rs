//! Repairs that every loaded mesh goes through: a renderer may rely on finite, in-range, non-degenerate triangles.

use crate::{Mesh, TriangleReport};
use glam::{DVec3, Vec2, Vec3, Vec4};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Drops triangles that cannot be rendered and those that are there twice, and mends normals, coordinates, colours and tangents.
/// Of a mesh that deforms, triangles without area or at the same places stay: another pose may part their corners.
pub(crate) fn clean(mesh: &mut Mesh) -> TriangleReport {
    let mut report = TriangleReport::default();
    let positions = &mesh.positions;
    let deforms = mesh.deforms();
    mesh.triangles.retain(|t| {
        let counter = match shape(positions, *t) {
            Shape::Good => return true,
            Shape::Needle => {
                report.needles += 1;
                return true;
            }
            Shape::OutOfRange => &mut report.out_of_range,
            Shape::NotFinite => &mut report.not_finite,
            Shape::NoArea if deforms => return true,
            Shape::NoArea => &mut report.no_area,
        };
        *counter += 1;
        false
    });
    if !deforms {
        drop_duplicates(mesh, &mut report);
    }
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
    mesh.more_uvs.iter_mut().filter(|uvs| uvs.len() != vertices).for_each(Vec::clear);
    // Where all are white there is nothing to look up.
    let color = |v: f32| if v.is_nan() { 1.0 } else { v.clamp(0.0, 1.0) };
    mesh.colors.iter_mut().for_each(|c| *c = Vec4::from(c.to_array().map(color)));
    if mesh.colors.len() != vertices || mesh.colors.iter().all(|&c| c == Vec4::ONE) {
        mesh.colors.clear();
    }
    for uv in mesh.uvs.iter_mut().chain(mesh.more_uvs.iter_mut().flatten()) {
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
    report
}

/// What a triangle is, by the rules of [`TriangleReport`].
enum Shape {
    Good,
    Needle,
    OutOfRange,
    NotFinite,
    NoArea,
}

fn shape(positions: &[Vec3], triangle: [u32; 3]) -> Shape {
    let corner = |i: u32| positions.get(i as usize).copied();
    let [Some(a), Some(b), Some(c)] = triangle.map(corner) else { return Shape::OutOfRange };
    if !(a.is_finite() && b.is_finite() && c.is_finite()) {
        return Shape::NotFinite;
    }
    let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
    let (ab, ac, bc) = (b - a, c - a, c - b);
    // Fourth powers of single precision, 1e-45 and 3e38, are within double precision.
    let area = ab.cross(ac).length_squared();
    // Rounding of the cross product is less than 2^-51 of the product of the edges.
    if area <= ab.length_squared() * ac.length_squared() * (2.0 * f64::EPSILON).powi(2) {
        return Shape::NoArea;
    }
    let longest = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    if longest.powi(2) > TriangleReport::NEEDLE.powi(2) * area { Shape::Needle } else { Shape::Good }
}

/// Whether a mesh is the surface of a body: each edge is passed as often in one direction as in the other. Vertices at one place
/// are one.
pub(crate) fn is_closed(mesh: &Mesh) -> bool {
    let mut known = HashMap::new();
    let mut place = |v: u32| {
        let next = known.len() as u32;
        *known.entry((mesh.positions[v as usize] + Vec3::ZERO).to_array().map(f32::to_bits)).or_insert(next)
    };
    let mut edges: HashMap<[u32; 2], i64> = HashMap::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(&mut place);
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
        }
    }
    edges.values().all(|&balance| balance == 0)
}

/// Volume, area, and the sum of the triangles' normals times their areas.
fn measures(mesh: &Mesh) -> (f64, f64, DVec3) {
    let corners = |t: &[u32; 3]| t.map(|v| mesh.positions[v as usize].as_dvec3());
    let origin = mesh.triangles.first().map_or(DVec3::ZERO, |t| corners(t)[0]);
    let (mut volume, mut area, mut sum) = (0.0, 0.0, DVec3::ZERO);
    for triangle in &mesh.triangles {
        let [a, b, c] = corners(triangle).map(|p| p - origin);
        let normal = 0.5 * (b - a).cross(c - a);
        volume += a.dot(normal) / 3.0;
        area += normal.length();
        sum += normal;
    }
    (volume, area, sum)
}

/// Volume of a closed mesh over its area^1.5; 0 where it has no area.
pub(crate) fn fullness(mesh: &Mesh) -> f64 {
    let (volume, area, _) = measures(mesh);
    if area > 0.0 { volume.abs() / area.powf(1.5) } else { 0.0 }
}

/// Whether a mesh is the surface of a body with its front faces on the inside.
pub(crate) fn is_inside_out(mesh: &Mesh) -> bool {
    let (volume, area, sum) = measures(mesh);
    // Quick tests first: normals of a closed surface cancel. A ball of this area has a volume of 0.09 `area`^1.5.
    volume < -1e-4 * area.powf(1.5) && sum.length() <= 1e-3 * area && is_closed(mesh)
}

/// Keeps the first of the triangles that have the same three corners in the same cyclic order.
fn drop_duplicates(mesh: &mut Mesh, report: &mut TriangleReport) {
    let positions = &mesh.positions;
    // Adding zero makes the two zeros one.
    let bits = |i: u32| (positions[i as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
    let vertex_keys: Vec<u64> = (0..positions.len() as u32)
        .into_par_iter()
        .with_min_len(1 << 12)
        .map(|i| {
            let [x, y, z] = bits(i).map(u64::from);
            mix(mix(x | (y << 32)) ^ z)
        })
        .collect();
    let key = |t: &[u32; 3]| {
        let k = t.map(|i| vertex_keys[i as usize]);
        // The same from whichever corner one starts.
        let first = (0..3).min_by_key(|&i| k[i]).unwrap_or(0);
        mix(mix(k[first] ^ k[(first + 1) % 3].rotate_left(21)) ^ k[(first + 2) % 3])
    };
    // Nearly always no key is there twice: sorting tells in a third of the time that a table takes.
    let mut keys: Vec<u64> = mesh.triangles.par_iter().with_min_len(1 << 12).map(key).collect();
    keys.par_sort_unstable();
    let repeated: HashSet<u64> = keys.windows(2).filter(|k| k[0] == k[1]).map(|k| k[0]).collect();
    drop(keys);
    if repeated.is_empty() {
        return;
    }
    let corners = |t: &[u32; 3]| {
        let c = t.map(bits);
        let first = (0..3).min_by_key(|&k| c[k]).unwrap_or(0);
        [c[first], c[(first + 1) % 3], c[(first + 2) % 3]]
    };
    // Nothing goes that was not compared with what stays.
    let mut seen = HashSet::new();
    mesh.triangles.retain(|t| {
        let stays = !repeated.contains(&key(t)) || seen.insert(corners(t));
        if !stays {
            report.duplicate += 1;
            // The one that stays was counted, too.
            report.needles -= usize::from(matches!(shape(positions, *t), Shape::Needle));
        }
        stays
    });
}

/// A well-mixed number (the two halves of a product with an odd constant, added without carry).
fn mix(v: u64) -> u64 {
    let product = u128::from(v ^ 0x9e37_79b9_7f4a_7c15) * 0xd6e8_feb8_6659_fd93_u128;
    (product >> 64) as u64 ^ product as u64
}

/// Moves a mesh that stands far from its own zero next to it, and returns by how much: to be added to its transforms in double
/// precision. No coordinate is rounded: axes move only where all vertices lie within a factor of two of the middle (Sterbenz's
/// lemma).
pub(crate) fn recentre(mesh: &mut Mesh) -> DVec3 {
    let used = || mesh.triangles.iter().flatten().map(|&i| mesh.positions[i as usize]);
    let (low, high) = used().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let middle = 0.5 * low + 0.5 * high;
    let reach = 0.5 * (high - low).max_element();
    let shift = Vec3::select(middle.abs().cmpgt(Vec3::splat(FAR * reach)), middle, Vec3::ZERO);
    if !shift.is_finite() || shift == Vec3::ZERO {
        return DVec3::ZERO;
    }
    mesh.positions.iter_mut().for_each(|p| *p -= shift);
    // Vertices that nobody uses may lie anywhere.
    mesh.positions.iter_mut().filter(|p| !p.is_finite()).for_each(|p| *p = Vec3::ZERO);
    shift.as_dvec3()
}

/// Distance of a mesh from its own zero, in halves of its size, from which on it is moved there.
const FAR: f32 = 16.0;

/// Direction of the geometric normal; zero without one.
fn direction([a, b, c]: [Vec3; 3]) -> Vec3 {
    let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
    (b - a).cross(c - a).normalize_or_zero().as_vec3()
}

/// Makes normals unit; those without a direction become the mean of their triangles' geometric normals.
fn mend_normals(mesh: &mut Mesh) {
    // Squares of very short and very long ones leave single precision.
    let unit = |n: Vec3| {
        let plain = (1e-30..1e30).contains(&n.length_squared());
        let scaled = if plain { n } else { n / n.abs().max_element() };
        scaled.try_normalize()
    };
    let units: Option<Vec<Vec3>> = mesh.normals.iter().map(|&n| unit(n)).collect();
    if let Some(units) = units {
        mesh.normals = units;
        return;
    }
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for t in &mesh.triangles {
        let n = direction(t.map(|i| mesh.positions[i as usize]));
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
