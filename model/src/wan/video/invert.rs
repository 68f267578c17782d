//! Inverse rendering: from pictures to intrinsics.

use super::WanRenderer;
use super::pixels::Size;
use crate::parameters::read;
use crate::wan::flow::Intrinsic;
use crate::{Error, Result};

impl WanRenderer {
    /// Whether the weights include an inverse adapter.
    pub fn inverts(&self) -> bool {
        self.config().inverse.is_some()
    }

    /// Recovers `intrinsics` from the frames of a clip, with `steps` Euler steps. Frames and results are `[3, height, width]`
    /// with values -1..=1; results are ordered by intrinsic, then by frame. Several frames must be consecutive. They are padded
    /// to a whole clip with the last frame.
    ///
    /// # Errors
    /// When there is no inverse adapter, for no frames or 0 steps, or when a frame has another number of values.
    pub fn invert(
        &self,
        frames: &[&[f32]],
        [width, height]: [usize; 2],
        intrinsics: &[Intrinsic],
        steps: usize,
    ) -> Result<Vec<Vec<Vec<f32>>>> {
        let broken = |reason: String| Error::Data { place: "pictures".into(), reason };
        if steps == 0 {
            return Err(Error::config("steps", "must be at least 1"));
        }
        let values = 3 * width * height;
        let Some(last) = frames.last() else { return Err(broken("there are none".into())) };
        if values == 0 || frames.iter().any(|frame| frame.len() != values) {
            return Err(broken(format!("not all have the {values} values of {width}x{height} pixels")));
        }
        let size = Size::new(width, height, self.config().pixel_multiple());
        let factor = self.config().vae.temporal_factor();
        let count = 1 + (frames.len() - 1).next_multiple_of(factor);
        let padded: Vec<&[f32]> = frames.iter().copied().chain(std::iter::repeat_n(*last, count - frames.len())).collect();
        let start = self.encode(size.clip(&padded, &self.device))?;
        let mut found = Vec::with_capacity(intrinsics.len());
        for &intrinsic in intrinsics {
            let mut z = start.clone();
            for step in 0..steps {
                // The remaining distance is the velocity times 1 - t. A step covers 1 / steps of the whole distance.
                let t = step as f64 / steps as f64;
                let end = self.flow.invert(z.clone(), &[t], intrinsic)?;
                z = z.clone() + (end - z) * (1.0 / (steps - step) as f64);
            }
            let pictures = read(self.decode(z)?)?;
            super::clips::all_finite(&pictures)?;
            found.push((0..frames.len()).map(|i| size.frame(&pictures, count, i)).collect());
        }
        Ok(found)
    }
}
