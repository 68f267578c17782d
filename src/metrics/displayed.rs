//! Errors of what a screen shows of scene-linear radiance.

use super::relmse::same_size;
use super::{psnr, ssim};
use anyhow::{Result, ensure};
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
/// When the sizes differ, or a value is not a number.
pub fn displayed(image: &Rgb, reference: &Rgb, exposure: f32) -> Result<Displayed> {
    same_size(image, reference)?;
    let [a, b] = [image, reference].map(|picture| picture.map(|p| color::display(*p, exposure)));
    let psnr = psnr::psnr(&a, &b);
    // The smaller of NaN and 200 would be 200.
    ensure!(!psnr.is_nan(), "a value of the picture or of the reference is not a number");
    Ok(Displayed { psnr: psnr.min(200.0), ssim: ssim::ssim(&a, &b) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_have_the_largest_value_and_sizes_must_agree() {
        let image = Rgb::from_fn(16, 12, |x, y| [x as f32 / 8.0, y as f32 / 8.0, 0.5]);
        assert_eq!(displayed(&image, &image, 0.5).unwrap(), Displayed { psnr: 200.0, ssim: Some(1.0) });
        assert!(displayed(&image.crop(0, 0, 8, 8), &image, 1.0).is_err());
        let mut broken = image.clone();
        broken.pixels[7][2] = f32::NAN;
        let said = displayed(&broken, &image, 1.0).unwrap_err().to_string();
        assert!(said.contains("not a number"), "{said}");
    }
}
