//! Differentiable losses on pictures `[b, c, f, h, w]` with values -1..=1, and their weighted sum. Each loss is one number,
//! `[1]`.

use crate::parameters::{GradientList, read};
use crate::train::runner::StepResult;
use crate::{Error, Result};
use burn::tensor::Tensor;

/// Numbers by name.
type Terms = Vec<(&'static str, f32)>;

/// A weighted sum of losses, and its terms for the log.
#[derive(Default)]
pub(super) struct LossSum {
    loss: Option<Tensor<1>>,
    terms: Terms,
    squares: Terms,
}

/// The numbers of a [`LossSum`].
pub(super) struct LossReport {
    total: f32,
    terms: Terms,
    squares: Terms,
}

impl LossReport {
    /// The result of a step, with the gradients of a batch.
    pub fn result(self, items: usize, gradients: GradientList) -> StepResult {
        StepResult { total: self.total, terms: self.terms, squares: self.squares, items, gradients }
    }
}

impl LossSum {
    /// Adds `weight` times a loss, unless the weight is 0. The log gets the loss without the weight.
    pub fn add(&mut self, name: &'static str, weight: f32, loss: Tensor<1>) {
        self.terms.push((name, value(loss.clone())));
        if weight > 0.0 {
            let loss = loss.mul_scalar(weight);
            self.loss = Some(match self.loss.take() {
                Some(sum) => sum + loss,
                None => loss,
            });
        }
    }

    /// Adds the mean squared error of two pictures to the log, for values scaled to 0..=1.
    pub fn compare(&mut self, a: Tensor<5>, b: Tensor<5>) {
        let squares = square(a.without_autodiff(), b.without_autodiff()).mul_scalar(0.25);
        self.squares.push(("pictures", value(squares)));
    }

    /// The numbers of the sum, and the sum to be differentiated.
    ///
    /// # Errors
    /// When the weights of all losses are 0.
    pub fn finish(self) -> Result<(LossReport, Tensor<1>)> {
        let loss = self.loss.ok_or_else(|| Error::config("stage", "the weights of all losses are 0"))?;
        Ok((LossReport { total: value(loss.clone()), terms: self.terms, squares: self.squares }, loss))
    }
}

/// The value of a scalar. It is NaN where the device has failed, which the reading of the gradients then reports.
fn value(of: Tensor<1>) -> f32 {
    read(of.without_autodiff()).ok().and_then(|values| values.first().copied()).unwrap_or(f32::NAN)
}

/// Frames of clips as pictures: `[b, c, f, h, w]` to `[b f, c, h, w]`.
pub(super) fn frames(x: Tensor<5>) -> Tensor<4> {
    let [b, c, f, h, w] = x.dims();
    x.permute([0, 2, 1, 3, 4]).reshape([b * f, c, h, w])
}

/// Mean squared difference.
pub fn square(a: Tensor<5>, b: Tensor<5>) -> Tensor<1> {
    let d = a - b;
    (d.clone() * d).mean()
}

/// Mean absolute difference.
pub fn absolute(a: Tensor<5>, b: Tensor<5>) -> Tensor<1> {
    (a - b).abs().mean()
}

/// Keeps the slope of the square root finite where a picture is flat (SPSR, Ma et al. 2020).
const FLAT: f32 = 1e-6;

/// Mean absolute difference of the gradient magnitudes `sqrt(gx^2 + gy^2 + 1e-6)` of two pictures, per channel, with
/// `gx = I(x + 1) - I(x - 1)`. The mean is over the pixels that have all neighbours: the zero padding of SPSR (Ma et al. 2020)
/// would turn the border into an edge. It is 0 for pictures with fewer than three pixels a side.
pub fn gradient(a: Tensor<5>, b: Tensor<5>) -> Tensor<1> {
    let [_, _, _, h, w] = a.dims();
    if h < 3 || w < 3 {
        return a.mul_scalar(0.0).mean();
    }
    let magnitude = |x: Tensor<5>| {
        let rows = x.clone().narrow(3, 1, h - 2);
        let columns = x.narrow(4, 1, w - 2);
        let gx = rows.clone().narrow(4, 2, w - 2) - rows.narrow(4, 0, w - 2);
        let gy = columns.clone().narrow(3, 2, h - 2) - columns.narrow(3, 0, h - 2);
        (gx.clone() * gx + gy.clone() * gy).add_scalar(FLAT).sqrt()
    };
    absolute(magnitude(a), magnitude(b))
}

/// Mean Kullback-Leibler divergence of normal distributions from the standard normal distribution, in nats per value (Kingma and
/// Welling 2014).
pub fn divergence(mean: Tensor<5>, log_variance: Tensor<5>) -> Tensor<1> {
    (mean.clone() * mean + log_variance.clone().exp() - log_variance).sub_scalar(1.0).mean().mul_scalar(0.5)
}

/// Mean of `1 - cos` of the angle between predicted and true vectors `[b, 3, f, h, w]`, over the pixels of `mask` `[b, 1, f, h,
/// w]`.
pub fn angle(a: Tensor<5>, b: Tensor<5>, mask: Tensor<5>) -> Tensor<1> {
    let dot = |x: &Tensor<5>, y: &Tensor<5>| (x.clone() * y.clone()).sum_dim(1);
    // The bound is added inside the root, so that the slope at a zero vector is finite.
    let length = |x: &Tensor<5>| dot(x, x).add_scalar(1e-6).sqrt();
    let cosine = dot(&a, &b) / (length(&a) * length(&b));
    masked_mean(cosine.neg().add_scalar(1.0), mask)
}

/// Mean absolute difference over the pixels of `mask` `[b, 1, f, h, w]`.
pub fn masked_absolute(a: Tensor<5>, b: Tensor<5>, mask: Tensor<5>) -> Tensor<1> {
    masked_mean((a - b).abs().mean_dim(1), mask)
}

/// `1/N sum d^2 - 1/(2 N^2) (sum d)^2`, averaged over the items, where d are the differences of log depth `[b, 1, f, h, w]` at
/// the N pixels of an item's `mask`. This is the paper's formula (Eigen et al. 2014 with lambda = 1/2).
pub fn log_depth(a: Tensor<5>, b: Tensor<5>, mask: Tensor<5>) -> Tensor<1> {
    let items = a.dims()[0];
    let flat = |x: Tensor<5>| x.reshape([items as i32, -1]);
    let (d, mask) = (flat((a - b) * mask.clone()), flat(mask));
    let count = mask.sum_dim(1).clamp_min(1.0);
    let squares = (d.clone() * d.clone()).sum_dim(1) / count.clone();
    let mean = d.sum_dim(1) / count;
    (squares - (mean.clone() * mean).mul_scalar(0.5)).mean()
}

fn masked_mean(x: Tensor<5>, mask: Tensor<5>) -> Tensor<1> {
    let count = mask.clone().sum().clamp_min(1.0);
    (x * mask).sum() / count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::to_vec;
    use burn::tensor::{Device, TensorData};

    fn picture(values: &[f32], shape: [usize; 5]) -> Tensor<5> {
        Tensor::from_data(TensorData::new(values.to_vec(), shape), &Device::flex().autodiff())
    }

    fn number(x: Tensor<1>) -> f32 {
        to_vec(x.without_autodiff())[0]
    }

    #[test]
    fn gradients_of_pictures_follow_their_definition() {
        let (h, w) = (4, 5);
        let at = |x: usize, y: usize| (x as f32 * 0.3).sin() + (y as f32 * 0.7).cos();
        let values: Vec<f32> = (0..h * w).map(|i| at(i % w, i / w)).collect();
        let flat = picture(&vec![0.5; h * w], [1, 1, 1, h, w]);
        let mut sum = 0.0;
        for y in 1..h - 1 {
            for x in 1..w - 1 {
                let (gx, gy) = (at(x + 1, y) - at(x - 1, y), at(x, y + 1) - at(x, y - 1));
                sum += (gx * gx + gy * gy + 1e-6).sqrt() - 1e-3;
            }
        }
        let expected = sum / ((h - 2) * (w - 2)) as f32;
        let found = number(gradient(picture(&values, [1, 1, 1, h, w]), flat));
        assert!((found - expected).abs() < 1e-6, "{found} instead of {expected}");
        assert_eq!(number(gradient(picture(&values[..8], [1, 1, 1, 2, 4]), picture(&values[..8], [1, 1, 1, 2, 4]))), 0.0);
    }

    #[test]
    fn losses_of_intrinsics_follow_their_definitions() {
        let mask = picture(&[1.0, 1.0, 0.0], [1, 1, 1, 1, 3]);
        // Channels are planes: pixel vectors (1,0,0), (0,1,0), (0,0,1) against (1,0,0), (1,0,0), (1,0,0).
        let a = picture(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [1, 3, 1, 1, 3]);
        let b = picture(&[1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [1, 3, 1, 1, 3]);
        assert!((number(angle(a.clone(), b.clone(), mask.clone())) - 0.5).abs() < 1e-5);
        assert!((number(masked_absolute(a.clone(), b, mask.clone())) - 1.0 / 3.0).abs() < 1e-6);
        let (d, zero) = (picture(&[0.4, 0.2, 9.0], [1, 1, 1, 1, 3]), picture(&[0.0; 3], [1, 1, 1, 1, 3]));
        let expected = (0.16 + 0.04) / 2.0 - 0.36 / 8.0;
        assert!((number(log_depth(d, zero.clone(), mask.clone())) - expected).abs() < 1e-6);
        assert!((number(divergence(zero.clone().add_scalar(2.0), zero.clone())) - 2.0).abs() < 1e-6);
        // An empty mask and zero vectors still give a number and a gradient.
        let nothing = mask.mul_scalar(0.0);
        let x = a.mul_scalar(0.0).require_grad();
        let loss = angle(x.clone(), x.clone(), nothing.clone()) + angle(x.clone(), x.clone(), nothing.clone().add_scalar(1.0));
        let loss = loss + log_depth(x.clone().narrow(1, 0, 1), zero, nothing) + gradient(x.clone(), x.clone());
        let slopes = to_vec(x.grad(&loss.backward()).expect("depends on x"));
        assert!(slopes.iter().all(|s| s.is_finite()), "{slopes:?}");
    }
}
