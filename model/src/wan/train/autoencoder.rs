//! Training of an autoencoder on pictures of all kinds: absolute error, gradients, a small divergence term, and LPIPS on request.

use super::clip_pictures::{ClipPictures, Window};
use super::config::{AutoencoderLoss, BatchConfig, Config};
use super::losses::{self, LossSum, frames};
use crate::data::{ClipSource, step_rng};
use crate::lpips::Lpips;
use crate::network::init::normal;
use crate::parameters::{self, read};
use crate::train::runner::{Objective, StepResult};
use crate::train::{Share, draw_weighted};
use crate::wan::config::VaeConfig;
use crate::wan::pictures::Kind;
use crate::wan::vae::Vae;
use crate::{Error, Result};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

/// Pictures, and the noise with which their latents are drawn.
pub struct PictureBatch {
    /// Numbers of items, frames, rows and columns.
    pub shape: [usize; 4],
    /// `[items, 3, frames, height, width]`, -1..=1.
    pub pictures: Vec<f32>,
    /// Standard normal values, one for each latent value.
    pub noise: Vec<f32>,
}

impl PictureBatch {
    /// Draws a batch of one of the kinds in `batches`, by weight, and makes the `share` of this process. Each item is a window of
    /// a random kind of picture.
    ///
    /// # Errors
    /// When no clip has enough frames in a row.
    pub fn draw(
        config: &VaeConfig,
        batches: &[BatchConfig],
        clips: &[Arc<ClipPictures>],
        share: Share,
        rng: &mut Pcg64Mcg,
    ) -> Result<Self> {
        let kind = batches[draw_weighted(batches.iter().map(|b| b.weight), rng)];
        let starts: Vec<(usize, usize)> = clips
            .iter()
            .enumerate()
            .flat_map(|(i, clip)| clip.starts(kind.frames - 1).into_iter().map(move |frame| (i, frame)))
            .collect();
        if starts.is_empty() {
            let reason = format!("no {} frames in a row in the clips in memory", kind.frames);
            return Err(Error::Data { place: "training data".into(), reason });
        }
        let made = share.of(kind.items);
        let mut pictures = Vec::with_capacity(made.len() * 3 * kind.frames * kind.size * kind.size);
        for i in 0..kind.items {
            let (clip, frame) = starts[rng.random_range(0..starts.len())];
            let clip = &clips[clip];
            let picture = Kind::ALL[rng.random_range(0..Kind::ALL.len())];
            let window = Window {
                top: rng.random_range(0..=clip.height - kind.size),
                left: rng.random_range(0..=clip.width - kind.size),
                height: kind.size,
                width: kind.size,
            };
            if made.contains(&i) {
                pictures.extend(clip.clip(frame, kind.frames, picture, window));
            }
        }
        let side = kind.size / config.spatial_factor();
        let frames = config.latent_frames(kind.frames).unwrap_or(1);
        let values = config.z_dim * frames * side * side;
        let noise: Vec<f32> = (0..made.end * values).map(|_| normal(rng)).collect();
        let noise = noise[made.start * values..].to_vec();
        Ok(Self { shape: [made.len(), kind.frames, kind.size, kind.size], pictures, noise })
    }

    fn tensor(&self, device: &Device) -> Tensor<5> {
        let [b, t, h, w] = self.shape;
        Tensor::from_data(TensorData::new(self.pictures.clone(), [b, 3, t, h, w]), device)
    }
}

/// Logarithm of the variance of a new autoencoder's latents. With random weights it would be 0; then the noise is stronger than
/// the signal, and the network learns nothing for hundreds of steps.
const LOG_VARIANCE: f32 = -6.0;

/// A new autoencoder, ready to be trained.
///
/// # Errors
/// When the configuration is invalid.
pub fn new_autoencoder(config: &VaeConfig, seed: u64, device: &Device) -> Result<Vae> {
    let mut vae = Vae::new(config, seed, device)?;
    let mut bias = vec![0.0; 2 * config.z_dim];
    bias[config.z_dim..].fill(LOG_VARIANCE);
    vae.quant.bias = Param::from_tensor(Tensor::from_data(bias.as_slice(), device));
    Ok(vae)
}

/// The loss of an autoencoder.
pub struct AutoencoderObjective {
    /// Weights of the terms.
    pub loss: AutoencoderLoss,
    /// LPIPS on the recording device, if it is part of the loss.
    pub lpips: Option<Lpips>,
}

impl Objective for AutoencoderObjective {
    type Batch = PictureBatch;
    type Model = Vae;

    fn step(&self, model: &Vae, batch: PictureBatch, device: &Device) -> Result<StepResult> {
        let z = model.config().z_dim;
        let truth = batch.tensor(device);
        let moments = model.moments(truth.clone())?;
        // The bounds of latent diffusion's autoencoder (Rombach et al. 2022).
        let (mean, log_variance) = (moments.clone().narrow(1, 0, z), moments.narrow(1, z, z).clamp(-30.0, 20.0));
        let noise = Tensor::<5>::from_data(TensorData::new(batch.noise, mean.dims()), device);
        let drawn = mean.clone() + noise * log_variance.clone().mul_scalar(0.5).exp();
        let pictures = model.decode(drawn)?;

        let mut sum = LossSum::default();
        sum.add("absolute", 1.0, losses::absolute(pictures.clone(), truth.clone()));
        sum.add("gradient", self.loss.gradient, losses::gradient(pictures.clone(), truth.clone()));
        sum.add("divergence", self.loss.divergence, losses::divergence(mean, log_variance));
        let shown = pictures.clamp(-1.0, 1.0);
        if let Some(lpips) = &self.lpips {
            sum.add("lpips", self.loss.lpips, lpips.loss(frames(shown.clone()), frames(truth.clone()))?);
        }
        sum.compare(shown, truth);
        let (report, loss) = sum.finish()?;
        let gradients = parameters::gradients_learning(model, &mut loss.backward());
        Ok(report.result(batch.shape[0], gradients))
    }
}

/// Pictures from which the statistics of latents are measured.
pub struct StatisticsSample(Vec<PictureBatch>);

/// Number of clips that the sample is drawn from. They are spread over the data.
const SAMPLE_CLIPS: usize = 4;
/// Least number of pictures in the sample.
const SAMPLE_ITEMS: usize = 96;

impl StatisticsSample {
    /// Draws the sample. It depends on the data and the seed alone.
    ///
    /// # Errors
    /// When a clip cannot be used, or as for [`PictureBatch::draw`].
    pub fn draw(
        config: &Config,
        network: &VaeConfig,
        source: &dyn ClipSource,
        make: &dyn Fn(&crate::Clip) -> Result<ClipPictures>,
    ) -> Result<Self> {
        let count = source.len().min(SAMPLE_CLIPS);
        let clips: Vec<Arc<ClipPictures>> =
            (0..count).map(|i| Ok(Arc::new(make(&source.load(i * source.len() / count)?)?))).collect::<Result<_>>()?;
        let mut rng = step_rng(config.run.seed ^ 0x7374_6174, 0);
        let (mut batches, mut items) = (Vec::new(), 0);
        while items < SAMPLE_ITEMS {
            let batch = PictureBatch::draw(network, &config.batches, &clips, Share::WHOLE, &mut rng)?;
            items += batch.shape[0];
            batches.push(batch);
        }
        Ok(Self(batches))
    }

    /// Returns `network` with the mean and the standard deviation of each channel of the latents that `model` makes.
    ///
    /// # Errors
    /// When the autoencoder does not fit the pictures.
    pub fn measure(&self, network: &VaeConfig, model: &Vae) -> Result<VaeConfig> {
        let (plain, z) = (model.valid(), network.z_dim);
        let mut sums = vec![[0.0f64; 3]; z];
        for batch in &self.0 {
            let latents = plain.encode(batch.tensor(&plain.device()))?;
            let [_, _, f, h, w] = latents.dims();
            for (i, plane) in read(latents)?.chunks_exact(f * h * w).enumerate() {
                let [count, sum, squares] = &mut sums[i % z];
                for value in plane {
                    *count += 1.0;
                    *sum += f64::from(*value);
                    *squares += f64::from(*value).powi(2);
                }
            }
        }
        let mean = |[count, sum, _]: &[f64; 3]| sum / count.max(1.0);
        // A constant channel is not scaled.
        let deviation = |sums: &[f64; 3]| {
            let variance = sums[2] / sums[0].max(1.0) - mean(sums).powi(2);
            if variance > 1e-12 { variance.sqrt() } else { 1.0 }
        };
        Ok(VaeConfig {
            latents_mean: sums.iter().map(|s| mean(s) as f32).collect(),
            latents_std: sums.iter().map(|s| deviation(s) as f32).collect(),
            ..network.clone()
        })
    }
}
