//! The loop of every training run: it prepares batches one step ahead, updates the parameters, and writes checkpoints and the
//! log.

use super::checkpoint::{self, CheckpointHeader};
use super::config::{RunConfig, TrainingConfig};
use super::log::Log;
use super::optimizer::Optimizer;
use super::resident::{Refused, Resident};
use super::schedule;
use super::team::Team;
use crate::device::NetworkDevice;
use crate::parameters;
use crate::{Error, Result};
use burn::module::Module;
use burn::tensor::Device;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Instant;

pub use super::report::{LogRecord, Progress, StepResult, VALIDATIONS, Validation};

/// How many steps in a row may have a loss or gradient that is not finite. One more ends the run: a single batch may be at fault,
/// but not all of them.
const MOST_LEFT_OUT: u32 = 10;

/// What a network is trained to do: a model, and a loss on batches.
pub trait Objective {
    /// One batch.
    type Batch: Send;
    /// The module of which some or all parameters learn.
    type Model: Module;
    /// The loss of `model` on a batch, and its gradients. Tensors are made on `device`, which records operations.
    ///
    /// # Errors
    /// When the batch does not fit the model.
    fn step(&self, model: &Self::Model, batch: Self::Batch, device: &Device) -> Result<StepResult>;
}

/// The outcome of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Steps done over all resumptions.
    pub steps: u64,
    /// Seconds of training over all resumptions.
    pub elapsed: f64,
    /// Whether the run reached its end. If not, it was cancelled and can be resumed.
    pub finished: bool,
    /// The last line of the log, if any was written.
    pub last: Option<LogRecord>,
    /// File of the averaged weights, which is written at every checkpoint and at the end.
    pub weights: PathBuf,
}

/// The file of the averaged weights of a run in the folder `output`.
pub fn weights_path(output: &Path) -> PathBuf {
    output.join("weights.safetensors")
}

/// What a run needs besides its configuration and its data. None of it is stored in checkpoints.
#[derive(Clone, Copy)]
pub struct RunContext<'a> {
    /// Device that computes gradients and takes the steps. The losses of the fusion and the inverse network are computed on the
    /// host.
    pub device: &'a NetworkDevice,
    /// Receives progress.
    pub progress: &'a (dyn Fn(&Progress) + Sync),
    /// Stops the run after the current step, with a checkpoint.
    pub cancel: &'a AtomicBool,
    /// The processes that train together. Each makes its [`Share`](super::Share) of every batch.
    pub team: &'a Team,
}

impl RunContext<'_> {
    /// The same, where only the process that leads the team reports progress.
    pub(crate) fn reporting(self) -> Self {
        Self { progress: self.team.report(self.progress), ..self }
    }

    /// The device, which records operations.
    pub fn autodiff(&self) -> Device {
        self.device.device().clone().autodiff()
    }
}

/// One run in the folder that its configuration names.
pub struct Runner<'a, C> {
    /// Options. They are stored in checkpoints.
    pub config: &'a C,
    /// Identity of the training data ([`ClipSource::identity`](crate::data::ClipSource::identity)). A checkpoint of other data is
    /// refused.
    pub data: Option<String>,
    /// Where it runs, and who is told.
    pub context: RunContext<'a>,
}

/// Writes weights from the state of the optimiser and the model; see [`Runner::run`].
pub type Save<'a, M> = &'a dyn Fn(&Optimizer, &M) -> Result<()>;

impl<C: TrainingConfig> Runner<'_, C> {
    /// Trains `model`, and resumes from the checkpoint in the folder if there is one.
    ///
    /// `batches` receives the first step and returns the function that makes the batch of a step. That function is called for one
    /// step after another, on a thread of its own. `save` is called after every checkpoint and at the end, once for a step, on
    /// the process that leads its team.
    ///
    /// # Errors
    /// When the objective, a batch or `save` fails, or when the folder cannot be written. [`Error::Diverged`] after eleven steps
    /// in a row that were not finite. [`Error::Device`] when the device fails, after a checkpoint.
    pub fn run<O: Objective, B: FnMut(u64) -> Result<O::Batch> + Send>(
        &self,
        objective: &O,
        model: O::Model,
        batches: impl FnOnce(u64) -> Result<B>,
        save: Save<O::Model>,
    ) -> Result<Summary> {
        let run = self.config.run();
        let path: PathBuf = run.output.join("checkpoint.safetensors");
        let mut optimizer = Optimizer::new(parameters::export_learning(&model));
        let differs = |old: &C| run.difference(old.run()).or_else(|| self.config.difference(old));
        let resumed = checkpoint::load::<C>(&path, &differs, self.data.as_deref(), &mut optimizer)?;
        if self.data.is_some() && resumed.as_ref().is_some_and(|header| header.data.is_none()) {
            self.note(format!(
                "{}: does not say which data its run learned from; the run continues with this data",
                path.display()
            ));
        }
        let log = run.output.join("log.jsonl");
        let weights = weights_path(&run.output);
        if resumed.is_none() && std::fs::symlink_metadata(&weights).is_ok() {
            let reason = "exists already, and there is no checkpoint of this run beside it; choose another output folder";
            return Err(Error::malformed(weights, reason));
        }
        Log::check(&log)?;
        let resumed_at = resumed.as_ref().map(|header| header.step);
        let before = resumed.map_or(0.0, |header| header.elapsed);
        let first_step = optimizer.steps;
        // Everything that can be refused is refused before anything is written.
        let mut make = batches(first_step)?;
        let options = serde_json::to_string(&(self.config, &self.data)).map_err(|e| Error::malformed(&path, e.to_string()))?;
        self.context.team.check_start(&options, &optimizer)?;
        let mut log = if self.context.team.leads() { Some(Log::open(&log, optimizer.steps)?) } else { None };
        let validations = run.output.join(VALIDATIONS);
        if log.is_some() && resumed_at.is_some() && validations.exists() {
            // A run that was killed may have left half a line.
            Log::open(&validations, optimizer.steps)?;
        }

        let sizes: Vec<usize> = optimizer.slots.iter().map(|slot| slot.first.len()).collect();
        let mut optimizer = Resident::new(optimizer, self.context.device);
        let start = Instant::now();
        let elapsed = || before + start.elapsed().as_secs_f64();
        let (mut meter, mut last) = (Meter::default(), None);
        let checkpoint = |optimizer: &Optimizer, elapsed: f64| -> Result<()> {
            let data = self.data.clone();
            let header = CheckpointHeader { config: self.config.clone(), step: optimizer.steps, elapsed, data };
            checkpoint::save(&path, &header, optimizer)
        };
        let keep = |optimizer: &Resident, model: &O::Model, elapsed: f64, saved: Option<u64>| -> Result<()> {
            if !self.context.team.leads() {
                return Ok(());
            }
            let optimizer = optimizer.on_host()?;
            checkpoint(&optimizer, elapsed)?;
            // The weights of a step are written, and validated, once. The time of the run has gone on.
            if saved == Some(optimizer.steps) { Ok(()) } else { save(&optimizer, model) }
        };
        // This reference may go to another thread; `self` may not.
        let cancel = self.context.cancel;
        let device = self.context.autodiff();
        let finished = std::thread::scope(|scope| -> Result<bool> {
            // Batches are made one step ahead, on a thread of their own.
            let (sender, receiver) = mpsc::sync_channel::<Result<O::Batch>>(1);
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
            let mut model = optimizer.put_into(model, &device);
            // The step of the last checkpoint, and that of the last one of this session.
            let (mut left_out, mut kept, mut saved) = (0, resumed_at, None);
            loop {
                let (elapsed_now, stop) = self.context.team.agree(elapsed(), cancel.load(Ordering::Relaxed))?;
                let share = run.share(optimizer.steps(), elapsed_now);
                if stop {
                    // Another process may have been told to stop. What is being made here is not needed any more.
                    cancel.store(true, Ordering::Relaxed);
                }
                if share >= 1.0 || stop {
                    // A run that is stopped before its first step has nothing to keep, and may begin with other options.
                    if share >= 1.0 || optimizer.steps() > first_step {
                        keep(&optimizer, &model, elapsed(), saved)?;
                    }
                    self.context.team.part()?;
                    return Ok(share >= 1.0);
                }
                let batch = match receiver.recv() {
                    // The producer saw the request to stop first, perhaps while it made a batch.
                    Ok(Err(_)) | Err(_) if cancel.load(Ordering::Relaxed) => None,
                    Ok(batch) => Some(batch?),
                    Err(_) => return Err(Error::Data { place: "batches".into(), reason: "producer stopped".into() }),
                };
                let lacking = self.context.team.any(batch.is_none())?;
                let Some(batch) = batch.filter(|_| !lacking) else { continue };
                let lr = schedule::rate(run, optimizer.steps(), share);
                let taken = objective.step(&model, batch, &device).and_then(|mut result| {
                    self.context.team.mean(&mut result, &sizes, run.gradients, self.context.device.device())?;
                    let norm = self.update(&mut optimizer, &mut result, lr)?;
                    Ok((result, norm))
                });
                let (result, norm) = match taken {
                    Err(Error::Device { device, reason }) if self.context.team.size() == 1 => {
                        let kept = match (&optimizer, kept) {
                            (Resident::Host(optimizer), _) => {
                                checkpoint(optimizer, elapsed())?;
                                "what was learned is kept".to_owned()
                            }
                            (Resident::Device(_), Some(step)) => format!("what was learned until step {step} is kept"),
                            (Resident::Device(_), None) => "this was before the first checkpoint".to_owned(),
                        };
                        let reason = format!("{reason}; {kept}; smaller or fewer crops in a batch need less memory");
                        return Err(Error::Device { device, reason });
                    }
                    taken => taken?,
                };
                match norm {
                    Ok(norm) => {
                        left_out = 0;
                        model = optimizer.put_into(model, &device);
                        meter.add(&result, self.context.team.size(), norm);
                    }
                    Err(what) if left_out == MOST_LEFT_OUT => {
                        return Err(Error::Diverged { step: optimizer.steps(), what });
                    }
                    Err(what) => {
                        left_out += 1;
                        self.note(format!("step {}: {what} is not finite; the step is left out", optimizer.steps()));
                        optimizer.pass();
                    }
                }
                let steps = optimizer.steps();
                // Where every step was left out, there is nothing to log.
                if steps.is_multiple_of(run.log_steps) && meter.steps > 0 {
                    let record = self.record(&meter, steps, lr, [before, elapsed()], first_step);
                    log.as_mut().map_or(Ok(()), |log| log.append(&record))?;
                    (self.context.progress)(&Progress::Step(record.clone()));
                    last = Some(record);
                    meter = Meter::default();
                }
                if steps.is_multiple_of(run.checkpoint_steps) {
                    if self.context.team.size() > 1 {
                        let mut own = optimizer.on_host()?.into_owned();
                        if self.context.team.level(&mut own)? {
                            optimizer.replace(own);
                            model = optimizer.put_into(model, &device);
                        }
                    }
                    keep(&optimizer, &model, elapsed(), saved)?;
                    (kept, saved) = (Some(steps), Some(steps));
                }
            }
        })?;
        Ok(Summary { steps: optimizer.steps(), elapsed: elapsed(), finished, last, weights })
    }

    fn note(&self, note: String) {
        (self.context.progress)(&Progress::Note(note));
    }

    /// Takes a step with the gradients of `result`, and returns their norm, or what is not finite; then nothing is changed.
    fn update(&self, optimizer: &mut Resident, result: &mut StepResult, lr: f64) -> Result<std::result::Result<f32, String>> {
        let gradients = std::mem::take(&mut result.gradients);
        if !result.total.is_finite() {
            // A device that has failed says so when its gradients are read.
            parameters::read_gradients(gradients)?;
            return Ok(Err("the loss".into()));
        }
        match optimizer.step(gradients, lr as f32, self.config.run()) {
            Ok(norm) => Ok(Ok(norm)),
            Err(Refused::NotFinite(what)) => Ok(Err(what)),
            Err(Refused::Failed(error)) => Err(error),
        }
    }

    fn record(&self, meter: &Meter, step: u64, lr: f64, [before, elapsed]: [f64; 2], first_step: u64) -> LogRecord {
        let (run, n): (&RunConfig, f64) = (self.config.run(), meter.steps.max(1) as f64);
        // The estimate uses the speed of this session, or the minutes if they end the run earlier.
        let rate = (elapsed - before) / (step - first_step).max(1) as f64;
        let by_steps = rate * run.steps.saturating_sub(step) as f64;
        let eta = run.minutes.map_or(by_steps, |minutes| by_steps.min((60.0 * minutes - elapsed).max(0.0)));
        let means = |of: &Sums| of.iter().map(|(&name, &(sum, count))| (name.to_owned(), (sum / count as f64) as f32)).collect();
        let mut psnr: BTreeMap<String, f32> = means(&meter.squares);
        psnr.values_mut().for_each(|square| *square = -10.0 * square.max(1e-10).log10());
        LogRecord {
            step,
            share: run.share(step, elapsed).min(1.0),
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

/// Sum and number of values, by name.
type Sums = BTreeMap<&'static str, (f64, u64)>;

/// Sums since the previous line of the log.
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
    /// Adds a step of `processes`, whose mean is `result`.
    fn add(&mut self, result: &StepResult, processes: usize, norm: f32) {
        self.steps += 1;
        self.items += result.items * processes;
        self.total += f64::from(result.total);
        self.norm += f64::from(norm);
        for (sums, values) in [(&mut self.terms, &result.terms), (&mut self.squares, &result.squares)] {
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
    use super::super::config::Decay;
    use super::*;
    use crate::network::init::Init;
    use crate::network::layers::Conv;
    use burn::tensor::Tensor;
    use std::sync::Mutex;

    /// Options of a run that has no others.
    impl TrainingConfig for RunConfig {
        fn run(&self) -> &RunConfig {
            self
        }

        fn difference(&self, _: &Self) -> Option<&'static str> {
            None
        }
    }

    /// Every gradient is the batch. The device fails where it is infinite.
    struct Toy;

    impl Objective for Toy {
        type Batch = f32;
        type Model = Conv;

        fn step(&self, model: &Conv, batch: f32, _: &Device) -> Result<StepResult> {
            if batch.is_infinite() {
                return Err(Error::Device { device: "gpu".into(), reason: "lost".into() });
            }
            let like = |parameter: &parameters::Parameter| {
                Some(Tensor::from_data(vec![batch; parameter.values.len()].as_slice(), &Device::flex()))
            };
            let gradients = parameters::export_learning(model).iter().map(like).collect();
            Ok(StepResult { total: 1.0, terms: vec![("one", 1.0)], squares: vec![("picture", 0.01)], items: 1, gradients })
        }
    }

    /// The outcome of a run of 40 steps, and its notes. Batches are NaN at the steps that are `broken`.
    fn run(broken: impl Fn(u64) -> bool + Send) -> (Result<Summary>, Vec<String>) {
        let folder = tempfile::tempdir().expect("a folder");
        run_in(folder.path(), move |step: u64| if broken(step) { f32::NAN } else { 1.0 })
    }

    /// The same in a folder, with any batches.
    fn run_in(folder: &Path, batch: impl Fn(u64) -> f32 + Send) -> (Result<Summary>, Vec<String>) {
        let notes = Mutex::new(Vec::new());
        let config = RunConfig {
            output: folder.into(),
            steps: 40,
            learning_rate: 0.1,
            warmup_steps: 1,
            decay: Decay::Constant,
            weight_decay: 0.0,
            ema_decay: 0.5,
            checkpoint_steps: 10,
            ..RunConfig::default()
        };
        let context = RunContext {
            device: &NetworkDevice::cpu(),
            progress: &|progress| {
                if let Progress::Note(note) = progress {
                    notes.lock().expect("notes").push(note.clone());
                }
            },
            cancel: &AtomicBool::new(false),
            team: &Team::alone(),
        };
        let model = Conv::new(&mut Init::new(1, &context.autodiff()), 1, 1, 1, 1.0);
        let runner = Runner { config: &config, data: None, context };
        let saved = Mutex::new(Vec::new());
        let finite = |optimizer: &Optimizer, _: &Conv| {
            assert!(optimizer.values().iter().flat_map(|values| values.iter()).all(|v| v.is_finite()));
            saved.lock().expect("steps").push(optimizer.steps);
            Ok(())
        };
        let summary = runner.run(&Toy, model, |_| Ok(move |step| Ok(batch(step))), &finite);
        let saved = saved.into_inner().expect("steps");
        assert!(saved.is_sorted_by(|a, b| a < b), "the last step has a checkpoint of its own, and is saved once: {saved:?}");
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

    #[test]
    fn what_was_learned_outlives_the_device() {
        let folder = tempfile::tempdir().expect("a folder");
        let (ended, _) = run_in(folder.path(), |step| if step == 17 { f32::INFINITY } else { 1.0 });
        let said = ended.expect_err("the device is lost").to_string();
        assert!(said.starts_with("device gpu: lost; what was learned is kept"), "{said}");
        let validations = folder.path().join(VALIDATIONS);
        std::fs::write(&validations, "{\"step\":10}\n{\"step\":17,\"ps").expect("a file");
        let first = Mutex::new(None);
        let (summary, _) = run_in(folder.path(), |step| {
            first.lock().expect("the first step").get_or_insert(step);
            1.0
        });
        assert_eq!(summary.expect("a run").steps, 40);
        assert_eq!(*first.lock().expect("the first step"), Some(17));
        assert_eq!(std::fs::read_to_string(&validations).expect("a file"), "{\"step\":10}\n");
    }
}
