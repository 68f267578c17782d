//! Clustering boxes to a binary tree: PLOC (Meister and Bittner 2018), as obvhs does it at medium quality, without its quadratic
//! cases.
//!
//! In each round every box looks for the neighbour along the Morton curve with which it would make the smallest box, and those
//! that choose each other become one. Where many choices cost the same, or costs only grow along the curve, all may look in one
//! direction, and a round of obvhs joins a single pair: a row of 20,000 equal boxes takes it 20,000 rounds. Here a round that
//! would join too few pairs joins the cheapest pairs that have no box in common instead, which are many. A tree that needs no
//! such round is the tree of obvhs, node for node.

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::ploc::morton::morton_encode_u64_unorm;

/// Neighbours on each side that are looked at; on the first rounds only the next ones.
const REACH: usize = 14;
const SHORT_ROUNDS: usize = 3;
/// A round stalls if it joins less than one pair for this number of boxes. Rounds of ordinary scenes join one pair for every 3 to
/// 6 boxes.
const STALLED: usize = 32;
/// So few boxes may be joined pair by pair.
const FEW: usize = 64;
/// Boxes from which on sorting uses all threads.
const MANY: usize = 250_000;

/// A tree with one of `boxes` in each leaf. The time is proportional to `n log n` for any boxes.
pub(super) fn build(boxes: &[Aabb]) -> Bvh2 {
    let mut bvh = Bvh2 { primitive_indices: (0..boxes.len() as u32).collect(), ..Bvh2::default() };
    if boxes.is_empty() {
        return bvh;
    }
    let mut free = 2 * boxes.len() - 1;
    bvh.nodes = vec![Bvh2Node::default(); free];
    let mut nodes = sorted(boxes);
    let mut next = Vec::with_capacity(nodes.len());
    let mut choices = Choices::default();
    let mut round = 0;
    while nodes.len() > 1 {
        choices.choose(&nodes, round);
        for (index, node) in nodes.iter().enumerate() {
            let partner = choices.partner[index];
            if partner == index || choices.partner[partner] != index {
                next.push(*node);
            } else if index > partner {
                free -= 2;
                bvh.nodes[free] = *node;
                bvh.nodes[free + 1] = nodes[partner];
                next.push(Bvh2Node::new(node.aabb().union(nodes[partner].aabb()), 0, free as u32));
            }
        }
        std::mem::swap(&mut nodes, &mut next);
        next.clear();
        round += 1;
    }
    bvh.nodes[0] = nodes[0];
    bvh.max_depth = bvh.max_depth.max(round + 1);
    bvh.children_are_ordered_after_parents = true;
    bvh
}

/// Leaves along the Morton curve.
fn sorted(boxes: &[Aabb]) -> Vec<Bvh2Node> {
    let all = boxes.iter().fold(Aabb::empty(), |mut all, b| {
        all.extend(b.min);
        all.extend(b.max);
        all
    });
    let scale = 1.0 / all.diagonal().as_dvec3();
    let offset = -all.min.as_dvec3() * scale;
    let code = |b: &Aabb| morton_encode_u64_unorm(b.center().as_dvec3() * scale + offset);
    let mut codes: Vec<(u64, u32)> = boxes.iter().map(code).zip(0u32..).collect();
    if codes.len() <= MANY {
        codes.sort_unstable_by_key(|&(code, _)| code);
    } else {
        rayon::slice::ParallelSliceMut::par_sort_unstable(&mut codes[..]);
    }
    codes.into_iter().map(|(_, index)| Bvh2Node::new(boxes[index as usize], 1, index)).collect()
}

/// Which boxes want to be one.
#[derive(Default)]
struct Choices {
    /// Of each box the one it chose; itself where it chose none.
    partner: Vec<usize>,
    /// Half the area of what the two would make.
    cost: Vec<f32>,
}

impl Choices {
    /// Chooses for the round number `round`.
    fn choose(&mut self, nodes: &[Bvh2Node], round: usize) {
        if round < SHORT_ROUNDS {
            self.choose_next(nodes);
        } else {
            self.choose_near(nodes);
        }
        if !self.stalls() {
            return;
        }
        if round < SHORT_ROUNDS {
            self.choose_near(nodes);
        }
        if self.stalls() {
            self.pair_up();
        }
    }

    /// Whether the boxes that chose each other are too few.
    fn stalls(&self) -> bool {
        let pairs = self.partner.iter().enumerate().filter(|&(i, &p)| i < p && self.partner[p] == i).count();
        pairs == 0 || self.partner.len() > FEW && pairs * STALLED < self.partner.len()
    }

    /// Each box chooses one of the two beside it.
    fn choose_next(&mut self, nodes: &[Bvh2Node]) {
        self.partner.clear();
        let mut last = f32::INFINITY;
        for (index, pair) in nodes.windows(2).enumerate() {
            let cost = pair[0].aabb().union(pair[1].aabb()).half_area();
            self.partner.push(if last < cost { index - 1 } else { index + 1 });
            last = cost;
        }
        self.partner.push(nodes.len() - 2);
    }

    /// Each box chooses the cheapest within reach, of equal ones the last.
    fn choose_near(&mut self, nodes: &[Bvh2Node]) {
        self.partner.clear();
        self.partner.extend(0..nodes.len());
        self.cost.clear();
        self.cost.resize(nodes.len(), f32::INFINITY);
        for index in 0..nodes.len() {
            let own = *nodes[index].aabb();
            let (mut best, mut choice) = (self.cost[index], self.partner[index]);
            for (other, node) in nodes.iter().enumerate().take(index + REACH + 1).skip(index + 1) {
                let cost = own.union(node.aabb()).half_area();
                if cost <= best {
                    (best, choice) = (cost, other);
                }
                if cost <= self.cost[other] {
                    (self.cost[other], self.partner[other]) = (cost, index);
                }
            }
            (self.cost[index], self.partner[index]) = (best, choice);
        }
    }

    /// Makes the cheapest choices mutual, as many as have no box in common. A box is chosen by at most 2 [`REACH`] others, so
    /// that the pairs are always a share of all boxes.
    fn pair_up(&mut self) {
        let count = self.partner.len();
        let edge = |(index, &partner): (usize, &usize)| (self.cost[index], index.min(partner), index.max(partner));
        let mut edges: Vec<(f32, usize, usize)> = self.partner.iter().enumerate().map(edge).filter(|(_, a, b)| a != b).collect();
        edges.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        self.partner.clear();
        self.partner.extend(0..count);
        for (_, a, b) in edges {
            if self.partner[a] == a && self.partner[b] == b {
                (self.partner[a], self.partner[b]) = (b, a);
            }
        }
        // Areas that are not finite choose nothing.
        if self.partner.iter().enumerate().all(|(index, &partner)| index == partner) {
            self.partner.iter_mut().enumerate().for_each(|(index, partner)| *partner = (index ^ 1).min(count - 1));
        }
    }
}
