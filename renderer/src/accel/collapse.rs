//! Collapsing a BVH2 to eight-wide nodes and leaves of up to eight, by least expected cost.

use super::leaf;
use super::simd::WIDTH;
use super::{Node, Tree};
use glam::Vec3A;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;

/// Cost of a leaf relative to a node. Rates hardly change from 0.8 to 2 (docs/measurements/renderer-notes.md, trees).
pub(super) const LEAF_COST: f32 = 1.2;

/// Chooses which nodes of the BVH2 stay (Ylitie, Karras, Laine 2017, section 3.2): the costs of a subtree as a forest of at most
/// 1 to 7 roots follow from those of its children.
pub(super) struct Collapse<'a> {
    binary: &'a Bvh2,
    leaf_size: u32,
    /// Things below each BVH2 node.
    counts: Vec<u32>,
    /// Least cost of each BVH2 node as a forest of at most 1, 2 .. 7 trees; the last entry is its cost as a wide node.
    costs: Vec<[f32; WIDTH]>,
    /// Absolute padding of every box, metres.
    padding: Vec3A,
}

impl<'a> Collapse<'a> {
    /// `leaf_size`, 1 to 8, at least what the leaves of `binary` have.
    pub fn new(binary: &'a Bvh2, leaf_size: usize) -> Self {
        let mut order = vec![0u32];
        let mut next = 0;
        while next < order.len() {
            let node = &binary.nodes[order[next] as usize];
            if !node.is_leaf() {
                order.extend([node.first_index, node.first_index + 1]);
            }
            next += 1;
        }
        let mut collapse = Self {
            binary,
            leaf_size: leaf_size as u32,
            counts: vec![0; binary.nodes.len()],
            costs: vec![[0.0; WIDTH]; binary.nodes.len()],
            padding: padding([binary.nodes[0].aabb().min, binary.nodes[0].aabb().max]),
        };
        for &index in order.iter().rev() {
            collapse.judge(index);
        }
        collapse
    }

    fn node(&self, index: u32) -> &Bvh2Node {
        &self.binary.nodes[index as usize]
    }

    fn judge(&mut self, index: u32) {
        let node = self.node(index);
        let area = node.aabb().half_area();
        let first = node.first_index;
        if node.is_leaf() {
            self.counts[index as usize] = node.prim_count;
            self.costs[index as usize] = [area * LEAF_COST; WIDTH];
            return;
        }
        let count = self.counts[first as usize] + self.counts[first as usize + 1];
        let mut costs = [0.0; WIDTH];
        let wide = area + self.shared_out(first, WIDTH).0;
        let leaf = if count <= self.leaf_size { area * LEAF_COST } else { f32::INFINITY };
        costs[0] = wide.min(leaf);
        for trees in 2..WIDTH {
            costs[trees - 1] = costs[trees - 2].min(self.shared_out(first, trees).0);
        }
        costs[WIDTH - 1] = wide;
        self.counts[index as usize] = count;
        self.costs[index as usize] = costs;
    }

    /// Least cost of the siblings at `first` as a forest of at most `trees`, and how many of those the first sibling gets.
    fn shared_out(&self, first: u32, trees: usize) -> (f32, usize) {
        let (left, right) = (&self.costs[first as usize], &self.costs[first as usize + 1]);
        (1..trees).map(|k| (left[k - 1] + right[trees - k - 1], k)).fold((f32::INFINITY, 1), |best, now| {
            // Written so that costs that are not finite still choose a split.
            if now.0 < best.0 { now } else { best }
        })
    }

    /// Whether the subtree becomes one leaf.
    fn is_leaf(&self, index: u32) -> bool {
        let costs = &self.costs[index as usize];
        self.node(index).is_leaf() || self.counts[index as usize] <= self.leaf_size && costs[0] < costs[WIDTH - 1]
    }

    /// The roots of the subtree `index` as a forest of at most `trees`.
    fn roots(&self, index: u32, mut trees: usize, into: &mut Vec<u32>) {
        let costs = &self.costs[index as usize];
        while trees > 1 && costs[trees - 1] >= costs[trees - 2] {
            trees -= 1;
        }
        let node = self.node(index);
        if trees == 1 || node.is_leaf() {
            into.push(index);
            return;
        }
        let (_, k) = self.shared_out(node.first_index, trees);
        self.roots(node.first_index, k, into);
        self.roots(node.first_index + 1, trees - k, into);
    }

    /// The wide tree, and what its leaves hold in their order. Children come after their parents.
    pub fn run(&self) -> Tree {
        let (mut nodes, mut order) = (vec![Node::EMPTY], Vec::new());
        let mut todo = vec![(0u32, 0usize)];
        let mut children = Vec::with_capacity(WIDTH);
        while let Some((binary, wide)) = todo.pop() {
            children.clear();
            if self.is_leaf(binary) {
                // The root alone.
                children.push(binary);
            } else {
                let first = self.node(binary).first_index;
                let (_, k) = self.shared_out(first, WIDTH);
                self.roots(first, k, &mut children);
                self.roots(first + 1, WIDTH - k, &mut children);
            }
            // The largest first: any-hit queries look there first.
            children
                .sort_by(|&a, &b| self.node(b).aabb().half_area().total_cmp(&self.node(a).aabb().half_area()).then(a.cmp(&b)));
            let mut node = Node::EMPTY;
            for (lane, &child) in children.iter().enumerate() {
                let bounds = self.node(child).aabb();
                node.set_bounds(lane, [bounds.min, bounds.max], self.padding);
                node.children[lane] = if self.is_leaf(child) {
                    let before = order.len();
                    self.below(child, &mut order);
                    leaf::name(before, order.len() - before)
                } else {
                    nodes.push(Node::EMPTY);
                    todo.push((child, nodes.len() - 1));
                    nodes.len() as u32 - 1
                };
            }
            nodes[wide] = node;
        }
        Tree { nodes, order }
    }

    /// What a subtree holds.
    fn below(&self, root: u32, found: &mut Vec<u32>) {
        let mut todo = vec![root];
        while let Some(index) = todo.pop() {
            let node = self.node(index);
            if node.is_leaf() {
                let slots = node.first_index as usize..(node.first_index + node.prim_count) as usize;
                found.extend_from_slice(&self.binary.primitive_indices[slots]);
            } else {
                todo.extend([node.first_index, node.first_index + 1]);
            }
        }
    }
}

/// By how much boxes are larger than what they hold, metres: a quarter of a millionth of the scene's extent, more than what the
/// triangle test's roundings can move a hit out of its box.
pub(super) fn padding([low, high]: [Vec3A; 2]) -> Vec3A {
    Vec3A::splat(low.abs().max(high.abs()).max_element() * 2f32.powi(-22))
}
