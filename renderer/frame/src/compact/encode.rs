//! Encodes frames as compact files.

use super::decode::octahedral;
use super::header::{self, Block, Encoding, Header, kept, layer_name};
use super::planes::split;
use super::{DEPTH_ERROR, Keep, SIGNATURE, VERSION};
use crate::channel::{self, Access, Field, LAYERS, Layer};
use crate::color::linear_to_srgb;
use crate::exr::{HALF_MAX, check_values, sized};
use crate::file::write_atomic;
use crate::image::Image;
use crate::{Error, Frame, Result};
use glam::DVec3;
use half::f16;
use std::path::Path;
use zstd::zstd_safe::CParameter;

/// Level of zstd. On rendered frames of 512 x 512 (88 ms): 3 is 8 % larger (18 ms), 6 is 1 % larger (50 ms), 19 is 11 % smaller
/// (1.8 s).
const LEVEL: i32 = 9;

/// Largest code of a coordinate on the octahedron.
pub(super) const OCTAHEDRAL_MOST: u16 = 4095;

/// What a compact file loses of its frame, beyond the precision that its header states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// Values beyond 65504 in half layers, or outside 0..=1 in 8-bit layers, which were clamped.
    pub clamped: usize,
    /// Largest relative error of depth; 0 where depth is stored as `float`.
    pub depth: f32,
}

/// Writes the training layers of a frame.
///
/// # Errors
/// As [`encode`], and when the file cannot be written (nothing is left behind).
pub fn write(path: &Path, frame: &Frame) -> Result<Loss> {
    let (bytes, loss) = encode(path, frame)?;
    write_atomic(path, &bytes)?;
    Ok(loss)
}

/// The training layers of a frame as a compact file; errors give `name` as the path. The same frame always gives the same bytes.
///
/// # Errors
/// When a channel holds NaN, or an infinity that is not the depth of a miss, or when a picture does not have the frame's size.
pub fn encode(name: &Path, frame: &Frame) -> Result<(Vec<u8>, Loss)> {
    encode_with(name, frame, Keep::Training)
}

/// [`encode`] with the layers that `keep` selects.
///
/// # Errors
/// As [`encode`].
pub fn encode_with(name: &Path, frame: &Frame, keep: Keep) -> Result<(Vec<u8>, Loss)> {
    file(frame, keep).map_err(|reason| Error::malformed(name, reason))
}

fn file(frame: &Frame, keep: Keep) -> std::result::Result<(Vec<u8>, Loss), String> {
    if frame.width == 0 || frame.height == 0 {
        return Err(format!("a frame of {} x {} pixels has nothing to write", frame.width, frame.height));
    }
    frame.info.check()?;
    let mut compressor = zstd::bulk::Compressor::new(LEVEL).map_err(|e| e.to_string())?;
    compressor.set_parameter(CParameter::ChecksumFlag(true)).map_err(|e| e.to_string())?;
    let mut compress = |raw: &[u8]| compressor.compress(raw).map_err(|e| e.to_string());
    let (mut loss, mut blocks, mut layers, mut left_out) = (Loss::default(), Vec::new(), Vec::new(), Vec::new());
    for layer in LAYERS {
        let Some(numbers) = numbers(frame, layer, &mut loss)? else { continue };
        if !kept(layer, keep) {
            left_out.push(layer_name(layer).to_owned());
            continue;
        }
        // Constant materials are smaller unchanged; values that change smoothly are smaller as differences.
        let plain = compress(&numbers.samples.planes(frame.width, false))?;
        let delta = compress(&numbers.samples.planes(frame.width, true))?;
        let smaller = if delta.len() < plain.len() { &delta } else { &plain };
        layers.push(Block {
            name: layer_name(layer).to_owned(),
            components: layer.components.iter().map(|&c| c.to_owned()).collect(),
            encoding: numbers.encoding,
            delta: delta.len() < plain.len(),
            offset: blocks.len(),
            bytes: smaller.len(),
            precision: numbers.precision(),
            lowest: numbers.depth.map(|(lowest, _)| lowest),
            step: numbers.depth.map(|(_, step)| step),
        });
        blocks.extend_from_slice(smaller);
    }
    let header = Header {
        width: frame.width,
        height: frame.height,
        info: frame.info.clone(),
        layers,
        left_out,
        conventions: channel::conventions(),
    };
    let json = serde_json::to_vec(&header).map_err(|e| e.to_string())?;
    let stored = compress(&json)?;
    let mut bytes = Vec::with_capacity(super::START + stored.len() + blocks.len());
    bytes.extend_from_slice(&SIGNATURE);
    let word = |length: usize| u32::try_from(length).map_err(|_| format!("a header of {length} bytes"));
    for word in [VERSION, word(stored.len())?, word(json.len())?] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    bytes.extend_from_slice(&stored);
    bytes.extend_from_slice(&blocks);
    let padding = header::padding(frame.width, frame.height, &header.layers, bytes.len());
    bytes.resize(bytes.len() + padding, 0);
    Ok((bytes, loss))
}

/// One vector for each sample.
enum Samples {
    Bytes(Vec<Vec<u8>>),
    Words(Vec<Vec<u16>>),
    Longs(Vec<Vec<u32>>),
}

impl Samples {
    fn planes(&self, width: usize, delta: bool) -> Vec<u8> {
        match self {
            Self::Bytes(samples) => split(samples, width, delta),
            Self::Words(samples) => split(samples, width, delta),
            Self::Longs(samples) => split(samples, width, delta),
        }
    }
}

/// A layer as numbers.
struct Numbers {
    encoding: Encoding,
    samples: Samples,
    /// Bits of the smallest depth, and from one depth to the next.
    depth: Option<(u32, u32)>,
}

impl Numbers {
    fn precision(&self) -> String {
        match (self.encoding, self.depth) {
            (Encoding::Half, _) => "half float: 2^-11 relative".into(),
            (Encoding::Unit8, _) => "n / 255: 1/510".into(),
            (Encoding::Srgb8, _) => "sRGB curve of n / 255: 1/510 after the curve".into(),
            (Encoding::Octahedral12, _) => "0.04 degrees".into(),
            (Encoding::Depth16, Some((_, step))) => format!("{:e} relative", depth_error(step)),
            _ => "exact".into(),
        }
    }
}

/// The numbers of one layer; `None` when the frame lacks it.
fn numbers(frame: &Frame, layer: &Layer, loss: &mut Loss) -> std::result::Result<Option<Numbers>, String> {
    let encoding = Encoding::of(layer);
    Ok(match &layer.field {
        Field::Id(access) => match (access.get)(frame) {
            Some(ids) => Some(smallest(&sized(frame, layer, ids)?.pixels)),
            None => None,
        },
        Field::Rgb(access) => match components(frame, layer, access, |p| p)? {
            Some([x, y, z]) if encoding == Encoding::Octahedral12 => {
                let mut samples = vec![Vec::with_capacity(x.len()), Vec::with_capacity(x.len())];
                for ((x, y), z) in x.iter().zip(&y).zip(&z) {
                    let code = nearest(DVec3::new(f64::from(*x), f64::from(*y), f64::from(*z)));
                    samples.iter_mut().zip(code).for_each(|(sample, n)| sample.push(n));
                }
                Some(Numbers { encoding, samples: Samples::Words(samples), depth: None })
            }
            found => found.map(|c| floats(encoding, &c, loss)),
        },
        Field::Vec2(access) => components(frame, layer, access, |p| p)?.map(|c| floats(encoding, &c, loss)),
        Field::Scalar(access) => components(frame, layer, access, |p| [p])?
            .map(|c| if encoding == Encoding::Depth16 { depths(&c[0], loss) } else { floats(encoding, &c, loss) }),
    })
}

/// The components of a picture, checked.
fn components<P: Copy, const C: usize>(
    frame: &Frame,
    layer: &Layer,
    access: &Access<Image<P>>,
    of: impl Fn(P) -> [f32; C],
) -> std::result::Result<Option<[Vec<f32>; C]>, String> {
    let Some(image) = (access.get)(frame) else { return Ok(None) };
    let image = sized(frame, layer, image)?;
    let components: [Vec<f32>; C] = std::array::from_fn(|c| image.pixels.iter().map(|&pixel| of(pixel)[c]).collect());
    for (name, values) in layer.channel_names().zip(&components) {
        check_values(&name, layer, frame.width, values)?;
    }
    Ok(Some(components))
}

/// Values whose components are coded one by one.
fn floats(encoding: Encoding, components: &[Vec<f32>], loss: &mut Loss) -> Numbers {
    let mut clamp = |v: f32, lowest: f32, highest: f32| {
        loss.clamped += usize::from(!(lowest..=highest).contains(&v));
        v.clamp(lowest, highest)
    };
    let samples = match encoding {
        Encoding::Half => {
            let mut half = |&v: &f32| f16::from_f32(clamp(v, -HALF_MAX, HALF_MAX)).to_bits();
            Samples::Words(components.iter().map(|c| c.iter().map(&mut half).collect()).collect())
        }
        Encoding::Unit8 => {
            let mut unit = |&v: &f32| (255.0 * clamp(v, 0.0, 1.0)).round() as u8;
            Samples::Bytes(components.iter().map(|c| c.iter().map(&mut unit).collect()).collect())
        }
        Encoding::Srgb8 => {
            let mut srgb = |&v: &f32| (255.0 * linear_to_srgb(clamp(v, 0.0, 1.0))).round() as u8;
            Samples::Bytes(components.iter().map(|c| c.iter().map(&mut srgb).collect()).collect())
        }
        _ => Samples::Longs(components.iter().map(|c| c.iter().map(|v| v.to_bits()).collect()).collect()),
    };
    Numbers { encoding, samples, depth: None }
}

/// Unsigned integers in the fewest bytes that hold the largest.
fn smallest(ids: &[u32]) -> Numbers {
    let highest = ids.iter().copied().max().unwrap_or(0);
    let (encoding, samples) = if highest <= u32::from(u8::MAX) {
        (Encoding::U8, Samples::Bytes(vec![ids.iter().map(|&id| id as u8).collect()]))
    } else if highest <= u32::from(u16::MAX) {
        (Encoding::U16, Samples::Words(vec![ids.iter().map(|&id| id as u16).collect()]))
    } else {
        (Encoding::U32, Samples::Longs(vec![ids.to_vec()]))
    };
    Numbers { encoding, samples, depth: None }
}

/// Relative error of depths `step` bits apart: half of it, in the last place of a float's 23-bit fraction.
fn depth_error(step: u32) -> f32 {
    if step == 1 { 0.0 } else { 0.5 * step as f32 / (1 << 23) as f32 }
}

/// Depths in 16 bits where that is precise enough, and as `float` elsewhere.
fn depths(values: &[f32], loss: &mut Loss) -> Numbers {
    let hits = || values.iter().copied().filter(|v| v.is_finite());
    let nearest = hits().fold(f32::INFINITY, f32::min);
    let farthest = hits().fold(nearest, f32::max);
    // Bits of positive floats sort like the floats. Without any hit every code is 0, and any depth such as 1 m serves.
    let [lowest, highest] = if nearest.is_finite() { [nearest.to_bits(), farthest.to_bits()] } else { [1f32.to_bits(); 2] };
    let step = if nearest > 0.0 { (highest - lowest).div_ceil(65534).max(1) } else { u32::MAX };
    let fits = u64::from(lowest) + 65534 * u64::from(step) <= u64::from(f32::MAX.to_bits());
    if nearest <= 0.0 || depth_error(step) > DEPTH_ERROR || !fits {
        return floats(Encoding::Float, &[values.to_vec()], loss);
    }
    loss.depth = depth_error(step);
    let code = |v: &f32| if v.is_finite() { 1 + ((v.to_bits() - lowest + step / 2) / step) as u16 } else { 0 };
    let samples = Samples::Words(vec![values.iter().map(code).collect()]);
    Numbers { encoding: Encoding::Depth16, samples, depth: Some((lowest, step)) }
}

/// The code whose vector is nearest to the direction of `n`; 0, 0 for a zero vector.
fn nearest(n: DVec3) -> [u16; 2] {
    let sum = n.x.abs() + n.y.abs() + n.z.abs();
    if sum == 0.0 {
        return [0, 0];
    }
    let (mut u, mut v) = (n.x / sum, n.y / sum);
    if n.z < 0.0 {
        (u, v) = ((1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v));
    }
    // The best of the four nearest codes. Rounding each component by itself is up to 1.5 times as far off.
    let around = |c: f64| [0.0, 1.0].map(|up| ((2047.0 * c).floor() + up + 2048.0).clamp(1.0, f64::from(OCTAHEDRAL_MOST)) as u16);
    // By distance: single-precision lengths are off by as much as cosines of such angles differ.
    let unit = n.normalize_or_zero();
    let mut best = ([2048, 2048], f64::INFINITY);
    for x in around(u) {
        for y in around(v) {
            let distance = unit.distance_squared(DVec3::from_array(octahedral(x, y).map(f64::from)));
            if distance < best.1 {
                best = ([x, y], distance);
            }
        }
    }
    best.0
}
