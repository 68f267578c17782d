//! Configurations of the networks: presets and limits. `config_file` reads published configuration files.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Mean of each latent channel of the published autoencoder.
const LATENTS_MEAN: [f32; 16] = [
    -0.7571, -0.7089, -0.9113, 0.1075, -0.1745, 0.9653, -0.1517, 1.5508, 0.4134, -0.0715, 0.5517, -0.3632, -0.1922, -0.9497,
    0.2503, -0.2921,
];
/// Standard deviation of each latent channel of the published autoencoder.
const LATENTS_STD: [f32; 16] = [
    2.8184, 1.4541, 2.3275, 2.6558, 1.2196, 1.7708, 2.6052, 2.0743, 3.2687, 2.1526, 2.8652, 1.5579, 1.6382, 1.1253, 2.8251,
    1.9160,
];

/// The autoencoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaeConfig {
    /// Channels of the encoder at full resolution.
    pub base_dim: usize,
    /// Channels of the decoder at full resolution.
    pub decoder_base_dim: usize,
    /// Latent channels.
    pub z_dim: usize,
    /// Channels of each level as multiples of the base. Each level but the last halves the resolution.
    pub dim_mult: Vec<usize>,
    /// Number of residual blocks in each encoder level. A decoder level has one more.
    pub num_res_blocks: usize,
    /// Whether the reduction after each level but the last also halves the frame rate. The decoder reverses it.
    pub temporal_downsample: Vec<bool>,
    /// Channels of input pictures.
    pub in_channels: usize,
    /// Channels of output pictures.
    pub out_channels: usize,
    /// Mean of each latent channel, for normalisation.
    pub latents_mean: Vec<f32>,
    /// Standard deviation of each latent channel.
    pub latents_std: Vec<f32>,
}

impl VaeConfig {
    /// The autoencoder of Wan2.1, 126.9 M parameters.
    pub fn wan() -> Self {
        Self {
            base_dim: 96,
            decoder_base_dim: 96,
            z_dim: 16,
            dim_mult: vec![1, 2, 4, 4],
            num_res_blocks: 2,
            temporal_downsample: vec![false, true, true],
            in_channels: 3,
            out_channels: 3,
            latents_mean: LATENTS_MEAN.to_vec(),
            latents_std: LATENTS_STD.to_vec(),
        }
    }

    /// The same graph at a size for unit tests. Latents are not normalised.
    pub fn tiny() -> Self {
        Self { base_dim: 8, decoder_base_dim: 8, z_dim: 4, latents_mean: vec![0.0; 4], latents_std: vec![1.0; 4], ..Self::wan() }
    }

    /// Number of pixels that a latent pixel spans in height and in width.
    pub fn spatial_factor(&self) -> usize {
        1 << (self.dim_mult.len() - 1)
    }

    /// Number of frames that a latent frame spans. The first latent frame spans one.
    pub fn temporal_factor(&self) -> usize {
        1 << self.temporal_downsample.iter().filter(|&&halved| halved).count()
    }

    /// Number of latent frames of a clip of `frames` pictures. `None` unless `frames` is 1 more than a multiple of
    /// [`Self::temporal_factor`].
    pub fn latent_frames(&self, frames: usize) -> Option<usize> {
        let factor = self.temporal_factor();
        (frames >= 1 && (frames - 1).is_multiple_of(factor)).then(|| 1 + (frames - 1) / factor)
    }

    /// Checks that the configuration describes a network.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        let levels = self.dim_mult.len();
        check("vae.dim_mult", (1..=6).contains(&levels) && self.dim_mult.iter().all(|&m| (1..=64).contains(&m)))?;
        check("vae.temporal_downsample", self.temporal_downsample.len() + 1 == levels)?;
        for (option, dim) in [("vae.base_dim", self.base_dim), ("vae.decoder_base_dim", self.decoder_base_dim)] {
            check(option, (1..=4096).contains(&dim))?;
        }
        // Each enlargement halves the channels.
        let halved = self.dim_mult.iter().skip(1).all(|m| (m * self.decoder_base_dim).is_multiple_of(2));
        if !halved {
            return Err(Error::config("vae.decoder_base_dim", "the channels of a decoder level are halved and must be even"));
        }
        check("vae.num_res_blocks", (1..=16).contains(&self.num_res_blocks))?;
        check("vae.z_dim", (1..=1024).contains(&self.z_dim))?;
        check("vae.in_channels", (1..=1024).contains(&self.in_channels))?;
        check("vae.out_channels", (1..=1024).contains(&self.out_channels))?;
        let (mean, std) = (&self.latents_mean, &self.latents_std);
        if mean.len() != self.z_dim || mean.iter().any(|m| !m.is_finite()) {
            return Err(Error::config("vae.latents_mean", format!("{} finite numbers are needed", self.z_dim)));
        }
        if std.len() != self.z_dim || !std.iter().all(|s| s.is_finite() && *s > 0.0) {
            return Err(Error::config("vae.latents_std", format!("{} positive numbers are needed", self.z_dim)));
        }
        Ok(())
    }
}

/// The form of GELU, `x Phi(x)`, in the perceptrons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gelu {
    /// `x / 2 (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3)))`, with which Wan was trained.
    #[default]
    Tanh,
    /// The exact form, by the error function.
    Erf,
}

/// The diffusion transformer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DitConfig {
    /// Number of attention heads.
    pub heads: usize,
    /// Channels of a head, an even number.
    pub head_dim: usize,
    /// Hidden width of a block's perceptron.
    pub ffn_dim: usize,
    /// Number of blocks.
    pub layers: usize,
    /// Channels of a text token. `None` for the graph without text, which has no text embedder and no cross-attention.
    pub text_dim: Option<usize>,
    /// Length of the timestep's sinusoidal embedding, an even number.
    pub freq_dim: usize,
    /// Channels of input latents.
    pub in_channels: usize,
    /// Channels of output latents.
    pub out_channels: usize,
    /// Latent frames, rows and columns that a token covers.
    pub patch_size: [usize; 3],
    /// Whether a learned layer normalisation precedes cross-attention.
    pub cross_attn_norm: bool,
    /// Constant that layer normalisation adds to the variance.
    pub layer_norm_eps: f64,
    /// Constant that the normalisation of queries and keys adds to the mean square.
    pub qk_norm_eps: f64,
    /// Nonlinearity of the perceptrons (blocks and text embedder).
    pub activation: Gelu,
    /// Base of the rotary frequencies.
    pub rope_theta: f64,
}

impl DitConfig {
    /// The transformer of Wan2.1 T2V-1.3B, 1,419.0 M parameters.
    pub fn wan_1_3b() -> Self {
        Self {
            heads: 12,
            head_dim: 128,
            ffn_dim: 8960,
            layers: 30,
            text_dim: Some(4096),
            freq_dim: 256,
            in_channels: 16,
            out_channels: 16,
            patch_size: [1, 2, 2],
            cross_attn_norm: true,
            layer_norm_eps: 1e-6,
            qk_norm_eps: 1e-6,
            activation: Gelu::Tanh,
            rope_theta: 10_000.0,
        }
    }

    /// The same graph at a size for unit tests.
    pub fn tiny() -> Self {
        Self {
            heads: 2,
            head_dim: 16,
            ffn_dim: 64,
            layers: 2,
            text_dim: Some(24),
            freq_dim: 32,
            in_channels: 4,
            out_channels: 4,
            ..Self::wan_1_3b()
        }
    }

    /// The same transformer without its text path, which is RenderFlow's backbone.
    pub fn without_text(self) -> Self {
        Self { text_dim: None, ..self }
    }

    /// A preset by name: `wan-1.3b` or `wan-tiny`.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "wan-1.3b" => Some(Self::wan_1_3b()),
            "wan-tiny" => Some(Self::tiny()),
            _ => None,
        }
    }

    /// Channels of a token.
    pub fn width(&self) -> usize {
        self.heads * self.head_dim
    }

    /// Number of latent values that a token covers in each channel.
    pub fn patch_values(&self) -> usize {
        self.patch_size.iter().product()
    }

    /// Checks that the configuration describes a network.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        check("dit.heads", (1..=256).contains(&self.heads))?;
        check("dit.layers", (1..=256).contains(&self.layers))?;
        check("dit.ffn_dim", (1..=1 << 17).contains(&self.ffn_dim))?;
        check("dit.in_channels", (1..=4096).contains(&self.in_channels))?;
        check("dit.out_channels", (1..=4096).contains(&self.out_channels))?;
        check("dit.patch_size", self.patch_size.iter().all(|p| (1..=16).contains(p)))?;
        if !(6..=1024).contains(&self.head_dim) || !self.head_dim.is_multiple_of(2) {
            return Err(Error::config(
                "dit.head_dim",
                "must be even and 6 to 1024: each axis turns at least one pair of channels",
            ));
        }
        if !(2..=1 << 16).contains(&self.freq_dim) || !self.freq_dim.is_multiple_of(2) {
            return Err(Error::config("dit.freq_dim", "must be even: one half is cosines, the other sines"));
        }
        check("dit.text_dim", self.text_dim.is_none_or(|dim| (1..=1 << 16).contains(&dim)))?;
        for (option, eps) in [("dit.layer_norm_eps", self.layer_norm_eps), ("dit.qk_norm_eps", self.qk_norm_eps)] {
            if !(1e-12..=1e-2).contains(&eps) {
                return Err(Error::config(option, "must be from 1e-12 to 0.01"));
            }
        }
        check("dit.rope_theta", (1.0..=1e12).contains(&self.rope_theta))
    }
}

/// The transformer with VACE's context path.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VaceConfig {
    /// The transformer.
    pub dit: DitConfig,
    /// Blocks of the transformer that receive a hint, ascending from 0. Each has one context block.
    pub vace_layers: Vec<usize>,
    /// Channels of the context.
    pub vace_in_channels: usize,
}

impl VaceConfig {
    /// VACE-1.3B, 2,154.0 M parameters.
    pub fn wan_1_3b() -> Self {
        Self { dit: DitConfig::wan_1_3b(), vace_layers: (0..30).step_by(2).collect(), vace_in_channels: 96 }
    }

    /// The same graph at a size for unit tests.
    pub fn tiny() -> Self {
        Self { dit: DitConfig::tiny(), vace_layers: vec![0, 1], vace_in_channels: 24 }
    }

    /// Checks that the configuration describes a network.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        self.dit.validate()?;
        check("vace_in_channels", (1..=4096).contains(&self.vace_in_channels))?;
        let ascending = self.vace_layers.windows(2).all(|pair| pair[0] < pair[1]);
        let inside = self.vace_layers.last().is_some_and(|&last| last < self.dit.layers);
        if self.vace_layers.first() != Some(&0) || !ascending || !inside {
            let reason = format!("must ascend from 0 and stay below the {} blocks of the transformer", self.dit.layers);
            return Err(Error::config("vace_layers", reason));
        }
        Ok(())
    }
}

fn check(option: &'static str, valid: bool) -> Result<()> {
    if valid { Ok(()) } else { Err(Error::config(option, "out of range")) }
}
