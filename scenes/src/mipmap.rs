//! Textures as they are stored: four channels in the precision of the file, and a pyramid of box-filtered halves.
//!
//! Four bytes a texel (eight for 16-bit files) instead of twelve or sixteen of decoded floats: an 8k texture with its pyramid takes
//! 358 MB, and look-ups touch a quarter of the cache lines. Halves are filtered in linear space and stored in the file's encoding.

use crate::loaded::{Encoding, Texture, Wrap};
use renderflow_frame::color::{linear_to_srgb, srgb_to_linear};

/// One level of a texture.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row from the top.
    pub texels: Texels,
}

/// RGBA texels.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// 8 bits a channel.
    Bytes(Vec<[u8; 4]>),
    /// 16 bits a channel.
    Words(Vec<[u16; 4]>),
}

impl Texture {
    /// A texture of 8-bit RGBA texels, `width * height` of them, with its levels.
    ///
    /// # Panics
    /// When the number of texels is not `width * height`, or 0.
    pub fn from_rgba8(
        name: impl Into<String>,
        size: [usize; 2],
        texels: Vec<[u8; 4]>,
        encoding: Encoding,
        wrap: [Wrap; 2],
    ) -> Self {
        let decode: [f32; 256] = std::array::from_fn(|i| decode(encoding, i as f32 / 255.0));
        let alpha: [f32; 256] = std::array::from_fn(|i| i as f32 / 255.0);
        let read = |t: &[u8; 4]| {
            [decode[usize::from(t[0])], decode[usize::from(t[1])], decode[usize::from(t[2])], alpha[usize::from(t[3])]]
        };
        let write = |v: [f32; 4]| pack(encoding, v).map(|v| (v * 255.0).round() as u8);
        let levels = pyramid(size, texels, read, write)
            .map(|(width, height, texels)| Level { width, height, texels: Texels::Bytes(texels) })
            .collect();
        Self { name: name.into(), wrap, encoding, levels }
    }

    /// A texture of 16-bit RGBA texels, as [`Self::from_rgba8`].
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_rgba16(
        name: impl Into<String>,
        size: [usize; 2],
        texels: Vec<[u16; 4]>,
        encoding: Encoding,
        wrap: [Wrap; 2],
    ) -> Self {
        let unit = |v: u16| f32::from(v) / 65535.0;
        let read = |t: &[u16; 4]| {
            let [r, g, b] = [t[0], t[1], t[2]].map(|v| decode(encoding, unit(v)));
            [r, g, b, unit(t[3])]
        };
        let write = |v: [f32; 4]| pack(encoding, v).map(|v| (v * 65535.0).round() as u16);
        let levels = pyramid(size, texels, read, write)
            .map(|(width, height, texels)| Level { width, height, texels: Texels::Words(texels) })
            .collect();
        Self { name: name.into(), wrap, encoding, levels }
    }

    /// Bytes of all texels.
    pub fn bytes(&self) -> usize {
        let level = |l: &Level| match &l.texels {
            Texels::Bytes(t) => size_of_val(t.as_slice()),
            Texels::Words(t) => size_of_val(t.as_slice()),
        };
        self.levels.iter().map(level).sum()
    }
}

/// The value that a stored colour channel, 0..=1, stands for.
pub fn decode(encoding: Encoding, value: f32) -> f32 {
    match encoding {
        Encoding::Srgb => srgb_to_linear(value),
        Encoding::Linear => value,
        Encoding::Normal => 2.0 * value - 1.0,
    }
}

/// Inverse of [`decode`] for colour, alpha as it is; clamped to 0..=1.
fn pack(encoding: Encoding, [r, g, b, a]: [f32; 4]) -> [f32; 4] {
    let encode = |v: f32| match encoding {
        Encoding::Srgb => linear_to_srgb(v),
        Encoding::Linear => v,
        Encoding::Normal => 0.5 * v + 0.5,
    };
    [encode(r), encode(g), encode(b), a].map(|v| v.clamp(0.0, 1.0))
}

/// All levels, the given one first.
fn pyramid<T: Copy>(
    [width, height]: [usize; 2],
    texels: Vec<T>,
    read: impl Fn(&T) -> [f32; 4],
    write: impl Fn([f32; 4]) -> T,
) -> impl Iterator<Item = (usize, usize, Vec<T>)> {
    assert!(width > 0 && height > 0 && texels.len() == width * height, "{width} x {height} texels, not {}", texels.len());
    let mut levels = vec![(width, height, texels)];
    while let Some((w, h, texels)) = levels.last().filter(|(w, h, _)| *w > 1 || *h > 1) {
        let half = shrink((*w, *h), texels, &read, &write);
        levels.push(half);
    }
    levels.into_iter()
}

/// Half of a level: every texel is the mean over exactly the area it covers, odd sizes included.
fn shrink<T: Copy>(
    (width, height): (usize, usize),
    texels: &[T],
    read: &impl Fn(&T) -> [f32; 4],
    write: &impl Fn([f32; 4]) -> T,
) -> (usize, usize, Vec<T>) {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let columns: Vec<_> = (0..w).map(|x| covered(x, width, w)).collect();
    let mut result = Vec::with_capacity(w * h);
    for y in 0..h {
        let rows = covered(y, height, h);
        for taps in &columns {
            let mut sum = [0.0f32; 4];
            for &(row, wy) in rows.iter().filter(|(_, weight)| *weight > 0.0) {
                for &(column, wx) in taps.iter().filter(|(_, weight)| *weight > 0.0) {
                    let value = read(&texels[row * width + column]);
                    (0..4).for_each(|c| sum[c] += wy * wx * value[c]);
                }
            }
            result.push(write(sum));
        }
    }
    (w, h, result)
}

/// The texels of `n` that texel `i` of `m` covers (`n / m` is below 3), with weights that sum to 1.
fn covered(i: usize, n: usize, m: usize) -> [(usize, f32); 4] {
    let scale = n as f64 / m as f64;
    let (start, end) = (i as f64 * scale, (i + 1) as f64 * scale);
    let first = start as usize;
    std::array::from_fn(|k| {
        let texel = (first + k).min(n - 1);
        let overlap = (end.min((first + k + 1) as f64) - start.max((first + k) as f64)).max(0.0);
        (texel, if first + k < n { (overlap / scale) as f32 } else { 0.0 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(level: &Level) -> Vec<u8> {
        match &level.texels {
            Texels::Bytes(t) => t.iter().map(|t| t[0]).collect(),
            Texels::Words(_) => vec![],
        }
    }

    #[test]
    fn levels_halve_down_to_one_texel_and_keep_the_mean() {
        for size in [[1, 1], [2, 2], [8, 4], [5, 3], [7, 1], [13, 9]] {
            let texels: Vec<[u8; 4]> = (0..size[0] * size[1]).map(|i| [(i * 37 % 251) as u8; 4]).collect();
            let mean = texels.iter().map(|t| f32::from(t[0])).sum::<f32>() / texels.len() as f32;
            let texture = Texture::from_rgba8("t", size, texels, Encoding::Linear, Default::default());
            let last = texture.levels.last().expect("at least one");
            assert_eq!((last.width, last.height), (1, 1));
            // Half a unit of rounding a level.
            assert!((f32::from(grey(last)[0]) - mean).abs() <= 0.5 * texture.levels.len() as f32, "{size:?}");
        }
    }

    #[test]
    fn colours_are_averaged_in_linear_space() {
        let texture = Texture::from_rgba8("t", [2, 1], vec![[0; 4], [255; 4]], Encoding::Srgb, Default::default());
        // sRGB of linear 0.5 is 187.5 of 255 by the standard's formula.
        assert!((187..=188).contains(&grey(&texture.levels[1])[0]), "{:?}", texture.levels[1]);
    }

    #[test]
    fn odd_sizes_weigh_by_area() {
        let texture = Texture::from_rgba8("t", [3, 1], vec![[30; 4], [60; 4], [120; 4]], Encoding::Linear, Default::default());
        assert_eq!(grey(&texture.levels[1]), [70]);
    }
}
