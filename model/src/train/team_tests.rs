use super::*;
use crate::device::NetworkDevice;
use crate::network::init::Init;
use crate::network::layers::Conv;
use crate::parameters;
use crate::train::config::{Decay, RunConfig};
use crate::train::runner::{LogRecord, Objective, RunContext, Runner, Summary};
use burn::tensor::{Device, Tensor};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// Processes that are threads: a channel from each member to each.
struct Threads {
    share: Share,
    to: Vec<Sender<Vec<u8>>>,
    from: Vec<Receiver<Vec<u8>>>,
}

impl Threads {
    fn team(size: usize) -> Vec<Self> {
        let member = |rank| Self { share: Share { rank, size }, to: Vec::new(), from: Vec::new() };
        let mut members: Vec<Self> = (0..size).map(member).collect();
        for from in 0..size {
            for to in 0..size {
                let (sender, receiver) = channel();
                members[from].to.push(sender);
                members[to].from.push(receiver);
            }
        }
        members
    }

    fn send(&self, to: usize, part: &[u8]) -> Result<()> {
        self.to[to].send(part.to_vec()).map_err(|_| lost())
    }

    fn receive(&self, from: usize, part: &mut [u8]) -> Result<()> {
        part.copy_from_slice(&self.from[from].recv().map_err(|_| lost())?);
        Ok(())
    }
}

fn lost() -> Error {
    Error::Team { reason: "a member is gone".into() }
}

impl Links for Threads {
    fn share(&self) -> Share {
        self.share
    }

    fn exchange(&self, sent: &[u8], received: &mut [u8]) -> Result<()> {
        let part = sent.len() / self.share.size;
        (0..self.share.size).try_for_each(|to| self.send(to, &sent[to * part..(to + 1) * part]))?;
        (0..self.share.size).try_for_each(|from| self.receive(from, &mut received[from * part..(from + 1) * part]))
    }

    fn gather(&self, part: &[u8], all: &mut [u8]) -> Result<()> {
        (0..self.share.size).try_for_each(|to| self.send(to, part))?;
        (0..self.share.size).try_for_each(|from| self.receive(from, &mut all[from * part.len()..(from + 1) * part.len()]))
    }

    fn broadcast(&self, bytes: &mut [u8]) -> Result<()> {
        if self.share.rank == 0 {
            return (1..self.share.size).try_for_each(|to| self.send(to, bytes));
        }
        self.receive(0, bytes)
    }

    fn abort(&self, _: u8) {}
}

/// What each member of a team of `size` does, in their order.
pub(crate) fn together<T: Send>(size: usize, work: impl Fn(&Team) -> T + Sync) -> Vec<T> {
    if size == 1 {
        return vec![work(&Team::alone())];
    }
    std::thread::scope(|scope| {
        let member = |links: Threads| scope.spawn(|| work(&Team::new(links)));
        let threads: Vec<_> = Threads::team(size).into_iter().map(member).collect();
        threads.into_iter().map(|thread| thread.join().expect("no panic")).collect()
    })
}

/// Draws every value of the model towards the mean of the items.
struct Toy;

impl Objective for Toy {
    type Batch = Vec<f32>;
    type Model = Conv;

    fn step(&self, model: &Conv, batch: Vec<f32>, _: &Device) -> Result<StepResult> {
        let mean = |of: &dyn Fn(f32) -> f32| batch.iter().map(|item| of(*item)).sum::<f32>() / batch.len() as f32;
        let slopes = |parameter: &parameters::Parameter| {
            let slope = |(i, v): (usize, &f32)| mean(&|item| v - item * (1.0 + i as f32));
            let slopes: Vec<f32> = parameter.values.iter().enumerate().map(slope).collect();
            Some(Tensor::from_data(slopes.as_slice(), &Device::flex()))
        };
        let gradients = parameters::export_learning(model).iter().map(slopes).collect();
        let total = mean(&|item| item * item);
        Ok(StepResult {
            total,
            terms: vec![("mean", mean(&|v| v))],
            squares: vec![("picture", total)],
            items: batch.len(),
            gradients,
        })
    }
}

/// How a run of [`Toy`] is disturbed.
#[derive(Clone, Copy, Default)]
struct Disturbance {
    /// Process and step at which an item is not finite.
    broken: Option<(usize, u64)>,
    /// Process that is told to stop when it makes the batch of a step.
    stopped: Option<(usize, u64)>,
    /// Process and step at which no batch can be made.
    failed: Option<(usize, u64)>,
    /// Process that begins with other weights.
    other: Option<usize>,
    minutes: Option<f64>,
    gradients: Gradients,
}

/// Outcome and last values of a run.
type Outcome = Result<(Summary, Vec<f32>)>;

fn toy(folder: &Path, processes: usize, disturbed: Disturbance) -> Vec<Outcome> {
    together(processes, |team| {
        let config = RunConfig {
            output: folder.into(),
            steps: if disturbed.minutes.is_some() { u64::MAX } else { 40 },
            minutes: disturbed.minutes,
            learning_rate: 0.05,
            warmup_steps: 1,
            decay: Decay::Constant,
            checkpoint_steps: 10,
            log_steps: 5,
            gradients: disturbed.gradients,
            ..RunConfig::default()
        };
        let (device, cancel, share) = (Device::flex().autodiff(), AtomicBool::new(false), team.share());
        let at = |when: Option<(usize, u64)>, step: u64| when == Some((share.rank, step));
        let batch = |step: u64| {
            if disturbed.minutes.is_some() {
                std::thread::sleep(Duration::from_millis(3 * share.rank as u64));
            }
            if at(disturbed.failed, step) {
                return Err(Error::Data { place: "here".into(), reason: "broken".into() });
            }
            cancel.fetch_or(at(disturbed.stopped, step), Ordering::Relaxed);
            let mut rng = Pcg64Mcg::seed_from_u64(step);
            let items: Vec<f32> = (0..8).map(|_| rng.random_range(-1.0..2.0)).collect();
            let mut own = items[share.of(8)].to_vec();
            own[0] = if at(disturbed.broken, step) { f32::NAN } else { own[0] };
            Ok(own)
        };
        let seed = if disturbed.other == Some(share.rank) { 2 } else { 1 };
        let model = Conv::new(&mut Init::new(seed, &device), 2, 3, 3, 1.0);
        let last = std::cell::RefCell::new(Vec::new());
        let save = |optimizer: &Optimizer, _: &Conv| {
            assert!(team.leads());
            *last.borrow_mut() = optimizer.values().concat();
            Ok(())
        };
        let context = RunContext { device: &NetworkDevice::cpu(), progress: &|_| (), cancel: &cancel, team };
        let runner = Runner { config: &config, data: None, context };
        let summary = runner.run(&Toy, model, |_| Ok(batch), &save)?;
        assert!(team.has_parted());
        Ok((summary, last.into_inner()))
    })
}

fn ended(mut outcomes: Vec<Outcome>) -> (Summary, Vec<f32>) {
    outcomes.truncate(1);
    outcomes.remove(0).expect("a run")
}

pub(crate) fn log(folder: &Path) -> Vec<LogRecord> {
    let text = std::fs::read_to_string(folder.join("log.jsonl")).expect("a log");
    text.lines().map(|line| serde_json::from_str(line).expect("a line")).collect()
}

/// The largest difference of two logs, relative to the values.
pub(crate) fn apart(a: &[LogRecord], b: &[LogRecord]) -> f32 {
    assert_eq!(a.iter().map(|line| line.step).collect::<Vec<_>>(), b.iter().map(|line| line.step).collect::<Vec<_>>());
    let values = |line: &LogRecord| {
        [line.loss, line.gradient_norm]
            .into_iter()
            .chain(line.terms.values().copied())
            .chain(line.psnr.values().copied())
            .collect()
    };
    let all = |lines: &[LogRecord]| -> Vec<f32> { lines.iter().flat_map(|line| -> Vec<f32> { values(line) }).collect() };
    let (a, b) = (all(a), all(b));
    assert_eq!(a.len(), b.len());
    a.iter().zip(&b).map(|(a, b)| (a - b).abs() / a.abs().max(1e-3)).fold(0.0, f32::max)
}

fn largest(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

pub(crate) fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

#[test]
fn several_processes_make_the_run_of_one() {
    let alone = folder();
    let (_, values) = ended(toy(alone.path(), 1, Disturbance::default()));
    for processes in [2, 4, 8] {
        let (first, again) = (folder(), folder());
        let (summary, together) = ended(toy(first.path(), processes, Disturbance::default()));
        assert_eq!((summary.steps, summary.finished), (40, true));
        let (values_apart, logs_apart) = (largest(&values, &together), apart(&log(alone.path()), &log(first.path())));
        assert!(values_apart < 1e-5 && logs_apart < 1e-4, "{processes}: {values_apart} {logs_apart}");
        assert_eq!(ended(toy(again.path(), processes, Disturbance::default())).1, together, "the same bytes");
    }
    // Half precision rounds to one part in two thousand.
    let half = folder();
    let (_, halves) = ended(toy(half.path(), 2, Disturbance { gradients: Gradients::F16, ..Disturbance::default() }));
    let (values_apart, logs_apart) = (largest(&values, &halves), apart(&log(alone.path()), &log(half.path())));
    assert!(values_apart > 0.0 && values_apart < 0.01 && logs_apart < 0.01, "{values_apart} {logs_apart}");
}

#[test]
fn all_processes_leave_out_the_same_step() {
    let (alone, pair) = (folder(), folder());
    let broken = |rank| Disturbance { broken: Some((rank, 7)), ..Disturbance::default() };
    let (_, values) = ended(toy(alone.path(), 1, broken(0)));
    let (_, together) = ended(toy(pair.path(), 2, broken(1)));
    assert!(largest(&values, &together) < 1e-5);
}

#[test]
fn one_that_is_told_to_stop_stops_all_and_the_run_resumes() {
    let (whole, parts) = (folder(), folder());
    let (_, values) = ended(toy(whole.path(), 2, Disturbance::default()));
    for outcome in toy(parts.path(), 2, Disturbance { stopped: Some((1, 23)), ..Disturbance::default() }) {
        let summary = outcome.expect("both stop").0;
        assert!(!summary.finished && (21..=24).contains(&summary.steps), "{}", summary.steps);
    }
    assert_eq!(ended(toy(parts.path(), 2, Disturbance::default())).1, values, "as if it had not been stopped");
    // The line after the resumption is about fewer steps.
    let lines = |folder: &Path| -> Vec<LogRecord> { log(folder).into_iter().filter(|line| line.step != 25).collect() };
    assert!(apart(&lines(whole.path()), &lines(parts.path())) < 1e-5);
}

#[test]
fn all_processes_end_by_the_clock_of_the_first() {
    let agreed = together(3, |team| {
        let rank = team.share().rank;
        team.agree(1.0 + rank as f64, rank == 2).expect("all are there")
    });
    assert_eq!(agreed, [(1.0, true); 3]);
    let outcomes = toy(folder().path(), 3, Disturbance { minutes: Some(0.005), ..Disturbance::default() });
    let steps: Vec<u64> = outcomes.into_iter().map(|outcome| outcome.expect("all end").0.steps).collect();
    assert!(steps[0] > 0 && steps.iter().all(|n| *n == steps[0]), "{steps:?}");
}

#[test]
fn a_process_that_fails_takes_the_others_with_it() {
    let outcomes = toy(folder().path(), 2, Disturbance { failed: Some((1, 5)), ..Disturbance::default() });
    let said: Vec<String> = outcomes.into_iter().map(|outcome| outcome.expect_err("no run").to_string()).collect();
    assert_eq!(said, ["a member is gone", "here: broken"]);
}

#[test]
fn processes_that_begin_differently_are_refused() {
    for outcome in toy(folder().path(), 3, Disturbance { other: Some(2), ..Disturbance::default() }) {
        let said = outcome.expect_err("no run").to_string();
        assert!(said.starts_with("process 2 begins with other weights than process 0. "), "{said}");
    }
}

#[test]
fn processors_that_round_differently_are_brought_together() {
    let values = together(3, |team| {
        let parameter =
            parameters::Parameter { name: "w".into(), shape: vec![2], values: vec![1.0 + team.share().rank as f32, 2.0] };
        let mut optimizer = Optimizer::new(vec![parameter]);
        assert!(team.level(&mut optimizer).expect("all are there"));
        assert!(!team.level(&mut optimizer).expect("all are there"));
        let slot = &optimizer.slots[0];
        [slot.parameter.values.clone(), slot.average.clone()]
    });
    assert!(values.iter().all(|of| *of == [vec![1.0, 2.0], vec![1.0, 2.0]]), "{values:?}");
}

#[test]
fn half_floats_keep_gradients_of_any_size() {
    for size in [1e-30_f32, 1e-9, 0.3, 1.0, 7e4, 1e30] {
        let means = together(2, |team| {
            let own: Vec<f32> =
                (0..5).map(|i| size * [1.0, 1e-3, -0.25, 0.0, 0.7][i] * (1.0 + team.share().rank as f32)).collect();
            let device = Device::flex();
            let gradients = vec![Some(Tensor::from_data(own.as_slice(), &device))];
            let mut result = StepResult { total: 1.0, terms: Vec::new(), squares: Vec::new(), items: 1, gradients };
            team.mean(&mut result, &[5], Gradients::F16, &device).expect("both are there");
            parameters::to_vec(result.gradients.remove(0).expect("a gradient"))
        });
        assert_eq!(means[0], means[1]);
        for (mean, expected) in means[0].iter().zip([1.5, 1.5e-3, -0.375, 0.0, 1.05]) {
            assert!((mean / size - expected).abs() <= 1e-3 * expected.abs(), "{size}: {mean} {expected}");
        }
    }
}

#[test]
fn batches_are_shared_without_rest() {
    let parts: Vec<_> = (0..4).map(|rank| Share { rank, size: 4 }.of(8)).collect();
    assert_eq!(parts, [0..2, 2..4, 4..6, 6..8]);
    assert_eq!(Share::WHOLE.of(5), 0..5);
    for refused in together(3, |team| team.share().check_batch("crops.batch", 8).map_err(|error| error.to_string())) {
        assert_eq!(refused, Err("crops.batch: 8 cannot be shared equally by 3 processes".to_owned()));
    }
}

#[test]
fn launchers_say_how_many_processes_they_started() {
    let found = |variables: &[(&str, &str)]| {
        launched(&|name| variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned()))
    };
    assert_eq!(found(&[]), None);
    assert_eq!(found(&[("OMPI_COMM_WORLD_SIZE", "1"), ("OMPI_COMM_WORLD_RANK", "0")]), None);
    assert_eq!(found(&[("OMPI_COMM_WORLD_SIZE", "4"), ("OMPI_COMM_WORLD_RANK", "3")]), Some(("OMPI_COMM_WORLD_SIZE", 4)));
    assert_eq!(found(&[("SLURM_STEP_NUM_TASKS", "2"), ("SLURM_PROCID", "0")]), Some(("SLURM_STEP_NUM_TASKS", 2)));
    assert_eq!(found(&[("PMI_SIZE", "many"), ("PMI_RANK", "0")]), None);
    let place = |variables: &[(&str, &str)]| {
        place(&|name| variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned()))
    };
    assert_eq!(place(&[]), 0);
    assert_eq!(place(&[("OMPI_COMM_WORLD_LOCAL_RANK", "3")]), 3);
    assert_eq!(place(&[("MPI_LOCALRANKID", "?"), ("SLURM_LOCALID", " 1 ")]), 1);
}
