//! Sequences in memory: they arrive one after the other from a thread of their own, and the newest are kept.

use super::config;
use super::report::Progress;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::Scope;

/// A kind of crop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// Rows and columns: a multiple of the network's coarsest pixel, at most 4096.
    pub size: usize,
    /// Crops in a batch, 1..=4096.
    pub batch: usize,
    /// The share of the steps, 0..1, after which these crops are drawn. Minutes do not count, because a batch depends on its step
    /// alone.
    pub from: f64,
}

impl Crop {
    /// Checks the option `crops`, whose sizes must be multiples of `multiple`.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn check(crops: &[Self], multiple: usize) -> Result<()> {
        let fits = |crop: &Self| {
            crop.size > 0 && crop.size.is_multiple_of(multiple) && crop.size <= 4096 && (1..=4096).contains(&crop.batch)
        };
        if crops.is_empty() || !crops.iter().all(fits) {
            return Err(Error::config(
                "crops",
                format!("sizes must be multiples of {multiple} up to 4096, and batches 1..=4096"),
            ));
        }
        config::all([
            ("crops.from", crops.iter().all(|crop| (0.0..1.0).contains(&crop.from)), "must be at least 0 and below 1"),
            ("crops.from", crops.iter().any(|crop| crop.from <= 0.0), "one kind of crop must begin at 0"),
        ])
    }

    /// The kind of crop that is drawn when `share` of the run is done: the one that began last.
    pub fn at(crops: &[Self], share: f64) -> Self {
        let begun = crops.iter().filter(|crop| crop.from <= share);
        *begun.max_by(|a, b| a.from.total_cmp(&b.from)).unwrap_or(&crops[0])
    }
}

/// Which sequences are in memory at a step.
#[derive(Clone, Copy, Debug)]
pub struct Rotation {
    /// Number of sequences that are made before the first step, at least 1.
    pub first: u64,
    /// Number of steps after which one more sequence is used, at least 1.
    pub rotate_steps: u64,
    /// Number of sequences in memory, at least `first`. The newest are kept.
    pub window: u64,
}

impl Rotation {
    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(self) -> Result<()> {
        config::all([
            ("first", self.first > 0, "must be at least 1"),
            ("rotate_steps", self.rotate_steps > 0, "must be at least 1"),
            ("window", self.window >= self.first, "must be at least `first`"),
        ])
    }

    /// The sequences `[from, to)` of a step.
    fn at(&self, step: u64) -> (u64, u64) {
        let to = self.first + step / self.rotate_steps;
        (to.saturating_sub(self.window), to)
    }

    /// Loads the sequences of `step`, and goes on to make those of later steps on a thread of `scope`. `make` makes a sequence.
    ///
    /// # Errors
    /// When a sequence cannot be made.
    pub fn load<'scope, T: Send + 'scope>(
        self,
        scope: &'scope Scope<'scope, '_>,
        mut make: impl FnMut(u64) -> Result<T> + Send + 'scope,
        step: u64,
        cancel: &'scope AtomicBool,
        progress: &dyn Fn(&Progress),
    ) -> Result<Pool<T>> {
        let (from, to) = self.at(step);
        let (sender, receiver) = mpsc::sync_channel(1);
        scope.spawn(move || {
            for i in from.. {
                // The receiver is gone when training has ended.
                if cancel.load(Ordering::Relaxed) || sender.send(make(i)).is_err() {
                    return;
                }
            }
        });
        let mut pool = Pool { rotation: self, receiver, window: VecDeque::new(), next: from };
        while pool.next < to && !cancel.load(Ordering::Relaxed) {
            progress(&Progress::Loading { done: pool.next - from, total: to - from });
            pool.receive()?;
        }
        Ok(pool)
    }
}

/// Sequences in memory. Which ones they are depends on the step alone.
pub struct Pool<T> {
    rotation: Rotation,
    receiver: mpsc::Receiver<Result<T>>,
    window: VecDeque<Arc<T>>,
    /// Index of the sequence that arrives next.
    next: u64,
}

impl<T> Pool<T> {
    /// Waits for the next sequence.
    fn receive(&mut self) -> Result<()> {
        let stopped = |_| Error::Data { place: "sequences".into(), reason: "their producer stopped".into() };
        let made = self.receiver.recv().map_err(stopped)?;
        self.window.push_back(Arc::new(made?));
        self.next += 1;
        Ok(())
    }

    /// The sequences of a step. Steps must come in ascending order.
    ///
    /// # Errors
    /// When a sequence cannot be made.
    pub fn at(&mut self, step: u64) -> Result<Vec<Arc<T>>> {
        let (from, to) = self.rotation.at(step);
        while self.next < to {
            self.receive()?;
        }
        while self.window.len() as u64 > to - from {
            self.window.pop_front();
        }
        Ok(self.window.iter().cloned().collect())
    }
}
