//! PNG files of 8 and 16 bits.

use anyhow::{Context, Result};
use image::{ColorType, ImageEncoder, codecs::png::PngEncoder};

/// Numbers of a PNG.
pub trait Sample {
    /// Colour type of 1, 3 or 4 such numbers a pixel.
    fn color(channels: usize) -> Option<ColorType>;
    /// Their bytes as the encoder wants them: native order.
    fn bytes(samples: &[Self]) -> Vec<u8>
    where
        Self: Sized;
}

impl Sample for u8 {
    fn color(channels: usize) -> Option<ColorType> {
        [(1, ColorType::L8), (3, ColorType::Rgb8), (4, ColorType::Rgba8)].iter().find(|c| c.0 == channels).map(|c| c.1)
    }

    fn bytes(samples: &[Self]) -> Vec<u8> {
        samples.to_vec()
    }
}

impl Sample for u16 {
    fn color(channels: usize) -> Option<ColorType> {
        [(1, ColorType::L16), (3, ColorType::Rgb16), (4, ColorType::Rgba16)].iter().find(|c| c.0 == channels).map(|c| c.1)
    }

    fn bytes(samples: &[Self]) -> Vec<u8> {
        samples.iter().flat_map(|sample| sample.to_ne_bytes()).collect()
    }
}

/// A PNG of `pixels`, row-major from the top left.
pub fn png<S: Sample, const C: usize>(width: usize, height: usize, pixels: impl Iterator<Item = [S; C]>) -> Result<Vec<u8>> {
    let samples: Vec<S> = pixels.flatten().collect();
    let color = S::color(C).context("a PNG has 1, 3 or 4 channels")?;
    let mut file = Vec::new();
    PngEncoder::new(&mut file).write_image(&S::bytes(&samples), width as u32, height as u32, color.into())?;
    Ok(file)
}

/// A PNG whose pixels are the numbers of colours in `palette`, which has three bytes for each colour.
///
/// # Errors
/// When the sizes do not fit together.
pub fn indexed(width: usize, height: usize, palette: &[u8], pixels: Vec<u8>) -> Result<Vec<u8>> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(palette);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&pixels)?;
    writer.finish()?;
    Ok(file)
}

/// 0..=1 in 8 bits, rounded.
pub fn byte(value: f32) -> u8 {
    (255.0 * value.clamp(0.0, 1.0)).round() as u8
}

/// 0..=1 in 16 bits, rounded.
pub fn word(value: f32) -> u16 {
    (65535.0 * value.clamp(0.0, 1.0)).round() as u16
}
