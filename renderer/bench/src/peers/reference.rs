//! What a renderer converges to, with the noise that is left in it.

use super::contender::{Contender, Shot, bytes, picture};
use anyhow::{Result, ensure};
use renderflow::metrics::relmse::{RelMse, relmse};
use renderflow_frame::file;
use renderflow_frame::image::{Image, Rgb};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Independent pictures that a reference is the mean of; their spread tells its noise.
const BATCHES: u32 = 8;
/// Seeds from here on are of references.
const SEEDS: u64 = 1_000_000;

/// A picture of many samples.
pub struct Reference {
    /// Mean radiance.
    pub mean: Rgb,
    /// Variance of `mean`.
    pub variance: Rgb,
}

/// How the references of two families differ.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Difference {
    /// Of the scene.
    pub scene: String,
    /// The family whose reference is taken as true here.
    pub of: String,
    /// The other.
    pub other: String,
    /// Mean radiance of the other over this one's.
    pub ratio: f64,
    /// The other's relative error, with the noise of both taken off.
    pub error: RelMse,
}

impl Reference {
    /// Reads it from `path`, or else makes it of `spp` samples (rounded up to a multiple of 8) and writes it there. `step` is
    /// called with the samples of every part.
    ///
    /// # Errors
    /// When a picture fails, the file cannot be written, or `cancel` was set.
    pub fn get(
        path: &Path,
        contender: &mut Contender,
        spp: u32,
        shot: &Shot,
        step: &dyn Fn(u32),
        cancel: &AtomicBool,
    ) -> Result<Self> {
        let batch = spp.div_ceil(BATCHES);
        if let Ok(stored) = Self::read(path, shot.size) {
            step(batch * BATCHES);
            return Ok(stored);
        }
        let mut batches = Vec::new();
        for index in 0..BATCHES {
            let (picture, _) = contender.render(batch, SEEDS + u64::from(index), shot, cancel)?;
            ensure!([picture.width, picture.height] == shot.size, "a picture of another size");
            batches.push(picture);
            step(batch);
        }
        let made = Self::of(&batches);
        file::write_atomic(path, &[bytes(&made.mean), bytes(&made.variance)].concat())?;
        Ok(made)
    }

    /// Mean of independent pictures of one size.
    fn of(batches: &[Rgb]) -> Self {
        let count = batches.len() as f64;
        let statistics = |pixel: usize, channel: usize| {
            let values = batches.iter().map(|b| f64::from(b.pixels[pixel][channel]));
            let mean = values.clone().sum::<f64>() / count;
            let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0) / count;
            (mean as f32, variance as f32)
        };
        let (width, height) = (batches[0].width, batches[0].height);
        let image = |f: &dyn Fn((f32, f32)) -> f32| Image {
            width,
            height,
            pixels: (0..width * height).map(|p| [0, 1, 2].map(|c| f(statistics(p, c)))).collect(),
        };
        Self { mean: image(&|s| s.0), variance: image(&|s| s.1) }
    }

    fn read(path: &Path, size: [usize; 2]) -> Result<Self> {
        let stored = file::read(path)?;
        let (mean, variance) = stored.split_at(stored.len() / 2);
        Ok(Self { mean: picture(mean, size)?, variance: picture(variance, size)? })
    }

    /// Error of a picture, the reference's own noise taken off.
    ///
    /// # Errors
    /// When it has another size.
    pub fn error(&self, picture: &Rgb) -> Result<RelMse> {
        relmse(picture, &self.mean, Some(&self.variance))
    }

    /// How far `other` is from this one beyond the noise of both.
    ///
    /// # Errors
    /// When it has another size.
    pub fn difference(&self, other: &Self, scene: &str, names: [&str; 2]) -> Result<Difference> {
        let mut both = self.variance.clone();
        for (a, b) in both.pixels.iter_mut().flatten().zip(other.variance.pixels.iter().flatten()) {
            *a += b;
        }
        let sum = |r: &Self| r.mean.pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>();
        Ok(Difference {
            scene: scene.to_owned(),
            of: names[0].to_owned(),
            other: names[1].to_owned(),
            ratio: sum(other) / sum(self),
            error: relmse(&other.mean, &self.mean, Some(&both))?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_of_batches() {
        let batches = [1.0, 2.0, 6.0].map(|v: f32| Rgb::filled(2, 1, [v, 2.0 * v, 5.0]));
        let reference = Reference::of(&batches);
        assert_eq!(reference.mean.pixels, [[3.0, 6.0, 5.0]; 2]);
        // Sample variance of 1, 2, 6 is 7, of its mean a third.
        assert_eq!(reference.variance.pixels, [[7.0 / 3.0, 28.0 / 3.0, 0.0]; 2]);
        let same = reference.difference(&Reference::of(&batches), "s", ["a", "b"]).unwrap();
        assert!(same.ratio == 1.0 && same.error.mean < 0.0, "{same:?}");
    }
}
