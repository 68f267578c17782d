//! Occlusion, bounced light and reflections from a G-buffer alone.
//!
//! Occlusion follows the horizon method of Jimenez et al. 2016 ("Practical real-time strategies for accurate indirect occlusion",
//! GTAO); light visibility marches towards the environment's dominant light. Both start from a pattern that repeats every
//! four pixels and does not change from frame to frame, and end with a filter that averages exactly one period of it.
//!
//! Rays are straight in the picture of a pinhole camera. Under a lens that bends lines, they are marched through that picture,
//! and each step is looked up where the lens shows it ([`Surface::shown`]). Steps are as dense as in the pinhole's picture, and
//! rays of reflections end at its border, even where the lens shows what lies beyond.

pub(crate) mod filter;
pub(crate) mod gather;
pub(crate) mod horizon;
pub(crate) mod march;
pub(crate) mod reflect;

use glam::{DVec2, Vec2, Vec3A};
use rayon::prelude::*;
use renderflow_frame::ibl::Shading;
use renderflow_frame::{Camera, Distortion};

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
            if !depth.is_finite() {
                NOWHERE
            } else if camera.distortion.is_some() {
                camera.direction_cam(Vec2::new(x, y)) * *depth
            } else {
                Vec3A::new((x - camera.cx) * scale_x * depth, (camera.cy - y) * scale_y * depth, -depth)
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

    /// Image point that shows what a pinhole camera would show at the image point (x, y).
    #[inline]
    pub fn shown(&self, x: f32, y: f32) -> [f32; 2] {
        match &self.camera.distortion {
            None => [x, y],
            Some(lens) => bent(self.camera, lens, x, y),
        }
    }

    /// Index of the pixel that shows what a pinhole camera would show at the image point (x, y).
    #[inline]
    pub fn under(&self, x: f32, y: f32) -> Option<usize> {
        let [x, y] = self.shown(x, y);
        self.pixel(x, y)
    }
}

/// [`Surface::shown`] through a lens that bends lines.
#[inline(never)]
fn bent(camera: &Camera, lens: &Distortion, x: f32, y: f32) -> [f32; 2] {
    let straight = DVec2::new(((x - camera.cx) / camera.fl_x).into(), ((y - camera.cy) / camera.fl_y).into());
    let shown = lens.distort(straight).as_vec2();
    [camera.cx + camera.fl_x * shown.x, camera.cy + camera.fl_y * shown.y]
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

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::image::{Image, Rgb};
    use renderflow_frame::{Environment, Frame, Light, ibl};

    /// A frame that is covered everywhere, at depths between 2 and 3 metres.
    fn frame(camera: Camera) -> Frame {
        let (width, height) = (camera.width, camera.height);
        let mut frame = Frame {
            width,
            height,
            alpha: Image::filled(width, height, 1.0),
            albedo: Rgb::filled(width, height, [0.5; 3]),
            normal: Rgb::filled(width, height, [0.0, 0.0, 1.0]),
            depth: Image::from_fn(width, height, |x, y| 2.0 + ((3 * x + 5 * y) % 7) as f32 / 7.0),
            material: Rgb::filled(width, height, [0.6, 0.0, 0.5]),
            object_id: Image::filled(width, height, 1),
            material_id: Image::filled(width, height, 1),
            ..Frame::default()
        };
        frame.info.camera = camera;
        frame
    }

    #[test]
    fn points_lie_where_the_camera_sees_them_and_steps_come_back_to_their_pixels() {
        let pinhole = Camera::look_at(Vec3A::new(0.4, 1.2, 3.0), Vec3A::ZERO, Vec3A::Y, 0.8, 32, 24);
        let barrel = Distortion { k1: -0.2, p1: 0.01, ..Distortion::default() };
        let pincushion = Distortion { k1: 0.3, k4: 0.1, p2: -0.01, ..Distortion::default() };
        let light = Light::new(Environment::constant([1.0; 3]));
        for distortion in [None, Some(barrel), Some(pincushion)] {
            let camera = Camera { distortion, ..pinhole };
            let frame = frame(camera);
            let shading = ibl::shade(&frame, &light);
            let surface = Surface::new(&shading, &camera);
            for (i, p) in surface.points.iter().enumerate() {
                let centre = Vec2::new((i % 32) as f32 + 0.5, (i / 32) as f32 + 0.5);
                let expected = camera.unproject(centre, frame.depth.pixels[i]);
                let found = camera.camera_to_world.transform_point3a(*p);
                assert!(found.distance(expected) < 1e-5, "{distortion:?}, pixel {i}: {found} for {expected}");
                let straight = [camera.cx - camera.fl_x * p.x / p.z, camera.cy + camera.fl_y * p.y / p.z];
                assert!(Vec2::from(surface.shown(straight[0], straight[1])).distance(centre) < 1e-3);
                assert_eq!(surface.under(straight[0], straight[1]), Some(i));
            }
        }
    }
}
