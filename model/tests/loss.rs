//! The fused loss and its hand-written gradient against the same objective composed of burn's operations and differentiated by burn.

use burn::tensor::{Device, Tensor, TensorData};
use rand::RngExt;
use renderflow_model::bridge::MAX_RADIANCE;
use renderflow_model::config::{Curve, Start};
use renderflow_model::data::{BASE_CHANNELS, Batch, step_rng};
use renderflow_model::network::shuffle;
use renderflow_model::parameters::to_vec;
use renderflow_model::train::loss::{Loss, LossWeights, base, direct, predict};

const SIZE: usize = 8;
const ITEMS: usize = 2;

/// Random pictures with holes in the mask; radiance from dark to above display white.
fn batch() -> Batch {
    let mut rng = step_rng(5, 5);
    let pixels = ITEMS * SIZE * SIZE;
    let mut batch = Batch { items: ITEMS, size: SIZE, ..Batch::default() };
    for _ in 0..pixels {
        batch.mask.push(if rng.random::<f32>() < 0.8 { 1.0 } else { 0.0 });
        batch.alpha.push(rng.random());
        for c in 0..BASE_CHANNELS {
            let value: f32 = rng.random();
            batch.base.push(if c >= 12 { 2.0 * value - 1.0 } else { 0.6 * value * value });
        }
        for c in 0..6 {
            batch.target.push(if c < 3 { 2.4 * rng.random::<f32>() - 1.0 } else { rng.random() });
        }
    }
    batch
}

fn random(count: usize) -> Vec<f32> {
    let mut rng = step_rng(6, 6);
    (0..count).map(|_| 1.6 * rng.random::<f32>() - 0.8).collect()
}

fn picture(values: &[f32], channels: usize, device: &Device) -> Tensor<4> {
    Tensor::from_data(TensorData::new(values.to_vec(), [ITEMS, SIZE, SIZE, channels]), device)
}

fn srgb(x: Tensor<4>) -> Tensor<4> {
    let power = x.clone().clamp_min(0.003_130_8).powf_scalar(1.0 / 2.4).mul_scalar(1.055).sub_scalar(0.055);
    power.mask_where(x.clone().lower_equal_scalar(0.003_130_8), x.mul_scalar(12.92))
}

fn encode(curve: Curve, x: Tensor<4>) -> Tensor<4> {
    match curve {
        Curve::Log => x.mul_scalar(8.0).log1p().mul_scalar(2.0 / 9f32.ln()).sub_scalar(1.0),
        Curve::Srgb => srgb(x).mul_scalar(2.0).sub_scalar(1.0),
    }
}

fn decode(curve: Curve, z: Tensor<4>) -> Tensor<4> {
    let x = match curve {
        Curve::Log => z.add_scalar(1.0).mul_scalar(0.5 * 9f32.ln()).exp().sub_scalar(1.0).mul_scalar(0.125),
        Curve::Srgb => {
            let s = z.add_scalar(1.0).mul_scalar(0.5);
            let power = s.clone().clamp_min(0.040_45).add_scalar(0.055).div_scalar(1.055).powf_scalar(2.4);
            power.mask_where(s.clone().lower_equal_scalar(0.040_45), s.div_scalar(12.92))
        }
    };
    x.clamp(0.0, MAX_RADIANCE)
}

/// The documented objective, in burn's operations.
fn reference(z: Tensor<4>, x: Tensor<4>, batch: &Batch, weights: LossWeights) -> Tensor<1> {
    let device = z.device();
    let target = picture(&batch.target, 6, &device);
    let mask = picture(&batch.mask, 1, &device);
    let mean = |picture: Tensor<4>, mask: Tensor<4>| (picture * mask.clone()).sum() / mask.sum().mul_scalar(3.0);
    let bridge = mean((z - target.clone().narrow(3, 0, 3)).square(), mask.clone());
    let error = srgb(x.clamp(0.0, 1.0)) - target.narrow(3, 3, 3);
    let along = |dim: usize| {
        let difference = error.clone().narrow(dim, 1, SIZE - 1) - error.clone().narrow(dim, 0, SIZE - 1);
        mean(difference.abs(), mask.clone().narrow(dim, 1, SIZE - 1) * mask.clone().narrow(dim, 0, SIZE - 1))
    };
    let gradient = along(1) + along(2);
    bridge + mean(error.square(), mask).mul_scalar(weights.display) + gradient.mul_scalar(weights.gradient)
}

fn compare(name: &str, (loss, gradient): (Loss, Vec<f32>), expected: Tensor<1>, source: Tensor<4>) {
    let mut gradients = expected.backward();
    let value = to_vec(expected.without_autodiff())[0];
    assert!((loss.total - value).abs() < 1e-5 * value, "{name}: loss {} instead of {value}", loss.total);
    let expected = to_vec(source.grad_remove(&mut gradients).unwrap());
    let largest = expected.iter().fold(0.0f32, |a, b| a.max(b.abs()));
    assert!(largest > 1e-4);
    for (i, (a, b)) in gradient.iter().zip(&expected).enumerate() {
        assert!((a - b).abs() < 1e-4 * largest, "{name}: gradient {i} is {a} instead of {b} (largest {largest})");
    }
}

#[test]
fn base_loss_equals_automatic_differentiation() {
    let (device, batch, weights) = (Device::flex().autodiff(), batch(), LossWeights { display: 3.0, gradient: 0.7 });
    for curve in [Curve::Log, Curve::Srgb] {
        for start in [Start::Ibl, Start::Albedo] {
            let values = random(ITEMS * SIZE * SIZE * start.head_channels());
            let shape = [ITEMS, SIZE / 2, SIZE / 2, 4 * start.head_channels()];
            let outputs = Tensor::<4>::from_data(TensorData::new(values.clone(), shape), &device).require_grad();
            let heads = shuffle(outputs.clone());
            let base_tensor = picture(&batch.base, BASE_CHANNELS, &device);
            let part = |i: usize| base_tensor.clone().narrow(3, 3 * i, 3);
            let (z, x) = match start {
                Start::Ibl => {
                    let factor = |from: usize| heads.clone().narrow(3, from, 3).exp();
                    let x = part(0) * factor(0) + part(1) * factor(3) + part(2) * heads.clone().narrow(3, 6, 3) + part(3);
                    let x = x.clamp_min(0.0);
                    (encode(curve, x.clone()), x)
                }
                _ => {
                    let z = part(4) + heads * picture(&batch.alpha, 1, &device);
                    (z.clone(), decode(curve, z))
                }
            };
            let predicted = predict(start, curve, &values, &batch);
            for (a, b) in predicted.iter().zip(to_vec(z.clone().without_autodiff())) {
                assert!((a - b).abs() < 1e-5, "prediction {a} instead of {b}");
            }
            compare(
                &format!("{start:?} {curve:?}"),
                base(start, curve, &values, &batch, weights),
                reference(z, x, &batch, weights),
                outputs,
            );
        }
    }
}

#[test]
fn direct_loss_equals_automatic_differentiation() {
    let (device, batch, weights) = (Device::flex().autodiff(), batch(), LossWeights::default());
    for curve in [Curve::Log, Curve::Srgb] {
        let values: Vec<f32> = random(ITEMS * SIZE * SIZE * 3).iter().map(|v| 1.4 * v).collect();
        let z = picture(&values, 3, &device).require_grad();
        let expected = reference(z.clone(), decode(curve, z.clone()), &batch, weights);
        compare(&format!("{curve:?}"), direct(curve, &values, &batch, weights), expected, z);
    }
}

#[test]
fn uncovered_pixels_do_not_count() {
    let mut first = batch();
    let values = random(ITEMS * SIZE * SIZE * 9);
    let score = |batch: &Batch| base(Start::Ibl, Curve::Log, &values, batch, LossWeights::default());
    let before = score(&first);
    for i in (0..first.mask.len()).filter(|&i| first.mask[i] == 0.0).collect::<Vec<_>>() {
        first.base[i * BASE_CHANNELS] = 50.0;
        first.target[6 * i] = 7.0;
    }
    assert_eq!(before, score(&first));
    first.mask.fill(0.0);
    let (loss, gradient) = score(&first);
    assert_eq!(loss.total, 0.0);
    assert!(gradient.iter().all(|g| *g == 0.0));
}
