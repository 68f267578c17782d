//! Convolution, decoder entry and their gradients on plain slices.
use super::gather::{Finish, Frames, Size, Source, Weights, gather};
use super::gradient::{self, WeightGradient};
use super::options::Stride;
use super::taps::Lattice;
use super::tile::Tile;
use std::borrow::Cow;

/// Frames of a clip, and how a convolution over time reads them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Time {
    /// Frames of a clip of the input.
    pub input: usize,
    /// Input frames from one output frame to the next.
    pub step: usize,
    /// The input frame under the newest tap of the first output frame.
    pub newest: usize,
}

impl Time {
    /// Taps of a convolution over time.
    pub const TAPS: usize = 3;

    /// Frames of a clip of the output.
    pub fn output(self) -> usize {
        (self.input - 1 - self.newest) / self.step + 1
    }

    /// Frames that output frames read under tap `tap`, the newest being the last.
    fn forward(self, tap: usize) -> Frames {
        let offset = self.newest as isize - (Self::TAPS - 1 - tap) as isize;
        Frames { out: self.output(), source: self.input, step: self.step, offset, every: 1 }
    }

    /// Output frames that read input frames under tap `tap`.
    fn backward(self, tap: usize) -> Frames {
        Frames { out: self.input, source: self.output(), step: 1, offset: -self.forward(tap).offset, every: self.step }
    }
}

/// A convolution of one picture, of an enlarged one beside another, or of the frames of a clip.
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
    /// The pictures are frames, and the kernel has three taps over time as well; only with [`Stride::One`] and without `skip`.
    pub time: Option<Time>,
    /// `[kernel, kernel, channels of x and skip, outputs]`; of a convolution over time `[kernel, kernel, taps, channels,
    /// outputs]`.
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

/// Pictures as a tile multiplies them.
struct Cells<'a> {
    x: Cow<'a, [f32]>,
    skip: Option<Cow<'a, [f32]>>,
    factors: usize,
}

impl<'a> Convolution<'a> {
    /// Whether its channels, those read and those written, come in whole cells of `factors`.
    pub fn fits(&self, factors: usize) -> bool {
        let skip = self.skip.map_or(0, |(_, size)| size.channels);
        let even = [self.size.channels, skip, self.outputs].iter().all(|channels| channels.is_multiple_of(factors));
        even && (factors == 1 || self.time.is_none())
    }

    /// Size of the output.
    pub fn output(&self) -> Size {
        let Size { batch, height, width, .. } = self.size;
        let batch = self.time.map_or(batch, |time| batch / time.input * time.output());
        Size { batch, height: self.stride.output(height), width: self.stride.output(width), channels: self.outputs }
    }

    /// The pictures as the tile multiplies them.
    fn cells<T: Tile>(&self, tile: T) -> Cells<'a> {
        Cells { x: tile.cells(self.x), skip: self.skip.map(|(values, _)| tile.cells(values)), factors: T::FACTORS }
    }

    fn sources<'c>(&self, cells: &'c Cells) -> Vec<Source<'c>> {
        let lattice = Lattice::forward(self.kernel, self.stride);
        let size = self.size.cells(cells.factors);
        let x = Source { values: &cells.x, size, lattice, frames: Frames::SINGLE, first: 0, onto: 0 };
        if let Some(time) = self.time {
            // Frames before the first are zero: a tap that meets only those is left out.
            let taps = (0..Time::TAPS).map(|tap| Source { frames: time.forward(tap), first: tap * size.channels, ..x });
            return taps.filter(|source| source.frames.meet()).collect();
        }
        let skip = self.skip.zip(cells.skip.as_ref()).map(|((_, beside), values)| Source {
            values,
            size: beside.cells(cells.factors),
            lattice: Lattice::beside_up(),
            first: size.channels,
            ..x
        });
        std::iter::once(x).chain(skip).collect()
    }

    fn weights(&self, transposed: bool) -> Weights<'a> {
        let inputs = match self.time {
            Some(_) => Time::TAPS * self.size.channels,
            None => self.size.channels + self.skip.map_or(0, |(_, size)| size.channels),
        };
        Weights { values: self.weights, kernel: self.kernel, inputs, outputs: self.outputs, transposed }
    }

    /// The output, and the activated output for [`Finish::SiluAndSums`].
    pub fn forward<T: Tile>(&self, tile: T, bias: &[f32], finish: Finish) -> (Vec<f32>, Option<Vec<f32>>) {
        let cells = self.cells(tile);
        gather(tile, &self.sources(&cells), self.weights(false), self.output(), bias, finish)
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
        let input = |sources: &[Source], size: Size| gather(tile, sources, transposed, size, &[], Finish::Plain).0;
        let lattice = Lattice::backward(self.kernel, self.stride);
        let read = if wanted.x || wanted.skip { tile.cells(gradient) } else { Cow::default() };
        let source = Source { values: &read, size: out.cells(T::FACTORS), lattice, frames: Frames::SINGLE, first: 0, onto: 0 };
        if wanted.x {
            result.x = match self.time {
                Some(time) => {
                    let onto = |tap| tap * self.size.channels;
                    let taps = (0..Time::TAPS).map(|tap| Source { frames: time.backward(tap), onto: onto(tap), ..source });
                    input(&taps.filter(|source| source.frames.meet()).collect::<Vec<_>>(), self.size)
                }
                None => input(&[source], self.size),
            };
        }
        if let (true, Some((_, size))) = (wanted.skip, self.skip) {
            let lattice = Lattice::backward(self.kernel, Stride::One);
            result.skip = input(&[Source { lattice, onto: self.size.channels, ..source }], size);
        }
        if wanted.weights {
            result.weights = vec![0.0; self.weights.len()];
            // Here sums run over pixels, so that it is those that cells are made of.
            let floats = Cells { x: Cow::Borrowed(self.x), skip: self.skip.map(|(values, _)| Cow::Borrowed(values)), factors: 1 };
            for mut source in self.sources(&floats) {
                // On its own, the second picture is an ordinary convolution: nine sums instead of thirty-six.
                if self.skip.is_some() && source.first > 0 {
                    source.lattice = Lattice::forward(self.kernel, Stride::One);
                }
                let into = WeightGradient { values: &mut result.weights, kernel: self.kernel, inputs: transposed.inputs };
                gradient::weights(tile, &source, gradient, out, into);
            }
        }
        if wanted.bias {
            result.bias = gradient::bias(gradient, self.outputs);
        }
        result
    }
}
