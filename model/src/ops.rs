//! The operations of both networks, on channels-last tensors.
//!
//! Pictures are `[batch, height, width, channels]` (NHWC), sequences `[batch, tokens, channels]`, convolution weights
//! `[k, k, channels in, channels out]` (HWIO). Everything is differentiable with respect to every tensor.
//! On the CPU in f32, [`crate::kernels`] compute them. Other devices and element types use compositions of burn's own operations
//! ([`crate::kernels::portable`]). Both return the same numbers up to rounding.
pub use crate::kernels::options::{Products, Stride};

use crate::kernels::{self, portable};
use burn::tensor::Tensor;

/// [`conv`] with a choice of products.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn conv_by(products: Products, x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, stride: Stride, silu: bool) -> Tensor<4> {
    check_conv("conv", x.dims(), w.dims(), b.dims());
    assert!(stride != Stride::Half || w.dims()[0] == 3, "conv: half the size needs a kernel of 3 x 3");
    if kernels::fits(&x.device(), &[x.dtype(), w.dtype(), b.dtype()]) {
        kernels::conv(x, w, b, stride, silu, products)
    } else {
        let factors = portable::factors(products, &x.device());
        portable::conv(x, w, b, stride, silu, factors)
    }
}

/// Convolution with zero padding of `k / 2`, and SiLU after it if `silu`.
///
/// `x` `[b, h, w, ci]`, `w` `[k, k, ci, co]` with `k` 1 or 3, `b` `[co]`; the result is `[b, stride.output(h), stride.output(w),
/// co]`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn conv(x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, stride: Stride, silu: bool) -> Tensor<4> {
    conv_by(Products::F32, x, w, b, stride, silu)
}

/// Convolution over time and space of the frames of clips. Frame i of the result sees frame `newest + i step` and the two before
/// it, with zeros before the first frame. In space it is [`conv`] with [`Stride::One`].
///
/// `x` `[b, t, h, w, ci]`, `w` `[k, k, 3, ci, co]` with `k` 1 or 3 and the newest frame last, `b` `[co]`; the result is
/// `[b, (t - 1 - newest) / step + 1, h, w, co]`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn conv_over_time(x: Tensor<5>, w: Tensor<5>, b: Tensor<1>, step: usize, newest: usize) -> Tensor<5> {
    let ([batch, frames, height, width, ci], [k, k2, taps, wi, co]) = (x.dims(), w.dims());
    check_conv("convolution over time", [batch, height, width, ci], [k, k2, wi, co], b.dims());
    assert!(
        taps == 3 && step > 0 && newest < frames,
        "convolution over time: {taps} taps, step {step}, frame {newest} of {frames}"
    );
    if kernels::fits(&x.device(), &[x.dtype(), w.dtype(), b.dtype()]) {
        kernels::conv_over_time(x, w, b, step, newest)
    } else {
        portable::conv_over_time(x, w, b, step, newest)
    }
}

/// First layer of a decoder stage: `silu(conv3x3(concat(up2(x), skip)))`, where `up2` repeats each pixel 2 x 2 times.
///
/// `x` `[b, h, w, cu]`, `skip` `[b, 2h, 2w, cs]`, `w` `[3, 3, cu + cs, co]`, `b` `[co]`; the result is `[b, 2h, 2w, co]`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn decode(products: Products, x: Tensor<4>, skip: Tensor<4>, w: Tensor<4>, b: Tensor<1>) -> Tensor<4> {
    let ([batch, height, width, cu], [sb, sh, sw, cs]) = (x.dims(), skip.dims());
    assert!([sb, sh, sw] == [batch, 2 * height, 2 * width], "decode: skip {:?} is not twice {:?}", skip.dims(), x.dims());
    check_conv("decode", [batch, sh, sw, cu + cs], w.dims(), b.dims());
    assert!(w.dims()[0] == 3, "decode: weights {:?} are not 3 x 3", w.dims());
    if kernels::fits(&x.device(), &[x.dtype(), skip.dtype(), w.dtype(), b.dtype()]) {
        kernels::decode(x, skip, w, b, products)
    } else {
        let factors = portable::factors(products, &x.device());
        portable::decode(x, skip, w, b, factors)
    }
}

/// `x w + b`, and SiLU after it if `silu`. `x` `[b, n, ci]`, `w` `[ci, co]`, `b` `[co]`; the result is `[b, n, co]`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn linear(x: Tensor<3>, w: Tensor<2>, b: Tensor<1>, silu: bool) -> Tensor<3> {
    let ([batch, n, _], [ci, co]) = (x.dims(), w.dims());
    check_conv("linear", [batch, 1, n, x.dims()[2]], [1, 1, ci, co], b.dims());
    if kernels::fits(&x.device(), &[x.dtype(), w.dtype(), b.dtype()]) {
        let pixels = x.reshape([batch, 1, n, ci]);
        kernels::conv(pixels, w.reshape([1, 1, ci, co]), b, Stride::One, silu, Products::F32).reshape([batch, n, co])
    } else {
        portable::linear(x, w, b, silu)
    }
}

/// Scaled dot-product attention (Vaswani et al. 2017) over `heads` equal slices of the channels.
///
/// `q` `[b, n, c]`, `k` and `v` `[b, m, c]`, `c` a multiple of `heads`; the result is `[b, n, c]`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn attention(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>, heads: usize) -> Tensor<3> {
    let ([batch, _, channels], [kb, m, kc]) = (q.dims(), k.dims());
    assert!(
        kb == batch && kc == channels && v.dims() == [kb, m, kc],
        "attention: {:?}, {:?}, {:?}",
        q.dims(),
        k.dims(),
        v.dims()
    );
    assert!(heads > 0 && channels > 0 && channels % heads == 0, "attention: {channels} channels in {heads} heads");
    if m > 0 && kernels::fits(&q.device(), &[q.dtype(), k.dtype(), v.dtype()]) {
        kernels::attention(q, k, v, heads)
    } else {
        portable::attention(q, k, v, heads)
    }
}

/// Divides the channels of a pixel by their Euclidean norm, multiplies by `sqrt(c)` and a factor per channel, and applies SiLU if
/// `silu`.
///
/// `x` `[.., c]` with `c` > 0, `gamma` `[c]`; the result has the shape of `x`. A pixel of zeros stays 0.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn channel_norm<const D: usize>(x: Tensor<D>, gamma: Tensor<1>, silu: bool) -> Tensor<D> {
    let (channels, factors) = (x.dims()[D - 1], gamma.dims()[0]);
    assert!(channels > 0 && channels == factors, "channel norm: {channels} channels and {factors} factors");
    if kernels::fits(&x.device(), &[x.dtype(), gamma.dtype()]) {
        kernels::channel_norm(x, gamma, silu)
    } else {
        portable::channel_norm(x, gamma, silu)
    }
}

/// Divides a token by the root mean square of its channels, and multiplies by a factor per channel (Zhang and Sennrich 2019).
///
/// `x` `[b, n, c]` with `c` > 0, `gamma` `[c]`, `eps` added to the mean square; the result has the shape of `x`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn rms_norm(x: Tensor<3>, gamma: Tensor<1>, eps: f32) -> Tensor<3> {
    let (channels, factors) = (x.dims()[2], gamma.dims()[0]);
    assert!(channels > 0 && channels == factors, "norm: {channels} channels and {factors} factors");
    if kernels::fits(&x.device(), &[x.dtype(), gamma.dtype()]) {
        kernels::rms_norm(x, gamma, eps)
    } else {
        portable::rms_norm(x, gamma, eps)
    }
}

/// `factor x + shift`. With `eps`, x is first layer-normalised (Ba et al. 2016) with `eps` added to the variance.
///
/// `x` `[b, n, c]`, `factor` and `shift` `[b, g, c]`, each for `n / g` consecutive tokens; the result has the shape of `x`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn modulate(x: Tensor<3>, factor: Tensor<3>, shift: Tensor<3>, eps: Option<f32>) -> Tensor<3> {
    let ([b, n, c], [fb, groups, fc]) = (x.dims(), factor.dims());
    let fits = [fb, fc] == [b, c] && shift.dims() == factor.dims() && c > 0 && groups > 0 && n % groups == 0;
    assert!(fits, "modulation: {:?}, {:?}, {:?}", x.dims(), factor.dims(), shift.dims());
    if n > 0 && kernels::fits(&x.device(), &[x.dtype(), factor.dtype(), shift.dtype()]) {
        kernels::modulate(x, factor, shift, eps)
    } else {
        portable::modulate(x, factor, shift, eps)
    }
}

/// `x + y gate`. `x` and `y` `[b, n, c]`, `gate` `[b, 1, c]`; the result has the shape of `x`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn gate(x: Tensor<3>, y: Tensor<3>, gate: Tensor<3>) -> Tensor<3> {
    let [b, n, c] = x.dims();
    assert!(y.dims() == [b, n, c] && gate.dims() == [b, 1, c], "gate: {:?}, {:?}, {:?}", x.dims(), y.dims(), gate.dims());
    if n * c > 0 && kernels::fits(&x.device(), &[x.dtype(), y.dtype(), gate.dtype()]) {
        kernels::gate(x, y, gate)
    } else {
        portable::gate(x, y, gate)
    }
}

/// Rotates pairs of neighbouring channels (Su et al. 2021): `(a, b)` becomes `(a cos - b sin, a sin + b cos)`.
///
/// `x` `[b, n, c]`, whose channels are heads of p pairs; `cos` and `sin` `[n, p]`, the same for all heads and not differentiated.
/// The result has the shape of `x`.
///
/// # Panics
/// When the shapes do not fit each other.
pub fn turn(x: Tensor<3>, cos: Tensor<2>, sin: Tensor<2>) -> Tensor<3> {
    let ([_, n, c], [rows, pairs]) = (x.dims(), cos.dims());
    let fits = rows == n && sin.dims() == cos.dims() && pairs > 0 && c % (2 * pairs) == 0;
    assert!(fits, "turn: {:?}, {:?}, {:?}", x.dims(), cos.dims(), sin.dims());
    if n * c > 0 && kernels::fits(&x.device(), &[x.dtype(), cos.dtype(), sin.dtype()]) {
        kernels::turn(x, cos, sin)
    } else {
        portable::turn(x, cos, sin)
    }
}

/// `x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2` of every value (Hendrycks and Gimpel 2016).
pub fn gelu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    if kernels::fits(&x.device(), &[x.dtype()]) { kernels::gelu(x) } else { portable::gelu(x) }
}

fn check_conv(name: &str, x: [usize; 4], w: [usize; 4], b: [usize; 1]) {
    assert!(matches!(w[0], 1 | 3) && w[1] == w[0], "{name}: weights {w:?} are neither 1 x 1 nor 3 x 3");
    assert!(w[2] == x[3] && w[3] == b[0] && w[2] > 0 && w[3] > 0, "{name}: input {x:?}, weights {w:?} and bias {b:?} do not fit");
}
