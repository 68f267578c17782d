//! Textures as they are stored: four channels in the precision of the file, and a pyramid of box-filtered halves.
//!
//! Four bytes a texel (eight for 16-bit files) instead of twelve or sixteen of decoded floats: an 8k texture with its pyramid
//! takes 358 MB, and look-ups touch a quarter of the cache lines. Halves are filtered in linear space and stored in the file's
//! encoding.
//!
//! Alpha is one channel of four: it says something of the others only where a material has holes, for which there is
//! [`Texture::weighed_by_alpha`]. Elsewhere it may be anything; a glossiness, for one.

use rayon::prelude::*;
use renderflow_frame::color::{linear_to_srgb, srgb_to_linear};
use std::sync::{Arc, OnceLock};

/// How texture coordinates outside 0..1 behave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// Fractional part.
    #[default]
    Repeat,
    /// Fractional part, every other tile mirrored.
    Mirror,
    /// Edge texel.
    Clamp,
}

/// What the stored numbers of a texture mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// RGB encoded with sRGB, linear alpha; decodes to linear Rec.709, 0..=1.
    Srgb,
    /// Numbers 0..=1.
    Linear,
    /// A tangent-space direction in RGB; decodes to -1..=1.
    Normal,
}

/// An image with its mip levels, in the precision of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// File or glTF image it came from.
    pub name: String,
    /// Wrap along u and v.
    pub wrap: [Wrap; 2],
    /// Meaning of the texels.
    pub encoding: Encoding,
    /// From the image itself down to one texel, each half the size of the one before (rounded down, at least 1).
    pub levels: Arc<[Level]>,
}

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
        Self { name: name.into(), wrap, encoding, levels: bytes(size, texels, encoding, false) }
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
        Self { name: name.into(), wrap, encoding, levels: words(size, texels, encoding, false) }
    }

    /// The texture as the colour of a surface with holes: coarser levels hold the mean colour of what covers, each texel weighed
    /// by its alpha, and a transparent texel of any level has the colour of what covers near it. So no look-up beside a hole or
    /// from afar mixes in the colour that the file has in its holes, often black. Alpha stays as it is, and an image that is
    /// transparent all over has its mean everywhere. `None` where nothing is transparent.
    pub fn weighed_by_alpha(&self) -> Option<Self> {
        if self.lowest_alpha() >= 1.0 {
            return None;
        }
        let Level { width, height, texels } = self.levels.first()?;
        let levels = match texels {
            Texels::Bytes(texels) => bytes([*width, *height], texels.clone(), self.encoding, true),
            Texels::Words(texels) => words([*width, *height], texels.clone(), self.encoding, true),
        };
        Some(Self { name: self.name.clone(), levels, ..*self })
    }

    /// Lowest alpha of the image, 0..=1; coarser levels and what lies between texels never go below it.
    pub(crate) fn lowest_alpha(&self) -> f32 {
        match self.levels.first().map(|level| &level.texels) {
            Some(Texels::Bytes(t)) => t.iter().map(|t| t[3]).min().map_or(1.0, |a| f32::from(a) / 255.0),
            Some(Texels::Words(t)) => t.iter().map(|t| t[3]).min().map_or(1.0, |a| f32::from(a) / 65535.0),
            None => 1.0,
        }
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

/// The levels of an image of 8 bits a channel.
fn bytes(size: [usize; 2], texels: Vec<[u8; 4]>, encoding: Encoding, by_alpha: bool) -> Arc<[Level]> {
    let decode: [f32; 256] = std::array::from_fn(|i| decode(encoding, i as f32 / 255.0));
    let alpha: [f32; 256] = std::array::from_fn(|i| i as f32 / 255.0);
    let read =
        |t: &[u8; 4]| [decode[usize::from(t[0])], decode[usize::from(t[1])], decode[usize::from(t[2])], alpha[usize::from(t[3])]];
    let table = encoding_table::<255>(encoding, &BYTES);
    let write = |v: [f32; 4]| match table {
        // The cast is exact: the table ends at 255.
        Some(table) => {
            [table.encode(v[0]) as u8, table.encode(v[1]) as u8, table.encode(v[2]) as u8, quantise(v[3], 255.0) as u8]
        }
        None => pack(encoding, v).map(|v| quantise(v, 255.0) as u8),
    };
    pyramid(size, texels, read, write, by_alpha)
        .map(|(width, height, texels)| Level { width, height, texels: Texels::Bytes(texels) })
        .collect()
}

/// The levels of an image of 16 bits a channel.
fn words(size: [usize; 2], texels: Vec<[u16; 4]>, encoding: Encoding, by_alpha: bool) -> Arc<[Level]> {
    let unit = |v: u16| f32::from(v) / 65535.0;
    let decode: Vec<f32> = (0..=u16::MAX).map(|v| decode(encoding, unit(v))).collect();
    let read = |t: &[u16; 4]| {
        let [r, g, b] = [t[0], t[1], t[2]].map(|v| decode[usize::from(v)]);
        [r, g, b, unit(t[3])]
    };
    let table = encoding_table::<65535>(encoding, &WORDS);
    let write = |v: [f32; 4]| match table {
        Some(table) => [table.encode(v[0]), table.encode(v[1]), table.encode(v[2]), quantise(v[3], 65535.0)],
        None => pack(encoding, v).map(|v| quantise(v, 65535.0)),
    };
    pyramid(size, texels, read, write, by_alpha)
        .map(|(width, height, texels)| Level { width, height, texels: Texels::Words(texels) })
        .collect()
}

/// The value that a stored colour channel, 0..=1, stands for.
pub fn decode(encoding: Encoding, value: f32) -> f32 {
    match encoding {
        Encoding::Srgb => srgb_to_linear(value),
        Encoding::Linear => value,
        Encoding::Normal => 2.0 * value - 1.0,
    }
}

/// Inverse of [`decode`] for colour, alpha as it is.
fn pack(encoding: Encoding, [r, g, b, a]: [f32; 4]) -> [f32; 4] {
    let encode = |v: f32| match encoding {
        Encoding::Srgb => linear_to_srgb(v),
        Encoding::Linear => v,
        Encoding::Normal => 0.5 * v + 0.5,
    };
    [encode(r), encode(g), encode(b), a]
}

/// A number 0..=1 as a whole number up to `most`.
fn quantise(v: f32, most: f32) -> u16 {
    // Halves round up; in double precision the sum is exact. (`round` is a call on processors without an instruction for it.)
    (f64::from(v.clamp(0.0, 1.0) * most) + 0.5) as u16
}

/// The sRGB curve and rounding to `MOST` steps by comparison: a power for every channel took ten times as long.
struct EncodeTable<const MOST: usize> {
    /// Smallest linear value of each code above 0.
    from: Vec<f32>,
    /// Code of the least value of each bucket, `BUCKETS` of them over 0..=1.
    start: Vec<u16>,
}

static BYTES: OnceLock<EncodeTable<255>> = OnceLock::new();
static WORDS: OnceLock<EncodeTable<65535>> = OnceLock::new();

fn encoding_table<const MOST: usize>(
    encoding: Encoding,
    cell: &'static OnceLock<EncodeTable<MOST>>,
) -> Option<&'static EncodeTable<MOST>> {
    (encoding == Encoding::Srgb).then(|| cell.get_or_init(EncodeTable::new))
}

impl<const MOST: usize> EncodeTable<MOST> {
    /// Buckets are at most a few codes wide at the dark end, where codes lie closest (1 / (12.92 MOST) apart).
    const BUCKETS: usize = 16 * (MOST + 1);

    fn new() -> Self {
        let code = |v: f32| (linear_to_srgb(v).clamp(0.0, 1.0) * MOST as f32).round() as usize;
        let from: Vec<f32> = (1..=MOST)
            .map(|k| {
                // The inverse curve comes within a few floats of the step; the rest is found by stepping.
                let mut v = srgb_to_linear((k as f32 - 0.5) / MOST as f32);
                while code(v) >= k {
                    v = v.next_down();
                }
                while code(v) < k {
                    v = v.next_up();
                }
                v
            })
            .collect();
        let mut next = 0;
        let start = (0..=Self::BUCKETS)
            .map(|b| {
                let low = b as f32 / Self::BUCKETS as f32;
                while next < from.len() && from[next] <= low {
                    next += 1;
                }
                next as u16
            })
            .collect();
        Self { from, start }
    }

    /// Code of a linear value; below 0 and above 1 the nearest.
    fn encode(&self, v: f32) -> u16 {
        let v = v.clamp(0.0, 1.0);
        let mut code = usize::from(self.start[(v * Self::BUCKETS as f32) as usize]);
        while code < MOST && self.from[code] <= v {
            code += 1;
        }
        code as u16
    }
}

/// The 8-bit sRGB code of a linear value.
pub(crate) fn srgb_byte(v: f32) -> u8 {
    // The cast is exact: the table ends at 255.
    BYTES.get_or_init(EncodeTable::new).encode(v) as u8
}

/// All levels, the given one first; their colours as [`Texture::weighed_by_alpha`] says where that is asked for.
fn pyramid<C: Copy + Default + PartialEq + Send + Sync>(
    [width, height]: [usize; 2],
    texels: Vec<[C; 4]>,
    read: impl Fn(&[C; 4]) -> [f32; 4] + Sync,
    write: impl Fn([f32; 4]) -> [C; 4] + Sync,
    by_alpha: bool,
) -> impl Iterator<Item = (usize, usize, Vec<[C; 4]>)> {
    assert!(width > 0 && height > 0 && texels.len() == width * height, "{width} x {height} texels, not {}", texels.len());
    let mut levels = vec![(width, height, texels)];
    while let Some((w, h, texels)) = levels.last().filter(|(w, h, _)| *w > 1 || *h > 1) {
        let half = shrink((*w, *h), texels, &read, &write);
        levels.push(half);
    }
    if by_alpha {
        weigh(&mut levels, &read, &write);
    }
    levels.into_iter()
}

/// The colours of [`Texture::weighed_by_alpha`], in place of those of a plain mean.
fn weigh<C: Copy + Default + PartialEq + Send + Sync>(
    levels: &mut [(usize, usize, Vec<[C; 4]>)],
    read: &(impl Fn(&[C; 4]) -> [f32; 4] + Sync),
    write: &(impl Fn([f32; 4]) -> [C; 4] + Sync),
) {
    let recolor = |texel: &mut [C; 4], color: [C; 4]| texel[..3].copy_from_slice(&color[..3]);
    // Upwards go means of colour times alpha and of alpha, in full precision: where little covers, the alpha stored ends at 0.
    let mut sums: Vec<[f32; 4]> = vec![];
    for k in 1..levels.len() {
        let (width, height, texels) = &levels[k - 1];
        let size = (*width, *height);
        let covering = |texel: &[C; 4]| {
            let [r, g, b, a] = read(texel);
            [r * a, g * a, b * a, a]
        };
        (_, _, sums) = match k {
            1 => shrink(size, texels, &covering, &|sum| sum),
            _ => shrink(size, &sums, &|sum| *sum, &|sum| sum),
        };
        levels[k].2.par_iter_mut().zip(&sums).for_each(|(texel, &[r, g, b, a])| {
            if a > 0.0 {
                recolor(texel, write([r / a, g / a, b / a, a]));
            }
        });
    }
    // Downwards go the colours of transparent texels: that of the coarser texel about them, which by then has one.
    for k in (1..levels.len()).rev() {
        let (finer, coarser) = levels.split_at_mut(k);
        let ((width, _, texels), (w, h, colors)) = (&mut finer[k - 1], &coarser[0]);
        texels.par_chunks_mut(*width).enumerate().for_each(|(y, row)| {
            for (x, texel) in row.iter_mut().enumerate().filter(|(_, texel)| texel[3] == C::default()) {
                recolor(texel, colors[(y / 2).min(h - 1) * w + (x / 2).min(w - 1)]);
            }
        });
    }
}

/// Half of a level: every texel is the mean over exactly the area it covers, odd sizes included.
fn shrink<T: Sync, U: Copy + Send>(
    (width, height): (usize, usize),
    texels: &[T],
    read: &(impl Fn(&T) -> [f32; 4] + Sync),
    write: &(impl Fn([f32; 4]) -> U + Sync),
) -> (usize, usize, Vec<U>) {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let even = width == 2 * w && height == 2 * h;
    let columns: Vec<_> = (0..w).map(|x| covered(x, width, w)).collect();
    let mut result = vec![write([0.0; 4]); w * h];
    let row = |y: usize, row: &mut [U]| {
        if even {
            let (above, below) = texels[2 * y * width..(2 * y + 2) * width].split_at(width);
            for ((texel, a), b) in row.iter_mut().zip(above.chunks_exact(2)).zip(below.chunks_exact(2)) {
                let values = [read(&a[0]), read(&a[1]), read(&b[0]), read(&b[1])];
                *texel = write(std::array::from_fn(|c| values.iter().map(|v| 0.25 * v[c]).sum()));
            }
            return;
        }
        let rows = covered(y, height, h);
        for (texel, taps) in row.iter_mut().zip(&columns) {
            let mut sum = [0.0f32; 4];
            for &(row, wy) in rows.iter().filter(|(_, weight)| *weight > 0.0) {
                for &(column, wx) in taps.iter().filter(|(_, weight)| *weight > 0.0) {
                    let value = read(&texels[row * width + column]);
                    (0..4).for_each(|c| sum[c] += wy * wx * value[c]);
                }
            }
            *texel = write(sum);
        }
    };
    result.par_chunks_mut(w).with_min_len((1 << 14) / w + 1).enumerate().for_each(|(y, texels)| row(y, texels));
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

    /// Every code's threshold and its neighbours, and random values: the table is the formula.
    #[test]
    fn the_encoding_table_is_the_curve() {
        fn compare<const MOST: usize>() {
            let table = EncodeTable::<MOST>::new();
            let near = table.from.iter().flat_map(|&v| [v.next_down(), v, v.next_up()]);
            let random = (0..200_000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32);
            for v in near.chain(random).chain([0.0, -1.0, 1.0, 2.0, 1e-9, 0.003_130_8]) {
                let expected = (linear_to_srgb(v).clamp(0.0, 1.0) * MOST as f32).round() as u16;
                assert_eq!(table.encode(v), expected, "{v} of {MOST}");
            }
        }
        compare::<255>();
        compare::<65535>();
    }

    #[test]
    fn even_and_odd_sizes_are_filtered_alike() {
        // A column beside a picture of even size makes it odd, and its mean must stay what its texels are.
        let picture = |x: usize, y: usize| [(x * 31 + y * 17) as u8, (x * y) as u8, 200, 255 - x as u8];
        let [w, h] = [16, 8];
        let texels: Vec<[u8; 4]> = (0..w * h).map(|i| picture(i % w, i / w)).collect();
        let texture = Texture::from_rgba8("t", [w, h], texels.clone(), Encoding::Srgb, Default::default());
        let Texels::Bytes(half) = &texture.levels[1].texels else { panic!("bytes") };
        for (i, found) in half.iter().enumerate() {
            let at = |dx: usize, dy: usize| texels[(2 * (i / 8) + dy) * w + 2 * (i % 8) + dx];
            let taps = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)].map(|t| t.map(|v| f64::from(v) / 255.0));
            for c in 0..4 {
                let curve = |v: f64| if c == 3 { v } else { f64::from(srgb_to_linear(v as f32)) };
                let mean = taps.iter().map(|t| 0.25 * curve(t[c])).sum::<f64>() as f32;
                let expected = 255.0 * if c == 3 { mean } else { linear_to_srgb(mean) };
                assert!((f32::from(found[c]) - expected).abs() <= 0.501, "{i}, {c}: {found:?} but {expected}");
            }
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

    /// Colours and alphas of all levels.
    fn texels(texture: &Texture) -> Vec<Vec<[u8; 4]>> {
        let texels = |level: &Level| match &level.texels {
            Texels::Bytes(texels) => texels.clone(),
            Texels::Words(texels) => texels.iter().map(|texel| texel.map(|v| (v >> 8) as u8)).collect(),
        };
        texture.levels.iter().map(texels).collect()
    }

    fn alphas(texture: &Texture) -> Vec<Vec<u8>> {
        texels(texture).iter().map(|level| level.iter().map(|texel| texel[3]).collect()).collect()
    }

    /// One colour on holes of any other is that colour in every texel of every level, also where so little covers that the alpha
    /// stored is 0, and alpha is what it is without weights.
    #[test]
    fn the_colour_of_holes_is_nowhere() {
        let patterns: [fn(usize, usize) -> bool; 2] = [|x, y| (x, y) == (5, 2), |x, y| (x / 2 + y / 2).is_multiple_of(2)];
        for size in [[64, 64], [48, 20], [37, 61], [1, 7], [6, 3]] {
            for (covers, encoding) in patterns.into_iter().zip([Encoding::Srgb, Encoding::Linear]) {
                let at = |i: usize| covers(i % size[0], i / size[0]);
                let bytes = (0..size[0] * size[1]).map(|i| if at(i) { [200, 90, 255, 255] } else { [0, 30, 7, 0] });
                let bytes: Vec<[u8; 4]> = bytes.collect();
                let words = bytes.iter().map(|texel| texel.map(|v| u16::from(v) * 257)).collect();
                let of_words = Texture::from_rgba16("t", size, words, encoding, Default::default());
                for plain in [Texture::from_rgba8("t", size, bytes.clone(), encoding, Default::default()), of_words] {
                    let weighed = plain.weighed_by_alpha().expect("there are holes");
                    let covered = bytes.iter().any(|texel| texel[3] > 0);
                    let right = |texel: &[u8; 4]| texel[..3].iter().zip([200, 90, 255]).all(|(a, b)| a.abs_diff(b) <= 1);
                    assert!(!covered || texels(&weighed).iter().flatten().all(right), "{size:?} {encoding:?}");
                    assert_eq!(alphas(&weighed), alphas(&plain));
                }
            }
        }
    }

    #[test]
    fn colours_are_weighed_by_how_much_covers() {
        let linear = |texels: &[[u8; 4]]| {
            Texture::from_rgba8("t", [texels.len(), 1], texels.to_vec(), Encoding::Linear, Default::default())
        };
        let pair = linear(&[[255, 0, 100, 255], [0, 255, 100, 85]]).weighed_by_alpha().expect("a half covers");
        // Three parts of the first, one of the second; what covers at all keeps its colour.
        assert_eq!(texels(&pair), [vec![[255, 0, 100, 255], [0, 255, 100, 85]], vec![[191, 64, 100, 170]]]);
        let uneven = linear(&[[200, 0, 0, 255], [9, 9, 9, 0], [0, 0, 200, 255]]).weighed_by_alpha().expect("a hole");
        assert_eq!(texels(&uneven), [vec![[200, 0, 0, 255], [100, 0, 100, 0], [0, 0, 200, 255]], vec![[100, 0, 100, 170]]]);
        // The colour of a transparent texel is that of the nearest block that something covers.
        let row = linear(&[[10, 0, 0, 255], [0; 4], [0; 4], [0; 4], [30, 0, 0, 255], [0; 4], [0; 4], [0; 4]]);
        let row = row.weighed_by_alpha().expect("holes");
        assert_eq!(grey(&row.levels[0]), [10, 10, 10, 10, 30, 30, 30, 30]);
        assert_eq!(grey(&row.levels[3]), [20]);
        // Where nothing covers, nothing is known but the plain mean; where all does, there is nothing to do.
        let nothing = linear(&[[10, 0, 0, 0], [30, 0, 0, 0]]).weighed_by_alpha().expect("holes");
        assert_eq!(texels(&nothing)[1], [[20, 0, 0, 0]]);
        assert_eq!(linear(&[[10, 0, 0, 255], [30, 0, 0, 255]]).weighed_by_alpha(), None);
    }
}
