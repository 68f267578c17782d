//! Rays.

use glam::Vec3A;

/// A half-line. What queries derive from one is derived where it is needed, in registers.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, world space, metres.
    pub origin: Vec3A,
    /// Direction, world space; unit but for rays taken to the space of an instance, where `t` stays in metres of the world.
    pub direction: Vec3A,
}

impl Ray {
    /// A ray from `origin` along `direction`; distances along the ray are metres if `direction` is a unit vector.
    #[inline]
    pub fn new(origin: Vec3A, direction: Vec3A) -> Self {
        Self { origin, direction }
    }

    /// A ray that leaves the surface point `p` by `offset` metres along the unit normal `n`, which is on the side of `direction`.
    #[inline]
    pub(crate) fn leaving(p: Vec3A, n: Vec3A, offset: f32, direction: Vec3A) -> Self {
        Self::new(p + n * offset, direction)
    }
}
