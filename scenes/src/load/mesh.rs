//! Repairs that every loaded mesh goes through: a renderer may rely on finite, in-range, non-degenerate triangles.

use crate::{Mesh, TriangleReport};
use glam::{DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::{BuildHasherDefault, Hasher};

/// Drops triangles that cannot be rendered and those that are there twice, and mends normals, coordinates and tangents.
pub(crate) fn clean(mesh: &mut Mesh) -> TriangleReport {
    let mut report = TriangleReport::default();
    let positions = &mesh.positions;
    mesh.triangles.retain(|t| {
        let counter = match shape(positions, *t) {
            Shape::Good => return true,
            Shape::Needle => {
                report.needles += 1;
                return true;
            }
            Shape::OutOfRange => &mut report.out_of_range,
            Shape::NotFinite => &mut report.not_finite,
            Shape::NoArea => &mut report.no_area,
        };
        *counter += 1;
        false
    });
    drop_duplicates(mesh, &mut report);
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
    // Squares of single-precision products stay within double precision: 1e-45 and 3e38 to the fourth power.
    let area = ab.cross(ac).length();
    // Rounding of the cross product: less than 2^-51 of the product of the edges.
    if area <= ab.length() * ac.length() * (2.0 * f64::EPSILON) {
        return Shape::NoArea;
    }
    let longest = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    if longest > TriangleReport::NEEDLE * area { Shape::Needle } else { Shape::Good }
}

/// Keeps the first of the triangles that have the same three corners in the same cyclic order. 30 ms a million triangles.
fn drop_duplicates(mesh: &mut Mesh, report: &mut TriangleReport) {
    let positions = &mesh.positions;
    // Adding zero makes the two zeros one.
    let bits = |i: u32| (positions[i as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
    let corners = |t: [u32; 3]| {
        let c = t.map(bits);
        let first = (0..3).min_by_key(|&k| c[k]).unwrap_or(0);
        [c[first], c[(first + 1) % 3], c[(first + 2) % 3]]
    };
    let mut seen: HashMap<u64, [u32; 3], BuildHasherDefault<Keyed>> =
        HashMap::with_capacity_and_hasher(mesh.triangles.len(), BuildHasherDefault::default());
    mesh.triangles.retain(|&t| {
        let mine = corners(t);
        let key = mine.as_flattened().iter().fold(0x9e37_79b9_7f4a_7c15_u64, |h, &word| {
            let mixed = u128::from(h ^ u64::from(word)) * 0xd6e8_feb8_6659_fd93_u128;
            (mixed >> 64) as u64 ^ mixed as u64
        });
        match seen.entry(key) {
            Entry::Vacant(free) => {
                free.insert(t);
                true
            }
            // Another triangle with the same key stays: nothing is dropped that was not compared.
            Entry::Occupied(other) => {
                let duplicate = corners(*other.get()) == mine;
                if duplicate {
                    report.duplicate += 1;
                    // The one that stays was counted, too.
                    report.needles -= usize::from(matches!(shape(positions, t), Shape::Needle));
                }
                !duplicate
            }
        }
    });
}

/// Takes numbers that are well mixed already.
#[derive(Default)]
struct Keyed(u64);

impl Hasher for Keyed {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(u64::from(b)));
    }

    fn write_u64(&mut self, value: u64) {
        self.0 = self.0.rotate_left(5) ^ value;
    }
}

/// Moves a mesh that stands far from its own zero next to it, and returns by how much: to be added to its transforms in double
/// precision. No coordinate is rounded: axes move only where all vertices lie within a factor of two of the middle (Sterbenz's lemma).
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
    let unit = |n: Vec3| n.try_normalize();
    if mesh.normals.iter().all(|&n| unit(n).is_some()) {
        mesh.normals.iter_mut().for_each(|n| *n = n.normalize());
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
