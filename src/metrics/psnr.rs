//! Peak signal-to-noise ratio of display values in 0..=1.

use renderflow_frame::Image;
use renderflow_frame::image::Rgb;

/// The most that counts, in dB: an error of 1e-5 of the range, less than a step of 16 bits (1.5e-5). Equal pictures have it too,
/// so that means over frames stay finite and JSON, which has no infinity, can hold them. See [`capped`].
pub const CAP: f64 = 100.0;

/// PSNR in dB over the whole picture: `-10 log10(mean squared error)` with peak 1. Equal pictures give +inf.
pub fn psnr(a: &Rgb, b: &Rgb) -> f64 {
    decibel(a.pixels.iter().zip(&b.pixels).map(|(a, b)| squared_error(a, b)))
}

/// PSNR in dB over the pixels where `mask` is above 0; `None` when there are none.
pub fn psnr_masked(a: &Rgb, b: &Rgb, mask: &Image<f32>) -> Option<f64> {
    let inside = || mask.pixels.iter().zip(a.pixels.iter().zip(&b.pixels)).filter(|(m, _)| **m > 0.0);
    inside().next()?;
    Some(decibel(inside().map(|(_, (a, b))| squared_error(a, b))))
}

/// `psnr` dB, at most [`CAP`]: what is stored and what means are made of. NaN stays NaN: it is no sign of equal pictures.
pub fn capped(psnr: f64) -> f64 {
    psnr.clamp(f64::NEG_INFINITY, CAP)
}

fn squared_error(a: &[f32; 3], b: &[f32; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>() / 3.0
}

fn decibel(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0usize), |(sum, count), e| (sum + e, count + 1));
    -10.0 * (sum / count.max(1) as f64).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_broken_picture_is_not_equal_to_its_truth() {
        assert_eq!([capped(f64::INFINITY), capped(31.5), capped(f64::NEG_INFINITY)], [CAP, 31.5, f64::NEG_INFINITY]);
        let (truth, mut broken) = (Rgb::filled(4, 4, [0.5; 3]), Rgb::filled(4, 4, [0.5; 3]));
        broken.pixels[5][1] = f32::NAN;
        assert!(capped(psnr(&broken, &truth)).is_nan());
    }
}
