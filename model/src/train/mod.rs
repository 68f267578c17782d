//! Training: batches of random crops, bridge matching, AdamW with a moving average, checkpoints, a log.

pub mod checkpoint;
pub mod log;
pub mod loss;
pub mod optimizer;
pub mod pool;
pub mod schedule;
pub mod stage;

use crate::bridge::{Bridge, SIGMA, Times};
use crate::config::{KeyframeConfig, NetworkConfig};
use crate::data::{Batch, ClipSource, step_rng};
use crate::keyframe::KeyframeNet;
use crate::network::init::Init;
use crate::network::{Network, PIXEL_MULTIPLE};
use crate::parameters::{self, Parameter};
use crate::weights::{self, Precision, WeightsHeader};
use crate::{Error, Result};
use burn::tensor::Device;
use checkpoint::CheckpointHeader;
use loss::{Loss, LossWeights};
use optimizer::{Optimizer, StepSettings};
use pool::{Pool, PoolSettings};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use stage::{BaseStage, KeyframeStage, Objective};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Instant;

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

impl Trainer<'_> {
    fn train<O: Objective>(
        &self,
        objective: &O,
        model: O::Model,
        source: &dyn ClipSource,
        finish: &dyn Fn(&Optimizer) -> (WeightsHeader, Vec<Parameter>),
    ) -> Result<Summary> {
        let config = self.config;
        std::fs::create_dir_all(&config.output).map_err(Error::io(&config.output, "create folder"))?;
        let checkpoint_path = config.output.join("checkpoint.safetensors");
        let weights_path = config.output.join("weights.safetensors");
        let mut optimizer = Optimizer::new(parameters::export(&model));
        let resumed = checkpoint::load(&checkpoint_path, config, &mut optimizer)?;
        let before = resumed.as_ref().map_or(0.0, |header| header.elapsed);
        let mut log = log::Log::open(&config.output.join("log.jsonl"), optimizer.steps)?;
        let settings = PoolSettings {
            limit: config.cache_mib << 20,
            rotate_steps: config.rotate_steps,
            keys: matches!(config.stage, Stage::Keyframes { .. }),
            min_size: config.crops.iter().map(|crop| crop.size).max().unwrap_or(PIXEL_MULTIPLE),
            seed: config.seed,
        };
        let loading = |done, total| (self.progress)(&Progress::Loading { done, total });
        let pool = Pool::load(source, settings, optimizer.steps, self.cancel, &loading)?;

        let start = Instant::now();
        let mut meter = Meter::default();
        let mut last = None;
        let first_step = optimizer.steps;
        let save = |optimizer: &Optimizer, elapsed: f64| -> Result<()> {
            let header = CheckpointHeader { config: config.clone(), step: optimizer.steps, elapsed };
            checkpoint::save(&checkpoint_path, &header, optimizer)?;
            let (header, parameters) = finish(optimizer);
            weights::save(&weights_path, &header, &parameters, config.precision)
        };
        let finished = std::thread::scope(|scope| -> Result<bool> {
            // Batches are made one ahead, on a thread of their own.
            let (sender, receiver) = mpsc::sync_channel::<Result<Batch>>(1);
            scope.spawn(move || self.produce(pool, first_step, &sender));
            let mut model = parameters::import(model, &optimizer.values(), &self.device);
            loop {
                let elapsed = before + start.elapsed().as_secs_f64();
                let share = self.share(optimizer.steps, elapsed);
                if share >= 1.0 || self.cancel.load(Ordering::Relaxed) {
                    save(&optimizer, elapsed)?;
                    return Ok(share >= 1.0);
                }
                let batch =
                    receiver.recv().map_err(|_| Error::Data { place: "batches".into(), reason: "producer stopped".into() })??;
                let items = batch.items;
                let lr = schedule::learning_rate(config.learning_rate, optimizer.steps, config.warmup_steps, share);
                model = self.step(objective, model, batch, lr, &mut optimizer, &mut meter)?;
                meter.images += items;
                if optimizer.steps.is_multiple_of(config.log_steps) {
                    let elapsed = before + start.elapsed().as_secs_f64();
                    let record = meter.record(
                        optimizer.steps,
                        self.share(optimizer.steps, elapsed),
                        lr,
                        elapsed,
                        before,
                        first_step,
                        config,
                    );
                    log.append(&record)?;
                    (self.progress)(&Progress::Step(record.clone()));
                    last = Some(record);
                    meter = Meter::default();
                }
                if optimizer.steps.is_multiple_of(config.checkpoint_steps) {
                    save(&optimizer, before + start.elapsed().as_secs_f64())?;
                }
            }
        })?;
        Ok(Summary {
            steps: optimizer.steps,
            elapsed: before + start.elapsed().as_secs_f64(),
            finished,
            last,
            weights: weights_path,
        })
    }

    /// Share of the run that is done.
    fn share(&self, step: u64, elapsed: f64) -> f64 {
        let by_steps = step as f64 / self.config.steps as f64;
        self.config.minutes.map_or(by_steps, |minutes| by_steps.max(elapsed / (60.0 * minutes)))
    }

    fn step<O: Objective>(
        &self,
        objective: &O,
        model: O::Model,
        batch: Batch,
        lr: f64,
        optimizer: &mut Optimizer,
        meter: &mut Meter,
    ) -> Result<O::Model> {
        let config = self.config;
        let (loss, mut gradients) = objective.gradients(&model, batch, config.loss, &self.device);
        if !loss.total.is_finite() {
            return Err(Error::Diverged { step: optimizer.steps, what: "loss".into() });
        }
        let collected = parameters::gradients(&model, &mut gradients);
        let settings = StepSettings {
            learning_rate: lr as f32,
            weight_decay: config.weight_decay,
            clip_norm: config.clip_norm,
            ema_decay: config.ema_decay,
        };
        let step = optimizer.steps;
        let norm = optimizer.step(&collected, settings).map_err(|what| Error::Diverged { step, what })?;
        meter.add(loss, norm);
        Ok(parameters::import(model, &optimizer.values(), &self.device))
    }

    fn produce(&self, mut pool: Pool, first_step: u64, sender: &mpsc::SyncSender<Result<Batch>>) {
        for step in first_step.. {
            if self.cancel.load(Ordering::Relaxed) {
                return;
            }
            let batch = pool.at(step).map(|clips| {
                let frames: Vec<_> = clips.iter().flat_map(|clip| clip.iter()).collect();
                let mut rng = step_rng(self.config.seed, step);
                let total: f32 = self.config.crops.iter().map(|crop| crop.weight).sum();
                let mut u = rng.random::<f32>() * total;
                let mut crop = self.config.crops[0];
                for &candidate in self.config.crops.iter().filter(|crop| crop.weight > 0.0) {
                    crop = candidate;
                    u -= candidate.weight;
                    if u < 0.0 {
                        break;
                    }
                }
                Batch::draw(self.network, &frames, crop.size, crop.batch, self.config.bridge(), &mut rng)
            });
            let failed = batch.is_err();
            // The receiver is gone when training has ended.
            if sender.send(batch).is_err() || failed {
                return;
            }
        }
    }
}

/// Sums since the last log line.
struct Meter {
    since: Instant,
    steps: u64,
    images: usize,
    sums: [f64; 4],
    norm: f64,
}

impl Default for Meter {
    fn default() -> Self {
        Self { since: Instant::now(), steps: 0, images: 0, sums: [0.0; 4], norm: 0.0 }
    }
}

impl Meter {
    fn add(&mut self, loss: Loss, norm: f32) {
        self.steps += 1;
        self.norm += f64::from(norm);
        for (sum, value) in self.sums.iter_mut().zip([loss.total, loss.bridge, loss.display, loss.gradient]) {
            *sum += f64::from(value);
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn record(&self, step: u64, share: f64, lr: f64, elapsed: f64, before: f64, first_step: u64, config: &Config) -> log::Record {
        let n = self.steps.max(1) as f64;
        let [loss, bridge, display, gradient] = self.sums.map(|sum| (sum / n) as f32);
        // By steps from this session's own rate; by time where that ends the run earlier.
        let rate = (elapsed - before) / (step - first_step).max(1) as f64;
        let by_steps = rate * config.steps.saturating_sub(step) as f64;
        let eta = config.minutes.map_or(by_steps, |minutes| by_steps.min((60.0 * minutes - elapsed).max(0.0)));
        log::Record {
            step,
            share: share.min(1.0),
            loss,
            bridge,
            display_psnr: -10.0 * display.max(1e-10).log10(),
            gradient,
            gradient_norm: (self.norm / n) as f32,
            lr,
            images_per_second: self.images as f64 / self.since.elapsed().as_secs_f64().max(1e-9),
            elapsed,
            eta,
        }
    }
}
