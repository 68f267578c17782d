//! Up to eight triangles, and their test against a ray.

use super::kernel::splat;
use super::simd::{Lanes, Numbers, Sixteen, WIDTH};
use super::{EMPTY, LEAF};
use crate::ray::Ray;
use glam::Vec3A;

/// Numbers of a triangle in a leaf: three corners of three coordinates.
const ROWS: usize = 9;
/// Numbers that may be read at the start of any leaf.
const READ: usize = (ROWS + 1) * WIDTH;

/// The triangles of a tree, leaf after leaf.
///
/// A leaf of `n` triangles is nine rows of `n` numbers (x, y and z of the first corners, of the second, of the third), so that a
/// triangle takes 36 bytes however full its leaf is; vectors of eight read on into the next row, and the lanes from `n` on are
/// masked. A leaf is named by `8 first + n - 1` where `first` counts the triangles before it.
#[derive(Default)]
pub(super) struct Leaves {
    rows: Vec<f32>,
    /// Numbers of the triangles, in the order of the leaves.
    primitives: Vec<u32>,
}

/// First triangle of a leaf, and how many it has.
#[inline(always)]
pub(super) fn range(leaf: u32) -> (usize, usize) {
    ((leaf >> 3) as usize, (leaf & 7) as usize + 1)
}

/// Name of the leaf of `count` triangles after `first` others.
pub(super) fn name(first: usize, count: usize) -> u32 {
    debug_assert!((1..=WIDTH).contains(&count) && first < 1 << 28);
    LEAF | (first as u32) << 3 | (count as u32 - 1)
}

impl Leaves {
    /// Leaves that hold `primitives` in this order; their corners are still to be set.
    pub fn new(primitives: Vec<u32>) -> Self {
        // What is read behind the last row is zero.
        Self { rows: vec![0.0; ROWS * primitives.len() + READ], primitives }
    }

    /// Moves the triangles of `leaf` and returns their box, unpadded.
    pub fn set(&mut self, leaf: u32, triangles: &[[Vec3A; 3]]) -> [Vec3A; 2] {
        let (first, count) = range(leaf);
        let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        let rows = &mut self.rows[ROWS * first..ROWS * (first + count)];
        for (lane, &primitive) in self.primitives[first..first + count].iter().enumerate() {
            for (corner, position) in triangles[primitive as usize].iter().enumerate() {
                (low, high) = (low.min(*position), high.max(*position));
                for axis in 0..3 {
                    rows[(3 * corner + axis) * count + lane] = position[axis];
                }
            }
        }
        [low, high]
    }

    /// Triangles, those that are in several leaves each time.
    pub fn count(&self) -> usize {
        self.primitives.len()
    }

    pub fn memory(&self) -> usize {
        size_of_val(self.rows.as_slice()) + size_of_val(self.primitives.as_slice())
    }

    /// What may be read from the leaf that begins with triangle `first`.
    #[inline(always)]
    fn read(&self, first: usize) -> &[f32; READ] {
        const NOTHING: &[f32; READ] = &[0.0; READ];
        self.rows[ROWS * first..].first_chunk().unwrap_or(NOTHING)
    }

    /// Number of the triangle in a lane.
    #[inline(always)]
    pub fn primitive(&self, leaf: u32, lane: usize) -> u32 {
        self.primitives[range(leaf).0 + lane]
    }

    #[inline(always)]
    pub fn corners(&self, leaf: u32, lane: usize) -> [Vec3A; 3] {
        let (first, count) = range(leaf);
        let rows = &self.rows[ROWS * first..ROWS * (first + count)];
        let at = |row: usize| rows[row * count + lane];
        [0, 3, 6].map(|row| Vec3A::new(at(row), at(row + 1), at(row + 2)))
    }
}

/// The transform of the watertight triangle test (Woop, Benthin, Wald 2013): `axis` is permuted so that the direction's largest
/// component comes last, and `scale` shears the direction onto that axis.
pub(super) struct Shear<N> {
    pub axis: [usize; 3],
    /// Axes permuted.
    pub origin: [N; 3],
    pub scale: [N; 3],
}

/// `axis` and `scale` of [`Shear`].
#[inline(always)]
pub(super) fn shear(ray: &Ray) -> ([usize; 3], [f32; 3]) {
    let m = ray.direction.abs();
    let axis = if m.x > m.y && m.x > m.z {
        [1, 2, 0]
    } else if m.y > m.z {
        [2, 0, 1]
    } else {
        [0, 1, 2]
    };
    let d = ray.direction.to_array();
    let inverse = 1.0 / d[axis[2]];
    (axis, [d[axis[0]] * inverse, d[axis[1]] * inverse, inverse])
}

impl<L: Lanes> Shear<L> {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let (axis, scale) = shear(ray);
        let o = ray.origin.to_array();
        Self { axis, origin: splat([o[axis[0]], o[axis[1]], o[axis[2]]]), scale: splat(scale) }
    }
}

/// Triangle tests, one a lane; lanes outside `mask` mean nothing.
pub(super) struct Candidates<N> {
    pub mask: u32,
    pub t: N,
    pub weights: [N; 3],
    /// Positive where the ray meets the front.
    pub facing: N,
}

/// Row `row` of a leaf of `count` triangles.
#[inline(always)]
fn load<L: Lanes>(rows: &[f32; READ], row: usize, count: usize) -> L {
    L::load(rows[row * count..][..WIDTH].first_chunk().unwrap_or(&[0.0; WIDTH]))
}

/// The corners whose coordinates begin at `row`, relative to the ray and sheared.
#[inline(always)]
fn corners_of<L: Lanes>(rows: &[f32; READ], row: usize, count: usize, ray: &Shear<L>) -> [L; 3] {
    // The compiler sees that no row is out of bounds.
    let [x, y, z] = [ray.axis[0] & 3, ray.axis[1] & 3, ray.axis[2] & 3];
    ray.apply([load(rows, row + x, count), load(rows, row + y, count), load(rows, row + z, count)])
}

impl<N: Numbers> Shear<N> {
    /// A corner (axes permuted) relative to the ray and sheared.
    #[inline(always)]
    fn apply(&self, [x, y, z]: [N; 3]) -> [N; 3] {
        let ([ox, oy, oz], [sx, sy, _]) = (self.origin, self.scale);
        let z = z.sub(oz);
        [x.sub(ox).sub(sx.mul(z)), y.sub(oy).sub(sy.mul(z)), z]
    }

    /// Woop, Benthin, Wald 2013, without its double-precision fallback: an edge function that rounds to zero counts as inside for
    /// both neighbours, so the ray hits at least one of them. `t` is raised to `enter`.
    #[inline(always)]
    fn test(&self, [ax, ay, az]: [N; 3], [bx, by, bz]: [N; 3], [cx, cy, cz]: [N; 3], enter: N, limit: N) -> Candidates<N> {
        let u = cx.mul(by).sub(cy.mul(bx));
        let v = ax.mul(cy).sub(ay.mul(cx));
        let w = bx.mul(ay).sub(by.mul(ax));
        let determinant = u.add(v).add(w);
        let zero = N::splat(0.0);
        let inside = zero.le(u.min(v).min(w)) | u.max(v).max(w).le(zero);
        let inverse = N::splat(1.0).div(determinant);
        let t = u.mul(az).add(v.mul(bz)).add(w.mul(cz)).mul(self.scale[2]).mul(inverse);
        // A zero determinant makes `t` infinite or NaN, and these comparisons then fail for it.
        let there = t.gt(zero) & t.le(N::splat(f32::MAX));
        let t = t.max(enter);
        let mask = inside & there & t.le(limit);
        Candidates { mask, t, weights: [u.mul(inverse), v.mul(inverse), w.mul(inverse)], facing: determinant.mul(self.scale[2]) }
    }
}

/// Tests the triangles of a leaf, whose box the ray enters at `enter`, up to `limit`.
#[inline(always)]
pub(super) fn intersect<L: Lanes>(leaves: &Leaves, leaf: u32, ray: &Shear<L>, enter: f32, limit: f32) -> Candidates<L> {
    let (first, count) = range(leaf);
    let rows = leaves.read(first);
    let (a, b, c) = (corners_of(rows, 0, count, ray), corners_of(rows, 3, count, ray), corners_of(rows, 6, count, ray));
    let found = ray.test(a, b, c, L::splat(enter), L::splat(limit));
    Candidates { mask: found.mask & (EMPTY >> (32 - count)), ..found }
}

/// Tests one triangle of a leaf against the rays of a packet, which enter the leaf's box at `enter`, up to `limit`.
#[inline(always)]
pub(super) fn intersect_packet<S: Sixteen>(
    leaves: &Leaves,
    leaf: u32,
    lane: usize,
    rays: &Shear<S>,
    enter: S,
    limit: S,
) -> Candidates<S> {
    let (first, count) = range(leaf);
    let rows = leaves.read(first);
    let (a, b, c) =
        (corner_for(rows, 0, lane, count, rays), corner_for(rows, 3, lane, count, rays), corner_for(rows, 6, lane, count, rays));
    rays.test(a, b, c, enter, limit)
}

/// The corner of one triangle whose coordinates begin at `row`, relative to the rays and sheared.
#[inline(always)]
fn corner_for<S: Sixteen>(rows: &[f32; READ], row: usize, lane: usize, count: usize, rays: &Shear<S>) -> [S; 3] {
    let [x, y, z] = [rays.axis[0] & 3, rays.axis[1] & 3, rays.axis[2] & 3];
    let lane = lane & 7;
    let (x, y, z) = (rows[(row + x) * count + lane], rows[(row + y) * count + lane], rows[(row + z) * count + lane]);
    rays.apply([S::splat(x), S::splat(y), S::splat(z)])
}
