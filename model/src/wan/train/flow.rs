//! The loss of the renderer, and of its adapters.

use super::config::PixelLoss;
use super::latent_batch::{LatentBatch, Truth};
use super::losses::{self, LossSum, frames};
use super::recompute;
use crate::lpips::Lpips;
use crate::train::runner::{Objective, StepResult};
use crate::wan::flow::{Conditions, Flow, Intrinsic, KeyframeLatent};
use crate::wan::vae::Vae;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};

/// The loss of rendering or of inverse rendering.
pub struct FlowObjective {
    /// The frozen autoencoder, on the recording device.
    pub vae: Vae,
    /// Losses of decoded predictions.
    pub pixels: PixelLoss,
    /// Weight of the squared error of the velocity.
    pub latent: f32,
    /// Weight of LPIPS in the loss of a recovered albedo.
    pub albedo_lpips: f32,
    /// LPIPS on the recording device, if it is part of the loss.
    pub lpips: Option<Lpips>,
    /// Whether activations are computed again in the backward pass; see [`recompute::recomputed`].
    pub recompute: bool,
}

impl Objective for FlowObjective {
    type Batch = LatentBatch;
    type Model = Flow;

    fn step(&self, model: &Flow, mut batch: LatentBatch, device: &Device) -> Result<StepResult> {
        let shape = batch.shape;
        let latents = |values: Vec<f32>| Tensor::<5>::from_data(TensorData::new(values, shape), device);
        let z_t = latents(std::mem::take(&mut batch.z_t));
        let target = latents(std::mem::take(&mut batch.velocity));
        let times: Vec<f64> = batch.times.iter().map(|t| f64::from(*t)).collect();
        let prepared = match batch.intrinsic {
            Some(intrinsic) => model.prepare_inverse(z_t.clone(), &times, intrinsic)?,
            None => model.prepare(z_t.clone(), &times, &conditions(&mut batch, device)?)?,
        };
        let loss = |velocity: Tensor<5>| {
            let mut sum = LossSum::default();
            sum.add("latent", self.latent, losses::square(velocity.clone(), target));
            if let Some(truth) = &batch.truth {
                let left = batch.times.iter().map(|t| 1.0 - t).collect::<Vec<f32>>();
                let left = Tensor::<1>::from_data(left.as_slice(), device).reshape([shape[0], 1, 1, 1, 1]);
                self.add_pixel_losses(&mut sum, z_t + velocity * left, batch.intrinsic, truth)?;
            }
            sum.finish()
        };
        let (report, gradients) =
            if self.recompute { recompute::recomputed(model, prepared, loss)? } else { recompute::plain(model, prepared, loss)? };
        Ok(report.result(shape[0], gradients))
    }
}

impl FlowObjective {
    /// Pictures from normalised latents, clamped to -1..=1.
    fn decode(&self, latents: Tensor<5>) -> Result<Tensor<5>> {
        Ok(self.vae.decode(self.vae.denormalise(latents))?.clamp(-1.0, 1.0))
    }

    /// Decodes a window of the latents and adds the losses of its pictures.
    fn add_pixel_losses(&self, sum: &mut LossSum, latents: Tensor<5>, intrinsic: Option<Intrinsic>, truth: &Truth) -> Result<()> {
        let device = latents.device();
        let shape = latents.dims();
        let window = latents.narrow(3, truth.top, truth.size[0]).narrow(4, truth.left, truth.size[1]);
        let mut decoded = self.decode(window)?;
        let size = decoded.dims();
        let [b, _, f, h, w] = size;
        let tensor = |values: &[f32], channels: usize| -> Result<Tensor<5>> {
            if values.len() != b * channels * f * h * w {
                let reason = format!("{} values of truth beside {size:?} predicted", values.len());
                return Err(Error::Data { place: "training data".into(), reason });
            }
            Ok(Tensor::from_data(TensorData::new(values.to_vec(), [b, channels, f, h, w]), &device))
        };
        let (pictures, masks) = (tensor(&truth.pictures, 3)?, tensor(&truth.masks, 1)?);
        if let Some(start) = &truth.start {
            let mut shape = shape;
            [shape[3], shape[4]] = truth.size;
            let latents = Tensor::from_data(TensorData::new(start.latents.clone(), shape), &device);
            decoded = decoded + tensor(&start.pictures, 3)? - self.decode(latents)?;
        }
        let weight = self.pixels.weight;
        let lpips = |a: Tensor<5>, b: Tensor<5>| self.lpips.as_ref().map(|lpips| lpips.loss(frames(a), frames(b))).transpose();
        match intrinsic {
            None => {
                if let Some(distance) = lpips(decoded.clone(), pictures.clone())? {
                    sum.add("lpips", weight * self.pixels.lpips, distance);
                }
                sum.add("gradient", weight * self.pixels.gradient, losses::gradient(decoded.clone(), pictures.clone()));
            }
            Some(Intrinsic::Albedo) => {
                sum.add("albedo", weight, losses::absolute(decoded.clone(), pictures.clone()));
                if let Some(distance) = lpips(decoded.clone(), pictures.clone())? {
                    sum.add("lpips", weight * self.albedo_lpips, distance);
                }
            }
            Some(Intrinsic::Normal) => sum.add("normal", weight, losses::angle(decoded.clone(), pictures.clone(), masks)),
            Some(Intrinsic::Depth) => {
                // The picture holds the logarithm of depth in three equal channels.
                let grey = |x: Tensor<5>| x.mean_dim(1);
                sum.add("depth", weight, losses::log_depth(grey(decoded.clone()), grey(pictures.clone()), masks));
            }
            Some(Intrinsic::Material) => {
                sum.add("material", weight, losses::masked_absolute(decoded.clone(), pictures.clone(), masks));
            }
        }
        sum.compare(decoded, pictures);
        Ok(())
    }
}

/// Moves the conditions of the renderer from the batch to `device`.
fn conditions(batch: &mut LatentBatch, device: &Device) -> Result<Conditions> {
    let [b, z, f, h, w] = batch.shape;
    let tensor = |values: Vec<f32>, [c, f]: [usize; 2]| -> Result<Tensor<5>> {
        if values.len() != b * c * f * h * w {
            let reason = format!("{} values where {b} x {c} x {f} x {h} x {w} are expected", values.len());
            return Err(Error::Data { place: "training data".into(), reason });
        }
        Ok(Tensor::from_data(TensorData::new(values, [b, c, f, h, w]), device))
    };
    let channels = batch.attributes.len() / (b * f * h * w).max(1);
    let keyframes = std::mem::take(&mut batch.keyframes);
    Ok(Conditions {
        attributes: tensor(std::mem::take(&mut batch.attributes), [channels, f])?,
        environment: tensor(std::mem::take(&mut batch.environment), [z, f])?,
        keyframes: keyframes
            .into_iter()
            .map(|(latent, time)| Ok(KeyframeLatent { latent: tensor(latent, [z, 1])?, time }))
            .collect::<Result<_>>()?,
    })
}
