//! The range of depths in a sequence, and depth on a logarithmic scale.

use crate::Frame;
use serde::{Deserialize, Serialize};

/// The planar depths, in metres, that depth pictures of a sequence show as 0 and 1. The bounds hold for the whole sequence: with
/// bounds of single frames, the pictures would flicker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DepthBounds {
    /// Least depth, > 0.
    pub near: f32,
    /// Largest depth, > `near`.
    pub far: f32,
}

impl DepthBounds {
    /// Smallest ratio of the bounds, so that a wall at one distance has bounds too.
    const LEAST_RATIO: f32 = 1.01;

    /// The least and the largest depth of some frames, or 1 m and 1.01 m if no pixel sees a surface.
    pub fn of<'a>(frames: impl IntoIterator<Item = &'a Frame>) -> Self {
        Self::of_depths(frames.into_iter().flat_map(|frame| frame.depth.pixels.iter().copied()))
    }

    /// The bounds of a list of depths. A depth that is not a positive number belongs to a pixel that sees no surface.
    pub fn of_depths(depths: impl IntoIterator<Item = f32>) -> Self {
        let (mut near, mut far) = (f32::INFINITY, 0.0f32);
        for depth in depths.into_iter().filter(|d| is_depth(*d)) {
            (near, far) = (near.min(depth), far.max(depth));
        }
        if near > far {
            (near, far) = (1.0, 1.0);
        }
        // Outside these limits the ratio is not a number of single precision.
        let near = near.clamp(1e-6, 1e12);
        Self { near, far: far.clamp(near * Self::LEAST_RATIO, 1e14) }
    }

    /// Whether these are the bounds of a range whose logarithm exists.
    pub fn is_range(self) -> bool {
        let ratio = self.far / self.near;
        self.near > 0.0 && ratio.is_finite() && ratio >= 1.0001
    }

    /// Maps a depth in metres to 0..=1, on a logarithmic scale. A pixel without a surface gives 1.
    pub fn encode(self, depth: f32) -> f32 {
        if is_depth(depth) { ((depth / self.near).ln() / (self.far / self.near).ln()).clamp(0.0, 1.0) } else { 1.0 }
    }
}

/// Whether a depth belongs to a surface: misses have infinite depth.
pub fn is_depth(depth: f32) -> bool {
    depth > 0.0 && depth.is_finite()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_bounds_hold_for_any_frames() {
        let frame = |depths: &[f32]| Frame {
            width: depths.len(),
            height: 1,
            depth: crate::Image { width: depths.len(), height: 1, pixels: depths.to_vec() },
            ..Frame::default()
        };
        let frames = [frame(&[2.0, f32::INFINITY]), frame(&[f32::NAN, 8.0, -1.0])];
        let bounds = DepthBounds::of(&frames);
        assert_eq!(bounds, DepthBounds { near: 2.0, far: 8.0 });
        assert!((bounds.encode(4.0) - 0.5).abs() < 1e-6);
        assert_eq!(
            [bounds.encode(1.0), bounds.encode(9.0), bounds.encode(f32::INFINITY), bounds.encode(f32::NAN)],
            [0.0, 1.0, 1.0, 1.0]
        );
        for depths in [vec![], vec![f32::INFINITY], vec![5.0, 5.0], vec![1e-30, f32::MAX]] {
            let bounds = DepthBounds::of(&[frame(&depths)]);
            assert!(bounds.is_range());
            assert!(depths.iter().all(|d| (0.0..=1.0).contains(&bounds.encode(*d))), "{bounds:?}");
        }
        for (near, far) in [(0.0, 1.0), (2.0, 2.0), (f32::NAN, 1.0), (1.0, f32::INFINITY), (-1.0, -2.0)] {
            assert!(!DepthBounds { near, far }.is_range(), "{near} to {far}");
        }
    }
}
