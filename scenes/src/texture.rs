//! Decodes PNG and JPEG images to the floats a shader multiplies with.

use renderflow_frame::Image;
use renderflow_frame::color::srgb_to_linear;
use std::io::Cursor;
use std::sync::LazyLock;

/// What the numbers of an image mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Meaning {
    /// Colour encoded with sRGB; becomes linear Rec.709, 0..=1.
    Color,
    /// Numbers; become 0..=1.
    Data,
    /// A tangent-space direction; 0..=1 becomes -1..=1.
    Normal,
}

impl Meaning {
    fn decode(self, value: f32) -> f32 {
        match self {
            Self::Color => srgb_to_linear(value),
            Self::Data => value,
            Self::Normal => 2.0 * value - 1.0,
        }
    }

    /// All values of an 8-bit channel, decoded.
    fn table8(self) -> [f32; 256] {
        std::array::from_fn(|i| self.decode(i as f32 / 255.0))
    }
}

/// sRGB of all 16-bit values: 65536 powers cost less than those of one small texture.
static SRGB16: LazyLock<Vec<f32>> = LazyLock::new(|| (0..=u16::MAX).map(|i| srgb_to_linear(f32::from(i) / 65535.0)).collect());

/// Largest edge of an image, pixels.
const MAX_EDGE: u32 = 16384;
/// Most bytes the decoder may take: keeps a few kilobytes of hostile PNG from filling the memory.
const MAX_BYTES: u64 = 512 << 20;

/// Decodes a PNG or JPEG (by content). 8 and 16 bits a channel; grey becomes three equal channels, alpha is dropped.
///
/// # Errors
/// What is wrong with the bytes, in words.
pub(crate) fn decode(bytes: &[u8], meaning: Meaning) -> Result<Image<[f32; 3]>, String> {
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
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    if width == 0 || height == 0 {
        return Err("the image has no pixels".into());
    }
    let pixels = if picture.color().bytes_per_pixel() / picture.color().channel_count() > 1 {
        let decode = |v: u16| match meaning {
            Meaning::Color => SRGB16[usize::from(v)],
            other => other.decode(f32::from(v) / 65535.0),
        };
        picture.into_rgb16().pixels().map(|p| p.0.map(decode)).collect()
    } else {
        let table = meaning.table8();
        picture.into_rgb8().pixels().map(|p| p.0.map(|v| table[usize::from(v)])).collect()
    };
    Ok(Image { width, height, pixels })
}
