//! AdamW or Muon with global gradient clipping and an exponential moving average of the weights, in one pass over the host's memory.
//!
//! burn's optimiser makes some ten full-size temporaries a step and clips each tensor by itself; this keeps one gradient direction.

use crate::parameters::{Parameter, to_vec};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which way a step goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// AdamW (Loshchilov and Hutter 2019) for every parameter.
    #[default]
    AdamW,
    /// Muon (Jordan et al. 2024) for the kernels of convolutions wider than a pixel, as matrices of inputs by outputs; AdamW for the rest.
    Muon,
}

/// Settings of a step.
#[derive(Clone, Copy, Debug)]
pub struct StepSettings {
    /// Which way the step goes.
    pub method: Method,
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

/// Decay of Muon's momentum.
const MOMENTUM: f32 = 0.95;
/// Coefficients of the odd polynomial that, applied over and over, takes singular values to about 1.
const POLYNOMIAL: [f32; 3] = [3.4445, -4.7750, 2.0315];
const ITERATIONS: usize = 5;
/// Root mean square of AdamW's steps over the learning rate, about, so that one rate serves both (Liu et al. 2025).
const ADAMW_STEP: f32 = 0.2;

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

impl Slot {
    /// Rows and columns of the matrix whose step Muon takes; `None` where AdamW takes it.
    fn matrix(&self) -> Option<[usize; 2]> {
        match self.parameter.shape[..] {
            [height, width, inputs, outputs] if height * width > 1 => Some([height * width * inputs, outputs]),
            _ => None,
        }
    }

    /// The step of AdamW; `correction` takes out the bias of the young moments.
    fn step_along_moments(&mut self, gradient: Option<&[f32]>, scale: f32, correction: [f32; 2], settings: StepSettings) {
        let decay = if self.parameter.shape.len() > 1 { 1.0 - settings.learning_rate * settings.weight_decay } else { 1.0 };
        for i in 0..self.first.len() {
            let g = gradient.map_or(0.0, |g| g[i]) * scale;
            let m = BETA[0] * self.first[i] + (1.0 - BETA[0]) * g;
            let v = BETA[1] * self.second[i] + (1.0 - BETA[1]) * g * g;
            self.first[i] = m;
            self.second[i] = v;
            self.parameter.values[i] = decay * self.parameter.values[i]
                - settings.learning_rate * (m * correction[0]) / ((v * correction[1]).sqrt() + EPSILON);
        }
    }

    /// The step of Muon: along the nearest orthogonal matrix to the momentum, with Nesterov's look ahead.
    fn step_along_orthogonal(
        &mut self,
        gradient: Option<&[f32]>,
        scale: f32,
        [rows, columns]: [usize; 2],
        settings: StepSettings,
    ) {
        let ahead: Vec<f32> = (0..self.first.len())
            .map(|i| {
                let g = gradient.map_or(0.0, |g| g[i]) * scale;
                self.first[i] = MOMENTUM * self.first[i] + (1.0 - MOMENTUM) * g;
                MOMENTUM * self.first[i] + (1.0 - MOMENTUM) * g
            })
            .collect();
        let length = settings.learning_rate * ADAMW_STEP * (rows.max(columns) as f32).sqrt();
        let decay = 1.0 - settings.learning_rate * settings.weight_decay;
        for (value, along) in self.parameter.values.iter_mut().zip(orthogonal(&ahead, rows, columns)) {
            *value = decay * *value - length * along;
        }
    }
}

/// About the nearest matrix to `values` `[rows, columns]` whose shorter side is orthonormal: singular values between .7 and 1.2.
fn orthogonal(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let norm = values.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt() as f32;
    if norm == 0.0 {
        return vec![0.0; values.len()];
    }
    let scaled: Vec<f32> = values.iter().map(|v| v / norm).collect();
    let x: Tensor<2> = Tensor::from_data(TensorData::new(scaled, [rows, columns]), &Device::flex());
    // Products of the shorter side with itself are the smaller ones.
    let tall = rows > columns;
    let mut x = if tall { x.transpose() } else { x };
    let [a, b, c] = POLYNOMIAL;
    for _ in 0..ITERATIONS {
        let square = x.clone().matmul(x.clone().transpose());
        let along = square.clone().mul_scalar(b) + square.clone().matmul(square).mul_scalar(c);
        x = x.clone().mul_scalar(a) + along.matmul(x);
    }
    to_vec(if tall { x.transpose() } else { x })
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
            let gradient = gradient.as_deref();
            match slot.matrix().filter(|_| settings.method == Method::Muon) {
                Some(matrix) => slot.step_along_orthogonal(gradient, scale, matrix, settings),
                None => slot.step_along_moments(gradient, scale, correction, settings),
            }
            for (average, value) in slot.average.iter_mut().zip(&slot.parameter.values) {
                *average = ema * *average + (1.0 - ema) * value;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a diagonal matrix with an orthogonal factor on either side it keeps the factors.
    #[test]
    fn the_orthogonal_matrix_is_that_of_the_polar_decomposition() {
        let (c, s) = (0.6, 0.8);
        let tall = |sigma: [f32; 2]| -> Vec<f32> {
            // Columns of the left factor, in three rows.
            let left = [[1.0, 0.0], [0.0, c], [0.0, s]];
            let right = [[c, s], [-s, c]];
            left.iter().flat_map(|row| (0..2).map(move |j| (0..2).map(|k| row[k] * sigma[k] * right[k][j]).sum())).collect()
        };
        let wide: Vec<f32> = (0..2).flat_map(|j| (0..3).map(move |i| tall([3.0, 0.2])[2 * i + j])).collect();
        let expected = tall([1.0, 1.0]);
        let (of_tall, of_wide) = (orthogonal(&tall([3.0, 0.2]), 3, 2), orthogonal(&wide, 2, 3));
        for i in 0..3 {
            for j in 0..2 {
                assert!((of_tall[2 * i + j] - expected[2 * i + j]).abs() < 0.3, "{of_tall:?} {expected:?}");
                assert!((of_wide[3 * j + i] - of_tall[2 * i + j]).abs() < 1e-5);
            }
        }
        assert_eq!(orthogonal(&[0.0; 6], 3, 2), [0.0; 6]);
    }

    /// Both methods go down a valley whose sides are a hundred times as steep as its bottom.
    #[test]
    fn both_methods_reach_the_bottom() {
        for method in [Method::AdamW, Method::Muon] {
            let shape = vec![3, 3, 1, 2];
            let wanted: Vec<f32> = (0..18).map(|i| (i as f32 * 0.7).sin()).collect();
            let parameter = Parameter { name: "kernel".into(), shape, values: vec![0.0; 18] };
            let mut optimizer = Optimizer::new(vec![parameter]);
            let distance = |optimizer: &Optimizer| -> f32 {
                optimizer.values()[0].iter().zip(&wanted).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt()
            };
            let before = distance(&optimizer);
            for step in 0..400 {
                let steepness = |i: usize| if i.is_multiple_of(2) { 100.0 } else { 1.0 };
                let gradient = (0..18).map(|i| steepness(i) * (optimizer.values()[0][i] - wanted[i])).collect();
                let learning_rate = 0.05 * (1.0 - step as f32 / 400.0);
                let settings = StepSettings { method, learning_rate, weight_decay: 0.0, clip_norm: 1.0, ema_decay: 0.9 };
                optimizer.step(&[Some(gradient)], settings).expect("finite gradients");
            }
            assert!(distance(&optimizer) < 0.02 * before, "{method:?}: {} of {before}", distance(&optimizer));
        }
    }
}
