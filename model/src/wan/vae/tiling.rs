//! Encoding and decoding of large pictures in overlapping tiles, so that memory holds one tile and the result.

use super::Vae;
use crate::{Error, Result};
use burn::tensor::{Tensor, TensorData};

/// The size of tiles, in latent pixels.
///
/// Tiles are blended linearly where they overlap. The result is close to the result for the whole picture but not equal: the
/// attention in the middle of each network sees one tile, and convolutions see zeros beyond its edge. A picture of one tile is
/// the same to the bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiling {
    /// Side of a tile.
    pub size: usize,
    /// Overlap of neighbouring tiles, less than `size`.
    pub overlap: usize,
}

impl Default for Tiling {
    /// 512 pixels a side, 128 of them shared, with the published autoencoder.
    fn default() -> Self {
        Self { size: 64, overlap: 16 }
    }
}

impl Tiling {
    fn validate(self) -> Result<()> {
        if self.size == 0 || self.overlap >= self.size {
            let reason = format!("tiles of {} that overlap by {} cover nothing", self.size, self.overlap);
            return Err(Error::config("tiling", reason));
        }
        Ok(())
    }

    /// First pixel of each tile along an axis. The last tile ends with the axis.
    fn starts(self, length: usize) -> Vec<usize> {
        let last = length.saturating_sub(self.size);
        let step = self.size - self.overlap;
        (0..last).step_by(step).chain([last]).collect()
    }

    /// Weight of each tile at each of its pixels along an axis of `length`, with `scale` pixels for each of the axis. Weights sum
    /// to 1.
    fn weights(self, length: usize, scale: usize) -> Vec<Vec<f32>> {
        let (starts, size) = (self.starts(length), self.size.min(length));
        let ramp = (self.overlap * scale) as f32;
        let plain = |start: usize| {
            let weight = move |i: usize| {
                let rise = if start == 0 { f32::INFINITY } else { i as f32 + 0.5 };
                let fall = if start + size == length { f32::INFINITY } else { (size * scale - i) as f32 - 0.5 };
                (rise.min(fall) / ramp).min(1.0)
            };
            (0..size * scale).map(weight).collect::<Vec<f32>>()
        };
        let mut weights: Vec<Vec<f32>> = starts.iter().map(|&start| plain(start)).collect();
        let mut sums = vec![0.0; length * scale];
        for (weights, start) in weights.iter().zip(&starts) {
            sums[start * scale..].iter_mut().zip(weights).for_each(|(sum, w)| *sum += w);
        }
        for (weights, start) in weights.iter_mut().zip(&starts) {
            weights.iter_mut().zip(&sums[start * scale..]).for_each(|(w, sum)| *w /= sum);
        }
        weights
    }

    /// Applies `run` to each tile of `x` `[b, c, t, h, w]`. A latent pixel spans `from` pixels of `x` and `to` pixels of the
    /// result.
    fn map(self, x: Tensor<5>, from: usize, to: usize, run: impl Fn(Tensor<5>) -> Result<Tensor<5>>) -> Result<Tensor<5>> {
        self.validate()?;
        let [_, _, _, h, w] = x.dims();
        let (rows, columns) = (h / from, w / from);
        if rows <= self.size && columns <= self.size {
            return run(x);
        }
        let device = x.device();
        let row_weights = self.weights(rows, to);
        let column_weights = self.weights(columns, to);
        let mut result: Option<Tensor<5>> = None;
        for (&top, row_weights) in self.starts(rows).iter().zip(&row_weights) {
            let band = x.clone().narrow(3, top * from, self.size.min(rows) * from);
            let mut strip: Option<Tensor<5>> = None;
            for (&left, weights) in self.starts(columns).iter().zip(&column_weights) {
                let tile = run(band.clone().narrow(4, left * from, self.size.min(columns) * from))?;
                let weights = Tensor::from_data(TensorData::new(weights.clone(), [1, 1, 1, 1, weights.len()]), &device);
                add(&mut strip, within(tile * weights, 4, left * to, columns * to));
            }
            let weights = Tensor::from_data(TensorData::new(row_weights.clone(), [1, 1, 1, row_weights.len(), 1]), &device);
            if let Some(strip) = strip {
                add(&mut result, within(strip * weights, 3, top * to, rows * to));
            }
        }
        // An axis has at least one tile.
        Ok(result.unwrap_or(x))
    }
}

fn add(sum: &mut Option<Tensor<5>>, x: Tensor<5>) {
    *sum = Some(match sum.take() {
        Some(sum) => sum + x,
        None => x,
    });
}

/// Pads `x` with zeros, so that it begins at `start` of an axis of `length`.
fn within(x: Tensor<5>, axis: usize, start: usize, length: usize) -> Tensor<5> {
    let (shape, device) = (x.dims(), x.device());
    let end = length - start - shape[axis];
    let zeros = |count: usize| {
        let mut shape = shape;
        shape[axis] = count;
        Tensor::zeros(shape, &device)
    };
    let mut parts = Vec::with_capacity(3);
    if start > 0 {
        parts.push(zeros(start));
    }
    parts.push(x);
    if end > 0 {
        parts.push(zeros(end));
    }
    Tensor::cat(parts, axis)
}

impl Vae {
    /// [`Vae::encode`] in tiles.
    ///
    /// # Errors
    /// When the tiling is invalid, or as for [`Vae::encode`].
    pub fn encode_tiled(&self, pictures: Tensor<5>, tiling: Tiling) -> Result<Tensor<5>> {
        let factor = self.config().spatial_factor();
        self.check_encode(&pictures)?;
        tiling.map(pictures, factor, 1, |tile| self.encode(tile))
    }

    /// [`Vae::decode`] in tiles.
    ///
    /// # Errors
    /// When the tiling is invalid, or as for [`Vae::decode`].
    pub fn decode_tiled(&self, latents: Tensor<5>, tiling: Tiling) -> Result<Tensor<5>> {
        let factor = self.config().spatial_factor();
        tiling.map(latents, 1, factor, |tile| self.decode(tile))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;

    /// Tiles do not change the result of a map of single pixels.
    #[test]
    fn tiles_cover_everything_once() {
        let device = Device::flex();
        for (rows, columns, size, overlap) in [(10, 7, 4, 1), (5, 9, 5, 4), (16, 16, 8, 0), (3, 30, 7, 3), (2, 2, 8, 3)] {
            let tiling = Tiling { size, overlap };
            let values: Vec<f32> = (0..2 * rows * columns).map(|i| (i as f32 * 0.37).sin()).collect();
            let x = Tensor::<5>::from_data(TensorData::new(values, [1, 2, 1, rows, columns]), &device);
            let up = |x: Tensor<5>| {
                let [b, c, t, h, w] = x.dims();
                let x = x.reshape([b * c * t, h, 1, w, 1]).expand([b * c * t, h, 3, w, 3]);
                x.reshape([b, c, t, 3 * h, 3 * w])
            };
            let tiled = tiling.map(x.clone(), 1, 3, |tile| Ok(up(tile))).expect("tiles");
            let whole = up(x.clone());
            let difference: f32 = (tiled - whole.clone()).abs().max().into_scalar();
            assert!(difference < 1e-6, "{tiling:?}: {difference}");
            let back = tiling.map(whole, 3, 1, |tile| {
                let [b, c, t, h, w] = tile.dims();
                Ok(tile.reshape([b * c * t, h / 3, 3, w / 3, 3]).narrow(2, 1, 1).narrow(4, 1, 1).reshape([b, c, t, h / 3, w / 3]))
            });
            let difference: f32 = (back.expect("tiles") - x).abs().max().into_scalar();
            assert!(difference < 1e-6, "{tiling:?}: {difference}");
        }
        let invalid = Tiling { size: 4, overlap: 4 };
        invalid.map(Tensor::zeros([1, 1, 1, 9, 9], &device), 1, 1, Ok).expect_err("no progress");
    }
}
