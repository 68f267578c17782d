//! The U-Net: dense 3 x 3 convolutions from 1/2 to 1/64 of the picture, without normalisation.

use super::head::OUTPUTS;
use crate::Result;
use crate::network::init::Init;
use crate::network::layers::Conv;
use crate::network::unet::{self, Layers, Refine, conv_values};
use crate::ops::{Products, Stride};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

/// Number of levels, at 1/2, 1/4, ... 1/64 of the picture's size.
pub const LEVELS: usize = 6;
/// Sides of pictures are padded to a multiple of this.
pub const MULTIPLE: usize = 64;
/// Channels that are read from a pixel: the picture, and the place in it.
pub const CHANNELS: usize = 5;
/// Convolutions of each [`Refine`] of a level.
const REFINES: [usize; LEVELS] = [1; LEVELS];

/// Size of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InverseConfig {
    /// Channels of each level: multiples of 16, at most 1024.
    pub widths: [usize; LEVELS],
}

impl Default for InverseConfig {
    fn default() -> Self {
        Self { widths: [32, 64, 96, 128, 160, 160] }
    }
}

impl InverseConfig {
    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        unet::check_widths(&self.widths)
    }

    /// Number of values in all parameters.
    pub fn values(&self) -> usize {
        let w = self.widths;
        conv_values(3, 4 * CHANNELS, w[0]) + unet::values(&w, &REFINES) + conv_values(1, w[0], 4 * OUTPUTS)
    }
}

/// The network.
#[derive(Module, Debug)]
pub struct InverseNet {
    /// From the pixel-unshuffled inputs to the first level.
    pub stem: Conv,
    /// From each level to the next, with stride 2.
    pub reduce: Vec<Conv>,
    /// At each level of the encoder.
    pub down: Vec<Refine>,
    /// From each level and a skip connection to the next finer level. The coarsest comes first.
    pub enter: Vec<Conv>,
    /// After each of `enter`.
    pub up: Vec<Refine>,
    /// Outputs of four pixels at half size.
    pub fine: Conv,
}

impl InverseNet {
    /// Random weights drawn from `seed`; the outputs are 0.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &InverseConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let init = &mut Init::new(seed, device);
        let w = config.widths;
        let stem = Conv::new(init, 3, 4 * CHANNELS, w[0], 1.4);
        let Layers { reduce, down, enter, up } = Layers::new(init, &w, &REFINES);
        Ok(Self { stem, reduce, down, enter, up, fine: Conv::new(init, 1, w[0], 4 * OUTPUTS, 0.0) })
    }

    /// Runs the network on pixel-unshuffled inputs `[b, h/2, w/2, 4 CHANNELS]`; the result is `[b, h/2, w/2, 4 OUTPUTS]`. h and w
    /// are multiples of [`MULTIPLE`]. A block of four pixels holds its pixels one after another, by rows.
    pub fn forward(&self, products: Products, x: Tensor<4>) -> Tensor<4> {
        let x = self.stem.forward(products, x, Stride::One, true);
        let layers = unet::View { reduce: &self.reduce, down: &self.down, enter: &self.enter, up: &self.up };
        let finest = layers.forward(products, x).swap_remove(0);
        self.fine.forward(products, finest, Stride::One, false)
    }
}

/// Index of the first of `channels` numbers of pixel (`x`, `y`) among the pixel-unshuffled numbers of a picture of `width`
/// columns.
pub fn place(width: usize, channels: usize, x: usize, y: usize) -> usize {
    channels * (4 * (y / 2 * (width / 2) + x / 2) + 2 * (y % 2) + x % 2)
}
