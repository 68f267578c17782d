//! What the loop needs of the renderer's stages: loss and gradients of one batch.

use super::autoencoder::{Parts, Sum, frames};
use super::batch::{LatentBatch, Truth};
use super::config::PixelLoss;
use super::{losses, recompute};
use crate::lpips::Lpips;
use crate::train::runner::{Learner, Lesson};
use crate::wan::flow::{Conditions, Flow, Intrinsic, KeyframeLatent};
use crate::wan::probe::Probe;
use crate::wan::vae::Vae;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};

/// Loss of the renderer, forwards or back.
pub struct FlowLearner {
    /// Frozen, on the recording device.
    pub vae: Vae,
    /// Losses on decoded predictions.
    pub pixels: PixelLoss,
    /// Weight of the squared error of the velocity.
    pub latent: f32,
    /// Weight of LPIPS in the loss of a recovered albedo.
    pub albedo_lpips: f32,
    /// Loaded on the recording device, where wanted.
    pub lpips: Option<Lpips>,
    /// See [`recompute::recomputed`].
    pub recompute: bool,
}

impl Learner for FlowLearner {
    type Batch = LatentBatch;
    type Model = Flow;

    fn learn(&self, model: &Flow, _: u64, mut batch: LatentBatch, device: &Device) -> Result<Lesson> {
        let shape = batch.shape;
        let latents = |values: Vec<f32>| Tensor::<5>::from_data(TensorData::new(values, shape), device);
        let z_t = latents(std::mem::take(&mut batch.z_t));
        let target = latents(std::mem::take(&mut batch.velocity));
        let times: Vec<f64> = batch.times.iter().map(|t| f64::from(*t)).collect();
        let prepared = match batch.intrinsic {
            Some(intrinsic) => model.prepare_inverse(z_t.clone(), &times, intrinsic, &mut Probe::idle())?,
            None => model.prepare(z_t.clone(), &times, &conditions(&mut batch, device)?, &mut Probe::idle())?,
        };
        let judge = |velocity: Tensor<5>| {
            let mut sum = Sum::default();
            sum.add("latent", self.latent, losses::square(velocity.clone(), target));
            if let Some(truth) = &batch.truth {
                let left = batch.times.iter().map(|t| 1.0 - t).collect::<Vec<f32>>();
                let left = Tensor::<1>::from_data(left.as_slice(), device).reshape([shape[0], 1, 1, 1, 1]);
                self.judge_pictures(&mut sum, z_t + velocity * left, batch.intrinsic, truth)?;
            }
            sum.finish()
        };
        let (Parts { total, terms, squares }, gradients) = if self.recompute {
            recompute::recomputed(model, prepared, judge)?
        } else {
            recompute::plain(model, prepared, judge)?
        };
        Ok(Lesson { total, terms, squares, items: shape[0], gradients })
    }
}

impl FlowLearner {
    /// Adds the losses of a window of the decoded latents.
    fn judge_pictures(&self, sum: &mut Sum, latents: Tensor<5>, intrinsic: Option<Intrinsic>, truth: &Truth) -> Result<()> {
        let device = latents.device();
        let window = latents.narrow(3, truth.top, truth.size[0]).narrow(4, truth.left, truth.size[1]);
        let decoded = self.vae.decode(self.vae.denormalise(window), &mut Probe::idle())?.clamp(-1.0, 1.0);
        let [b, _, f, h, w] = decoded.dims();
        let tensor = |values: &[f32], channels: usize| -> Result<Tensor<5>> {
            if values.len() != b * channels * f * h * w {
                let reason = format!("{} values of truth beside {:?} predicted", values.len(), decoded.dims());
                return Err(Error::Data { place: "training data".into(), reason });
            }
            Ok(Tensor::from_data(TensorData::new(values.to_vec(), [b, channels, f, h, w]), &device))
        };
        let (pictures, masks) = (tensor(&truth.pictures, 3)?, tensor(&truth.masks, 1)?);
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
                // The picture is a logarithm of depth already; its three channels are alike.
                let grey = |x: Tensor<5>| x.mean_dim(1);
                sum.add("depth", weight, losses::log_depth(grey(decoded.clone()), grey(pictures.clone()), masks));
            }
            Some(Intrinsic::Material) => {
                sum.add("material", weight, losses::masked_absolute(decoded.clone(), pictures.clone(), masks));
            }
        }
        // Of values of 0..=1, as PSNR is counted.
        sum.compare(losses::square(decoded.without_autodiff(), pictures.without_autodiff()).mul_scalar(0.25));
        Ok(())
    }
}

/// What the renderer is given beside the state, on `device`; the batch is left without it.
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
