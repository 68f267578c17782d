//! The environment: an equirectangular map of scene-linear radiance around the scene.

mod angle;
mod dominant;

pub use dominant::DominantLight;

use crate::Camera;
use crate::image::{Image, Rgb};
pub use angle::atan2;
use glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::f32::consts::{PI, TAU};

/// The largest difference of radiance, as a share of the mean, between directions whose mean serves for a pixel.
const EVEN: f32 = 0.05;

/// Equirectangular environment map with the orientation and gain it is used with.
///
/// Direction of map coordinates (u, v): `d = (sin phi sin theta, cos theta, -cos phi sin theta)`, `phi = 2 pi u`, `theta = pi v`;
/// u runs to the right and wraps, v runs down. Texel centres lie at half-integers. Values between texel centres are bilinear;
/// beyond the first and last row the neighbour is the same row half a turn away, so radiance is continuous across the poles.
#[derive(Clone, Debug, PartialEq)]
pub struct Environment {
    /// Scene-linear radiance; every value finite and >= 0.
    pub map: Rgb,
    /// Radians; a world direction is turned by `-rotation` about +Y before the map is looked up, so the sky turns by `+rotation`.
    pub rotation: f32,
    /// Gain on the map's values.
    pub intensity: f32,
}

impl Environment {
    /// The same radiance from everywhere.
    pub fn constant(radiance: [f32; 3]) -> Self {
        Self { map: Rgb::filled(1, 1, radiance), rotation: 0.0, intensity: 1.0 }
    }

    /// Whether every texel holds the same value, so that all directions have the same radiance.
    pub fn is_constant(&self) -> bool {
        self.map.pixels.windows(2).all(|pair| pair[0] == pair[1])
    }

    /// An environment with another map and the same rotation and intensity.
    pub fn with_map(&self, map: Rgb) -> Self {
        Self { map, ..*self }
    }

    /// Map coordinates (each 0..=1) of a world-space direction (unit length not needed), rotation applied.
    #[inline]
    pub fn uv(&self, direction: Vec3A) -> Vec2 {
        // Turning by -rotation about +Y raises the azimuth: phi is measured from -Z towards +X, against the sense of +Y.
        let turns = (atan2(direction.x, -direction.z) + self.rotation) * (1.0 / TAU);
        // The arc tangent keeps its accuracy near the poles, where an arc cosine of y loses half the digits.
        let theta = atan2((direction.x * direction.x + direction.z * direction.z).sqrt(), direction.y);
        Vec2::new((turns - floor(turns) as f32).clamp(0.0, 1.0), theta * (1.0 / PI))
    }

    /// World-space unit direction of map coordinates, rotation applied; inverse of [`Self::uv`].
    #[inline]
    pub fn direction(&self, uv: Vec2) -> Vec3A {
        let (sin_phi, cos_phi) = (TAU * uv.x - self.rotation).sin_cos();
        let (sin_theta, cos_theta) = (PI * uv.y).sin_cos();
        Vec3A::new(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
    }

    /// Radiance from a world-space direction: bilinear, times `intensity`.
    #[inline]
    pub fn radiance(&self, direction: Vec3A) -> [f32; 3] {
        self.radiance_uv(self.uv(direction))
    }

    /// Mean radiance over pixel (x, y) of `camera`: of four directions if they agree to [`EVEN`], else of sixteen.
    pub fn over_pixel(&self, camera: &Camera, (x, y): (usize, usize)) -> [f32; 3] {
        // A grid of four by four. The first directions of the rows lie in four columns.
        let seen = |row: usize, step: usize| {
            let at = Vec2::new((([1, 3, 0, 2][row] + step) % 4) as f32, row as f32);
            let through = Vec2::new(x as f32, y as f32) + (at + 0.5) / 4.0;
            Vec3A::from_array(self.radiance(camera.ray_direction(through)))
        };
        let first = [0, 1, 2, 3].map(|row| seen(row, 0));
        let sum: Vec3A = first.iter().sum();
        let [low, high] = [Vec3A::min, Vec3A::max].map(|end| first.into_iter().reduce(end).unwrap_or(Vec3A::ZERO));
        if (high - low).cmple(EVEN / 4.0 * sum).all() {
            return (sum / 4.0).to_array();
        }
        let others = (0..4).flat_map(|row| (1..4).map(move |step| (row, step)));
        ((sum + others.map(|(row, step)| seen(row, step)).sum::<Vec3A>()) / 16.0).to_array()
    }

    /// Radiance at map coordinates as [`Self::uv`] returns them: bilinear, times `intensity`. An empty map is black.
    #[inline]
    pub fn radiance_uv(&self, uv: Vec2) -> [f32; 3] {
        let (width, height) = (self.map.width, self.map.height);
        match self.map.pixels.len() {
            0 => return [0.0; 3],
            1 => return self.map.pixels[0].map(|value| value * self.intensity),
            _ => {}
        }
        let y = uv.y * height as f32 - 0.5;
        let row = floor(y);
        let t = y - row as f32;
        let a = self.row_value(row as isize, uv.x);
        let b = self.row_value(row as isize + 1, uv.x);
        let a = a + (b - a) * t;
        debug_assert!(width > 0);
        (a * self.intensity).to_array()
    }

    /// The map at row `row` (-1 ..= height), linear along `u`.
    #[inline]
    fn row_value(&self, row: isize, u: f32) -> Vec3A {
        let (width, height) = (self.map.width, self.map.height);
        // Past a pole the map continues half a turn away.
        let (row, u) = if row < 0 {
            (0, u + 0.5)
        } else if row as usize >= height {
            (height - 1, u + 0.5)
        } else {
            (row as usize, u)
        };
        let x = u * width as f32 - 0.5;
        let column = floor(x);
        let t = x - column as f32;
        let wrap = |i: isize| {
            if i < 0 {
                (i + width as isize) as usize
            } else if i as usize >= width {
                i as usize - width
            } else {
                i as usize
            }
        };
        let left = wrap(column as isize);
        let right = if left + 1 == width { 0 } else { left + 1 };
        let texels = &self.map.pixels[row * width..(row + 1) * width];
        let (a, b) = (Vec3A::from_array(texels[left]), Vec3A::from_array(texels[right]));
        a + (b - a) * t
    }

    /// Solid angle in steradians of one texel of row `row`; all texels of a map sum to 4 pi.
    pub fn texel_solid_angle(&self, row: usize) -> f32 {
        let band = |row: usize| (std::f64::consts::PI * row as f64 / self.map.height as f64).cos();
        (std::f64::consts::TAU / self.map.width as f64 * (band(row) - band(row + 1))) as f32
    }

    /// World-space unit direction of the centre of a texel.
    pub fn texel_direction(&self, column: usize, row: usize) -> Vec3A {
        let (width, height) = (self.map.width as f32, self.map.height as f32);
        self.direction(Vec2::new((column as f32 + 0.5) / width, (row as f32 + 0.5) / height))
    }

    /// Area-averaged copy of the map at `width x height` (rotation and intensity kept). Weights are solid angles, so the total
    /// energy is unchanged; an axis longer than the map's own repeats its texels.
    pub fn downsampled(&self, width: usize, height: usize) -> Self {
        let source = &self.map;
        if (width, height) == (source.width, source.height) || source.pixels.is_empty() || width == 0 || height == 0 {
            return self.clone();
        }
        let columns = overlaps(source.width, width, |x| x);
        let rows = overlaps(source.height, height, |y| 1.0 - (std::f64::consts::PI * y).cos());
        let mut pixels = vec![[0.0; 3]; width * height];
        pixels.par_chunks_mut(width).zip(&rows).for_each(|(out, (first_row, row_weights))| {
            for (pixel, (first_column, column_weights)) in out.iter_mut().zip(&columns) {
                let mut sum = Vec3A::ZERO;
                for (dy, wy) in row_weights.iter().enumerate() {
                    let start = (first_row + dy) * source.width + first_column;
                    let texels = &source.pixels[start..start + column_weights.len()];
                    let line: Vec3A = texels.iter().zip(column_weights).map(|(t, w)| Vec3A::from_array(*t) * *w).sum();
                    sum += line * *wy;
                }
                *pixel = sum.to_array();
            }
        });
        self.with_map(Image { width, height, pixels })
    }
}

/// Largest integer not above `x`; without SSE 4.1, which plain builds may not assume, `f32::floor` is a function call.
#[inline]
fn floor(x: f32) -> i32 {
    let toward_zero = x as i32;
    toward_zero - i32::from(toward_zero as f32 > x)
}

/// For each of `to` equal cells of 0..=1: the first of `from` equal cells it overlaps, and the share of its measure in each.
/// `measure` is increasing on 0..=1.
fn overlaps(from: usize, to: usize, measure: impl Fn(f64) -> f64) -> Vec<(usize, Vec<f32>)> {
    (0..to)
        .map(|cell| {
            // Borders in integers over from * to: exact, so neighbouring cells neither overlap nor leave gaps.
            let (low, high) = (cell * from, (cell + 1) * from);
            let (first, last) = (low / to, high.div_ceil(to));
            let at = |i: usize| measure(i as f64 / (from * to) as f64);
            let whole = at(high) - at(low);
            let weights =
                (first..last).map(|i| ((at(((i + 1) * to).min(high)) - at((i * to).max(low))) / whole) as f32).collect();
            (first, weights)
        })
        .collect()
}
