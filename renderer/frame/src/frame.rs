//! One rendered frame: beauty, G-buffer and what its header says.

use crate::Camera;
use crate::image::{Image, Rgb};

/// Most groups the light can be split into.
pub const LIGHT_GROUPS: usize = 8;

/// What the header of a frame file holds besides pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameInfo {
    /// The camera of this frame.
    pub camera: Option<Camera>,
    /// Samples a pixel of the beauty, on average where [`Frame::samples`] is there; 0 when there is none.
    pub spp: u32,
    /// Seed of the sequence.
    pub seed: u64,
    /// BLAKE3 of the scene's canonical JSON, hexadecimal.
    pub scene_hash: String,
    /// Factor from scene-linear radiance to display-linear (see [`crate::ibl::exposure`]).
    pub exposure: f32,
    /// Form of the BRDF that was rendered (`conserving`, `published`), empty where it is not known.
    pub bsdf: String,
    /// How samples were spread over the pixels where not evenly (such as `average 256`), empty where evenly.
    pub sampling: String,
    /// Samples that share a camera ray; `None` where each has one of its own.
    pub branches: Option<u32>,
    /// Largest contribution of light scattered at two or more surfaces; `None` without such a limit, which biases.
    pub indirect_limit: Option<f32>,
    /// Whether paths from the light were traced besides those from the camera.
    pub light_paths: bool,
    /// Name of the denoiser used on the beauty, `None` when it is raw.
    pub denoiser: Option<String>,
}

/// All channels of one frame; the table in [`crate::channel`] gives their meaning in files.
///
/// G-buffer values are one sample at the pixel centre, never filtered. The `guide_*` pictures are the same quantities averaged
/// over several camera rays a pixel, premultiplied by coverage (a miss adds zero).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Scene-linear Rec.709 radiance, denoised where a denoiser ran, background included.
    pub beauty: Option<Rgb>,
    /// Hit coverage, 0..=1.
    pub alpha: Image<f32>,
    /// Mean radiance before denoising.
    pub raw: Option<Rgb>,
    /// Variance of the mean of `raw`.
    pub variance: Option<Rgb>,
    /// Samples of each pixel; `None` where all have [`FrameInfo::spp`].
    pub samples: Option<Image<u32>>,
    /// Shares of `raw` by where the light entered, index = group; all `None` unless asked for.
    pub light: [Option<Rgb>; LIGHT_GROUPS],
    /// Base colour at the pixel centre, linear, 0..=1, 0 at a miss.
    pub albedo: Rgb,
    /// Shading normal in camera space (OpenGL axes), unit length, 0 at a miss.
    pub normal: Rgb,
    /// Planar depth in metres along -z, +inf at a miss.
    pub depth: Image<f32>,
    /// (roughness, metallic, specular), each 0..=1, 0 at a miss.
    pub material: Rgb,
    /// Integral of L max(0, ns.w) dw / pi over the unoccluded environment.
    pub irradiance: Option<Rgb>,
    /// Albedo filtered over the pixel, premultiplied by coverage.
    pub guide_albedo: Option<Rgb>,
    /// Camera-space normal filtered over the pixel, premultiplied by coverage, not unit length.
    pub guide_normal: Option<Rgb>,
    /// Pixels, +x right, +y down, from this frame to where the surface point stands in the next; 0 at a miss and in the last frame.
    pub motion: Option<Image<[f32; 2]>>,
    /// The same towards the previous frame; 0 at a miss and in the first frame.
    pub motion_prev: Option<Image<[f32; 2]>>,
    /// Object id, 0 = none.
    pub object_id: Image<u32>,
    /// Material id, 0 = none.
    pub material_id: Image<u32>,
    /// Header values.
    pub info: FrameInfo,
}
