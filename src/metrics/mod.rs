//! How far a picture is from the truth.
//!
//! Every metric but the relative error is of display values: sRGB(clamp(exposure x linear)) in 0..=1, as floats, never quantised.
//! [`Truth`] holds what is computed once for a frame, [`Truth::measure`] compares a picture with it. [`temporal`] needs two
//! frames and [`bootstrap`] many sequences. Nothing here starts threads, so frames and methods can be measured side by side; all
//! results are the same for any number of threads. (The network of LPIPS and the warp of [`temporal`] use the threads of their
//! caller.)

pub mod bootstrap;
mod convolve;
pub mod displayed;
pub mod flip;
pub mod intrinsics;
pub mod psnr;
pub mod relmse;
pub mod ssim;
pub mod temporal;

mod table;
mod truth;

pub use table::{METRICS, Metric, values};
pub use truth::{Hdr, Networks, Truth};

use renderflow_frame::Image;
use serde::{Deserialize, Serialize};

/// What was measured of one picture.
///
/// In JSON what is absent is `null`. "Object" means the pixels the truth's coverage is above 0 at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Metrics {
    /// PSNR over the object in dB, at most [`psnr::CAP`] (equal pictures); `None` where nothing is covered.
    pub psnr: Option<f64>,
    /// PSNR over the full picture in dB, at most [`psnr::CAP`].
    pub psnr_full: Option<f64>,
    /// SSIM over the full picture, -1 to 1; `None` below 11x11.
    pub ssim: Option<f64>,
    /// Mean of the SSIM of windows centred on the object; `None` where there are none.
    pub ssim_object: Option<f64>,
    /// LPIPS with AlexNet, full picture; `None` without weights and below 31x31.
    pub lpips_alex: Option<f64>,
    /// LPIPS with SqueezeNet, full picture; `None` without weights and below 17x17.
    pub lpips_squeeze: Option<f64>,
    /// FLIP over the full picture, 0 to 1.
    pub flip: Option<f64>,
    /// Mean FLIP over the object; `None` where nothing is covered.
    pub flip_object: Option<f64>,
    /// Relative squared error of exposed radiance, mean over pixels and channels; `None` for methods that only make display
    /// values.
    pub rel_mse: Option<f64>,
    /// The same over the object.
    pub rel_mse_object: Option<f64>,
    /// The same over the full picture without the 0.1 % of pixels with the largest error.
    pub rel_mse_robust: Option<f64>,
    /// Flicker against the frame before, see [`temporal`]; `None` in the first frame. Set by the caller, who has both frames.
    pub temporal: Option<f64>,
}

/// Mean of the values whose pixel has `mask` above 0; `None` when there are none.
fn masked_mean(values: impl Iterator<Item = f64>, mask: &Image<f32>) -> Option<f64> {
    let inside = values.zip(&mask.pixels).filter(|(_, m)| **m > 0.0);
    let (sum, count) = inside.fold((0.0, 0usize), |(sum, count), (v, _)| (sum + v, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Middle of the finite values (the mean of the two in the middle where their number is even); NaN where there is none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    if sorted.is_empty() { f64::NAN } else { 0.5 * (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_the_middle() {
        assert_eq!([median(&[3.0, 1.0, 2.0]), median(&[4.0, f64::NAN, 1.0])], [2.0, 2.5]);
        assert!(median(&[]).is_nan());
    }
}
