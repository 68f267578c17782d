//! Measurements: the scenes they run on, their errors, and what each subcommand of `renderflow bench` does.

pub mod autoencoder;
pub mod clock;
pub mod composed;
pub mod convergence;
#[allow(unsafe_code)]
pub mod embree;
pub mod export;
pub mod frame;
pub mod inverse;
pub mod kernels;
pub mod metrics;
pub mod models;
pub mod orbit;
pub mod peers;
pub mod plot;
pub mod reference;
pub mod scaling;
pub mod scenes;
pub mod skip;
pub mod stages;
pub mod watch;

use clock::{Clock, Elapsed, Of};
use serde::{Deserialize, Serialize};

/// Time that something took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spent {
    /// Seconds by wall clock.
    pub seconds: f64,
    /// Processor seconds of all threads of this program, `None` where the system does not tell.
    pub processor: Option<f64>,
}

impl Spent {
    /// No time at all.
    pub const NONE: Self = Self { seconds: 0.0, processor: Some(0.0) };

    /// `factor` times as long.
    pub fn times(self, factor: f64) -> Self {
        Self { seconds: factor * self.seconds, processor: self.processor.map(|p| factor * p) }
    }
}

impl Default for Spent {
    fn default() -> Self {
        Self::NONE
    }
}

impl std::ops::Add for Spent {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { seconds: self.seconds + other.seconds, processor: self.processor.zip(other.processor).map(|(a, b)| a + b) }
    }
}

/// Measures [`Spent`] from its start.
pub struct Stopwatch(Clock);

impl Stopwatch {
    /// Starts to measure.
    pub fn start() -> Self {
        Self(Clock::start(Of::Process))
    }

    /// Time since the start.
    pub fn spent(&self) -> Spent {
        let Elapsed { cpu, wall } = self.0.elapsed();
        Spent { seconds: wall, processor: cfg!(unix).then_some(cpu) }
    }
}

/// What the numbers were measured with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Version of this program.
    pub version: String,
    /// Model of the processor, empty where the system does not tell.
    pub processor: String,
    /// Threads that render.
    pub threads: usize,
}

impl Machine {
    /// This one.
    pub fn current() -> Self {
        let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = info.lines().find_map(|line| line.strip_prefix("model name")).and_then(|rest| rest.split_once(':'));
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            processor: model.map(|(_, name)| name.trim().to_owned()).unwrap_or_default(),
            threads: rayon::current_num_threads(),
        }
    }
}
