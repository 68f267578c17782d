//! Frames as the pictures that an autoencoder reads: planes of three channels with values -1..=1.
//!
//! The paper does not define the encodings. This program scales the following values from 0..=1 to -1..=1:
//! - `albedo` and `target` (the path-traced picture): display values as in the metrics, `sRGB(x)` of the base colour and
//!   `sRGB(clamp(exposure x))` of the radiance;
//! - `normal`: `0.5 + 0.5 n` in camera space;
//! - `depth`: `ln(z / near) / ln(far / near)`, clamped, in all three channels, with bounds for the whole sequence;
//! - `material`: roughness, metallic, specular;
//! - pixels that see no surface: the albedo shows the environment behind them as the target does, the normal is the zero vector,
//!   the depth is 1, and the material is 0;
//! - `environment`: a latitude-longitude picture around the camera with the view direction in the middle. Its exposed radiance is
//!   mapped by the extended Reinhard curve with white point 16, per channel (as in DiffusionRenderer, Liang et al. 2025), and
//!   encoded with sRGB.

use crate::bridge::MAX_RADIANCE;
use crate::{Error, Result};
use glam::{Vec2, Vec3A};
use rayon::prelude::*;
use renderflow_frame::color::{display, linear_to_srgb, reinhard, srgb_to_linear};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Camera, DepthBounds, Environment, Frame, Light, is_depth};
use serde::{Deserialize, Serialize};
use std::f32::consts::{PI, TAU};

/// Exposed radiance that pictures of the environment show as white.
pub const WHITE: f32 = 16.0;

/// The environment of a sequence, prepared for pictures from any camera.
#[derive(Clone, Debug)]
pub struct EnvironmentView {
    source: Environment,
    width: usize,
    height: usize,
}

impl EnvironmentView {
    /// Prepares pictures of `width x height`. A finer map is averaged to that size, so that a small sun keeps its energy.
    pub fn new(environment: &Environment, width: usize, height: usize) -> Self {
        let (w, h) = (environment.map.width.min(width), environment.map.height.min(height));
        Self { source: environment.downsampled(w, h), width, height }
    }

    /// The environment around a camera, `[3, height, width]` with values -1..=1.
    pub fn picture(&self, camera: &Camera, exposure: f32) -> Vec<f32> {
        planes(self.width, self.height, |x, y| {
            let (sin_phi, cos_phi) = (TAU * ((x as f32 + 0.5) / self.width as f32 - 0.5)).sin_cos();
            let (sin_theta, cos_theta) = (PI * (y as f32 + 0.5) / self.height as f32).sin_cos();
            let direction = camera.camera_to_world.matrix3 * Vec3A::new(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta);
            self.source.radiance(direction).map(|v| {
                let exposed = (exposure * v).clamp(0.0, MAX_RADIANCE);
                signed(linear_to_srgb(reinhard(exposed, WHITE).clamp(0.0, 1.0)))
            })
        })
    }
}

/// What the bridge to the path-traced picture begins with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BridgeStart {
    /// The albedo, as in the paper.
    #[default]
    Albedo,
    /// The albedo times the irradiance of the environment without shadows, as a display value. The paper's experiment on the
    /// input buffer.
    Lit,
    /// Standard normal noise, as in diffusion models; the albedo is one more condition. This is the paradigm of the paper's
    /// stochastic baselines.
    Noise,
    /// The picture by deferred shading. The autoencoder codes the change of this picture and not the picture itself: the result
    /// is the start, plus the decoded prediction, minus the decoded start. What the autoencoder loses of both cancels, and a
    /// network that has learnt nothing returns the start. If keyframes are read, the start is keyframes carried over that
    /// picture.
    Deferred,
}

impl BridgeStart {
    /// Whether the autoencoder codes the change of the start.
    pub(in crate::wan) fn is_coded_as_change(self) -> bool {
        self == Self::Deferred
    }

    /// Whether it is the paper's.
    pub(in crate::wan) fn is_albedo(&self) -> bool {
        *self == Self::Albedo
    }
}

/// A kind of picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Base colour.
    Albedo,
    /// Shading normal.
    Normal,
    /// Logarithm of depth.
    Depth,
    /// Roughness, metallic, specular.
    Material,
    /// The environment around the camera.
    Environment,
    /// The path-traced picture.
    Target,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Albedo, Self::Normal, Self::Depth, Self::Material, Self::Environment, Self::Target];

    /// Name in files.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Albedo => "Albedo",
            Self::Normal => "Normal",
            Self::Depth => "Depth",
            Self::Material => "Material",
            Self::Environment => "Environment",
            Self::Target => "Target",
        }
    }
}

/// The pictures of one frame; see the module. All are `[3, height, width]` except `environment` and `mask`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pictures {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Base colour.
    pub albedo: Vec<f32>,
    /// Shading normal.
    pub normal: Vec<f32>,
    /// Logarithm of depth.
    pub depth: Vec<f32>,
    /// Roughness, metallic, specular.
    pub material: Vec<f32>,
    /// The environment around the camera, `[3, he, we]` with the size of the view.
    pub environment: Vec<f32>,
    /// `[height, width]`: 1 where the pixel sees a surface, 0 elsewhere. Masked metrics count the former.
    pub mask: Vec<f32>,
    /// The path-traced picture, if the frame has one.
    pub target: Option<Vec<f32>>,
}

impl Pictures {
    /// The pictures of `frame` under `light`, whose environment `view` shows.
    ///
    /// # Errors
    /// [`Error::Data`] when the exposure is not a positive number, when the bounds are not a range, or when the sizes of a frame,
    /// its channels and its camera differ.
    pub fn new(frame: &Frame, light: &Light, view: &EnvironmentView, bounds: DepthBounds) -> Result<Self> {
        let exposure = light.exposure();
        let broken = |reason: String| Error::Data { place: "frame".into(), reason };
        if !(exposure.is_finite() && exposure > 0.0) {
            return Err(broken(format!("exposure {exposure} is not a positive number")));
        }
        check_bounds(bounds)?;
        let (width, height, camera) = (frame.width, frame.height, &frame.info.camera);
        let sizes = [frame.alpha.pixels.len(), frame.albedo.pixels.len(), frame.normal.pixels.len(), frame.depth.pixels.len()];
        let whole = sizes.iter().chain([&frame.material.pixels.len()]).all(|n| *n == width * height);
        if width == 0 || height == 0 || (camera.width, camera.height) != (width, height) || !whole {
            let reason = format!("{width}x{height} pixels with a camera of {}x{}", camera.width, camera.height);
            return Err(broken(reason));
        }
        if frame.beauty.as_ref().is_some_and(|beauty| (beauty.width, beauty.height) != (width, height)) {
            return Err(broken("its beauty differs in size from its other channels".into()));
        }
        let seen = |x: usize, y: usize| is_depth(*frame.depth.at(x, y));
        let albedo = planes(width, height, |x, y| {
            if seen(x, y) {
                frame.albedo.at(x, y).map(|v| signed(linear_to_srgb(finite(v).clamp(0.0, 1.0))))
            } else {
                let direction = camera.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
                shown(light.environment.radiance(direction), exposure)
            }
        });
        let plane = |f: &(dyn Fn(usize, usize) -> [f32; 3] + Sync)| planes(width, height, f);
        Ok(Self {
            width,
            height,
            albedo,
            normal: plane(&|x, y| {
                if seen(x, y) { frame.normal.at(x, y).map(|v| finite(v).clamp(-1.0, 1.0)) } else { [0.0; 3] }
            }),
            depth: plane(&|x, y| [signed(bounds.encode(*frame.depth.at(x, y))); 3]),
            material: plane(&|x, y| {
                if seen(x, y) { frame.material.at(x, y).map(|v| signed(finite(v).clamp(0.0, 1.0))) } else { [-1.0; 3] }
            }),
            environment: view.picture(camera, exposure),
            mask: frame.alpha.pixels.iter().map(|a| if *a > 0.0 { 1.0 } else { 0.0 }).collect(),
            target: frame.beauty.as_ref().map(|beauty| plane(&|x, y| shown(*beauty.at(x, y), exposure))),
        })
    }
}

impl Pictures {
    /// The same pictures of `frame` under `light` for a bridge that begins with `start`. Where a surface is seen, the albedo is
    /// multiplied by the irradiance with [`BridgeStart::Lit`], and is replaced by `shaded` with [`BridgeStart::Deferred`].
    ///
    /// # Errors
    /// [`Error::Data`] when the bridge begins with `shaded`, and it is missing or of another size.
    pub fn starting(self, start: BridgeStart, frame: &Frame, light: &Light, shaded: Option<&Rgb>) -> Result<Self> {
        match start {
            BridgeStart::Albedo | BridgeStart::Noise => Ok(self),
            BridgeStart::Lit => Ok(self.lit(frame, light)),
            BridgeStart::Deferred => {
                let fits = |shaded: &&Rgb| (shaded.width, shaded.height) == (self.width, self.height);
                let shaded = shaded.filter(fits).ok_or_else(|| Error::Data {
                    place: "frame".into(),
                    reason: "these weights begin with deferred shading, and there is no such picture of its size".into(),
                })?;
                let (exposure, pixels) = (light.exposure(), self.width * self.height);
                let albedo = planes(self.width, self.height, |x, y| {
                    let i = y * self.width + x;
                    match self.mask[i] > 0.0 {
                        true => shown(*shaded.at(x, y), exposure),
                        false => [0, 1, 2].map(|c| self.albedo[c * pixels + i]),
                    }
                });
                Ok(Self { albedo, ..self })
            }
        }
    }

    fn lit(self, frame: &Frame, light: &Light) -> Self {
        let (tables, exposure, camera) = (light.tables(), light.exposure(), &frame.info.camera);
        let pixels = self.width * self.height;
        let albedo = planes(self.width, self.height, |x, y| {
            let i = y * self.width + x;
            if !is_depth(*frame.depth.at(x, y)) {
                return [0, 1, 2].map(|c| self.albedo[c * pixels + i]);
            }
            let n = camera.camera_to_world.matrix3 * Vec3A::from(frame.normal.at(x, y).map(finite));
            let irradiance = tables.irradiance(n.normalize_or(Vec3A::Y));
            let albedo = frame.albedo.at(x, y).map(|v| finite(v).clamp(0.0, 1.0));
            shown([0, 1, 2].map(|c| albedo[c] * irradiance[c]), exposure)
        });
        Self { albedo, ..self }
    }

    /// The picture of a kind. It is empty for [`Kind::Target`] if the frame has no path-traced picture.
    pub fn of(&self, kind: Kind) -> &[f32] {
        match kind {
            Kind::Albedo => &self.albedo,
            Kind::Normal => &self.normal,
            Kind::Depth => &self.depth,
            Kind::Material => &self.material,
            Kind::Environment => &self.environment,
            Kind::Target => self.target.as_deref().unwrap_or_default(),
        }
    }
}

/// Checks the bounds of depth pictures.
///
/// # Errors
/// [`Error::Data`] when they are not a range.
pub(super) fn check_bounds(bounds: DepthBounds) -> Result<()> {
    if bounds.is_range() {
        return Ok(());
    }
    Err(Error::Data { place: "depth bounds".into(), reason: format!("{} to {} m is not a range", bounds.near, bounds.far) })
}

/// Converts a picture of kind [`Kind::Target`], `[3, height, width]`, to scene-linear radiance from 0 to display white.
///
/// # Errors
/// [`Error::Data`] when the number of values does not fit.
pub fn radiance(picture: &[f32], width: usize, height: usize, exposure: f32) -> Result<Rgb> {
    let pixels = width * height;
    if picture.len() != 3 * pixels {
        let reason = format!("{} values where {width}x{height} pixels of 3 are expected", picture.len());
        return Err(Error::Data { place: "picture".into(), reason });
    }
    Ok(Rgb::from_fn(width, height, |x, y| {
        let i = y * width + x;
        [0, 1, 2].map(|c| srgb_to_linear((0.5 + 0.5 * finite(picture[c * pixels + i])).clamp(0.0, 1.0)) / exposure)
    }))
}

/// Radiance as a display value, scaled to -1..=1.
fn shown(radiance: [f32; 3], exposure: f32) -> [f32; 3] {
    display(radiance.map(finite), exposure).map(signed)
}

/// Scales 0..=1 to -1..=1.
fn signed(value: f32) -> f32 {
    2.0 * value - 1.0
}

/// Replaces NaN by 0.
fn finite(value: f32) -> f32 {
    if value.is_nan() { 0.0 } else { value }
}

/// The picture `[3, height, width]` of a function of column and row.
fn planes(width: usize, height: usize, pixel: impl Fn(usize, usize) -> [f32; 3] + Sync) -> Vec<f32> {
    let pixels: Vec<[f32; 3]> = (0..width * height).into_par_iter().map(|i| pixel(i % width, i / width)).collect();
    (0..3).flat_map(|c| pixels.iter().map(move |p| p[c])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sun to the right of the camera is in the right half of the picture, in whichever direction the camera looks.
    #[test]
    fn the_environment_turns_with_the_camera() {
        let toward_x = Rgb::from_fn(64, 32, |x, y| {
            // u = 1/4 is +x.
            if (x as i32 - 16).abs() <= 1 && (y as i32 - 16).abs() <= 1 { [500.0; 3] } else { [0.1; 3] }
        });
        let environment = Environment { map: toward_x, rotation: 0.0, intensity: 1.0 };
        let view = EnvironmentView::new(&environment, 32, 16);
        for (target, column) in [(Vec3A::NEG_Z, 24), (Vec3A::X, 16), (Vec3A::Z, 8)] {
            let camera = Camera::look_at(Vec3A::ZERO, target, Vec3A::Y, 1.0, 8, 8);
            let picture = view.picture(&camera, 1.0);
            assert!(picture.iter().all(|v| (-1.0..=1.0).contains(v)));
            let row = &picture[8 * 32..9 * 32];
            let brightest = (0..32).max_by(|a, b| row[*a].total_cmp(&row[*b])).expect("pixels");
            assert!(brightest.abs_diff(column) <= 1, "looking at {target}: {brightest}");
        }
        // Every exposure gives a picture.
        let camera = Camera::look_at(Vec3A::ZERO, Vec3A::X, Vec3A::Y, 1.0, 8, 8);
        assert!(view.picture(&camera, f32::MAX).iter().all(|v| (-1.0..=1.0).contains(v)));
    }
}
