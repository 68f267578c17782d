//! Clips in memory: all of them when they fit, otherwise a window that slides over a seeded order as training goes on.

use crate::data::{Clip, ClipSource, step_rng};
use crate::{Error, Result};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How the cache is filled.
#[derive(Clone, Copy, Debug)]
pub struct PoolSettings {
    /// Bytes it may take, beyond the one clip that is being loaded.
    pub limit: usize,
    /// Steps after which the oldest clip makes room for the next, when not all fit.
    pub rotate_steps: u64,
    /// Seed of the order.
    pub seed: u64,
}

/// What a clip is kept as.
pub trait Stored: Default + Send + Sync {
    /// Memory it takes.
    fn bytes(&self) -> usize;
}

/// Makes what is kept of a clip; called from several threads.
pub type Make<'a, T> = &'a (dyn Fn(&Clip) -> Result<T> + Sync);

/// The clips a step may draw from; a function of the step alone, so that resuming gives the same batches.
pub struct Pool<'a, T> {
    source: &'a dyn ClipSource,
    make: Make<'a, T>,
    settings: PoolSettings,
    /// Clips of the window, oldest first.
    window: VecDeque<Arc<T>>,
    /// Position in the endless order of the clip at the front of the window.
    front: u64,
}

impl<'a, T: Stored> Pool<'a, T> {
    /// Loads the window of `step`. `progress(done, total)` is called after each clip, from several threads.
    ///
    /// # Errors
    /// [`Error::Data`] when there are no clips or a clip cannot be used.
    pub fn load(
        source: &'a dyn ClipSource,
        make: Make<'a, T>,
        settings: PoolSettings,
        step: u64,
        cancel: &AtomicBool,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self> {
        let count = source.len();
        if count == 0 {
            return Err(Error::Data { place: "training data".into(), reason: "no clips".into() });
        }
        let mut pool = Self { source, make, settings, window: VecDeque::new(), front: 0 };
        // The first clip of the order tells how many fit; the same on every run.
        let probe = pool.fetch(0)?;
        let bytes = probe.bytes();
        let size = (settings.limit / bytes.max(1)).clamp(1, count);
        pool.front = if size == count { 0 } else { step / settings.rotate_steps.max(1) };
        let done = AtomicUsize::new(0);
        let window: Vec<Arc<T>> = (pool.front..pool.front + size as u64)
            .into_par_iter()
            .map(|position| {
                if cancel.load(Ordering::Relaxed) {
                    return Ok(Arc::default());
                }
                let frames = if position == 0 { probe.clone() } else { pool.fetch(position)? };
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, size);
                Ok(frames)
            })
            .collect::<Result<_>>()?;
        pool.window = window.into();
        Ok(pool)
    }

    /// Clips a step may draw from; moves the window forward when its time has come.
    ///
    /// # Errors
    /// When a clip cannot be loaded.
    pub fn at(&mut self, step: u64) -> Result<Vec<Arc<T>>> {
        if self.window.len() < self.source.len() {
            while self.front < step / self.settings.rotate_steps.max(1) {
                let next = self.fetch(self.front + self.window.len() as u64)?;
                self.window.pop_front();
                self.window.push_back(next);
                self.front += 1;
            }
        }
        Ok(self.window.iter().cloned().collect())
    }

    /// Whether every clip is in memory.
    pub fn complete(&self) -> bool {
        self.window.len() == self.source.len()
    }

    /// Loads the clip at a position of the endless order: one seeded permutation of all clips after another.
    fn fetch(&self, position: u64) -> Result<Arc<T>> {
        let count = self.source.len() as u64;
        let mut order: Vec<usize> = (0..self.source.len()).collect();
        order.shuffle(&mut step_rng(self.settings.seed ^ 0x636c_6970, position / count));
        let clip = self.source.load(order[(position % count) as usize])?;
        Ok(Arc::new((self.make)(&clip)?))
    }
}
