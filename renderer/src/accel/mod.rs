//! Ray queries: obvhs BVH2s collapsed to eight-wide nodes with leaves of up to eight triangles, and a tree over instances of
//! them.
//!
//! The trees are built by obvhs (PLOC with reinsertion). obvhs' own ray queries are not used: their triangle test leaks at edges
//! and vertices, and testing one box at a time is half as fast. Here one ray meets eight boxes or eight triangles at a time, with
//! the instructions that the processor has (see [`Level`]), and triangles are tested with the watertight test of Woop, Benthin
//! and Wald (2013): two triangles that share an edge compute bit-identical, opposite edge functions, so no ray passes between
//! them.

mod build;
mod collapse;
mod instances;
mod kernel;
mod leaf;
mod packet;
mod ploc;
mod queries;
mod refit;
mod simd;

pub(crate) use instances::{Instances, Placement};
pub use simd::Level;

use crate::ray::Ray;
use glam::Vec3A;
use leaf::Leaves;
use obvhs::aabb::Aabb;
use packet::PacketQuery;
use queries::{All, AnyQuery, ClosestQuery};
use simd::{PACKET, WIDTH};

const LEAF: u32 = 1 << 31;
const EMPTY: u32 = u32::MAX;
/// Entries a query can keep for later. The builder makes sure that no tree needs more.
const STACK: usize = 256;
/// Most triangles a tree can hold: leaves are named by 28 bits of their first.
pub(crate) const MAX_TRIANGLES: usize = (1 << 28) - WIDTH;
/// Vertices farther than this from the origin (metres) would overflow the products of the triangle test.
pub(crate) const MAX_COORDINATE: f32 = 1e12;
/// [`Hit::instance`] of what lies in the world-space tree.
pub(crate) const FLATTENED: u32 = u32::MAX;

#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct Node {
    /// Lower and upper planes of x, of y, of z; one lane a child. Empty lanes are inside out.
    bounds: [[f32; WIDTH]; 6],
    /// Node, name of a leaf (see [`Leaves`]) with `LEAF` set, or `EMPTY`.
    children: [u32; WIDTH],
}

impl Node {
    const EMPTY: Self = Self {
        bounds: [
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
            [f32::INFINITY; WIDTH],
            [f32::NEG_INFINITY; WIDTH],
        ],
        children: [EMPTY; WIDTH],
    };

    fn set_bounds(&mut self, lane: usize, [low, high]: [Vec3A; 2], padding: Vec3A) {
        let (low, high) = (low - padding, high + padding);
        for axis in 0..3 {
            self.bounds[2 * axis][lane] = low[axis];
            self.bounds[2 * axis + 1][lane] = high[axis];
        }
    }

    /// Lower and upper corner of a child's box.
    fn child_bounds(&self, lane: usize) -> [Vec3A; 2] {
        [0, 1].map(|side| Vec3A::from_array([0, 1, 2].map(|axis| self.bounds[2 * axis + side][lane])))
    }

    /// Lanes in use.
    fn lanes(&self) -> impl Iterator<Item = usize> {
        let children = self.children;
        (0..WIDTH).filter(move |&lane| children[lane] != EMPTY)
    }
}

/// Nodes, and what their leaves stand for.
#[derive(Default)]
struct Tree {
    nodes: Vec<Node>,
    /// Numbers of the things, in the order of the leaves.
    order: Vec<u32>,
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
    /// Name of the leaf.
    leaf: u32,
    /// Place in the leaf.
    lane: u8,
    /// Instance whose tree was hit, or [`FLATTENED`].
    pub(crate) instance: u32,
}

/// A triangle that a ray meets; a filter accepts it or lets the ray pass.
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
    packet: [packet::Entry; STACK],
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stack: [(0, 0.0); STACK], inner: [(0, 0.0); STACK], packet: [(0, 0, 0.0); STACK] }
    }
}

/// A tree over triangles.
pub struct Accel {
    nodes: Vec<Node>,
    leaves: Leaves,
    level: Level,
    /// Cost of a ray by the surface area heuristic, in nodes, now and when the tree was built.
    cost: f32,
    built_cost: f32,
}

impl Accel {
    /// Builds the tree. Corners must be finite and within 1e12 m of the origin; the scene compiler drops others.
    pub fn build(triangles: &[[Vec3A; 3]]) -> Self {
        Self::build_for(triangles, Level::best())
    }

    /// As [`Self::build`], for queries with the instructions of `level`. All levels find the same hits, bit for bit.
    pub fn build_for(triangles: &[[Vec3A; 3]], level: Level) -> Self {
        let boxes: Vec<Aabb> = triangles.iter().map(|t| Aabb::from_points(t)).collect();
        let Tree { nodes, order } = build::tree(&boxes, WIDTH);
        let mut tree = Self { nodes, leaves: Leaves::new(order), level, cost: 0.0, built_cost: 0.0 };
        tree.built_cost = tree.fit(triangles);
        tree.cost = tree.built_cost;
        tree
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.leaves.count()
    }

    /// Bytes of nodes and leaves.
    pub fn memory(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + self.leaves.memory()
    }

    /// Calls `open` with the boxes of the tree from above (lower and upper corner) and, where it says so, with those inside, down
    /// to `triangle` with the corners of triangles.
    pub(crate) fn walk(&self, mut open: impl FnMut([Vec3A; 2]) -> bool, mut triangle: impl FnMut([Vec3A; 3])) {
        let mut todo: Vec<u32> = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(index) = todo.pop() {
            let node = &self.nodes[index as usize];
            for lane in node.lanes().filter(|&lane| open(node.child_bounds(lane))) {
                let child = node.children[lane];
                if child & LEAF == 0 {
                    todo.push(child);
                } else {
                    let leaf = child & !LEAF;
                    (0..leaf::range(leaf).1).for_each(|lane| triangle(self.leaves.corners(leaf, lane)));
                }
            }
        }
    }

    /// Corners of all triangles, in the order of the leaves.
    #[cfg(test)]
    fn triangles(&self) -> impl Iterator<Item = [Vec3A; 3]> + '_ {
        let leaves = self.nodes.iter().flat_map(|n| n.children).filter(|&c| c & LEAF != 0 && c != EMPTY).map(|c| c & !LEAF);
        leaves.flat_map(move |leaf| (0..leaf::range(leaf).1).map(move |lane| self.leaves.corners(leaf, lane)))
    }

    /// Corners of the triangle that was hit, in the space of the tree.
    #[inline]
    pub fn corners(&self, hit: &Hit) -> [Vec3A; 3] {
        self.leaves.corners(hit.leaf, hit.lane.into())
    }

    /// The nearest triangle along `ray`, front or back; of several at the same distance that with the lowest number.
    #[inline]
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        simd::run(self.level, ClosestQuery { tree: self, ray, scratch, filter: All })
    }

    /// [`Self::closest`] of each ray, the same hits bit for bit. Rays are traced up to sixteen at a time, which is several times
    /// as fast where those have one origin and directions close to each other, as camera rays of 4 x 4 pixels; sixteen whose
    /// directions differ in a sign or in the largest component are traced one by one. `hits` is as long as `rays`; what is in it
    /// does not matter.
    pub fn closest_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) {
        for (rays, hits) in rays.chunks(PACKET).zip(hits.chunks_mut(PACKET)) {
            let traced = rays.len() > 2 && simd::run(self.level, PacketQuery { tree: self, rays, hits, scratch });
            if !traced {
                for (ray, hit) in rays.iter().zip(hits) {
                    *hit = self.closest(ray, scratch);
                }
            }
        }
    }

    /// Whether any triangle stands in the way of `ray`.
    #[inline]
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        simd::run(self.level, AnyQuery { tree: self, ray, scratch, filter: All })
    }

    /// The nearest triangle along `ray` that `accept` accepts. The filter sees some triangles beyond the nearest, in no order.
    #[inline]
    pub fn closest_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> Option<Hit> {
        simd::run(self.level, ClosestQuery { tree: self, ray, scratch, filter: accept })
    }

    /// Whether any triangle that `accept` accepts stands in the way of `ray`.
    #[inline]
    pub fn occluded_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> bool {
        simd::run(self.level, AnyQuery { tree: self, ray, scratch, filter: accept })
    }
}

#[cfg(test)]
mod tests;
