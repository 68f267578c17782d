//! Decodes PNG and JPEG images.

use crate::loaded::{Encoding, Texture, Wrap};
use std::io::Cursor;

/// Largest edge of an image, pixels.
const MAX_EDGE: u32 = 16384;
/// Most bytes the decoder may take: keeps a few kilobytes of hostile PNG from filling the memory.
const MAX_BYTES: u64 = 512 << 20;

/// Decodes a PNG or JPEG (by content) and builds its mip levels. 8 and 16 bits a channel; grey becomes three equal channels.
///
/// # Errors
/// What is wrong with the bytes, in words.
pub(crate) fn decode(bytes: &[u8], name: String, encoding: Encoding, wrap: [Wrap; 2]) -> Result<Texture, String> {
    let mut reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    match reader.format() {
        Some(image::ImageFormat::Png | image::ImageFormat::Jpeg) => {}
        _ => return Err("neither PNG nor JPEG".into()),
    }
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_EDGE);
    limits.max_image_height = Some(MAX_EDGE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let picture = reader.decode().map_err(|e| e.to_string())?;
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
