//! Decodes PNG, JPEG and WebP images, as many as fit into memory.

use crate::loaded::{Encoding, Texture, Wrap};
use glam::{Affine2, Mat2, Vec2};
use image::ImageDecoder;
use rayon::prelude::*;
use renderflow_frame::{file, guard, memory};
use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;
use std::sync::Mutex;

/// Largest edge of an image, pixels.
const MAX_EDGE: u32 = 16384;
/// Most texels of an image: 8192 x 8192, which take 358 MB with their mip levels (716 MB in 16 bits).
const MAX_TEXELS: u64 = 1 << 26;
/// Most bytes the decoder may take: 16-bit RGBA of that many texels.
const MAX_BYTES: u64 = 8 * MAX_TEXELS;
/// Most bytes of an image file: as many texels without compression, and a profile.
const MAX_FILE: u64 = MAX_BYTES + (64 << 20);
/// Texels that a byte of PNG gives at most: deflate makes 1032 bytes of one, each eight 1-bit texels.
const PNG_TEXELS_PER_BYTE: u64 = 8 * 1032;
/// Texels that a byte of JPEG gives at most: the first scan of a progressive file spends one bit on 8 x 8 of them.
const JPEG_TEXELS_PER_BYTE: u64 = 8 * 64;
/// The same of WebP: a picture of one colour takes no bytes at all beside its header.
const WEBP_TEXELS_PER_BYTE: u64 = u64::MAX;

/// Most bytes of all textures of a scene, whatever the machine has.
const MOST: u64 = 8 << 30;
/// The same where the system does not say what it has.
const UNKNOWN: u64 = 4 << 30;
/// Bytes that decoding an image takes for a time, for each byte that it takes in the end.
const WHILE_DECODING: u64 = 3;

/// The memory that the textures of a scene may take, with their mip levels.
pub(crate) struct Budget {
    limit: u64,
    /// Bytes and names of the images so far.
    images: Mutex<Vec<(u64, String)>>,
}

impl Budget {
    /// Half of what is free, and no more than [`MOST`].
    pub(crate) fn of_machine() -> Self {
        Self::of(memory::available().map_or(UNKNOWN, |free| free / 2).min(MOST))
    }

    fn of(limit: u64) -> Self {
        Self { limit, images: Mutex::default() }
    }

    /// Counts an image in; the caller asks for [`Self::check`] before decoding it.
    fn count(&self, name: &str, bytes: u64) {
        self.images.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((bytes, name.to_owned()));
    }

    /// Counts a texture that is made of others.
    ///
    /// # Errors
    /// When it does not fit, in words.
    pub(crate) fn take(&self, name: &str, bytes: u64) -> Result<(), String> {
        self.count(name, bytes);
        self.check()
    }

    /// Whether all images counted so far fit; the error names the largest, in words.
    fn check(&self) -> Result<(), String> {
        let mut images = self.images.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone();
        let total: u64 = images.iter().map(|(bytes, _)| bytes).sum();
        if total <= self.limit {
            return Ok(());
        }
        images.sort_by(|a, b| (b.0, &a.1).cmp(&(a.0, &b.1)));
        let gib = |bytes: u64| format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30));
        let largest: Vec<String> = images.iter().take(3).map(|(bytes, name)| format!("{name} ({})", gib(*bytes))).collect();
        Err(format!(
            "the {} textures take {} of memory, more than the {} there is for them; the largest are {}: make them smaller",
            images.len(),
            gib(total),
            gib(self.limit),
            largest.join(", ")
        ))
    }
}

/// Bytes of an image file; the error says what is wrong, in words.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, String> {
    file::read_at_most(path, MAX_FILE).map_err(|e| e.reason())
}

/// Decodes a PNG, JPEG or WebP (by content) and builds its mip levels. 8 and 16 bits a channel; grey becomes three equal
/// channels.
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

/// An image to decode with others.
pub(crate) struct Wanted {
    /// Of the texture.
    pub name: String,
    pub encoding: Encoding,
    pub wrap: [Wrap; 2],
}

/// Decodes images that take no more memory than `budget` has: nothing is decoded where they do. `about` says what image an item
/// wants, `bytes` reads its file, `fail` makes an error of an item and a reason.
pub(crate) fn decode_all<'a, T: Sync, E: Send>(
    items: &[T],
    budget: &Budget,
    about: impl Fn(&T) -> Wanted + Sync,
    bytes: impl Fn(&T) -> Result<Cow<'a, [u8]>, E> + Sync,
    fail: impl Fn(&T, String) -> E + Sync,
) -> Result<Vec<Texture>, E> {
    let size = |item: &T| -> Result<u64, E> { size(&bytes(item)?).map_err(|reason| fail(item, reason)) };
    let sizes = items.par_iter().map(size).collect::<Vec<_>>().into_iter().collect::<Result<Vec<u64>, E>>()?;
    items.iter().zip(&sizes).for_each(|(item, &size)| budget.count(&about(item).name, size));
    if let (Err(reason), Some((item, _))) = (budget.check(), items.iter().zip(&sizes).max_by_key(|(_, size)| **size)) {
        return Err(fail(item, reason));
    }
    let one = |item: &T| {
        let Wanted { name, encoding, wrap } = about(item);
        decode(&bytes(item)?, name, encoding, wrap).map_err(|reason| fail(item, reason))
    };
    // As many at a time as threads only where that leaves room.
    let small = budget.limit / (WHILE_DECODING * rayon::current_num_threads() as u64);
    let mut textures: Vec<Option<Result<Texture, E>>> =
        items.par_iter().zip(&sizes).map(|(item, &size)| (size <= small).then(|| one(item))).collect();
    for (item, texture) in items.iter().zip(&mut textures) {
        texture.get_or_insert_with(|| one(item));
    }
    textures.into_iter().flatten().collect()
}

/// Decodes one image with others to come, as [`decode_all`].
pub(crate) fn decode_one(bytes: &[u8], wanted: Wanted, budget: &Budget) -> Result<Texture, String> {
    budget.count(&wanted.name, size(bytes)?);
    budget.check()?;
    decode(bytes, wanted.name, wanted.encoding, wanted.wrap)
}

/// Decodes a PNG, JPEG or WebP into 8 bits a channel; also whether it has an alpha channel.
pub(crate) fn decode_rgba8(bytes: &[u8], name: &str, budget: &Budget) -> Result<(image::RgbaImage, bool), String> {
    budget.count(name, size(bytes)?);
    budget.check()?;
    let picture = picture(bytes)?;
    let has_alpha = picture.color().has_alpha();
    Ok((picture.into_rgba8(), has_alpha))
}

/// Bytes that the image takes as a texture, with its mip levels; only its header is read.
fn size(bytes: &[u8]) -> Result<u64, String> {
    let ((mut width, mut height), color) = guarded(|| {
        let decoder = decoder(bytes)?;
        Ok((decoder.dimensions(), decoder.color_type()))
    })?;
    let texel = if color.bytes_per_pixel() / color.channel_count() > 1 { 8 } else { 4 };
    let mut texels = u64::from(width) * u64::from(height);
    while width > 1 || height > 1 {
        (width, height) = ((width / 2).max(1), (height / 2).max(1));
        texels += u64::from(width) * u64::from(height);
    }
    Ok(texel * texels)
}

/// The decoder of a PNG, JPEG or WebP that no limit forbids.
fn decoder(bytes: &[u8]) -> Result<impl ImageDecoder, String> {
    let mut reader = image::ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let texels_per_byte = match reader.format() {
        Some(image::ImageFormat::Png) => PNG_TEXELS_PER_BYTE,
        Some(image::ImageFormat::Jpeg) => JPEG_TEXELS_PER_BYTE,
        Some(image::ImageFormat::WebP) => WEBP_TEXELS_PER_BYTE,
        _ => return Err("neither PNG, JPEG nor WebP".into()),
    };
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_EDGE);
    limits.max_image_height = Some(MAX_EDGE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err("the image has no pixels".into());
    }
    let texels = u64::from(width) * u64::from(height);
    if texels > MAX_TEXELS {
        return Err(format!("{width} x {height} is more than {MAX_TEXELS} texels"));
    }
    // The decoder fills what a cut-off JPEG lacks with grey: a header alone would become a picture of any size.
    if texels / texels_per_byte > bytes.len() as u64 {
        return Err(format!("{width} x {height} texels cannot be in {} bytes", bytes.len()));
    }
    Ok(decoder)
}

fn picture(bytes: &[u8]) -> Result<image::DynamicImage, String> {
    guarded(|| image::DynamicImage::from_decoder(decoder(bytes)?).map_err(|e| e.to_string()))
}

/// Runs a decoder. The one of JPEG panics at some damaged files.
fn guarded<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    guard::guarded(decode).unwrap_or_else(|| Err("damaged image data".into()))
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

    /// A PNG of one colour, `edge` texels a side.
    fn png(edge: u32) -> Vec<u8> {
        let mut bytes = Cursor::new(vec![]);
        image::RgbImage::new(edge, edge).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn the_size_of_a_texture_is_known_before_it_is_decoded() {
        for edge in [1, 2, 3, 31, 64] {
            let texture = decode(&png(edge), "x".into(), Encoding::Srgb, Default::default()).unwrap();
            assert_eq!(size(&png(edge)), Ok(texture.bytes() as u64), "{edge}");
        }
    }

    #[test]
    fn textures_stay_in_their_budget_together() {
        let files = [("a", png(16)), ("b", png(64)), ("c", png(16))];
        let load = |limit: u64| {
            let about =
                |(name, _): &(&str, Vec<u8>)| Wanted { name: (*name).into(), encoding: Encoding::Srgb, wrap: Default::default() };
            let bytes = |(_, png): &(&str, Vec<u8>)| Ok(Cow::Owned(png.clone()));
            decode_all(&files, &Budget::of(limit), about, bytes, |(name, _), reason| format!("{name}: {reason}"))
        };
        let all: u64 = files.iter().map(|(_, png)| size(png).unwrap()).sum();
        // Also where an image alone is too large to be decoded beside others.
        let names: Vec<String> = load(all).unwrap().into_iter().map(|texture| texture.name).collect();
        assert_eq!(names, ["a", "b", "c"]);
        let error = load(all - 1).unwrap_err();
        assert!(
            error.starts_with("b: the 3 textures take") && error.contains("the largest are b (0.0 GiB), a (0.0 GiB), c"),
            "{error}"
        );
    }

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
