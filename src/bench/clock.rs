//! Time that other processes on the machine do not count in.

use std::time::Instant;

/// Processor and wall seconds since a moment.
pub struct Clock {
    cpu: f64,
    wall: Instant,
    of: Of,
}

/// Whose processor time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// The calling thread.
    Thread,
    /// All threads of the process.
    Process,
}

/// Seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elapsed {
    /// Of the processor; the wall's where the system does not tell.
    pub cpu: f64,
    /// Of the wall clock.
    pub wall: f64,
}

impl Clock {
    /// Starts measuring.
    pub fn start(of: Of) -> Self {
        Self { cpu: now(of).unwrap_or(0.0), wall: Instant::now(), of }
    }

    /// Time since.
    pub fn elapsed(&self) -> Elapsed {
        let wall = self.wall.elapsed().as_secs_f64();
        Elapsed { cpu: now(self.of).map_or(wall, |cpu| cpu - self.cpu), wall }
    }
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
