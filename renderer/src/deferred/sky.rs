//! Visibility of the rest of the environment from many small shadow maps, so that objects outside the picture cast shadows too.

use super::shadow_map::ShadowMap;
use glam::Vec3A;
use renderflow_frame::Environment;
use renderflow_frame::color::luminance;
use std::f32::consts::PI;

/// Number of cells that the sphere of directions is divided into.
const SKY_CELLS: usize = 64;
/// Columns and rows of a [`coarse`] environment.
const GRID: [usize; 2] = [64, 32];
/// A cell with less than this share of the mean cell's light is left out: it is not worth a map.
const LEAST: f32 = 0.02;
/// Exponent of the sharpest lobe about a reflection, which is as narrow as a cell.
const SHARPEST: f32 = 24.0;

/// A part of the environment, seen through one shadow map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkyCell {
    /// World-space unit direction of its centre.
    pub direction: Vec3A,
    /// Irradiance over pi of a surface that faces it (intensity included).
    pub irradiance: Vec3A,
}

/// The environment in so many texels that [`sky_cells`] needs no more. Their number does not depend on the map's size: a constant
/// map of one texel fills all cells.
pub fn coarse(environment: &Environment) -> Environment {
    environment.downsampled(GRID[0], GRID[1])
}

/// Divides a [`coarse`] environment into cells about the directions of a spherical spiral. Dark cells are left out; a black
/// environment has no cells.
pub fn sky_cells(coarse: &Environment) -> Vec<SkyCell> {
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

/// A point on a surface that looks at the sky; directions are unit, in world space.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Position, relative to the camera's origin.
    pub p: Vec3A,
    /// Normal.
    pub n: Vec3A,
    /// Reflected view direction.
    pub mirror: Vec3A,
    /// Roughness of the lobe about `mirror`, 0..=1.
    pub roughness: f32,
}

/// Shares of the sky that a point sees, each 0..=1.
#[derive(Clone, Copy, Debug)]
pub struct SkyShare {
    /// Share of the irradiance.
    pub diffuse: f32,
    /// Share of the light that a lobe about the mirror direction would receive.
    pub specular: f32,
    /// Cosine-weighted share of the hemisphere that is open.
    pub open: f32,
}

/// Looks up the maps of all cells (one map per cell) for `receiver`; `jitter` moves the look-up by this many texels.
pub fn sky_share(cells: &[SkyCell], maps: &[ShadowMap], receiver: &Receiver, jitter: [f32; 2]) -> SkyShare {
    let Receiver { p, n, mirror, roughness } = *receiver;
    let alpha2 = roughness.powi(4).max(1e-3);
    // Phong exponent of a lobe of reflected directions of that width.
    let sharpness = (0.5 / alpha2).clamp(1.0, SHARPEST);
    let (mut seen, mut all) = (0.0, 1e-12);
    let (mut mirror_seen, mut mirror_all) = (0.0, 1e-12);
    let (mut open, mut whole) = (0.0, 1e-12);
    for (cell, map) in cells.iter().zip(maps) {
        let cosine = n.dot(cell.direction);
        let along = mirror.dot(cell.direction);
        if cosine <= 0.0 {
            continue;
        }
        let lit = f32::from(u8::from(map.lit(p, n, jitter)));
        let light = luminance(cell.irradiance.to_array()) * cosine;
        all += light;
        seen += light * lit;
        whole += cosine;
        open += cosine * lit;
        if along > 0.0 {
            let weight = along.powf(sharpness) * luminance(cell.irradiance.to_array());
            mirror_all += weight;
            mirror_seen += weight * lit;
        }
    }
    SkyShare { diffuse: seen / all, specular: mirror_seen / mirror_all, open: open / whole }
}
