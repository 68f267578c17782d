//! Pictures for people to look at: PNG, error maps, sheets, thumbnails.

use anyhow::{Context, Result};
use base64::Engine;
use renderflow_frame::image::Rgb;
use std::path::Path;

/// Error maps show |difference| times this.
pub const ERROR_GAIN: f32 = 4.0;

/// Mean absolute difference over the channels, times [`ERROR_GAIN`], on a black-red-yellow-white scale.
pub fn error_map(a: &Rgb, b: &Rgb) -> Rgb {
    let pixels = a.pixels.iter().zip(&b.pixels).map(|(a, b)| {
        let error = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / 3.0 * ERROR_GAIN;
        [0.0, 1.0, 2.0].map(|start| (3.0 * error - start).clamp(0.0, 1.0))
    });
    Rgb { width: a.width, height: a.height, pixels: pixels.collect() }
}

/// Pictures of one size side by side, truth first; below each its error map.
pub fn montage<'a>(truth: &'a Rgb, others: impl IntoIterator<Item = &'a Rgb>) -> Rgb {
    let columns: Vec<&Rgb> = std::iter::once(truth).chain(others).collect();
    let errors: Vec<Rgb> = columns.iter().map(|picture| error_map(picture, truth)).collect();
    let (width, height) = (truth.width, truth.height);
    Rgb::from_fn(width * columns.len(), 2 * height, |x, y| {
        if y < height { *columns[x / width].at(x % width, y) } else { *errors[x / width].at(x % width, y - height) }
    })
}

/// 8-bit PNG of display values in 0..=1.
pub fn png(image: &Rgb) -> Result<Vec<u8>> {
    let bytes = image.pixels.iter().flatten().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    let buffer = image::RgbImage::from_raw(image.width as u32, image.height as u32, bytes).context("picture size")?;
    encode(&image::DynamicImage::from(buffer))
}

fn encode(picture: &image::DynamicImage) -> Result<Vec<u8>> {
    let mut out = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut out, image::ImageFormat::Png)?;
    Ok(out.into_inner())
}

/// Display values of a PNG or JPEG file.
///
/// # Errors
/// When it cannot be read.
pub fn display_values(path: &Path) -> Result<Rgb> {
    let picture = image::open(path).with_context(|| path.display().to_string())?.into_rgb32f();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Ok(Rgb { width, height, pixels: picture.pixels().map(|p| p.0).collect() })
}

/// Base64 as data URLs want it.
pub fn base64(bytes: &[u8]) -> String {
    base64::engine::general_purpose::STANDARD.encode(bytes)
}

/// A PNG file's bytes as a data URL.
pub fn data_url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(png))
}

/// Bytes of a PNG file; `None` where there is no such file.
///
/// # Errors
/// When it cannot be read, or is something else.
pub fn read(path: &Path) -> Result<Option<Vec<u8>>> {
    let bytes = match std::fs::read(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        read => read.with_context(|| format!("{}: cannot read", path.display()))?,
    };
    anyhow::ensure!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{}: not a PNG file", path.display());
    Ok(Some(bytes))
}

/// A smaller PNG, `side` pixels along its longer side at most; `path` stands in errors.
///
/// # Errors
/// When the file is damaged.
pub fn thumbnail(png: &[u8], side: u32, path: &Path) -> Result<Vec<u8>> {
    let picture = image::load_from_memory_with_format(png, image::ImageFormat::Png)
        .with_context(|| format!("{}: cannot decode", path.display()))?;
    if picture.width().max(picture.height()) <= side {
        return Ok(png.to_vec());
    }
    encode(&picture.thumbnail(side, side))
}
