//! Errors of a noisy picture against a reference, on scene-linear radiance and on what a screen shows.

pub use crate::metrics::relmse::{RelMse, reference_noise, relative_errors, relmse};

use crate::metrics::relmse::{percentile, same_size};
use crate::metrics::{psnr::psnr, ssim::ssim};
use anyhow::Result;
use renderflow_frame::color;
use renderflow_frame::image::Rgb;
use serde::{Deserialize, Serialize};

/// Errors of what a screen shows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Displayed {
    /// Decibel over the whole picture, at most 200 (which stands for equal pictures).
    pub psnr: f64,
    /// Structural similarity; `None` for pictures smaller than its window.
    pub ssim: Option<f64>,
}

/// PSNR and SSIM of sRGB(clamp(exposure x linear)).
///
/// # Errors
/// When the sizes differ.
pub fn displayed(image: &Rgb, reference: &Rgb, exposure: f32) -> Result<Displayed> {
    same_size(image, reference)?;
    let [a, b] = [image, reference].map(|picture| picture.map(|p| color::display(*p, exposure)));
    Ok(Displayed { psnr: psnr(&a, &b).min(200.0), ssim: ssim(&a, &b) })
}

/// Middle value of a list (the mean of both where there are two); NaN of an empty one.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    if sorted.is_empty() { f64::NAN } else { percentile(&sorted, 0.5) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_have_the_largest_value_and_sizes_must_agree() {
        let image = Rgb::from_fn(16, 12, |x, y| [x as f32 / 8.0, y as f32 / 8.0, 0.5]);
        assert_eq!(displayed(&image, &image, 0.5).unwrap(), Displayed { psnr: 200.0, ssim: Some(1.0) });
        assert!(displayed(&image.crop(0, 0, 8, 8), &image, 1.0).is_err());
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
    }
}
