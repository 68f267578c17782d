//! Learning rate: linear warm-up, then a cosine down to 1% by the share of the run that is done, or no change.

use super::runner::Settings;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// What follows the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decay {
    /// Half a cosine, down to 1%.
    #[default]
    Cosine,
    /// The peak rate to the end.
    Constant,
}

/// The rate of a run with these settings.
pub fn rate(settings: Settings, step: u64, share: f64) -> f64 {
    match settings.decay {
        Decay::Cosine => learning_rate(settings.learning_rate, step, settings.warmup_steps, share),
        Decay::Constant => learning_rate(settings.learning_rate, step, settings.warmup_steps, 0.0),
    }
}

/// Share of the peak rate at the end.
const FLOOR: f64 = 0.01;

/// Rate at `step` (from 0) when `share` (0..=1) of the run, in steps or in time, is done.
pub fn learning_rate(peak: f64, step: u64, warmup_steps: u64, share: f64) -> f64 {
    let warm = ((step + 1) as f64 / (warmup_steps.max(1)) as f64).min(1.0);
    let cosine = 0.5 * (1.0 + (PI * share.clamp(0.0, 1.0)).cos());
    peak * warm * (FLOOR + (1.0 - FLOOR) * cosine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rises_linearly_then_falls_to_the_floor() {
        assert!((learning_rate(1.0, 0, 100, 0.0) - 0.01).abs() < 1e-12);
        assert!((learning_rate(1.0, 99, 100, 0.0) - 1.0).abs() < 1e-12);
        assert!((learning_rate(1.0, 500, 100, 0.5) - 0.505).abs() < 1e-12);
        assert!((learning_rate(1.0, 500, 100, 1.0) - 0.01).abs() < 1e-12);
        assert!((learning_rate(1.0, 500, 100, 7.0) - 0.01).abs() < 1e-12);
    }
}
