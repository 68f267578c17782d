//! The learning rate over a run: a linear warm-up, then half a cosine down to 1%, or no change.

use super::config::{Decay, RunConfig};
use std::f64::consts::PI;

/// The learning rate at `step` (from 0) of a run of which `share` (0..=1), in steps or in time, is done.
pub fn rate(run: &RunConfig, step: u64, share: f64) -> f64 {
    let share = match run.decay {
        Decay::Cosine => share,
        Decay::Constant => 0.0,
    };
    learning_rate(run.learning_rate, step, run.warmup_steps, share)
}

/// The rate at the end, relative to the peak.
const FLOOR: f64 = 0.01;

fn learning_rate(peak: f64, step: u64, warmup_steps: u64, share: f64) -> f64 {
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
