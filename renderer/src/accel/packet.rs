//! Packets: sixteen coherent rays that meet nodes together.
//!
//! At nodes all rays are tested at once against eight boxes by bounds of their origins and inverse directions (interval
//! arithmetic, exact in its roundings: it never passes over a box that one of the rays meets). At leaves every ray meets the
//! leaf's box and its triangles, one triangle after the other, sixteen rays at a time, with the arithmetic of single rays: hits
//! are the same bit for bit.

use super::kernel::{NEARER, Nearest, SLACK, splat};
use super::leaf::{self, Shear, shear};
use super::simd::{Kernel, Lanes, Numbers, PACKET, Sixteen, WIDTH};
use super::{Accel, EMPTY, FLATTENED, Hit, LEAF, Node, STACK, Scratch};
use crate::ray::Ray;

/// What is to be visited: a child, the node and the lane that its box is in (`8 node + lane`), and where the first ray may enter
/// it.
pub(super) type Entry = (u32, u32, f32);

/// Asks a tree for the nearest triangle along each of up to sixteen rays of one octant.
pub(super) struct PacketQuery<'a> {
    pub tree: &'a Accel,
    pub rays: &'a [Ray],
    pub hits: &'a mut [Option<Hit>],
    pub scratch: &'a mut Scratch,
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
    fn new(row: usize, origins: &[f32; PACKET], inverses: &[f32; PACKET]) -> Self {
        let (low, high) = bounds(origins);
        let (small, large) = bounds(inverses);
        // Planes less the origin are smallest for the largest origin; a negative inverse turns that round.
        let (near, far) = if row % 2 == 1 { (low, high) } else { (high, low) };
        Self { near: L::splat(near), far: L::splat(far), inverse: [L::splat(small), L::splat(large)], row }
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

/// The rays, one per lane.
struct Rays<S> {
    origin: [S; 3],
    inverse: [S; 3],
    rows: [usize; 3],
    shear: Shear<S, S>,
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

/// Number of a triangle, and where it is stored: lane `lane` of leaf `leaf`.
#[derive(Clone, Copy)]
struct Place {
    primitive: u32,
    leaf: u32,
    lane: usize,
}

impl<S: Sixteen> Best<S> {
    #[inline(always)]
    fn replace(&mut self, mask: u32, t: S, weights: [S; 3], Place { primitive, leaf, lane }: Place) {
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

/// Origins, directions and values derived from them, one ray per lane.
struct Prepared<S> {
    origins: [[f32; PACKET]; 3],
    inverses: [[f32; PACKET]; 3],
    scales: [[f32; PACKET]; 3],
    rays: Rays<S>,
}

impl<S: Sixteen> Prepared<S> {
    /// As [`inverse`](super::kernel::inverse) and [`shear`](super::leaf::shear), sixteen at a time. `None` unless the rays can be
    /// traced as one: finite, with directions of the same signs and the same largest component.
    #[inline(always)]
    fn new(rays: &[Ray]) -> Option<Self> {
        let (mut origins, mut directions) = ([[0.0; PACKET]; 3], [[0.0; PACKET]; 3]);
        for lane in 0..PACKET {
            // Lanes without a ray repeat the first.
            let ray = rays.get(lane).or(rays.first())?;
            let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
            for axis in 0..3 {
                origins[axis][lane] = origin[axis];
                directions[axis][lane] = direction[axis];
            }
        }
        const ALL: u32 = (1 << PACKET) - 1;
        let (one, zero, most) = (S::splat(1.0), S::splat(0.0), S::splat(f32::MAX));
        let least = zero.sub(most);
        let o: [S; 3] = sixteen(&origins, [0, 1, 2]);
        let d: [S; 3] = sixteen(&directions, [0, 1, 2]);
        let sum = [o[0].add(d[0]), o[1].add(d[1]), o[2].add(d[2])];
        let finite = magnitude(sum[0]).le(most) & magnitude(sum[1]).le(most) & magnitude(sum[2]).le(most);
        let inverse =
            [one.div(d[0]).max(least).min(most), one.div(d[1]).max(least).min(most), one.div(d[2]).max(least).min(most)];
        let negative = [zero.gt(inverse[0]), zero.gt(inverse[1]), zero.gt(inverse[2])];
        let m = [magnitude(d[0]), magnitude(d[1]), magnitude(d[2])];
        let x_largest = m[0].gt(m[1]) & m[0].gt(m[2]);
        let y_largest = m[1].gt(m[2]) & !x_largest;
        let uniform = |mask: u32| mask == 0 || mask == ALL;
        if finite != ALL || ![negative[0], negative[1], negative[2], x_largest, y_largest].into_iter().all(uniform) {
            return None;
        }
        let axis = shear(rays.first()?).0;
        let along = one.div(d[axis[2]]);
        let scale = [d[axis[0]].mul(along), d[axis[1]].mul(along), along];
        let rows = [usize::from(negative[0] != 0), 2 + usize::from(negative[1] != 0), 4 + usize::from(negative[2] != 0)];
        let permuted = |v: [S; 3]| [v[axis[0]], v[axis[1]], v[axis[2]]];
        Some(Self {
            origins,
            inverses: [inverse[0].store(), inverse[1].store(), inverse[2].store()],
            scales: [scale[0].store(), scale[1].store(), scale[2].store()],
            rays: Rays {
                origin: o,
                inverse,
                rows,
                shear: Shear { axis, origin: permuted(o), scale, inverse: permuted(inverse) },
            },
        })
    }

    /// One of the rays.
    #[inline(always)]
    fn single<L: Lanes>(&self, lane: usize) -> Shear<L> {
        let axis = self.rays.shear.axis;
        let permuted = |v: &[[f32; PACKET]; 3]| [v[axis[0]][lane], v[axis[1]][lane], v[axis[2]][lane]];
        let scale = splat([self.scales[0][lane], self.scales[1][lane], self.scales[2][lane]]);
        Shear { axis, origin: splat(permuted(&self.origins)), scale, inverse: permuted(&self.inverses) }
    }
}

#[inline(always)]
fn magnitude<S: Sixteen>(v: S) -> S {
    v.max(S::splat(0.0).sub(v))
}

impl Kernel for PacketQuery<'_> {
    /// Whether the rays could be traced as one; the hits are set then.
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let Self { tree, rays, hits, scratch } = self;
        let Some(packet) = Prepared::<L::Sixteen>::new(rays) else { return false };
        if tree.nodes.is_empty() {
            hits.fill(None);
            return true;
        }
        let [x, y, z] = [
            Interval::<L>::new(packet.rays.rows[0], &packet.origins[0], &packet.inverses[0]),
            Interval::<L>::new(packet.rays.rows[1], &packet.origins[1], &packet.inverses[1]),
            Interval::<L>::new(packet.rays.rows[2], &packet.origins[2], &packet.inverses[2]),
        ];
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
                visit::<L>(tree, current & !LEAF, from, &packet, &mut best);
            }
            loop {
                if top == 0 {
                    finish(&best, hits);
                    return true;
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

/// Tests the triangles of a leaf, whichever is less: one ray after the other against all triangles, or one triangle after the
/// other against all rays.
#[inline(always)]
fn visit<L: Lanes>(tree: &Accel, leaf: u32, from: u32, packet: &Prepared<L::Sixteen>, best: &mut Best<L::Sixteen>) {
    let rays = &packet.rays;
    let (enter, exit) = rays.meet(&tree.nodes[(from >> 3) as usize], (from & 7) as usize);
    let mut mask = enter.le(exit.min(best.t).mul(<L::Sixteen as Numbers>::splat(SLACK)));
    if mask == 0 {
        return;
    }
    let (_, count) = leaf::range(leaf);
    let mut changed = 0;
    if (mask.count_ones() as usize) < count {
        let limits = best.t.store();
        while mask != 0 {
            let ray = mask.trailing_zeros() as usize % PACKET;
            mask &= mask - 1;
            let found = leaf::intersect(&tree.leaves, leaf, &packet.single::<L>(ray), limits[ray]);
            let mut lanes = found.mask;
            if lanes == 0 {
                continue;
            }
            let (t, [u, v, w]) = (found.t.store(), found.weights);
            let (u, v, w) = (u.store(), v.store(), w.store());
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize % WIDTH;
                lanes &= lanes - 1;
                let primitive = tree.leaves.primitive(leaf, lane);
                let all = <L::Sixteen as Numbers>::splat(t[lane]);
                let beaten = best.beaten(1 << ray, all, primitive);
                if beaten != 0 {
                    best.replace(beaten, all, splat([u[lane], v[lane], w[lane]]), Place { primitive, leaf, lane });
                    changed = beaten;
                }
            }
        }
    } else {
        for lane in 0..count {
            let found = leaf::intersect_packet(&tree.leaves, leaf, lane, &rays.shear, best.t);
            if found.mask & mask != 0 {
                let primitive = tree.leaves.primitive(leaf, lane);
                let beaten = best.beaten(found.mask & mask, found.t, primitive);
                best.replace(beaten, found.t, found.weights, Place { primitive, leaf, lane });
                changed |= beaten;
            }
        }
    }
    if changed != 0 {
        best.limit = largest(&best.t.store());
    }
}

#[inline(always)]
fn largest(values: &[f32; PACKET]) -> f32 {
    let mut all = *values;
    for half in [8, 4, 2, 1] {
        for lane in 0..half {
            all[lane] = all[lane].max(all[lane + half]);
        }
    }
    all[0]
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
