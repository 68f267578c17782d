//! The U-Net: dense 3 x 3 convolutions from 1/2 to 1/16 of the picture, without normalisation.

use super::head::{self, KERNEL};
use super::record::{CHANNELS, Groups};
use crate::network::init::Init;
use crate::network::layers::Conv;
use crate::network::unet::{self, Layers, Refine, conv_values};
use crate::ops::{self, Products, Stride};
use crate::{Error, Result};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

/// Number of levels, at 1/2, 1/4, 1/8 and 1/16 of the picture's size.
pub const LEVELS: usize = 4;
/// Sides of pictures are padded to a multiple of this.
pub const MULTIPLE: usize = 16;

/// Size of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FusionConfig {
    /// Channels of each level: multiples of 16, at most 1024.
    pub widths: [usize; LEVELS],
    /// Residual convolutions of each level, 1 to 8: so many on the way down, and so many on the way up.
    pub refines: [usize; LEVELS],
    /// Whether frames without samples have a U-Net of their own.
    pub separate: bool,
    /// Whether it reads what samples are made of ([`Groups::paths`]). Older weights files say nothing about it and do not.
    pub paths: bool,
    /// Channels of each level of that U-Net; `widths` if not given. It has one residual convolution where the other has some.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plain_widths: Option<[usize; LEVELS]>,
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self { widths: [48, 64, 96, 128], refines: ONE, separate: true, paths: true, plain_widths: None }
    }
}

impl FusionConfig {
    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`](crate::Error::Config) naming the option.
    pub fn validate(&self) -> Result<()> {
        unet::check_widths(&self.widths)?;
        unet::check_refines(&self.refines)?;
        match self.plain_widths {
            Some(_) if !self.separate => Err(Error::config("plain_widths", "are of a U-Net that `separate` adds")),
            Some(widths) => unet::check_widths(&widths),
            None => Ok(()),
        }
    }

    /// Number of values in all parameters.
    pub fn values(&self) -> usize {
        self.plain().map_or(0, |size| size.values(PLAIN)) + self.sampled().values(self.most())
    }

    /// The groups that its U-Net for frames with samples reads.
    pub(super) fn most(&self) -> Groups {
        Groups { paths: self.paths, ..Groups::ALL }
    }

    /// Size of the U-Net for frames with samples.
    pub(super) fn sampled(&self) -> Size {
        Size { widths: self.widths, refines: self.refines }
    }

    /// Size of the U-Net for frames without samples, if they have their own.
    pub(super) fn plain(&self) -> Option<Size> {
        self.separate.then(|| Size { widths: self.plain_widths.unwrap_or(self.widths), refines: ONE })
    }

    /// Largest distance in pixels of an input that an output depends on, rounded up to a [`MULTIPLE`].
    pub(super) fn reach(&self) -> usize {
        // With one convolution in each place: 89 for the U-Net, and 11 for the kernels. The coarsest level has a way down alone.
        let more = (0..LEVELS).map(|level| (self.refines[level] - 1) * if level + 1 < LEVELS { 4 << level } else { 2 << level });
        (100 + more.sum::<usize>()).next_multiple_of(MULTIPLE)
    }
}

/// One residual convolution in each place.
const ONE: [usize; LEVELS] = [1; LEVELS];

/// Size of a U-Net.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    /// Channels of each level.
    pub widths: [usize; LEVELS],
    /// Residual convolutions of each level, on either way.
    pub refines: [usize; LEVELS],
}

impl Size {
    /// Number of values in all parameters of a U-Net for frames with some of the groups `most`.
    fn values(&self, most: Groups) -> usize {
        let w = &self.widths;
        let coarse = if most.samples { conv_values(1, w[1], KERNEL) } else { 0 };
        let ends = conv_values(3, 4 * most.channels(), w[0]) + conv_values(1, w[0], head::fine(most));
        ends + unet::values(w, &self.refines) + coarse
    }
}

/// The groups of frames without samples.
const PLAIN: Groups = Groups { samples: false, neighbours: false, denoised: false, paths: false, ..Groups::ALL };

/// What the names of the parameters of each U-Net begin with.
pub(super) const SAMPLED_PREFIX: &str = "sampled.";
pub(super) const PLAIN_PREFIX: &str = "plain.";

/// The network.
#[derive(Module, Debug)]
pub struct FusionNet {
    /// For frames with samples. If it is the only one, it is for all frames.
    pub sampled: UNet,
    /// For frames without samples.
    pub plain: Option<UNet>,
}

/// One U-Net.
#[derive(Module, Debug)]
pub struct UNet {
    /// From the pixel-unshuffled inputs of all groups to the first level.
    pub stem: Conv,
    /// From each level to the next, with stride 2.
    pub reduce: Vec<Conv>,
    /// At each level of the encoder.
    pub down: Vec<Refine>,
    /// From each level and a skip connection to the next finer level. The coarsest comes first.
    pub enter: Vec<Conv>,
    /// After each of `enter`.
    pub up: Vec<Refine>,
    /// Outputs at half size.
    pub fine: Conv,
    /// Outputs at quarter size: kernels of the coarsest scale. Frames without samples have none.
    pub coarse: Option<Conv>,
}

/// The outputs of the network; see [`head`] for the meaning of the channels.
#[derive(Clone, Debug)]
pub struct Outputs {
    /// `[b, h/2, w/2, head::fine(groups)]`.
    pub fine: Tensor<4>,
    /// `[b, h/4, w/4, KERNEL]`, with samples only.
    pub coarse: Option<Tensor<4>>,
}

impl FusionNet {
    /// Random weights drawn from `seed`; the outputs are 0.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &FusionConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let init = &mut Init::new(seed, device);
        let sampled = UNet::new(init, config.sampled(), config.most());
        Ok(Self { sampled, plain: config.plain().map(|size| UNet::new(init, size, PLAIN)) })
    }

    /// Runs the network on pixel-unshuffled inputs `[b, h/2, w/2, 4 groups.channels()]`. h and w are multiples of [`MULTIPLE`].
    pub fn forward(&self, products: Products, x: Tensor<4>, groups: Groups) -> Outputs {
        self.plain.as_ref().filter(|_| !groups.samples).unwrap_or(&self.sampled).forward(products, x, groups)
    }
}

impl UNet {
    /// Random weights for frames with some of the groups `most`; the outputs are 0.
    fn new(init: &mut Init, size: Size, most: Groups) -> Self {
        let w = &size.widths;
        // About half of the groups are given at a time.
        let stem = Conv::new(init, 3, 4 * most.channels(), w[0], 1.4);
        let Layers { reduce, down, enter, up } = Layers::new(init, w, &size.refines);
        let fine = Conv::new(init, 1, w[0], head::fine(most), 0.0);
        let coarse = most.samples.then(|| Conv::new(init, 1, w[1], KERNEL, 0.0));
        Self { stem, reduce, down, enter, up, fine, coarse }
    }

    fn forward(&self, products: Products, mut x: Tensor<4>, mut groups: Groups) -> Outputs {
        let untold = Groups { paths: false, ..groups };
        // The inputs of `paths` come last, and so do its outputs. A network may have neither.
        let (told, reads) = (groups.paths, self.stem.weight.dims()[2] == 4 * Groups::ALL.channels());
        if told && !reads {
            groups = untold;
            x = x.narrow(3, 0, 4 * groups.channels());
        }
        let x = ops::conv_by(products, x, stem_of(&self.stem.weight, groups), self.stem.bias.val(), Stride::One, true);
        let layers = unet::View { reduce: &self.reduce, down: &self.down, enter: &self.enter, up: &self.up };
        let mut levels = layers.forward(products, x).into_iter();
        let (half, quarter) = (levels.next().expect("the finest level"), levels.next());
        let (outputs, all) = (head::fine(untold), self.fine.bias.dims()[0]);
        let (mut weight, mut bias) = (self.fine.weight.val().narrow(3, 0, outputs), self.fine.bias.val().narrow(0, 0, outputs));
        if told {
            let more = head::fine(Groups { paths: true, ..untold }) - outputs;
            let (more_weight, more_bias) = if reads {
                (self.fine.weight.val().narrow(3, all - more, more), self.fine.bias.val().narrow(0, all - more, more))
            } else {
                // With 0, the head treats indirect light as all other light.
                (weight.clone().narrow(3, 0, more) * 0.0, bias.clone().narrow(0, 0, more) * 0.0)
            };
            weight = Tensor::cat(vec![weight, more_weight], 3);
            bias = Tensor::cat(vec![bias, more_bias], 0);
        }
        let coarse = self.coarse.as_ref().filter(|_| groups.samples).zip(quarter);
        Outputs {
            fine: ops::conv_by(products, half, weight, bias, Stride::One, false),
            coarse: coarse.map(|(coarse, x)| coarse.forward(products, x, Stride::One, false)),
        }
    }
}

/// The weights of the inputs that are given. The other inputs would be zeros. The groups that come last may have no weights.
fn stem_of(weight: &Param<Tensor<4>>, groups: Groups) -> Tensor<4> {
    let weight = weight.val();
    let mut parts = Vec::new();
    let mut from = 0;
    for (channels, given) in CHANNELS.iter().zip(groups.flags()) {
        if given {
            parts.push(weight.clone().narrow(2, 4 * from, 4 * channels));
        }
        from += channels;
    }
    Tensor::cat(parts, 2)
}
