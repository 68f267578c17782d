//! Trees shared by instances, and the tree over those.

use super::kernel::{Nearest, STOP, Slabs, Visit, traverse};
use super::queries::{self, All, Filter};
use super::simd::{self, Kernel, Lanes};
use super::{Accel, Candidate, FLATTENED, Hit, LEAF, Level, Node, Scratch, Stack, build, leaf};
use crate::ray::Ray;
use glam::{Affine3A, DAffine3, DMat3, Vec3A};
use obvhs::aabb::Aabb;
use std::marker::PhantomData;

/// Largest product of the norms of a transform and its inverse. Rays in object space are rounded to 2^-24 of their length, and a
/// worse transform would magnify that; such instances are flattened.
const WORST_CONDITION: f64 = 1e3;

/// A shared tree placed in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    /// Number the scene knows the instance by.
    pub instance: u32,
    /// Index of the tree.
    pub object: u32,
    /// Object to world.
    pub transform: Affine3A,
    /// World to object.
    inverse: DAffine3,
    mirrored: bool,
}

impl Placement {
    /// `None` when the transform is not finite, flattens the object, or is too uneven (scales apart by more than about 1000).
    pub fn new(instance: u32, object: u32, transform: Affine3A) -> Option<Self> {
        let matrix = DMat3::from_cols(
            transform.matrix3.x_axis.as_dvec3(),
            transform.matrix3.y_axis.as_dvec3(),
            transform.matrix3.z_axis.as_dvec3(),
        );
        let norm = |m: &DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        let determinant = matrix.determinant();
        if !transform.is_finite() || determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let inverse = matrix.inverse();
        let condition = norm(&matrix) * norm(&inverse) / 3.0;
        // Written so that NaN fails.
        let fine = condition <= WORST_CONDITION && norm(&matrix) < 1e12 && norm(&inverse) < 1e12;
        fine.then(|| Self {
            instance,
            object,
            transform,
            inverse: DAffine3::from_mat3_translation(inverse, inverse * -transform.translation.as_dvec3()),
            mirrored: determinant < 0.0,
        })
    }

    /// `ray` in object space. Its direction is not normalised there, so that distances along it stay world-space distances. In
    /// double precision up to the last rounding: an object far from the origin would lose its digits to the translation
    /// otherwise.
    #[inline]
    fn to_object(self, ray: &Ray) -> Ray {
        let inverse = &self.inverse;
        let origin = inverse.transform_point3(ray.origin.as_dvec3());
        let direction = inverse.transform_vector3(ray.direction.as_dvec3());
        Ray::new(origin.as_vec3a(), direction.as_vec3a())
    }
}

/// Instances of shared trees, and the tree over them.
pub(crate) struct Instances {
    objects: Vec<Accel>,
    placements: Vec<Placement>,
    /// `placements` that a leaf of the tree stands for, in order.
    nodes: Vec<Node>,
    level: Level,
}

impl Instances {
    /// Builds the tree over `placements` of `objects`.
    pub fn new(objects: Vec<Accel>, placements: Vec<Placement>) -> Self {
        let mut instances = Self { objects, placements: Vec::new(), nodes: Vec::new(), level: Level::best() };
        instances.place(placements);
        instances
    }

    #[cfg(test)]
    pub fn set_level(&mut self, level: Level) {
        self.level = level;
    }

    /// Rebuilds the tree over instances and keeps the trees of the objects.
    pub fn place(&mut self, placements: Vec<Placement>) {
        let boxes: Vec<Aabb> = placements.iter().map(|p| self.bounds(p)).collect();
        let tree = build::tree(&boxes, 1);
        self.nodes = tree.nodes;
        self.placements = tree.order.iter().map(|&placement| placements[placement as usize]).collect();
    }

    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// Bytes of all trees.
    pub fn memory(&self) -> usize {
        self.objects.iter().map(Accel::memory).sum::<usize>()
            + self.nodes.len() * size_of::<Node>()
            + self.placements.len() * size_of::<Placement>()
    }

    /// Boxes in the world (corners of parallelepipeds) that together hold an instance: the boxes of its tree's first nodes.
    pub fn parts(&self, placement: &Placement) -> impl Iterator<Item = [Vec3A; 8]> + '_ {
        /// More boxes cost more than they fit better.
        const MOST: usize = 16;
        let nodes = &self.objects[placement.object as usize].nodes;
        let children = |index: u32| {
            let node = &nodes[index as usize];
            node.lanes().map(|lane| (node.children[lane], node.child_bounds(lane)))
        };
        let mut parts: Vec<(u32, [Vec3A; 2])> = if nodes.is_empty() { Vec::new() } else { children(0).collect() };
        // Open the largest box as long as there is room for what is in it.
        while parts.len() + super::WIDTH - 1 <= MOST {
            let area = |(_, [low, high]): &(u32, [Vec3A; 2])| Aabb::new(*low, *high).half_area();
            let inner = (0..parts.len()).filter(|&i| parts[i].0 & LEAF == 0);
            let Some(largest) = inner.max_by(|&i, &j| area(&parts[i]).total_cmp(&area(&parts[j]))) else { break };
            let (index, _) = parts.swap_remove(largest);
            parts.extend(children(index));
        }
        let transform = placement.transform;
        parts.into_iter().map(move |(_, bounds)| {
            std::array::from_fn(|k| {
                let corner = [0, 1, 2].map(|axis| bounds[k >> axis & 1][axis]);
                transform.transform_point3a(Vec3A::from_array(corner))
            })
        })
    }

    fn bounds(&self, placement: &Placement) -> Aabb {
        let mut bounds = self.parts(placement).fold(Aabb::empty(), |all, part| all.union(&Aabb::from_points(&part)));
        if !bounds.valid() {
            // An object without triangles: a point, which costs nothing.
            bounds = Aabb::from_point(placement.transform.translation);
        }
        // Roundings of the corners above, and of rays on their way to object space.
        let m = &placement.transform.matrix3;
        let reach = (m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs()) + placement.transform.translation.abs();
        let slack = Vec3A::splat(16.0 * f32::EPSILON * reach.max(bounds.min.abs()).max(bounds.max.abs()).max_element());
        Aabb::new(bounds.min - slack, bounds.max + slack)
    }

    /// As [`Accel::closest`], before `limit`, or at it in an instance with a lower number than `instance`: of those at the same
    /// distance the first is hit.
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch, limit: f32, instance: u32) -> Option<Hit> {
        simd::run(self.level, ClosestQuery { instances: self, ray, scratch, limit, instance, filter: All })
    }

    /// As [`Accel::occluded`].
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        simd::run(self.level, AnyQuery { instances: self, ray, scratch, filter: All })
    }

    /// As [`Accel::closest_where`], before `limit` and `instance` as in [`Self::closest`].
    pub fn closest_where(
        &self,
        ray: &Ray,
        scratch: &mut Scratch,
        limit: f32,
        instance: u32,
        accept: impl Fn(&Candidate) -> bool,
    ) -> Option<Hit> {
        simd::run(self.level, ClosestQuery { instances: self, ray, scratch, limit, instance, filter: accept })
    }

    /// As [`Accel::occluded_where`].
    pub fn occluded_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> bool {
        simd::run(self.level, AnyQuery { instances: self, ray, scratch, filter: accept })
    }

    /// The placement and the tree of a hit that is not [`FLATTENED`].
    #[inline]
    pub fn of(&self, hit: &Hit) -> (&Placement, &Accel) {
        debug_assert!(hit.instance != FLATTENED);
        let placement = &self.placements[hit.instance as usize];
        (placement, &self.objects[placement.object as usize])
    }
}

/// The filter of a query, told of the sides that triangles have in the world.
struct Placed<'a, F> {
    filter: &'a F,
    mirrored: bool,
}

impl<F: Filter> Filter for Placed<'_, F> {
    const ALL: bool = F::ALL;
    #[inline(always)]
    fn accept(&self, candidate: &Candidate) -> bool {
        self.filter.accept(&Candidate { front: candidate.front != self.mirrored, ..*candidate })
    }
}

/// Asks instances for the nearest triangle before `limit`.
struct ClosestQuery<'a, F> {
    instances: &'a Instances,
    ray: &'a Ray,
    scratch: &'a mut Scratch,
    limit: f32,
    instance: u32,
    filter: F,
}

impl<F: Filter> Kernel for ClosestQuery<'_, F> {
    type Output = Option<Hit>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<Hit> {
        let Self { instances, ray, scratch: Scratch { stack, inner, .. }, limit, instance, filter } = self;
        let lanes = PhantomData::<L>;
        let mut visit = ClosestPlaced { instances, ray, stack: inner, filter: &filter, limit, instance, found: None, lanes };
        traverse::<L, false>(&instances.nodes, &Slabs::new(ray), stack, limit, &mut visit);
        visit.found
    }
}

struct ClosestPlaced<'a, L, F> {
    instances: &'a Instances,
    ray: &'a Ray,
    stack: &'a mut Stack,
    filter: &'a F,
    limit: f32,
    /// Instances at `limit` must have a lower number than this.
    instance: u32,
    found: Option<Hit>,
    lanes: PhantomData<L>,
}

impl<L: Lanes, F: Filter> Visit for ClosestPlaced<'_, L, F> {
    #[inline(always)]
    fn leaf(&mut self, leaf: u32, enter: f32, _: f32) -> f32 {
        let (first, _) = leaf::range(leaf);
        let index = first as u32;
        let placement = &self.instances.placements[first];
        let object = &self.instances.objects[placement.object as usize];
        let filter = Placed { filter: self.filter, mirrored: placement.mirrored };
        let before = Nearest::none(self.limit, placement.instance < self.instance);
        let nearest = queries::nearest::<L, _>(object, &placement.to_object(self.ray), self.stack, before, index, &filter);
        if let Some(hit) = nearest.hit(index) {
            // As triangles in their boxes: what is in an instance is not before its box.
            let t = hit.t.max(enter);
            if t < self.limit || t == self.limit && placement.instance < self.instance {
                (self.limit, self.instance, self.found) = (t, placement.instance, Some(Hit { t, ..hit }));
            }
        }
        self.limit
    }
}

/// Asks instances whether anything is in the way.
struct AnyQuery<'a, F> {
    instances: &'a Instances,
    ray: &'a Ray,
    scratch: &'a mut Scratch,
    filter: F,
}

impl<F: Filter> Kernel for AnyQuery<'_, F> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        let Self { instances, ray, scratch: Scratch { stack, inner, .. }, filter } = self;
        let mut visit = AnyPlaced { instances, ray, stack: inner, filter: &filter, lanes: PhantomData::<L> };
        traverse::<L, true>(&instances.nodes, &Slabs::new(ray), stack, f32::INFINITY, &mut visit)
    }
}

struct AnyPlaced<'a, L, F> {
    instances: &'a Instances,
    ray: &'a Ray,
    stack: &'a mut Stack,
    filter: &'a F,
    lanes: PhantomData<L>,
}

impl<L: Lanes, F: Filter> Visit for AnyPlaced<'_, L, F> {
    #[inline(always)]
    fn leaf(&mut self, leaf: u32, _: f32, limit: f32) -> f32 {
        let (first, _) = leaf::range(leaf);
        let placement = &self.instances.placements[first];
        let object = &self.instances.objects[placement.object as usize];
        let filter = Placed { filter: self.filter, mirrored: placement.mirrored };
        let found = queries::any::<L, _>(object, &placement.to_object(self.ray), self.stack, first as u32, &filter);
        if found { STOP } else { limit }
    }
}
