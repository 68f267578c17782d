//! The metrics by name: for tables, plots and files that treat them alike.

use super::Metrics;
use serde::{Deserialize, Serialize};

/// One of the values of [`Metrics`]; in JSON it has the field's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)] // Each is the field of the same name.
pub enum Kind {
    Psnr,
    PsnrFull,
    Ssim,
    SsimObject,
    LpipsAlex,
    LpipsSqueeze,
    Flip,
    FlipObject,
    RelMse,
    RelMseObject,
    RelMseRobust,
    Temporal,
}

impl Kind {
    /// All of them, in the order of [`Metrics`].
    pub const ALL: [Self; 12] = [
        Self::Psnr,
        Self::PsnrFull,
        Self::Ssim,
        Self::SsimObject,
        Self::LpipsAlex,
        Self::LpipsSqueeze,
        Self::Flip,
        Self::FlipObject,
        Self::RelMse,
        Self::RelMseObject,
        Self::RelMseRobust,
        Self::Temporal,
    ];

    /// Name of the field of [`Metrics`], and of this value in JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Psnr => "psnr",
            Self::PsnrFull => "psnr_full",
            Self::Ssim => "ssim",
            Self::SsimObject => "ssim_object",
            Self::LpipsAlex => "lpips_alex",
            Self::LpipsSqueeze => "lpips_squeeze",
            Self::Flip => "flip",
            Self::FlipObject => "flip_object",
            Self::RelMse => "rel_mse",
            Self::RelMseObject => "rel_mse_object",
            Self::RelMseRobust => "rel_mse_robust",
            Self::Temporal => "temporal",
        }
    }

    /// Heading of a column.
    pub fn label(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR object (dB)",
            Self::PsnrFull => "PSNR full (dB)",
            Self::Ssim => "SSIM",
            Self::SsimObject => "SSIM object",
            Self::LpipsAlex => "LPIPS alex",
            Self::LpipsSqueeze => "LPIPS squeeze",
            Self::Flip => "FLIP",
            Self::FlipObject => "FLIP object",
            Self::RelMse => "relMSE",
            Self::RelMseObject => "relMSE object",
            Self::RelMseRobust => "relMSE without 0.1 %",
            Self::Temporal => "flicker",
        }
    }

    /// Digits after the point that tables show.
    pub fn digits(self) -> usize {
        match self {
            Self::Psnr | Self::PsnrFull => 2,
            Self::Temporal => 5,
            _ => 4,
        }
    }

    /// Whether more is better (PSNR and SSIM); of the others less is.
    pub fn higher_is_better(self) -> bool {
        matches!(self, Self::Psnr | Self::PsnrFull | Self::Ssim | Self::SsimObject)
    }

    /// This value of `metrics`.
    pub fn of(self, metrics: &Metrics) -> Option<f64> {
        let mut copy = *metrics;
        *self.of_mut(&mut copy)
    }

    /// This value of `metrics`, to set.
    pub fn of_mut(self, metrics: &mut Metrics) -> &mut Option<f64> {
        match self {
            Self::Psnr => &mut metrics.psnr,
            Self::PsnrFull => &mut metrics.psnr_full,
            Self::Ssim => &mut metrics.ssim,
            Self::SsimObject => &mut metrics.ssim_object,
            Self::LpipsAlex => &mut metrics.lpips_alex,
            Self::LpipsSqueeze => &mut metrics.lpips_squeeze,
            Self::Flip => &mut metrics.flip,
            Self::FlipObject => &mut metrics.flip_object,
            Self::RelMse => &mut metrics.rel_mse,
            Self::RelMseObject => &mut metrics.rel_mse_object,
            Self::RelMseRobust => &mut metrics.rel_mse_robust,
            Self::Temporal => &mut metrics.temporal,
        }
    }
}
