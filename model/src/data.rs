//! Clips to learn from, and the random numbers of a step.

use crate::{Error, Result};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use renderflow_frame::tracks::Tracks;
use renderflow_frame::{Frame, Light};

/// One sequence as it was rendered: consecutive frames under one environment.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Where it came from, for messages.
    pub name: String,
    /// Frames with `beauty`.
    pub frames: Vec<Frame>,
    /// Light of the sequence.
    pub light: Light,
    /// Number of each frame in its sequence, ascending; distances to keyframes are counted in them.
    pub numbers: Vec<usize>,
    /// Transforms of the objects that move.
    pub tracks: Tracks,
    /// Indices of keyframes, ascending; used by the keyframe stage.
    pub keyframes: Vec<usize>,
}

impl Clip {
    /// Checks what every kind of training needs.
    ///
    /// # Errors
    /// [`Error::Data`] when lengths disagree, the exposure is no positive number, or a frame has no beauty.
    pub fn check(&self) -> Result<()> {
        let (frames, numbers) = (self.frames.len(), self.numbers.len());
        if frames == 0 || numbers != frames {
            return Err(self.broken(format!("{frames} frames with {numbers} numbers")));
        }
        let exposure = self.light.exposure();
        if !(exposure.is_finite() && exposure > 0.0) {
            return Err(self.broken(format!("exposure {exposure} is not a positive number")));
        }
        match self.frames.iter().position(|frame| frame.beauty.is_none()) {
            Some(i) => Err(self.broken(format!("frame {i} has no beauty to learn from"))),
            None => Ok(()),
        }
    }

    pub(crate) fn broken(&self, reason: String) -> Error {
        Error::Data { place: self.name.clone(), reason }
    }
}

/// Where training clips come from.
pub trait ClipSource: Sync {
    /// Number of clips.
    fn len(&self) -> usize;
    /// Loads clip `i`; called from several threads.
    ///
    /// # Errors
    /// When its files cannot be read.
    fn load(&self, i: usize) -> Result<Clip>;
    /// What tells these clips from others: the same text for the same clips, wherever they lie. A run is gone on with only on the
    /// clips it began with. `None` where nothing tells them apart.
    ///
    /// # Errors
    /// When files cannot be read.
    fn identity(&self) -> Result<Option<String>> {
        Ok(None)
    }
    /// Whether there is nothing to train on.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl ClipSource for Vec<Clip> {
    fn len(&self) -> usize {
        self.as_slice().len()
    }

    fn load(&self, i: usize) -> Result<Clip> {
        Ok(self[i].clone())
    }
}

/// Random numbers of one step: the same for every run and every resumption.
pub fn step_rng(seed: u64, step: u64) -> Pcg64Mcg {
    // SplitMix64's finaliser keeps neighbouring steps unrelated.
    let mut x = seed.wrapping_add(step.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    Pcg64Mcg::seed_from_u64(x ^ (x >> 31))
}
