//! Where rays that leave a surface begin.

use glam::Vec3A;

/// See [`Start`].
const OFFSET_REACH: f32 = 5.0 * f32::EPSILON;
/// See [`Start`].
const OFFSET_EXTENT: f32 = 4.0 * f32::EPSILON;
/// See [`Start`].
const MOST_INWARD: f32 = 1.0 / 16.0;

/// How far from a surface new rays start, without any absolute length.
pub(super) struct Start {
    /// Along the normal, metres. Interpolating a point whose weights are off by two roundings, and the transform of its corners,
    /// move it by less than four roundings of its coordinates, of which only the part along the normal matters; the test of a
    /// triangle errs by less than four of a number as large as the triangle. Measured in closed rooms: half of both constants
    /// makes one ray in 30 000 meet its own surface or leak, these none in 3e7.
    pub offset: f32,
    /// How far weights are drawn to 1/3, at least: enough to move the point off the triangle's edges by twice the offset.
    /// Otherwise a point on an edge between two walls can lie behind the other wall by a rounding.
    inward: f32,
}

impl Start {
    #[inline]
    pub fn new(corners: &[Vec3A; 3], n: Vec3A, doubled_area: f32, reach: Vec3A) -> Self {
        let [a, b, c] = *corners;
        let extent = (a.max(b).max(c) - a.min(b).min(c)).max_element();
        let offset = OFFSET_REACH * n.abs().dot(reach) + OFFSET_EXTENT * extent;
        // The smallest height is the doubled area by the longest edge, which is less than twice the extent. Needles are left
        // alone beyond a limit: there the point would move along the needle.
        Self { offset, inward: (4.0 * offset * extent / doubled_area).min(MOST_INWARD) }
    }

    #[inline]
    pub fn inward(&self, weights: [f32; 3]) -> [f32; 3] {
        weights.map(|w| w * (1.0 - 3.0 * self.inward) + self.inward)
    }
}
