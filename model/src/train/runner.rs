//! The loop behind every training run: batches one ahead, optimiser, schedule, checkpoints, log, resumption.

use super::checkpoint::{self, CheckpointHeader};
use super::log::Log;
use super::optimizer::{Method, Optimizer, StepSettings};
use super::schedule::{self, Decay};
use crate::parameters;
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::Device;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Instant;

/// Steps in a row whose loss or gradient may not be finite; with one more the run ends. A batch may be at fault, a run of them is not.
const MOST_LEFT_OUT: u32 = 10;

/// What one batch teaches.
pub struct Lesson {
    /// What was minimised; a step whose loss is not finite is left out.
    pub total: f32,
    /// Parts of the loss by name, each before its weight; averaged over the steps that give them.
    pub terms: Vec<(&'static str, f32)>,
    /// Mean squared errors of pictures of 0..=1 by name, likewise.
    pub squares: Vec<(&'static str, f32)>,
    /// Items of the batch.
    pub items: usize,
    /// Gradients in the order of [`parameters::export_learning`].
    pub gradients: Vec<Option<Vec<f32>>>,
}

/// What the loop needs of a kind of training.
pub trait Learner {
    /// One batch.
    type Batch: Send;
    /// The module of which some or all parameters learn.
    type Model: Module;
    /// Loss and gradients of `model` on the batch of `step`; tensors are made on `device`, which records them.
    ///
    /// # Errors
    /// When the batch does not fit the model.
    fn learn(&self, model: &Self::Model, step: u64, batch: Self::Batch, device: &Device) -> Result<Lesson>;
}

/// Numbers that steer a run.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Optimiser steps; where `minutes` is given, an upper bound.
    pub steps: u64,
    /// Minutes over all resumptions.
    pub minutes: Option<f64>,
    /// How a step is taken.
    pub method: Method,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Steps of linear warm-up.
    pub warmup_steps: u64,
    /// What follows the warm-up.
    pub decay: Decay,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest gradient norm.
    pub clip_norm: f32,
    /// Decay of the moving average of the weights.
    pub ema_decay: f32,
    /// Steps between checkpoints.
    pub checkpoint_steps: u64,
    /// Steps between log lines and progress reports.
    pub log_steps: u64,
}

impl Settings {
    /// Share of the run that is done.
    fn share(&self, step: u64, elapsed: f64) -> f64 {
        let by_steps = step as f64 / self.steps as f64;
        self.minutes.map_or(by_steps, |minutes| by_steps.max(elapsed / (60.0 * minutes)))
    }
}

/// A line of the log; averages are over the steps since the line before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogRecord {
    /// Steps done.
    pub step: u64,
    /// Share of the run done, 0..=1.
    pub share: f64,
    /// Mean of [`Lesson::total`].
    pub loss: f32,
    /// Means of [`Lesson::terms`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub terms: BTreeMap<String, f32>,
    /// PSNR in dB of the means of [`Lesson::squares`].
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub psnr: BTreeMap<String, f32>,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f32,
    /// Learning rate.
    pub lr: f64,
    /// Items a second.
    pub items_per_second: f64,
    /// Seconds of training so far, over all resumptions.
    pub elapsed: f64,
    /// Seconds left.
    pub eta: f64,
}

/// A validation of the averaged weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// Steps done.
    pub step: u64,
    /// Mean PSNR in dB by what was validated.
    pub psnr: BTreeMap<String, f32>,
}

/// What a run reports while it goes on.
#[derive(Clone, Debug)]
pub enum Progress {
    /// What is learnt from is made ready before the first step.
    Loading {
        /// Clips or sequences done.
        done: u64,
        /// Clips or sequences to load.
        total: u64,
    },
    /// Something worth knowing, a sentence.
    Note(String),
    /// Steps have been taken.
    Step(LogRecord),
    /// The averaged weights were measured.
    Validated(Validation),
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
    pub last: Option<LogRecord>,
    /// Averaged weights: written at the end and at every checkpoint.
    pub weights: PathBuf,
}

/// Where a run in the folder `output` leaves its averaged weights.
pub fn weights_path(output: &Path) -> PathBuf {
    output.join("weights.safetensors")
}

/// One run in one folder, which gets `checkpoint.safetensors` and `log.jsonl`.
pub struct Runner<'a, C> {
    /// Written into checkpoints.
    pub config: &'a C,
    /// The first option that may not differ between a checkpoint's run and this one.
    pub difference: &'a dyn Fn(&C, &C) -> Option<&'static str>,
    /// Folder.
    pub output: &'a Path,
    /// What the run learns from ([`ClipSource::identity`](crate::data::ClipSource::identity)): another source than the checkpoint's is refused.
    pub data: Option<String>,
    /// Numbers.
    pub settings: Settings,
    /// Device that records gradients.
    pub device: Device,
    /// Told how it goes.
    pub progress: &'a (dyn Fn(&Progress) + Sync),
    /// Stops after the current step.
    pub cancel: &'a AtomicBool,
}

/// Something to be done with the state of the optimiser; see [`Runner::run`].
pub type Save<'a, M> = &'a dyn Fn(&Optimizer, &M) -> Result<()>;

impl<C: Serialize + DeserializeOwned + Clone> Runner<'_, C> {
    /// Trains `model`, resuming from the checkpoint in the folder if there is one. `batches` is given the first step and returns
    /// what makes the batch of a step, called for one step after another on a thread of its own. `save` is called after every
    /// checkpoint and at the end. Returns the trained model too.
    ///
    /// # Errors
    /// Those of its parts, [`Error::Diverged`] after eleven steps in a row that were not finite, and when the folder cannot be written.
    pub fn run<L: Learner, B: FnMut(u64) -> Result<L::Batch> + Send>(
        &self,
        learner: &L,
        model: L::Model,
        batches: impl FnOnce(u64) -> Result<B>,
        save: Save<L::Model>,
    ) -> Result<Summary> {
        let path: PathBuf = self.output.join("checkpoint.safetensors");
        let mut optimizer = Optimizer::new(parameters::export_learning(&model));
        let differs = |old: &C| (self.difference)(old, self.config);
        let resumed = checkpoint::load::<C>(&path, &differs, self.data.as_deref(), &mut optimizer)?;
        if self.data.is_some() && resumed.as_ref().is_some_and(|header| header.data.is_none()) {
            self.note(format!("{}: does not say what its run learned from; it goes on with this data", path.display()));
        }
        let log = self.output.join("log.jsonl");
        let weights = weights_path(self.output);
        if resumed.is_none() && std::fs::symlink_metadata(&weights).is_ok() {
            let reason = "is there already, and no checkpoint says that it is of this run; choose another output folder";
            return Err(Error::malformed(weights, reason));
        }
        Log::check(&log)?;
        let before = resumed.map_or(0.0, |header| header.elapsed);
        let first_step = optimizer.steps;
        // What can be refused is refused before anything is written.
        let mut make = batches(first_step)?;
        let mut log = Log::open(&log, optimizer.steps)?;

        let start = Instant::now();
        let elapsed = || before + start.elapsed().as_secs_f64();
        let (mut meter, mut last) = (Meter::default(), None);
        let keep = |optimizer: &Optimizer, model: &L::Model, elapsed: f64| -> Result<()> {
            let data = self.data.clone();
            let header = CheckpointHeader { config: self.config.clone(), step: optimizer.steps, elapsed, data };
            checkpoint::save(&path, &header, optimizer)?;
            save(optimizer, model)
        };
        // References that may go to another thread; `self` may not.
        let cancel = self.cancel;
        let finished = std::thread::scope(|scope| -> Result<bool> {
            // Batches are made one ahead, on a thread of their own.
            let (sender, receiver) = mpsc::sync_channel::<Result<L::Batch>>(1);
            scope.spawn(move || {
                for step in first_step.. {
                    if cancel.load(Ordering::Relaxed) {
                        return;
                    }
                    let batch = make(step);
                    let failed = batch.is_err();
                    // The receiver is gone when training has ended.
                    if sender.send(batch).is_err() || failed {
                        return;
                    }
                }
            });
            let mut model = parameters::import_learning(model, &optimizer.values(), &self.device);
            let mut left_out = 0;
            loop {
                let share = self.settings.share(optimizer.steps, elapsed());
                if share >= 1.0 || cancel.load(Ordering::Relaxed) {
                    keep(&optimizer, &model, elapsed())?;
                    return Ok(share >= 1.0);
                }
                let batch = match receiver.recv() {
                    // The producer saw the request to stop first, perhaps in the middle of its work.
                    Ok(Err(_)) if cancel.load(Ordering::Relaxed) => continue,
                    Ok(batch) => batch?,
                    Err(_) if cancel.load(Ordering::Relaxed) => continue,
                    Err(_) => return Err(Error::Data { place: "batches".into(), reason: "producer stopped".into() }),
                };
                let lr = schedule::rate(self.settings, optimizer.steps, share);
                let lesson = learner.learn(&model, optimizer.steps, batch, &self.device)?;
                match self.step(&mut optimizer, &lesson, lr) {
                    Ok(norm) => {
                        left_out = 0;
                        model = parameters::import_learning(model, &optimizer.values(), &self.device);
                        meter.add(&lesson, norm);
                    }
                    Err(what) if left_out == MOST_LEFT_OUT => {
                        return Err(Error::Diverged { step: optimizer.steps, what });
                    }
                    Err(what) => {
                        left_out += 1;
                        self.note(format!("step {}: {what} is not finite; the step is left out", optimizer.steps));
                        optimizer.steps += 1;
                    }
                }
                if optimizer.steps.is_multiple_of(self.settings.log_steps) {
                    let record = self.record(&meter, optimizer.steps, lr, [before, elapsed()], first_step);
                    log.append(&record)?;
                    (self.progress)(&Progress::Step(record.clone()));
                    last = Some(record);
                    meter = Meter::default();
                }
                if optimizer.steps.is_multiple_of(self.settings.checkpoint_steps) {
                    keep(&optimizer, &model, elapsed())?;
                }
            }
        })?;
        Ok(Summary { steps: optimizer.steps, elapsed: elapsed(), finished, last, weights: weights_path(self.output) })
    }

    fn note(&self, note: String) {
        (self.progress)(&Progress::Note(note));
    }

    /// Takes a step; says what is not finite, where nothing is changed.
    fn step(&self, optimizer: &mut Optimizer, lesson: &Lesson, lr: f64) -> std::result::Result<f32, String> {
        if !lesson.total.is_finite() {
            return Err("the loss".into());
        }
        let settings = StepSettings {
            method: self.settings.method,
            learning_rate: lr as f32,
            weight_decay: self.settings.weight_decay,
            clip_norm: self.settings.clip_norm,
            ema_decay: self.settings.ema_decay,
        };
        optimizer.step(&lesson.gradients, settings).map_err(|what| format!("the gradient of {what}"))
    }

    fn record(&self, meter: &Meter, step: u64, lr: f64, [before, elapsed]: [f64; 2], first_step: u64) -> LogRecord {
        let n = meter.steps.max(1) as f64;
        // By steps from this session's own rate; by time where that ends the run earlier.
        let rate = (elapsed - before) / (step - first_step).max(1) as f64;
        let by_steps = rate * self.settings.steps.saturating_sub(step) as f64;
        let eta = self.settings.minutes.map_or(by_steps, |minutes| by_steps.min((60.0 * minutes - elapsed).max(0.0)));
        let means = |of: &Sums| of.iter().map(|(&name, &(sum, count))| (name.to_owned(), (sum / count as f64) as f32)).collect();
        let mut psnr: BTreeMap<String, f32> = means(&meter.squares);
        psnr.values_mut().for_each(|square| *square = -10.0 * square.max(1e-10).log10());
        LogRecord {
            step,
            share: self.settings.share(step, elapsed).min(1.0),
            loss: (meter.total / n) as f32,
            terms: means(&meter.terms),
            psnr,
            gradient_norm: (meter.norm / n) as f32,
            lr,
            items_per_second: meter.items as f64 / meter.since.elapsed().as_secs_f64().max(1e-9),
            elapsed,
            eta,
        }
    }
}

/// Sum and number of values by name.
type Sums = BTreeMap<&'static str, (f64, u64)>;

/// Sums since the last log line.
struct Meter {
    since: Instant,
    steps: u64,
    items: usize,
    total: f64,
    terms: Sums,
    squares: Sums,
    norm: f64,
}

impl Default for Meter {
    fn default() -> Self {
        Self { since: Instant::now(), steps: 0, items: 0, total: 0.0, terms: Sums::new(), squares: Sums::new(), norm: 0.0 }
    }
}

impl Meter {
    fn add(&mut self, lesson: &Lesson, norm: f32) {
        self.steps += 1;
        self.items += lesson.items;
        self.total += f64::from(lesson.total);
        self.norm += f64::from(norm);
        for (sums, values) in [(&mut self.terms, &lesson.terms), (&mut self.squares, &lesson.squares)] {
            for &(name, value) in values {
                let (sum, count) = sums.entry(name).or_default();
                *sum += f64::from(value);
                *count += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::init::Init;
    use crate::network::layers::Conv;
    use std::sync::Mutex;

    /// The batch is the value of every gradient.
    struct Toy;

    impl Learner for Toy {
        type Batch = f32;
        type Model = Conv;

        fn learn(&self, model: &Conv, _: u64, batch: f32, _: &Device) -> Result<Lesson> {
            let like = |parameter: &parameters::Parameter| Some(vec![batch; parameter.values.len()]);
            let gradients = parameters::export_learning(model).iter().map(like).collect();
            Ok(Lesson { total: 1.0, terms: vec![("one", 1.0)], squares: vec![("picture", 0.01)], items: 1, gradients })
        }
    }

    /// What a run of 40 steps left, and its notes; batches are NaN at the steps that are `broken`.
    fn run(broken: impl Fn(u64) -> bool + Send) -> (Result<Summary>, Vec<String>) {
        let folder = tempfile::tempdir().expect("a folder");
        let notes = Mutex::new(Vec::new());
        let device = Device::flex().autodiff();
        let runner = Runner {
            config: &1_u32,
            difference: &|_, _| None,
            output: folder.path(),
            data: None,
            settings: Settings {
                steps: 40,
                minutes: None,
                method: Method::AdamW,
                learning_rate: 0.1,
                warmup_steps: 1,
                decay: Decay::Constant,
                weight_decay: 0.0,
                clip_norm: 1.0,
                ema_decay: 0.5,
                checkpoint_steps: 10,
                log_steps: 20,
            },
            device: device.clone(),
            progress: &|progress| {
                if let Progress::Note(note) = progress {
                    notes.lock().expect("notes").push(note.clone());
                }
            },
            cancel: &AtomicBool::new(false),
        };
        let model = Conv::new(&mut Init::new(1, &device), 1, 1, 1, 1.0);
        let batch = move |step: u64| Ok(if broken(step) { f32::NAN } else { 1.0 });
        let finite = |optimizer: &Optimizer, _: &Conv| {
            assert!(optimizer.values().iter().flat_map(|values| values.iter()).all(|v| v.is_finite()));
            Ok(())
        };
        let summary = runner.run(&Toy, model, |_| Ok(batch), &finite);
        (summary, notes.into_inner().expect("notes"))
    }

    #[test]
    fn steps_that_are_not_finite_are_named_and_left_out() {
        let (summary, notes) = run(|step| step == 7 || (20..30).contains(&step));
        let summary = summary.expect("a run");
        assert_eq!(summary.steps, 40);
        let last = summary.last.expect("a line");
        assert_eq!((last.step, last.terms["one"], last.psnr["picture"].round()), (40, 1.0, 20.0));
        assert_eq!(notes.len(), 11);
        assert_eq!(notes[0], "step 7: the gradient of weight is not finite; the step is left out");
        let (ended, notes) = run(|step| step >= 5);
        let said = ended.expect_err("nothing can be learnt").to_string();
        assert!(said.starts_with("step 15: the gradient of weight is not finite"), "{said}");
        assert_eq!(notes.len(), 10);
    }
}
