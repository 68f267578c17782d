//! Training: records from a source that never ends, a window of them in memory, batches, AdamW with a moving average, checkpoints,
//! validation on a fixed set.

use super::batch::{Batch, TIERS, Tier};
use super::graph::{FusionConfig, FusionNet, MULTIPLE};
use super::objective::{LossWeights, display, loss};
use super::record::{AROUND, Chosen, PARTS, Record, at};
use super::render::{self, Fusion, Header};
use crate::data::step_rng;
use crate::ops::Products;
use crate::parameters;
use crate::train::optimizer::{Method, Optimizer};
use crate::train::runner::{self, Learner, Lesson, Progress, Runner, Summary, Validation};
use crate::train::schedule::Decay;
use crate::weights::Precision;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use half::f16;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

/// Where records come from: sequence `i` of an endless list, the same whenever it is asked for.
pub trait Source: Sync {
    /// The records of sequence `i`.
    ///
    /// # Errors
    /// When it cannot be made; the run ends then.
    fn make(&self, i: u64) -> Result<Vec<Record<f16>>>;
    /// What tells these sequences from others.
    fn identity(&self) -> String;
}

/// A kind of crop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// Rows and columns, a multiple of 16.
    pub size: usize,
    /// Crops in a batch.
    pub batch: usize,
    /// Share of the run from which on these are drawn.
    pub from: f64,
}

/// Settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The network.
    pub network: FusionConfig,
    /// Folder for `checkpoint.safetensors`, `weights.safetensors`, `log.jsonl` and `validation.jsonl`.
    pub output: PathBuf,
    /// Seed of the initial weights and of every batch.
    pub seed: u64,
    /// Optimiser steps; where `minutes` is given, an upper bound.
    pub steps: u64,
    /// Minutes of training over all resumptions; the learning rate follows time then, so that the run ends annealed.
    pub minutes: Option<f64>,
    /// Crops, those of the largest `from` that has been reached.
    pub crops: Vec<Crop>,
    /// Sequences made before the first step.
    pub first: u64,
    /// Steps after which one more sequence is there.
    pub rotate_steps: u64,
    /// Sequences kept in memory, the newest.
    pub window: u64,
    /// How a step is taken.
    pub optimizer: Method,
    /// How convolutions multiply, forwards and backwards.
    pub products: Products,
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
    /// Names of [`TIERS`] that are learnt; empty = all.
    pub tiers: Vec<String>,
    /// Steps between checkpoints and validations.
    pub checkpoint_steps: u64,
    /// Steps between log lines.
    pub log_steps: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: FusionConfig::default(),
            output: PathBuf::from("train-out"),
            seed: 1,
            steps: 100_000,
            minutes: None,
            crops: vec![Crop { size: 96, batch: 8, from: 0.0 }, Crop { size: 192, batch: 2, from: 0.67 }],
            first: 12,
            rotate_steps: 100,
            window: 32,
            optimizer: Method::Muon,
            products: Products::Bf16,
            learning_rate: 3e-3,
            warmup_steps: 200,
            weight_decay: 0.005,
            clip_norm: 1.0,
            ema_decay: 0.999,
            loss: LossWeights::default(),
            tiers: Vec::new(),
            checkpoint_steps: 250,
            log_steps: 25,
        }
    }
}

impl Config {
    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        self.network.validate()?;
        self.learnt()?;
        let crop = |crop: &Crop| {
            crop.size > 0 && crop.size.is_multiple_of(MULTIPLE) && crop.size <= 4096 && (1..=4096).contains(&crop.batch)
        };
        let positive = |v: f32| v > 0.0 && v.is_finite();
        let checks = [
            (
                "crops",
                !self.crops.is_empty() && self.crops.iter().all(crop),
                "sizes must be multiples of 16 up to 4096, batches 1..=4096",
            ),
            ("crops.from", self.crops.iter().any(|crop| crop.from <= 0.0), "one kind of crop must be there from 0 on"),
            ("steps", self.steps > 0, "must be at least 1"),
            ("minutes", self.minutes.is_none_or(|m| m > 0.0 && m.is_finite()), "must be a number > 0"),
            ("first", self.first > 0, "must be at least 1"),
            ("rotate_steps", self.rotate_steps > 0, "must be at least 1"),
            ("window", self.window >= self.first, "must be as much as `first` at least"),
            ("learning_rate", self.learning_rate > 0.0 && self.learning_rate <= 1.0, "must be in 0..=1"),
            ("weight_decay", (0.0..=1.0).contains(&self.weight_decay), "must be in 0..=1"),
            ("clip_norm", positive(self.clip_norm), "must be a number > 0"),
            ("ema_decay", (0.0..1.0).contains(&self.ema_decay), "must be in 0..1"),
            ("checkpoint_steps", self.checkpoint_steps > 0, "must be at least 1"),
            ("log_steps", self.log_steps > 0, "must be at least 1"),
        ];
        match checks.into_iter().find(|(_, fits, _)| !fits) {
            Some((option, _, reason)) => Err(Error::config(option, reason)),
            None => Ok(()),
        }
    }

    fn learnt(&self) -> Result<Vec<Tier>> {
        if self.tiers.is_empty() {
            return Ok(TIERS.to_vec());
        }
        let find = |name: &String| {
            let found = TIERS.into_iter().find(|tier| tier.name == name);
            found.ok_or_else(|| Error::config("tiers", format!("there is no {name:?}")))
        };
        self.tiers.iter().map(find).collect()
    }

    fn settings(&self) -> runner::Settings {
        runner::Settings {
            steps: self.steps,
            minutes: self.minutes,
            method: self.optimizer,
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
}

/// What a batch teaches: the network and its head forwards, the loss, and all derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub struct Objective {
    /// Weights of the loss.
    pub loss: LossWeights,
    /// How convolutions multiply.
    pub products: Products,
}

impl Learner for Objective {
    type Batch = Batch;
    type Model = FusionNet;

    fn learn(&self, model: &FusionNet, _: u64, mut batch: Batch, device: &Device) -> Result<Lesson> {
        let outputs = render::forward(model, self.products, &mut batch, device);
        let values = |tensor: &Tensor<4>| parameters::to_vec(tensor.clone().without_autodiff());
        let fine = values(&outputs.fine);
        let coarse = outputs.coarse.as_ref().map(values).unwrap_or_default();
        let pixels = batch.width * batch.height;
        let parts: Vec<_> = (0..batch.items)
            .into_par_iter()
            .map(|item| {
                let picture = batch.picture(item, &fine, &coarse);
                let (drawn, tape) = picture.draw();
                let truth = &batch.truth[item * pixels..(item + 1) * pixels];
                let (loss, slopes) = loss(batch.width, picture.known, &drawn, truth, self.loss);
                (loss, picture.backward(&tape, &slopes))
            })
            .collect();
        let scale = 1.0 / batch.items as f32;
        let mean = |of: fn(&super::objective::Loss) -> f32| scale * parts.iter().map(|(loss, _)| of(loss)).sum::<f32>();
        let joined = |of: fn(&Slopes) -> &Vec<f32>| -> Vec<f32> {
            parts.iter().flat_map(|(_, slopes)| of(slopes).iter().map(|v| scale * v)).collect()
        };
        let along = |tensor: Tensor<4>, slopes: Vec<f32>| {
            let slopes = Tensor::<4>::from_data(TensorData::new(slopes, tensor.dims()), device);
            (tensor * slopes).sum()
        };
        // The derivative of this sum with respect to the outputs is what the host computed.
        let mut sum = along(outputs.fine, joined(|slopes| &slopes.0));
        if let Some(coarse) = outputs.coarse {
            sum = sum + along(coarse, joined(|slopes| &slopes.1));
        }
        let mut gradients = sum.backward();
        let name = TIERS.iter().find(|tier| tier.groups == batch.groups).map_or("other", |tier| tier.name);
        Ok(Lesson {
            total: mean(|loss| loss.total),
            terms: Vec::new(),
            squares: vec![(name, mean(|loss| loss.display))],
            items: batch.items,
            gradients: parameters::gradients_learning(model, &mut gradients),
        })
    }
}

/// Derivatives of the fine and the coarse outputs of a picture.
type Slopes = (Vec<f32>, Vec<f32>);

/// Sequences in memory; which ones is a function of the step alone.
struct Pool {
    receiver: mpsc::Receiver<(u64, Result<Vec<Record<f16>>>)>,
    window: VecDeque<Arc<Vec<Record<f16>>>>,
    /// Index of the sequence after the last in the window.
    next: u64,
}

/// Sequences `[from, to)` that are there at a step.
fn present(config: &Config, step: u64) -> (u64, u64) {
    let to = config.first + step / config.rotate_steps;
    (to.saturating_sub(config.window), to)
}

impl Pool {
    fn at(&mut self, config: &Config, step: u64, cancel: &AtomicBool) -> Result<Vec<Arc<Vec<Record<f16>>>>> {
        let (from, to) = present(config, step);
        while self.next < to {
            let (i, made) = match self.receiver.recv() {
                Ok(made) => made,
                Err(_) if cancel.load(Ordering::Relaxed) => break,
                Err(_) => return Err(Error::Data { place: "sequences".into(), reason: "their producer stopped".into() }),
            };
            debug_assert_eq!(i, self.next);
            self.window.push_back(Arc::new(made?));
            self.next += 1;
        }
        while self.window.len() as u64 > to - from {
            self.window.pop_front();
        }
        Ok(self.window.iter().cloned().collect())
    }
}

/// Trains, resuming from the checkpoint in `config.output` if there is one. `start` are weights to begin with, `validation` the records
/// that are measured at each checkpoint.
///
/// Batches depend on (seed, step) and the source only. Setting `cancel` stops after the current step with a checkpoint.
///
/// # Errors
/// Bad options or data, an unwritable output folder, a checkpoint of another run, or a loss that is no longer finite.
pub fn run(
    config: &Config,
    source: &dyn Source,
    start: Option<&Fusion>,
    validation: &[Record<f16>],
    progress: &(dyn Fn(&Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Summary> {
    config.validate()?;
    let device = Device::flex().autodiff();
    let mut model = FusionNet::new(&config.network, config.seed, &device)?;
    if let Some(start) = start {
        if start.header().fusion != config.network {
            return Err(Error::config("network", "the weights to begin with are of another size"));
        }
        let values = start.parameters();
        model = parameters::import(model, &values.iter().map(|p| p.values.as_slice()).collect::<Vec<_>>(), &device);
    }
    let tiers = config.learnt()?;
    let runner = Runner {
        config,
        difference: &difference,
        output: &config.output,
        data: Some(source.identity()),
        settings: config.settings(),
        device: device.clone(),
        progress,
        cancel,
    };
    let (sender, receiver) = mpsc::sync_channel(1);
    std::thread::scope(|scope| {
        let batches = |first_step: u64| {
            let (from, to) = present(config, first_step);
            scope.spawn(move || {
                for i in from.. {
                    // The receiver is gone when training has ended.
                    if cancel.load(Ordering::Relaxed) || sender.send((i, source.make(i))).is_err() {
                        return;
                    }
                }
            });
            let mut pool = Pool { receiver, window: VecDeque::new(), next: from };
            while pool.next < to && !cancel.load(Ordering::Relaxed) {
                progress(&Progress::Loading { done: pool.next - from, total: to - from });
                let (_, made) = pool
                    .receiver
                    .recv()
                    .map_err(|_| Error::Data { place: "sequences".into(), reason: "their producer stopped".into() })?;
                pool.window.push_back(Arc::new(made?));
                pool.next += 1;
            }
            let tiers = tiers.clone();
            Ok(move |step: u64| {
                let sequences = pool.at(config, step, cancel)?;
                let records: Vec<&Record<f16>> = sequences.iter().flat_map(|sequence| sequence.iter()).collect();
                let mut rng = step_rng(config.seed, step);
                let share = step as f64 / config.steps as f64;
                let reached = config.crops.iter().filter(|crop| crop.from <= share);
                let crop = reached.max_by(|a, b| a.from.total_cmp(&b.from)).unwrap_or(&config.crops[0]);
                for _ in 0..64 {
                    if let Some(batch) = Batch::draw(&records, &tiers, crop.size, crop.batch, &mut rng) {
                        return Ok(batch);
                    }
                }
                let reason = format!("no record has what is to be learnt, at {} pixels or more a side", crop.size);
                Err(Error::Data { place: "sequences".into(), reason })
            })
        };
        let save = |optimizer: &Optimizer, _: &FusionNet| {
            let header = Header { fusion: config.network.clone(), steps: optimizer.steps, seed: config.seed };
            let averaged = optimizer.averaged();
            let bytes = render::encode(&header, &averaged, Precision::F16)?;
            renderflow_frame::file::write_atomic(&runner::weights_path(&config.output), &bytes)?;
            if !validation.is_empty() {
                let fusion = Fusion::with_parameters(header, &averaged)?;
                let validated = Validation { step: optimizer.steps, psnr: validate(&fusion, validation)? };
                append(&config.output.join("validation.jsonl"), &validated)?;
                progress(&Progress::Validated(validated));
            }
            Ok(())
        };
        runner.run(&Objective { loss: config.loss, products: config.products }, model, batches, &save)
    })
}

/// What is validated: each tier that a record can serve, with all it has; with samples those of one part, of each part where
/// nothing else is given.
pub fn variants(record: &Record<f16>) -> Vec<(String, Chosen)> {
    let has = record.groups().given();
    let mut found = Vec::new();
    for tier in TIERS {
        if has.into_iter().zip(tier.groups.given()).any(|(has, given)| given && !has) {
            continue;
        }
        let all = Chosen { groups: tier.groups, ..Chosen::all(record) };
        if !tier.groups.samples {
            found.push((tier.name.to_owned(), all));
            continue;
        }
        let alone = !tier.groups.keys && !tier.groups.neighbours;
        for part in (0..if alone { PARTS } else { 1 }).filter(|part| record.parts[*part] > 0) {
            let mut chosen = all;
            chosen.parts = std::array::from_fn(|other| other == part);
            chosen.spp = record.parts[part] as f32;
            chosen.picture = if tier.groups.neighbours { AROUND } else { part };
            if !tier.groups.denoised || record.denoised[chosen.picture] {
                found.push((format!("{} {}", tier.name, chosen.spp), chosen));
            }
        }
    }
    found
}

/// Mean PSNR over covered pixels of `records` for each of their [`variants`].
///
/// # Errors
/// When a record is empty.
pub fn validate(fusion: &Fusion, records: &[Record<f16>]) -> Result<BTreeMap<String, f32>> {
    let mut sums: BTreeMap<String, (f64, u32)> = BTreeMap::new();
    for record in records {
        for (name, chosen) in variants(record) {
            let drawn = fusion.draw(record, &chosen)?;
            let sum = sums.entry(name).or_default();
            sum.0 += psnr(record, &drawn);
            sum.1 += 1;
        }
    }
    Ok(sums.into_iter().map(|(name, (sum, count))| (name, (sum / f64::from(count)) as f32)).collect())
}

/// PSNR of the display picture over the covered pixels of a record.
pub fn psnr(record: &Record<f16>, drawn: &[[f32; 3]]) -> f64 {
    let (mut sum, mut count) = (0.0_f64, 0u32);
    for (stored, drawn) in record.pixels.chunks_exact(at::COUNT).zip(drawn) {
        if stored[at::ALPHA] > f16::ZERO {
            for c in 0..3 {
                sum += f64::from(display(drawn[c]) - display(stored[at::TRUTH + c].to_f32())).powi(2);
            }
            count += 3;
        }
    }
    -10.0 * (sum / f64::from(count.max(1))).max(1e-10).log10()
}

fn append(path: &std::path::Path, validated: &Validation) -> Result<()> {
    use std::io::Write;
    let line = serde_json::to_string(validated).map_err(|e| Error::malformed(path, e.to_string()))?;
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path).map_err(Error::io(path, "open"))?;
    writeln!(file, "{line}").map_err(Error::io(path, "write"))
}

/// The first option that may not change between a run and its continuation.
fn difference(a: &Config, b: &Config) -> Option<&'static str> {
    [
        ("network", a.network == b.network),
        ("seed", a.seed == b.seed),
        ("optimizer", a.optimizer == b.optimizer),
        ("first", a.first == b.first),
        ("rotate_steps", a.rotate_steps == b.rotate_steps),
        ("window", a.window == b.window),
    ]
    .into_iter()
    .find(|(_, same)| !same)
    .map(|(option, _)| option)
}
