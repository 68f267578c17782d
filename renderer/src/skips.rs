//! What is asked for, and switches for the work that a picture does not need.
//!
//! All switches are on. Turning one off does that work after all, for measurements: `renderflow-bench skip` and the tests compare
//! the two.

use serde::{Deserialize, Serialize};

/// What is left out where it cannot matter. Pictures are bit-identical either way, but for
/// [`Self::feature_sets`] (roundings), [`Self::flat_environment`] (other noise) and [`Self::plain_pixels`] (other guides).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Skips {
    /// The integrator compiled for what the scene has; off: the one compiled for everything.
    pub feature_sets: bool,
    /// No camera rays in pixels that no triangle's bounds cover.
    pub environment_pixels: bool,
    /// Takes coverage and guides from the beauty's samples; off, a second pass of the same number of camera rays gives them.
    pub shared_guides: bool,
    /// No shadow ray for a light sample that would contribute nothing.
    pub zero_contributions: bool,
    /// No light sample where the surface reflects nothing at all.
    pub black_surfaces: bool,
    /// The ray beyond the last scattering only asks whether something stands in its way; off: what the nearest surface is.
    pub last_any_hit: bool,
    /// No paths in a scene without light.
    pub dark_scenes: bool,
    /// No light samples of an environment that is the same from everywhere. Both ways converge to the same picture.
    pub flat_environment: bool,
    /// No guide rays in pixels whose centre and corners see the same surface, where no beauty is rendered. If it has a texture,
    /// a grid of nine points in the pixel shows it in place of 10 to 32 rays. What is narrower than a pixel can be missed between
    /// them.
    pub plain_pixels: bool,
}

impl Skips {
    /// Everything is left out that can be.
    pub const ALL: Self = Self {
        feature_sets: true,
        environment_pixels: true,
        shared_guides: true,
        zero_contributions: true,
        black_surfaces: true,
        last_any_hit: true,
        dark_scenes: true,
        flat_environment: true,
        plain_pixels: true,
    };
}

impl Default for Skips {
    fn default() -> Self {
        Self::ALL
    }
}

/// Which parts of a [`renderflow_frame::Frame`] to fill; what is not asked for costs nothing. The irradiance and the groups of
/// light have settings of their own, and coverage is always there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Channels {
    /// Albedo, normal, depth, material and ids at pixel centres; without them these pictures are empty (0 x 0).
    pub gbuffer: bool,
    /// Motion to the next and from the previous frame; needs [`Self::gbuffer`].
    pub motion: bool,
    /// Albedo and normal filtered over pixels, for denoisers.
    pub guides: bool,
    /// Variance of the beauty.
    pub variance: bool,
    /// Indirect light, and the light that is hidden from light samples. The network reads both with few samples.
    pub paths: bool,
}

impl Channels {
    /// Every channel but [`Self::paths`], for which few have a use.
    pub const ALL: Self = Self { gbuffer: true, motion: true, guides: true, variance: true, paths: false };
    /// The picture and its coverage.
    pub const BEAUTY: Self = Self { gbuffer: false, motion: false, guides: false, variance: false, paths: false };
}

impl Default for Channels {
    fn default() -> Self {
        Self::ALL
    }
}
