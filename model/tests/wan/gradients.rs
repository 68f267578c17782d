//! Gradients against finite differences.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use renderflow_model::parameters::{self, to_vec};

/// Values of about one without a pattern.
pub fn waves(count: usize, seed: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * 0.7391 + seed).sin() + (i as f32 * 0.137 * seed).cos()).collect()
}

pub fn tensor<const D: usize>(shape: [usize; D], seed: f32, device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(waves(shape.iter().product(), seed), shape), device)
}

/// A number that depends on every value of `x`.
pub fn weighed<const D: usize>(x: Tensor<D>) -> Tensor<1> {
    let weights = tensor(x.dims(), 0.31, &x.device());
    (x * weights).mean()
}

/// Compares the slope along one direction in each tensor.
pub fn compare<M: Module>(network: M, device: &Device, loss: impl Fn(&M) -> Tensor<1>) {
    let mut found = loss(&network).backward();
    let gradients = parameters::gradients(&network, &mut found).expect("gradients");
    let start = parameters::export(&network);
    let at = |which: usize, values: &[f32]| {
        let all: Vec<&[f32]> =
            start.iter().enumerate().map(|(i, p)| if i == which { values } else { p.values.as_slice() }).collect();
        f64::from(to_vec(loss(&parameters::import(network.clone(), &all, device)).without_autodiff())[0])
    };
    // Differences of a loss of about one are known to about 1e-6 / step.
    let mut worst = 0.0f64;
    for (i, (parameter, gradient)) in start.iter().zip(&gradients).enumerate() {
        let gradient = gradient.as_ref().unwrap_or_else(|| panic!("{} has no gradient", parameter.name));
        assert!(gradient.iter().all(|g| g.is_finite()), "{}", parameter.name);
        let length = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        assert!(length > 0.0, "{} has no influence", parameter.name);
        // Along the gradient, where the slope is largest, with a little of everything else.
        let direction: Vec<f32> =
            gradient.iter().zip(waves(gradient.len(), 0.77)).map(|(g, w)| g / length as f32 + 0.02 * w).collect();
        let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
        let moved = |step: f32| parameter.values.iter().zip(&direction).map(|(v, d)| v + step * d).collect::<Vec<_>>();
        let step = 1e-2;
        let difference = (at(i, &moved(step)) - at(i, &moved(-step))) / (2.0 * f64::from(step));
        let error = (difference - slope).abs() / (slope.abs() + 2e-3);
        worst = worst.max(error);
        assert!(error < 0.03, "{}: slope {slope:.3e}, by differences {difference:.3e}", parameter.name);
    }
    println!("{} tensors, largest relative error {worst:.1e}", start.len());
}
