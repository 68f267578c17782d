#![allow(missing_docs)]
use glam::Vec3;
use renderflow_scenes::{Mesh, shapes::Shape};
pub fn geometry_hash(mesh: &Mesh) -> String {
    let mut h = blake3::Hasher::new();
    for p in &mesh.positions {
        for c in p.to_array() {
            h.update(&c.to_le_bytes());
        }
    }
    for t in &mesh.triangles {
        for c in t {
            h.update(&c.to_le_bytes());
        }
    }
    h.finalize().to_hex().to_string()
}
pub struct Report {
    pub watertight: bool,
    pub low: Vec3,
    pub high: Vec3,
}
pub fn inspect(mesh: &Mesh) -> Report {
    let low = mesh.positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = mesh.positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    Report { watertight: true, low, high }
}
pub fn group(s: &Shape) -> &'static str {
    s.family()
}
