//! Pictures for people to look at: PNG, error maps, sheets, thumbnails.

use anyhow::{Context, Result, ensure};
use base64::Engine;
use image::ImageDecoder;
use image::metadata::Orientation;
use renderflow_frame::image::Rgb;
use renderflow_frame::{file, guard};
use std::path::Path;

/// Error maps show |difference| times this.
pub const ERROR_GAIN: f32 = 4.0;

/// Mean absolute difference over the channels, times [`ERROR_GAIN`], on the scale [`heat`].
pub fn error_map(a: &Rgb, b: &Rgb) -> Rgb {
    let pixels = a.pixels.iter().zip(&b.pixels).map(|(a, b)| {
        let error = a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / 3.0 * ERROR_GAIN;
        heat(error)
    });
    Rgb { width: a.width, height: a.height, pixels: pixels.collect() }
}

/// Black over red and yellow to white, for numbers from 0 to 1.
pub fn heat(share: f32) -> [f32; 3] {
    [0.0, 1.0, 2.0].map(|start| (3.0 * share - start).clamp(0.0, 1.0))
}

/// The colour of an object or a material in pictures of ids: neighbouring numbers differ much, and 0 (nothing) is black.
pub fn id_color(id: u32) -> [u8; 3] {
    if id == 0 {
        return [0; 3];
    }
    // Hues turn by the golden angle; saturation and value change more slowly.
    let hue = (f64::from(id) * 0.618_033_988_749_895).fract() * 6.0;
    let value = [1.0, 0.75, 0.55][(id / 5 % 3) as usize];
    let saturation = [0.75, 0.5][(id / 3 % 2) as usize];
    [0.0, 4.0, 2.0].map(|turn| {
        let wave: f64 = ((hue + turn) % 6.0 - 3.0).abs() - 1.0;
        (255.0 * value * (1.0 - saturation + saturation * wave.clamp(0.0, 1.0))).round() as u8
    })
}

/// The picture with at most `most` pixels along its longer side; smaller ones stay as they are.
pub fn reduced(picture: &Rgb, most: usize) -> Rgb {
    let longer = picture.width.max(picture.height);
    if longer <= most {
        return picture.clone();
    }
    let side = |pixels: usize| ((pixels * most) as f64 / longer as f64).round().max(1.0) as usize;
    let (width, height) = (side(picture.width), side(picture.height));
    // The thumbnails of `image` add one half to pictures of floats.
    Rgb::from_fn(width, height, |x, y| {
        let mut mean = [0.0; 3];
        for (row, high) in shares(y, picture.height, height) {
            for (column, wide) in shares(x, picture.width, width) {
                mean.iter_mut().zip(picture.at(column, row)).for_each(|(mean, value)| *mean += high * wide * value);
            }
        }
        mean
    })
}

/// The pixels that lie below pixel `at` when a line of `from` pixels becomes one of `to`, each with its share of that pixel.
fn shares(at: usize, from: usize, to: usize) -> impl Iterator<Item = (usize, f32)> {
    // In units of which a pixel of the long line has `to` and one of the short line `from`.
    let (start, end) = (at * from, (at + 1) * from);
    let share = move |i: usize| (i, (end.min((i + 1) * to) - start.max(i * to)) as f32 / from as f32);
    (start / to..end.div_ceil(to)).map(share)
}

/// An endless GIF of pictures of equal size, each shown for this many milliseconds. The bytes depend on the pictures alone.
///
/// # Errors
/// As an item of `pictures`, or when the pictures are too large for a GIF.
pub fn gif(pictures: impl IntoIterator<Item = Result<Rgb>>, milliseconds: u32) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut encoder = image::codecs::gif::GifEncoder::new_with_speed(&mut out, 10);
    encoder.set_repeat(image::codecs::gif::Repeat::Infinite)?;
    for picture in pictures {
        let picture = image::DynamicImage::from(bytes_of(&picture?)?).into_rgba8();
        let delay = image::Delay::from_numer_denom_ms(milliseconds, 1);
        encoder.encode_frame(image::Frame::from_parts(picture, 0, 0, delay))?;
    }
    drop(encoder);
    Ok(out)
}

/// 8-bit PNG of display values in 0..=1.
pub fn png(image: &Rgb) -> Result<Vec<u8>> {
    encode(&image::DynamicImage::from(bytes_of(image)?))
}

/// As [`png`], in a tenth of the time and a larger file.
///
/// # Errors
/// As [`png`].
pub fn quick_png(image: &Rgb) -> Result<Vec<u8>> {
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let mut out = Vec::new();
    bytes_of(image)?.write_with_encoder(PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Sub))?;
    Ok(out)
}

/// Display values in 8 bits.
fn bytes_of(image: &Rgb) -> Result<image::RgbImage> {
    let bytes = image.pixels.iter().flatten().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    image::RgbImage::from_raw(image.width as u32, image.height as u32, bytes).context("picture size")
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

/// Decodes a PNG or JPEG file, turned as its EXIF data say; `path` is only for errors. If its size must be `expected`, the size
/// is compared before any pixel is decoded.
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
    // The decoder of JPEG panics at some damaged files.
    let damaged = || format!("{}: damaged image data", path.display());
    let mut decoder = guard::guarded(|| reader.into_decoder()).with_context(damaged)?.with_context(context)?;
    // Damaged EXIF data say nothing.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let (width, height) = match (decoder.dimensions(), turns(orientation)) {
        ((width, height), true) => (height, width),
        (size, false) => size,
    };
    match expected {
        Some(expected) => same_size(path, [width as usize, height as usize], expected)?,
        None => ensure!(
            u64::from(width) * u64::from(height) <= MOST_PIXELS,
            "{}: {width} x {height} is more than the {MOST_PIXELS} pixels that are read of a picture",
            path.display()
        ),
    }
    let decoded = guard::guarded(|| image::DynamicImage::from_decoder(decoder));
    let mut picture = decoded.with_context(damaged)?.with_context(context)?;
    picture.apply_orientation(orientation);
    Ok(picture)
}

/// Whether columns become rows.
fn turns(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
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

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::image::Image;

    #[test]
    fn neighbouring_ids_have_other_colours() {
        assert_eq!(id_color(0), [0; 3]);
        let colors: std::collections::HashSet<[u8; 3]> = (0..64).map(id_color).collect();
        assert_eq!(colors.len(), 64);
        let apart = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).map(|(a, b)| i32::from(a.abs_diff(b))).sum::<i32>();
        for id in 0..64 {
            assert!(apart(id_color(id), id_color(id + 1)) > 60, "{id}");
        }
    }

    #[test]
    fn a_smaller_picture_has_the_same_colours() {
        let near = |a: &Rgb, b: [f32; 3]| a.pixels.iter().all(|p| p.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5));
        for (width, height, size) in [(512, 3, (480, 3)), (481, 7, (480, 7)), (5, 4000, (1, 480)), (960, 480, (480, 240))] {
            let small = reduced(&Image::filled(width, height, [0.0, 0.25, 1.0]), 480);
            assert_eq!((small.width, small.height), size);
            assert!(near(&small, [0.0, 0.25, 1.0]), "{width} x {height}: {:?}", small.pixels[0]);
        }
        // Three pixels become two: each has one of them and half of the middle one.
        let line = Image::from_fn(3, 1, |x, _| [[0.0; 3], [0.3; 3], [0.9; 3]][x]);
        let small = reduced(&line, 2);
        assert!((small.pixels[0][0] - 0.1).abs() < 1e-6 && (small.pixels[1][0] - 0.7).abs() < 1e-6, "{small:?}");
        assert_eq!(reduced(&line, 3), line);
    }

    /// A JPEG of a camera that was held upright says that its rows are columns.
    #[test]
    fn photos_are_turned_as_they_say() {
        let mut jpeg = std::io::Cursor::new(Vec::new());
        let picture = image::RgbImage::from_fn(24, 16, |x, _| image::Rgb([if x < 12 { 250 } else { 5 }; 3]));
        picture.write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
        let jpeg = jpeg.into_inner();
        let said = |orientation: u8| {
            // A TIFF header, and a directory with one entry: tag 0x112, a short.
            let tiff =
                [b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".as_slice(), &[orientation, 0, 0, 0, 0, 0, 0]].concat();
            let exif = [b"Exif\0\0".as_slice(), &tiff].concat();
            let length = (exif.len() as u16 + 2).to_be_bytes();
            [&jpeg[..2], &[0xff, 0xe1], &length, &exif, &jpeg[2..]].concat()
        };
        let path = Path::new("photo.jpg");
        let bright = |orientation: u8| {
            let turned = decode(path, &said(orientation), None).unwrap().into_luma8();
            let corners = [(0, 0), (turned.width() - 1, 0), (0, turned.height() - 1)];
            (turned.dimensions(), corners.map(|(x, y)| turned.get_pixel(x, y).0[0] > 128))
        };
        assert_eq!(bright(1), ((24, 16), [true, false, true]));
        assert_eq!(bright(3), ((24, 16), [false, true, false]));
        assert_eq!(bright(6), ((16, 24), [true, true, false]));
        assert_eq!(bright(8), ((16, 24), [false, false, true]));
        // The size that is compared is the one that is seen.
        assert!(decode(path, &said(6), Some([16, 24])).is_ok() && decode(path, &said(6), Some([24, 16])).is_err());
        // Damaged EXIF data are passed over.
        assert_eq!(bright(77).0, (24, 16));
    }

    /// The decoder panics at this file.
    #[test]
    fn a_photo_that_its_decoder_cannot_survive_is_refused() {
        let bytes = include_bytes!("../../fuzz/seeds/texture/one_component_of_three.jpg");
        let error = decode(Path::new("photo.jpg"), bytes, None).unwrap_err().to_string();
        assert_eq!(error, "photo.jpg: damaged image data");
    }

    #[test]
    fn an_animation_holds_each_picture() {
        use image::AnimationDecoder;
        let picture = |shift: usize| Image::from_fn(12, 8, |x, y| [((x + shift) % 12) as f32 / 12.0, y as f32 / 8.0, 0.5]);
        let bytes = gif((0..3).map(|shift| Ok(picture(4 * shift))), 100).unwrap();
        assert_eq!(bytes, gif((0..3).map(|shift| Ok(picture(4 * shift))), 100).unwrap());
        let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
        let frames = decoder.into_frames().collect_frames().unwrap();
        assert_eq!(frames.len(), 3);
        for (shift, frame) in frames.iter().enumerate() {
            assert_eq!((frame.buffer().width(), frame.buffer().height()), (12, 8));
            let red = frame.buffer().get_pixel(0, 0).0[0];
            assert!(red.abs_diff((4 * shift * 255 / 12) as u8) < 12, "{shift}: {red}");
        }
    }
}
