//! Training clips, and the random numbers of a step.

use crate::{Error, Result};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, Light};

/// One rendered sequence: frames under one environment.
#[derive(Clone, Debug)]
pub struct Clip {
    /// Name of the source, for messages.
    pub name: String,
    /// Frames with `beauty`.
    pub frames: Vec<Frame>,
    /// Each frame by deferred shading, as scene-linear radiance, with keyframes carried over it if the network reads keyframes;
    /// empty where no network asks for it.
    pub shaded: Vec<Rgb>,
    /// Environment light of the sequence.
    pub light: Light,
    /// Number of each frame in its sequence, ascending. Distances to keyframes are differences of these numbers.
    pub numbers: Vec<usize>,
}

impl Clip {
    /// Checks that the clip can be trained on.
    ///
    /// # Errors
    /// [`Error::Data`] when lengths or sizes disagree, when the exposure is not a positive number, or when a frame has no beauty.
    pub fn check(&self) -> Result<()> {
        let (frames, numbers) = (self.frames.len(), self.numbers.len());
        if frames == 0 || numbers != frames {
            return Err(self.broken(format!("{frames} frames with {numbers} numbers")));
        }
        let fits = |(shaded, frame): (&Rgb, &Frame)| (shaded.width, shaded.height) == (frame.width, frame.height);
        let all_fit = self.shaded.len() == frames && self.shaded.iter().zip(&self.frames).all(fits);
        if !self.shaded.is_empty() && !all_fit {
            return Err(self.broken("the pictures by deferred shading are not of its frames".into()));
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

/// A source of training clips.
pub trait ClipSource: Sync {
    /// Number of clips.
    fn len(&self) -> usize;
    /// Loads clip `i`. It is called from several threads.
    ///
    /// # Errors
    /// When the files of the clip cannot be read.
    fn load(&self, i: usize) -> Result<Clip>;
    /// A text that is equal for equal clips only, wherever they are stored. A run can only be resumed with the clips that it
    /// began with. `None` if the source cannot tell its clips from others.
    ///
    /// # Errors
    /// When files cannot be read.
    fn identity(&self) -> Result<Option<String>> {
        Ok(None)
    }
    /// Whether there are no clips.
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

/// The random numbers of one step. They are the same in every run and after every resumption.
pub fn step_rng(seed: u64, step: u64) -> Pcg64Mcg {
    // SplitMix64's finaliser makes the numbers of neighbouring steps independent.
    let mut x = seed.wrapping_add(step.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    Pcg64Mcg::seed_from_u64(x ^ (x >> 31))
}
