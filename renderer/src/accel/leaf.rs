//! Four triangles, and their test against a ray.

use super::{Candidate, EMPTY, Hit, WIDTH};
use crate::ray::{Ray, Shear};
use glam::{Vec3A, Vec4};

#[derive(Clone, Copy)]
#[repr(C, align(16))]
pub(super) struct Leaf {
    /// `vertices[corner][axis]`, one lane a triangle. Unused lanes are points, which no ray hits.
    pub vertices: [[Vec4; 3]; 3],
    pub primitives: [u32; WIDTH],
}

/// Four triangle tests; lanes outside `mask` mean nothing.
pub(super) struct Candidates {
    pub mask: u32,
    pub t: Vec4,
    pub weights: [Vec4; 3],
    /// Positive where the ray meets the front.
    pub facing: Vec4,
}

impl Leaf {
    /// No triangle.
    pub const UNUSED: Self = Self { vertices: [[Vec4::ZERO; 3]; 3], primitives: [EMPTY; WIDTH] };

    #[inline(always)]
    pub fn corners(&self, lane: usize) -> [Vec3A; 3] {
        self.vertices.map(|[x, y, z]| Vec3A::new(x[lane], y[lane], z[lane]))
    }

    /// Woop, Benthin, Wald 2013, without its double-precision fallback: an edge function that rounds to zero counts as inside for
    /// both neighbours, so the ray hits at least one of them.
    #[inline(always)]
    pub fn intersect(&self, ray: &Ray, limit: f32) -> Candidates {
        let Shear { axis, origin, scale } = &ray.shear;
        let corner = |v: &[Vec4; 3]| {
            let z = v[axis[2]] - origin[2];
            let x = (v[axis[0]] - origin[0]) - scale[0] * z;
            let y = (v[axis[1]] - origin[1]) - scale[1] * z;
            (x, y, z)
        };
        let (ax, ay, az) = corner(&self.vertices[0]);
        let (bx, by, bz) = corner(&self.vertices[1]);
        let (cx, cy, cz) = corner(&self.vertices[2]);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let determinant = u + v + w;
        let zero = Vec4::ZERO;
        let smallest = u.min(v).min(w);
        let largest = u.max(v).max(w);
        let inside = smallest.cmpge(zero) | largest.cmple(zero);
        let inverse = Vec4::ONE / determinant;
        let t = (u * az + v * bz + w * cz) * scale[2] * inverse;
        // A zero determinant makes `t` infinite or NaN, and both comparisons then fail for it.
        let mask = (inside & t.cmpgt(zero) & t.cmplt(Vec4::splat(limit.min(f32::MAX)))).bitmask();
        Candidates { mask, t, weights: [u * inverse, v * inverse, w * inverse], facing: determinant * scale[2] }
    }

    /// Shows every triangle that `ray` meets before `limit` to `see`, until it returns true; whether it did is returned. `index` is
    /// the number of this leaf.
    #[inline(always)]
    pub fn for_each(&self, ray: &Ray, limit: f32, index: u32, instance: u32, mut see: impl FnMut(Candidate) -> bool) -> bool {
        let found = self.intersect(ray, limit);
        let mut mask = found.mask;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let hit = Hit {
                t: found.t[lane],
                primitive: self.primitives[lane],
                weights: found.weights.map(|w| w[lane]),
                slot: index * WIDTH as u32 + lane as u32,
                instance,
            };
            if see(Candidate { hit, front: found.facing[lane] > 0.0 }) {
                return true;
            }
        }
        false
    }
}
