//! Visibility of a distant light by marching through the depth buffer.

use super::Surface;
use glam::Vec3A;

/// Number of samples along the ray.
const STEPS: usize = 24;
/// Length of the ray in units of the pixel's depth.
const LENGTH: f32 = 1.0;
/// A ray that is deeper behind a depth sample than this share of its depth has passed behind the occluder.
const THICKNESS: f32 = 0.12;
/// Offset of the start from the surface, and smallest depth in front of the ray that occludes, as shares of the depth.
const BIAS: f32 = 0.002;

/// Visibility (0..=1) from pixel `i` towards `light`, a camera-space unit direction.
pub fn visibility(surface: &Surface, i: usize, light: Vec3A, (_, step): (f32, f32)) -> f32 {
    let camera = surface.camera;
    let n = surface.normal(i);
    if n.dot(light) <= 0.0 {
        return 0.0;
    }
    let depth = -surface.points[i].z;
    // One pixel's width on the surface; at smaller distances the surface would occlude itself.
    let pixel = depth / camera.fl_x.min(camera.fl_y);
    let p = surface.points[i] + n * (BIAS * depth + pixel);
    let mut clear = 1.0_f32;
    for k in 0..STEPS {
        let s = (k as f32 + step) / STEPS as f32;
        let q = p + light * (pixel + s * s * (LENGTH * depth - pixel));
        let ray_depth = -q.z;
        if ray_depth <= BIAS * depth {
            break;
        }
        let (at_x, at_y) = (camera.cx + camera.fl_x * q.x / ray_depth, camera.cy - camera.fl_y * q.y / ray_depth);
        let Some(under) = surface.under(at_x, at_y) else { break };
        // Minus infinity where nothing is known: no occluder.
        let behind = ray_depth + surface.points[under].z;
        let (least, most) = (BIAS * ray_depth, THICKNESS * ray_depth);
        // Fades in over the bias (the buffer is stepped) and out over the second half of the thickness (unknown).
        let hit = ((behind - least) / least).min((most - behind) / (0.5 * most)).clamp(0.0, 1.0);
        clear = clear.min(1.0 - hit);
        if clear <= 0.0 {
            break;
        }
    }
    clear
}
