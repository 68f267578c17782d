//! Training: batches of random crops, bridge matching, AdamW with a moving average, checkpoints, a log.

pub mod checkpoint;
pub mod log;
pub mod loss;
pub mod optimizer;
pub mod pool;
pub mod runner;
pub mod schedule;
pub mod stage;

use crate::bridge::{Bridge, SIGMA, Times};
use crate::config::{KeyframeConfig, NetworkConfig};
use crate::data::{Batch, Clip, ClipSource, StoredFrame, prepare, step_rng};
use crate::keyframe::KeyframeNet;
use crate::network::init::Init;
use crate::network::{Network, PIXEL_MULTIPLE};
use crate::parameters::{self, Parameter};
use crate::weights::{self, Precision, WeightsHeader};
use crate::{Error, Result};
use burn::tensor::Device;
use loss::LossWeights;
use optimizer::Optimizer;
use pool::{Pool, PoolSettings};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use runner::{Learner, Lesson, Report, Runner};
use schedule::Decay;
use serde::{Deserialize, Serialize};
use stage::{BaseStage, KeyframeStage, Objective};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// What is trained.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The base network, from random weights.
    #[default]
    Base,
    /// The keyframe network on a frozen base.
    Keyframes {
        /// Weights file of the base.
        base: PathBuf,
        /// Size of the keyframe network.
        network: KeyframeConfig,
    },
}

/// A kind of batch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CropConfig {
    /// Rows and columns, a multiple of 32.
    pub size: usize,
    /// Crops in a batch.
    pub batch: usize,
    /// Relative frequency.
    pub weight: f32,
}

/// Settings of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The network; ignored in the keyframe stage, where the base file decides.
    pub network: NetworkConfig,
    /// Base or keyframes.
    pub stage: Stage,
    /// Folder for `checkpoint.safetensors`, `weights.safetensors` and `log.jsonl`.
    pub output: PathBuf,
    /// Seed of the initial weights and of every batch.
    pub seed: u64,
    /// Optimiser steps; where `minutes` is given, an upper bound.
    pub steps: u64,
    /// Minutes of training over all resumptions; the learning rate follows time then, so that the run ends annealed.
    pub minutes: Option<f64>,
    /// Batches, drawn by weight. Large crops teach long-range attention.
    pub crops: Vec<CropConfig>,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Steps of linear warm-up.
    pub warmup_steps: u64,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest gradient norm.
    pub clip_norm: f32,
    /// Decay of the moving average of the weights.
    pub ema_decay: f32,
    /// Loss weights.
    pub loss: LossWeights,
    /// Probability of each bridge time 0, 1/4, 1/2, 3/4.
    pub time_probabilities: [f32; 4],
    /// Every time from 0 to [`crate::bridge::LAST_TIME`] alike, in place of the four.
    pub uniform_times: bool,
    /// Noise of the bridge, in units of z; 0 for the straight path.
    pub sigma: f32,
    /// Mebibytes of training data held in memory.
    pub cache_mib: usize,
    /// Steps after which a clip is replaced when not all fit.
    pub rotate_steps: u64,
    /// Steps between checkpoints.
    pub checkpoint_steps: u64,
    /// Steps between log lines and progress reports.
    pub log_steps: u64,
    /// Number format of the final weights.
    pub precision: Precision,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: NetworkConfig::default(),
            stage: Stage::Base,
            output: PathBuf::from("train-out"),
            seed: 1,
            steps: 20_000,
            minutes: None,
            crops: vec![CropConfig { size: 128, batch: 8, weight: 0.85 }, CropConfig { size: 256, batch: 2, weight: 0.15 }],
            // 1e-3 made the convolutions, which have no normalisation, die within 300 steps.
            learning_rate: 4e-4,
            warmup_steps: 300,
            weight_decay: 0.01,
            clip_norm: 1.0,
            ema_decay: 0.999,
            loss: LossWeights::default(),
            time_probabilities: [0.7, 0.1, 0.1, 0.1],
            uniform_times: false,
            sigma: SIGMA,
            cache_mib: 8192,
            rotate_steps: 20,
            checkpoint_steps: 500,
            log_steps: 20,
            precision: Precision::F16,
        }
    }
}

impl Config {
    fn settings(&self) -> runner::Settings {
        runner::Settings {
            steps: self.steps,
            minutes: self.minutes,
            learning_rate: self.learning_rate,
            warmup_steps: self.warmup_steps,
            decay: Decay::Cosine,
            weight_decay: self.weight_decay,
            clip_norm: self.clip_norm,
            ema_decay: self.ema_decay,
            checkpoint_steps: self.checkpoint_steps,
            log_steps: self.log_steps,
        }
    }

    /// The bridge that training draws from.
    pub fn bridge(&self) -> Bridge {
        let times = if self.uniform_times { Times::Uniform } else { Times::Four(self.time_probabilities) };
        Bridge { sigma: self.sigma, times }
    }

    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        self.network.validate()?;
        if self.crops.is_empty() {
            return Err(Error::config("crops", "needs at least one kind of batch"));
        }
        for crop in &self.crops {
            if crop.size == 0 || !crop.size.is_multiple_of(PIXEL_MULTIPLE) || crop.size > 4096 {
                return Err(Error::config(
                    "crops.size",
                    format!("{} is not a multiple of {PIXEL_MULTIPLE} up to 4096", crop.size),
                ));
            }
            if crop.batch == 0 || crop.batch > 4096 {
                return Err(Error::config("crops.batch", "must be 1..=4096"));
            }
            if !(crop.weight >= 0.0 && crop.weight.is_finite()) {
                return Err(Error::config("crops.weight", "must be a number >= 0"));
            }
        }
        let checks = [
            ("crops.weight", self.crops.iter().map(|c| c.weight).sum::<f32>() > 0.0, "must not all be 0"),
            ("steps", self.steps > 0, "must be at least 1"),
            ("minutes", self.minutes.is_none_or(|m| m > 0.0 && m.is_finite()), "must be a number > 0"),
            ("learning_rate", self.learning_rate > 0.0 && self.learning_rate <= 1.0, "must be in 0..=1"),
            ("weight_decay", (0.0..=1.0).contains(&self.weight_decay), "must be in 0..=1"),
            ("clip_norm", self.clip_norm > 0.0, "must be > 0"),
            ("ema_decay", (0.0..1.0).contains(&self.ema_decay), "must be in 0..1"),
            ("loss", [self.loss.display, self.loss.gradient].iter().all(|w| *w >= 0.0 && w.is_finite()), "weights must be >= 0"),
            ("time_probabilities", Times::Four(self.time_probabilities).is_valid(), "must be >= 0 and not all 0"),
            ("sigma", (0.0..=1.0).contains(&self.sigma), "must be in 0..=1"),
            ("checkpoint_steps", self.checkpoint_steps > 0, "must be at least 1"),
            ("log_steps", self.log_steps > 0, "must be at least 1"),
            ("rotate_steps", self.rotate_steps > 0, "must be at least 1"),
        ];
        match checks.into_iter().find(|(_, valid, _)| !valid) {
            Some((option, _, reason)) => Err(Error::config(option, reason)),
            None => Ok(()),
        }
    }
}

/// What a run reports while it goes on.
#[derive(Clone, Debug)]
pub enum Progress {
    /// Clips are being turned into network inputs.
    Loading {
        /// Clips done.
        done: usize,
        /// Clips to load.
        total: usize,
    },
    /// Steps have been taken.
    Step(log::Record),
}

/// What a run left behind.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Steps done in all.
    pub steps: u64,
    /// Seconds of training in all.
    pub elapsed: f64,
    /// Whether the run reached its end; otherwise it was cancelled and can be resumed.
    pub finished: bool,
    /// The last line of the log, if any was written.
    pub last: Option<log::Record>,
    /// Averaged weights: written at the end and at every checkpoint.
    pub weights: PathBuf,
}

/// Trains, resuming from the checkpoint in `config.output` if there is one.
///
/// Batches depend on (seed, step) only. `progress` is called from this thread and, while loading, from others. Setting `cancel`
/// stops after the current step with a checkpoint.
///
/// # Errors
/// Bad options or data, an unwritable output folder, a checkpoint of another run, or a loss that is no longer finite.
pub fn run(
    config: &Config,
    source: &dyn ClipSource,
    progress: &(dyn Fn(&Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Summary> {
    config.validate()?;
    let device = Device::flex().autodiff();
    match &config.stage {
        Stage::Base => {
            let network = Network::new(&config.network, config.seed, &device)?;
            let header = WeightsHeader { network: config.network.clone(), steps: 0, keyframe_steps: 0, seed: config.seed };
            let stage = BaseStage { config: config.network.clone() };
            let finish = |optimizer: &Optimizer| {
                let prefixed =
                    optimizer.averaged().into_iter().map(|p| Parameter { name: format!("base.{}", p.name), ..p }).collect();
                (WeightsHeader { steps: optimizer.steps, ..header.clone() }, prefixed)
            };
            Trainer { config, network: &config.network, device, progress, cancel }.train(&stage, network.base, source, &finish)
        }
        Stage::Keyframes { base, network } => {
            let (frozen, header) = weights::load(base, &Device::flex())?;
            let model = KeyframeNet::new(&mut Init::new(config.seed, &device), network);
            let before: Vec<Parameter> =
                parameters::export(&frozen).into_iter().filter(|p| p.name.starts_with("base.")).collect();
            let network_config = NetworkConfig { keyframes: Some(network.clone()), ..header.network.clone() };
            let finish = |optimizer: &Optimizer| {
                let mut all = before.clone();
                all.extend(optimizer.averaged().into_iter().map(|p| Parameter { name: format!("keyframes.{}", p.name), ..p }));
                (WeightsHeader { network: network_config.clone(), keyframe_steps: optimizer.steps, ..header.clone() }, all)
            };
            let input = header.network.clone();
            Trainer { config, network: &input, device, progress, cancel }.train(
                &KeyframeStage { base: frozen, sigma: config.sigma },
                model,
                source,
                &finish,
            )
        }
    }
}

struct Trainer<'a> {
    config: &'a Config,
    /// Decides the inputs of a batch.
    network: &'a NetworkConfig,
    device: Device,
    progress: &'a (dyn Fn(&Progress) + Sync),
    cancel: &'a AtomicBool,
}

/// A stage as the loop sees it.
struct Stages<'a, O> {
    objective: &'a O,
    loss: LossWeights,
}

impl<O: Objective> Learner for Stages<'_, O> {
    type Batch = Batch;
    type Model = O::Model;

    fn learn(&self, model: &O::Model, _: u64, batch: Batch, device: &Device) -> Result<Lesson> {
        let items = batch.items;
        let (loss, mut gradients) = self.objective.gradients(model, batch, self.loss, device);
        let terms = vec![("bridge", loss.bridge), ("display", loss.display), ("gradient", loss.gradient)];
        Ok(Lesson { total: loss.total, terms, items, gradients: parameters::gradients(model, &mut gradients) })
    }
}

impl Trainer<'_> {
    fn train<O: Objective>(
        &self,
        objective: &O,
        model: O::Model,
        source: &dyn ClipSource,
        finish: &dyn Fn(&Optimizer) -> (WeightsHeader, Vec<Parameter>),
    ) -> Result<Summary> {
        let config = self.config;
        let weights_path = config.output.join("weights.safetensors");
        let keys = matches!(config.stage, Stage::Keyframes { .. });
        let least = config.crops.iter().map(|crop| crop.size).max().unwrap_or(PIXEL_MULTIPLE);
        let make = move |clip: &Clip| prepare_at_least(clip, keys, least);
        let pool = PoolSettings { limit: config.cache_mib << 20, rotate_steps: config.rotate_steps, seed: config.seed };
        let loading = |done, total| (self.progress)(&Progress::Loading { done, total });
        let runner = Runner {
            config,
            difference: &difference,
            output: &config.output,
            settings: config.settings(),
            device: self.device.clone(),
            record: &record,
            progress: &|record: &log::Record| (self.progress)(&Progress::Step(record.clone())),
            cancel: self.cancel,
        };
        let network = self.network;
        let batches = |first_step| {
            let mut pool = Pool::load(source, &make, pool, first_step, self.cancel, &loading)?;
            Ok(move |step| {
                let clips = pool.at(step)?;
                let frames: Vec<_> = clips.iter().flat_map(|clip| clip.iter()).collect();
                let mut rng = step_rng(config.seed, step);
                let crop = config.crops[draw_weighted(config.crops.iter().map(|crop| crop.weight), &mut rng)];
                Ok(Batch::draw(network, &frames, crop.size, crop.batch, config.bridge(), &mut rng))
            })
        };
        let save = |optimizer: &Optimizer, _: &O::Model| {
            let (header, parameters) = finish(optimizer);
            weights::save(&weights_path, &header, &parameters, config.precision)
        };
        let (outcome, _) = runner.run(&Stages { objective, loss: config.loss }, model, batches, &save)?;
        let runner::Outcome { steps, elapsed, finished, last } = outcome;
        Ok(Summary { steps, elapsed, finished, last, weights: weights_path })
    }
}

/// [`prepare`], refusing frames that have no crop of `least` pixels.
fn prepare_at_least(clip: &Clip, keys: bool, least: usize) -> Result<Vec<StoredFrame>> {
    let frames = prepare(clip, keys)?;
    match frames.iter().find(|f| f.width.min(f.height) < least) {
        Some(frame) => {
            let reason = format!("frames of {}x{} are smaller than the crop of {least}", frame.width, frame.height);
            Err(Error::Data { place: clip.name.clone(), reason })
        }
        None => Ok(frames),
    }
}

/// Index of one of `weights` (>= 0, not all 0), drawn in proportion.
pub(crate) fn draw_weighted(weights: impl Iterator<Item = f32> + Clone, rng: &mut Pcg64Mcg) -> usize {
    let total: f32 = weights.clone().sum();
    let mut u = rng.random::<f32>() * total;
    let mut drawn = 0;
    for (i, weight) in weights.enumerate().filter(|(_, weight)| *weight > 0.0) {
        drawn = i;
        u -= weight;
        if u < 0.0 {
            break;
        }
    }
    drawn
}

/// The first option that may not change between a run and its continuation.
fn difference(a: &Config, b: &Config) -> Option<&'static str> {
    let stage = |config: &Config| matches!(config.stage, Stage::Keyframes { .. });
    [
        ("network", a.network == b.network),
        ("seed", a.seed == b.seed),
        ("crops", a.crops == b.crops),
        ("stage", stage(a) == stage(b)),
    ]
    .into_iter()
    .find(|(_, same)| !same)
    .map(|(option, _)| option)
}

fn record(report: &Report) -> log::Record {
    let term = |name| report.terms.get(name).copied().unwrap_or_default();
    log::Record {
        step: report.step,
        share: report.share,
        loss: report.loss,
        bridge: term("bridge"),
        display_psnr: -10.0 * term("display").max(1e-10).log10(),
        gradient: term("gradient"),
        gradient_norm: report.gradient_norm,
        lr: report.lr,
        images_per_second: report.items_per_second,
        elapsed: report.elapsed,
        eta: report.eta,
    }
}
