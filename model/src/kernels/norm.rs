//! Channel normalisation, with SiLU after it where asked for: one pass over the pixels in place of burn's ten on one thread.
//! Normalisation by the root mean square is the same but for what keeps the divisor from 0.
use super::tile::Tile;
use rayon::prelude::*;

/// Square of the least length a pixel is divided by. Bounding the square, not the root, keeps the gradient of a pixel of zeros
/// finite.
pub const LEAST_SQUARE: f32 = 1e-24;

/// Values a task works on, about: what a core's first cache holds.
const TASK: usize = 4096;
/// Partial sums of a row, added in a fixed order: the same bits whatever the width of vectors.
const LANES: usize = 16;

/// `gamma sqrt(c) x / |x|` of each row of `c` channels, with `eps` `gamma x / sqrt(|x|^2 / c + eps)`; then SiLU if `silu`.
#[derive(Clone, Copy, Debug)]
pub struct ChannelNorm<'a> {
    /// Rows of `gamma.len()` channels.
    pub x: &'a [f32],
    /// Factor of each channel.
    pub gamma: &'a [f32],
    /// Added to the mean square; without it [`LEAST_SQUARE`] bounds the square.
    pub eps: Option<f32>,
    /// With SiLU.
    pub silu: bool,
}

impl ChannelNorm<'_> {
    /// Values of a task: whole rows.
    fn task(&self) -> usize {
        let channels = self.gamma.len();
        channels * (TASK / channels).max(1)
    }

    /// Square of what a row is divided by, and what it is multiplied by.
    fn scale(&self, row: &[f32]) -> (f32, f32) {
        let (square, count) = (product(row, row), row.len() as f32);
        let square = self.eps.map_or(square.max(LEAST_SQUARE), |eps| square + count * eps);
        (square, count.sqrt() / square.sqrt())
    }

    /// Normalises whole rows.
    fn normalise(&self, x: &[f32], z: &mut [f32]) {
        let channels = self.gamma.len();
        for (x, z) in x.chunks_exact(channels).zip(z.chunks_exact_mut(channels)) {
            let (_, scale) = self.scale(x);
            for ((z, x), gamma) in z.iter_mut().zip(x).zip(self.gamma) {
                *z = x * scale * gamma;
            }
        }
    }

    /// As many values as `x` has.
    pub fn forward<T: Tile>(&self, tile: T) -> Vec<f32> {
        let task = self.task();
        super::buffer::fill(self.x.len(), task, Vec::new, |z: &mut Vec<f32>, i, y| {
            let x = &self.x[i * task..][..y.len()];
            if self.silu {
                z.resize(y.len(), 0.0);
                self.normalise(x, z);
                tile.silu(z, y);
            } else {
                self.normalise(x, y);
            }
        })
    }

    /// Gradients of x and of gamma, given that of the result.
    pub fn backward<T: Tile>(&self, tile: T, gradient: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let (task, channels) = (self.task(), self.gamma.len());
        let mut dx = vec![0.0; self.x.len()];
        let parts: Vec<Vec<f32>> = dx
            .par_chunks_mut(task)
            .enumerate()
            .map_init(
                || (Vec::new(), Vec::new()),
                |(z, dz): &mut (Vec<f32>, Vec<f32>), (i, dx)| {
                    let range = i * task..i * task + dx.len();
                    let (x, gradient) = (&self.x[range.clone()], &gradient[range]);
                    dz.resize(dx.len(), 0.0);
                    if self.silu {
                        z.resize(dx.len(), 0.0);
                        self.normalise(x, z);
                        tile.silu_gradient(z, gradient, dz);
                    } else {
                        dz.copy_from_slice(gradient);
                    }
                    let mut part = vec![0.0; channels];
                    let rows = x.chunks_exact(channels).zip(dz.chunks_exact_mut(channels)).zip(dx.chunks_exact_mut(channels));
                    for ((x, dz), dx) in rows {
                        let (square, scale) = self.scale(x);
                        for (((part, dz), x), gamma) in part.iter_mut().zip(&mut *dz).zip(x).zip(self.gamma) {
                            *part += *dz * x * scale;
                            *dz *= gamma;
                        }
                        // What lies along the row changes its length alone, which the division takes out again.
                        let along = if self.eps.is_some() || square > LEAST_SQUARE { product(x, dz) / square } else { 0.0 };
                        for ((dx, dz), x) in dx.iter_mut().zip(&*dz).zip(x) {
                            *dx = scale * (dz - x * along);
                        }
                    }
                    part
                },
            )
            .collect();
        let mut dgamma = vec![0.0; channels];
        for part in parts {
            dgamma.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        (dx, dgamma)
    }
}

/// Sum of products of two rows of equal length.
fn product(a: &[f32], b: &[f32]) -> f32 {
    sum(a, b, |a, b| a * b)
}

/// Sum of `term` over two rows of equal length.
#[inline(always)]
pub fn sum(a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) -> f32 {
    let mut sums = [0.0; LANES];
    let (a_whole, a_rest) = a.as_chunks::<LANES>();
    let (b_whole, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a_whole.iter().zip(b_whole) {
        for lane in 0..LANES {
            sums[lane] += term(a[lane], b[lane]);
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(a_rest).zip(b_rest) {
        *sum += term(*a, *b);
    }
    let mut width = LANES / 2;
    while width > 0 {
        for lane in 0..width {
            sums[lane] += sums[lane + width];
        }
        width /= 2;
    }
    sums[0]
}
