//! Reads and writes environment maps: Radiance `.hdr` and `.exr`.

use crate::Result;
use crate::image::Rgb;
use std::path::Path;

/// An environment map as read, with what had to be repaired.
#[derive(Clone, Debug)]
pub struct LoadedMap {
    /// Finite, non-negative radiance.
    pub map: Rgb,
    /// Texels that were NaN, infinite or negative and became 0.
    pub repaired: usize,
}

/// Reads `.hdr` or `.exr` (by content). NaN, infinite and negative texels become 0 and are counted.
///
/// # Errors
/// When the file is missing, truncated or neither format.
pub fn read(_path: &Path) -> Result<LoadedMap> {
    todo!()
}

/// Decodes a Radiance `.hdr` held in memory; `name` stands for the path in errors.
///
/// # Errors
/// As [`read`].
pub fn decode(_name: &Path, _bytes: &[u8]) -> Result<LoadedMap> {
    todo!()
}

/// Encodes as Radiance RGBE with run lengths: the same picture gives the same bytes on every machine.
pub fn encode(_map: &Rgb) -> Vec<u8> {
    todo!()
}
