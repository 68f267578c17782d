//! The layers that both U-Nets share: dense 3 x 3 convolutions on levels of half the size each, without normalisation.

use super::init::Init;
use super::layers::Conv;
use crate::ops::{Products, Stride};
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::Tensor;

/// Most convolutions of a [`Refine`].
const MOST_REFINES: usize = 8;

/// One or more times `x + silu(conv(x))`. The first convolution is small at first, and the others are 0, so that a deeper network
/// begins as the shallower one.
#[derive(Module, Debug)]
pub struct Refine {
    /// 3 x 3.
    pub conv: Conv,
    /// Those after it, 3 x 3.
    pub more: Vec<Conv>,
}

impl Refine {
    fn new(init: &mut Init, width: usize, count: usize) -> Self {
        let conv = Conv::new(init, 3, width, width, 0.1);
        Self { conv, more: (1..count).map(|_| Conv::new(init, 3, width, width, 0.0)).collect() }
    }

    fn forward(&self, products: Products, x: Tensor<4>) -> Tensor<4> {
        let step = |x: Tensor<4>, conv: &Conv| x.clone() + conv.forward(products, x, Stride::One, true);
        self.more.iter().fold(step(x, &self.conv), step)
    }
}

/// Checks the option `widths`: the channels of each level.
///
/// # Errors
/// [`Error::Config`] naming the option.
pub fn check_widths(widths: &[usize]) -> Result<()> {
    let fits = |&width: &usize| (16..=1024).contains(&width) && width.is_multiple_of(16);
    if widths.iter().all(fits) { Ok(()) } else { Err(Error::config("widths", "must be multiples of 16 up to 1024")) }
}

/// Checks the option `refines`: the convolutions of each [`Refine`] of a level.
///
/// # Errors
/// [`Error::Config`] naming the option.
pub fn check_refines(refines: &[usize]) -> Result<()> {
    let fits = refines.iter().all(|count| (1..=MOST_REFINES).contains(count));
    if fits { Ok(()) } else { Err(Error::config("refines", format!("must be 1 to {MOST_REFINES}"))) }
}

/// New layers of a U-Net. A network keeps them as fields of its own, by whose names its weights are stored.
pub struct Layers {
    /// From each level to the next, with stride 2.
    pub reduce: Vec<Conv>,
    /// At each level of the encoder.
    pub down: Vec<Refine>,
    /// From each level and a skip connection to the next finer level. The coarsest comes first.
    pub enter: Vec<Conv>,
    /// After each of `enter`.
    pub up: Vec<Refine>,
}

impl Layers {
    /// Random layers for levels of these widths, of which there is at least one, with so many convolutions in each [`Refine`] of
    /// a level.
    pub fn new(init: &mut Init, widths: &[usize], refines: &[usize]) -> Self {
        let (w, levels) = (widths, widths.len());
        Self {
            reduce: (1..levels).map(|level| Conv::new(init, 3, w[level - 1], w[level], 1.0)).collect(),
            down: (0..levels).map(|level| Refine::new(init, w[level], refines[level])).collect(),
            enter: (0..levels - 1).rev().map(|level| Conv::new(init, 3, w[level + 1] + w[level], w[level], 1.0)).collect(),
            up: (0..levels - 1).rev().map(|level| Refine::new(init, w[level], refines[level])).collect(),
        }
    }
}

/// Number of values in a convolution with its bias.
pub fn conv_values(k: usize, from: usize, to: usize) -> usize {
    k * k * from * to + to
}

/// Number of values in the layers of [`Layers::new`].
pub fn values(widths: &[usize], refines: &[usize]) -> usize {
    let (w, levels) = (widths, widths.len());
    let refine = |level: usize| refines[level] * conv_values(3, w[level], w[level]);
    let refines: usize = (0..levels).chain(0..levels - 1).map(refine).sum();
    let between = |level: usize| conv_values(3, w[level - 1], w[level]) + conv_values(3, w[level] + w[level - 1], w[level - 1]);
    refines + (1..levels).map(between).sum::<usize>()
}

/// The layers of a network.
pub struct View<'a> {
    /// As [`Layers::reduce`].
    pub reduce: &'a [Conv],
    /// As [`Layers::down`].
    pub down: &'a [Refine],
    /// As [`Layers::enter`].
    pub enter: &'a [Conv],
    /// As [`Layers::up`].
    pub up: &'a [Refine],
}

impl View<'_> {
    /// From `[b, h, w, widths[0]]` to the results of every level of the decoder, the finest first. `h` and `w` are multiples of
    /// 2 to the power of the number of levels less one.
    pub fn forward(&self, products: Products, mut x: Tensor<4>) -> Vec<Tensor<4>> {
        let mut skips = Vec::with_capacity(self.reduce.len());
        for (level, down) in self.down.iter().enumerate() {
            if level > 0 {
                skips.push(x.clone());
                x = self.reduce[level - 1].forward(products, x, Stride::Two, true);
            }
            x = down.forward(products, x);
        }
        let mut found = vec![x.clone()];
        for (enter, up) in self.enter.iter().zip(self.up) {
            let skip = skips.pop().expect("a skip connection for each level");
            x = up.forward(products, enter.decode(products, x, skip));
            found.push(x.clone());
        }
        found.reverse();
        found
    }
}
