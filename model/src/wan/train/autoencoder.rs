//! Training an autoencoder on pictures of all kinds: `|x - y|`, gradients, a little divergence, LPIPS if wanted.

use super::album::{Album, Window};
use super::config::{AutoencoderLoss, BatchConfig, Config};
use super::losses;
use crate::data::{ClipSource, step_rng};
use crate::lpips::Lpips;
use crate::network::init::normal;
use crate::parameters::{self, to_vec};
use crate::train::draw_weighted;
use crate::train::runner::{Learner, Lesson};
use crate::wan::config::VaeConfig;
use crate::wan::pictures::Kind;
use crate::wan::probe::Probe;
use crate::wan::vae::Vae;
use crate::{Error, Result};
use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

/// Pictures and the noise their latents are drawn with.
pub struct PictureBatch {
    /// Items, frames, rows and columns.
    pub shape: [usize; 4],
    /// `[items, 3, frames, height, width]` of -1..=1.
    pub pictures: Vec<f32>,
    /// Standard normal, one a latent value.
    pub noise: Vec<f32>,
}

impl PictureBatch {
    /// A batch of one of the kinds in `batches`, drawn by weight: each item a window of a random kind of picture.
    ///
    /// # Errors
    /// When clips of several frames are asked for and none has as many in a row.
    pub fn draw(config: &VaeConfig, batches: &[BatchConfig], albums: &[Arc<Album>], rng: &mut Pcg64Mcg) -> Result<Self> {
        let kind = batches[draw_weighted(batches.iter().map(|b| b.weight), rng)];
        let starts: Vec<(usize, usize)> = albums
            .iter()
            .enumerate()
            .flat_map(|(i, album)| album.stretches(kind.frames - 1).into_iter().map(move |page| (i, page)))
            .collect();
        if starts.is_empty() {
            let reason = format!("no {} frames in a row in the clips in memory", kind.frames);
            return Err(Error::Data { place: "training data".into(), reason });
        }
        let mut pictures = Vec::with_capacity(kind.items * 3 * kind.frames * kind.size * kind.size);
        for _ in 0..kind.items {
            let (album, page) = starts[rng.random_range(0..starts.len())];
            let album = &albums[album];
            let picture = Kind::ALL[rng.random_range(0..Kind::ALL.len())];
            let window = Window {
                top: rng.random_range(0..=album.height - kind.size),
                left: rng.random_range(0..=album.width - kind.size),
                height: kind.size,
                width: kind.size,
            };
            pictures.extend(album.clip(page, kind.frames, picture, window));
        }
        let side = kind.size / config.spatial_factor();
        let frames = config.latent_frames(kind.frames).unwrap_or(1);
        let noise = (0..kind.items * config.z_dim * frames * side * side).map(|_| normal(rng)).collect();
        Ok(Self { shape: [kind.items, kind.frames, kind.size, kind.size], pictures, noise })
    }

    fn tensor(&self, device: &Device) -> Tensor<5> {
        let [b, t, h, w] = self.shape;
        Tensor::from_data(TensorData::new(self.pictures.clone(), [b, 3, t, h, w]), device)
    }
}

/// Logarithm of the variance that latents of a new autoencoder begin with. At 0, where random weights put it, the noise they are drawn
/// with is larger than what they say, and hundreds of steps teach nothing.
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

/// What the loop needs.
pub struct AutoencoderLearner {
    /// Weights of the losses.
    pub loss: AutoencoderLoss,
    /// Loaded on the recording device, where wanted.
    pub lpips: Option<Lpips>,
}

impl Learner for AutoencoderLearner {
    type Batch = PictureBatch;
    type Model = Vae;

    fn learn(&self, model: &Vae, _: u64, batch: PictureBatch, device: &Device) -> Result<Lesson> {
        let z = model.config().z_dim;
        let truth = batch.tensor(device);
        let moments = model.moments(truth.clone(), &mut Probe::idle())?;
        // The bounds of latent diffusion's autoencoder (Rombach et al. 2022).
        let (mean, log_variance) = (moments.clone().narrow(1, 0, z), moments.narrow(1, z, z).clamp(-30.0, 20.0));
        let noise = Tensor::<5>::from_data(TensorData::new(batch.noise, mean.dims()), device);
        let drawn = mean.clone() + noise * log_variance.clone().mul_scalar(0.5).exp();
        let pictures = model.decode(drawn, &mut Probe::idle())?;

        let mut sum = Sum::default();
        sum.add("absolute", 1.0, losses::absolute(pictures.clone(), truth.clone()));
        sum.add("gradient", self.loss.gradient, losses::gradient(pictures.clone(), truth.clone()));
        sum.add("divergence", self.loss.divergence, losses::divergence(mean, log_variance));
        let shown = pictures.clamp(-1.0, 1.0);
        if let Some(lpips) = &self.lpips {
            sum.add("lpips", self.loss.lpips, lpips.loss(frames(shown.clone()), frames(truth.clone()))?);
        }
        // Of values of 0..=1, as PSNR is counted.
        sum.compare(losses::square(shown.without_autodiff(), truth.without_autodiff()).mul_scalar(0.25));
        let (Parts { total, terms, squares }, loss) = sum.finish()?;
        let gradients = parameters::gradients_learning(model, &mut loss.backward());
        Ok(Lesson { total, terms, squares, items: batch.shape[0], gradients })
    }
}

/// `[b, c, f, h, w]` to `[b f, c, h, w]`.
pub(super) fn frames(x: Tensor<5>) -> Tensor<4> {
    let [b, c, f, h, w] = x.dims();
    x.permute([0, 2, 1, 3, 4]).reshape([b * f, c, h, w])
}

/// Parts of a loss by name.
pub(super) type Terms = Vec<(&'static str, f32)>;

/// A loss of several parts.
#[derive(Default)]
pub(super) struct Sum {
    loss: Option<Tensor<1>>,
    terms: Terms,
    squares: Terms,
}

/// What is told of a loss.
#[derive(Clone, Debug)]
pub(super) struct Parts {
    pub total: f32,
    pub terms: Terms,
    /// See [`Lesson::squares`].
    pub squares: Terms,
}

impl Sum {
    /// Adds `weight` times a part, unless the weight is 0; the log gets the part itself.
    pub fn add(&mut self, name: &'static str, weight: f32, part: Tensor<1>) {
        self.note(name, part.clone());
        if weight > 0.0 {
            let part = part.mul_scalar(weight);
            self.loss = Some(match self.loss.take() {
                Some(loss) => loss + part,
                None => part,
            });
        }
    }

    /// Adds a number to the log.
    pub fn note(&mut self, name: &'static str, part: Tensor<1>) {
        self.terms.push((name, value(part)));
    }

    /// Adds the mean squared error of pictures to the log.
    pub fn compare(&mut self, square: Tensor<1>) {
        self.squares.push(("pictures", value(square)));
    }

    /// What is told of the loss, and itself to be differentiated.
    pub fn finish(self) -> Result<(Parts, Tensor<1>)> {
        let loss = self.loss.ok_or_else(|| Error::config("stage", "all weights of losses are 0"))?;
        Ok((Parts { total: value(loss.clone()), terms: self.terms, squares: self.squares }, loss))
    }
}

/// The number in a tensor of one.
fn value(of: Tensor<1>) -> f32 {
    to_vec(of.without_autodiff()).first().copied().unwrap_or(f32::NAN)
}

/// Pictures whose latents' statistics stand for all.
pub struct Sample(Vec<PictureBatch>);

/// Clips a sample is drawn from, spread over the data, and its items.
const SAMPLE_CLIPS: usize = 4;
const SAMPLE_ITEMS: usize = 96;

impl Sample {
    /// A function of the data and the seed.
    ///
    /// # Errors
    /// As [`PictureBatch::draw`], and when a clip cannot be used.
    pub fn draw(
        config: &Config,
        network: &VaeConfig,
        source: &dyn ClipSource,
        make: &dyn Fn(&crate::Clip) -> Result<Album>,
    ) -> Result<Self> {
        let clips = source.len().min(SAMPLE_CLIPS);
        let albums: Vec<Arc<Album>> =
            (0..clips).map(|i| Ok(Arc::new(make(&source.load(i * source.len() / clips)?)?))).collect::<Result<_>>()?;
        let mut rng = step_rng(config.seed ^ 0x7374_6174, 0);
        let (mut batches, mut items) = (Vec::new(), 0);
        while items < SAMPLE_ITEMS {
            let batch = PictureBatch::draw(network, &config.batches, &albums, &mut rng)?;
            items += batch.shape[0];
            batches.push(batch);
        }
        Ok(Self(batches))
    }

    /// `network` with the mean and the standard deviation of each channel of `model`'s latents.
    ///
    /// # Errors
    /// When the autoencoder does not fit the pictures.
    pub fn measure(&self, network: &VaeConfig, model: &Vae) -> Result<VaeConfig> {
        let (plain, z) = (model.valid(), network.z_dim);
        let mut sums = vec![[0.0f64; 3]; z];
        for batch in &self.0 {
            let latents = plain.encode(batch.tensor(&Device::flex()))?;
            let [_, _, f, h, w] = latents.dims();
            for (i, plane) in to_vec(latents).chunks_exact(f * h * w).enumerate() {
                let [count, sum, squares] = &mut sums[i % z];
                for value in plane {
                    *count += 1.0;
                    *sum += f64::from(*value);
                    *squares += f64::from(*value).powi(2);
                }
            }
        }
        let mean = |[count, sum, _]: &[f64; 3]| sum / count.max(1.0);
        // A channel that says nothing stays what it is.
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
