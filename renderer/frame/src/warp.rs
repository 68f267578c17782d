//! Carries a keyframe's picture to another camera: where a pixel's surface point stood in the keyframe, and whether it was seen there.

use crate::Frame;
use crate::image::{Image, Rgb};

/// Where each pixel of the current frame finds itself in a keyframe.
#[derive(Clone, Debug)]
pub struct Correspondence {
    /// Image point in the keyframe (pixels), meaningless where `valid` is 0.
    pub source: Image<[f32; 2]>,
    /// 1 where depth, normal and object id agree on the whole bilinear footprint, else 0.
    pub valid: Image<f32>,
}

/// Correspondence of `current` into `key` for static geometry, by depth and both cameras. `motion` holds, per pixel, the extra
/// offset (pixels) of moving objects, if any.
pub fn correspond(_current: &Frame, _key: &Frame, _motion: Option<&Image<[f32; 2]>>) -> Correspondence {
    todo!()
}

/// Bilinear fetch of `picture` (of the keyframe) at each pixel's source; 0 where invalid.
pub fn fetch(_picture: &Rgb, _correspondence: &Correspondence) -> Rgb {
    todo!()
}
