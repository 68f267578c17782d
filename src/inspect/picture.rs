//! Maps, frames and texture images.

use super::Counts;
use anyhow::{Result, ensure};
use renderflow_frame::{Frame, channel, frame_file, hdr};
use renderflow_scenes::load;
use renderflow_scenes::loaded::Encoding;
use serde_json::json;
use std::path::Path;

/// Whether an OpenEXR file, by the names in its header, is a frame: a frame has a depth, a map has not.
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
        found.notes.push("not twice as wide as high: it is stretched over the sphere all the same".into());
    }
    Ok(found)
}

/// A frame: every channel present and in its range.
pub(super) fn frame(path: &Path) -> Result<Counts> {
    let frame = frame_file::read(path)?;
    verify(&frame).map_err(|reason| anyhow::anyhow!("{}: {reason}", path.display()))?;
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

/// Half floats round a unit normal's length by this much.
const NORMAL: f32 = 2e-3;

/// The conventions that a frame's header states, pixel by pixel: depth +inf and a zero normal at a miss, a positive depth and a unit
/// normal at a hit, coverage within 0..=1, no negative light. (The reader has refused NaN.)
pub(crate) fn verify(frame: &Frame) -> Result<()> {
    let place = |i: usize| format!("pixel ({}, {})", i % frame.width, i / frame.width);
    for i in 0..frame.depth.pixels.len() {
        let (depth, alpha) = (frame.depth.pixels[i], frame.alpha.pixels[i]);
        let length = glam::Vec3::from(frame.normal.pixels[i]).length();
        ensure!(depth > 0.0, "{}: depth.Z is {depth}, not above 0", place(i));
        ensure!((0.0..=1.0).contains(&alpha), "{}: A is {alpha}, outside 0..=1", place(i));
        if depth.is_finite() {
            ensure!((length - 1.0).abs() <= NORMAL, "{}: the normal has length {length}, not 1", place(i));
        } else {
            ensure!(length == 0.0, "{}: a miss (depth +inf) with a normal of length {length}", place(i));
        }
    }
    if let Some(distance) = &frame.distance {
        let mut expected = frame.clone();
        expected.fill_distance();
        let pairs = distance.pixels.iter().zip(expected.distance.iter().flat_map(|image| &image.pixels));
        if let Some(i) = pairs.into_iter().position(|(d, e)| !(d == e || (d - e).abs() <= 1e-5 * e)) {
            anyhow::bail!("{}: distance.Z is {}, not that of the planar depth", place(i), distance.pixels[i]);
        }
    }
    let lights = [("the beauty", &frame.beauty), ("raw", &frame.raw), ("variance", &frame.variance)];
    for (name, image) in lights {
        if let Some(image) = image
            && let Some(i) = image.pixels.iter().position(|p| p.iter().any(|v| *v < 0.0))
        {
            anyhow::bail!("{}: {name} is negative, {:?}", place(i), image.pixels[i]);
        }
    }
    Ok(())
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
