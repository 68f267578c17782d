//! How long something took, by the wall clock and by the processor. Other processes on the machine do not count for the
//! processor.

use anyhow::Result;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// The result of `work` and its wall seconds.
///
/// # Errors
/// As `work`.
pub fn timed<T>(work: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let started = Instant::now();
    let value = work()?;
    Ok((value, started.elapsed().as_secs_f64()))
}

/// Whose processor time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// The calling thread.
    Thread,
    /// All threads of the process.
    Process,
}

#[cfg(unix)]
fn now(of: Of) -> Option<f64> {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(match of {
        Of::Thread => ClockId::ThreadCPUTime,
        Of::Process => ClockId::ProcessCPUTime,
    });
    Some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
}

#[cfg(not(unix))]
fn now(_: Of) -> Option<f64> {
    None
}

/// Time that something took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spent {
    /// Seconds by wall clock.
    pub seconds: f64,
    /// Processor seconds of all threads of this program (or of the thread in question); `None` where the system does not tell.
    pub processor: Option<f64>,
}

impl Spent {
    /// No time at all.
    pub const NONE: Self = Self { seconds: 0.0, processor: Some(0.0) };

    /// Processor seconds; those of the wall clock where the system does not tell.
    pub fn cpu(self) -> f64 {
        self.processor.unwrap_or(self.seconds)
    }

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
pub struct Stopwatch {
    wall: Instant,
    processor: Option<f64>,
    of: Of,
}

impl Stopwatch {
    /// Starts to measure all threads of the process.
    pub fn start() -> Self {
        Self::start_of(Of::Process)
    }

    /// Starts to measure the processor time of `of`.
    pub fn start_of(of: Of) -> Self {
        Self { processor: now(of), wall: Instant::now(), of }
    }

    /// Time since the start.
    pub fn spent(&self) -> Spent {
        let seconds = self.wall.elapsed().as_secs_f64();
        Spent { seconds, processor: now(self.of).zip(self.processor).map(|(end, start)| end - start) }
    }
}
