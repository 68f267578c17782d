//! Settings of a training run.

use super::loss::LossWeights;
use super::optimizer::Method;
use super::runner;
use super::schedule::Decay;
use crate::bridge::{Bridge, SIGMA, Times};
use crate::config::{KeyframeConfig, NetworkConfig};
use crate::network::PIXEL_MULTIPLE;
use crate::weights::Precision;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What is trained.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The base network, from random weights.
    #[default]
    Base,
    /// The keyframe network on a frozen base.
    Keyframes {
        /// Weights file of the base.
        base: PathBuf,
        /// Size of the keyframe network.
        network: KeyframeConfig,
    },
}

/// A kind of batch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CropConfig {
    /// Rows and columns, a multiple of 32.
    pub size: usize,
    /// Crops in a batch.
    pub batch: usize,
    /// Relative frequency.
    pub weight: f32,
}

/// Settings of a training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The network; ignored in the keyframe stage, where the base file decides.
    pub network: NetworkConfig,
    /// Base or keyframes.
    pub stage: Stage,
    /// Folder for `checkpoint.safetensors`, `weights.safetensors` and `log.jsonl`.
    pub output: PathBuf,
    /// Seed of the initial weights and of every batch.
    pub seed: u64,
    /// Optimiser steps; where `minutes` is given, an upper bound.
    pub steps: u64,
    /// Minutes of training over all resumptions; the learning rate follows time then, so that the run ends annealed.
    pub minutes: Option<f64>,
    /// Batches, drawn by weight. Large crops teach long-range attention.
    pub crops: Vec<CropConfig>,
    /// Peak learning rate.
    pub learning_rate: f64,
    /// Steps of linear warm-up.
    pub warmup_steps: u64,
    /// Decoupled weight decay.
    pub weight_decay: f32,
    /// Largest gradient norm.
    pub clip_norm: f32,
    /// Decay of the moving average of the weights.
    pub ema_decay: f32,
    /// Loss weights.
    pub loss: LossWeights,
    /// Probability of each bridge time 0, 1/4, 1/2, 3/4.
    pub time_probabilities: [f32; 4],
    /// Every time from 0 to [`crate::bridge::LAST_TIME`] alike, in place of the four.
    pub uniform_times: bool,
    /// Noise of the bridge, in units of z; 0 for the straight path.
    pub sigma: f32,
    /// Mebibytes of training data held in memory.
    pub cache_mib: usize,
    /// Steps after which a clip is replaced when not all fit.
    pub rotate_steps: u64,
    /// Steps between checkpoints.
    pub checkpoint_steps: u64,
    /// Steps between log lines and progress reports.
    pub log_steps: u64,
    /// Number format of the final weights.
    pub precision: Precision,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            network: NetworkConfig::default(),
            stage: Stage::Base,
            output: PathBuf::from("train-out"),
            seed: 1,
            steps: 20_000,
            minutes: None,
            crops: vec![CropConfig { size: 128, batch: 8, weight: 0.85 }, CropConfig { size: 256, batch: 2, weight: 0.15 }],
            // 1e-3 made the convolutions, which have no normalisation, die within 300 steps.
            learning_rate: 4e-4,
            warmup_steps: 300,
            weight_decay: 0.01,
            clip_norm: 1.0,
            ema_decay: 0.999,
            loss: LossWeights::default(),
            time_probabilities: [0.7, 0.1, 0.1, 0.1],
            uniform_times: false,
            sigma: SIGMA,
            cache_mib: 8192,
            rotate_steps: 20,
            checkpoint_steps: 500,
            log_steps: 20,
            precision: Precision::F16,
        }
    }
}

impl Config {
    pub(super) fn settings(&self) -> runner::Settings {
        runner::Settings {
            method: Method::AdamW,
            steps: self.steps,
            minutes: self.minutes,
            learning_rate: self.learning_rate,
            warmup_steps: self.warmup_steps,
            decay: Decay::Cosine,
            weight_decay: self.weight_decay,
            clip_norm: self.clip_norm,
            ema_decay: self.ema_decay,
            checkpoint_steps: self.checkpoint_steps,
            log_steps: self.log_steps,
        }
    }

    /// The bridge that training draws from.
    pub fn bridge(&self) -> Bridge {
        let times = if self.uniform_times { Times::Uniform } else { Times::Four(self.time_probabilities) };
        Bridge { sigma: self.sigma, times }
    }

    /// Checks every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        self.network.validate()?;
        if self.crops.is_empty() {
            return Err(Error::config("crops", "needs at least one kind of batch"));
        }
        for crop in &self.crops {
            if crop.size == 0 || !crop.size.is_multiple_of(PIXEL_MULTIPLE) || crop.size > 4096 {
                return Err(Error::config(
                    "crops.size",
                    format!("{} is not a multiple of {PIXEL_MULTIPLE} up to 4096", crop.size),
                ));
            }
            if crop.batch == 0 || crop.batch > 4096 {
                return Err(Error::config("crops.batch", "must be 1..=4096"));
            }
            if !(crop.weight >= 0.0 && crop.weight.is_finite()) {
                return Err(Error::config("crops.weight", "must be a number >= 0"));
            }
        }
        let checks = [
            ("crops.weight", self.crops.iter().map(|c| c.weight).sum::<f32>() > 0.0, "must not all be 0"),
            ("steps", self.steps > 0, "must be at least 1"),
            ("minutes", self.minutes.is_none_or(|m| m > 0.0 && m.is_finite()), "must be a number > 0"),
            ("learning_rate", self.learning_rate > 0.0 && self.learning_rate <= 1.0, "must be in 0..=1"),
            ("weight_decay", (0.0..=1.0).contains(&self.weight_decay), "must be in 0..=1"),
            ("clip_norm", self.clip_norm > 0.0 && self.clip_norm.is_finite(), "must be a number > 0"),
            ("ema_decay", (0.0..1.0).contains(&self.ema_decay), "must be in 0..1"),
            ("loss", [self.loss.display, self.loss.gradient].iter().all(|w| *w >= 0.0 && w.is_finite()), "weights must be >= 0"),
            ("time_probabilities", Times::Four(self.time_probabilities).is_valid(), "must be >= 0 and not all 0"),
            ("sigma", (0.0..=1.0).contains(&self.sigma), "must be in 0..=1"),
            ("checkpoint_steps", self.checkpoint_steps > 0, "must be at least 1"),
            ("log_steps", self.log_steps > 0, "must be at least 1"),
            ("rotate_steps", self.rotate_steps > 0, "must be at least 1"),
        ];
        match checks.into_iter().find(|(_, valid, _)| !valid) {
            Some((option, _, reason)) => Err(Error::config(option, reason)),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_a_checkpoint_cannot_hold_are_refused() {
        Config::default().validate().expect("valid");
        // JSON has no infinity: the run could not be resumed.
        let error = Config { clip_norm: f32::INFINITY, ..Config::default() }.validate().expect_err("no bound").to_string();
        assert!(error.contains("clip_norm"), "{error}");
    }
}
