//! Removes the noise that is left in a path-traced picture, with Intel Open Image Denoise (OIDN).
//!
//! The library is searched when the first [`Denoiser`] is made. Where it is not found, [`Denoiser::new`] fails and says how to
//! get it; all else is the same.

mod library;
mod oidn;

pub use library::VARIABLE;

use renderflow_frame::image::Rgb;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest radiance handed to the denoiser, the largest half float. One pixel of infinite or 1e30 radiance blows up OIDN's
/// output by 1e17 and disturbs an eighth of the picture; at this bound it disturbs less than half a percent.
pub const MAX_RADIANCE: f32 = 65504.0;

/// Effort of the denoiser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// Least time, for previews.
    Fast,
    /// Least error.
    #[default]
    High,
}

/// How to denoise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Effort.
    pub quality: Quality,
    /// Trust the guides to be free of noise, and keep every detail of them. About twice the time.
    pub clean_guides: bool,
}

impl Default for Options {
    /// Least error, on every scene and number of samples that was measured (docs/measurements/renderer-notes.md, small).
    fn default() -> Self {
        Self { quality: Quality::High, clean_guides: true }
    }
}

/// Why a picture could not be denoised.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DenoiseError {
    /// The library was not found, or cannot be loaded.
    #[error(
        "Open Image Denoise cannot be loaded ({0}); fetch it with `make oidn` (for the Python package, `pip install pyoidn`), or name an \
         installed copy of version 2 with the environment variable {VARIABLE}"
    )]
    NotFound(&'static str),
    /// OIDN reported an error.
    #[error("Open Image Denoise: {0}")]
    Oidn(String),
    /// The library is of another major version than the one linked against.
    #[error("Open Image Denoise 2 is needed, version {0} was found")]
    Version(i32),
    /// A guide has another size than the picture.
    #[error("the {guide} guide is {}x{}, the picture {}x{}", .found[0], .found[1], .expected[0], .expected[1])]
    GuideSize {
        /// "albedo" or "normal".
        guide: &'static str,
        /// Width and height of the guide.
        found: [usize; 2],
        /// Width and height of the picture.
        expected: [usize; 2],
    },
    /// A normal guide came without an albedo guide, which OIDN cannot use.
    #[error("a normal guide needs an albedo guide beside it")]
    NormalAlone,
    /// The caller asked to stop.
    #[error("denoising was cancelled")]
    Cancelled,
}

/// Where the library of OIDN was found.
///
/// # Errors
/// [`DenoiseError::NotFound`].
pub fn library() -> Result<&'static Path, DenoiseError> {
    library::Oidn::get().map(library::Oidn::path).map_err(DenoiseError::NotFound)
}

/// A denoiser, kept between pictures: its network is built once for each picture size and set of guides.
pub struct Denoiser {
    filter: oidn::Filter,
    clamped: u64,
}

impl Denoiser {
    /// Opens OIDN on the CPU with default [`Options`]. It takes no more threads than the rayon pool
    /// has that this is called in.
    ///
    /// # Errors
    /// [`DenoiseError::NotFound`] where the library is not found; otherwise what OIDN reports.
    pub fn new() -> Result<Self, DenoiseError> {
        Self::with_options(Options::default())
    }

    /// Opens OIDN on the CPU.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_options(options: Options) -> Result<Self, DenoiseError> {
        Ok(Self { filter: oidn::Filter::new(options)?, clamped: 0 })
    }

    /// Denoises `color` (scene-linear radiance). Guides are of the same size: `guide_albedo` in 0..=1, `guide_normal` in -1..=1
    /// in any space, zero where nothing is hit, filtered like the picture.
    ///
    /// The result is finite and >= 0 and depends on the input only, not on the number of threads. Radiance beyond
    /// [`MAX_RADIANCE`] is clamped to it (see [`Self::clamped`]); NaN becomes 0.
    ///
    /// # Errors
    /// When a guide has another size, when a normal guide comes alone, or what OIDN reports.
    pub fn denoise(&mut self, color: &Rgb, guide_albedo: Option<&Rgb>, guide_normal: Option<&Rgb>) -> Result<Rgb, DenoiseError> {
        self.denoise_until(color, guide_albedo, guide_normal, &AtomicBool::new(false))
    }

    /// As [`Self::denoise`], until `cancel` is set: OIDN asks between the layers of its network.
    ///
    /// # Errors
    /// As [`Self::denoise`], and [`DenoiseError::Cancelled`].
    pub fn denoise_until(
        &mut self,
        color: &Rgb,
        guide_albedo: Option<&Rgb>,
        guide_normal: Option<&Rgb>,
        cancel: &AtomicBool,
    ) -> Result<Rgb, DenoiseError> {
        let expected = [color.width, color.height];
        for (guide, picture) in [("albedo", guide_albedo), ("normal", guide_normal)] {
            let found = picture.map_or(expected, |picture| [picture.width, picture.height]);
            if found != expected {
                return Err(DenoiseError::GuideSize { guide, found, expected });
            }
        }
        if guide_albedo.is_none() && guide_normal.is_some() {
            return Err(DenoiseError::NormalAlone);
        }
        if color.pixels.is_empty() {
            return Ok(color.clone());
        }
        let (color, clamped) = bounded(color, 0.0, MAX_RADIANCE);
        let albedo = guide_albedo.map(|guide| bounded(guide, 0.0, 1.0).0);
        let normal = guide_normal.map(|guide| bounded(guide, -1.0, 1.0).0);
        if cancel.load(Ordering::Relaxed) {
            return Err(DenoiseError::Cancelled);
        }
        self.clamped += clamped;
        let mut denoised = self.filter.run(color, albedo, normal, cancel)?;
        bound(&mut denoised, 0.0, f32::MAX);
        Ok(denoised)
    }

    /// Values of all pictures so far that were clamped to [`MAX_RADIANCE`].
    pub fn clamped(&self) -> u64 {
        self.clamped
    }
}

/// `picture` with every value in `low..=high` (NaN becomes 0), and how many lay above.
fn bounded(picture: &Rgb, low: f32, high: f32) -> (Rgb, u64) {
    let mut bounded = picture.clone();
    let above = bound(&mut bounded, low, high);
    (bounded, above)
}

/// Clamps every value to `low..=high` (NaN becomes 0) and returns how many were above.
fn bound(picture: &mut Rgb, low: f32, high: f32) -> u64 {
    let mut above = 0;
    for value in picture.pixels.iter_mut().flatten() {
        above += u64::from(*value > high);
        *value = if value.is_nan() { 0.0 } else { value.clamp(low, high) };
    }
    above
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_bounded_and_counted() {
        let picture = Rgb { width: 2, height: 1, pixels: vec![[f32::NAN, -1.0, f32::INFINITY], [1e30, 2.0, 65504.0]] };
        let (bounded, above) = bounded(&picture, 0.0, MAX_RADIANCE);
        assert_eq!(bounded.pixels, [[0.0, 0.0, MAX_RADIANCE], [MAX_RADIANCE, 2.0, MAX_RADIANCE]]);
        assert_eq!(above, 2);
    }

    /// OIDN has no more threads than the program. Its pictures do not depend on them.
    #[test]
    fn oidn_takes_the_threads_of_the_pool() {
        let picture = Rgb::from_fn(96, 64, |x, y| [((x * y) % 7) as f32, 0.5, ((x + 3 * y) % 5) as f32]);
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let mut denoiser = pool.install(Denoiser::new)?;
            Ok::<_, DenoiseError>((denoiser.filter.threads(), denoiser.denoise(&picture, None, None)?))
        };
        let (one, expected) = match with(1) {
            Ok(made) => made,
            Err(error) => return println!("skipped: {error}"),
        };
        assert_eq!(one, 1);
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let (many, same) = with(cores).expect("a picture");
        assert!((1..=cores as i32).contains(&many), "{many} of {cores}");
        assert_eq!(same, expected);
    }
}
