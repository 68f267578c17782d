//! Packets: sixteen coherent rays that meet nodes together.
//!
//! At nodes all rays are tested at once against eight boxes by bounds of their origins and inverse directions (interval arithmetic,
//! exact in its roundings: it never passes over a box that one of the rays meets). At leaves every ray meets the leaf's box and its
//! triangles, one triangle after the other, sixteen rays at a time, with the arithmetic of single rays: hits are the same bit for bit.

use super::kernel::{NEARER, Nearest, SLACK, inverse};
use super::leaf::{self, Shear, shear};
use super::simd::{Kernel, Lanes, Numbers, PACKET, Sixteen, WIDTH};
use super::{Accel, EMPTY, FLATTENED, Hit, LEAF, Node, STACK, Scratch};
use crate::ray::Ray;

/// What is to be visited: a child, the node and the lane that its box is in (`8 node + lane`), and where the first ray may enter it.
pub(super) type Entry = (u32, u32, f32);

/// Asks a tree for the nearest triangle along each of up to sixteen rays of one octant.
pub(super) struct PacketQuery<'a> {
    pub tree: &'a Accel,
    pub rays: &'a [Ray],
    pub hits: &'a mut [Option<Hit>],
    pub scratch: &'a mut Scratch,
}

/// Whether the rays can be traced as one: finite, with directions of the same signs and the same largest component.
pub(super) fn coherent(rays: &[Ray]) -> bool {
    let kind = |ray: &Ray| (inverse(ray).map(|v| v < 0.0), shear(ray).0);
    let fine = |ray: &Ray| (ray.origin + ray.direction).is_finite();
    rays.first().is_some_and(|first| {
        let expected = kind(first);
        rays.len() <= PACKET && rays.iter().all(|ray| fine(ray) && kind(ray) == expected)
    })
}

/// Bounds of a packet on one axis, for the slab test.
#[derive(Clone, Copy)]
struct Interval<L> {
    /// The origins that give the earliest entry and the latest exit.
    near: L,
    far: L,
    /// Smallest and largest inverse.
    inverse: [L; 2],
    /// Row of a node's bounds that is entered first.
    row: usize,
}

impl<L: Lanes> Interval<L> {
    #[inline(always)]
    fn new(axis: usize, origins: &[f32; PACKET], inverses: &[f32; PACKET]) -> Self {
        let (low, high) = bounds(origins);
        let (small, large) = bounds(inverses);
        let negative = small < 0.0;
        // Planes less the origin are smallest for the largest origin; a negative inverse turns that round.
        let (near, far) = if negative { (low, high) } else { (high, low) };
        Self {
            near: L::splat(near),
            far: L::splat(far),
            inverse: [L::splat(small), L::splat(large)],
            row: 2 * axis + usize::from(negative),
        }
    }

    #[inline(always)]
    fn enter(&self, node: &Node) -> L {
        let d = L::load(&node.bounds[self.row]).sub(self.near);
        d.mul(self.inverse[0]).min(d.mul(self.inverse[1]))
    }

    #[inline(always)]
    fn exit(&self, node: &Node) -> L {
        let d = L::load(&node.bounds[self.row ^ 1]).sub(self.far);
        d.mul(self.inverse[0]).max(d.mul(self.inverse[1]))
    }
}

fn bounds(values: &[f32; PACKET]) -> (f32, f32) {
    values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)))
}

/// The rays, one a lane.
struct Rays<S> {
    origin: [S; 3],
    inverse: [S; 3],
    rows: [usize; 3],
    shear: Shear<S>,
}

impl<S: Sixteen> Rays<S> {
    /// Where the rays enter and leave the box in `lane` of `node`.
    #[inline(always)]
    fn meet(&self, node: &Node, lane: usize) -> (S, S) {
        let [nx, ny, nz] = self.rows;
        let enter = self.plane(node, nx, lane).max(self.plane(node, ny, lane)).max(self.plane(node, nz, lane).max(S::splat(0.0)));
        let exit = self.plane(node, nx ^ 1, lane).min(self.plane(node, ny ^ 1, lane)).min(self.plane(node, nz ^ 1, lane));
        (enter, exit)
    }

    #[inline(always)]
    fn plane(&self, node: &Node, row: usize, lane: usize) -> S {
        let axis = row / 2 % 3;
        S::splat(node.bounds[row][lane]).sub(self.origin[axis]).mul(self.inverse[axis])
    }
}

/// The nearest triangles so far. Numbers are kept as bits.
struct Best<S> {
    t: S,
    /// Largest of `t`.
    limit: f32,
    primitive: S,
    leaf: S,
    lane: S,
    weights: [S; 3],
}

impl<S: Sixteen> Best<S> {
    #[inline(always)]
    fn replace(&mut self, mask: u32, t: S, weights: [S; 3], primitive: u32, leaf: u32, lane: usize) {
        self.t = t.select(mask, self.t);
        self.primitive = S::splat(f32::from_bits(primitive)).select(mask, self.primitive);
        self.leaf = S::splat(f32::from_bits(leaf)).select(mask, self.leaf);
        self.lane = S::splat(f32::from_bits(lane as u32)).select(mask, self.lane);
        let [u, v, w] = weights;
        self.weights = [u.select(mask, self.weights[0]), v.select(mask, self.weights[1]), w.select(mask, self.weights[2])];
    }

    /// The lanes among `mask` where `t` is nearer than what was found, or as near with a lower number.
    #[inline(always)]
    fn beaten(&self, mask: u32, t: S, primitive: u32) -> u32 {
        let mut beaten = mask & self.t.gt(t);
        let mut equal = mask & !beaten & t.le(self.t);
        if equal != 0 {
            let numbers = self.primitive.store();
            while equal != 0 {
                let lane = equal.trailing_zeros() as usize % PACKET;
                equal &= equal - 1;
                beaten |= u32::from(primitive < numbers[lane].to_bits()) << lane;
            }
        }
        beaten
    }
}

impl Kernel for PacketQuery<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { tree, rays, hits, scratch } = self;
        if tree.nodes.is_empty() || rays.is_empty() {
            hits.fill(None);
            return;
        }
        let mut o = [[0.0; PACKET]; 3];
        let mut inv = [[0.0; PACKET]; 3];
        let mut scale = [[0.0; PACKET]; 3];
        for lane in 0..PACKET {
            // Lanes without a ray repeat the first.
            let ray = rays.get(lane).unwrap_or(&rays[0]);
            let (origin, inverse, scales) = (ray.origin.to_array(), inverse(ray), shear(ray).1);
            for axis in 0..3 {
                o[axis][lane] = origin[axis];
                inv[axis][lane] = inverse[axis];
                scale[axis][lane] = scales[axis];
            }
        }
        let [x, y, z] =
            [Interval::<L>::new(0, &o[0], &inv[0]), Interval::<L>::new(1, &o[1], &inv[1]), Interval::<L>::new(2, &o[2], &inv[2])];
        let axis = shear(&rays[0]).0;
        let rays_of = Rays::<L::Sixteen> {
            origin: sixteen(&o, [0, 1, 2]),
            inverse: sixteen(&inv, [0, 1, 2]),
            rows: [x.row, y.row, z.row],
            shear: Shear { axis, origin: sixteen(&o, axis), scale: sixteen(&scale, [0, 1, 2]) },
        };
        let none = <L::Sixteen as Numbers>::splat(f32::from_bits(EMPTY));
        let zero = <L::Sixteen as Numbers>::splat(0.0);
        let mut best = Best {
            t: <L::Sixteen as Numbers>::splat(f32::INFINITY),
            limit: f32::INFINITY,
            primitive: none,
            leaf: none,
            lane: zero,
            weights: [zero; 3],
        };
        let stack = &mut scratch.packet;
        let mut top = 0usize;
        let (mut current, mut from) = (0u32, 0u32);
        loop {
            if current & LEAF == 0 {
                let node = &tree.nodes[current as usize];
                let enter = x.enter(node).max(y.enter(node)).max(z.enter(node).max(L::splat(0.0)));
                let exit = x.exit(node).min(y.exit(node)).min(z.exit(node).min(L::splat(best.limit)));
                let mut mask = enter.le(exit.mul(L::splat(SLACK)));
                if mask != 0 {
                    let distances = enter.store();
                    let base = top;
                    let place = current << 3;
                    while mask != 0 {
                        let lane = mask.trailing_zeros() as usize % WIDTH;
                        mask &= mask - 1;
                        let entry = (node.children[lane], place | lane as u32, distances[lane]);
                        let mut hole = top;
                        while hole > base && stack[(hole - 1) % STACK].2 < entry.2 {
                            stack[hole % STACK] = stack[(hole - 1) % STACK];
                            hole -= 1;
                        }
                        stack[hole % STACK] = entry;
                        top += 1;
                    }
                    top -= 1;
                    (current, from, _) = stack[top % STACK];
                    continue;
                }
            } else {
                visit::<L::Sixteen>(tree, current & !LEAF, from, &rays_of, &mut best);
            }
            loop {
                if top == 0 {
                    finish(&best, hits);
                    return;
                }
                top -= 1;
                let entry = stack[top % STACK];
                if entry.2 * NEARER <= best.limit {
                    (current, from, _) = entry;
                    break;
                }
            }
        }
    }
}

#[inline(always)]
fn sixteen<S: Sixteen>(values: &[[f32; PACKET]; 3], [x, y, z]: [usize; 3]) -> [S; 3] {
    [S::load(&values[x]), S::load(&values[y]), S::load(&values[z])]
}

/// Tests the triangles of a leaf.
#[inline(always)]
fn visit<S: Sixteen>(tree: &Accel, leaf: u32, from: u32, rays: &Rays<S>, best: &mut Best<S>) {
    let (enter, exit) = rays.meet(&tree.nodes[(from >> 3) as usize], (from & 7) as usize);
    let mask = enter.le(exit.min(best.t).mul(S::splat(SLACK)));
    if mask == 0 {
        return;
    }
    let enter = enter.mul(S::splat(NEARER));
    let mut changed = 0;
    for lane in 0..leaf::range(leaf).1 {
        let found = leaf::intersect_packet(&tree.leaves, leaf, lane, &rays.shear, enter, best.t);
        if found.mask & mask != 0 {
            let primitive = tree.leaves.primitive(leaf, lane);
            let beaten = best.beaten(found.mask & mask, found.t, primitive);
            best.replace(beaten, found.t, found.weights, primitive, leaf, lane);
            changed |= beaten;
        }
    }
    if changed != 0 {
        best.limit = best.t.store().into_iter().fold(0.0, f32::max);
    }
}

#[inline(always)]
fn finish<S: Sixteen>(best: &Best<S>, hits: &mut [Option<Hit>]) {
    let (t, primitive, leaf, lanes) = (best.t.store(), best.primitive.store(), best.leaf.store(), best.lane.store());
    let [u, v, w] = &best.weights;
    let (u, v, w) = (u.store(), v.store(), w.store());
    for (i, hit) in hits.iter_mut().enumerate().take(PACKET) {
        let (primitive, leaf) = (primitive[i].to_bits(), leaf[i].to_bits());
        *hit = Nearest { t: t[i], primitive, leaf, lane: lanes[i].to_bits() as u8, weights: [u[i], v[i], w[i]] }.hit(FLATTENED);
    }
}
