//! AdamW with global gradient clipping and an exponential moving average of the weights, in one pass over the host's memory.
//!
//! burn's optimiser makes some ten full-size temporaries a step and clips each tensor by itself; this keeps one gradient direction.

use crate::parameters::Parameter;
use rayon::prelude::*;

/// Settings of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepSettings {
    /// Learning rate.
    pub learning_rate: f32,
    /// Decoupled weight decay of matrices and convolutions (not of biases and norms).
    pub weight_decay: f32,
    /// Gradients are scaled down to this Euclidean norm.
    pub clip_norm: f32,
    /// Decay of the moving average, before its warm-up.
    pub ema_decay: f32,
}

/// Decay of the first and the second moment, and the term that keeps the quotient finite (Loshchilov and Hutter 2019).
const BETA: [f32; 2] = [0.9, 0.99];
const EPSILON: f32 = 1e-8;

/// One parameter with its optimiser state; all vectors have the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// Current value.
    pub parameter: Parameter,
    /// First moment.
    pub first: Vec<f32>,
    /// Second moment.
    pub second: Vec<f32>,
    /// Moving average of the value.
    pub average: Vec<f32>,
}

/// Optimiser state of a whole module, in the order of [`crate::parameters::export`].
#[derive(Clone, Debug, PartialEq)]
pub struct Optimizer {
    /// Parameters.
    pub slots: Vec<Slot>,
    /// Steps taken.
    pub steps: u64,
}

impl Optimizer {
    /// Fresh state; the average starts at the value.
    pub fn new(parameters: Vec<Parameter>) -> Self {
        let slot = |parameter: Parameter| {
            let zeros = vec![0.0; parameter.values.len()];
            Slot { average: parameter.values.clone(), first: zeros.clone(), second: zeros, parameter }
        };
        Self { slots: parameters.into_iter().map(slot).collect(), steps: 0 }
    }

    /// Takes one step and returns the norm of the gradient before clipping. A missing gradient counts as zero.
    ///
    /// # Errors
    /// The name of the first parameter whose gradient is not finite; nothing is changed then.
    pub fn step(&mut self, gradients: &[Option<Vec<f32>>], settings: StepSettings) -> Result<f32, String> {
        let squares: Vec<f64> = gradients
            .par_iter()
            .map(|g| g.as_ref().map_or(0.0, |g| g.iter().map(|&v| f64::from(v) * f64::from(v)).sum()))
            .collect();
        if let Some(i) = squares.iter().position(|s| !s.is_finite()) {
            return Err(self.slots[i].parameter.name.clone());
        }
        let norm = squares.iter().sum::<f64>().sqrt() as f32;
        let scale = if norm > settings.clip_norm { settings.clip_norm / norm } else { 1.0 };

        self.steps += 1;
        let t = self.steps as f64;
        // Bias corrections, in f64: 1 - beta^t is small at first.
        let correction = BETA.map(|beta| (1.0 / (1.0 - f64::from(beta).powf(t))) as f32);
        // A short memory at first, so that the average forgets the random start (as in TensorFlow's moving average).
        let ema = settings.ema_decay.min((1.0 + t as f32) / (10.0 + t as f32));
        self.slots.par_iter_mut().zip(gradients).for_each(|(slot, gradient)| {
            let decay = if slot.parameter.shape.len() > 1 { 1.0 - settings.learning_rate * settings.weight_decay } else { 1.0 };
            for i in 0..slot.first.len() {
                let g = gradient.as_ref().map_or(0.0, |g| g[i]) * scale;
                let m = BETA[0] * slot.first[i] + (1.0 - BETA[0]) * g;
                let v = BETA[1] * slot.second[i] + (1.0 - BETA[1]) * g * g;
                slot.first[i] = m;
                slot.second[i] = v;
                let value = decay * slot.parameter.values[i]
                    - settings.learning_rate * (m * correction[0]) / ((v * correction[1]).sqrt() + EPSILON);
                slot.parameter.values[i] = value;
                slot.average[i] = ema * slot.average[i] + (1.0 - ema) * value;
            }
        });
        Ok(norm)
    }

    /// Current values, one slice a parameter.
    pub fn values(&self) -> Vec<&[f32]> {
        self.slots.iter().map(|slot| slot.parameter.values.as_slice()).collect()
    }

    /// Averaged parameters: what is evaluated and shipped.
    pub fn averaged(&self) -> Vec<Parameter> {
        self.slots.iter().map(|slot| Parameter { values: slot.average.clone(), ..slot.parameter.clone() }).collect()
    }
}
