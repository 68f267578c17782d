//! The environment as a small grid of equal-area tiles around the view direction, for a network.

use super::Environment;
use super::angle::atan2;
use crate::Camera;
use glam::{Mat3A, Vec2, Vec3A};
use rayon::prelude::*;
use std::f32::consts::{FRAC_1_PI, FRAC_PI_4};

/// Subsamples along one side of a tile, at least; 32 x 32 keep the area of a tile within about one per cent.
const SAMPLES_PER_TILE_SIDE: usize = 32;

impl Environment {
    /// Mean radiance (intensity included) of `n x n` equal-area tiles of the sphere as the camera sees it, row-major.
    ///
    /// The tiles divide the square of the equal-area octahedral map (Clarberg 2008) whose middle is the view direction: the
    /// four middle tiles lie ahead, the border behind; columns run to the right, rows down. Mirroring the picture
    /// left to right mirrors the columns. Every texel gives its energy to the tile it lies in, so a small sun is never missed.
    pub fn tokens(&self, camera: &Camera, n: usize) -> Vec<[f32; 3]> {
        if n == 0 || self.map.pixels.is_empty() {
            return vec![[0.0; 3]; n * n];
        }
        // Texels finer than the tiles need them are averaged first; coarser ones are split.
        let target = SAMPLES_PER_TILE_SIDE * n;
        let source = self.downsampled(self.map.width.min(target), self.map.height.min(target / 2));
        let (width, height) = (source.map.width, source.map.height);
        let (split_x, split_y) = (target.div_ceil(width), (target / 2).div_ceil(height));
        let world_to_camera: Mat3A = camera.world_to_camera().matrix3;

        // Per row of texels: the tile of each subsample. Rows are summed in order afterwards: the same bits for any thread count.
        let rows: Vec<Vec<(u32, Vec3A, f32)>> = (0..height)
            .into_par_iter()
            .map(|row| {
                let mut runs: Vec<(u32, Vec3A, f32)> = Vec::new();
                for sub_row in 0..split_y {
                    let cells = (height * split_y) as f64;
                    let band = |i: usize| (std::f64::consts::PI * i as f64 / cells).cos();
                    let fine_row = row * split_y + sub_row;
                    let weight = (band(fine_row) - band(fine_row + 1)) as f32;
                    let v = (fine_row as f32 + 0.5) / cells as f32;
                    for fine_column in 0..width * split_x {
                        let u = (fine_column as f32 + 0.5) / (width * split_x) as f32;
                        let tile = tile_of(world_to_camera * source.direction(Vec2::new(u, v)), n);
                        let energy = Vec3A::from_array(*source.map.at(fine_column / split_x, row)) * weight;
                        match runs.last_mut() {
                            Some(run) if run.0 == tile => {
                                run.1 += energy;
                                run.2 += weight;
                            }
                            _ => runs.push((tile, energy, weight)),
                        }
                    }
                }
                runs
            })
            .collect();
        let mut sums = vec![(Vec3A::ZERO, 0.0_f32); n * n];
        for (tile, energy, weight) in rows.into_iter().flatten() {
            let sum = &mut sums[tile as usize];
            sum.0 += energy;
            sum.1 += weight;
        }
        sums.iter().map(|(energy, weight)| (*energy * (self.intensity / weight.max(f32::MIN_POSITIVE))).to_array()).collect()
    }
}

/// Camera-space unit direction of the centre of tile (`column`, `row`) of the `n x n` grid of [`Environment::tokens`].
pub fn token_direction(n: usize, column: usize, row: usize) -> Vec3A {
    let (x, y) = (2.0 * (column as f32 + 0.5) / n as f32 - 1.0, 2.0 * (row as f32 + 0.5) / n as f32 - 1.0);
    // Inverse of `square_of`: signed distance from the diagonal tells ahead from behind.
    let (ax, ay) = (x.abs(), y.abs());
    let signed = 1.0 - (ax + ay);
    let r = 1.0 - signed.abs();
    let phi = if r == 0.0 { FRAC_PI_4 } else { ((ay - ax) / r + 1.0) * FRAC_PI_4 };
    let ahead = (1.0 - r * r).copysign(signed);
    let radius = r * (2.0 - r * r).max(0.0).sqrt();
    Vec3A::new((phi.cos() * radius).copysign(x), (phi.sin() * radius).copysign(-y), -ahead)
}

/// Tile of a camera-space unit direction.
fn tile_of(direction: Vec3A, n: usize) -> u32 {
    let square = square_of(direction);
    let index = |t: f32| ((0.5 * (t + 1.0) * n as f32) as usize).min(n - 1);
    (index(square.y) * n + index(square.x)) as u32
}

/// Equal-area octahedral coordinates (-1..=1, x right, y down) of a camera-space unit direction; the view direction is the middle.
fn square_of(direction: Vec3A) -> Vec2 {
    let (x, y) = (direction.x.abs(), direction.y.abs());
    let r = (1.0 - direction.z.abs()).max(0.0).sqrt();
    // Azimuth in the first quadrant as a share of a right angle.
    let phi = atan2(y, x) * (2.0 * FRAC_1_PI);
    let (mut along_y, mut along_x) = (phi * r, r - phi * r);
    // The half behind the camera is folded out past the diagonals.
    if direction.z > 0.0 {
        (along_x, along_y) = (1.0 - along_y, 1.0 - along_x);
    }
    Vec2::new(along_x.copysign(direction.x), along_y.copysign(-direction.y))
}
