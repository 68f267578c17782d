//! The loops of ray queries, written once for every [`Level`](super::Level).
//!
//! What a query finds does not depend on the order in which it meets things, nor on the level: of the triangles whose own box the
//! ray meets, it is the one with the smallest `t`, then the smallest number. For that to be exact no box may be farther than what
//! it holds. Boxes that hold others are entered no later (the plain slab test is monotonic in the planes, roundings included, and
//! the padded one lets pass more), and `t` is raised to where the ray enters the triangle's box if its rounding errors put it
//! before, as may happen to a triangle seen edge-on.

use super::leaf::{self, Shear};
use super::simd::{Lanes, Numbers, WIDTH};
use super::{EMPTY, LEAF, Leaves, Node, STACK, Stack};
use crate::ray::Ray;
use glam::Vec3A;

/// Three roundings on each side of the slab comparison take 1 + 2 gamma(3) = 1 + 2^-21 (Ize 2013); the rest covers [`NEARER`].
pub(super) const SLACK: f32 = 1.0 + 16.0 * f32::EPSILON;
/// A triangle's box is entered at this times the distance at the latest: half a dozen roundings of a triangle's `t` do not put it
/// before.
pub(super) const NEARER: f32 = 1.0 - 8.0 * f32::EPSILON;
/// More than the inverse of [`NEARER`].
const FURTHER: f32 = 1.0 + 16.0 * f32::EPSILON;
/// As [`SLACK`], without the rest.
pub(super) const BOX_SLACK: f32 = 1.0 + 4.0 * f32::EPSILON;

/// How a ray meets the boxes of a node.
pub(super) trait Meet<L> {
    /// NaN would pass the test of lanes that are empty.
    fn finite(&self) -> bool;
    /// Where the boxes are entered, and which are before `reach`.
    fn meet(&self, node: &Node, reach: f32) -> (L, u32);
}

/// A ray, prepared for the slab test.
pub(super) struct Slabs<L> {
    origin: [L; 3],
    inverse: [L; 3],
    /// Rows of a node's bounds that are entered first; the last ones are their neighbours.
    near: [usize; 3],
    finite: bool,
}

impl<L: Lanes> Slabs<L> {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let inverse = inverse(ray);
        Self {
            origin: splat(ray.origin.to_array()),
            inverse: splat(inverse),
            near: [0, 1, 2].map(|a| 2 * a + usize::from(inverse[a] < 0.0)),
            finite: (ray.origin + ray.direction).is_finite(),
        }
    }
}

#[inline(always)]
pub(super) fn splat<N: Numbers>([x, y, z]: [f32; 3]) -> [N; 3] {
    [N::splat(x), N::splat(y), N::splat(z)]
}

impl<L: Lanes> Meet<L> for Slabs<L> {
    #[inline(always)]
    fn finite(&self) -> bool {
        self.finite
    }

    #[inline(always)]
    fn meet(&self, node: &Node, reach: f32) -> (L, u32) {
        let [nx, ny, nz] = self.near.map(|n| n & 7);
        let plane = |row: usize, axis: usize| L::load(&node.bounds[row]).sub(self.origin[axis]).mul(self.inverse[axis]);
        let enter = plane(nx, 0).max(plane(ny, 1)).max(plane(nz, 2).max(L::splat(0.0)));
        let exit = plane(nx ^ 1, 0).min(plane(ny ^ 1, 1)).min(plane(nz ^ 1, 2).min(L::splat(reach)));
        (enter, enter.le(exit.mul(L::splat(SLACK))))
    }
}

/// A ray as the slab test wants it whose distances to planes are `plane * inverse - origin * inverse`, in one fused step where
/// the processor has one: rays that go through many nodes are up to 9% faster, packets and shadow rays that are soon stopped up
/// to 11% slower by what their hits take. The difference cancels, so planes are put nearer or farther by more than all roundings,
/// with which the boxes hold what [`Slabs`] finds in them.
pub(super) struct Padded<L> {
    inverse: [L; 3],
    near_offset: [L; 3],
    far_offset: [L; 3],
    near: [usize; 3],
}

impl<L: Lanes> Padded<L> {
    /// `None` where products might overflow or vanish, as along the axes: [`Slabs`] are for those. All bounds are within
    /// `extent`.
    #[inline(always)]
    pub fn new(ray: &Ray, extent: f32) -> Option<Self> {
        let inverse = ray.direction.recip();
        let size = inverse.abs();
        let largest = ray.origin.abs().max_element().max(extent);
        // Written so that NaN fails.
        let within = size.cmpge(Vec3A::splat(2f32.powi(-60))) & size.cmple(Vec3A::splat(2f32.powi(60)));
        if !(within.all() && largest <= 2f32.powi(50) && extent >= 2f32.powi(-30) && ray.origin.is_finite()) {
            return None;
        }
        // In units of 2^-24 `size` `largest`: distances here are wrong by up to 5 (origin times inverse 1, its sum with this 1,
        // the distance 2 and one more where nothing is fused), those of the plain test by 4, and that lets pass 16 more
        // ([`BOX_SLACK`]).
        let padding = size * (largest * 2f32.powi(-19));
        let offset = -(ray.origin * inverse);
        let inverse = inverse.to_array();
        Some(Self {
            inverse: splat(inverse),
            near_offset: splat((offset - padding).to_array()),
            far_offset: splat((offset + padding).to_array()),
            near: [0, 1, 2].map(|a| 2 * a + usize::from(inverse[a] < 0.0)),
        })
    }
}

impl<L: Lanes> Meet<L> for Padded<L> {
    #[inline(always)]
    fn finite(&self) -> bool {
        true
    }

    #[inline(always)]
    fn meet(&self, node: &Node, reach: f32) -> (L, u32) {
        let [nx, ny, nz] = self.near.map(|n| n & 7);
        let plane =
            |row: usize, axis: usize, offset: &[L; 3]| L::load(&node.bounds[row]).mul_add(self.inverse[axis], offset[axis]);
        let (near, far) = (&self.near_offset, &self.far_offset);
        let enter = plane(nx, 0, near).max(plane(ny, 1, near)).max(plane(nz, 2, near).max(L::splat(0.0)));
        let exit = plane(nx ^ 1, 0, far).min(plane(ny ^ 1, 1, far)).min(plane(nz ^ 1, 2, far).min(L::splat(reach)));
        (enter, enter.le(exit))
    }
}

/// A zero component of the direction gives an infinite inverse, and 0 * inf would be NaN in the slab test; the largest finite
/// number is as good, because node boxes are padded and so never start exactly at the origin's plane.
#[inline(always)]
pub(super) fn inverse(ray: &Ray) -> [f32; 3] {
    ray.direction.recip().clamp(Vec3A::splat(-f32::MAX), Vec3A::splat(f32::MAX)).to_array()
}

/// What a query does at a leaf whose box the ray enters at `enter`: looks for triangles up to `limit` and returns the new limit.
/// [`STOP`] ends an any-hit query.
pub(super) trait Visit {
    fn leaf(&mut self, leaf: u32, enter: f32, limit: f32) -> f32;
}

/// Ends an any-hit query.
pub(super) const STOP: f32 = -1.0;

/// Shows `visit` the leaves whose boxes the ray meets before `limit`, nearest first; with `ANY` the order is free and the limit
/// stays. Returns whether it was stopped.
#[inline(always)]
pub(super) fn traverse<L: Lanes, const ANY: bool>(
    nodes: &[Node],
    ray: &impl Meet<L>,
    stack: &mut Stack,
    limit: f32,
    visit: &mut impl Visit,
) -> bool {
    if nodes.is_empty() || !ray.finite() {
        return false;
    }
    let (mut top, mut current, mut distance, mut best) = (0usize, 0u32, 0.0f32, limit);
    let mut reach = best * FURTHER;
    loop {
        if current & LEAF == 0 {
            let node = &nodes[current as usize];
            let (enter, mut mask) = ray.meet(node, reach);
            if mask != 0 {
                let distances = enter.store();
                let lane = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                current = node.children[lane];
                distance = distances[lane];
                if mask == 0 {
                    continue;
                }
                // 3 to 4% of shuffled rays' time; nothing lost on others.
                let mut rest = mask;
                while rest != 0 {
                    let child = node.children[rest.trailing_zeros() as usize % WIDTH];
                    rest &= rest - 1;
                    if child & LEAF == 0 {
                        L::prefetch(nodes, child as usize);
                    }
                }
                // A branch or a select for two children alone was no faster than this loop.
                let base = top;
                while mask != 0 {
                    // Any-hit queries take the first lanes first, which have the largest boxes; others the nearest boxes.
                    let lane = if ANY { 31 - mask.leading_zeros() } else { mask.trailing_zeros() } as usize % WIDTH;
                    mask ^= 1 << lane;
                    let mut entry = (node.children[lane], distances[lane]);
                    if ANY {
                        stack[top % STACK] = entry;
                    } else {
                        if entry.1 < distance {
                            std::mem::swap(&mut current, &mut entry.0);
                            std::mem::swap(&mut distance, &mut entry.1);
                        }
                        let mut hole = top;
                        while hole > base && stack[(hole - 1) % STACK].1 < entry.1 {
                            stack[hole % STACK] = stack[(hole - 1) % STACK];
                            hole -= 1;
                        }
                        stack[hole % STACK] = entry;
                    }
                    top += 1;
                }
                continue;
            }
        } else {
            let limit = visit.leaf(current & !LEAF, distance * NEARER, best);
            if ANY {
                if limit < 0.0 {
                    return true;
                }
            } else {
                best = limit;
                reach = best * FURTHER;
            }
        }
        loop {
            if top == 0 {
                return false;
            }
            top -= 1;
            (current, distance) = stack[top % STACK];
            if ANY || distance <= reach {
                break;
            }
        }
    }
}

/// The nearest triangle so far.
#[derive(Clone, Copy)]
pub(super) struct Nearest {
    pub t: f32,
    /// Triangles at `t` must have a smaller number than this.
    pub primitive: u32,
    pub leaf: u32,
    pub lane: u8,
    pub weights: [f32; 3],
}

impl Nearest {
    /// Nothing, before `limit`; at it if `ties`.
    #[inline(always)]
    pub fn none(limit: f32, ties: bool) -> Self {
        Self { t: limit, primitive: if ties { EMPTY } else { 0 }, leaf: EMPTY, lane: 0, weights: [0.0; 3] }
    }

    #[inline(always)]
    pub fn found(&self) -> bool {
        self.leaf != EMPTY
    }

    #[inline(always)]
    pub fn replaced_by(&self, t: f32, primitive: u32) -> bool {
        t < self.t || t == self.t && primitive < self.primitive
    }
}

/// Looks for the nearest triangle.
pub(super) struct Closest<'a, L> {
    pub leaves: &'a Leaves,
    pub shear: &'a Shear<L>,
    pub nearest: Nearest,
}

impl<L: Lanes> Visit for Closest<'_, L> {
    #[inline(always)]
    fn leaf(&mut self, leaf: u32, _: f32, limit: f32) -> f32 {
        let found = leaf::intersect(self.leaves, leaf, self.shear, limit);
        let mut mask = found.mask;
        if mask == 0 {
            return limit;
        }
        let t = found.t.store();
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % WIDTH;
            mask &= mask - 1;
            let primitive = self.leaves.primitive(leaf, lane);
            if self.nearest.replaced_by(t[lane], primitive) {
                let [u, v, w] = &found.weights;
                let weights = [u.store()[lane], v.store()[lane], w.store()[lane]];
                self.nearest = Nearest { t: t[lane], primitive, leaf, lane: lane as u8, weights };
            }
        }
        self.nearest.t
    }
}

/// Looks for any triangle.
pub(super) struct Any<'a, L> {
    pub leaves: &'a Leaves,
    pub shear: &'a Shear<L>,
}

impl<L: Lanes> Visit for Any<'_, L> {
    #[inline(always)]
    fn leaf(&mut self, leaf: u32, _: f32, limit: f32) -> f32 {
        if leaf::intersect(self.leaves, leaf, self.shear, limit).mask != 0 { STOP } else { limit }
    }
}
