//! Maps, frames and texture images.

use super::Counts;
use crate::dataset::check::verify_frame;
use anyhow::Result;
use renderflow_frame::{Frame, channel, frame_file, hdr};
use renderflow_scenes::load;
use renderflow_scenes::loaded::Encoding;
use serde_json::json;
use std::path::Path;

/// Whether an OpenEXR file is a frame, by the names in its header: frames have a depth, and maps do not.
pub(super) fn is_frame(head: &[u8]) -> bool {
    head.windows(8).any(|w| w == b"depth.Z\0")
}

/// An environment map.
pub(super) fn map(path: &Path) -> Result<Counts> {
    let loaded = hdr::read(path)?;
    let (low, high) = range(loaded.map.pixels.as_flattened());
    let mut found = Counts::default();
    found.add("size", json!([loaded.map.width, loaded.map.height]));
    found.add("lowest", low);
    found.add("highest", high);
    found.add("repaired_texels", loaded.repaired);
    if loaded.map.width != 2 * loaded.map.height {
        found.notes.push("not twice as wide as high: it is stretched over the sphere anyway".into());
    }
    Ok(found)
}

/// A frame: every channel present and in its range.
pub(super) fn frame(path: &Path) -> Result<Counts> {
    let frame = frame_file::read(path)?;
    verify_frame(&frame).map_err(|reason| anyhow::anyhow!("{}: {reason}", path.display()))?;
    Ok(describe(&frame))
}

/// What a readable frame holds.
fn describe(frame: &Frame) -> Counts {
    let mut found = Counts::default();
    found.add("size", json!([frame.width, frame.height]));
    found.add("spp", frame.info.spp);
    found.add("exposure", frame.info.exposure);
    found.add("denoiser", frame.info.denoiser.clone());
    found.add("covered", frame.depth.pixels.iter().filter(|d| d.is_finite()).count());
    if let Some(beauty) = frame.beauty.as_ref().or(frame.raw.as_ref()) {
        let (low, high) = range(beauty.pixels.as_flattened());
        found.add("lowest", low);
        found.add("highest", high);
    }
    found.add("known_channels", channel::LAYERS.iter().map(|l| l.components.len()).sum::<usize>());
    found
}

/// An image for textures.
pub(super) fn texture(path: &Path) -> Result<Counts> {
    let texture = load::read_texture(path, Encoding::Srgb)?;
    let mut found = Counts::default();
    if let Some(level) = texture.levels.first() {
        found.add("size", json!([level.width, level.height]));
    }
    found.add("levels", texture.levels.len());
    found.add("bytes", texture.bytes());
    Ok(found)
}

/// Smallest and largest of some values; 0 and 0 without any.
fn range(values: &[f32]) -> (f32, f32) {
    values.iter().copied().map(|v| (v, v)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default()
}
