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
    if most_identical(boxes) <= MOST_IDENTICAL {
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
