//! What a render did, counted where it happened and added up a tile at a time.

use serde::{Deserialize, Serialize};
use std::ops::AddAssign;

/// Counts of one render.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stats {
    /// Camera samples of the beauty.
    pub samples: u64,
    /// Rays from the camera: samples, guide samples and pixel centres.
    pub camera_rays: u64,
    /// Rays that continue a path.
    pub bounce_rays: u64,
    /// Rays towards the environment.
    pub shadow_rays: u64,
    /// Camera rays not traced because their pixel can see nothing but the environment.
    pub skipped_rays: u64,
    /// Samples whose radiance was NaN or infinite; each contributed 0 to its pixel.
    pub non_finite_samples: u64,
    /// Light paths.
    #[serde(default)]
    pub light_paths: u64,
    /// Contributions that [`crate::Settings::clamp_indirect`] limited.
    #[serde(default)]
    pub clamped_contributions: u64,
}

impl Stats {
    /// Rays that continue a path or go towards light.
    pub fn rays(&self) -> u64 {
        self.bounce_rays + self.shadow_rays
    }
}

impl AddAssign for Stats {
    fn add_assign(&mut self, other: Self) {
        self.samples += other.samples;
        self.camera_rays += other.camera_rays;
        self.bounce_rays += other.bounce_rays;
        self.shadow_rays += other.shadow_rays;
        self.skipped_rays += other.skipped_rays;
        self.non_finite_samples += other.non_finite_samples;
        self.light_paths += other.light_paths;
        self.clamped_contributions += other.clamped_contributions;
    }
}
