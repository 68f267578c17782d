//! Training: sequences arrive from an endless source, the newest are kept in memory, and crops of their frames make the batches.
//! The averaged weights are validated on a fixed set at every checkpoint.

use super::batch::{self, Batch, Tier};
use super::graph::{FusionConfig, FusionNet, MULTIPLE};
use super::loss::{Loss, LossWeights, Truth, display, loss, perceptual};
use super::record::{AROUND, Groups, PARTS, Record, Selection, at};
use super::render::{self, Fusion, Header};
use crate::lpips::{Backbone, Lpips};
use crate::ops::Products;
use crate::parameters;
use crate::train::config::{self, Method, RunConfig, TrainingConfig, first_difference};
use crate::train::optimizer::Optimizer;
use crate::train::runner::{self, Objective, Progress, RunContext, Runner, StepResult, Summary, Validation};
use crate::train::sequences::Rotation;
use crate::weights::Precision;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use half::f16;
use rayon::prelude::*;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;
use std::path::PathBuf;

pub use crate::train::sequences::Crop;

/// An endless list of sequences to learn from. Sequence `i` is the same whenever it is asked for.
pub trait Source: Sync {
    /// The records of the frames of sequence `i`.
    ///
    /// # Errors
    /// When the sequence cannot be made. The run ends then.
    fn make(&self, i: u64) -> Result<Vec<Record<f16>>>;
    /// A text that is equal for equal lists of sequences only.
    fn identity(&self) -> String;
}

/// Options of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Config {
    /// The network.
    pub network: FusionConfig,
    /// The options that every run has.
    #[serde(flatten)]
    pub run: RunConfig,
    /// Kinds of crop, at least one of which begins at 0. At any time, the kind that began last is drawn.
    pub crops: Vec<Crop>,
    /// Number of sequences that are made before the first step, at least 1.
    pub first: u64,
    /// Number of steps after which one more sequence is used, at least 1.
    pub rotate_steps: u64,
    /// Number of sequences in memory, at least `first`. The newest are kept.
    pub window: u64,
    /// How convolutions multiply, forwards and backwards.
    pub products: Products,
    /// Weights of the terms of the loss.
    pub loss: LossWeights,
    /// Folder with the weights of LPIPS, or `None` for [`crate::lpips::weights_folder`]. They are read where `loss` has LPIPS.
    pub lpips_weights: Option<PathBuf>,
    /// Names of the [tiers](batch::TIERS) that are trained and validated; empty for all but
    /// `deferred+keys`, whose pictures no command makes.
    pub tiers: Vec<String>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: FusionConfig::default(),
            run: RunConfig {
                steps: 100_000,
                optimizer: Method::Muon,
                learning_rate: 3e-3,
                weight_decay: 0.005,
                checkpoint_steps: 250,
                log_steps: 25,
                ..RunConfig::default()
            },
            crops: vec![Crop { size: 96, batch: 8, from: 0.0 }, Crop { size: 192, batch: 2, from: 0.67 }],
            first: 12,
            rotate_steps: 100,
            window: 32,
            products: Products::Bf16,
            loss: LossWeights::default(),
            lpips_weights: None,
            tiers: Vec::new(),
        }
    }
}

impl Serialize for Config {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        Self::serialize(self, serializer)
    }
}

impl<'de> Deserialize<'de> for Config {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        config::over_defaults(deserializer, |_| (), Self::deserialize)
    }
}

impl TrainingConfig for Config {
    fn run(&self) -> &RunConfig {
        &self.run
    }

    fn difference(&self, other: &Self) -> Option<&'static str> {
        first_difference([
            ("network", self.network == other.network),
            ("first", self.first == other.first),
            ("rotate_steps", self.rotate_steps == other.rotate_steps),
            ("window", self.window == other.window),
        ])
    }
}

impl Config {
    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        self.network.validate()?;
        self.tiers()?;
        self.run.validate()?;
        Crop::check(&self.crops, MULTIPLE)?;
        self.loss.validate()?;
        let small = self.crops.iter().any(|crop| crop.size < Backbone::Squeeze.smallest_side());
        if self.loss.lpips > 0.0 && small {
            return Err(Error::config("crops.size", "is too small for LPIPS in the loss"));
        }
        self.rotation().validate()
    }

    /// The tiers that are trained, and validated.
    ///
    /// # Errors
    /// [`Error::Config`] with the first name that no tier has.
    pub fn tiers(&self) -> Result<Vec<Tier>> {
        let mut tiers = batch::tiers(&self.tiers)?;
        tiers.iter_mut().for_each(|tier| tier.groups.paths &= self.network.paths);
        Ok(tiers)
    }

    /// The sequences in memory.
    fn rotation(&self) -> Rotation {
        Rotation { first: self.first, rotate_steps: self.rotate_steps, window: self.window }
    }
}

/// The loss of crops that the network renders. The network runs on tensors; what follows it, and its derivative, runs on the
/// host.
#[derive(Clone, Copy, Debug, Default)]
pub struct FusionObjective<'a> {
    /// Weights of the terms of the loss.
    pub loss: LossWeights,
    /// LPIPS on the device of the step. Without it, its weight does not count.
    pub lpips: Option<&'a Lpips>,
    /// How convolutions multiply.
    pub products: Products,
}

impl Objective for FusionObjective<'_> {
    type Batch = Batch;
    type Model = FusionNet;

    fn step(&self, model: &FusionNet, mut batch: Batch, device: &Device) -> Result<StepResult> {
        let outputs = render::forward(model, self.products, &mut batch, device);
        let values = |tensor: &Tensor<4>| parameters::read(tensor.clone().without_autodiff());
        let fine = values(&outputs.fine)?;
        let coarse = outputs.coarse.as_ref().map(values).transpose()?.unwrap_or_default();
        let pixels = batch.width * batch.height;
        let (drawn, tapes): (Vec<_>, Vec<_>) =
            (0..batch.items).into_par_iter().map(|item| batch.picture(item, &fine, &coarse).draw()).unzip();
        let drawn = drawn.concat();
        let lpips = self.lpips.filter(|_| self.loss.lpips > 0.0).map(|lpips| perceptual(lpips, &batch, &drawn, device));
        let lpips = lpips.transpose()?;
        let parts: Vec<_> = tapes
            .par_iter()
            .enumerate()
            .map(|(item, tape)| {
                let picture = batch.picture(item, &fine, &coarse);
                let range = item * pixels..(item + 1) * pixels;
                let truth = Truth { picture: &batch.truth[range.clone()], raw: &batch.raw[range.clone()] };
                let (loss, mut slopes) = loss(batch.width, picture.pixels, &drawn[range.clone()], truth, self.loss);
                if let Some((_, of_lpips)) = &lpips {
                    // The derivative of the mean over the batch becomes one of this picture's loss, as the other terms are.
                    let weight = self.loss.lpips * batch.items as f32;
                    let added = slopes.as_flattened_mut().iter_mut().zip(of_lpips[range].as_flattened());
                    added.for_each(|(slope, of_lpips)| *slope += weight * of_lpips);
                }
                (loss, picture.backward(tape, &slopes))
            })
            .collect();
        let scale = 1.0 / batch.items as f32;
        let mean = |of: fn(&Loss) -> f32| scale * parts.iter().map(|(loss, _)| of(loss)).sum::<f32>();
        let joined = |of: fn(&Slopes) -> &Vec<f32>| -> Vec<f32> {
            parts.iter().flat_map(|(_, slopes)| of(slopes).iter().map(|v| scale * v)).collect()
        };
        let along = |tensor: Tensor<4>, slopes: Vec<f32>| {
            let slopes = Tensor::<4>::from_data(TensorData::new(slopes, tensor.dims()), device);
            (tensor * slopes).sum()
        };
        // The derivative of this sum with respect to the outputs is the one that the host computed.
        let mut sum = along(outputs.fine, joined(|slopes| &slopes.0));
        if let Some(coarse) = outputs.coarse {
            sum = sum + along(coarse, joined(|slopes| &slopes.1));
        }
        let mut gradients = sum.backward();
        Ok(StepResult {
            total: mean(|loss| loss.total) + lpips.as_ref().map_or(0.0, |(value, _)| self.loss.lpips * value),
            terms: lpips.map(|(value, _)| ("lpips", value)).into_iter().collect(),
            squares: vec![(batch.tier(), mean(|loss| loss.display))],
            items: batch.items,
            gradients: parameters::gradients_learning(model, &mut gradients),
        })
    }
}

/// The loss of `fusion` on a batch, and its gradients in the order of the network's parameters.
///
/// # Errors
/// When the configuration of the network is invalid.
pub fn gradients(fusion: &Fusion, batch: Batch, objective: FusionObjective<'_>) -> Result<StepResult> {
    let device = fusion.device().device().clone().autodiff();
    objective.step(&fusion.on(&device)?, batch, &device)
}

/// Derivatives of the fine and the coarse outputs of a picture.
type Slopes = (Vec<f32>, Vec<f32>);

/// Trains a network, and resumes from the checkpoint in the output folder if there is one. `start` holds weights to begin with,
/// `validation` the records that are validated at each checkpoint.
///
/// Batches depend on the seed, the step and the source alone. Each process of a team makes its share of them.
///
/// # Errors
/// For invalid options or data, an output folder that cannot be written, a checkpoint of another run, a loss that stays not
/// finite, or a device that fails.
pub fn run(
    config: &Config,
    source: &dyn Source,
    start: Option<&Fusion>,
    validation: &[Record<f16>],
    context: RunContext,
) -> Result<Summary> {
    config.validate()?;
    context.team.share().check_crops(&config.crops)?;
    let context = context.reporting();
    let device = context.autodiff();
    let model = match start {
        None => FusionNet::new(&config.network, config.run.seed, &device)?,
        Some(start) => start.fitted(&config.network)?.on(&device)?,
    };
    let tiers = config.tiers()?;
    let counts = config.loss.lpips > 0.0;
    let lpips = counts.then(|| Lpips::for_loss(config.lpips_weights.as_deref(), &device)).transpose()?;
    let runner = Runner { config, data: Some(source.identity()), context };
    std::thread::scope(|scope| {
        let batches = |first_step: u64| {
            let mut pool = config.rotation().load(scope, |i| source.make(i), first_step, context.cancel, context.progress)?;
            let share = context.team.share();
            Ok(move |step: u64| {
                let sequences = pool.at(step)?;
                let records: Vec<&Record<f16>> = sequences.iter().flat_map(|sequence| sequence.iter()).collect();
                let crop = Crop::at(&config.crops, config.run.share(step, 0.0));
                Batch::numbered(&records, &tiers, crop, share, [config.run.seed, step])
            })
        };
        let save = |optimizer: &Optimizer, _: &FusionNet| save(config, optimizer, validation, context);
        let objective = FusionObjective { loss: config.loss, lpips: lpips.as_ref(), products: config.products };
        runner.run(&objective, model, batches, &save)
    })
}

/// Writes the averaged weights and validates them.
fn save(config: &Config, optimizer: &Optimizer, validation: &[Record<f16>], context: RunContext) -> Result<()> {
    let header = Header { fusion: config.network.clone(), steps: optimizer.steps, seed: config.run.seed };
    let averaged = Fusion::with_parameters(header, &optimizer.averaged())?.to(context.device)?;
    // On the processor, it is validated as it was trained.
    let products = if context.device.is_cpu() { config.products } else { context.device.products() };
    let averaged = averaged.with_products(products);
    averaged.save(&runner::weights_path(&config.run.output), Precision::F16)?;
    if !validation.is_empty() {
        let psnr = validate(&averaged, validation, &config.tiers()?)?;
        let validated = Validation { step: optimizer.steps, psnr, others: BTreeMap::new() };
        validated.append(&config.run.output)?;
        (context.progress)(&Progress::Validated(validated));
    }
    Ok(())
}

/// The selections of a record that are validated: one for each of the tiers whose inputs the record has. With samples, it takes
/// the samples of one part; a tier of samples alone has one selection for each part.
pub fn variants(record: &Record<f16>, tiers: &[Tier]) -> Vec<(String, Selection)> {
    let mut found = Vec::new();
    for tier in tiers {
        if !tier.groups.are_in(record.groups()) {
            continue;
        }
        let groups = Groups { paths: tier.groups.paths && record.paths, ..tier.groups };
        let all = Selection { groups, ..Selection::all(record) };
        if !tier.groups.samples {
            found.push((tier.name.to_owned(), all));
            continue;
        }
        let alone = !tier.groups.keys && !tier.groups.neighbours;
        for part in (0..if alone { PARTS } else { 1 }).filter(|part| record.parts[*part] > 0) {
            let mut selection = all;
            selection.parts = [0.0; PARTS];
            selection.parts[part] = record.parts[part] as f32;
            selection.picture = if tier.groups.neighbours { AROUND } else { part };
            if !tier.groups.denoised || record.denoised[selection.picture] {
                found.push((format!("{} {}", tier.name, selection.spp()), selection));
            }
        }
    }
    found
}

/// Mean PSNR in dB over the covered pixels of `records`, for each of their [`variants`] in `tiers`.
///
/// # Errors
/// When a record is empty.
pub fn validate(fusion: &Fusion, records: &[Record<f16>], tiers: &[Tier]) -> Result<BTreeMap<String, f32>> {
    let mut sums: BTreeMap<String, (f64, u32)> = BTreeMap::new();
    for record in records {
        for (name, selection) in variants(record, tiers) {
            let drawn = fusion.draw(record, &selection)?;
            let sum = sums.entry(name).or_default();
            sum.0 += psnr(record, &drawn);
            sum.1 += 1;
        }
    }
    Ok(sums.into_iter().map(|(name, (sum, count))| (name, (sum / f64::from(count)) as f32)).collect())
}

/// PSNR in dB of the display picture over the covered pixels of a record, against its truth before that was denoised. Noise
/// lowers all numbers, but a denoised truth would favour pictures of the same denoiser.
pub fn psnr(record: &Record<f16>, drawn: &[[f32; 3]]) -> f64 {
    let (mut sum, mut count) = (0.0_f64, 0u32);
    for (stored, drawn) in record.pixels.chunks_exact(at::COUNT).zip(drawn) {
        if stored[at::ALPHA] > f16::ZERO {
            for c in 0..3 {
                sum += f64::from(display(drawn[c]) - display(stored[at::RAW_TRUTH + c].to_f32())).powi(2);
            }
            count += 3;
        }
    }
    -10.0 * (sum / f64::from(count.max(1))).max(1e-10).log10()
}
