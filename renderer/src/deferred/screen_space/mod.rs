//! Occlusion, bounced light and reflections from a G-buffer alone.
//!
//! Occlusion follows the horizon method of Jimenez et al. 2016 ("Practical real-time strategies for accurate indirect occlusion",
//! GTAO); light visibility marches towards the environment's dominant light. Both start from a pattern that repeats every
//! four pixels and does not change from frame to frame, and end with a filter that averages exactly one period of it.

pub(crate) mod filter;
pub(crate) mod gather;
pub(crate) mod horizon;
pub(crate) mod march;
pub(crate) mod reflect;

use glam::Vec3A;
use rayon::prelude::*;
use renderflow_frame::Camera;
use renderflow_frame::ibl::Shading;

/// Side of the repeating pattern, pixels.
const PATTERN: usize = 4;

/// The covered surface as points and normals in camera space.
pub(crate) struct Surface<'a> {
    pub camera: &'a Camera,
    pub width: usize,
    pub height: usize,
    /// Points at the pixels' centres, computed once because each is read about a hundred times. Pixels without a depth hold
    /// [`NOWHERE`].
    pub points: Vec<Vec3A>,
    pub normals: &'a [[f32; 3]],
}

/// Stands for a pixel without a known depth: infinitely far ahead.
const NOWHERE: Vec3A = Vec3A::new(0.0, 0.0, f32::NEG_INFINITY);

impl<'a> Surface<'a> {
    pub fn new(shading: &'a Shading, camera: &'a Camera) -> Self {
        let (width, height) = (shading.surfaces.depth.width, shading.surfaces.depth.height);
        let (scale_x, scale_y) = (1.0 / camera.fl_x, 1.0 / camera.fl_y);
        let point = |(i, depth): (usize, &f32)| {
            let (x, y) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
            if depth.is_finite() {
                Vec3A::new((x - camera.cx) * scale_x * depth, (camera.cy - y) * scale_y * depth, -depth)
            } else {
                NOWHERE
            }
        };
        let points = shading.surfaces.depth.pixels.par_iter().with_min_len(1024).enumerate().map(point).collect();
        Self { camera, width, height, points, normals: &shading.surfaces.normal.pixels }
    }

    /// Whether pixel `i` has a depth.
    #[inline]
    pub fn known(&self, i: usize) -> bool {
        self.points[i].z.is_finite()
    }

    #[inline]
    pub fn normal(&self, i: usize) -> Vec3A {
        Vec3A::from_array(self.normals[i])
    }

    /// Index of the pixel that holds an image point.
    #[inline]
    pub fn pixel(&self, x: f32, y: f32) -> Option<usize> {
        // Negative values are caught here, because the cast would round them to 0.
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| y as usize * self.width + x as usize)
    }
}

/// (turn, step) of the pattern at a pixel, each one of 16 values in 0..1; every 4 x 4 window holds all 16 of each.
pub(crate) fn phase(x: usize, y: usize) -> (f32, f32) {
    // A 4 x 4 ordered matrix: neighbours differ strongly, so that small filters see most of the range.
    const TURN: [u8; 16] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
    const STEP: [u8; 16] = [5, 10, 13, 2, 0, 15, 8, 7, 12, 3, 4, 11, 9, 6, 1, 14];
    let i = y % PATTERN * PATTERN + x % PATTERN;
    let unit = |k: u8| (f32::from(k) + 0.5) / 16.0;
    (unit(TURN[i]), unit(STEP[i]))
}
