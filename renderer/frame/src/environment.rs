//! The environment: an equirectangular map of scene-linear radiance around the scene.

use crate::image::Rgb;
use glam::{Vec2, Vec3A};

/// Equirectangular environment map with the orientation and gain it is used with.
///
/// Direction of map coordinates (u, v): `d = (sin phi sin theta, cos theta, -cos phi sin theta)`, `phi = 2 pi u`, `theta = pi v`;
/// u runs to the right and wraps, v runs down. Texel centres lie at half-integers. Values between texel centres are bilinear.
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

    /// Map coordinates (each 0..=1) of a world-space unit direction, rotation applied.
    pub fn uv(&self, _direction: Vec3A) -> Vec2 {
        todo!()
    }

    /// World-space unit direction of map coordinates, rotation applied; inverse of [`Self::uv`].
    pub fn direction(&self, _uv: Vec2) -> Vec3A {
        todo!()
    }

    /// Radiance from a world-space unit direction: bilinear, times `intensity`.
    pub fn radiance(&self, _direction: Vec3A) -> [f32; 3] {
        todo!()
    }

    /// Area-averaged copy of the map at `width x height` (rotation and intensity kept).
    pub fn downsampled(&self, _width: usize, _height: usize) -> Self {
        todo!()
    }
}
