//! Reads and writes environment maps: Radiance `.hdr` and `.exr`.

use crate::image::Rgb;
use crate::{Error, Result, exr, rgbe};
use std::path::Path;

/// Largest size in bytes of a map's file: 2^27 uncompressed texels of four floats, and a header.
const LARGEST: u64 = 9 << 28;

/// An environment map that was read, with the number of texels that had to be repaired.
#[derive(Clone, Debug)]
pub struct LoadedMap {
    /// Finite, non-negative radiance.
    pub map: Rgb,
    /// Texels that were NaN, infinite or negative and became 0.
    pub repaired: usize,
}

/// Reads `.hdr` or `.exr` (by content). NaN, infinite and negative texels become 0 and are counted.
///
/// `EXPOSURE` and `COLORCORR` lines of a `.hdr` are not applied, as in other renderers: maps are used in their stored units.
///
/// # Errors
/// When the file is missing, truncated or of neither format; when an `.exr` is not one equirectangular `R`, `G`, `B` picture.
pub fn read(path: &Path) -> Result<LoadedMap> {
    decode(path, &crate::file::read_at_most(path, LARGEST)?)
}

/// Decodes a `.hdr` or `.exr` in memory; errors give `name` as the path.
///
/// # Errors
/// As [`read`].
pub fn decode(name: &Path, bytes: &[u8]) -> Result<LoadedMap> {
    let mut map = if bytes.starts_with(&exr::SIGNATURE) {
        exr::decode_environment(name, bytes)?
    } else if bytes.starts_with(rgbe::SIGNATURE) {
        rgbe::decode(bytes).map_err(|reason| Error::malformed(name, reason))?
    } else {
        return Err(neither(name, bytes));
    };
    let mut repaired = 0;
    for texel in &mut map.pixels {
        if !texel.iter().all(|v| v.is_finite() && *v >= 0.0) {
            *texel = [0.0; 3];
            repaired += 1;
        }
    }
    Ok(LoadedMap { map, repaired })
}

fn neither(name: &Path, bytes: &[u8]) -> Error {
    Error::malformed(name, if bytes.is_empty() { "the file is empty" } else { "neither Radiance .hdr nor OpenEXR" })
}

/// Columns and rows of the picture in a `.hdr` or `.exr` in memory; pixels are not decoded. Errors give `name` as the path.
///
/// # Errors
/// When the bytes are of neither format, or the header is refused as in [`decode`].
pub fn size(name: &Path, bytes: &[u8]) -> Result<[usize; 2]> {
    if bytes.starts_with(&exr::SIGNATURE) {
        exr::rgb_size(name, bytes)
    } else if !bytes.starts_with(rgbe::SIGNATURE) {
        Err(neither(name, bytes))
    } else {
        rgbe::size(bytes).map_err(|reason| Error::malformed(name, reason))
    }
}

/// Encodes as Radiance RGBE with run lengths. The same picture gives the same bytes on every machine.
///
/// Components are rounded to the nearest of 8-bit mantissas that share an exponent; a decoded picture encodes to the same values
/// again. NaN and negative components become 0, and larger values become 1.7e38.
pub fn encode(map: &Rgb) -> Vec<u8> {
    rgbe::encode(map)
}
