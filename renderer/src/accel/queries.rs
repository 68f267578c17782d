//! What trees are asked, as kernels that are compiled once a [`Level`](super::Level).

use super::kernel::{Any, Closest, Nearest, Padded, STOP, Slabs, Visit, traverse};
use super::leaf::{self, Shear};
use super::simd::{Kernel, Lanes, WIDTH};
use super::{Accel, Candidate, FLATTENED, Hit, Leaves, Scratch, Stack};
use crate::ray::Ray;

/// Which triangles count.
pub(super) trait Filter {
    /// All do: `accept` is not asked.
    const ALL: bool;
    fn accept(&self, candidate: &Candidate) -> bool;
}

/// Every triangle counts.
pub(super) struct All;

impl Filter for All {
    const ALL: bool = true;
    #[inline(always)]
    fn accept(&self, _: &Candidate) -> bool {
        true
    }
}

impl<F: Fn(&Candidate) -> bool> Filter for F {
    const ALL: bool = false;
    #[inline(always)]
    fn accept(&self, candidate: &Candidate) -> bool {
        self(candidate)
    }
}

impl Nearest {
    #[inline(always)]
    pub fn hit(&self, instance: u32) -> Option<Hit> {
        let &Self { t, primitive, leaf, lane, weights } = self;
        self.found().then_some(Hit { t, primitive, weights, leaf, lane, instance })
    }
}

/// Triangles that a filter accepts.
struct Filtered<'a, L, F> {
    leaves: &'a Leaves,
    shear: &'a Shear<L>,
    instance: u32,
    filter: &'a F,
    nearest: Nearest,
    any: bool,
}

impl<L: Lanes, F: Filter> Visit for Filtered<'_, L, F> {
    #[inline(always)]
    fn leaf(&mut self, leaf: u32, _: f32, limit: f32) -> f32 {
        let found = leaf::intersect(self.leaves, leaf, self.shear, limit);
        let mut mask = found.mask;
        if mask == 0 {
            return limit;
        }
        let (t, facing) = (found.t.store(), found.facing.store());
        let [u, v, w] = found.weights;
        let (u, v, w) = (u.store(), v.store(), w.store());
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % WIDTH;
            mask &= mask - 1;
            let primitive = self.leaves.primitive(leaf, lane);
            if !self.nearest.replaced_by(t[lane], primitive) {
                continue;
            }
            let weights = [u[lane], v[lane], w[lane]];
            let hit = Hit { t: t[lane], primitive, weights, leaf, lane: lane as u8, instance: self.instance };
            if self.filter.accept(&Candidate { hit, front: facing[lane] > 0.0 }) {
                if self.any {
                    return STOP;
                }
                self.nearest = Nearest { t: hit.t, primitive, leaf, lane: hit.lane, weights };
            }
        }
        if self.any { limit } else { self.nearest.t }
    }
}

/// Goes through `tree` by whichever box test is for this ray.
#[inline(always)]
fn search<L: Lanes, const ANY: bool>(tree: &Accel, ray: &Ray, stack: &mut Stack, limit: f32, visit: &mut impl Visit) -> bool {
    match Padded::<L>::new(ray, tree.leaves.extent()) {
        Some(padded) => traverse::<L, ANY>(&tree.nodes, &padded, stack, limit, visit),
        None => traverse::<L, ANY>(&tree.nodes, &Slabs::new(ray), stack, limit, visit),
    }
}

/// The nearest triangle of `tree` before `nearest` that counts.
#[inline(always)]
pub(super) fn nearest<L: Lanes, F: Filter>(
    tree: &Accel,
    ray: &Ray,
    stack: &mut Stack,
    nearest: Nearest,
    instance: u32,
    filter: &F,
) -> Nearest {
    let (leaves, shear) = (&tree.leaves, &Shear::<L>::new(ray));
    if F::ALL {
        let mut visit = Closest { leaves, shear, nearest };
        search::<L, false>(tree, ray, stack, nearest.t, &mut visit);
        visit.nearest
    } else {
        let mut visit = Filtered { leaves, shear, instance, filter, nearest, any: false };
        search::<L, false>(tree, ray, stack, nearest.t, &mut visit);
        visit.nearest
    }
}

/// Whether any triangle of `tree` that counts is in the way.
#[inline(always)]
pub(super) fn any<L: Lanes, F: Filter>(tree: &Accel, ray: &Ray, stack: &mut Stack, instance: u32, filter: &F) -> bool {
    let (leaves, shear) = (&tree.leaves, &Shear::<L>::new(ray));
    if F::ALL {
        search::<L, true>(tree, ray, stack, f32::INFINITY, &mut Any { leaves, shear })
    } else {
        let nearest = Nearest::none(f32::INFINITY, true);
        let mut visit = Filtered { leaves, shear, instance, filter, nearest, any: true };
        search::<L, true>(tree, ray, stack, f32::INFINITY, &mut visit)
    }
}

/// Asks a tree for the nearest triangle.
pub(super) struct ClosestQuery<'a, F> {
    pub tree: &'a Accel,
    pub ray: &'a Ray,
    pub scratch: &'a mut Scratch,
    pub filter: F,
}

impl<F: Filter> Kernel for ClosestQuery<'_, F> {
    type Output = Option<Hit>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<Hit> {
        let none = Nearest::none(f32::INFINITY, true);
        nearest::<L, F>(self.tree, self.ray, &mut self.scratch.stack, none, FLATTENED, &self.filter).hit(FLATTENED)
    }
}

/// Asks a tree whether anything is in the way.
pub(super) struct AnyQuery<'a, F> {
    pub tree: &'a Accel,
    pub ray: &'a Ray,
    pub scratch: &'a mut Scratch,
    pub filter: F,
}

impl<F: Filter> Kernel for AnyQuery<'_, F> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        any::<L, F>(self.tree, self.ray, &mut self.scratch.stack, FLATTENED, &self.filter)
    }
}
