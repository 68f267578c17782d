//! The decoder, from latents to pictures.

use super::causal::{Cache, CausalConv};
use super::encoder::Conv;
use super::residual::{Middle, Residual};
use super::to_first;
use crate::ops::Stride;
use crate::wan::activations;
use crate::wan::config::VaeConfig;
use crate::wan::init::Init;
use crate::wan::layers::ChannelNorm;
use crate::wan::names::Listing;
use burn::module::Module;
use burn::tensor::Tensor;

/// Doubles height and width and halves the channels. With a convolution over time, it also doubles the frame rate.
#[derive(Module, Debug)]
pub struct Up {
    time: Option<CausalConv>,
    conv: Conv,
}

impl Up {
    fn new(init: &mut Init, width: usize, temporal: bool) -> Self {
        Self { time: temporal.then(|| CausalConv::new(init, 1, width, 2 * width)), conv: Conv::new(init, width, width / 2) }
    }

    /// `[b, t, h, w, c]` to `[b, t', 2 h, 2 w, c / 2]`.
    fn forward(&self, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        let x = match &self.time {
            Some(time) => Self::double(time, x, cache),
            None => x,
        };
        let [b, t, h, w, c] = x.dims();
        let y = self.conv.forward(x.reshape([b * t, h, w, c]), Stride::Up);
        y.reshape([b, t, 2 * h, 2 * w, c / 2])
    }

    /// Doubles the frames. The first frame of a clip stays a single frame, and later frames do not depend on it.
    fn double(time: &CausalConv, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        if cache.is_first() {
            cache.skip();
            return x;
        }
        let [b, t, h, w, c] = x.dims();
        let y = time.over(cache.extend(x, 2), t);
        // The first half of the channels is the earlier frame.
        y.reshape([b, t, h, w, 2, c]).permute([0, 1, 4, 2, 3, 5]).reshape([b, 2 * t, h, w, c])
    }

    fn list(&self, list: &mut Listing, name: &str) {
        self.conv.list(list, &format!("{name}.resample.1"));
        if let Some(time) = &self.time {
            time.list(list, &format!("{name}.time_conv"));
        }
    }
}

/// The residual blocks at one resolution, and the enlargement after them.
#[derive(Module, Debug)]
pub struct Level {
    residuals: Vec<Residual>,
    up: Option<Up>,
}

/// The decoder; see [`super`].
#[derive(Module, Debug)]
pub struct Decoder {
    conv_in: CausalConv,
    middle: Middle,
    levels: Vec<Level>,
    norm_out: ChannelNorm,
    conv_out: CausalConv,
}

impl Decoder {
    pub(super) fn new(init: &mut Init, config: &VaeConfig) -> Self {
        let multiples = config.dim_mult.iter().rev();
        let mut width = config.dim_mult.last().map_or(1, |m| m * config.decoder_base_dim);
        let conv_in = CausalConv::new(init, 3, config.z_dim, width);
        let middle = Middle::new(init, width);
        let mut temporal = config.temporal_downsample.iter().rev();
        let levels = multiples
            .map(|multiple| {
                let to = multiple * config.decoder_base_dim;
                let residuals = (0..=config.num_res_blocks).map(|i| Residual::new(init, if i == 0 { width } else { to }, to));
                let residuals = residuals.collect();
                let up = temporal.next().map(|&temporal| Up::new(init, to, temporal));
                width = to / 2;
                Level { residuals, up }
            })
            .collect();
        let width = config.dim_mult.first().map_or(1, |m| m * config.decoder_base_dim);
        Self {
            conv_in,
            middle,
            levels,
            norm_out: ChannelNorm::new(init, width),
            conv_out: CausalConv::new(init, 3, width, config.out_channels),
        }
    }

    /// Decodes one latent frame after [`super::Vae::post_quant`], `[b, 1, h, w, z]`, to `[b, t, s h, s w, channels]`,
    /// channels-last. With a new cache, t is 1; then it is the number of frames that a latent frame spans.
    pub fn forward(&self, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        cache.begin();
        let x = self.conv_in.forward(x, cache);
        activations::report("dec.conv_in", || to_first(x.clone()));
        let mut x = self.middle.forward(x, cache, "dec");
        for (i, level) in self.levels.iter().enumerate() {
            for residual in &level.residuals {
                x = residual.forward(x, cache);
            }
            if let Some(up) = &level.up {
                x = up.forward(x, cache);
            }
            activations::report(&format!("dec.up_blocks.{i}"), || to_first(x.clone()));
        }
        self.conv_out.forward(self.norm_out.forward_silu(x), cache)
    }

    pub(super) fn list(&self, list: &mut Listing) {
        self.conv_in.list(list, "decoder.conv_in");
        self.middle.list(list, "decoder.mid_block");
        // The original files number residual blocks and enlargements together.
        let mut flat = 0;
        for (i, level) in self.levels.iter().enumerate() {
            let mut next = || {
                flat += 1;
                format!("decoder.upsamples.{}", flat - 1)
            };
            for (j, residual) in level.residuals.iter().enumerate() {
                list.within(format!("decoder.up_blocks.{i}.resnets.{j}"), next(), |list, name| residual.list(list, name));
            }
            if let Some(up) = &level.up {
                list.within(format!("decoder.up_blocks.{i}.upsamplers.0"), next(), |list, name| up.list(list, name));
            }
        }
        self.norm_out.list(list, "decoder.norm_out", 3);
        self.conv_out.list(list, "decoder.conv_out");
    }
}
