//! Ray queries: obvhs BVH2s collapsed to four-wide nodes with four-triangle leaves, and a tree over instances of them.
//!
//! The trees are built by obvhs (PLOC with reinsertion). obvhs' own ray queries are not used: their triangle test leaks at edges and
//! vertices, and testing one box at a time is half as fast. Here one ray meets four boxes or four triangles at a time
//! (`glam::Vec4`, so the code is safe and portable), and triangles are tested with the watertight test of Woop, Benthin and Wald
//! (2013): two triangles that share an edge compute bit-identical, opposite edge functions, so no ray passes between them.

mod build;
mod instances;
mod leaf;
mod refit;

pub(crate) use instances::{Instances, Placement};

use crate::ray::Ray;
use glam::{Vec3A, Vec4};
use leaf::Leaf;

const LEAF: u32 = 1 << 31;
const EMPTY: u32 = u32::MAX;
const WIDTH: usize = 4;
/// Entries a query can keep for later. The builder makes sure that no tree needs more.
const STACK: usize = 128;
/// Most triangles a tree can hold; leaf numbers have 31 bits and slots four to a leaf.
pub(crate) const MAX_TRIANGLES: usize = 1 << 28;
/// Vertices farther than this from the origin (metres) would overflow the products of the triangle test.
pub(crate) const MAX_COORDINATE: f32 = 1e12;
/// Three roundings on each side of the slab comparison (Ize 2013): 1 + 2 gamma(3).
const SLACK: f32 = 1.0 + 6.0 * f32::EPSILON;
/// [`Hit::instance`] of what lies in the world-space tree.
pub(crate) const FLATTENED: u32 = u32::MAX;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Node {
    /// Lower and upper planes of x, y, z; one lane a child. Empty lanes are inside out.
    bounds: [[Vec4; 2]; 3],
    /// Node, `LEAF |` leaf, or `EMPTY`.
    children: [u32; WIDTH],
}

/// Where a ray first meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, metres, > 0.
    pub t: f32,
    /// Index of the triangle as given to [`Accel::build`].
    pub primitive: u32,
    /// Barycentric weights of the three corners; their sum is 1 up to rounding.
    pub weights: [f32; 3],
    /// Position in the leaves.
    slot: u32,
    /// Instance whose tree was hit, or [`FLATTENED`].
    pub(crate) instance: u32,
}

/// A triangle that a ray meets, for a filter to accept or to let pass.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The hit it would be.
    pub hit: Hit,
    /// Whether the ray comes from the side from which the corners run counter-clockwise in the world.
    pub front: bool,
}

type Stack = [(u32, f32); STACK];

/// Scratch memory of a query; made once a thread, reused by every ray.
pub struct Scratch {
    stack: Stack,
    /// The tree of an instance is queried while the tree over instances is.
    inner: Stack,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stack: [(0, 0.0); STACK], inner: [(0, 0.0); STACK] }
    }
}

/// A tree over triangles.
pub struct Accel {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

impl Accel {
    /// Builds the tree. Corners must be finite and within 1e12 m of the origin; the scene compiler drops others.
    pub fn build(triangles: &[[Vec3A; 3]]) -> Self {
        build::tree(triangles)
    }

    /// Number of triangles, padding excluded.
    pub fn triangle_count(&self) -> usize {
        self.leaves.iter().map(|l| l.primitives.iter().filter(|&&p| p != EMPTY).count()).sum()
    }

    /// Bytes of nodes and leaves.
    pub fn memory(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.leaves.len() * size_of::<Leaf>()
    }

    /// Corners of all triangles, in the order of the leaves.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = [Vec3A; 3]> + '_ {
        self.leaves
            .iter()
            .flat_map(|leaf| (0..WIDTH).filter(|&lane| leaf.primitives[lane] != EMPTY).map(|lane| leaf.corners(lane)))
    }

    /// Corners of the triangle that was hit, in the space of the tree.
    #[inline]
    pub(crate) fn corners(&self, hit: &Hit) -> [Vec3A; 3] {
        self.leaves[hit.slot as usize / WIDTH].corners(hit.slot as usize % WIDTH)
    }

    /// The nearest triangle along `ray`, front or back.
    #[inline]
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        self.nearest(ray, &mut scratch.stack, f32::INFINITY)
    }

    /// Whether any triangle stands in the way of `ray`.
    #[inline]
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        self.any(ray, &mut scratch.stack)
    }

    /// The nearest triangle along `ray` that `accept` accepts. The filter sees some triangles beyond the nearest, in no order.
    #[inline]
    pub fn closest_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> Option<Hit> {
        self.nearest_where(ray, &mut scratch.stack, f32::INFINITY, FLATTENED, accept)
    }

    /// Whether any triangle that `accept` accepts stands in the way of `ray`.
    #[inline]
    pub fn occluded_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> bool {
        self.any_where(ray, &mut scratch.stack, FLATTENED, accept)
    }

    #[inline(always)]
    fn nearest(&self, ray: &Ray, stack: &mut Stack, limit: f32) -> Option<Hit> {
        let mut found: Option<(u32, f32, [f32; 3])> = None;
        traverse::<false>(&self.nodes, ray, stack, limit, |index, best| {
            let candidates = self.leaves[index as usize].intersect(ray, best);
            let mut mask = candidates.mask;
            if mask == 0 {
                return best;
            }
            let t = candidates.t.to_array();
            let mut nearest = best;
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                if t[lane] < nearest {
                    nearest = t[lane];
                    found = Some((index * WIDTH as u32 + lane as u32, nearest, candidates.weights.map(|w| w[lane])));
                }
            }
            nearest
        });
        found.map(|(slot, t, weights)| Hit {
            t,
            slot,
            weights,
            primitive: self.leaves[slot as usize / WIDTH].primitives[slot as usize % WIDTH],
            instance: FLATTENED,
        })
    }

    #[inline(always)]
    fn any(&self, ray: &Ray, stack: &mut Stack) -> bool {
        traverse::<true>(&self.nodes, ray, stack, f32::INFINITY, |index, best| {
            if self.leaves[index as usize].intersect(ray, best).mask != 0 { STOP } else { best }
        })
    }

    #[inline(always)]
    fn nearest_where(
        &self,
        ray: &Ray,
        stack: &mut Stack,
        limit: f32,
        instance: u32,
        accept: impl Fn(&Candidate) -> bool,
    ) -> Option<Hit> {
        let mut found = None;
        traverse::<false>(&self.nodes, ray, stack, limit, |index, best| {
            let mut nearest = best;
            self.leaves[index as usize].for_each(ray, best, index, instance, |candidate| {
                if candidate.hit.t < nearest && accept(&candidate) {
                    nearest = candidate.hit.t;
                    found = Some(candidate.hit);
                }
                false
            });
            nearest
        });
        found
    }

    #[inline(always)]
    fn any_where(&self, ray: &Ray, stack: &mut Stack, instance: u32, accept: impl Fn(&Candidate) -> bool) -> bool {
        traverse::<true>(&self.nodes, ray, stack, f32::INFINITY, |index, best| {
            let stop = self.leaves[index as usize].for_each(ray, best, index, instance, |candidate| accept(&candidate));
            if stop { STOP } else { best }
        })
    }
}

/// What a visitor of leaves returns to end an any-hit query.
const STOP: f32 = -1.0;

/// Calls `visit(leaf, limit)` for the leaves whose boxes `ray` meets before `limit`, nearest first; it returns the new limit. With
/// `ANY` the order is free, the limit stays, and [`STOP`] ends the query. Returns whether it was stopped.
#[inline(always)]
fn traverse<const ANY: bool>(
    nodes: &[Node],
    ray: &Ray,
    stack: &mut Stack,
    limit: f32,
    mut visit: impl FnMut(u32, f32) -> f32,
) -> bool {
    if nodes.is_empty() {
        return false;
    }
    let (mut top, mut current, mut best) = (0usize, 0u32, limit);
    let [sx, sy, sz] = &ray.slabs;
    loop {
        if current & LEAF == 0 {
            let node = &nodes[current as usize];
            let [x, y, z] = &node.bounds;
            let enter = ((x[sx.near] - sx.origin) * sx.inverse)
                .max((y[sy.near] - sy.origin) * sy.inverse)
                .max(((z[sz.near] - sz.origin) * sz.inverse).max(Vec4::ZERO));
            let exit = ((x[1 - sx.near] - sx.origin) * sx.inverse)
                .min((y[1 - sy.near] - sy.origin) * sy.inverse)
                .min(((z[1 - sz.near] - sz.origin) * sz.inverse).min(Vec4::splat(best)));
            let mut mask = enter.cmple(exit * SLACK).bitmask();
            if mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                current = node.children[lane];
                if mask == 0 {
                    continue;
                }
                let distances = enter.to_array();
                let mut distance = distances[lane];
                // Keep the nearest child; push the others so that the nearer ones are popped first.
                let base = top;
                while mask != 0 {
                    let lane = mask.trailing_zeros() as usize;
                    mask &= mask - 1;
                    let mut entry = (node.children[lane], distances[lane]);
                    if !ANY {
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
                    } else {
                        stack[top % STACK] = entry;
                    }
                    top += 1;
                }
                continue;
            }
        } else {
            let limit = visit(current & !LEAF, best);
            if ANY {
                if limit < 0.0 {
                    return true;
                }
            } else {
                best = limit;
            }
        }
        loop {
            if top == 0 {
                return false;
            }
            top -= 1;
            let (child, distance) = stack[top % STACK];
            if ANY || distance < best {
                current = child;
                break;
            }
        }
    }
}
