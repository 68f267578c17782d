//! Ambient occlusion and bent normal of one pixel from the horizons of a few slices through the view direction.

use super::Surface;
use glam::Vec3A;
use std::f32::consts::{FRAC_PI_2, PI};

/// Number of slices per pixel; the pattern's filter combines the slices of 16 pixels.
const SLICES: usize = 3;
/// Depth samples on each side of a slice.
const STEPS: usize = 12;
/// Reach of occluders in units of the pixel's depth. The whole environment lights the scene, so distant large occluders count.
pub(super) const RADIUS: f32 = 0.7;
/// Share of the radius over which occlusion fades out.
const FADE: f32 = 0.2;
/// Share by which a horizon falls back per sample where the surface behind its occluder is visible again. Depth has no thickness,
/// and this lets light pass behind thin objects.
pub(super) const THIN: f32 = 0.03;

/// Smallest sine above the tangent plane at which a sample can occlude.
const ABOVE: f32 = 0.01;

/// How far and how firmly depth samples occlude.
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    /// See [`RADIUS`].
    pub radius: f32,
    /// See [`THIN`].
    pub thin: f32,
}

/// A plane through the view direction in which horizons are searched.
pub(super) struct Slice {
    /// (cos, sin) of its direction in the picture.
    pub towards: (f32, f32),
    /// Tangent on that side, across the view direction.
    pub t: Vec3A,
    /// Angle from the view direction to the normal's projection.
    pub tilt: f32,
    /// Length of that projection.
    pub length: f32,
}

/// `count` slices, turned by `turn` of their distance, for the unit normal `n` seen from `v`; slices perpendicular to the normal
/// are left out.
pub(super) fn slices(n: Vec3A, v: Vec3A, turn: f32, count: usize) -> impl Iterator<Item = Slice> {
    (0..count).filter_map(move |slice| {
        let (sin, cos) = ((slice as f32 + turn) * PI / count as f32).sin_cos();
        // In the slice's plane: v, and the tangent `t` on the side of (cos, sin).
        let across = Vec3A::new(cos, sin, 0.0);
        let t = (across - v * across.dot(v)).try_normalize()?;
        let axis = t.cross(v);
        let flat = n - axis * n.dot(axis);
        let length = flat.length();
        let tilt = flat.dot(t).atan2(flat.dot(v));
        (length >= 1e-4).then_some(Slice { towards: (cos, sin), t, tilt, length })
    })
}

/// Visible share of the cosine-weighted hemisphere and the (unnormalised) cosine-weighted mean open direction in camera space.
pub fn occlusion(surface: &Surface, i: usize, (turn, step): (f32, f32), reach: Reach) -> (f32, Vec3A) {
    let p = surface.points[i];
    let depth = -p.z;
    let v = -p.normalize();
    // A filtered normal may face away; horizons are taken about the nearest normal that does not.
    let n = surface.normal(i);
    let n = (n + v * (1e-3 - n.dot(v)).max(0.0)).normalize_or(v);
    let radius = reach.radius * depth;

    // Over all slices the open hemisphere's moment is 2 pi / 3 along n; a slice stands for pi / SLICES.
    let (mut open, mut weight, mut bent) = (0.0, 0.0, n * (2.0 / 3.0 * SLICES as f32));
    for Slice { towards: (cos, sin), t, tilt, length } in slices(n, v, turn, SLICES) {
        let walk = |towards, limit: f32| Walk { p, n, v, radius, thin: reach.thin, towards, step, lowest: limit.cos() };
        let right = walk((cos, sin), (tilt + FRAC_PI_2).min(PI)).highest(surface, |_, _, _| ());
        let left = walk((-cos, -sin), (tilt - FRAC_PI_2).max(-PI)).highest(surface, |_, _, _| ());
        // Angles from v, left negative, kept inside the normal's hemisphere.
        let h0 = (-left.acos()).max(tilt - FRAC_PI_2);
        let h1 = right.acos().min(tilt + FRAC_PI_2);
        let (sin_n, cos_n) = tilt.sin_cos();
        let (left, right) = (Sector::new(h0, sin_n, cos_n), Sector::new(h1, sin_n, cos_n));
        open += length * (left.area + right.area);
        // The slice's unoccluded values are known, so that few slices of a tilted normal still give exactly 1 and the normal in
        // the open.
        weight += length * (cos_n + tilt * sin_n);
        let lost_v = 2.0 / 3.0 * cos_n - left.along_v - right.along_v;
        let lost_t = 4.0 / 3.0 * sin_n - left.along_t - right.along_t;
        bent -= (v * lost_v + t * lost_t) * length;
    }
    if weight > 1e-6 { ((open / weight).clamp(0.0, 1.0), bent) } else { (1.0, n) }
}

/// Integrals from 0 to a horizon h of cos(a - n) |sin a| da, times 1, cos a and sin a (a from `v`, n the tilt of the normal).
pub(super) struct Sector {
    pub area: f32,
    along_v: f32,
    along_t: f32,
}

impl Sector {
    pub fn new(h: f32, sin_n: f32, cos_n: f32) -> Self {
        // Double and triple angles by products: this runs a million times a frame.
        let (s1, c1) = h.sin_cos();
        let (s2, c2) = (2.0 * s1 * c1, c1 * c1 - s1 * s1);
        let (s3, c3) = (s2 * c1 + c2 * s1, c2 * c1 - s2 * s1);
        let (cos_2h_n, cos_3h_n, sin_3h_n) = (c2 * cos_n + s2 * sin_n, c3 * cos_n + s3 * sin_n, s3 * cos_n - c3 * sin_n);
        let (cos_h_plus_n, sin_h_plus_n, sin_h_n) = (c1 * cos_n - s1 * sin_n, s1 * cos_n + c1 * sin_n, s1 * cos_n - c1 * sin_n);
        Self {
            area: 0.25 * (cos_n - cos_2h_n + 2.0 * h * sin_n),
            along_v: (4.0 * cos_n - cos_3h_n - 3.0 * cos_h_plus_n) / 12.0,
            along_t: (6.0 * sin_h_n - sin_3h_n - 3.0 * sin_h_plus_n + 8.0 * sin_n) / 12.0,
        }
    }
}

/// Half a slice: from the point `p` with normal `n`, seen from `v`, towards (`cos`, `sin`) in the picture (+y up).
pub(super) struct Walk {
    pub p: Vec3A,
    pub n: Vec3A,
    pub v: Vec3A,
    /// Camera-space metres.
    pub radius: f32,
    pub thin: f32,
    pub towards: (f32, f32),
    /// Offset of the samples along the walk, 0..1.
    pub step: f32,
    /// Least cosine from `v`.
    pub lowest: f32,
}

impl Walk {
    /// Cosine from `v` of the highest occluder. `raised` is called for each pixel that raises it, with the vector from `p` and
    /// the new cosine.
    pub fn highest(&self, surface: &Surface, mut raised: impl FnMut(usize, Vec3A, f32)) -> f32 {
        let Self { p, n, v, radius, towards: (cos, sin), lowest, .. } = *self;
        let camera = surface.camera;
        let depth = -p.z;
        // The reach in pixels of a pinhole camera, of a segment parallel to the picture.
        let (reach_x, reach_y) = (camera.fl_x * cos * radius / depth, -camera.fl_y * sin * radius / depth);
        let (start_x, start_y) = (camera.cx + camera.fl_x * p.x / depth, camera.cy - camera.fl_y * p.y / depth);
        let pixels = (reach_x * reach_x + reach_y * reach_y).sqrt();
        let mut highest = lowest;
        if pixels.is_nan() || pixels < 1.0 {
            return highest;
        }
        for k in 0..STEPS {
            // Denser near the pixel, the first one at least one pixel away.
            let s = (k as f32 + self.step) / STEPS as f32;
            let s = 1.0 / pixels + s * s * (1.0 - 1.0 / pixels);
            let Some(under) = surface.under(start_x + reach_x * s, start_y + reach_y * s) else { break };
            if !surface.known(under) {
                continue;
            }
            let to = surface.points[under] - p;
            let distance2 = to.length_squared();
            if distance2 < 1e-12 * depth * depth {
                continue;
            }
            let distance = distance2.sqrt();
            let cosine = to.dot(v) / distance;
            // Samples snap to pixel centres off the slice. On the surface's own plane this must not count as occlusion.
            if cosine > highest && to.dot(n) > ABOVE * distance {
                let fade = ((radius - distance) / (FADE * radius)).clamp(0.0, 1.0);
                highest += (cosine - highest) * fade;
                raised(under, to, highest);
            } else {
                highest += (cosine.max(lowest) - highest) * self.thin;
            }
        }
        highest.clamp(-1.0, 1.0)
    }
}
