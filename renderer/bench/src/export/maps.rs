//! Images of exported scenes.

use anyhow::{Context, Result};
use exr::prelude::{Encoding as Storage, Image, Layer, LayerAttributes, SpecificChannels, WritableImage};
use glam::Vec3;
use image::{ImageBuffer, ImageFormat, Luma, Rgb};
use renderflow_scenes::Texture;
use renderflow_scenes::loaded::{Encoding, Wrap};
use renderflow_scenes::mipmap::{self, Level, Texels};
use std::io::Cursor;

/// The edge up to which holes are cut out of an enlarged image.
const ENLARGED: usize = 4096;

/// The image itself.
fn level(texture: &Texture) -> Result<&Level> {
    texture.levels.first().with_context(|| format!("{}: no texels", texture.name))
}

/// Stored numbers of texel `at`, 0..=1.
fn texel(level: &Level, at: usize) -> [f32; 4] {
    match &level.texels {
        Texels::Bytes(texels) => texels[at].map(|v| f32::from(v) / 255.0),
        Texels::Words(texels) => texels[at].map(|v| f32::from(v) / 65535.0),
    }
}

fn word(value: f32) -> u16 {
    (value.clamp(0.0, 1.0) * 65535.0).round() as u16
}

/// Channels `channels` of a texture, multiplied with `factors`. Eight bits stay as they are where nothing is multiplied; the rest
/// becomes sixteen.
pub(super) fn png<const N: usize>(texture: &Texture, channels: [usize; N], factors: [f32; N]) -> Result<Vec<u8>> {
    let level = level(texture)?;
    let size = [level.width as u32, level.height as u32];
    let plain = factors.iter().all(|f| *f == 1.0);
    // Stored value, 0..=1, to the stored value of the product.
    let multiply = |value: f32, channel: usize, factor: f32| match texture.encoding {
        _ if plain => value,
        // Alpha is linear in any encoding.
        Encoding::Srgb if channel < 3 => renderflow_frame::color::linear_to_srgb(mipmap::decode(Encoding::Srgb, value) * factor),
        Encoding::Srgb | Encoding::Linear | Encoding::Normal => value * factor,
    };
    if let (Texels::Bytes(texels), true) = (&level.texels, plain) {
        return encode(size, texels.iter().flat_map(|t| channels.map(|c| t[c])).collect());
    }
    let product = |at: usize| -> [u16; N] {
        let stored = texel(level, at);
        std::array::from_fn(|i| word(multiply(stored[channels[i]], channels[i], factors[i])))
    };
    encode16(size, (0..level.width * level.height).flat_map(product).collect(), N)
}

/// Normals whose lean is `scale` times that of the texture.
pub(super) fn normals(texture: &Texture, scale: f32) -> Result<Vec<u8>> {
    if scale == 1.0 {
        return png(texture, [0, 1, 2], [1.0; 3]);
    }
    let level = level(texture)?;
    let normal = |at: usize| {
        let [x, y, z, _] = texel(level, at).map(|v| mipmap::decode(Encoding::Normal, v));
        Vec3::new(scale * x, scale * y, z).normalize_or(Vec3::Z).to_array().map(|v| word(0.5 + 0.5 * v))
    };
    let size = [level.width as u32, level.height as u32];
    encode16(size, (0..level.width * level.height).flat_map(normal).collect(), 3)
}

/// Where an alpha mask leaves the surface: 255, else 0. The alpha is interpolated before it is compared, so the image is enlarged
/// up to four times, for holes with smooth edges.
pub(super) fn opacity(texture: &Texture, cutoff: f32, factor: f32) -> Result<Vec<u8>> {
    let level = level(texture)?;
    let times = (ENLARGED / level.width.max(level.height).max(1)).clamp(1, 4);
    let (width, height) = (times * level.width, times * level.height);
    let place = |at: usize| (at as f32 + 0.5) / times as f32 - 0.5;
    let alpha = |x: usize, y: usize| {
        let (x, y) = (place(x), place(y));
        let value = |dx: f32, dy: f32| {
            let column = wrapped(x.floor() + dx, level.width, texture.wrap[0]);
            texel(level, wrapped(y.floor() + dy, level.height, texture.wrap[1]) * level.width + column)[3]
        };
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let (u, v) = (x - x.floor(), y - y.floor());
        mix(mix(value(0.0, 0.0), value(1.0, 0.0), u), mix(value(0.0, 1.0), value(1.0, 1.0), u), v)
    };
    let there = |at: usize| if factor * alpha(at % width, at / width) >= cutoff { 255 } else { 0 };
    encode([width as u32, height as u32], (0..width * height).map(there).collect())
}

/// The texel that stands at `place`, which may lie one beyond the ends of `0..count`.
fn wrapped(place: f32, count: usize, wrap: Wrap) -> usize {
    match wrap {
        Wrap::Repeat => (place as i64).rem_euclid(count as i64) as usize,
        Wrap::Mirror | Wrap::Clamp => (place.max(0.0) as usize).min(count - 1),
    }
}

/// The colour of a texture times `factors`, as OpenEXR.
pub(super) fn radiance(texture: &Texture, factors: [f32; 3]) -> Result<Vec<u8>> {
    let level = level(texture)?;
    let value = |x: usize, y: usize| {
        let stored = texel(level, y * level.width + x);
        let [r, g, b] = [0, 1, 2].map(|c| mipmap::decode(texture.encoding, stored[c]) * factors[c]);
        (r, g, b)
    };
    let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| value(at.x(), at.y()));
    let layer = Layer::new((level.width, level.height), LayerAttributes::default(), Storage::FAST_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).context("encoding a texture")?;
    Ok(bytes.into_inner())
}

fn encode([width, height]: [u32; 2], samples: Vec<u8>) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    if samples.len() == (width * height) as usize {
        let image = ImageBuffer::<Luma<u8>, _>::from_raw(width, height, samples).context("a texture of another size")?;
        image.write_to(&mut bytes, ImageFormat::Png)?;
    } else {
        let image = ImageBuffer::<Rgb<u8>, _>::from_raw(width, height, samples).context("a texture of another size")?;
        image.write_to(&mut bytes, ImageFormat::Png)?;
    }
    Ok(bytes.into_inner())
}

fn encode16([width, height]: [u32; 2], samples: Vec<u16>, channels: usize) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    if channels == 1 {
        let image = ImageBuffer::<Luma<u16>, _>::from_raw(width, height, samples).context("a texture of another size")?;
        image.write_to(&mut bytes, ImageFormat::Png)?;
    } else {
        let image = ImageBuffer::<Rgb<u16>, _>::from_raw(width, height, samples).context("a texture of another size")?;
        image.write_to(&mut bytes, ImageFormat::Png)?;
    }
    Ok(bytes.into_inner())
}
