//! The causal video autoencoder. It encodes pictures with values -1..=1 to latents at an eighth of the size and a quarter of the
//! frame rate, and decodes latents to pictures.
//!
//! A clip of 1 + 4 k frames is processed in chunks of 1, 4, 4, ... frames, each of which is one latent frame. Every causal
//! convolution keeps the last two frames of its input ([`Cache`]). Memory therefore does not grow with the clip, and the result
//! is the same as for the whole clip at once. On the first chunk, every causal convolution is exactly a two-dimensional
//! convolution with its newest tap, and runs as one.

mod causal;
mod decoder;
mod encoder;
mod residual;
mod tiling;

pub use causal::{Cache, CausalConv};
pub use decoder::Decoder;
pub use encoder::Encoder;
pub use tiling::Tiling;

use super::activations;
use super::config::VaeConfig;
use super::init::Init;
use super::layers::Dense;
use super::names::{self, Entry, Listing, Named};
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

/// The autoencoder; see the module.
#[derive(Module, Debug)]
pub struct Vae {
    /// From pictures to moments, before [`Self::quant`].
    pub encoder: Encoder,
    /// Point-wise layer after the encoder.
    pub quant: Dense,
    /// Point-wise layer before the decoder.
    pub post_quant: Dense,
    /// From latents to pictures.
    pub decoder: Decoder,
    #[module(skip)]
    config: VaeConfig,
}

/// Channels-first to channels-last.
fn to_last(x: Tensor<5>) -> Tensor<5> {
    x.permute([0, 2, 3, 4, 1])
}

/// Channels-last to channels-first.
pub(super) fn to_first(x: Tensor<5>) -> Tensor<5> {
    x.permute([0, 4, 1, 2, 3])
}

impl Vae {
    /// An autoencoder with weights from `seed`, which are made when they are used.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn new(config: &VaeConfig, seed: u64, device: &Device) -> Result<Self> {
        config.validate()?;
        let init = &mut Init::new(seed, device);
        Ok(Self {
            encoder: Encoder::new(init, config),
            quant: Dense::new(init, 2 * config.z_dim, 2 * config.z_dim),
            post_quant: Dense::new(init, config.z_dim, config.z_dim),
            decoder: Decoder::new(init, config),
            config: config.clone(),
        })
    }

    /// The device of its parameters.
    pub(crate) fn device(&self) -> Device {
        self.post_quant.weight.device()
    }

    /// The configuration of the network.
    pub fn config(&self) -> &VaeConfig {
        &self.config
    }

    /// The moments of the latents of pictures `[b, channels, 1 + k f, h, w]` with values -1..=1: means, then logarithms of
    /// variances, `[b, 2 z, 1 + k, h / s, w / s]`, where f and s are the factors of the configuration. Sizes are rounded down, as
    /// in the original code, so pixels beyond the last multiple of s are lost. [`Self::encode`] refuses such pictures.
    ///
    /// # Errors
    /// [`Error::Data`] when the size does not fit.
    pub fn moments(&self, pictures: Tensor<5>) -> Result<Tensor<5>> {
        let [_, c, t, h, w] = pictures.dims();
        let (config, factor) = (&self.config, self.config.spatial_factor());
        let frames = config.temporal_factor();
        expect(c == config.in_channels, || format!("{c} channels where the autoencoder reads {}", config.in_channels))?;
        expect(config.latent_frames(t).is_some(), || format!("{t} frames; 1 more than a multiple of {frames} is needed"))?;
        expect(h.min(w) >= factor, || format!("a picture of {w}x{h}; {factor}x{factor} is the smallest"))?;
        Ok(self.moments_after(Cache::new(), pictures))
    }

    /// [`Self::moments`] for a size that fits, beginning with this cache.
    #[doc(hidden)]
    pub fn moments_after(&self, mut cache: Cache, pictures: Tensor<5>) -> Tensor<5> {
        let (t, frames) = (pictures.dims()[2], self.config.temporal_factor());
        let mut chunks = vec![self.moments_next(pictures.clone().narrow(2, 0, 1), &mut cache)];
        activations::unrecorded(|| {
            for start in (1..t).step_by(frames) {
                let chunk = pictures.clone().narrow(2, start, frames);
                chunks.push(self.moments_next(chunk, &mut cache));
            }
        });
        Tensor::cat(chunks, 2)
    }

    /// The moments of the next latent frame of a clip that arrives in chunks: `[b, channels, t, h, w]` to `[b, 2 z, 1, h / s, w /
    /// s]`. With a new cache, t is 1; then it is the number of frames that a latent frame spans. All chunks have the same size.
    pub fn moments_next(&self, pictures: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        to_first(self.quant.clip(self.encoder.forward(to_last(pictures), cache)))
    }

    /// The latents of pictures before normalisation, `[b, z, 1 + k, h / s, w / s]`: the means of [`Self::moments`].
    ///
    /// # Errors
    /// [`Error::Data`] when the size does not fit, or when height or width is not a multiple of s.
    pub fn encode(&self, pictures: Tensor<5>) -> Result<Tensor<5>> {
        self.check_encode(&pictures)?;
        Ok(self.moments(pictures)?.narrow(1, 0, self.config.z_dim))
    }

    fn check_encode(&self, pictures: &Tensor<5>) -> Result<()> {
        let ([_, _, _, h, w], factor) = (pictures.dims(), self.config.spatial_factor());
        let fits = h.is_multiple_of(factor) && w.is_multiple_of(factor);
        expect(fits, || format!("a picture of {w}x{h}; multiples of {factor} are needed"))
    }

    /// The normalised latents of pictures, which the transformer reads.
    ///
    /// # Errors
    /// As for [`Self::encode`].
    pub fn encode_normalised(&self, pictures: Tensor<5>) -> Result<Tensor<5>> {
        Ok(self.normalise(self.encode(pictures)?))
    }

    /// Decodes latents that are not normalised: `[b, z, 1 + k, h, w]` to pictures `[b, channels, 1 + k f, s h, s w]`. Values are
    /// about -1..=1, and not clamped.
    ///
    /// # Errors
    /// [`Error::Data`] when the size does not fit.
    pub fn decode(&self, latents: Tensor<5>) -> Result<Tensor<5>> {
        let [_, z, t, h, w] = latents.dims();
        expect(z == self.config.z_dim, || format!("{z} channels where a latent has {}", self.config.z_dim))?;
        expect(t > 0 && h > 0 && w > 0, || format!("an empty latent, {t} frames of {w}x{h}"))?;
        Ok(self.decode_after(Cache::new(), latents))
    }

    /// [`Self::decode`] for a size that fits, beginning with this cache.
    #[doc(hidden)]
    pub fn decode_after(&self, mut cache: Cache, latents: Tensor<5>) -> Tensor<5> {
        let mut pictures = vec![self.decode_next(latents.clone().narrow(2, 0, 1), &mut cache)];
        activations::unrecorded(|| {
            for i in 1..latents.dims()[2] {
                pictures.push(self.decode_next(latents.clone().narrow(2, i, 1), &mut cache));
            }
        });
        Tensor::cat(pictures, 2)
    }

    /// Decodes the next latent frame of a clip: `[b, z, 1, h, w]` to `[b, channels, t, s h, s w]`. With a new cache, t is 1; then
    /// it is the number of frames that a latent frame spans.
    pub fn decode_next(&self, latent: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        let x = self.post_quant.clip(to_last(latent));
        activations::report("dec.post_quant_conv", || to_first(x.clone()));
        to_first(self.decoder.forward(x, cache))
    }

    /// Decodes normalised latents to pictures, which are clamped to -1..=1.
    ///
    /// # Errors
    /// As for [`Self::decode`].
    pub fn decode_normalised(&self, latents: Tensor<5>) -> Result<Tensor<5>> {
        Ok(self.decode(self.denormalise(latents))?.clamp(-1.0, 1.0))
    }

    /// `(z - mean) / std` for each channel.
    pub fn normalise(&self, latents: Tensor<5>) -> Tensor<5> {
        let (mean, std) = self.statistics(&latents.device());
        (latents - mean) / std
    }

    /// `z std + mean` for each channel, the inverse of [`Self::normalise`].
    pub fn denormalise(&self, latents: Tensor<5>) -> Tensor<5> {
        let (mean, std) = self.statistics(&latents.device());
        latents * std + mean
    }

    /// Mean and standard deviation as `[1, z, 1, 1, 1]`.
    fn statistics(&self, device: &Device) -> (Tensor<5>, Tensor<5>) {
        let shape = [1, self.config.z_dim, 1, 1, 1];
        let tensor = |values: &[f32]| Tensor::from_data(TensorData::new(values.to_vec(), shape), device);
        (tensor(&self.config.latents_mean), tensor(&self.config.latents_std))
    }
}

fn expect(valid: bool, reason: impl FnOnce() -> String) -> Result<()> {
    if valid { Ok(()) } else { Err(Error::Data { place: "autoencoder".into(), reason: reason() }) }
}

impl Named for Vae {
    fn entries(&self) -> Vec<Entry> {
        let mut list = Listing::new(names::vae_original);
        self.encoder.list(&mut list);
        let z = self.config.z_dim;
        self.quant.list(&mut list, "quant_conv", &[2 * z, 1, 1, 1]);
        self.post_quant.list(&mut list, "post_quant_conv", &[z, 1, 1, 1]);
        self.decoder.list(&mut list);
        list.into_entries()
    }
}
