//! Rays, and the values the traversal derives from one once.

use glam::{Vec3A, Vec4};

/// A half-line, prepared for box and triangle tests four at a time.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, world space, metres.
    pub origin: Vec3A,
    /// Direction, world space; unit but for rays taken to the space of an instance, where `t` stays in metres of the world.
    pub direction: Vec3A,
    pub(crate) slabs: [Slab; 3],
    pub(crate) shear: Shear,
}

/// One axis of the slab test.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Slab {
    pub origin: Vec4,
    pub inverse: Vec4,
    /// Index of the plane entered first: 0 = lower, 1 = upper.
    pub near: usize,
}

/// The transform of the watertight triangle test (Woop, Benthin, Wald 2013): `axis` is permuted so that the direction's largest
/// component comes last, and `scale` shears the direction onto that axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shear {
    pub axis: [usize; 3],
    pub origin: [Vec4; 3],
    pub scale: [Vec4; 3],
}

impl Ray {
    /// A ray from `origin` along `direction`, a unit vector if distances along the ray are to be metres.
    #[inline]
    pub fn new(origin: Vec3A, direction: Vec3A) -> Self {
        let (o, d) = (origin.to_array(), direction.to_array());
        // A zero component gives an infinite inverse, and 0 * inf would be NaN in the slab test; the largest finite number is as
        // good, because node boxes are padded and so never start exactly at the origin's plane.
        let slabs = std::array::from_fn(|a| {
            let inverse = (1.0 / d[a]).clamp(-f32::MAX, f32::MAX);
            Slab { origin: Vec4::splat(o[a]), inverse: Vec4::splat(inverse), near: usize::from(inverse < 0.0) }
        });
        let largest = {
            let m = direction.abs();
            if m.x > m.y && m.x > m.z {
                0
            } else if m.y > m.z {
                1
            } else {
                2
            }
        };
        let axis = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][largest];
        let inverse = 1.0 / d[axis[2]];
        let shear = Shear {
            axis,
            origin: axis.map(|a| Vec4::splat(o[a])),
            scale: [Vec4::splat(d[axis[0]] * inverse), Vec4::splat(d[axis[1]] * inverse), Vec4::splat(inverse)],
        };
        Self { origin, direction, slabs, shear }
    }

    /// A ray that leaves the surface point `p` by `offset` metres along the unit normal `n`, which is on the side of `direction`.
    #[inline]
    pub(crate) fn leaving(p: Vec3A, n: Vec3A, offset: f32, direction: Vec3A) -> Self {
        Self::new(p + n * offset, direction)
    }

    /// The point `t` metres along the ray.
    #[inline]
    pub fn at(&self, t: f32) -> Vec3A {
        self.origin + self.direction * t
    }
}
