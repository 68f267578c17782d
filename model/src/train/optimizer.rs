//! AdamW or Muon with global gradient clipping and an exponential moving average of the weights, in one pass over the host's
//! memory.
//!
//! burn's own optimiser allocates about ten full-size temporaries per step and clips each tensor separately, which changes the
//! direction of the gradient.

use super::config::{Method, RunConfig};
use crate::parameters::{Parameter, to_vec};
use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;

/// Decay of the first and the second moment (Loshchilov and Hutter 2019).
pub(super) const BETA: [f32; 2] = [0.9, 0.99];
/// Keeps AdamW's quotient finite.
pub(super) const EPSILON: f32 = 1e-8;

/// Decay of Muon's momentum.
pub(super) const MOMENTUM: f32 = 0.95;
/// Coefficients of the odd polynomial that brings singular values close to 1 when it is applied repeatedly.
const POLYNOMIAL: [f32; 3] = [3.4445, -4.7750, 2.0315];
const ITERATIONS: usize = 5;
/// Approximate root mean square of AdamW's steps, divided by the learning rate. Scaling Muon by it lets both methods use the same
/// learning rate (Liu et al. 2025).
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
    /// Updates the value by AdamW.
    fn update_adamw(&mut self, gradient: &[f32], pace: &Pace) {
        let decay = if self.parameter.shape.len() > 1 { 1.0 - pace.learning_rate * pace.weight_decay } else { 1.0 };
        for (i, gradient) in gradient.iter().enumerate() {
            let g = gradient * pace.clip;
            let m = BETA[0] * self.first[i] + (1.0 - BETA[0]) * g;
            let v = BETA[1] * self.second[i] + (1.0 - BETA[1]) * g * g;
            self.first[i] = m;
            self.second[i] = v;
            self.parameter.values[i] = decay * self.parameter.values[i]
                - pace.learning_rate * (m * pace.correction[0]) / ((v * pace.correction[1]).sqrt() + EPSILON);
        }
    }

    /// Updates the value by Muon: along the orthogonal matrix nearest to the Nesterov momentum.
    fn update_muon(&mut self, gradient: &[f32], [rows, columns]: [usize; 2], pace: &Pace) {
        let momentum: Vec<f32> = (0..self.first.len())
            .map(|i| {
                let g = gradient[i] * pace.clip;
                self.first[i] = MOMENTUM * self.first[i] + (1.0 - MOMENTUM) * g;
                MOMENTUM * self.first[i] + (1.0 - MOMENTUM) * g
            })
            .collect();
        let length = pace.muon([rows, columns]);
        let decay = 1.0 - pace.learning_rate * pace.weight_decay;
        for (value, along) in self.parameter.values.iter_mut().zip(nearest_orthogonal(&momentum, [rows, columns])) {
            *value = decay * *value - length * along;
        }
    }
}

/// How far one step goes, and what it remembers.
pub(super) struct Pace {
    /// Learning rate.
    pub learning_rate: f32,
    /// Weight decay per step and learning rate.
    pub weight_decay: f32,
    /// Factor that clips the norm of all gradients together.
    pub clip: f32,
    /// Factors that remove the bias of the moments' first steps.
    pub correction: [f32; 2],
    /// Decay of the average.
    pub ema: f32,
}

impl Pace {
    /// Of step number `step`, counted from 1, whose gradients have the Euclidean norm `norm`.
    pub fn new(step: u64, norm: f32, learning_rate: f32, run: &RunConfig) -> Self {
        let t = step as f64;
        Self {
            learning_rate,
            weight_decay: run.weight_decay,
            clip: if norm > run.clip_norm { run.clip_norm / norm } else { 1.0 },
            // In f64: 1 - beta^t is small at first.
            correction: BETA.map(|beta| (1.0 / (1.0 - f64::from(beta).powf(t))) as f32),
            // The memory is short at first, so that the average forgets the random start (as in TensorFlow's moving average).
            ema: run.ema_decay.min((1.0 + t as f32) / (10.0 + t as f32)),
        }
    }

    /// Length of a step of Muon in each direction.
    pub fn muon(&self, [rows, columns]: [usize; 2]) -> f32 {
        self.learning_rate * ADAMW_STEP * (rows.max(columns) as f32).sqrt()
    }
}

/// Rows and columns of the matrix that Muon updates, or `None` for a parameter of a shape that AdamW updates.
pub(super) fn matrix(shape: &[usize]) -> Option<[usize; 2]> {
    match shape[..] {
        [height, width, inputs, outputs] if height * width > 1 => Some([height * width * inputs, outputs]),
        _ => None,
    }
}

/// [`orthogonal`] of values of any norm.
fn nearest_orthogonal(values: &[f32], shape: [usize; 2]) -> Vec<f32> {
    let norm = values.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>().sqrt() as f32;
    if norm == 0.0 {
        return vec![0.0; values.len()];
    }
    let unit: Vec<f32> = values.iter().map(|v| v / norm).collect();
    to_vec(orthogonal(Tensor::from_data(TensorData::new(unit, shape), &Device::flex())))
}

/// Approximates the semi-orthogonal matrix nearest to `x`, a matrix whose Euclidean norm is 1: singular values come out between
/// 0.7 and 1.2. Zeros stay zeros.
///
/// Each iteration multiplies `x` from the left by a polynomial `p` of `g`, the product of `x` and its transpose, so that `g`
/// becomes `p g p`. All of these commute. The iterations are therefore carried out on square matrices of the shorter side, and
/// `x` is multiplied once, by the product `q` of all polynomials.
pub(super) fn orthogonal(x: Tensor<2>) -> Tensor<2> {
    let [rows, columns] = x.dims();
    let tall = rows > columns;
    let x = if tall { x.transpose() } else { x };
    let one = Tensor::eye(rows.min(columns), &x.device());
    let mut g = x.clone().matmul(x.clone().transpose());
    let mut q: Option<Tensor<2>> = None;
    let [a, b, c] = POLYNOMIAL;
    for iteration in 1..=ITERATIONS {
        let square = g.clone().matmul(g.clone());
        let p = one.clone().mul_scalar(a) + g.clone().mul_scalar(b) + square.mul_scalar(c);
        if iteration < ITERATIONS {
            g = p.clone().matmul(p.clone().matmul(g));
        }
        q = Some(match q {
            Some(q) => p.matmul(q),
            None => p,
        });
    }
    let x = q.map_or(x.clone(), |q| q.matmul(x));
    if tall { x.transpose() } else { x }
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

    /// Takes one step at this learning rate and returns the norm of the gradient before clipping. A parameter whose gradient is
    /// missing stays as it is, with its moments and its average. Of `run`, the method, the weight decay, the largest norm and the
    /// decay of the average are read.
    ///
    /// # Errors
    /// The name of the first parameter whose gradient is not finite. Nothing is changed then.
    pub fn step(&mut self, gradients: &[Option<Vec<f32>>], learning_rate: f32, run: &RunConfig) -> Result<f32, String> {
        let squares: Vec<f64> = gradients
            .par_iter()
            .map(|g| g.as_ref().map_or(0.0, |g| g.iter().map(|&v| f64::from(v) * f64::from(v)).sum()))
            .collect();
        if let Some(i) = squares.iter().position(|s| !s.is_finite()) {
            return Err(self.slots[i].parameter.name.clone());
        }
        let norm = squares.iter().sum::<f64>().sqrt() as f32;
        self.steps += 1;
        let pace = Pace::new(self.steps, norm, learning_rate, run);
        self.slots.par_iter_mut().zip(gradients).for_each(|(slot, gradient)| {
            let Some(gradient) = gradient else { return };
            match matrix(&slot.parameter.shape).filter(|_| run.optimizer == Method::Muon) {
                Some(matrix) => slot.update_muon(gradient, matrix, &pace),
                None => slot.update_adamw(gradient, &pace),
            }
            for (average, value) in slot.average.iter_mut().zip(&slot.parameter.values) {
                *average = pace.ema * *average + (1.0 - pace.ema) * value;
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

    /// The orthogonal factors on both sides of a diagonal matrix are kept, and the diagonal becomes 1.
    #[test]
    fn the_orthogonal_matrix_is_the_polar_factor() {
        let (c, s) = (0.6, 0.8);
        let tall = |sigma: [f32; 2]| -> Vec<f32> {
            // Columns of the left factor, in three rows.
            let left = [[1.0, 0.0], [0.0, c], [0.0, s]];
            let right = [[c, s], [-s, c]];
            left.iter().flat_map(|row| (0..2).map(move |j| (0..2).map(|k| row[k] * sigma[k] * right[k][j]).sum())).collect()
        };
        let wide: Vec<f32> = (0..2).flat_map(|j| (0..3).map(move |i| tall([3.0, 0.2])[2 * i + j])).collect();
        let expected = tall([1.0, 1.0]);
        let (of_tall, of_wide) = (nearest_orthogonal(&tall([3.0, 0.2]), [3, 2]), nearest_orthogonal(&wide, [2, 3]));
        for i in 0..3 {
            for j in 0..2 {
                assert!((of_tall[2 * i + j] - expected[2 * i + j]).abs() < 0.3, "{of_tall:?} {expected:?}");
                assert!((of_wide[3 * j + i] - of_tall[2 * i + j]).abs() < 1e-5);
            }
        }
        assert_eq!(nearest_orthogonal(&[0.0; 6], [3, 2]), [0.0; 6]);
    }

    /// Both methods descend a valley whose sides are a hundred times steeper than its bottom.
    #[test]
    fn both_methods_reach_the_bottom() {
        for method in [Method::AdamW, Method::Muon] {
            let run = RunConfig { optimizer: method, weight_decay: 0.0, clip_norm: 1.0, ema_decay: 0.9, ..RunConfig::default() };
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
                optimizer.step(&[Some(gradient)], learning_rate, &run).expect("finite gradients");
            }
            assert!(distance(&optimizer) < 0.02 * before, "{method:?}: {} of {before}", distance(&optimizer));
        }
    }
}
