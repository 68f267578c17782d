//! Clips in memory: all of them if they fit, otherwise a window that slides over a seeded order during training.

use crate::data::{Clip, ClipSource, step_rng};
use crate::{Error, Result};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Options of a pool.
#[derive(Clone, Copy, Debug)]
pub struct PoolSettings {
    /// Most bytes of clips in memory, besides the clip that is being loaded.
    pub limit: usize,
    /// Steps after which the oldest clip is replaced, if not all clips fit.
    pub rotate_steps: u64,
    /// Seed of the order of clips.
    pub seed: u64,
}

/// The form in which a clip is kept in memory.
pub trait Stored: Default + Send + Sync {
    /// Size in bytes.
    fn bytes(&self) -> usize;
}

/// Converts a clip to the form that is kept. It is called from several threads.
pub type Make<'a, T> = &'a (dyn Fn(&Clip) -> Result<T> + Sync);

/// The clips that a step may draw from. They depend on the step alone, so that a resumed run draws the same batches.
pub struct Pool<'a, T> {
    source: &'a dyn ClipSource,
    make: Make<'a, T>,
    settings: PoolSettings,
    /// Clips of the window, oldest first.
    window: VecDeque<Arc<T>>,
    /// Position of the window's first clip in the endless order.
    front: u64,
}

impl<'a, T: Stored> Pool<'a, T> {
    /// Loads the window of `step`. `progress(done, total)` is called after each clip, from several threads.
    ///
    /// # Errors
    /// When there are no clips, or when a clip cannot be used.
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
        // The first clip of the order decides how many fit, so the number is the same in every run.
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

    /// The clips of a step. Steps must come in ascending order.
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

    /// Loads the clip at a position of the endless order, which is one seeded permutation of all clips after another.
    fn fetch(&self, position: u64) -> Result<Arc<T>> {
        let count = self.source.len() as u64;
        let mut order: Vec<usize> = (0..self.source.len()).collect();
        order.shuffle(&mut step_rng(self.settings.seed ^ 0x636c_6970, position / count));
        let clip = self.source.load(order[(position % count) as usize])?;
        Ok(Arc::new((self.make)(&clip)?))
    }
}
