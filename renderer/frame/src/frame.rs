//! One rendered frame: beauty, G-buffer and header.

use crate::Camera;
use crate::image::{Image, Rgb};
use glam::Vec2;
use serde::{Deserialize, Serialize};

/// Largest number of groups that the light can be split into.
pub const LIGHT_GROUPS: usize = 8;

/// The header values of a frame file. In JSON (see [`crate::compact`]) absent keys have their defaults.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FrameInfo {
    /// The camera of this frame.
    pub camera: Camera,
    /// Samples per pixel of the beauty, the average where [`Frame::samples`] is present; 0 without a beauty.
    pub spp: u32,
    /// Seed of the sequence.
    pub seed: u64,
    /// BLAKE3 of the scene's canonical JSON, hexadecimal.
    pub scene_hash: String,
    /// BLAKE3 of what the files that the scene names hold, hexadecimal; empty where there are none, and where it is not known.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub scene_files: String,
    /// Factor from scene-linear radiance to display-linear (see [`crate::ibl::exposure`]).
    pub exposure: f32,
    /// Form of the BRDF (`conserving`, `published`); empty where it is not known.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub bsdf: String,
    /// How samples were distributed over the pixels (such as `average 256`); empty where every pixel has the same number.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub sampling: String,
    /// Lens of the beauty (such as `aperture 0.02 focus 3`, metres); empty for a pinhole. The G-buffer is always that of a
    /// pinhole in the middle of the lens.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub lens: String,
    /// Shutter of the beauty (such as `open 0.5 moments 32`, the share of the time between two frames and the number of moments);
    /// empty for a picture of one moment. The G-buffer is always that of the frame itself, in the middle of the time.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub shutter: String,
    /// Most surfaces at which a path scattered; `None` where it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_bounces: Option<u32>,
    /// Number of samples that share a camera ray; `None` where each sample has its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub branches: Option<u32>,
    /// Largest contribution of light that scattered at two or more surfaces; `None` without this limit, which biases the picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub indirect_limit: Option<f32>,
    /// Whether paths from the light were traced in addition to paths from the camera.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub light_paths: bool,
    /// Name of the denoiser of the beauty; `None` where the beauty is raw.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub denoiser: Option<String>,
}

impl FrameInfo {
    /// Checks that the frame was rendered from the scene with this [`scene_hash`](Self::scene_hash) and these
    /// [`scene_files`](Self::scene_files). Files that are not known are taken for the same.
    ///
    /// # Errors
    /// A text that tells what differs.
    pub fn check_scene(&self, hash: &str, files: &str) -> std::result::Result<(), &'static str> {
        if self.scene_hash != hash {
            Err("is of another scene than scene.json")
        } else if !self.scene_files.is_empty() && self.scene_files != files {
            Err("was rendered before files that scene.json names changed")
        } else {
            Ok(())
        }
    }

    /// Refuses values that no file may hold: numbers that are not finite, a limit that is not above 0, and 0 samples per camera
    /// ray.
    pub(crate) fn check(&self) -> std::result::Result<(), String> {
        if !self.exposure.is_finite() {
            return Err(format!("exposure is {}", self.exposure));
        }
        if let Some(limit) = self.indirect_limit
            && !(limit > 0.0 && limit.is_finite())
        {
            return Err(format!("the limit of indirect light is {limit}"));
        }
        if self.branches == Some(0) {
            return Err("0 samples a camera ray".into());
        }
        if self.camera.is_finite() { Ok(()) } else { Err("the camera holds NaN or infinity".into()) }
    }
}

/// All channels of one frame; the table in [`crate::channel`] gives their meaning in files.
///
/// G-buffer values are one sample at the pixel centre and never filtered. The `guide_*` pictures are the same quantities,
/// averaged over several camera rays per pixel and premultiplied by coverage (a miss adds zero).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Scene-linear Rec.709 radiance, background included; denoised where a denoiser ran.
    pub beauty: Option<Rgb>,
    /// Hit coverage, 0..=1.
    pub alpha: Image<f32>,
    /// Mean radiance before denoising.
    pub raw: Option<Rgb>,
    /// Variance of the mean of `raw`.
    pub variance: Option<Rgb>,
    /// Number of samples of each pixel; `None` where every pixel has [`FrameInfo::spp`].
    pub samples: Option<Image<u32>>,
    /// Shares of `raw` by where the light came from, indexed by light group; `None` unless requested.
    pub light: [Option<Rgb>; LIGHT_GROUPS],
    /// The part of `raw` that met two surfaces or more; `None` unless requested.
    pub indirect: Option<Rgb>,
    /// What light samples at the first surface would have added to `raw` if nothing had hidden their light; `None` unless
    /// requested. Light that is found by scattered rays is not in it, so it is less than a shadow takes: little on shiny
    /// surfaces, and nothing under an even sky, of which no light samples are drawn. Light that enters a clear body is not in it
    /// either.
    pub hidden: Option<Rgb>,
    /// Base colour at the pixel centre, linear, 0..=1, 0 at a miss.
    pub albedo: Rgb,
    /// Shading normal in camera space (OpenGL axes), unit length, 0 at a miss.
    pub normal: Rgb,
    /// Planar depth in metres along -z, +inf at a miss.
    pub depth: Image<f32>,
    /// Euclidean distance from the camera in metres, +inf at a miss; see [`Frame::fill_distance`].
    pub distance: Option<Image<f32>>,
    /// (roughness, metallic, specular), each 0..=1, 0 at a miss.
    pub material: Rgb,
    /// Share of the light of what is seen through the surface that arrives, 0..=1, 0 for opaque surfaces and at a miss: what
    /// clear surfaces on the way let through, or what a blended surface leaves open. `None` where the scene has neither.
    pub transmittance: Option<Rgb>,
    /// Direction in which the environment is seen through clear surfaces, in camera space (OpenGL axes), unit length. 0 where a
    /// surface is behind them, and where there are none. A blended surface has none either: [`Self::alpha`] says how much of the
    /// environment it leaves open.
    pub through: Option<Rgb>,
    /// Integral of L max(0, ns.w) dw / pi over the unoccluded environment.
    pub irradiance: Option<Rgb>,
    /// Albedo filtered over the pixel, premultiplied by coverage.
    pub guide_albedo: Option<Rgb>,
    /// Camera-space normal filtered over the pixel, premultiplied by coverage, not unit length.
    pub guide_normal: Option<Rgb>,
    /// Pixels, +x right, +y down, from this frame to where the surface point stands in the next; 0 at a miss and in the last
    /// frame.
    pub motion: Option<Image<[f32; 2]>>,
    /// As `motion`, towards the previous frame; 0 at a miss and in the first frame.
    pub motion_prev: Option<Image<[f32; 2]>>,
    /// Object id, 0 = none.
    pub object_id: Image<u32>,
    /// Material id, 0 = none.
    pub material_id: Image<u32>,
    /// Header values.
    pub info: FrameInfo,
}

impl Frame {
    /// Sets [`Self::distance`] from the planar depth and the camera.
    pub fn fill_distance(&mut self) {
        let camera = &self.info.camera;
        let depth = &self.depth;
        let ray = |x: usize, y: usize| camera.direction_cam(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).length();
        self.distance = Some(Image::from_fn(depth.width, depth.height, |x, y| depth.pixels[y * depth.width + x] * ray(x, y)));
    }
}
