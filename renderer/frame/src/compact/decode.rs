//! Decodes compact files into frames. Decoding uses one thread, since loaders read many files at once.

use super::header::{self, Block, Checked, Encoding, layer_name};
use super::planes::{Number, Rows};
use crate::channel::{Field, LAYERS};
use crate::color::srgb_to_linear;
use crate::image::Image;
use crate::{Error, Frame, FrameInfo, Result};
use half::f16;
use half::slice::{HalfBitsSliceExt, HalfFloatSliceExt};
use std::path::Path;
use std::sync::LazyLock;

/// Reads a compact frame file.
///
/// # Errors
/// When the file cannot be read, or as [`decode`].
pub fn read(path: &Path) -> Result<Frame> {
    decode(path, &crate::file::read(path)?)
}

/// [`read`] from memory; errors give `name` as the path.
///
/// # Errors
/// When the bytes are cut short, are damaged, hold NaN or are not a compact frame. The message names the file and the layer.
pub fn decode(name: &Path, bytes: &[u8]) -> Result<Frame> {
    frame(bytes, |_| true).map_err(|reason| Error::malformed(name, reason))
}

/// As [`decode`], but only the layers called `names` ([`layer_name`](super::layer_name)) are decompressed; the others are absent,
/// and those that every [`Frame`] has are pictures of 0 x 0 pixels. Layers that the file lacks are absent too.
///
/// # Errors
/// As [`decode`], and when there is no layer with one of the names.
pub fn decode_layers(name: &Path, bytes: &[u8], names: &[&str]) -> Result<Frame> {
    if let Some(unknown) = names.iter().find(|n| header::layer_named(n).is_none()) {
        let known: Vec<_> = LAYERS.iter().map(layer_name).collect();
        return Err(Error::malformed(name, format!("no layer is called {unknown:?}; there are {}", known.join(", "))));
    }
    frame(bytes, |layer| names.contains(&layer)).map_err(|reason| Error::malformed(name, reason))
}

/// The values of the header; no layer is decompressed. Errors give `name` as the path.
///
/// # Errors
/// When the bytes are not a compact frame, or the header is damaged or does not fit their length.
pub fn info(name: &Path, bytes: &[u8]) -> Result<FrameInfo> {
    frame(bytes, |_| false).map(|frame| frame.info).map_err(|reason| Error::malformed(name, reason))
}

fn frame(bytes: &[u8], wanted: impl Fn(&str) -> bool) -> std::result::Result<Frame, String> {
    let (header, blocks) = header::parse(bytes)?;
    let checked = header::check(&header, blocks, bytes.len())?;
    let mut frame = Frame { width: header.width, height: header.height, ..Frame::default() };
    let mut buffer = Vec::new();
    for layer in checked.iter().filter(|c| wanted(&c.block.name)) {
        buffer.resize(layer.raw.max(buffer.len()), 0);
        let raw = &mut buffer[..layer.raw];
        header::decompress(layer.bytes, raw).and_then(|()| fill(&mut frame, layer, raw)).map_err(|reason| {
            format!("layer {} (bytes {}..{} after the header): {reason}", layer.block.name, layer.block.offset, {
                layer.block.offset + layer.block.bytes
            })
        })?;
    }
    frame.info = header.info;
    Ok(frame)
}

/// Puts one layer into the frame.
fn fill(frame: &mut Frame, layer: &Checked, raw: &[u8]) -> std::result::Result<(), String> {
    let (width, height) = (frame.width, frame.height);
    let (block, picture) = (layer.block, Picture { raw, width, height, delta: layer.block.delta });
    match &layer.layer.field {
        Field::Id(access) => {
            let pixels = match block.encoding {
                Encoding::U8 => picture.ids::<u8>(),
                Encoding::U16 => picture.ids::<u16>(),
                _ => picture.ids::<u32>(),
            };
            (access.set)(frame, Image { width, height, pixels });
        }
        Field::Rgb(access) if block.encoding == Encoding::Octahedral12 => {
            (access.set)(frame, Image { width, height, pixels: picture.normals()? });
        }
        Field::Rgb(access) => (access.set)(frame, Image { width, height, pixels: picture.floats(block, false)? }),
        Field::Vec2(access) => (access.set)(frame, Image { width, height, pixels: picture.floats(block, false)? }),
        Field::Scalar(access) => {
            let miss = layer.layer.is_infinite_at_miss();
            let pixels = if block.encoding == Encoding::Depth16 { picture.depth(block)? } else { picture.floats(block, miss)? };
            (access.set)(frame, Image { width, height, pixels: pixels.into_flattened() });
        }
    }
    Ok(())
}

/// One decompressed block.
struct Picture<'a> {
    raw: &'a [u8],
    width: usize,
    height: usize,
    delta: bool,
}

impl Picture<'_> {
    fn rows<N: Number>(&self, sample: usize) -> Rows<'_, N> {
        Rows::new(self.raw, sample, self.width, self.height, self.delta)
    }

    fn ids<N: Number + Into<u32>>(&self) -> Vec<u32> {
        let mut rows = self.rows::<N>(0);
        let mut pixels = Vec::with_capacity(self.width * self.height);
        (0..self.height).for_each(|_| pixels.extend(rows.next().iter().map(|&n| n.into())));
        pixels
    }

    /// `C` samples per pixel, each turned into a float independently.
    fn floats<const C: usize>(&self, block: &Block, infinity: bool) -> std::result::Result<Vec<[f32; C]>, String> {
        match block.encoding {
            Encoding::Half => self.convert(|row: &[u16], floats| {
                let magnitude = row.iter().fold(0, |most, bits| most.max(bits & 0x7fff));
                row.reinterpret_cast::<f16>().convert_to_f32_slice(floats);
                magnitude < 0x7c00
            }),
            Encoding::Srgb8 => self.convert(|row: &[u8], floats| {
                for (float, &n) in floats.iter_mut().zip(row) {
                    *float = SRGB[n as usize];
                }
                true
            }),
            Encoding::Unit8 => self.convert(|row: &[u8], floats| {
                for (float, &n) in floats.iter_mut().zip(row) {
                    *float = f32::from(n) / 255.0;
                }
                true
            }),
            _ => self.convert(|row: &[u32], floats| {
                let mut valid = true;
                for (float, &bits) in floats.iter_mut().zip(row) {
                    *float = f32::from_bits(bits);
                    valid &= float.is_finite() || (infinity && *float == f32::INFINITY);
                }
                valid
            }),
        }
    }

    /// One sample per pixel: depths, +inf where the code is 0.
    fn depth(&self, block: &Block) -> std::result::Result<Vec<[f32; 1]>, String> {
        let (lowest, step) = (block.lowest.unwrap_or(0), block.step.unwrap_or(0));
        let highest = u64::from(lowest) + 65534 * u64::from(step);
        if lowest == 0 || step == 0 || highest > u64::from(f32::MAX.to_bits()) {
            return Err(format!("lowest {lowest} and step {step} are no depths"));
        }
        self.convert(|row: &[u16], floats| {
            for (float, &n) in floats.iter_mut().zip(row) {
                // Wraps only at a miss, whose bits are not used.
                let bits = lowest.wrapping_add(u32::from(n).wrapping_sub(1).wrapping_mul(step));
                *float = f32::from_bits(if n == 0 { f32::INFINITY.to_bits() } else { bits });
            }
            true
        })
    }

    /// `C` samples per pixel; `f` turns a row of one sample into floats and returns whether all of them may be in a frame.
    fn convert<N: Number, const C: usize>(
        &self,
        f: impl Fn(&[N], &mut [f32]) -> bool,
    ) -> std::result::Result<Vec<[f32; C]>, String> {
        let mut rows: [Rows<N>; C] = std::array::from_fn(|sample| self.rows(sample));
        let mut floats: [Vec<f32>; C] = std::array::from_fn(|_| vec![0.0; self.width]);
        let mut pixels = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            for (rows, floats) in rows.iter_mut().zip(&mut floats) {
                if !f(rows.next(), floats) {
                    return Err(format!("a value in row {y} is NaN or infinite"));
                }
            }
            // Slices of one known length let the interleaving run without bounds checks.
            let floats = floats.each_ref().map(|row| &row[..self.width]);
            pixels.extend((0..self.width).map(|x| floats.map(|row| row[x])));
        }
        Ok(pixels)
    }

    /// Two samples per pixel: unit vectors, zero where both codes are 0.
    fn normals(&self) -> std::result::Result<Vec<[f32; 3]>, String> {
        let (mut xs, mut ys) = (self.rows::<u16>(0), self.rows::<u16>(1));
        let mut pixels = Vec::with_capacity(self.width * self.height);
        for row in 0..self.height {
            let (xs, ys) = (xs.next(), ys.next());
            let highest = xs.iter().chain(ys).fold(0, |most, &n| most.max(n));
            if highest > super::encode::OCTAHEDRAL_MOST {
                return Err(format!("a code of a normal in row {row} is {highest}"));
            }
            pixels.extend(xs.iter().zip(ys).map(|(&x, &y)| octahedral(x, y)));
        }
        Ok(pixels)
    }
}

/// The unit vector of a code, by Meyer et al. 2010, "On floating-point normal vectors"; zero for the code 0, 0.
pub(super) fn octahedral(x: u16, y: u16) -> [f32; 3] {
    let [u, v] = [x, y].map(|n| (f32::from(n) - 2048.0) / 2047.0);
    let z = 1.0 - u.abs() - v.abs();
    // Below the equator the corners are folded over.
    let fold = (-z).max(0.0);
    let (u, v) = (u - fold.copysign(u), v - fold.copysign(v));
    let scale = if x | y == 0 { 0.0 } else { 1.0 / (u * u + v * v + z * z).sqrt() };
    [u * scale, v * scale, z * scale]
}

/// Linear values of the 256 codes of the sRGB curve.
static SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| std::array::from_fn(|n| srgb_to_linear(n as f32 / 255.0)));
