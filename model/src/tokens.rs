//! Environment tokens: the light around the camera in 8 x 8 cells of equal solid angle, in view space.

use crate::bridge::log_curve;
use glam::Vec3A;
use renderflow_frame::color::luminance;
use renderflow_frame::{Camera, Environment};

/// Cells around the view axis and from top to bottom.
pub const GRID: usize = 8;
/// Tokens of one frame.
pub const TOKENS: usize = GRID * GRID;
/// Features of a token: mean radiance (3, log curve, -1..), luminance-weighted mean direction (3), cell centre (3), peak luminance (1).
pub const TOKEN_FEATURES: usize = 10;

/// Longest side of the grid on which the environment is read.
const COLUMNS: usize = 256;
const ROWS: usize = 128;

/// An environment read once on a regular grid, world space; every frame of a sequence shares it.
#[derive(Clone, Debug)]
pub struct EnvironmentSummary {
    /// Unit direction, radiance, solid angle.
    texels: Vec<(Vec3A, [f32; 3], f32)>,
    /// Unit direction of the dominant light, world space: the one whose visibility the screen-space features give.
    pub light_direction: Vec3A,
    /// Luminance of the irradiance that the dominant light gives a surface facing it.
    pub light_irradiance: f32,
}

impl EnvironmentSummary {
    /// Reads `environment`; a large map is averaged first so that small lights keep their energy.
    pub fn new(environment: &Environment) -> Self {
        let averaged;
        let source = if environment.map.width > COLUMNS || environment.map.height > ROWS {
            averaged = environment.downsampled(COLUMNS, ROWS);
            &averaged
        } else {
            environment
        };
        let mut texels = Vec::with_capacity(COLUMNS * ROWS);
        for row in 0..ROWS {
            // Solid angle of a texel: the share of the row's band on the sphere.
            let theta = |edge: usize| std::f32::consts::PI * edge as f32 / ROWS as f32;
            let solid_angle = (theta(row).cos() - theta(row + 1).cos()) * std::f32::consts::TAU / COLUMNS as f32;
            for column in 0..COLUMNS {
                let uv = glam::Vec2::new((column as f32 + 0.5) / COLUMNS as f32, (row as f32 + 0.5) / ROWS as f32);
                let direction = source.direction(uv);
                let radiance = source.radiance(direction).map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
                texels.push((direction, radiance, solid_angle));
            }
        }
        let (light, _) = environment.split_dominant();
        Self { texels, light_direction: light.direction, light_irradiance: luminance(light.irradiance) }
    }

    /// Tokens of the frame seen by `camera`, `[TOKENS][TOKEN_FEATURES]`, row-major from the top, columns from the left with the view
    /// direction in the middle.
    pub fn tokens(&self, camera: &Camera, exposure: f32) -> Vec<f32> {
        #[derive(Clone, Copy, Default)]
        struct Cell {
            radiance: [f32; 3],
            direction: Vec3A,
            luminance: f32,
            peak: f32,
            solid_angle: f32,
        }
        // Rigid, so the inverse rotation is the transpose.
        let to_camera = camera.camera_to_world.matrix3.transpose();
        let mut cells = [Cell::default(); TOKENS];
        for &(direction, radiance, solid_angle) in &self.texels {
            let d = to_camera * direction;
            let column = ((d.x.atan2(-d.z) / std::f32::consts::TAU + 0.5) * GRID as f32).clamp(0.0, GRID as f32 - 1.0) as usize;
            let row = ((0.5 - 0.5 * d.y) * GRID as f32).clamp(0.0, GRID as f32 - 1.0) as usize;
            let cell = &mut cells[row * GRID + column];
            let y = luminance(radiance);
            for (sum, value) in cell.radiance.iter_mut().zip(radiance) {
                *sum += value * solid_angle;
            }
            cell.direction += d * y * solid_angle;
            cell.luminance += y * solid_angle;
            cell.peak = cell.peak.max(y);
            cell.solid_angle += solid_angle;
        }
        let mut out = Vec::with_capacity(TOKENS * TOKEN_FEATURES);
        for (i, cell) in cells.iter().enumerate() {
            let centre = cell_centre(i % GRID, i / GRID);
            let mean = if cell.luminance > 0.0 { cell.direction / cell.luminance } else { centre };
            let scale = if cell.solid_angle > 0.0 { exposure / cell.solid_angle } else { 0.0 };
            out.extend(cell.radiance.map(|v| 2.0 * log_curve(v * scale) - 1.0));
            out.extend(mean.to_array());
            out.extend(centre.to_array());
            out.push(log_curve(cell.peak * exposure));
        }
        out
    }
}

/// Camera-space direction of the middle of a cell.
fn cell_centre(column: usize, row: usize) -> Vec3A {
    let phi = std::f32::consts::TAU * ((column as f32 + 0.5) / GRID as f32 - 0.5);
    let y = 1.0 - 2.0 * (row as f32 + 0.5) / GRID as f32;
    let r = (1.0 - y * y).sqrt();
    Vec3A::new(phi.sin() * r, y, -phi.cos() * r)
}

/// The tokens of the mirrored picture: columns reversed and the x components of directions negated.
pub fn mirrored(tokens: &[f32]) -> Vec<f32> {
    let mut out = Vec::with_capacity(tokens.len());
    for row in tokens.chunks_exact(GRID * TOKEN_FEATURES) {
        for token in row.chunks_exact(TOKEN_FEATURES).rev() {
            let at = out.len();
            out.extend_from_slice(token);
            out[at + 3] = -out[at + 3];
            out[at + 6] = -out[at + 6];
        }
    }
    out
}
