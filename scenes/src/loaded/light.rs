//! Lights without an area.

use crate::ies::Profile;
use glam::Affine3A;
use std::sync::Arc;

/// A light without an area, which no ray meets.
#[derive(Clone, Debug, PartialEq)]
pub struct PunctualLight {
    /// Name, unique among the lights.
    pub name: String,
    /// What it is, and how strong.
    pub kind: PunctualKind,
    /// Photometric profile, which multiplies the intensity of a point or a spot.
    pub profile: Option<Arc<Profile>>,
    /// Light to world relative to [`crate::LoadedScene::origin`], a rotation and a translation, one for every frame, or a single
    /// one. The light shines along its own -Z.
    pub transforms: Vec<Affine3A>,
}

/// What a light without an area is; see [`crate::description::LightKind`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PunctualKind {
    /// It shines in all directions.
    Point {
        /// Radiant intensity, W/sr, linear Rec.709, >= 0.
        intensity: [f32; 3],
    },
    /// It shines into a cone.
    Spot {
        /// Radiant intensity on the axis, W/sr, linear Rec.709, >= 0.
        intensity: [f32; 3],
        /// Radians from the axis up to which it is as bright as there, less than `outer`.
        inner: f32,
        /// Radians from the axis where it ends, at most half pi.
        outer: f32,
    },
    /// It is infinitely far away.
    Directional {
        /// Irradiance of a surface that faces it, W/m^2, linear Rec.709, >= 0.
        irradiance: [f32; 3],
    },
}

impl PunctualLight {
    /// Light to world at `frame`.
    pub fn transform(&self, frame: usize) -> Affine3A {
        self.transforms[frame.min(self.transforms.len() - 1)]
    }
}
