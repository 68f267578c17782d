//! The average over one period of the sampling pattern that stays on one surface.

use super::{Sample, Surface};
use glam::Vec3A;

/// Five taps with halved ends cover one period of four, centred.
const TAPS: [(isize, f32); 5] = [(-2, 0.5), (-1, 1.0), (0, 1.0), (1, 1.0), (2, 0.5)];
/// Least cosine between the normals of pixels averaged together.
const SAME_NORMAL: f32 = 0.8;
/// Largest distance from the pixel's tangent plane, as a share of the depth.
const SAME_PLANE: f32 = 0.01;

/// Mean of `raw` around (x, y) over pixels of the same surface, itself at least.
pub fn average(surface: &Surface, raw: &[Sample], x: usize, y: usize) -> Sample {
    let here = y * surface.width + x;
    let (n, p) = (surface.normal(here), surface.points[here]);
    let tolerance = SAME_PLANE * -p.z;
    let mut sum = Sample { occlusion: 0.0, visibility: 0.0, bent: Vec3A::ZERO };
    let mut total = 0.0;
    for (dy, wy) in TAPS {
        let Some(row) = y.checked_add_signed(dy).filter(|row| *row < surface.height) else { continue };
        for (dx, wx) in TAPS {
            let Some(column) = x.checked_add_signed(dx).filter(|column| *column < surface.width) else { continue };
            let i = row * surface.width + column;
            let same =
                surface.known(i) && surface.normal(i).dot(n) > SAME_NORMAL && (surface.points[i] - p).dot(n).abs() < tolerance;
            if same || i == here {
                let weight = wx * wy;
                let sample = &raw[i];
                sum.occlusion += sample.occlusion * weight;
                sum.visibility += sample.visibility * weight;
                sum.bent += sample.bent * weight;
                total += weight;
            }
        }
    }
    Sample { occlusion: sum.occlusion / total, visibility: sum.visibility / total, bent: sum.bent / total }
}
