//! Building trees: obvhs' BVH2 (or a balanced one where that fails) collapsed to eight-wide nodes.

use super::collapse::Collapse;
use super::ploc;
use super::{EMPTY, LEAF, Node, STACK, Tree};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;

/// Most boxes that are worth twice the time.
const WELL: usize = 1 << 19;
/// Boxes below which no slow build is slow enough to matter.
const FEW: usize = 1 << 12;
/// A ray that meets more than this share of all boxes gains nothing from a better tree, and improving it takes quadratic time:
/// each box might go anywhere. Boxes of real scenes are far below (docs/measurements/renderer-notes.md, trees).
const HOPELESS: f32 = 1.0 / 16.0;

/// A tree over `boxes` with at most `leaf_size` (1 to 8) of them in a leaf.
pub(super) fn tree(boxes: &[Aabb], leaf_size: usize) -> Tree {
    if boxes.is_empty() {
        return Tree::default();
    }
    // One to a leaf: the collapse knows better what to join.
    let mut binary = ploc::build(boxes);
    if boxes.len() <= FEW || share_met(&binary) <= HOPELESS {
        // Reinsertion of 0.2 in place of 0.05 takes twice the time and makes rays faster; more gains nothing
        // (docs/measurements/renderer-notes.md, trees).
        let ratio = if boxes.len() <= WELL { 0.2 } else { 0.05 };
        let mut optimizer = ReinsertionOptimizer::default();
        optimizer.run(&mut binary, ratio, None);
        optimizer.run(&mut binary, 2.0 * ratio, None);
    }
    let tree = Collapse::new(&binary, leaf_size).run();
    if stack_need(&tree.nodes) <= STACK {
        return tree;
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

/// Share of its nodes that a ray through the scene's box meets, by the surface area heuristic; 1 where areas are not finite.
fn share_met(binary: &Bvh2) -> f32 {
    let area = |node: &Bvh2Node| f64::from(node.aabb().half_area());
    let share = binary.nodes.iter().map(area).sum::<f64>() / (area(&binary.nodes[0]) * binary.nodes.len() as f64);
    if share.is_finite() { share as f32 } else { 1.0 }
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
    use obvhs::BvhBuildParams;
    use obvhs::bvh2::builder::build_bvh2;
    use std::time::Duration;

    /// Numbers in 0..1 (PCG).
    struct Random(u32);

    impl Random {
        fn unit(&mut self) -> f32 {
            self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (self.0 >> 8) as f32 / (1 << 24) as f32
        }

        fn point(&mut self) -> Vec3A {
            Vec3A::new(self.unit(), self.unit(), self.unit())
        }
    }

    fn around(center: Vec3A, half: Vec3A) -> Aabb {
        Aabb::new(center - half, center + half)
    }

    /// `n` boxes of a kind.
    fn shape(kind: &str, n: usize) -> Vec<Aabb> {
        let mut random = Random(1);
        let half = Vec3A::splat(0.5);
        let side = (n as f32).sqrt().ceil() as usize;
        (0..n)
            .map(|i| {
                let f = i as f32;
                match kind {
                    "row" => around(Vec3A::X * (4.0 * f), half),
                    // Two triangles of each quad have the same box.
                    "ribbon" => around(Vec3A::X * (i / 2) as f32, Vec3A::new(0.5, 0.0, 0.5)),
                    "stairs" => around(Vec3A::new(0.3 * f, 0.2 * f, 0.0), Vec3A::new(0.15, 0.1, 0.5)),
                    "equal" => around(Vec3A::ZERO, half),
                    "grid" => around(Vec3A::new((i % side) as f32, 0.0, (i / side) as f32), half),
                    // Every gap is larger than the one before.
                    "growing" => around(Vec3A::X * (f + 1e-5 * f * f), Vec3A::splat(1e-3)),
                    "nested" => around(Vec3A::ZERO, Vec3A::splat(1.0 - f / (n as f32 + 1.0))),
                    "random" => around(random.point(), 0.01 * random.point()),
                    "large and random" => around(random.point(), random.point()),
                    _ => panic!("no boxes are called {kind}"),
                }
            })
            .collect()
    }

    const ROWS: [&str; 5] = ["row", "ribbon", "stairs", "equal", "growing"];

    fn by_obvhs(boxes: &[Aabb], reinsertion_batch_ratio: f32) -> Bvh2 {
        let parameters = BvhBuildParams { max_prims_per_leaf: 1, reinsertion_batch_ratio, ..BvhBuildParams::medium_build() };
        build_bvh2(boxes, parameters, &mut Duration::default())
    }

    #[test]
    fn boxes_within_boxes_are_hopeless_and_others_are_not() {
        for (kind, hopeless) in
            [("nested", true), ("equal", true), ("large and random", true), ("random", false), ("grid", false)]
                .into_iter()
                .chain(["row", "ribbon", "stairs", "growing"].map(|kind| (kind, false)))
        {
            let share = share_met(&ploc::build(&shape(kind, 10_000)));
            println!("{kind}: {share}");
            assert_eq!(share > HOPELESS, hopeless, "{kind}: {share}");
        }
    }

    /// Where no round stalls, the loop of `ploc` equals the loop of obvhs: the same nodes in the same places.
    #[test]
    fn trees_of_ordinary_boxes_are_those_of_obvhs() {
        let mut random = Random(3);
        let mesh: Vec<Aabb> = (0..20_000)
            .flat_map(|i| {
                // Triangles in pairs on a bumpy ball, which often have the same box.
                let (a, b) = ((i % 200) as f32 * 0.0314, (i / 200) as f32 * 0.0314);
                let at = Vec3A::new(a.cos() * b.sin(), b.cos(), a.sin() * b.sin()) * (1.0 + 0.1 * (7.0 * a).sin());
                [around(at, Vec3A::splat(0.02)); 2]
            })
            .collect();
        let sizes = (0..5000).map(|_| around(random.point(), random.point() * random.unit().powi(4))).collect();
        let shapes = [
            shape("random", 30_000),
            shape("large and random", 3000),
            sizes,
            mesh,
            shape("random", 40),
            shape("random", 1),
            vec![],
        ];
        for (number, boxes) in shapes.iter().enumerate() {
            let (own, theirs) = (ploc::build(boxes), by_obvhs(boxes, 0.0));
            assert_eq!(own.primitive_indices, theirs.primitive_indices);
            let nodes = |bvh: &Bvh2| -> Vec<_> {
                bvh.nodes.iter().map(|n| (n.aabb().min, n.aabb().max, n.prim_count, n.first_index)).collect()
            };
            assert!(nodes(&own) == nodes(&theirs) || boxes.is_empty(), "shape {number}");
            assert!(own.max_depth == theirs.max_depth || boxes.is_empty(), "shape {number}");
        }
    }

    /// The number of clustering rounds is at most the depth of the tree, which obvhs limits for its stack. Its own loop takes
    /// thousands here.
    #[test]
    fn no_row_of_boxes_takes_many_rounds() {
        for kind in ROWS.into_iter().chain(["nested", "grid", "random"]) {
            let binary = ploc::build(&shape(kind, 20_000));
            println!("{kind}: {} rounds at most", binary.max_depth);
            assert!(binary.max_depth <= 200, "{kind}: {} rounds", binary.max_depth);
        }
    }

    #[test]
    fn every_box_is_in_the_tree_once_and_within_its_parents() {
        for kind in ROWS.into_iter().chain(["nested", "grid", "random"]) {
            for n in [1, 2, 3, 700, 5001] {
                let boxes = shape(kind, n);
                let binary = ploc::build(&boxes);
                let mut seen = vec![0; n];
                for node in &binary.nodes {
                    if node.is_leaf() {
                        seen[binary.primitive_indices[node.first_index as usize] as usize] += 1;
                        continue;
                    }
                    for child in [node.first_index, node.first_index + 1].map(|c| binary.nodes[c as usize]) {
                        assert_eq!(node.aabb().union(child.aabb()), *node.aabb(), "{kind}");
                    }
                }
                assert!(seen.iter().all(|&count| count == 1), "{kind} {n}");
            }
        }
    }

    /// Areas beyond single precision are infinite, and of no area at all not even a number.
    #[test]
    fn boxes_beyond_all_bounds_end_too() {
        let huge = vec![around(Vec3A::ZERO, Vec3A::splat(1e30)); 1000];
        let odd = vec![Aabb::new(Vec3A::new(-3e38, 0.0, 0.0), Vec3A::new(3e38, 0.0, 0.0)); 1001];
        for boxes in [huge, odd] {
            assert_eq!(ploc::build(&boxes).nodes.len(), 2 * boxes.len() - 1);
        }
    }
}
