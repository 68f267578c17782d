//! The operations of [`crate::ops`] composed of burn's own, for every device and element type.
use super::norm::LEAST_SQUARE;
use super::options::{Products, Stride};
use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, FloatDType, Tensor, activation, module};

/// The type of the factors of a convolution on a device: bf16 where that is wanted and the device computes in it.
pub fn factors(products: Products, device: &Device) -> FloatDType {
    // On the processor, this type would only be converted to f32 and back.
    let half = products == Products::Bf16 && !super::is_cpu(device) && device.supports_dtype(FloatDType::BF16);
    if half { FloatDType::BF16 } else { FloatDType::F32 }
}

/// See [`crate::ops::conv`]. With factors in bf16, the sums are rounded to it too, and bias and SiLU are in f32.
pub fn conv(x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, stride: Stride, silu: bool, factors: FloatDType) -> Tensor<4> {
    let x = match stride {
        Stride::Up => up2(x),
        Stride::Half => beside_zeros(x),
        _ => x,
    };
    let step = if matches!(stride, Stride::Two | Stride::Half) { 2 } else { 1 };
    let half = if stride == Stride::Half { 0 } else { w.dims()[0] / 2 };
    let options = ConvOptions::new([step, step], [half, half], [1, 1], 1);
    let (x, w) = (x.permute([0, 3, 1, 2]), w.permute([3, 2, 0, 1]));
    let y = if factors == FloatDType::F32 {
        module::conv2d(x, w, Some(b), options).permute([0, 2, 3, 1])
    } else {
        let channels = b.dims()[0];
        module::conv2d(x.cast(factors), w.cast(factors), None, options).permute([0, 2, 3, 1]).cast(FloatDType::F32)
            + b.reshape([1, 1, 1, channels])
    };
    if silu { activation::silu(y) } else { y }
}

/// See [`crate::ops::conv_over_time`]. The frames under the taps stand side by side as channels.
pub fn conv_over_time(x: Tensor<5>, w: Tensor<5>, b: Tensor<1>, step: usize, newest: usize) -> Tensor<5> {
    let ([batch, t, height, width, ci], [k, _, taps, _, co]) = (x.dims(), w.dims());
    let frames = (t - 1 - newest) / step + 1;
    let before = Tensor::zeros([batch, taps - 1, height, width, ci], &x.device());
    let x = Tensor::cat(vec![before, x], 1);
    let window = |tap: usize| Tensor::cat((0..frames).map(|i| x.clone().narrow(1, newest + i * step + tap, 1)).collect(), 1);
    let pictures = Tensor::cat((0..taps).map(window).collect(), 4).reshape([batch * frames, height, width, taps * ci]);
    let w = w.reshape([k, k, taps * ci, co]);
    conv(pictures, w, b, Stride::One, false, FloatDType::F32).reshape([batch, frames, height, width, co])
}

/// See [`crate::ops::decode`].
pub fn decode(x: Tensor<4>, skip: Tensor<4>, w: Tensor<4>, b: Tensor<1>, factors: FloatDType) -> Tensor<4> {
    conv(Tensor::cat(vec![up2(x), skip], 3), w, b, Stride::One, true, factors)
}

/// See [`crate::ops::linear`].
pub fn linear(x: Tensor<3>, w: Tensor<2>, b: Tensor<1>, silu: bool) -> Tensor<3> {
    let ([batch, n, ci], co) = (x.dims(), w.dims()[1]);
    let y = x.reshape([batch * n, ci]).matmul(w).add(b.reshape([1, co])).reshape([batch, n, co]);
    if silu { activation::silu(y) } else { y }
}

/// See [`crate::ops::attention`].
pub fn attention(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>, heads: usize) -> Tensor<3> {
    let [batch, n, channels] = q.dims();
    let width = channels / heads;
    let split = |t: Tensor<3>| {
        let tokens = t.dims()[1];
        t.reshape([batch, tokens, heads, width]).swap_dims(1, 2)
    };
    let scores = split(q).matmul(split(k).swap_dims(2, 3)).mul_scalar(1.0 / (width as f32).sqrt());
    activation::softmax(scores, 3).matmul(split(v)).swap_dims(1, 2).reshape([batch, n, channels])
}

/// See [`crate::ops::channel_norm`].
pub fn channel_norm<const D: usize>(x: Tensor<D>, gamma: Tensor<1>, silu: bool) -> Tensor<D> {
    let channels = x.dims()[D - 1];
    let length = (x.clone() * x.clone()).sum_dim(D - 1).clamp_min(LEAST_SQUARE).sqrt();
    let mut shape = [1; D];
    shape[D - 1] = channels;
    let y = x * length.recip() * gamma.mul_scalar((channels as f32).sqrt()).reshape(shape);
    if silu { activation::silu(y) } else { y }
}

/// See [`crate::ops::rms_norm`].
pub fn rms_norm(x: Tensor<3>, gamma: Tensor<1>, eps: f32) -> Tensor<3> {
    let channels = x.dims()[2];
    let inverse = (x.clone() * x.clone()).mean_dim(2).add_scalar(eps).sqrt().recip();
    x * inverse * gamma.reshape([1, 1, channels])
}

/// See [`crate::ops::modulate`].
pub fn modulate(x: Tensor<3>, factor: Tensor<3>, shift: Tensor<3>, eps: Option<f32>) -> Tensor<3> {
    let ([b, n, c], [.., groups, _]) = (x.dims(), factor.dims());
    let x = match eps {
        Some(eps) => {
            let x = x.clone() - x.mean_dim(2);
            let variance = (x.clone() * x.clone()).mean_dim(2);
            x * variance.add_scalar(eps).sqrt().recip()
        }
        None => x,
    };
    let of = |t: Tensor<3>| t.reshape([b, groups, 1, c]);
    (x.reshape([b, groups, n / groups, c]) * of(factor) + of(shift)).reshape([b, n, c])
}

/// See [`crate::ops::gate`].
pub fn gate(x: Tensor<3>, y: Tensor<3>, gate: Tensor<3>) -> Tensor<3> {
    x + y * gate
}

/// See [`crate::ops::turn`].
pub fn turn(x: Tensor<3>, cos: Tensor<2>, sin: Tensor<2>) -> Tensor<3> {
    let ([b, n, c], [_, pairs]) = (x.dims(), cos.dims());
    let of = |t: Tensor<2>| t.reshape([1, n, 1, pairs, 1]);
    let (cos, sin) = (of(cos), of(sin));
    let x = x.reshape([b, n, c / pairs / 2, pairs, 2]);
    let (first, second) = (x.clone().narrow(4, 0, 1), x.narrow(4, 1, 1));
    let turned_first = first.clone() * cos.clone() - second.clone() * sin.clone();
    let turned_second = first * sin + second * cos;
    Tensor::cat(vec![turned_first, turned_second], 4).reshape([b, n, c])
}

/// See [`crate::ops::gelu`].
pub fn gelu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    // (1 + tanh u) / 2 is the sigmoid of 2 u, which takes a quarter of the time here and loses no digits below zero.
    const SCALE: f32 = 2.0 * std::f32::consts::FRAC_2_SQRT_PI * std::f32::consts::FRAC_1_SQRT_2;
    let twice = (x.clone() * x.clone()).mul_scalar(0.044_715 * SCALE).add_scalar(SCALE) * x.clone();
    x * activation::sigmoid(twice)
}

/// `[b, h, w, c]` to `[b, h + 1, w + 1, c]`, with zeros on the right and below.
fn beside_zeros(x: Tensor<4>) -> Tensor<4> {
    let ([b, h, w, c], device) = (x.dims(), x.device());
    let x = Tensor::cat(vec![x, Tensor::zeros([b, 1, w, c], &device)], 1);
    Tensor::cat(vec![x, Tensor::zeros([b, h + 1, 1, c], &device)], 2)
}

/// `[b, h, w, c]` to `[b, 2h, 2w, c]`, each pixel repeated 2 x 2 times.
pub fn up2(x: Tensor<4>) -> Tensor<4> {
    let [b, h, w, c] = x.dims();
    x.reshape([b, h, 1, w, 1, c]).expand([b, h, 2, w, 2, c]).reshape([b, 2 * h, 2 * w, c])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Factors in bf16 have 8 bits, and so have sums. Gradients reach every input in single precision.
    #[test]
    fn bf16_stays_close() {
        let device = Device::flex().autodiff();
        let wave = |n: usize, phase: f32| (0..n).map(|i| (i as f32 * 0.7 + phase).sin()).collect::<Vec<f32>>();
        let tensor = |shape: [usize; 4], phase| {
            Tensor::<1>::from_data(wave(shape.iter().product(), phase).as_slice(), &device).reshape(shape).detach().require_grad()
        };
        for (stride, k) in [(Stride::One, 3), (Stride::Two, 3), (Stride::Half, 3), (Stride::Up, 3), (Stride::One, 1)] {
            let run = |factors: FloatDType| {
                let (x, w) = (tensor([2, 8, 6, 5], 0.0), tensor([k, k, 5, 4], 0.3));
                let b = Tensor::<1>::from_data(wave(4, 0.9).as_slice(), &device).require_grad();
                let y = conv(x.clone(), w.clone(), b.clone(), stride, true, factors);
                let mut gradients = (y.clone() * y.clone()).sum().backward();
                let all = [
                    y.without_autodiff().flatten(0, 3),
                    x.grad_remove(&mut gradients).expect("a gradient").flatten(0, 3),
                    w.grad_remove(&mut gradients).expect("a gradient").flatten(0, 3),
                    b.grad_remove(&mut gradients).expect("a gradient"),
                ];
                all.map(|values: Tensor<1>| crate::parameters::to_vec(values))
            };
            let (exact, half) = (run(FloatDType::F32), run(FloatDType::BF16));
            for (exact, half) in exact.iter().zip(&half) {
                let largest = exact.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                let far = exact.iter().zip(half).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
                assert!(far < 0.03 * largest && far > 1e-6 * largest, "{stride:?}: {far} of {largest}");
            }
        }
        assert_eq!(factors(Products::Bf16, &device), FloatDType::F32);
    }
}
