//! Decodes PNG and JPEG images.

use crate::loaded::{Encoding, Texture, Wrap};
use glam::{Affine2, Mat2, Vec2};
use image::ImageDecoder;
use std::io::Cursor;
use std::path::Path;

/// Largest edge of an image, pixels.
const MAX_EDGE: u32 = 16384;
/// Most texels of an image: 8192 x 8192, which take 358 MB with their mip levels (716 MB in 16 bits).
const MAX_TEXELS: u64 = 1 << 26;
/// Most bytes the decoder may take: 16-bit RGBA of that many texels.
const MAX_BYTES: u64 = 8 * MAX_TEXELS;
/// Texels that a byte of PNG gives at most: deflate makes 1032 bytes of one, each eight 1-bit texels.
const PNG_TEXELS_PER_BYTE: u64 = 8 * 1032;
/// Texels that a byte of JPEG gives at most: the first scan of a progressive file spends one bit on 8 x 8 of them.
const JPEG_TEXELS_PER_BYTE: u64 = 8 * 64;

/// Bytes of an image file; the error says what is wrong, in words.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, String> {
    let kind = std::fs::metadata(path).map_err(|e| format!("cannot read: {e}"))?;
    // A pipe or a device would be read for ever.
    if !kind.is_file() {
        return Err("cannot read: not a regular file".into());
    }
    std::fs::read(path).map_err(|e| format!("cannot read: {e}"))
}

/// Decodes a PNG or JPEG (by content) and builds its mip levels. 8 and 16 bits a channel; grey becomes three equal channels.
///
/// # Errors
/// What is wrong with the bytes, in words.
pub(crate) fn decode(bytes: &[u8], name: String, encoding: Encoding, wrap: [Wrap; 2]) -> Result<Texture, String> {
    let picture = picture(bytes)?;
    let size = [picture.width() as usize, picture.height() as usize];
    Ok(if picture.color().bytes_per_pixel() / picture.color().channel_count() > 1 {
        let texels = picture.into_rgba16().pixels().map(|p| p.0).collect();
        Texture::from_rgba16(name, size, texels, encoding, wrap)
    } else {
        let texels = picture.into_rgba8().pixels().map(|p| p.0).collect();
        Texture::from_rgba8(name, size, texels, encoding, wrap)
    })
}

/// Decodes a PNG or JPEG into 8 bits a channel; also whether it has an alpha channel.
pub(crate) fn decode_rgba8(bytes: &[u8]) -> Result<(image::RgbaImage, bool), String> {
    let picture = picture(bytes)?;
    let has_alpha = picture.color().has_alpha();
    Ok((picture.into_rgba8(), has_alpha))
}

fn picture(bytes: &[u8]) -> Result<image::DynamicImage, String> {
    let mut reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let texels_per_byte = match reader.format() {
        Some(image::ImageFormat::Png) => PNG_TEXELS_PER_BYTE,
        Some(image::ImageFormat::Jpeg) => JPEG_TEXELS_PER_BYTE,
        _ => return Err("neither PNG nor JPEG".into()),
    };
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_EDGE);
    limits.max_image_height = Some(MAX_EDGE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions();
    let texels = u64::from(width) * u64::from(height);
    if texels > MAX_TEXELS {
        return Err(format!("{width} x {height} is more than {MAX_TEXELS} texels"));
    }
    // The decoder fills what a cut-off JPEG lacks with grey: a header alone would become a picture of any size.
    if texels / texels_per_byte > bytes.len() as u64 {
        return Err(format!("{width} x {height} texels cannot be in {} bytes", bytes.len()));
    }
    let picture = image::DynamicImage::from_decoder(decoder).map_err(|e| e.to_string())?;
    if picture.width() == 0 || picture.height() == 0 {
        return Err("the image has no pixels".into());
    }
    Ok(picture)
}

/// KHR_texture_transform: scale, then a turn that looks counter-clockwise where v runs down, then the offset.
/// (The README's own example, the lower left quadrant, holds with this sign only.)
pub(crate) fn uv_transform(offset: [f32; 2], rotation: f32, scale: [f32; 2]) -> Affine2 {
    let turn = Mat2::from_angle(-rotation);
    let transform = Affine2 { matrix2: turn * Mat2::from_diagonal(Vec2::from(scale)), translation: Vec2::from(offset) };
    if transform.is_finite() { transform } else { Affine2::IDENTITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The two examples of the extension's README, in its own words.
    #[test]
    fn texture_transform_examples() {
        // "utilizes only the lower left quadrant of the source image, rotated clockwise 90 degrees"
        let quadrant = uv_transform([0.0, 1.0], std::f32::consts::FRAC_PI_2, [0.5, 0.5]);
        for corner in [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE] {
            let uv = quadrant.transform_point2(corner);
            assert!((-1e-6..=0.5 + 1e-6).contains(&uv.x) && (0.5 - 1e-6..=1.0 + 1e-6).contains(&uv.y), "{corner} -> {uv}");
        }
        // "inverts the T axis, effectively defining a bottom-left origin"
        let flipped = uv_transform([0.0, 1.0], 0.0, [1.0, -1.0]);
        assert!(flipped.transform_point2(Vec2::new(0.25, 0.25)).distance(Vec2::new(0.25, 0.75)) < 1e-6);
    }
}
