//! The U-Net: dense 3 x 3 convolutions at 1/2, 1/4 and 1/8, transformer blocks at 1/16.

use super::env_adapter::EnvironmentAdapter;
use super::init::Init;
use super::layers::{Conv, Modulation, Residual};
use super::transformer::{Block, Rotary};
use crate::config::NetworkConfig;
use crate::ops::Stride;
use burn::module::Module;
use burn::tensor::Tensor;

/// One level on the way down: modulation, residual blocks, then half the resolution.
#[derive(Module, Debug)]
pub struct Down {
    /// Environment and time.
    pub modulate: Modulation,
    /// At this level's resolution.
    pub blocks: Vec<Residual>,
    /// To the next level, stride 2.
    pub reduce: Conv,
}

/// One level on the way up.
#[derive(Module, Debug)]
pub struct Up {
    /// Twice the resolution, joined with the skip connection.
    pub enter: Conv,
    /// Environment and time.
    pub modulate: Modulation,
    /// At this level's resolution.
    pub blocks: Vec<Residual>,
}

/// The base network.
#[derive(Module, Debug)]
pub struct UNet {
    /// Environment tokens and condition.
    pub environment: EnvironmentAdapter,
    /// Pixel-unshuffled input to the first level.
    pub stem: Conv,
    /// 1/2, 1/4, 1/8.
    pub down: Vec<Down>,
    /// At 1/16.
    pub transformer: Vec<Block>,
    /// 1/8, 1/4, 1/2.
    pub up: Vec<Up>,
    /// Zero-initialised: the predictions, pixel-unshuffled.
    pub head: Conv,
    #[module(skip)]
    head_width: usize,
}

impl UNet {
    /// Random weights, except for the head and the modulations, which are zero.
    pub fn new(init: &mut Init, config: &NetworkConfig) -> Self {
        let [w0, w1, w2] = config.widths;
        let c = config.token_width;
        let down = |init: &mut Init, level: usize, next: usize| Down {
            modulate: Modulation::new(init, config.condition_width, config.widths[level]),
            blocks: (0..config.encoder_blocks[level]).map(|_| Residual::new(init, config.widths[level])).collect(),
            reduce: Conv::new(init, 3, config.widths[level], next, 0.7),
        };
        let up = |init: &mut Init, level: usize, from: usize| Up {
            enter: Conv::new(init, 3, from + config.widths[level], config.widths[level], 1.0),
            modulate: Modulation::new(init, config.condition_width, config.widths[level]),
            blocks: (0..config.decoder_blocks[level]).map(|_| Residual::new(init, config.widths[level])).collect(),
        };
        Self {
            environment: EnvironmentAdapter::new(init, config),
            stem: Conv::new(init, 3, 4 * config.pixel_channels(), w0, 1.0),
            down: vec![down(init, 0, w1), down(init, 1, w2), down(init, 2, c)],
            transformer: (0..config.transformer_blocks).map(|_| Block::new(init, config)).collect(),
            up: vec![up(init, 2, c), up(init, 1, w2), up(init, 0, w1)],
            head: Conv::new(init, 3, w0, 4 * config.start.head_channels(), 0.0),
            head_width: c / config.heads,
        }
    }

    /// `x` `[b, h/2, w/2, 4 * pixel_channels]` (pixel-unshuffled, h and w multiples of 16), `tokens` `[b, m, TOKEN_FEATURES]`,
    /// `t` `[b, 1, 1]`. Returns `[b, h/2, w/2, 4 * head_channels]`.
    pub fn forward(&self, x: Tensor<4>, tokens: Tensor<3>, t: Tensor<3>) -> Tensor<4> {
        let (environment, condition) = self.environment.forward(tokens, t);
        let mut x = self.stem.forward(x, Stride::One, true);
        let mut skips = Vec::with_capacity(self.down.len());
        for level in &self.down {
            x = level.modulate.picture(x, condition.clone());
            for block in &level.blocks {
                x = block.forward(x);
            }
            skips.push(x.clone());
            x = level.reduce.forward(x, Stride::Two, false);
        }

        let [b, rows, columns, c] = x.dims();
        let rotary = Rotary::new(rows, columns, self.head_width, &x.device());
        let mut sequence = x.reshape([b, rows * columns, c]);
        for block in &self.transformer {
            sequence = block.forward(sequence, &rotary, environment.clone(), condition.clone());
        }
        x = sequence.reshape([b, rows, columns, c]);

        for (level, skip) in self.up.iter().zip(skips.into_iter().rev()) {
            x = level.modulate.picture(level.enter.decode(x, skip), condition.clone());
            for block in &level.blocks {
                x = block.forward(x);
            }
        }
        self.head.forward(x, Stride::One, false)
    }
}
