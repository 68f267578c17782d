//! Building trees: obvhs' BVH2 (or a balanced one where that fails) collapsed to four-wide nodes.

use super::leaf::Leaf;
use super::{Accel, EMPTY, LEAF, Node, STACK, WIDTH};
use glam::{Vec3A, Vec4};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::bvh2::node::Bvh2Node;

/// Things that may share one bounding box before obvhs is passed by: PLOC then merges one pair a round, which takes quadratic
/// time (20 000 identical triangles: 12 s, a tree 20 000 deep).
const MOST_IDENTICAL: u32 = 1000;

/// Share of boxes in pairs (see [`pairing`]) below which obvhs is passed by. Nested boxes have 0.02, grids, rows and
/// random boxes of any size 0.1 and more.
const LEAST_PAIRING: f32 = 0.05;
/// Boxes below which no slow build is slow enough to matter.
const FEW: usize = 1 << 12;
/// Neighbours along the Morton curve that [`pairing`] looks at on each side, and boxes and blocks of boxes that it samples.
const REACH: usize = 14;
const BLOCK: usize = 128;
const BLOCKS: usize = 32;

/// A tree over `triangles`, four to a leaf.
pub(super) fn tree(triangles: &[[Vec3A; 3]]) -> Accel {
    let boxes: Vec<Aabb> = triangles.iter().map(|t| Aabb::from_points(t)).collect();
    let (nodes, groups) = nodes(&boxes, WIDTH);
    let leaf = |primitives: &[u32; WIDTH]| {
        let mut leaf = Leaf { primitives: *primitives, ..Leaf::UNUSED };
        for (lane, &primitive) in primitives.iter().enumerate().filter(|(_, p)| **p != EMPTY) {
            for (corner, position) in triangles[primitive as usize].iter().enumerate() {
                for axis in 0..3 {
                    leaf.vertices[corner][axis][lane] = position[axis];
                }
            }
        }
        leaf
    };
    Accel { nodes, leaves: groups.iter().map(leaf).collect() }
}

/// What the leaves of a tree hold, by number; unused entries are [`EMPTY`].
pub(super) type Groups = Vec<[u32; WIDTH]>;

/// A tree over `boxes` with at most `leaf_size` (up to four) of them in a leaf.
pub(super) fn nodes(boxes: &[Aabb], leaf_size: usize) -> (Vec<Node>, Groups) {
    if boxes.is_empty() {
        return (Vec::new(), Vec::new());
    }
    if most_identical(boxes) <= MOST_IDENTICAL && pairing(boxes) > LEAST_PAIRING {
        let parameters = BvhBuildParams { max_prims_per_leaf: leaf_size as u32, ..BvhBuildParams::medium_build() };
        let binary = build_bvh2(boxes, parameters, &mut std::time::Duration::default());
        let (nodes, groups) = Collapse::new(&binary, leaf_size).run();
        if stack_need(&nodes) <= STACK {
            return (nodes, groups);
        }
    }
    // Adversarial input (many nested boxes) can make a tree too deep for the stack.
    Collapse::new(&balanced(boxes, leaf_size), leaf_size).run()
}

/// Stack entries that a query may need at once.
fn stack_need(nodes: &[Node]) -> usize {
    // An explicit stack: the trees this is meant to find are too deep for recursion.
    let mut worst = 0;
    let mut todo = vec![(0, 0usize)];
    while let Some((index, held)) = todo.pop() {
        let children = nodes[index as usize].children;
        let held = held + children.iter().filter(|&&c| c != EMPTY).count();
        worst = worst.max(held);
        todo.extend(children.iter().filter(|&&c| c & LEAF == 0).map(|&c| (c, held - 1)));
    }
    worst
}

/// Collapses a BVH2 into four-wide nodes.
struct Collapse<'a> {
    binary: &'a Bvh2,
    leaf_size: u32,
    /// Things below each BVH2 node.
    counts: Vec<u32>,
    /// Absolute padding of every box, metres.
    padding: Vec3A,
}

impl<'a> Collapse<'a> {
    fn new(binary: &'a Bvh2, leaf_size: usize) -> Self {
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
        Self { binary, leaf_size: leaf_size as u32, counts, padding }
    }

    fn node(&self, index: u32) -> &Bvh2Node {
        &self.binary.nodes[index as usize]
    }

    /// Whether the subtree becomes one leaf.
    fn is_leaf(&self, index: u32) -> bool {
        self.node(index).is_leaf() || self.counts[index as usize] <= self.leaf_size
    }

    fn run(&self) -> (Vec<Node>, Groups) {
        let empty = Node { bounds: [[Vec4::INFINITY, Vec4::NEG_INFINITY]; 3], children: [EMPTY; WIDTH] };
        let (mut nodes, mut groups) = (vec![empty], Groups::new());
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
                    groups.push(self.below(child));
                    LEAF | (groups.len() as u32 - 1)
                } else {
                    nodes.push(empty);
                    todo.push((child, nodes.len() - 1));
                    nodes.len() as u32 - 1
                };
            }
            nodes[wide] = node;
        }
        (nodes, groups)
    }

    /// What a subtree of at most `leaf_size` things holds.
    fn below(&self, root: u32) -> [u32; WIDTH] {
        let (mut found, mut count) = ([EMPTY; WIDTH], 0);
        let mut todo = vec![root];
        while let Some(index) = todo.pop() {
            let node = self.node(index);
            if !node.is_leaf() {
                todo.extend([node.first_index, node.first_index + 1]);
                continue;
            }
            for slot in node.first_index..node.first_index + node.prim_count {
                found[count] = self.binary.primitive_indices[slot as usize];
                count += 1;
            }
        }
        found
    }
}

/// Size of the largest group of equal boxes.
fn most_identical(boxes: &[Aabb]) -> u32 {
    if boxes.len() <= MOST_IDENTICAL as usize {
        return 0;
    }
    let mut groups = std::collections::HashMap::with_capacity(boxes.len());
    for b in boxes {
        *groups.entry([b.min, b.max].map(|v| v.to_array().map(f32::to_bits))).or_insert(0u32) += 1;
    }
    groups.into_values().max().unwrap_or(0)
}

/// Share of boxes that have a mutually best partner, 0..=1, judged by blocks of boxes along the Morton curve. PLOC merges such pairs
/// round by round; where next to none exist, as in boxes within boxes, it takes quadratic time (20 000 nested triangles: 13 s).
fn pairing(boxes: &[Aabb]) -> f32 {
    if boxes.len() <= FEW {
        return 1.0;
    }
    let root = boxes.iter().fold(Aabb::empty(), |all, b| all.union(b));
    let scale = (root.max - root.min).map(|v| if v > 0.0 { 1023.0 / v } else { 0.0 });
    let spread = |v: f32| (0..10).fold(0u32, |code, bit| code | ((v as u32 >> bit & 1) << (3 * bit)));
    let mut order: Vec<(u32, u32)> = (0u32..)
        .zip(boxes)
        .map(|(index, b)| {
            let p = (0.5 * b.min + 0.5 * b.max - root.min) * scale;
            (spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2, index)
        })
        .collect();
    order.sort_unstable();
    let (mut paired, mut seen) = (0, 0);
    for k in 0..BLOCKS {
        let first = k * (order.len() - BLOCK) / (BLOCKS - 1);
        let block: Vec<&Aabb> = order[first..first + BLOCK].iter().map(|&(_, index)| &boxes[index as usize]).collect();
        let near = |i: usize| (i.saturating_sub(REACH)..(i + REACH + 1).min(BLOCK)).filter(move |&j| j != i);
        let cost = |i: usize, j: usize| block[i].union(block[j]).half_area();
        let best: Vec<f32> = (0..BLOCK).map(|i| near(i).map(|j| cost(i, j)).fold(f32::INFINITY, f32::min)).collect();
        let pairs = |i: usize| near(i).any(|j| cost(i, j) == best[i] && best[i] == best[j]);
        paired += (0..BLOCK).filter(|&i| pairs(i)).count();
        seen += BLOCK;
    }
    paired as f32 / seen as f32
}

/// A BVH2 that halves the boxes by centre along the longest axis: worse to query, but never deep.
fn balanced(boxes: &[Aabb], leaf_size: usize) -> Bvh2 {
    let mut binary = Bvh2 { nodes: vec![Bvh2Node::default()], ..Bvh2::default() };
    binary.primitive_indices = (0..boxes.len() as u32).collect();
    let mut todo = vec![(0usize, 0usize, boxes.len())];
    while let Some((node, first, last)) = todo.pop() {
        let here = &mut binary.primitive_indices[first..last];
        let bounds = here.iter().fold(Aabb::empty(), |all, &p| all.union(&boxes[p as usize]));
        if last - first <= leaf_size {
            binary.nodes[node] = Bvh2Node::new(bounds, (last - first) as u32, first as u32);
            continue;
        }
        let axis = (bounds.max - bounds.min).max_position();
        let key = |p: &u32| boxes[*p as usize].min[axis] + boxes[*p as usize].max[axis];
        let middle = (last - first) / 2;
        here.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
        let children = binary.nodes.len();
        binary.nodes[node] = Bvh2Node::new(bounds, 0, children as u32);
        binary.nodes.extend([Bvh2Node::default(); 2]);
        todo.extend([(children, first, first + middle), (children + 1, first + middle, last)]);
    }
    binary
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nested_boxes_hardly_pair_and_others_do() {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut any = || Vec3A::new(random(), random(), random());
        let n = 10_000u16;
        let around = |c: Vec3A, h: Vec3A| Aabb::new(c - h, c + h);
        let shapes: [(&str, Vec<Aabb>); 5] = [
            ("nested", (0..n).map(|i| around(Vec3A::ZERO, Vec3A::splat(0.999f32.powi(i.into())))).collect()),
            ("random", (0..n).map(|_| around(any(), 0.01 * any())).collect()),
            ("large and random", (0..n).map(|_| around(any(), any())).collect()),
            (
                "grid",
                (0..n).map(|i| around(Vec3A::new(f32::from(i % 100), 0.0, f32::from(i / 100)), Vec3A::splat(0.5))).collect(),
            ),
            ("row", (0..n).map(|i| around(Vec3A::X * f32::from(i), Vec3A::splat(0.5))).collect()),
        ];
        for (name, boxes) in shapes {
            let share = pairing(&boxes);
            println!("{name}: {share}");
            assert_eq!(share < LEAST_PAIRING, name == "nested", "{name}: {share}");
        }
    }
}
