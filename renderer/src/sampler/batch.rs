//! Points of sixteen consecutive numbers of a sequence at once, bit for bit equal to [`PixelSampler::point`].
//!
//! The sixteen share the upper bits of their shuffled numbers, hence most of the Sobol matrix, and what is left is the same short
//! sequence of integer operations for each: the compiler makes vector code of it for whatever the processor has. A renderer that
//! goes through the samples of a pixel in order asks for nearly all of the sixteen.

use super::sobol::{PixelSampler, SEQUENCE};
use sobol_burley::parts::{hash, owen_scramble_rev, u32_to_f32_norm};

/// Points of a batch.
pub const LANES: usize = 16;
/// One set of a batch, an array a dimension.
pub type Batched = [[f32; LANES]; 4];
/// Samples that are asked for of a batch from which on it is cheaper than computing each.
const WORTH: u32 = 3;
/// Sets that are kept; paths seldom reach those beyond, which are computed one by one.
const SETS: usize = 16;
/// No number of a batch.
const NONE: u64 = u64::MAX;
/// Bits of a sample's number that matter.
const BITS: usize = SEQUENCE.ilog2() as usize;

/// Sobol's direction numbers of the first four dimensions (Joe and Kuo 2008), bits reversed; the first belongs to the lowest bit
/// of a sample's number.
const DIRECTIONS: [[u32; 4]; BITS] = directions();

/// The numbers of each dimension, with 0 for the lowest four bits: those are what the samples of a batch differ in.
const UPPER: [[u32; BITS]; 4] = {
    let mut upper = [[0; BITS]; 4];
    let mut bit = LANES.ilog2() as usize;
    while bit < BITS {
        let mut d = 0;
        while d < 4 {
            upper[d][bit] = DIRECTIONS[bit][d];
            d += 1;
        }
        bit += 1;
    }
    upper
};

const fn directions() -> [[u32; 4]; BITS] {
    /// Degree and inner coefficients of the primitive polynomial, and the first direction numbers.
    const POLYNOMIALS: [(usize, u32, [u32; 3]); 3] = [(1, 0, [1, 0, 0]), (2, 1, [1, 3, 0]), (3, 1, [1, 3, 1])];
    let mut numbers = [[0; 4]; BITS];
    let mut bit = 0;
    while bit < BITS {
        numbers[bit][0] = 1 << (31 - bit);
        bit += 1;
    }
    let mut dimension = 0;
    while dimension < 3 {
        let (degree, inner, first) = POLYNOMIALS[dimension];
        let at = dimension + 1;
        let mut k = 0;
        while k < BITS {
            numbers[k][at] = if k < degree {
                first[k] << (31 - k)
            } else {
                let mut number = numbers[k - degree][at] ^ (numbers[k - degree][at] >> degree);
                let mut i = 1;
                while i < degree {
                    if (inner >> (degree - 1 - i)) & 1 == 1 {
                        number ^= numbers[k - i][at];
                    }
                    i += 1;
                }
                number
            };
            k += 1;
        }
        dimension += 1;
    }
    let mut k = 0;
    while k < BITS {
        let mut d = 0;
        while d < 4 {
            numbers[k][d] = numbers[k][d].reverse_bits();
            d += 1;
        }
        k += 1;
    }
    numbers
}

/// One set of sixteen consecutive numbers of a sequence.
#[derive(Clone, Copy)]
struct Batch {
    /// What tells the sequence from others.
    base: u64,
    /// Number of the batch in the sequence.
    number: u64,
    points: Batched,
}

/// Caches points that were computed in advance. Its results depend on the arguments alone.
pub struct Points {
    batches: [Batch; SETS],
    /// Whether so few samples of a pixel are requested that each is computed by itself.
    few: bool,
}

impl Default for Points {
    fn default() -> Self {
        Self { batches: [Batch { base: 0, number: NONE, points: [[0.0; LANES]; 4] }; SETS], few: false }
    }
}

impl Points {
    /// Announces how many consecutive samples of a pixel will be requested. It affects what is computed in advance, never the
    /// results.
    #[inline(always)]
    pub fn expect(&mut self, samples: u32) {
        self.few = samples < WORTH;
    }

    /// [`PixelSampler::point`] of `sampler`.
    #[inline(always)]
    pub fn point(&mut self, sampler: &PixelSampler, index: u32, set: u32) -> [f32; 4] {
        let lane = sampler.number(index, set) as usize % LANES;
        // Spelled out: an array that is mapped goes through memory, and reading two of its numbers at once then waits for both
        // stores.
        match self.batch(sampler, index, set) {
            Some([x, y, z, w]) => [x[lane], y[lane], z[lane], w[lane]],
            None => sampler.point(index, set),
        }
    }

    /// The points of set `set` of all numbers `16 k..16 k + 16` of its sequence, that of sample `index` among them; `None` where
    /// they are not kept or too few are expected.
    #[inline(always)]
    pub fn batch(&mut self, sampler: &PixelSampler, index: u32, set: u32) -> Option<&Batched> {
        if self.few { None } else { self.sixteen(sampler, index, set) }
    }

    /// [`Self::batch`] however few are expected.
    #[inline(always)]
    pub fn sixteen(&mut self, sampler: &PixelSampler, index: u32, set: u32) -> Option<&Batched> {
        let batch = self.batches.get_mut(set as usize).filter(|_| sampler.is_sobol())?;
        let number = sampler.number(index, set) / LANES as u64;
        let base = sampler.base(set);
        if batch.number != number || batch.base != base {
            *batch = Batch { base, number, points: batch.points };
            let first = number * LANES as u64;
            compute(&mut batch.points, first as u32 % SEQUENCE, sampler.scramble(first, set));
        }
        Some(&batch.points)
    }
}

/// The points of the numbers `first..first + 16`, `first` a multiple of 16 below 2^16, as sobol_burley's `sample_4d` gives them.
#[inline(always)]
fn compute(points: &mut Batched, first: u32, seed: u32) {
    let shuffle = hash(seed ^ 0x79c6_8e4a);
    // The shuffle acts on reversed bits, where it carries upwards only: the lower bits, which are those of the batch, are common.
    let shuffled = owen_scramble_rev(first.reverse_bits(), shuffle);
    // Bit by bit the compiler would branch, and be wrong half of the time.
    let masks: [u32; BITS] = std::array::from_fn(|bit| set_bit(shuffled, bit));
    let common: [u32; 4] = std::array::from_fn(|d| {
        let numbers: [u32; BITS] = std::array::from_fn(|bit| masks[bit] & UPPER[d][bit]);
        numbers.iter().fold(0, |sum, number| sum ^ number)
    });
    let seed = seed.wrapping_mul(0x9c8f_2d3b);
    let scrambles = [0x912f_69ba, 0x174f_18ab, 0x691e_72ca, 0xb40c_c1b8].map(|d| hash(seed ^ d));
    let [x, y, z, w] = points;
    for lane in 0..LANES {
        let shuffled = owen_scramble_rev((first + lane as u32).reverse_bits(), shuffle);
        let masks: [u32; 4] = std::array::from_fn(|bit| set_bit(shuffled, bit));
        let coordinate = |d: usize| {
            let own = masks.iter().zip(&DIRECTIONS).fold(common[d], |sum, (mask, numbers)| sum ^ (mask & numbers[d]));
            u32_to_f32_norm(owen_scramble_rev(own, scrambles[d]).reverse_bits())
        };
        (x[lane], y[lane], z[lane], w[lane]) = (coordinate(0), coordinate(1), coordinate(2), coordinate(3));
    }
}

/// All ones where bit `bit`, counted from the highest, is set.
#[inline(always)]
fn set_bit(value: u32, bit: usize) -> u32 {
    (((value << bit) as i32) >> 31) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Sampler, Sharing};

    #[test]
    fn directions_are_those_of_sobol_burley() {
        for (bit, numbers) in DIRECTIONS.iter().enumerate() {
            for (d, number) in numbers.iter().enumerate() {
                assert_eq!(*number, sobol_burley::parts::sobol_rev(1 << (31 - bit), d as u32), "bit {bit} of dimension {d}");
            }
        }
    }

    #[test]
    fn batches_hold_the_points_of_the_stream() {
        let mut points = Points::default();
        for kind in [Sampler::Sobol, Sampler::Independent] {
            for pixel in 0..20 {
                let at = (pixel as u32 % 3, pixel as u32 / 3);
                let sampler = match pixel % 2 {
                    0 => PixelSampler::of_kind(kind, 5, 1, pixel),
                    _ => PixelSampler::shared(kind, 5, 1, at, 3, Sharing::new(1 << (pixel % 5), 2, 1)),
                };
                // In order, out of order, over the border of a scramble, and with numbers only an interrupted render starts from.
                let starts = [0, 7, 3, 1 << 10, (1 << 16) - 20, (1 << 20) + 5, (1 << 24) - 40];
                points.expect(if pixel % 3 == 0 { 1 } else { 16 });
                for index in starts.into_iter().flat_map(|start| start..start + 40) {
                    for set in [0, 1, 2, 9, SETS as u32 - 1, SETS as u32, 300] {
                        let (found, expected) = (points.point(&sampler, index, set), sampler.point(index, set));
                        assert_eq!(found.map(f32::to_bits), expected.map(f32::to_bits), "{kind:?} {pixel} {index} {set}");
                    }
                }
            }
        }
    }
}
