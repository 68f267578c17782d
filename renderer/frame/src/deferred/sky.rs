//! Visibility of the rest of the environment from many small shadow maps: what stands outside the picture shades too.

use super::shadow::ShadowMap;
use crate::Environment;
use glam::Vec3A;
use std::f32::consts::PI;

/// Parts of the sphere of directions.
pub const SKY_CELLS: usize = 64;
/// Cells that hold less than this share of the light of an average one are left out: no map is worth them.
const LEAST: f32 = 0.02;
/// Sharpest lobe about a reflection: no narrower than the cells.
const SHARPEST: f32 = 24.0;

/// Part of the environment that one shadow map stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyCell {
    /// World-space unit direction of its middle.
    pub direction: Vec3A,
    /// Irradiance over pi that it gives a surface facing it (intensity included).
    pub irradiance: Vec3A,
}

/// `environment` in cells about the directions of a spherical spiral, without the dark ones; none for a black environment.
pub fn sky_cells(environment: &Environment) -> Vec<SkyCell> {
    let golden = PI * (3.0 - 5.0_f32.sqrt());
    let directions: Vec<Vec3A> = (0..SKY_CELLS)
        .map(|k| {
            let y = 1.0 - 2.0 * (k as f32 + 0.5) / SKY_CELLS as f32;
            let (sin, cos) = (k as f32 * golden).sin_cos();
            let across = (1.0 - y * y).sqrt();
            Vec3A::new(across * sin, y, across * cos)
        })
        .collect();
    let mut energy = vec![Vec3A::ZERO; SKY_CELLS];
    // As many directions whatever the map's own size: a constant map of one texel fills all cells.
    const GRID: [usize; 2] = [64, 32];
    let coarse = environment.downsampled(GRID[0], GRID[1]);
    for row in 0..GRID[1] {
        let solid_angle = coarse.texel_solid_angle(row) * coarse.intensity;
        for column in 0..GRID[0] {
            let direction = coarse.texel_direction(column, row);
            let nearest = (0..SKY_CELLS)
                .fold(0, |best, k| if directions[k].dot(direction) > directions[best].dot(direction) { k } else { best });
            energy[nearest] += Vec3A::from_array(*coarse.map.at(column, row)) * (solid_angle / PI);
        }
    }
    let mean = energy.iter().map(|e| e.element_sum()).sum::<f32>() / SKY_CELLS as f32;
    let cells = directions.into_iter().zip(energy).map(|(direction, irradiance)| SkyCell { direction, irradiance });
    cells.filter(|cell| cell.irradiance.element_sum() > LEAST * mean).collect()
}

/// Share of the environment's light that reaches a point.
#[derive(Clone, Copy, Debug)]
pub struct SkyShare {
    /// Of the irradiance, by channel.
    pub diffuse: Vec3A,
    /// Of what a lobe about the mirror direction would receive.
    pub specular: f32,
    /// Cosine-weighted share of the hemisphere that is open.
    pub open: f32,
}

/// Looks up all maps (one a cell) at a world-space point with normal `n`; `mirror` is the reflected view and `roughness` that of the
/// lobe. `jitter` in texels moves the look-up.
pub fn sky_share(
    cells: &[SkyCell],
    maps: &[ShadowMap],
    p: Vec3A,
    n: Vec3A,
    mirror: Vec3A,
    roughness: f32,
    jitter: [f32; 2],
) -> SkyShare {
    let alpha2 = roughness.powi(4).max(1e-3);
    // Phong exponent of the lobe of reflected directions of that width.
    let sharpness = (0.5 / alpha2).clamp(1.0, SHARPEST);
    let (mut seen, mut all) = (Vec3A::ZERO, Vec3A::splat(1e-12));
    let (mut mirror_seen, mut mirror_all) = (0.0, 1e-12);
    let (mut open, mut whole) = (0.0, 1e-12);
    for (cell, map) in cells.iter().zip(maps) {
        let cosine = n.dot(cell.direction);
        let along = mirror.dot(cell.direction);
        if cosine <= 0.0 {
            continue;
        }
        let lit = f32::from(u8::from(map.lit(p, n, jitter)));
        let light = cell.irradiance * cosine;
        all += light;
        seen += light * lit;
        whole += cosine;
        open += cosine * lit;
        if along > 0.0 {
            let weight = along.powf(sharpness) * cell.irradiance.element_sum();
            mirror_all += weight;
            mirror_seen += weight * lit;
        }
    }
    SkyShare { diffuse: seen / all, specular: mirror_seen / mirror_all, open: open / whole }
}
