//! Up to eight triangles, and their test against a ray.

use super::kernel::{BOX_SLACK, NEARER, inverse, splat};
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
    /// By how much boxes are larger than what they hold, and what no bound of them is farther from the origin than, metres.
    padding: f32,
    extent: f32,
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
        Self { rows: vec![0.0; ROWS * primitives.len() + READ], primitives, padding: 0.0, extent: 0.0 }
    }

    /// Sets by how much boxes are larger than what they hold, and the largest coordinate of that, metres.
    pub fn set_padding(&mut self, padding: f32, extent: f32) {
        (self.padding, self.extent) = (padding, extent + padding);
    }

    pub fn extent(&self) -> f32 {
        self.extent
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
pub(super) struct Shear<N, I = f32> {
    pub axis: [usize; 3],
    /// Axes permuted.
    pub origin: [N; 3],
    pub scale: [N; 3],
    /// As [`inverse`], axes permuted.
    pub inverse: [I; 3],
}

/// What becomes a vector where it is needed: that is seldom, and vectors made for every ray cost time.
pub(super) trait Spread<N>: Copy {
    fn spread(self) -> N;
}

impl<N: Numbers> Spread<N> for f32 {
    #[inline(always)]
    fn spread(self) -> N {
        N::splat(self)
    }
}

impl<N: Numbers> Spread<N> for N {
    #[inline(always)]
    fn spread(self) -> N {
        self
    }
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
        let (o, inverse) = (ray.origin.to_array(), inverse(ray));
        let permuted = |v: [f32; 3]| splat([v[axis[0]], v[axis[1]], v[axis[2]]]);
        Self { axis, origin: permuted(o), scale: splat(scale), inverse: [inverse[axis[0]], inverse[axis[1]], inverse[axis[2]]] }
    }
}

/// Triangle tests, one per lane; lanes outside `mask` are meaningless.
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

/// The corners whose coordinates begin at `row`, axes permuted.
#[inline(always)]
fn corners_of<L: Lanes>(rows: &[f32; READ], row: usize, count: usize, ray: &Shear<L>) -> [L; 3] {
    // The compiler sees that no row is out of bounds.
    let [x, y, z] = [ray.axis[0] & 3, ray.axis[1] & 3, ray.axis[2] & 3];
    [load(rows, row + x, count), load(rows, row + y, count), load(rows, row + z, count)]
}

impl<N: Numbers, I: Spread<N>> Shear<N, I> {
    /// A corner (axes permuted) relative to the ray and sheared.
    #[inline(always)]
    fn apply(&self, [x, y, z]: [N; 3]) -> [N; 3] {
        let ([ox, oy, oz], [sx, sy, _]) = (self.origin, self.scale);
        let z = z.sub(oz);
        [x.sub(ox).sub(sx.mul(z)), y.sub(oy).sub(sy.mul(z)), z]
    }

    /// Woop, Benthin, Wald 2013, without its double-precision fallback: an edge function that rounds to zero counts as inside for
    /// both neighbours, so the ray hits at least one of them. The corners come with their axes permuted.
    ///
    /// A triangle counts if the ray meets its box, `padding` larger, and `t` is raised to where it does: a triangle seen edge-on
    /// has a `t` of roundings only, and what is found would depend on the order otherwise.
    #[inline(always)]
    fn test(&self, [a, b, c]: [[N; 3]; 3], padding: N, limit: N) -> Candidates<N> {
        let ([ax, ay, az], [bx, by, bz], [cx, cy, cz]) = (self.apply(a), self.apply(b), self.apply(c));
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
        let mut mask = inside & there & t.le(limit);
        let mut raised = t;
        if mask != 0 {
            let (mut enter, mut exit) = (zero, N::splat(f32::INFINITY));
            for k in 0..3 {
                let inverse = self.inverse[k].spread();
                let low = a[k].min(b[k]).min(c[k]).sub(padding).sub(self.origin[k]).mul(inverse);
                let high = a[k].max(b[k]).max(c[k]).add(padding).sub(self.origin[k]).mul(inverse);
                (enter, exit) = (enter.max(low.min(high)), exit.min(low.max(high)));
            }
            raised = t.max(enter.mul(N::splat(NEARER)));
            mask &= enter.le(exit.mul(N::splat(BOX_SLACK))) & raised.le(limit);
        }
        Candidates {
            mask,
            t: raised,
            weights: [u.mul(inverse), v.mul(inverse), w.mul(inverse)],
            facing: determinant.mul(self.scale[2]),
        }
    }
}

/// Tests the triangles of a leaf up to `limit`.
#[inline(always)]
pub(super) fn intersect<L: Lanes>(leaves: &Leaves, leaf: u32, ray: &Shear<L>, limit: f32) -> Candidates<L> {
    let (first, count) = range(leaf);
    let rows = leaves.read(first);
    let corners = [corners_of(rows, 0, count, ray), corners_of(rows, 3, count, ray), corners_of(rows, 6, count, ray)];
    let found = ray.test(corners, L::splat(leaves.padding), L::splat(limit));
    Candidates { mask: found.mask & (EMPTY >> (32 - count)), ..found }
}

/// Tests one triangle of a leaf against the rays of a packet up to `limit`.
#[inline(always)]
pub(super) fn intersect_packet<S: Sixteen>(
    leaves: &Leaves,
    leaf: u32,
    lane: usize,
    rays: &Shear<S, S>,
    limit: S,
) -> Candidates<S> {
    let (first, count) = range(leaf);
    let rows = leaves.read(first);
    let corners =
        [corner_for(rows, 0, lane, count, rays), corner_for(rows, 3, lane, count, rays), corner_for(rows, 6, lane, count, rays)];
    rays.test(corners, S::splat(leaves.padding), limit)
}

/// The corner of one triangle whose coordinates begin at `row`, axes permuted.
#[inline(always)]
fn corner_for<S: Sixteen>(rows: &[f32; READ], row: usize, lane: usize, count: usize, rays: &Shear<S, S>) -> [S; 3] {
    let [x, y, z] = [rays.axis[0] & 3, rays.axis[1] & 3, rays.axis[2] & 3];
    let lane = lane & 7;
    let (x, y, z) = (rows[(row + x) * count + lane], rows[(row + y) * count + lane], rows[(row + z) * count + lane]);
    [S::splat(x), S::splat(y), S::splat(z)]
}
