//! The average over one period of the sampling pattern that stays on one surface.

use super::Surface;
use glam::Vec4;
use rayon::prelude::*;

/// Five taps with halved ends cover one period of four, centred.
const TAPS: [(isize, f32); 5] = [(-2, 0.5), (-1, 1.0), (0, 1.0), (1, 1.0), (2, 0.5)];
/// Least cosine between the normals of pixels averaged together.
const SAME_NORMAL: f32 = 0.8;
/// Largest distance from the pixel's tangent plane, as a share of the depth.
const SAME_PLANE: f32 = 0.01;

/// Calls `f(index, weight)` for the pixels around (x, y) that show the same surface, including (x, y).
pub fn neighbours(surface: &Surface, x: usize, y: usize, mut f: impl FnMut(usize, f32)) {
    let here = y * surface.width + x;
    let (n, p) = (surface.normal(here), surface.points[here]);
    let tolerance = SAME_PLANE * -p.z;
    for (dy, wy) in TAPS {
        let Some(row) = y.checked_add_signed(dy).filter(|row| *row < surface.height) else { continue };
        for (dx, wx) in TAPS {
            let Some(column) = x.checked_add_signed(dx).filter(|column| *column < surface.width) else { continue };
            let i = row * surface.width + column;
            let same =
                surface.known(i) && surface.normal(i).dot(n) > SAME_NORMAL && (surface.points[i] - p).dot(n).abs() < tolerance;
            if same || i == here {
                f(i, wx * wy);
            }
        }
    }
}

/// Four values per pixel: at pixels with a depth the mean of `f(index, (turn, step))` over their [`neighbours`], and `otherwise`
/// elsewhere.
pub fn smooth(surface: &Surface, otherwise: Vec4, f: impl Fn(usize, (f32, f32)) -> Vec4 + Sync) -> Vec<Vec4> {
    let (width, row) = (surface.width, surface.width.max(1));
    let mut raw = vec![otherwise; width * surface.height];
    raw.par_chunks_mut(row).enumerate().for_each(|(y, values)| {
        for (x, value) in values.iter_mut().enumerate() {
            if surface.known(y * width + x) {
                *value = f(y * width + x, super::phase(x, y));
            }
        }
    });
    let mut out = vec![otherwise; width * surface.height];
    out.par_chunks_mut(row).enumerate().for_each(|(y, values)| {
        for (x, value) in values.iter_mut().enumerate() {
            if surface.known(y * width + x) {
                let (mut sum, mut total) = (Vec4::ZERO, 0.0);
                neighbours(surface, x, y, |i, weight| {
                    sum += raw[i] * weight;
                    total += weight;
                });
                *value = sum / total;
            }
        }
    });
    out
}
