//! Ray queries: an obvhs BVH2 collapsed to four-wide nodes with four-triangle leaves.
//!
//! The tree is built by obvhs (PLOC with reinsertion). obvhs' own ray queries are not used: their triangle test leaks at edges and
//! vertices, and testing one box at a time is half as fast. Here one ray meets four boxes or four triangles at a time
//! (`glam::Vec4`, so the code is safe and portable), and triangles are tested with the watertight test of Woop, Benthin and Wald
//! (2013): two triangles that share an edge compute bit-identical, opposite edge functions, so no ray passes between them.

use crate::ray::{Ray, Shear};
use glam::{Vec3A, Vec4};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::triangle::Triangle;

const LEAF: u32 = 1 << 31;
const EMPTY: u32 = u32::MAX;
const WIDTH: usize = 4;
/// Entries a query can keep for later. [`Accel::build`] makes sure that no tree needs more.
const STACK: usize = 128;
/// Most triangles a tree can hold; leaf numbers have 31 bits and slots four to a leaf.
pub(crate) const MAX_TRIANGLES: usize = 1 << 28;
/// Vertices farther than this from the origin (metres) would overflow the products of the triangle test.
pub(crate) const MAX_COORDINATE: f32 = 1e12;
/// Triangles that may share one bounding box before obvhs is passed by: PLOC then merges one pair a round, which takes quadratic
/// time (20 000 identical triangles: 12 s, a tree 20 000 deep).
const MOST_IDENTICAL: u32 = 1000;
/// Three roundings on each side of the slab comparison (Ize 2013): 1 + 2 gamma(3).
const SLACK: f32 = 1.0 + 6.0 * f32::EPSILON;

#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Node {
    /// Lower and upper planes of x, y, z; one lane a child. Empty lanes are inside out.
    bounds: [[Vec4; 2]; 3],
    /// Node, `LEAF |` leaf, or `EMPTY`.
    children: [u32; WIDTH],
}

#[derive(Clone, Copy)]
#[repr(C, align(16))]
struct Leaf {
    /// `vertices[corner][axis]`, one lane a triangle. Unused lanes are points, which no ray hits.
    vertices: [[Vec4; 3]; 3],
    primitives: [u32; WIDTH],
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
    slot: u32,
}

/// Scratch memory of a query; made once a thread, reused by every ray.
pub struct Scratch {
    stack: [(u32, f32); STACK],
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stack: [(0, 0.0); STACK] }
    }
}

/// A tree over world-space triangles.
pub struct Accel {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

impl Accel {
    /// Builds the tree. Corners must be finite and within 1e12 m of the origin; the scene compiler drops others.
    pub fn build(triangles: &[[Vec3A; 3]]) -> Self {
        if triangles.is_empty() {
            return Self { nodes: Vec::new(), leaves: Vec::new() };
        }
        if most_identical_bounds(triangles) > MOST_IDENTICAL {
            return Collapse::run(&balanced(triangles), triangles);
        }
        let corners: Vec<Triangle> = triangles.iter().map(|&[v0, v1, v2]| Triangle { v0, v1, v2 }).collect();
        let parameters = BvhBuildParams { max_prims_per_leaf: WIDTH as u32, ..BvhBuildParams::medium_build() };
        let binary = build_bvh2_from_tris(&corners, parameters, &mut std::time::Duration::default());
        let tree = Collapse::run(&binary, triangles);
        if tree.stack_need(0) <= STACK {
            return tree;
        }
        // Adversarial input (many nested boxes) can make a tree too deep for the stack.
        Collapse::run(&balanced(triangles), triangles)
    }

    /// Number of triangles, padding excluded.
    pub fn triangle_count(&self) -> usize {
        self.leaves.iter().map(|l| l.primitives.iter().filter(|&&p| p != EMPTY).count()).sum()
    }

    /// Corners of all triangles, in the order of the leaves.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = [Vec3A; 3]> + '_ {
        self.leaves
            .iter()
            .flat_map(|leaf| (0..WIDTH).filter(|&lane| leaf.primitives[lane] != EMPTY).map(|lane| leaf.corners(lane)))
    }

    /// Corners of the triangle that was hit.
    #[inline]
    pub(crate) fn corners(&self, hit: &Hit) -> [Vec3A; 3] {
        self.leaves[hit.slot as usize / WIDTH].corners(hit.slot as usize % WIDTH)
    }

    /// Stack entries that a query below `node` may need at once.
    fn stack_need(&self, node: u32) -> usize {
        // An explicit stack: the trees this is meant to find are too deep for recursion.
        let mut worst = 0;
        let mut todo = vec![(node, 0usize)];
        while let Some((index, held)) = todo.pop() {
            let children = self.nodes[index as usize].children;
            let held = held + children.iter().filter(|&&c| c != EMPTY).count();
            worst = worst.max(held);
            todo.extend(children.iter().filter(|&&c| c & LEAF == 0).map(|&c| (c, held - 1)));
        }
        worst
    }

    /// The nearest triangle along `ray`, front or back.
    #[inline]
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        let mut found: Option<(u32, f32, [f32; 3])> = None;
        self.traverse::<false>(ray, scratch, |leaf_index, candidates, best| {
            let t = candidates.t.to_array();
            let mut mask = candidates.mask;
            let mut nearest = best;
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                if t[lane] < nearest {
                    nearest = t[lane];
                    found = Some(((leaf_index * WIDTH + lane) as u32, nearest, candidates.weights.map(|w| w[lane])));
                }
            }
            nearest
        });
        found.map(|(slot, t, weights)| Hit {
            t,
            slot,
            weights,
            primitive: self.leaves[slot as usize / WIDTH].primitives[slot as usize % WIDTH],
        })
    }

    /// Whether any triangle stands in the way of `ray`.
    #[inline]
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        self.traverse::<true>(ray, scratch, |_, _, best| best)
    }

    /// Visits leaves with a candidate nearest first; `report` returns the new distance limit. With `ANY`, stops at the first candidate.
    /// Returns whether there was one.
    #[inline(always)]
    fn traverse<const ANY: bool>(
        &self,
        ray: &Ray,
        scratch: &mut Scratch,
        mut report: impl FnMut(usize, &Candidates, f32) -> f32,
    ) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let stack = &mut scratch.stack;
        let (mut top, mut current, mut best, mut any) = (0usize, 0u32, f32::INFINITY, false);
        let [sx, sy, sz] = &ray.slabs;
        loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
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
                let index = (current & !LEAF) as usize;
                let candidates = self.leaves[index].intersect(ray, best);
                if candidates.mask != 0 {
                    any = true;
                    if ANY {
                        return true;
                    }
                    best = report(index, &candidates, best);
                }
            }
            loop {
                if top == 0 {
                    return any;
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
}

/// Four triangle tests; lanes outside `mask` mean nothing.
struct Candidates {
    mask: u32,
    t: Vec4,
    weights: [Vec4; 3],
}

impl Leaf {
    #[inline(always)]
    fn corners(&self, lane: usize) -> [Vec3A; 3] {
        self.vertices.map(|[x, y, z]| Vec3A::new(x[lane], y[lane], z[lane]))
    }

    /// Woop, Benthin, Wald 2013, without its double-precision fallback: an edge function that rounds to zero counts as inside for
    /// both neighbours, so the ray hits at least one of them.
    #[inline(always)]
    fn intersect(&self, ray: &Ray, limit: f32) -> Candidates {
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
        Candidates { mask, t, weights: [u * inverse, v * inverse, w * inverse] }
    }
}

/// Collapses a BVH2 into the four-wide tree.
struct Collapse<'a> {
    binary: &'a Bvh2,
    triangles: &'a [[Vec3A; 3]],
    /// Triangles below each BVH2 node.
    counts: Vec<u32>,
    /// Absolute padding of every box, metres.
    padding: Vec3A,
    tree: Accel,
}

impl<'a> Collapse<'a> {
    fn run(binary: &'a Bvh2, triangles: &'a [[Vec3A; 3]]) -> Accel {
        let mut order = vec![0u32];
        let mut next = 0;
        while next < order.len() {
            let node = &binary.nodes[order[next] as usize];
            if !node.is_leaf() {
                order.extend([node.first_index, node.first_index + 1]);
            }
            next += 1;
        }
        let mut counts = vec![0u32; binary.nodes.len()];
        for &index in order.iter().rev() {
            let node = &binary.nodes[index as usize];
            counts[index as usize] = if node.is_leaf() {
                node.prim_count
            } else {
                counts[node.first_index as usize] + counts[node.first_index as usize + 1]
            };
        }
        let root = binary.nodes[0].aabb();
        // A quarter of a millionth of the scene's extent: more than what the triangle test's roundings can move a hit out of its box.
        let padding = Vec3A::splat(root.min.abs().max(root.max.abs()).max_element() * 2f32.powi(-22));
        let tree = Accel { nodes: Vec::new(), leaves: Vec::new() };
        let mut collapse = Self { binary, triangles, counts, padding, tree };
        collapse.fill();
        collapse.tree
    }

    fn node(&self, index: u32) -> &Bvh2Node {
        &self.binary.nodes[index as usize]
    }

    /// Whether the subtree becomes one leaf.
    fn is_leaf(&self, index: u32) -> bool {
        self.node(index).is_leaf() || self.counts[index as usize] <= WIDTH as u32
    }

    fn fill(&mut self) {
        let empty = Node { bounds: [[Vec4::INFINITY, Vec4::NEG_INFINITY]; 3], children: [EMPTY; WIDTH] };
        self.tree.nodes.push(empty);
        let mut todo = vec![(0u32, 0usize)];
        while let Some((binary, wide)) = todo.pop() {
            // Open the child with the largest surface until four stand side by side.
            let mut children = vec![binary];
            while children.len() < WIDTH {
                let openable = |c: u32| children.len() == 1 && !self.node(c).is_leaf() || !self.is_leaf(c);
                let largest = (0..children.len()).filter(|&i| openable(children[i])).max_by(|&i, &j| {
                    let area = |k: usize| self.node(children[k]).aabb().half_area();
                    area(i).total_cmp(&area(j))
                });
                let Some(position) = largest else { break };
                let first = self.node(children.swap_remove(position)).first_index;
                children.extend([first, first + 1]);
            }
            let mut node = empty;
            for (lane, &child) in children.iter().enumerate() {
                let bounds = self.node(child).aabb();
                let (low, high) = ((bounds.min - self.padding).to_array(), (bounds.max + self.padding).to_array());
                for axis in 0..3 {
                    node.bounds[axis][0][lane] = low[axis];
                    node.bounds[axis][1][lane] = high[axis];
                }
                node.children[lane] = if self.is_leaf(child) {
                    LEAF | self.leaf(child)
                } else {
                    self.tree.nodes.push(empty);
                    todo.push((child, self.tree.nodes.len() - 1));
                    self.tree.nodes.len() as u32 - 1
                };
            }
            self.tree.nodes[wide] = node;
        }
    }

    /// Appends the leaf of a subtree with at most four triangles and returns its number.
    fn leaf(&mut self, root: u32) -> u32 {
        let mut leaf = Leaf { vertices: [[Vec4::ZERO; 3]; 3], primitives: [EMPTY; WIDTH] };
        let mut lane = 0;
        let mut todo = vec![root];
        while let Some(index) = todo.pop() {
            let node = &self.binary.nodes[index as usize];
            if !node.is_leaf() {
                todo.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            for slot in node.first_index..node.first_index + node.prim_count {
                let primitive = self.binary.primitive_indices[slot as usize];
                for (corner, position) in self.triangles[primitive as usize].iter().enumerate() {
                    for axis in 0..3 {
                        leaf.vertices[corner][axis][lane] = position[axis];
                    }
                }
                leaf.primitives[lane] = primitive;
                lane += 1;
            }
        }
        self.tree.leaves.push(leaf);
        self.tree.leaves.len() as u32 - 1
    }
}

/// Size of the largest group of triangles with the same bounding box.
fn most_identical_bounds(triangles: &[[Vec3A; 3]]) -> u32 {
    if triangles.len() <= MOST_IDENTICAL as usize {
        return 0;
    }
    let mut groups = std::collections::HashMap::with_capacity(triangles.len());
    for [a, b, c] in triangles {
        let bounds = [a.min(*b).min(*c), a.max(*b).max(*c)].map(|v| v.to_array().map(f32::to_bits));
        *groups.entry(bounds).or_insert(0u32) += 1;
    }
    groups.into_values().max().unwrap_or(0)
}

/// A BVH2 that halves the triangles by centroid along the longest axis: worse to query, but never deep.
fn balanced(triangles: &[[Vec3A; 3]]) -> Bvh2 {
    let mut binary = Bvh2 { nodes: vec![Bvh2Node::default()], ..Bvh2::default() };
    binary.primitive_indices = (0..triangles.len() as u32).collect();
    let mut todo = vec![(0usize, 0usize, triangles.len())];
    while let Some((node, first, last)) = todo.pop() {
        let mut low = Vec3A::INFINITY;
        let mut high = Vec3A::NEG_INFINITY;
        for &p in &binary.primitive_indices[first..last] {
            for &v in &triangles[p as usize] {
                low = low.min(v);
                high = high.max(v);
            }
        }
        let bounds = obvhs::aabb::Aabb::new(low, high);
        if last - first <= WIDTH {
            binary.nodes[node] = Bvh2Node::new(bounds, (last - first) as u32, first as u32);
            continue;
        }
        let axis = (high - low).max_position();
        let key = |p: &u32| triangles[*p as usize].iter().map(|v| v[axis]).sum::<f32>();
        let middle = (last - first) / 2;
        binary.primitive_indices[first..last].select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
        let children = binary.nodes.len();
        binary.nodes[node] = Bvh2Node::new(bounds, 0, children as u32);
        binary.nodes.extend([Bvh2Node::default(); 2]);
        todo.extend([(children, first, first + middle), (children + 1, first + middle, last)]);
    }
    binary
}
