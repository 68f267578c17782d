//! Training: batches of random crops, bridge matching, AdamW with a moving average, checkpoints, a log.

pub mod checkpoint;
mod config;
pub mod log;
pub mod loss;
pub mod optimizer;
pub mod pool;
pub mod runner;
pub mod schedule;
pub mod stage;

pub use config::{Config, CropConfig, Stage};

use crate::config::NetworkConfig;
use crate::data::{Batch, Clip, ClipSource, StoredFrame, prepare, step_rng};
use crate::keyframe::KeyframeNet;
use crate::network::init::Init;
use crate::network::{Network, PIXEL_MULTIPLE};
use crate::parameters::{self, Parameter};
use crate::weights::{self, WeightsHeader};
use crate::{Error, Result};
use burn::tensor::Device;
use loss::LossWeights;
use optimizer::Optimizer;
use pool::{Pool, PoolSettings};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use runner::{Learner, Lesson, Report, Runner};
use stage::{BaseStage, KeyframeStage, Objective};
use std::sync::atomic::AtomicBool;

/// What a run reports while it goes on.
pub type Progress = runner::Progress<log::Record>;
/// What a run left behind.
pub type Summary = runner::Summary<log::Record>;

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
        let weights_path = runner::weights_path(&config.output);
        let keys = matches!(config.stage, Stage::Keyframes { .. });
        let least = config.crops.iter().map(|crop| crop.size).max().unwrap_or(PIXEL_MULTIPLE);
        let make = move |clip: &Clip| prepare_at_least(clip, keys, least);
        let pool = PoolSettings { limit: config.cache_mib << 20, rotate_steps: config.rotate_steps, seed: config.seed };
        let loading = |done, total| (self.progress)(&Progress::Loading { done, total });
        let runner = Runner {
            config,
            difference: &difference,
            output: &config.output,
            data: source.identity()?,
            settings: config.settings(),
            device: self.device.clone(),
            record: &record,
            progress: &|record: &log::Record| (self.progress)(&Progress::Step(record.clone())),
            note: &|note| (self.progress)(&Progress::Note(note)),
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
        runner.run(&Stages { objective, loss: config.loss }, model, batches, &save)
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
