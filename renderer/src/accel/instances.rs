//! Trees shared by instances, and the tree over those.

use super::{Accel, Candidate, FLATTENED, Hit, LEAF, Node, STOP, Scratch, build, traverse};
use crate::ray::Ray;
use glam::{Affine3A, DAffine3, DMat3, Vec3A};
use obvhs::aabb::Aabb;

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

    /// `ray` in object space. Its direction is not normalised there, so that distances along it stay those of the world. In double
    /// precision up to the last rounding: an object far from the origin would lose its digits to the translation otherwise.
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
}

impl Instances {
    /// Builds the tree over `placements` of `objects`.
    pub fn new(objects: Vec<Accel>, placements: Vec<Placement>) -> Self {
        let mut instances = Self { objects, placements: Vec::new(), nodes: Vec::new() };
        instances.place(placements);
        instances
    }

    /// Builds the tree over instances again; those of the objects are kept.
    pub fn place(&mut self, placements: Vec<Placement>) {
        let boxes: Vec<Aabb> = placements.iter().map(|p| self.bounds(p)).collect();
        let (nodes, groups) = build::nodes(&boxes, 1);
        self.nodes = nodes;
        self.placements = groups.iter().map(|group| placements[group[0] as usize]).collect();
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

    /// Boxes in the world (corners of parallelepipeds) that together hold an instance: those of its tree's first nodes.
    pub fn parts<'a>(&'a self, placement: &'a Placement) -> impl Iterator<Item = [Vec3A; 8]> + 'a {
        let nodes = &self.objects[placement.object as usize].nodes;
        let lanes = move |index: u32| {
            let node = &nodes[index as usize];
            (0..4).filter(|&lane| node.children[lane] != super::EMPTY).map(move |lane| {
                let corner = |k: usize| Vec3A::from_array([0, 1, 2].map(|axis| node.bounds[axis][k >> axis & 1][lane]));
                (node.children[lane], std::array::from_fn::<Vec3A, 8, _>(corner))
            })
        };
        let first = if nodes.is_empty() { None } else { Some(0) };
        first
            .into_iter()
            .flat_map(lanes)
            .flat_map(move |(child, corners)| {
                let (own, inner) = if child & LEAF == 0 { (None, Some(child)) } else { (Some(corners), None) };
                own.into_iter().chain(inner.into_iter().flat_map(lanes).map(|(_, corners)| corners))
            })
            .map(move |corners| corners.map(|c| placement.transform.transform_point3a(c)))
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

    /// As [`Accel::closest`], before `limit`.
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch, limit: f32) -> Option<Hit> {
        let Scratch { stack, inner } = scratch;
        let mut found = None;
        traverse::<false>(&self.nodes, ray, stack, limit, |index, best| {
            let placement = &self.placements[index as usize];
            let object = &self.objects[placement.object as usize];
            match object.nearest(&placement.to_object(ray), inner, best) {
                Some(hit) => {
                    found = Some(Hit { instance: index, ..hit });
                    hit.t
                }
                None => best,
            }
        });
        found
    }

    /// As [`Accel::occluded`].
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        let Scratch { stack, inner } = scratch;
        traverse::<true>(&self.nodes, ray, stack, f32::INFINITY, |index, best| {
            let placement = &self.placements[index as usize];
            let object = &self.objects[placement.object as usize];
            if object.any(&placement.to_object(ray), inner) { STOP } else { best }
        })
    }

    /// As [`Accel::closest_where`], before `limit`.
    pub fn closest_where(
        &self,
        ray: &Ray,
        scratch: &mut Scratch,
        limit: f32,
        accept: impl Fn(&Candidate) -> bool,
    ) -> Option<Hit> {
        let Scratch { stack, inner } = scratch;
        let mut found = None;
        traverse::<false>(&self.nodes, ray, stack, limit, |index, best| {
            let placement = &self.placements[index as usize];
            let object = &self.objects[placement.object as usize];
            let accept = |c: &Candidate| accept(&Candidate { front: c.front != placement.mirrored, ..*c });
            match object.nearest_where(&placement.to_object(ray), inner, best, index, accept) {
                Some(hit) => {
                    found = Some(hit);
                    hit.t
                }
                None => best,
            }
        });
        found
    }

    /// As [`Accel::occluded_where`].
    pub fn occluded_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> bool {
        let Scratch { stack, inner } = scratch;
        traverse::<true>(&self.nodes, ray, stack, f32::INFINITY, |index, best| {
            let placement = &self.placements[index as usize];
            let object = &self.objects[placement.object as usize];
            let accept = |c: &Candidate| accept(&Candidate { front: c.front != placement.mirrored, ..*c });
            if object.any_where(&placement.to_object(ray), inner, index, accept) { STOP } else { best }
        })
    }

    /// The placement and the tree of a hit that is not [`FLATTENED`].
    #[inline]
    pub fn of(&self, hit: &Hit) -> (&Placement, &Accel) {
        debug_assert!(hit.instance != FLATTENED);
        let placement = &self.placements[hit.instance as usize];
        (placement, &self.objects[placement.object as usize])
    }
}
