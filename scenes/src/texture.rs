//! Decodes PNG and JPEG images.

use crate::loaded::{Encoding, Texture, Wrap};
use image::ImageDecoder;
use std::io::Cursor;

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

/// Decodes a PNG or JPEG (by content) and builds its mip levels. 8 and 16 bits a channel; grey becomes three equal channels.
///
/// # Errors
/// What is wrong with the bytes, in words.
pub(crate) fn decode(bytes: &[u8], name: String, encoding: Encoding, wrap: [Wrap; 2]) -> Result<Texture, String> {
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
    let size = [picture.width() as usize, picture.height() as usize];
    if size.contains(&0) {
        return Err("the image has no pixels".into());
    }
    Ok(if picture.color().bytes_per_pixel() / picture.color().channel_count() > 1 {
        let texels = picture.into_rgba16().pixels().map(|p| p.0).collect();
        Texture::from_rgba16(name, size, texels, encoding, wrap)
    } else {
        let texels = picture.into_rgba8().pixels().map(|p| p.0).collect();
        Texture::from_rgba8(name, size, texels, encoding, wrap)
    })
}
