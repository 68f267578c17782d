//! Blocks of 4 x 4 pixels that share one sequence of points in each set (Ahmed and Wonka 2020).
//!
//! Each pixel takes a run of consecutive points, and the runs follow one another along a Z through the block. So the samples of a
//! pixel are as well spread as before, and those of 2 x 2 and 4 x 4 pixels together are, too: where neighbours see nearly the
//! same, one is too bright where another is too dark. The errors of pixels stay as large as they were. A denoiser, which takes
//! means over neighbours, has less of them left (docs/measurements/renderer-notes.md, blocks). The scramble shuffles runs, so no
//! pixel of a block is preferred. Image points stay each pixel's own.

use super::hash;

/// Width and height of a block.
pub const SIDE: u32 = 4;
/// Pixels of a block, as a power of two.
const BITS: u32 = 2 * SIDE.ilog2();
/// Tells the streams of blocks from those of pixels.
const STREAM: u64 = 0x424c_4f43;

/// How long the runs of a picture's pixels are in each set.
#[derive(Clone, Copy, Debug)]
pub struct Sharing {
    /// Powers of two: the light samples of the first surface, and all other sets.
    runs: [u32; 2],
}

impl Sharing {
    /// For pictures of `rays` camera rays a pixel, each with `lights` light samples and `branches` paths. More samples than that
    /// make further runs.
    pub fn new(rays: u32, lights: u32, branches: u32) -> Self {
        let run = |count: u64| count.max(1).next_power_of_two().ilog2();
        Self { runs: [lights, branches].map(|each| run(u64::from(rays) * u64::from(each))) }
    }
}

/// The place of a pixel in its block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Seed of the block's stream.
    base: u64,
    /// Number of the pixel along the Z, 0..16.
    along: u64,
    sharing: Sharing,
}

impl Place {
    /// The place of pixel (x, y). `parent` is the seed of the frame.
    #[inline]
    pub fn new(parent: u64, (x, y): (u32, u32), sharing: Sharing) -> Self {
        let spread = |v: u32| u64::from(v & 1 | (v & 2) << 1);
        let block = u64::from(y / SIDE) << 32 | u64::from(x / SIDE);
        let base = hash::child(hash::child(parent, STREAM), block);
        Self { base, along: spread(x) | spread(y) << 1, sharing }
    }

    /// Seed of the block's stream.
    #[inline]
    pub fn base(&self) -> u64 {
        self.base
    }

    /// The number of the pixel's sample `index` in the block's sequence of set `set`.
    #[inline(always)]
    pub fn number(&self, index: u32, set: u32) -> u64 {
        let run = self.sharing.runs[usize::from(set != 2)];
        let index = u64::from(index);
        (index >> run) << (run + BITS) | self.along << run | (index & ((1 << run) - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{PixelSampler, Sampler};

    /// Numbers of all pixels of a block, each with its first `samples` samples.
    fn numbers(sharing: Sharing, set: u32, samples: u32) -> Vec<u64> {
        let pixels = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (8 + x, 4 + y)));
        pixels.flat_map(|at| (0..samples).map(move |index| Place::new(0, at, sharing).number(index, set))).collect()
    }

    #[test]
    fn a_block_shares_out_each_number_once() {
        for (rays, lights, branches) in [(1, 1, 1), (4, 2, 1), (3, 1, 2), (64, 8, 2), (1 << 23, 64, 2)] {
            let sharing = Sharing::new(rays, lights, branches);
            for (set, each) in [(1, branches), (2, lights), (3, branches), (8, branches)] {
                let samples = rays.min(300) * each;
                // Twice as far: further samples must not meet those of other pixels.
                let mut found = numbers(sharing, set, 2 * samples);
                found.sort_unstable();
                assert!(found.windows(2).all(|pair| pair[0] < pair[1]), "{rays} {lights} {branches}, set {set}");
                if (rays * each).is_power_of_two() && rays <= 300 {
                    let mut found = numbers(sharing, set, samples);
                    found.sort_unstable();
                    assert!(found.into_iter().eq(0..u64::from(16 * samples)), "{rays} {lights} {branches}, set {set}");
                }
            }
        }
    }

    #[test]
    fn squares_of_pixels_are_stratified_together() {
        for seed in 0..50 {
            let at = |x: u32, y: u32| PixelSampler::shared(Sampler::Sobol, seed, 3, (x, y), 9, Sharing::new(4, 1, 1));
            for set in [1, 2, 5] {
                let mut cells = [0; 16];
                for (x, y) in [(6, 2), (7, 2), (6, 3), (7, 3)] {
                    for index in 0..4 {
                        let [u, v, ..] = at(x, y).point(index, set);
                        cells[(u * 4.0) as usize * 4 + (v * 4.0) as usize] += 1;
                    }
                }
                assert_eq!(cells, [1; 16], "seed {seed} set {set}");
            }
        }
    }

    #[test]
    fn every_pixel_has_points_of_its_own() {
        for set in [0, 1, 2, 3] {
            let at = |x, y| PixelSampler::shared(Sampler::Sobol, 1, 2, (x, y), 20, Sharing::new(16, 1, 1)).point(5, set);
            let mut found: Vec<[u32; 4]> = (0..400).map(|i| at(i % 20, i / 20).map(f32::to_bits)).collect();
            found.sort_unstable();
            found.dedup();
            assert_eq!(found.len(), 400, "set {set}");
        }
    }
}
