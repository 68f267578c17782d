//! The options that every training run has, with their defaults and ranges. The configuration of a network holds them beside its
//! own options; in a file, both are fields of one JSON object.

use crate::{Error, Result};
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use std::path::PathBuf;

/// Number format in which gradients travel between processes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gradients {
    /// Single precision.
    #[default]
    F32,
    /// Half precision, after a scaling that brings the largest gradient of a step to the top of its range. Sums are in single
    /// precision.
    F16,
}

/// The rule by which parameters are updated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// AdamW (Loshchilov and Hutter 2019) for every parameter.
    #[default]
    AdamW,
    /// Muon (Jordan et al. 2024) for convolution kernels wider than one pixel, taken as matrices of inputs by outputs. AdamW
    /// updates the other parameters.
    Muon,
}

/// How the learning rate changes after the warm-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decay {
    /// It follows half a cosine down to 1% of the peak.
    #[default]
    Cosine,
    /// It stays at the peak.
    Constant,
}

/// Options of a training run of any network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunConfig {
    /// Folder for `checkpoint.safetensors`, `weights.safetensors` and `log.jsonl`.
    pub output: PathBuf,
    /// Seed of the initial weights and of every batch.
    pub seed: u64,
    /// Optimiser steps, at least 1. With `minutes`, the run may end earlier.
    pub steps: u64,
    /// Minutes of training over all resumptions, above 0. The learning rate then follows time, so that it is annealed at the end.
    pub minutes: Option<f64>,
    /// How parameters are updated.
    pub optimizer: Method,
    /// Peak learning rate, above 0 and at most 1.
    pub learning_rate: f64,
    /// Steps over which the learning rate rises linearly at the start.
    pub warmup_steps: u64,
    /// How the learning rate changes after the warm-up.
    pub decay: Decay,
    /// Decoupled weight decay of matrices and convolutions, 0..=1. Biases and normalisation factors have none.
    pub weight_decay: f32,
    /// Largest Euclidean norm of the gradient, above 0. A longer gradient is scaled down to it.
    pub clip_norm: f32,
    /// Decay of the moving average of the weights, at least 0 and below 1.
    pub ema_decay: f32,
    /// Steps between checkpoints, at least 1.
    pub checkpoint_steps: u64,
    /// Steps between log lines and progress reports, at least 1.
    pub log_steps: u64,
    /// Number format in which processes that train together exchange gradients.
    pub gradients: Gradients,
}

impl Default for RunConfig {
    fn default() -> Self {
        Self {
            output: PathBuf::from("train-out"),
            seed: 1,
            steps: 20_000,
            minutes: None,
            optimizer: Method::AdamW,
            learning_rate: 3e-4,
            warmup_steps: 200,
            decay: Decay::Cosine,
            weight_decay: 0.01,
            clip_norm: 1.0,
            ema_decay: 0.999,
            checkpoint_steps: 500,
            log_steps: 20,
            gradients: Gradients::F32,
        }
    }
}

impl RunConfig {
    /// Checks the range of every option.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        all([
            ("steps", self.steps > 0, "must be at least 1"),
            ("minutes", self.minutes.is_none_or(|m| m > 0.0 && m.is_finite()), "must be a number above 0"),
            ("learning_rate", self.learning_rate > 0.0 && self.learning_rate <= 1.0, "must be above 0 and at most 1"),
            ("weight_decay", (0.0..=1.0).contains(&self.weight_decay), "must be in 0..=1"),
            ("clip_norm", self.clip_norm > 0.0 && self.clip_norm.is_finite(), "must be a number above 0"),
            ("ema_decay", (0.0..1.0).contains(&self.ema_decay), "must be at least 0 and below 1"),
            ("checkpoint_steps", self.checkpoint_steps > 0, "must be at least 1"),
            ("log_steps", self.log_steps > 0, "must be at least 1"),
        ])
    }

    /// The share of the run that is done after `step` steps and `elapsed` seconds; 1 or more at its end.
    pub fn share(&self, step: u64, elapsed: f64) -> f64 {
        let by_steps = step as f64 / self.steps as f64;
        self.minutes.map_or(by_steps, |minutes| by_steps.max(elapsed / (60.0 * minutes)))
    }

    /// The first option that a resumed run may not change.
    pub(super) fn difference(&self, other: &Self) -> Option<&'static str> {
        first_difference([("seed", self.seed == other.seed), ("optimizer", self.optimizer == other.optimizer)])
    }
}

/// The configuration of a network's training.
pub trait TrainingConfig: Clone + Serialize + DeserializeOwned {
    /// The options that every run has.
    fn run(&self) -> &RunConfig;
    /// The first of the network's own options that a resumed run may not change.
    fn difference(&self, other: &Self) -> Option<&'static str>;
}

/// The first option of a list that is not the same in two configurations.
pub(crate) fn first_difference<const N: usize>(options: [(&'static str, bool); N]) -> Option<&'static str> {
    options.into_iter().find(|(_, same)| !same).map(|(option, _)| option)
}

/// Checks a list of options, whether each is valid, and what it must be.
///
/// # Errors
/// [`Error::Config`] with the first invalid option.
pub(crate) fn all<const N: usize>(checks: [(&'static str, bool, &'static str); N]) -> Result<()> {
    match checks.into_iter().find(|(_, valid, _)| !valid) {
        Some((option, _, reason)) => Err(Error::config(option, reason)),
        None => Ok(()),
    }
}

/// Checks the weights of the terms of a loss.
///
/// # Errors
/// [`Error::Config`] naming the first one that is not a number of at least 0.
pub(crate) fn weights<const N: usize>(weights: [(&'static str, f32); N]) -> Result<()> {
    all(weights.map(|(option, weight)| (option, (0.0..=f32::MAX).contains(&weight), "must be a number of at least 0")))
}

/// Reads a configuration from a JSON object. Options that the object lacks have their defaults. `upgrade` brings the object of an
/// older program up to date, and `read` is the derived reader, which needs every option.
pub(crate) fn over_defaults<'de, D: Deserializer<'de>, C: Default + Serialize>(
    deserializer: D,
    upgrade: fn(&mut Map<String, Value>),
    read: fn(Value) -> serde_json::Result<C>,
) -> std::result::Result<C, D::Error> {
    let mut given = Map::deserialize(deserializer)?;
    upgrade(&mut given);
    let Value::Object(mut all) = serde_json::to_value(C::default()).map_err(D::Error::custom)? else {
        return Err(D::Error::custom("not an object"));
    };
    for (option, value) in given {
        let Some(place) = all.get_mut(&option) else {
            let known: Vec<String> = all.keys().map(|known| format!("`{known}`")).collect();
            return Err(D::Error::custom(format!("unknown field `{option}`, expected one of {}", known.join(", "))));
        };
        *place = value;
    }
    read(Value::Object(all)).map_err(D::Error::custom)
}
