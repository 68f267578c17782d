//! Analytic scenes for the tests: surfaces with exact intersections, and the G-buffer a pinhole camera sees of them.
#![allow(dead_code, reason = "each test file uses its own part")]

use glam::{Affine3A, Vec2, Vec3A};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Camera, Frame};

/// A surface; its object id is its place in the scene's list plus one.
#[derive(Clone, Copy, Debug)]
pub enum Surface {
    /// Centre and radius.
    Sphere(Vec3A, f32),
    /// Infinite plane: a point on it and its unit normal (one-sided: seen from the front only).
    Plane(Vec3A, Vec3A),
    /// Axis-aligned box: lower and upper corner.
    Block(Vec3A, Vec3A),
}

impl Surface {
    /// Distance along a unit `d` beyond 1e-4, and the unit normal there.
    pub fn hit(&self, o: Vec3A, d: Vec3A) -> Option<(f32, Vec3A)> {
        match *self {
            Self::Sphere(c, r) => {
                let oc = o - c;
                let b = oc.dot(d);
                let q = b * b - (oc.length_squared() - r * r);
                let t = -b - q.max(0.0).sqrt();
                (q > 0.0 && t > 1e-4).then(|| (t, (oc + d * t) / r))
            }
            Self::Plane(p, n) => {
                let t = (p - o).dot(n) / d.dot(n);
                (d.dot(n) < 0.0 && t > 1e-4).then_some((t, n))
            }
            Self::Block(low, high) => {
                let (a, b) = ((low - o) / d, (high - o) / d);
                let (near, far) = (a.min(b), a.max(b));
                let t = near.max_element();
                let n = Vec3A::select(near.cmpge(Vec3A::splat(t)), -d.signum(), Vec3A::ZERO);
                (t > 1e-4 && t < far.min_element()).then(|| (t, n.normalize()))
            }
        }
    }
}

/// First hit: distance, normal, object id.
pub fn trace(scene: &[Surface], o: Vec3A, d: Vec3A) -> Option<(f32, Vec3A, u32)> {
    let hits = scene.iter().enumerate().filter_map(|(i, s)| s.hit(o, d).map(|(t, n)| (t, n, i as u32 + 1)));
    hits.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// G-buffer of `scene`: grey, rough, one sample at each pixel's centre.
pub fn render(scene: &[Surface], camera: &Camera) -> Frame {
    let (width, height) = (camera.width, camera.height);
    let mut frame = Frame {
        width,
        height,
        alpha: Image::filled(width, height, 0.0),
        albedo: Rgb::filled(width, height, [0.0; 3]),
        normal: Rgb::filled(width, height, [0.0; 3]),
        depth: Image::filled(width, height, f32::INFINITY),
        material: Rgb::filled(width, height, [0.0; 3]),
        object_id: Image::filled(width, height, 0),
        material_id: Image::filled(width, height, 0),
        ..Frame::default()
    };
    frame.info.camera = *camera;
    let world_to_camera: Affine3A = camera.world_to_camera();
    for i in 0..width * height {
        let d = camera.ray_direction(Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5));
        if let Some((t, n, id)) = trace(scene, camera.position(), d) {
            frame.alpha.pixels[i] = 1.0;
            frame.albedo.pixels[i] = [0.5; 3];
            frame.normal.pixels[i] = (world_to_camera.matrix3 * n).to_array();
            frame.depth.pixels[i] = -world_to_camera.transform_point3a(camera.position() + d * t).z;
            frame.material.pixels[i] = [0.6, 0.0, 0.5];
            frame.object_id.pixels[i] = id;
            frame.material_id.pixels[i] = id;
        }
    }
    frame
}

/// World-space point of the centre of a pixel that hit something.
pub fn point(frame: &Frame, camera: &Camera, i: usize) -> Vec3A {
    let pixel = Vec2::new((i % frame.width) as f32 + 0.5, (i / frame.width) as f32 + 0.5);
    camera.unproject(pixel, frame.depth.pixels[i])
}
