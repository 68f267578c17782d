//! Screen-space features: what a G-buffer alone can say about occlusion.
//!
//! Occlusion follows the horizon method of Jimenez et al. 2016 ("Practical real-time strategies for accurate indirect occlusion",
//! GTAO); light visibility marches towards the environment's dominant light. Both start from a pattern that repeats every
//! four pixels and does not change from frame to frame, and end with a filter that averages exactly one period of it.

pub(crate) mod filter;
pub(crate) mod gather;
pub(crate) mod horizon;
pub(crate) mod march;
pub(crate) mod reflect;

use crate::Camera;
use crate::environment::Environment;
use crate::ibl::Shading;
use crate::image::{Image, Rgb};
use glam::Vec3A;
use rayon::prelude::*;

/// Occlusion read off the depth buffer; 1 where nothing is covered.
#[derive(Clone, Debug)]
pub struct ScreenSpace {
    /// Ambient occlusion: visible share of the cosine-weighted hemisphere, 0..=1.
    pub occlusion: Image<f32>,
    /// Cosine-weighted mean unoccluded direction (camera space, unit), 0 where nothing is covered.
    pub bent_normal: Rgb,
    /// Visibility towards the environment's dominant light, ray-marched through the depth buffer, 0..=1; 0 where the surface faces
    /// away from it, 1 everywhere if the environment has no dominant light.
    pub light_visibility: Image<f32>,
}

/// Side of the repeating pattern, pixels.
const PATTERN: usize = 4;

/// The covered surface as points and normals in camera space.
pub(crate) struct Surface<'a> {
    pub camera: &'a Camera,
    pub width: usize,
    pub height: usize,
    /// Points at the pixels' centres, computed once: each is read some hundred times. Pixels without a depth hold [`NOWHERE`].
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
        // Negative values are caught here: the cast would round them to 0.
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| y as usize * self.width + x as usize)
    }
}

/// Features of one pixel.
#[derive(Clone, Copy)]
pub(crate) struct Sample {
    occlusion: f32,
    visibility: f32,
    bent: Vec3A,
}

impl Sample {
    const OPEN: Self = Self { occlusion: 1.0, visibility: 1.0, bent: Vec3A::ZERO };
}

/// Computes all screen-space features; deterministic (the same bits for any number of threads), no noise that changes between frames.
/// Pixels without coverage or depth cost nothing.
///
/// # Panics
/// When a picture of `shading` has another size than its `depth`.
pub fn features(shading: &Shading, camera: &Camera, environment: &Environment) -> ScreenSpace {
    let (width, height) = (shading.surfaces.depth.width, shading.surfaces.depth.height);
    let surface = Surface::new(shading, camera);
    let (direction, share) = environment.dominant_direction();
    let light = (share > 0.0).then(|| camera.world_to_camera().matrix3 * direction);

    let row = width.max(1);
    let mut raw = vec![Sample::OPEN; width * height];
    raw.par_chunks_mut(row).enumerate().for_each(|(y, samples)| {
        for (x, sample) in samples.iter_mut().enumerate() {
            let i = y * width + x;
            if !surface.known(i) {
                continue;
            }
            let phase = phase(x, y);
            let (occlusion, bent) = horizon::occlusion(&surface, i, phase, horizon::Reach::FEATURES);
            let visibility = light.map_or(1.0, |light| march::visibility(&surface, i, light, phase));
            *sample = Sample { occlusion, visibility, bent };
        }
    });

    let mut out = ScreenSpace {
        occlusion: Image::filled(width, height, 1.0),
        bent_normal: Rgb::filled(width, height, [0.0; 3]),
        light_visibility: Image::filled(width, height, 1.0),
    };
    (
        out.occlusion.pixels.par_chunks_mut(row),
        out.bent_normal.pixels.par_chunks_mut(row),
        out.light_visibility.pixels.par_chunks_mut(row),
    )
        .into_par_iter()
        .enumerate()
        .for_each(|(y, (occlusion, bent, visibility))| {
            for x in 0..width {
                let i = y * width + x;
                let n = surface.normal(i);
                if !surface.known(i) {
                    // Covered by something too thin to have a depth anywhere near: open, bent towards its own normal.
                    bent[x] = n.to_array();
                    continue;
                }
                let smooth = filter::average(&surface, &raw, x, y);
                occlusion[x] = smooth.occlusion.clamp(0.0, 1.0);
                visibility[x] = smooth.visibility.clamp(0.0, 1.0);
                bent[x] = smooth.bent.normalize_or(n).to_array();
            }
        });
    out
}

/// (turn, step) of the pattern at a pixel, each one of 16 values in 0..1; every 4 x 4 window holds all 16 of each.
pub(crate) fn phase(x: usize, y: usize) -> (f32, f32) {
    // A 4 x 4 ordered matrix: neighbours differ much, so that small filters see most of the range.
    const TURN: [u8; 16] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
    const STEP: [u8; 16] = [5, 10, 13, 2, 0, 15, 8, 7, 12, 3, 4, 11, 9, 6, 1, 14];
    let i = y % PATTERN * PATTERN + x % PATTERN;
    let unit = |k: u8| (f32::from(k) + 0.5) / 16.0;
    (unit(TURN[i]), unit(STEP[i]))
}
