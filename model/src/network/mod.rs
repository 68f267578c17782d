//! The compact network: pixel-unshuffle codec, U-Net with a transformer at its bottom, demodulated heads, keyframe stage.

pub mod env_adapter;
pub mod heads;
pub mod init;
pub mod layers;
pub mod transformer;
pub mod unet;

use crate::Result;
use crate::config::NetworkConfig;
use crate::keyframe::KeyframeNet;
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use init::Init;
use unet::UNet;

/// Pictures are padded to a multiple of this before the network sees them.
pub const PIXEL_MULTIPLE: usize = 32;

/// The whole network of one weights file.
#[derive(Module, Debug)]
pub struct Network {
    /// Works from the G-buffer and the environment alone.
    pub base: UNet,
    /// Repairs warped keyframes; trained after the base, which it leaves as it is.
    pub keyframes: Option<KeyframeNet>,
    #[module(skip)]
    config: NetworkConfig,
}

impl Network {
    /// A network with random weights drawn from `seed`; its first prediction is the start picture exactly.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &NetworkConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        Ok(Self {
            base: UNet::new(&mut Init::new(seed, device), config),
            keyframes: config.keyframes.as_ref().map(|keyframes| KeyframeNet::new(&mut Init::new(seed, device), keyframes)),
            config: config.clone(),
        })
    }

    /// What the network is.
    pub fn config(&self) -> &NetworkConfig {
        &self.config
    }

    /// Head outputs of the base network, `[b, h, w, head_channels]`.
    ///
    /// `x` `[b, h/2, w/2, 4 * pixel_channels]` (see [`unshuffle`] for the order), `tokens` `[b, m, TOKEN_FEATURES]`, `t` `[b, 1, 1]`.
    pub fn heads(&self, x: Tensor<4>, tokens: Tensor<3>, t: Tensor<3>) -> Tensor<4> {
        shuffle(self.base.forward(x, tokens, t))
    }
}

/// Pixel shuffle by 2: `[b, h, w, 4 c]` to `[b, 2h, 2w, c]`; inverse of [`unshuffle`].
pub fn shuffle(x: Tensor<4>) -> Tensor<4> {
    let [b, h, w, c] = x.dims();
    x.reshape([b, h, w, 2, 2, c / 4]).permute([0, 1, 3, 2, 4, 5]).reshape([b, 2 * h, 2 * w, c / 4])
}

/// Pixel unshuffle by 2: `[b, 2h, 2w, c]` to `[b, h, w, 4 c]`; output channel `(2 dy + dx) c + i` is channel i of pixel (2x + dx, 2y + dy).
pub fn unshuffle(x: Tensor<4>) -> Tensor<4> {
    let [b, h, w, c] = x.dims();
    x.reshape([b, h / 2, 2, w / 2, 2, c]).permute([0, 1, 3, 2, 4, 5]).reshape([b, h / 2, w / 2, 4 * c])
}
