//! What a mesh is made of: counts, closedness, volume; and a fingerprint of its geometry.

use crate::Mesh;
use glam::Vec3;
use std::collections::{HashMap, HashSet};

/// Findings of [`inspect`]. Vertices at bit-equal positions count as one.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct MeshReport {
    /// Different positions that triangles use.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Pieces that share no vertex.
    pub components: usize,
    /// Whether every edge belongs to exactly two triangles that walk it in opposite directions (and there is one at all).
    pub watertight: bool,
    /// Signed volume, the mesh's units cubed; where pieces overlap, the overlap counts for each. Positive when faces look
    /// outwards.
    pub volume: f64,
    /// Pieces of negative volume: turned inside out, or the walls of bubbles.
    pub inverted: usize,
    /// Triangles without area: a corner twice, or three in a line (less than 1e-7 of the product of two edges).
    pub degenerate: usize,
    /// Positions, normals and texture coordinates that are not finite.
    pub non_finite: usize,
    /// Lowest corner of the bounding box.
    pub low: [f32; 3],
    /// Highest corner of the bounding box.
    pub high: [f32; 3],
}

/// BLAKE3 of positions and triangles, 64 hexadecimal digits: equal for the same geometry, whatever its normals and textures.
pub fn geometry_hash(mesh: &Mesh) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(mesh.positions.len() as u64).to_le_bytes());
    let mut bytes = Vec::with_capacity(12 * mesh.positions.len().max(mesh.triangles.len()));
    for p in &mesh.positions {
        // Both zeros are one.
        p.to_array().iter().for_each(|v| bytes.extend((v + 0.0).to_le_bytes()));
    }
    hasher.update(&bytes);
    bytes.clear();
    mesh.triangles.as_flattened().iter().for_each(|i| bytes.extend(i.to_le_bytes()));
    hasher.update(&bytes);
    hasher.finalize().to_hex().to_string()
}

/// Looks a mesh over; triangles that name vertices out of range count as degenerate and are left out otherwise.
pub fn inspect(mesh: &Mesh) -> MeshReport {
    let mut ids: HashMap<[u32; 3], u32> = HashMap::new();
    let id: Vec<u32> = mesh
        .positions
        .iter()
        .map(|p| {
            let next = ids.len() as u32;
            *ids.entry(p.to_array().map(|v| (v + 0.0).to_bits())).or_insert(next)
        })
        .collect();
    let mut root: Vec<u32> = (0..ids.len() as u32).collect();
    let find = |root: &mut Vec<u32>, mut i: u32| {
        while root[i as usize] != i {
            root[i as usize] = root[root[i as usize] as usize];
            i = root[i as usize];
        }
        i
    };
    let mut edges: HashSet<(u32, u32)> = HashSet::with_capacity(3 * mesh.triangles.len());
    let (mut degenerate, mut walked_twice) = (0, false);
    let mut used = vec![false; ids.len()];
    for t in &mesh.triangles {
        let corner = |k: usize| mesh.positions.get(t[k] as usize).map(|p| p.as_dvec3());
        let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else {
            degenerate += 1;
            continue;
        };
        let (ab, ac) = (b - a, c - a);
        let area = ab.cross(ac).length();
        if area.is_nan() || area <= 1e-7 * ab.length() * ac.length() || b == c {
            degenerate += 1;
        }
        let v = t.map(|i| id[i as usize]);
        for k in 0..3 {
            used[v[k] as usize] = true;
            walked_twice |= !edges.insert((v[k], v[(k + 1) % 3]));
            let (p, q) = (find(&mut root, v[0]), find(&mut root, v[k]));
            root[q as usize] = p;
        }
    }
    let watertight = !edges.is_empty() && !walked_twice && edges.iter().all(|&(a, b)| edges.contains(&(b, a)));
    let mut volumes: HashMap<u32, f64> = HashMap::new();
    for t in mesh.triangles.iter().filter(|t| t.iter().all(|&i| (i as usize) < id.len())) {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
        let piece = find(&mut root, id[t[0] as usize]);
        *volumes.entry(piece).or_insert(0.0) += a.dot(b.cross(c)) / 6.0;
    }
    let bad = |v: &[f32]| usize::from(!v.iter().all(|c| c.is_finite()));
    let non_finite = mesh.positions.iter().chain(&mesh.normals).map(|p| bad(&p.to_array())).sum::<usize>()
        + mesh.uvs.iter().map(|p| bad(&p.to_array())).sum::<usize>();
    let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = mesh.positions.iter().fold(start, |(l, h), &p| (l.min(p), h.max(p)));
    let (low, high) = if mesh.positions.is_empty() { (Vec3::ZERO, Vec3::ZERO) } else { (low, high) };
    // Summed in a fixed order.
    let mut pieces: Vec<(u32, f64)> = volumes.into_iter().collect();
    pieces.sort_unstable_by_key(|p| p.0);
    MeshReport {
        vertices: used.iter().filter(|u| **u).count(),
        triangles: mesh.triangles.len(),
        components: pieces.len(),
        watertight,
        volume: pieces.iter().map(|p| p.1).sum(),
        inverted: pieces.iter().filter(|p| p.1 < 0.0).count(),
        degenerate,
        non_finite,
        low: low.to_array(),
        high: high.to_array(),
    }
}
