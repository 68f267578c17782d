//! Building trees: obvhs' BVH2 (or a balanced one where that fails) collapsed to eight-wide nodes.

use super::collapse::Collapse;
use super::{EMPTY, LEAF, Node, STACK, Tree};
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
/// Most boxes that are worth twice the time.
const WELL: usize = 1 << 19;
/// Boxes below which no slow build is slow enough to matter.
const FEW: usize = 1 << 12;
/// Neighbours along the Morton curve that [`pairing`] looks at on each side, and boxes and blocks of boxes that it samples.
const REACH: usize = 14;
const BLOCK: usize = 128;
const BLOCKS: usize = 32;

/// A tree over `boxes` with at most `leaf_size` (1 to 8) of them in a leaf.
pub(super) fn tree(boxes: &[Aabb], leaf_size: usize) -> Tree {
    if boxes.is_empty() {
        return Tree::default();
    }
    if most_identical(boxes) <= MOST_IDENTICAL && pairing(boxes) > LEAST_PAIRING {
        // One to a leaf: the collapse knows better what to join.
        // Reinsertion of 0.2 in place of 0.05 takes twice the time (0.2 s more for 300 000 triangles) and makes diffuse rays up to 8%
        // faster; 0.3 takes three times and gains nothing more. The fast preset takes two thirds and makes them 6% slower.
        let reinsertion_batch_ratio = if boxes.len() <= WELL { 0.2 } else { 0.05 };
        let parameters = BvhBuildParams { max_prims_per_leaf: 1, reinsertion_batch_ratio, ..BvhBuildParams::medium_build() };
        let binary = build_bvh2(boxes, parameters, &mut std::time::Duration::default());
        let tree = Collapse::new(&binary, leaf_size).run();
        if stack_need(&tree.nodes) <= STACK {
            return tree;
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
    use glam::Vec3A;

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
