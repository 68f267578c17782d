//! Screen-space reflections: marches the mirror direction through the depth buffer and looks up the picture's colour at the hit.

use super::Surface;
use glam::{Vec3A, Vec4};
use rayon::prelude::*;

/// Number of samples along a ray before the hit is refined.
const STEPS: usize = 48;
/// Number of bisections of the step that found the hit.
const HALVINGS: usize = 5;
/// Longest ray in units of the pixel's depth.
const LENGTH: f32 = 6.0;
/// A ray that is deeper behind a depth sample than this share of its depth has passed behind.
const THICKNESS: f32 = 0.08;
/// Share of the picture's size over which reflections fade out at its border.
const BORDER: f32 = 0.06;

/// Where a ray meets the picture.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    /// Image point, pixels.
    pub at: [f32; 2],
    /// Metres from the start.
    pub distance: f32,
    /// 1 in the middle of the picture; less at its border and where a surface is uncertain.
    pub confidence: f32,
}

/// Marches from pixel `i` along `direction` (camera space, unit).
pub fn march(surface: &Surface, i: usize, direction: Vec3A, step: f32) -> Option<Meeting> {
    let camera = surface.camera;
    let n = surface.normal(i);
    let depth = -surface.points[i].z;
    let pixel = depth / camera.fl_x.min(camera.fl_y);
    let p = surface.points[i] + n * (1.5 * pixel);
    // Ends before the camera's plane.
    let mut length = LENGTH * depth;
    if direction.z > 0.0 {
        length = length.min(0.95 * -p.z / direction.z);
    }
    let q = p + direction * length;
    if p.z >= 0.0 || q.z >= 0.0 || !q.is_finite() {
        return None;
    }
    let project = |p: Vec3A| {
        let inverse = -1.0 / p.z;
        Vec3A::new(camera.cx + camera.fl_x * p.x * inverse, camera.cy - camera.fl_y * p.y * inverse, inverse)
    };
    // A pinhole camera's image point and the inverse depth are linear along the segment.
    let (start, end) = (project(p), project(q));
    let along = end - start;
    let mut last = 1.0_f32;
    for (from, by, size) in [(start.x, along.x, surface.width as f32), (start.y, along.y, surface.height as f32)] {
        if by > 0.0 {
            last = last.min((size - from) / by);
        } else if by < 0.0 {
            last = last.min(-from / by);
        }
    }
    let pixels = (along.x * along.x + along.y * along.y).sqrt() * last;
    if pixels.is_nan() || pixels < 1.0 {
        return None;
    }
    // (behind the surface, ray's depth) at a share of the segment.
    let probe = |s: f32| {
        let at = start + along * s;
        let under = surface.under(at.x, at.y)?;
        let ray_depth = 1.0 / at.z;
        Some((ray_depth + surface.points[under].z, ray_depth, under))
    };
    let mut before = 0.0;
    let mut depth_before = 1.0 / start.z;
    for k in 0..STEPS {
        let u = (k as f32 + step) / STEPS as f32;
        // Denser near the pixel, at least one pixel on.
        let s = last * (1.0 / pixels + u * (0.35 + 0.65 * u) * (1.0 - 1.0 / pixels)).min(1.0);
        let Some((behind, ray_depth, _)) = probe(s) else { break };
        let thickness = THICKNESS * ray_depth + (ray_depth - depth_before).abs();
        if behind > 0.0 && behind < thickness {
            let (mut low, mut high) = (before, s);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                match probe(middle) {
                    Some((behind, ..)) if behind <= 0.0 => low = middle,
                    _ => high = middle,
                }
            }
            let (behind, ray_depth, under) = probe(high)?;
            let at = start + along * high;
            let sure = 1.0 - (behind / (THICKNESS * ray_depth)).clamp(0.0, 1.0);
            // From behind, the surface shows a side that is not in the picture.
            if surface.normal(under).dot(direction) < 0.0 && sure > 0.0 {
                let point = Vec3A::new(
                    (at.x - camera.cx) / camera.fl_x * ray_depth,
                    (camera.cy - at.y) / camera.fl_y * ray_depth,
                    -ray_depth,
                );
                let border = |at: f32, size: usize| (at.min(size as f32 - at) / (BORDER * size as f32)).clamp(0.0, 1.0);
                let at = surface.shown(at.x, at.y);
                let confidence = border(at[0], surface.width) * border(at[1], surface.height) * (2.0 * sure).min(1.0);
                return Some(Meeting { at, distance: (point - p).length(), confidence });
            }
        }
        (before, depth_before) = (s, ray_depth);
    }
    None
}

/// A picture at halved sizes: colour times coverage, then coverage.
pub struct Pyramid {
    levels: Vec<(usize, usize, Vec<Vec4>)>,
}

impl Pyramid {
    /// `picture[i]` counts where `covered(i)`.
    pub fn new(width: usize, height: usize, picture: &[Vec3A], covered: impl Fn(usize) -> bool + Sync) -> Self {
        let first = picture.par_iter().with_min_len(1024).enumerate();
        let first = first.map(|(i, colour)| if covered(i) { colour.extend(1.0) } else { Vec4::ZERO }).collect();
        let mut levels: Vec<(usize, usize, Vec<Vec4>)> = vec![(width, height, first)];
        while let Some((width, height, fine)) = levels.last() {
            if *width <= 2 || *height <= 2 {
                break;
            }
            let (w, h) = (width.div_ceil(2), height.div_ceil(2));
            let at = |x: usize, y: usize| fine[y.min(height - 1) * width + x.min(width - 1)];
            let mean = |i: usize| {
                let (x, y) = (2 * (i % w), 2 * (i / w));
                (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) * 0.25
            };
            let coarse = (0..w * h).map(mean).collect();
            levels.push((w, h, coarse));
        }
        Self { levels }
    }

    /// Mean colour over a disc of `radius` pixels about an image point of the finest level, and the share of it that is covered.
    pub fn sample(&self, at: [f32; 2], radius: f32) -> (Vec3A, f32) {
        let level = (2.0 * radius).max(1.0).log2().min((self.levels.len() - 1) as f32);
        let below = (level as usize).min(self.levels.len() - 1);
        let above = (below + 1).min(self.levels.len() - 1);
        let t = level - below as f32;
        let value = self.bilinear(below, at) * (1.0 - t) + self.bilinear(above, at) * t;
        if value.w > 1e-4 { (Vec3A::from_vec4(value) / value.w, value.w.min(1.0)) } else { (Vec3A::ZERO, 0.0) }
    }

    fn bilinear(&self, level: usize, at: [f32; 2]) -> Vec4 {
        let (width, height, pixels) = &self.levels[level];
        let scale = 1.0 / (1u32 << level) as f32;
        let place = |at: f32, size: usize| (at * scale - 0.5).clamp(0.0, (size - 1) as f32);
        let (x, y) = (place(at[0], *width), place(at[1], *height));
        let (column, row) = (x as usize, y as usize);
        let (right, under) = ((column + 1).min(width - 1), (row + 1).min(height - 1));
        let (s, t) = (x - column as f32, y - row as f32);
        let pixel = |x: usize, y: usize| pixels[y * width + x];
        (pixel(column, row) * (1.0 - s) + pixel(right, row) * s) * (1.0 - t)
            + (pixel(column, under) * (1.0 - s) + pixel(right, under) * s) * t
    }
}
