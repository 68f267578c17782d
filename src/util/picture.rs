//! Pictures for people to look at: PNG, error maps, sheets, thumbnails.

use anyhow::{Context, Result, ensure};
use base64::Engine;
use image::ImageDecoder;
use renderflow_frame::file;
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

/// Pictures of equal size side by side, the truth first, with their error maps below.
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

/// Files of pictures may have at most this many bytes.
const LARGEST: u64 = 2 << 30;
/// A picture may have at most this many pixels, where its size is not known in advance.
const MOST_PIXELS: u64 = 1 << 26;

/// Bytes of a picture's file.
///
/// # Errors
/// When it cannot be read.
pub fn bytes(path: &Path) -> Result<Vec<u8>> {
    Ok(file::read_at_most(path, LARGEST)?)
}

/// Decodes a PNG or JPEG file; `path` is only for errors. If its size must be `expected`, the size is compared before any pixel
/// is decoded.
///
/// # Errors
/// When it is neither, has another size or too many pixels, or is damaged.
pub fn decode(path: &Path, bytes: &[u8], expected: Option<[usize; 2]>) -> Result<image::DynamicImage> {
    let context = || path.display().to_string();
    let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format().with_context(context)?;
    ensure!(
        matches!(reader.format(), Some(image::ImageFormat::Png | image::ImageFormat::Jpeg)),
        "{}: neither PNG nor JPEG",
        path.display()
    );
    // The size is compared below, before memory is taken for pixels.
    reader.no_limits();
    let decoder = reader.into_decoder().with_context(context)?;
    let (width, height) = decoder.dimensions();
    match expected {
        Some(expected) => same_size(path, [width as usize, height as usize], expected)?,
        None => ensure!(
            u64::from(width) * u64::from(height) <= MOST_PIXELS,
            "{}: {width} x {height} is more than the {MOST_PIXELS} pixels that are read of a picture",
            path.display()
        ),
    }
    image::DynamicImage::from_decoder(decoder).with_context(context)
}

/// # Errors
/// When the picture at `path` has another size than what it is compared with.
pub fn same_size(path: &Path, [width, height]: [usize; 2], [wide, high]: [usize; 2]) -> Result<()> {
    ensure!(
        [width, height] == [wide, high],
        "{}: {width} x {height} pixels where the picture to compare with has {wide} x {high}",
        path.display()
    );
    Ok(())
}

/// Display values of a PNG or JPEG file.
///
/// # Errors
/// When it cannot be read, or as [`decode`].
pub fn display_values(path: &Path) -> Result<Rgb> {
    let picture = decode(path, &bytes(path)?, None)?.into_rgb32f();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Ok(Rgb { width, height, pixels: picture.pixels().map(|p| p.0).collect() })
}

/// Base64, as data URLs need it.
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
    let bytes = match file::read_at_most(path, LARGEST) {
        Err(error) if error.is_missing() => return Ok(None),
        read => read?,
    };
    anyhow::ensure!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{}: not a PNG file", path.display());
    Ok(Some(bytes))
}

/// A smaller PNG, with at most `side` pixels along its longer side; `path` is only for errors.
///
/// # Errors
/// When the file is damaged.
pub fn thumbnail(png: &[u8], side: u32, path: &Path) -> Result<Vec<u8>> {
    let picture = decode(path, png, None)?;
    if picture.width().max(picture.height()) <= side {
        return Ok(png.to_vec());
    }
    encode(&picture.thumbnail(side, side))
}
