//! Training: sequences arrive from an endless source, the newest are kept in memory, and crops of their frames make the batches.
//! The averaged weights are validated on a fixed set at every checkpoint.

use super::batch::{Batch, target};
use super::example::Example;
use super::find::{Header, Inverse};
use super::graph::{CHANNELS, InverseConfig, InverseNet, MULTIPLE, place};
use super::head::OUTPUTS;
use super::loss::{Loss, LossWeights, loss};
use crate::data::step_rng;
use crate::fusion::training::Source;
use crate::ops::Products;
use crate::parameters;
use crate::train::config::{self, Method, RunConfig, TrainingConfig, first_difference};
use crate::train::optimizer::Optimizer;
use crate::train::runner::{self, Objective, Progress, RunContext, Runner, StepResult, Summary, Validation};
use crate::train::sequences::{Crop, Rotation};
use crate::weights::Precision;
use crate::{Error, Result};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::BTreeMap;

/// Options of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")]
pub struct Config {
    /// The network.
    pub network: InverseConfig,
    /// The options that every run has.
    #[serde(flatten)]
    pub run: RunConfig,
    /// Kinds of crop, at least one of which begins at 0. At any time, the kind that began last is drawn.
    pub crops: Vec<Crop>,
    /// Number of sequences that are made before the first step, at least 1.
    pub first: u64,
    /// Number of steps after which one more sequence is used, at least 1.
    pub rotate_steps: u64,
    /// Number of sequences in memory, at least `first`. The newest are kept. A frame of 256 x 256 takes 1.8 MB.
    pub window: u64,
    /// How convolutions multiply, forwards and backwards.
    pub products: Products,
    /// Weights of the terms of the loss.
    pub loss: LossWeights,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: InverseConfig::default(),
            run: RunConfig {
                steps: 20_000,
                optimizer: Method::Muon,
                // At .003, gradients grew a thousandfold now and then, and the network learned little of the material.
                learning_rate: 1e-3,
                clip_norm: 0.5,
                weight_decay: 0.01,
                checkpoint_steps: 250,
                log_steps: 25,
                ..RunConfig::default()
            },
            crops: vec![Crop { size: 128, batch: 8, from: 0.0 }, Crop { size: 256, batch: 4, from: 0.5 }],
            first: 40,
            rotate_steps: 20,
            window: 1000,
            products: Products::Bf16,
            loss: LossWeights::default(),
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
        self.run.validate()?;
        Crop::check(&self.crops, MULTIPLE)?;
        self.loss.validate()?;
        self.rotation().validate()
    }

    /// The sequences in memory.
    fn rotation(&self) -> Rotation {
        Rotation { first: self.first, rotate_steps: self.rotate_steps, window: self.window }
    }
}

/// The loss of crops whose buffers the network finds. The network runs on tensors; what follows it, and its derivative, runs on
/// the host.
#[derive(Clone, Copy, Debug, Default)]
pub struct InverseObjective {
    /// Weights of the terms of the loss.
    pub loss: LossWeights,
    /// How convolutions multiply.
    pub products: Products,
}

impl Objective for InverseObjective {
    type Batch = Batch;
    type Model = InverseNet;

    fn step(&self, model: &InverseNet, mut batch: Batch, device: &Device) -> Result<StepResult> {
        let shape = [batch.items, batch.height / 2, batch.width / 2, 4 * CHANNELS];
        let input = Tensor::from_data(TensorData::new(std::mem::take(&mut batch.input), shape), device);
        let outputs = model.forward(self.products, input);
        let values = parameters::read(outputs.clone().without_autodiff())?;
        let pixels = batch.width * batch.height;
        let of_item = |item: usize| {
            let (from, to) = (item * pixels, (item + 1) * pixels);
            let stored = &values[from * OUTPUTS..to * OUTPUTS];
            let mut by_rows = vec![0.0; stored.len()];
            let places = (0..pixels).map(|i| place(batch.width, OUTPUTS, i % batch.width, i / batch.width));
            for (row, at) in by_rows.chunks_exact_mut(OUTPUTS).zip(places.clone()) {
                row.copy_from_slice(&stored[at..at + OUTPUTS]);
            }
            let (loss, by_rows) = loss(batch.width, &batch.display[from..to], &by_rows, &batch.targets[from..to], &self.loss);
            let mut slopes = vec![0.0; stored.len()];
            for (row, at) in by_rows.chunks_exact(OUTPUTS).zip(places) {
                slopes[at..at + OUTPUTS].copy_from_slice(row);
            }
            (loss, slopes)
        };
        let parts: Vec<(Loss, Vec<f32>)> = (0..batch.items).into_par_iter().map(of_item).collect();
        let scale = 1.0 / batch.items as f32;
        let mean = |of: fn(&Loss) -> f32| scale * parts.iter().map(|(loss, _)| of(loss)).sum::<f32>();
        let slopes: Vec<f32> = parts.iter().flat_map(|(_, slopes)| slopes.iter().map(|v| scale * v)).collect();
        let slopes = Tensor::<4>::from_data(TensorData::new(slopes, outputs.dims()), device);
        // The derivative of this sum with respect to the outputs is the one that the host computed.
        let mut gradients = (outputs * slopes).sum().backward();
        let [roughness, metallic, specular]: [fn(&Loss) -> f32; 3] = [|l| l.material[0], |l| l.material[1], |l| l.material[2]];
        Ok(StepResult {
            total: mean(|loss| loss.total),
            terms: vec![
                ("normal", mean(|loss| loss.normal)),
                ("depth", mean(|loss| loss.depth)),
                ("roughness", mean(roughness)),
                ("metallic", mean(metallic)),
                ("specular", mean(specular)),
            ],
            squares: vec![("albedo", mean(|loss| loss.albedo))],
            items: batch.items,
            gradients: parameters::gradients_learning(model, &mut gradients),
        })
    }
}

/// Trains a network, and resumes from the checkpoint in the output folder if there is one. `start` holds weights to begin with,
/// `validation` the frames that are validated at each checkpoint.
///
/// Batches depend on the seed, the step and the source alone. Each process of a team makes its share of them.
///
/// # Errors
/// For invalid options or data, an output folder that cannot be written, a checkpoint of another run, a loss that stays not
/// finite, or a device that fails.
pub fn run(
    config: &Config,
    source: &dyn Source,
    start: Option<&Inverse>,
    validation: &[Example],
    context: RunContext,
) -> Result<Summary> {
    config.validate()?;
    context.team.share().check_crops(&config.crops)?;
    let context = context.reporting();
    let device = context.autodiff();
    let model = match start {
        None => InverseNet::new(&config.network, config.run.seed, &device)?,
        Some(start) if start.header().inverse == config.network => start.on(&device)?,
        Some(_) => return Err(Error::config("network", "the weights to begin with are of another size")),
    };
    let runner = Runner { config, data: Some(source.identity()), context };
    std::thread::scope(|scope| {
        let batches = |first_step: u64| {
            let make = |i: u64| Ok(source.make(i)?.iter().map(Example::of).collect::<Vec<Example>>());
            let mut pool = config.rotation().load(scope, make, first_step, context.cancel, context.progress)?;
            let share = context.team.share();
            Ok(move |step: u64| {
                let sequences = pool.at(step)?;
                let examples: Vec<&Example> = sequences.iter().flat_map(|sequence| sequence.iter()).collect();
                let crop = Crop::at(&config.crops, config.run.share(step, 0.0));
                let batch = Batch::draw(&examples, crop, share, &mut step_rng(config.run.seed, step));
                batch.ok_or_else(|| {
                    let reason = format!("no frame has at least {} pixels a side", crop.size);
                    Error::Data { place: "sequences".into(), reason }
                })
            })
        };
        let save = |optimizer: &Optimizer, _: &InverseNet| save(config, optimizer, validation, context);
        runner.run(&InverseObjective { loss: config.loss, products: config.products }, model, batches, &save)
    })
}

/// Writes the averaged weights and validates them.
fn save(config: &Config, optimizer: &Optimizer, validation: &[Example], context: RunContext) -> Result<()> {
    let header = Header { inverse: config.network.clone(), steps: optimizer.steps, seed: config.run.seed };
    let averaged = Inverse::with_parameters(header, &optimizer.averaged())?.to(context.device)?;
    // On the processor, it is validated as it was trained.
    let products = if context.device.is_cpu() { config.products } else { context.device.products() };
    let averaged = averaged.with_products(products);
    averaged.save(&runner::weights_path(&config.run.output), Precision::F16)?;
    if !validation.is_empty() {
        let validated = validate(&averaged, validation)?;
        let validated = Validation { step: optimizer.steps, ..validated };
        validated.append(&config.run.output)?;
        (context.progress)(&Progress::Validated(validated));
    }
    Ok(())
}

/// Mean errors of the buffers that are found behind the pictures of `examples`, over the pixels that see a surface: PSNR of the
/// albedo in dB, the mean angle of normals in degrees where a normal is known, the mean absolute error of half the logarithm of
/// depth after the best shift, and roots of mean squares of roughness and metallic.
///
/// # Errors
/// When an example is empty.
pub fn validate(inverse: &Inverse, examples: &[Example]) -> Result<Validation> {
    let mut sums = [0.0_f64; 5];
    // Of all examples, and of those with a normal.
    let mut counts = [0.0_f64; 2];
    for example in examples {
        let (width, height) = (example.width, example.height);
        let picture = Rgb::from_fn(width, height, |x, y| renderflow_frame::color::display(example.at(x, y).radiance, 1.0));
        let found = inverse.find(&picture)?;
        let targets: Vec<_> = (0..width * height).map(|i| target(&example.at(i % width, i / width))).collect();
        let seen: Vec<usize> = (0..targets.len()).filter(|i| targets[*i].weight > 0.0).collect();
        if seen.is_empty() {
            continue;
        }
        let mean_over = |pixels: &[usize], of: &dyn Fn(usize) -> f32| {
            pixels.iter().map(|i| f64::from(of(*i))).sum::<f64>() / pixels.len() as f64
        };
        let mean = |of: &dyn Fn(usize) -> f32| mean_over(&seen, of);
        let squares = |a: [f32; 3], b: [f32; 3]| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f32>() / 3.0;
        let material = |c: usize| mean(&|i| (found.material.pixels[i][c] - targets[i].pixel.material[c]).powi(2)).sqrt();
        let angle = |i: usize| {
            let [a, b] = [found.normal.pixels[i], targets[i].pixel.normal].map(glam::Vec3::from);
            a.cross(b).length().atan2(a.dot(b)).to_degrees()
        };
        let difference = |i: usize| found.depth.pixels[i] - targets[i].pixel.depth;
        let shift = mean(&difference) as f32;
        sums[0] -= 10.0 * mean(&|i| squares(found.albedo.pixels[i], targets[i].pixel.albedo)).max(1e-10).log10();
        // A pixel that is hardly covered, or whose normals cancel, has none.
        let known: Vec<usize> = seen.iter().copied().filter(|i| targets[*i].pixel.normal != [0.0; 3]).collect();
        if !known.is_empty() {
            sums[1] += mean_over(&known, &angle);
            counts[1] += 1.0;
        }
        counts[0] += 1.0;
        sums[2] += mean(&|i| (difference(i) - shift).abs());
        sums[3] += material(0);
        sums[4] += material(1);
    }
    let mean = |k: usize| (sums[k] / f64::max(counts[usize::from(k == 1)], 1.0)) as f32;
    let [psnr, angle, depth, roughness, metallic] = [0, 1, 2, 3, 4].map(mean);
    let others = [("normals, degrees", angle), ("depth", depth), ("roughness", roughness), ("metallic", metallic)];
    Ok(Validation {
        step: 0,
        psnr: BTreeMap::from([("albedo".to_owned(), psnr)]),
        others: others.into_iter().map(|(name, value)| (name.to_owned(), value)).collect(),
    })
}
