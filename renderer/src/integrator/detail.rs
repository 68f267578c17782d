//! Samples for pictures that are denoised: more where the G-buffer shows detail.
//!
//! A denoiser errs where neighbouring pixels do not tell the same: where normals and materials change from pixel to pixel, and it
//! errs by more where surfaces are bright or shiny. All of this is in the G-buffer, so the numbers of samples are known before
//! the first one is traced. They do not depend on samples, so means stay without bias, and all pixels of a block of 4 x 4 have
//! the same number, so they can share their points ([`crate::sampler::Sharing`]).
//!
//! The predicted error of a block is a product of powers, fitted to what OIDN makes of 2 to 16 samples
//! (docs/measurements/renderer-notes.md, detail). It is relative: only its differences within a picture count. Kuznetsov,
//! Kalantari and Ramamoorthi, Deep Adaptive Sampling for Low Sample Count Rendering (2018), predict such a map by a network from
//! first samples.

use super::adaptive::MOST;
use crate::error::{Error, Result};
use crate::number::log2;
use crate::sampler::block::SIDE;
use crate::sampler::hash;
use crate::settings::detail_range;
use rayon::prelude::*;
use renderflow_frame::color::luminance;
use renderflow_frame::{Frame, Image};
use std::f32::consts::LOG2_E;

/// Width and height of a block, in pixels.
const BLOCK: usize = SIDE as usize;
/// Exponents of the squared error of a denoised block, and what is added to their bases: the change of normals from pixel to
/// pixel in the block, the same around it, and the change of albedo, roughness and metallic around it.
const NORMALS_HERE: f32 = 0.196;
const NORMALS_AROUND: f32 = 0.444;
const MATERIAL_AROUND: f32 = 0.418;
const BASE: f32 = 0.01;
/// Logarithms of the factors that the luminance of the albedo around, and the shininess of the block, from 0 to 1, add to it.
const LUMINANCE: f32 = 1.328;
const SHINE: f32 = 0.785;
/// Counts are in proportion to this power of the predicted squared error: the root leaves least of it, if it falls with the
/// number of samples.
const POWER: f32 = 0.5;
/// Weights of the blocks on a line around a block: a Gaussian with a deviation of one block.
const AROUND: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
/// Tells blocks of the same wish apart.
const STREAM: u64 = 0x4445_5441;

/// Samples for each pixel of a picture that will be denoised, `spp` of them on average where surfaces are seen: more where the
/// G-buffer shows detail. Counts are powers of two: the largest one up to `spp`, half of it, twice or four times it. All pixels
/// of a block of 4 x 4 have the same. `gbuffer` holds albedo, normal, depth and material at pixel centres; guides are not read.
/// [`crate::render_mapped`] renders with it under [`crate::Budget::Detail`].
///
/// # Errors
/// When `gbuffer` has none of these channels.
pub fn detail_map(gbuffer: &Frame, spp: u32) -> Result<Image<u32>> {
    let (width, height) = (gbuffer.width, gbuffer.height);
    let sizes =
        [gbuffer.albedo.pixels.len(), gbuffer.normal.pixels.len(), gbuffer.depth.pixels.len(), gbuffer.material.pixels.len()];
    if sizes != [width * height; 4] {
        return Err(Error::SampleMap("the G-buffer that it follows has no surfaces".into()));
    }
    let blocks = Blocks { columns: width.div_ceil(BLOCK), rows: height.div_ceil(BLOCK) };
    let seen: Vec<Seen> = (0..blocks.count()).into_par_iter().map(|at| Seen::of(gbuffer, blocks.place(at))).collect();
    let wishes: Vec<f32> = blocks.wishes(&seen);
    let counts = spread(&wishes, &seen, spp);
    let pixel = |at: usize| counts[at / width / BLOCK * blocks.columns + at % width / BLOCK];
    Ok(Image { width, height, pixels: (0..width * height).map(pixel).collect() })
}

/// Whether all pixels of each block have the same number in a map of this width. Others cannot share their points.
pub(super) fn is_even(map: &[u32], width: usize) -> bool {
    let first = |at: usize| at / width / BLOCK * BLOCK * width + at % width / BLOCK * BLOCK;
    map.iter().enumerate().all(|(at, &count)| count == map[first(at)])
}

/// The blocks of a picture.
#[derive(Clone, Copy)]
struct Blocks {
    columns: usize,
    rows: usize,
}

impl Blocks {
    fn count(self) -> usize {
        self.columns * self.rows
    }

    /// Column and row of a block.
    fn place(self, at: usize) -> (usize, usize) {
        (at % self.columns, at / self.columns)
    }

    /// Means over the blocks around each block; at the border of the picture, the last ones count for those beyond.
    fn around(self, values: &[f32]) -> Vec<f32> {
        let line = |values: &[f32], first: usize, step: usize, place: usize, count: usize| {
            let at = |k: usize| (place + k).saturating_sub(2).min(count - 1);
            AROUND.iter().enumerate().map(|(k, weight)| weight * values[first + step * at(k)]).sum::<f32>()
        };
        let across = |at: usize| line(values, at / self.columns * self.columns, 1, at % self.columns, self.columns);
        let rows: Vec<f32> = (0..values.len()).map(across).collect();
        (0..values.len()).map(|at| line(&rows, at % self.columns, self.columns, at / self.columns, self.rows)).collect()
    }

    /// Binary logarithm of the number of samples that each block should have, up to a number that is the same for all.
    fn wishes(self, seen: &[Seen]) -> Vec<f32> {
        let around = |value: fn(&Seen) -> f32| self.around(&seen.iter().map(value).collect::<Vec<f32>>());
        let (normals, materials) = (around(|seen| seen.normals), around(|seen| seen.materials));
        let luminances = around(|seen| seen.luminance);
        let wish = |at: usize| {
            let power = |base: f32, exponent: f32| exponent * log2(base + BASE);
            let changes = power(seen[at].normals, NORMALS_HERE)
                + power(normals[at], NORMALS_AROUND)
                + power(materials[at], MATERIAL_AROUND);
            let wish = POWER * (changes + LOG2_E * (LUMINANCE * luminances[at] + SHINE * seen[at].shine));
            if wish.is_finite() { wish } else { 0.0 }
        };
        (0..seen.len()).map(wish).collect()
    }
}

/// What the G-buffer shows in a block: means over its pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Seen {
    /// Number of pixels that show a surface.
    covered: u32,
    /// Change of the normal from pixel to pixel, the sum of its coordinates' and both directions'.
    normals: f32,
    /// The same of albedo (luminance), roughness and metallic.
    materials: f32,
    /// Luminance of the albedo.
    luminance: f32,
    /// The squared complement of roughness.
    shine: f32,
}

impl Seen {
    /// The block with this column and row.
    fn of(gbuffer: &Frame, (column, row): (usize, usize)) -> Self {
        let (width, height) = (gbuffer.width, gbuffer.height);
        let mut sum = Self::default();
        let mut count = 0.0;
        for y in row * BLOCK..(row * BLOCK + BLOCK).min(height) {
            for x in column * BLOCK..(column * BLOCK + BLOCK).min(width) {
                let at = y * width + x;
                let others = [(x + 1 < width).then_some(at + 1), (y + 1 < height).then_some(at + width)];
                let material = |at: usize| {
                    let [roughness, metallic, _] = gbuffer.material.pixels[at];
                    [luminance(gbuffer.albedo.pixels[at]), roughness, metallic]
                };
                let change = |a: [f32; 3], b: [f32; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f32>();
                let [albedo, roughness, _] = material(at);
                for other in others.into_iter().flatten() {
                    sum.normals += change(gbuffer.normal.pixels[at], gbuffer.normal.pixels[other]);
                    sum.materials += change(material(at), material(other));
                }
                sum.luminance += albedo;
                if gbuffer.depth.pixels[at].is_finite() {
                    sum.covered += 1;
                    sum.shine += (1.0 - roughness) * (1.0 - roughness);
                }
                count += 1.0;
            }
        }
        let mean = |sum: f32| sum / count;
        Self {
            covered: sum.covered,
            normals: mean(sum.normals),
            materials: mean(sum.materials),
            luminance: mean(sum.luminance),
            shine: mean(sum.shine),
        }
    }
}

/// The number of samples of each block, in [`detail_range`]: the larger the larger its wish is, and at most `spp` on average over
/// what blocks show of surfaces. Blocks of the environment alone get the usual number, since they cost little. Where `spp` is a
/// power of two above 1, all counts are the same multiples of it.
fn spread(wishes: &[f32], seen: &[Seen], spp: u32) -> Vec<u32> {
    let usual: u32 = 1 << spp.clamp(1, MOST).ilog2();
    let powers = detail_range(spp);
    let lowest = powers.start().ilog2() as f32 - usual.ilog2() as f32;
    let highest = powers.end().ilog2() as f32 - usual.ilog2() as f32;
    // Equal wishes are told apart, so that half of the blocks can have the next power of two.
    let dither = |at: usize| (hash::child(STREAM, at as u64) >> 40) as f32 / (1u32 << 30) as f32;
    // What the usual number is multiplied by, in halves.
    let halves =
        |at: usize, offset: f32| 1_u64 << (1.0 + (wishes[at] + dither(at) + offset).round().clamp(lowest, highest)) as u32;
    let weight = |at: usize| u64::from(seen[at].covered);
    let budget = 2 * u64::from(spp) * (0..seen.len()).map(weight).sum::<u64>();
    let cost = |offset: f32| (0..seen.len()).into_par_iter().map(|at| weight(at) * halves(at, offset)).sum::<u64>();
    let (mut low, mut high) = (-64.0_f32, 64.0_f32);
    for _ in 0..32 {
        let middle = 0.5 * (low + high);
        *(if cost(middle) * u64::from(usual) <= budget { &mut low } else { &mut high }) = middle;
    }
    let count = |at: usize| if seen[at].covered > 0 { (halves(at, low) * u64::from(usual) / 2) as u32 } else { usual };
    (0..seen.len()).map(count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat wall, with a bumpy square in its middle.
    fn wall(width: usize, height: usize) -> Frame {
        let bumpy = |x: usize, y: usize| (width / 4..width / 2).contains(&x) && (height / 4..height / 2).contains(&y);
        let normal = |at: usize| {
            let (x, y) = (at % width, at / width);
            if bumpy(x, y) && (x + y) % 2 == 0 { [0.6, 0.0, 0.8] } else { [0.0, 0.0, 1.0] }
        };
        let count = width * height;
        Frame {
            width,
            height,
            albedo: Image::filled(width, height, [0.5; 3]),
            normal: Image { width, height, pixels: (0..count).map(normal).collect() },
            depth: Image::filled(width, height, 2.0),
            material: Image::filled(width, height, [0.5, 0.0, 0.5]),
            ..Frame::default()
        }
    }

    #[test]
    fn detail_gets_more_and_the_average_is_kept() {
        for (spp, width, height) in [(2, 64, 64), (4, 64, 64), (6, 61, 47), (16, 37, 64), (4, 3, 2), (1, 64, 64), (48, 64, 64)] {
            let map = detail_map(&wall(width, height), spp).unwrap();
            let sum: u64 = map.pixels.iter().map(|&n| u64::from(n)).sum();
            let average = sum as f64 / map.pixels.len() as f64;
            assert!(average <= f64::from(spp) && average > 0.9 * f64::from(spp), "{spp}: {average}");
            assert!(map.pixels.iter().all(|n| n.is_power_of_two() && detail_range(spp).contains(n)));
            // Powers of two differ by a factor alone.
            if spp.is_power_of_two() && spp > 1 {
                let more = detail_map(&wall(width, height), 2 * spp).unwrap();
                assert!(map.pixels.iter().zip(&more.pixels).all(|(n, more)| 2 * n == *more));
            }
            if spp > 1 && width > 30 {
                let (rough, flat) = (map.pixels[height * 3 / 8 * width + width * 3 / 8], map.pixels[height * 3 / 4 * width + 1]);
                assert!(rough >= 2 * flat, "{spp}: {rough} and {flat}");
            }
        }
    }

    #[test]
    fn nothing_to_see_and_nothing_to_read() {
        let empty = Frame { depth: Image::filled(9, 5, f32::INFINITY), ..wall(9, 5) };
        assert!(detail_map(&empty, 4).unwrap().pixels.iter().all(|&n| n == 4));
        assert!(detail_map(&Frame { width: 4, height: 4, ..Frame::default() }, 4).is_err());
        assert!(detail_map(&Frame::default(), 4).unwrap().pixels.is_empty());
        let broken = Frame { normal: Image::filled(8, 8, [f32::NAN; 3]), ..wall(8, 8) };
        assert!(detail_map(&broken, 4).unwrap().pixels.iter().all(|n| detail_range(4).contains(n)));
    }
}
