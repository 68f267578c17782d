//! Convolution, decoder entry and their gradients on plain slices.
use super::gather::{Finish, Size, Source, Weights, gather};
use super::gradient;
use super::taps::Lattice;
use super::tile::Tile;
use crate::ops::Stride;

/// A convolution of one picture, or of an enlarged one beside another.
#[derive(Clone, Copy, Debug)]
pub struct Convolution<'a> {
    /// The picture, and how it is read.
    pub x: &'a [f32],
    /// Its size.
    pub size: Size,
    /// Where the output pixels are.
    pub stride: Stride,
    /// A second picture at the output's size, whose channels follow those of `x`; only with [`Stride::Up`] and a 3 x 3 kernel.
    pub skip: Option<(&'a [f32], Size)>,
    /// `[kernel, kernel, channels of x and skip, outputs]`.
    pub weights: &'a [f32],
    /// Rows and columns of the kernel, 1 or 3.
    pub kernel: usize,
    /// Output channels.
    pub outputs: usize,
}

/// Which gradients are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// Of the picture.
    pub x: bool,
    /// Of the second picture.
    pub skip: bool,
    /// Of the weights.
    pub weights: bool,
    /// Of the bias.
    pub bias: bool,
}

/// Gradients; those not wanted are empty.
#[derive(Debug, Default)]
pub struct Gradients {
    /// Of the picture.
    pub x: Vec<f32>,
    /// Of the second picture.
    pub skip: Vec<f32>,
    /// Of the weights.
    pub weights: Vec<f32>,
    /// Of the bias.
    pub bias: Vec<f32>,
}

impl<'a> Convolution<'a> {
    /// Size of the output.
    pub fn output(&self) -> Size {
        let Size { batch, height, width, .. } = self.size;
        Size { batch, height: self.stride.output(height), width: self.stride.output(width), channels: self.outputs }
    }

    fn sources(&self) -> Vec<Source<'a>> {
        let lattice = Lattice::forward(self.kernel, self.stride);
        let mut sources = vec![Source { values: self.x, size: self.size, lattice, first: 0 }];
        if let Some((values, size)) = self.skip {
            sources.push(Source { values, size, lattice: Lattice::beside_up(), first: self.size.channels });
        }
        sources
    }

    fn weights(&self, transposed: bool) -> Weights<'a> {
        let inputs = self.size.channels + self.skip.map_or(0, |(_, size)| size.channels);
        Weights { values: self.weights, kernel: self.kernel, inputs, outputs: self.outputs, transposed }
    }

    /// The output, and the activated output for [`Finish::SiluAndSums`].
    pub fn forward<T: Tile>(&self, tile: T, bias: &[f32], finish: Finish) -> (Vec<f32>, Option<Vec<f32>>) {
        gather(tile, &self.sources(), self.weights(false), self.output(), 0, bias, finish)
    }

    /// Gradients, given that of the output; `sums` are those kept by [`Finish::SiluAndSums`] if SiLU was applied.
    pub fn backward<T: Tile>(&self, tile: T, sums: Option<&[f32]>, gradient: &[f32], wanted: Wanted) -> Gradients {
        let before;
        let gradient = match sums {
            Some(sums) => {
                before = gradient::before_silu(tile, sums, gradient);
                &before
            }
            None => gradient,
        };
        let mut result = Gradients::default();
        let (out, transposed) = (self.output(), self.weights(true));
        let input = |lattice: Lattice, size: Size, first: usize| {
            let source = Source { values: gradient, size: out, lattice, first: 0 };
            gather(tile, &[source], transposed, size, first, &[], Finish::Plain).0
        };
        if wanted.x {
            result.x = input(Lattice::backward(self.kernel, self.stride), self.size, 0);
        }
        if let (true, Some((_, size))) = (wanted.skip, self.skip) {
            result.skip = input(Lattice::backward(self.kernel, Stride::One), size, self.size.channels);
        }
        if wanted.weights {
            result.weights = vec![0.0; self.weights.len()];
            for mut source in self.sources() {
                // On its own, the second picture is an ordinary convolution: nine sums instead of thirty-six.
                if source.first > 0 {
                    source.lattice = Lattice::forward(self.kernel, Stride::One);
                }
                gradient::weights(tile, &source, gradient, out, self.kernel, transposed.inputs, &mut result.weights);
            }
        }
        if wanted.bias {
            result.bias = gradient::bias(gradient, self.outputs);
        }
        result
    }
}
