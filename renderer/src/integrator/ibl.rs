//! The classical baseline: the G-buffer shaded with the split sum (Karis 2013), without visibility or interreflection.

use super::render_gbuffer;
use crate::compile::RenderScene;
use crate::error::Result;
use crate::settings::Settings;
use renderflow_frame::{Frame, ibl};

/// Renders the G-buffer of the current frame and shades it; [`Frame::beauty`] is the picture, noise-free and without samples.
///
/// # Errors
/// As [`render_gbuffer`].
pub fn render(scene: &RenderScene, settings: &Settings) -> Result<Frame> {
    let mut frame = render_gbuffer(scene, settings)?;
    let shading = ibl::shade(&frame, scene.light());
    frame.beauty = Some(shading.image);
    Ok(frame)
}
