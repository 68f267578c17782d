//! The kernels as operations of burn's CPU backend, with their gradients.
use super::Kernel;
use super::attention::{Attention, Inputs};
use super::convolve::{Convolution, Time, Wanted};
use super::gather::{Finish, Size};
use super::norm::ChannelNorm;
use super::options::{Products, Stride};
use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients as Tape;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Bytes, DType, Shape, Tensor};
use burn_flex::{FlexTensor, Layout};

/// Runs an expression with the [`Tile`] of the kernel in use.
macro_rules! with_tile {
    ($tile:ident => $call:expr) => {
        match Kernel::active() {
            #[cfg(target_arch = "x86_64")]
            Some(Kernel::Avx512($tile)) => $call,
            #[cfg(target_arch = "x86_64")]
            Some(Kernel::Avx2($tile)) => $call,
            _ => {
                let $tile = $crate::kernels::tile::Scalar;
                $call
            }
        }
    };
}

pub(super) use with_tile;

/// [`with_tile`] for a convolution. It uses bf16 if that is requested, the processor has it, and the numbers of channels are
/// even.
macro_rules! with_tile_for {
    ($convolution:ident, $products:expr, $tile:ident => $call:expr) => {{
        let paired = $products == Products::Bf16 && $convolution.fits(2);
        #[cfg(target_arch = "x86_64")]
        let (matrices, vectors) = (super::amx().filter(|_| paired), super::bf16().filter(|_| paired));
        #[cfg(not(target_arch = "x86_64"))]
        let (matrices, vectors): (Option<super::tile::Scalar>, Option<super::tile::Scalar>) = (None, None);
        match (matrices, vectors) {
            (Some($tile), _) => $call,
            (None, Some($tile)) => $call,
            (None, None) => with_tile!($tile => $call),
        }
    }};
}

/// An operation without its tensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    stride: Stride,
    /// Whether there is a second picture.
    decode: bool,
    silu: bool,
    /// Given if the pictures are frames of clips.
    time: Option<Time>,
    products: Products,
}

/// A backward pass: the operation, and the gradients that are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BackwardTask {
    kind: Kind,
    wanted: Wanted,
}

/// Convolutions on channels-last tensors, attention and channel normalisation. Pictures, weights and bias as in [`crate::ops`].
#[backend_extension(Flex, Autodiff)]
pub trait CpuKernels: Backend {
    /// See [`crate::ops::conv`] and [`crate::ops::conv_over_time`]; differentiable.
    fn nhwc_conv(x: FloatTensor<Self>, w: FloatTensor<Self>, b: FloatTensor<Self>, kind: Kind) -> FloatTensor<Self>;

    /// See [`crate::ops::decode`]; differentiable.
    fn nhwc_decode(
        x: FloatTensor<Self>,
        skip: FloatTensor<Self>,
        w: FloatTensor<Self>,
        b: FloatTensor<Self>,
        kind: Kind,
    ) -> FloatTensor<Self>;

    /// See [`crate::ops::attention`]; differentiable.
    fn token_attention(q: FloatTensor<Self>, k: FloatTensor<Self>, v: FloatTensor<Self>, heads: usize) -> FloatTensor<Self>;

    /// Gradients of q, k and v.
    fn token_attention_backward(
        q: FloatTensor<Self>,
        k: FloatTensor<Self>,
        v: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        heads: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);

    /// See [`crate::ops::channel_norm`], and with `eps` [`crate::ops::rms_norm`]; differentiable.
    fn channel_norm(x: FloatTensor<Self>, gamma: FloatTensor<Self>, eps: Option<f32>, silu: bool) -> FloatTensor<Self>;

    /// Gradients of x and gamma.
    fn channel_norm_backward(
        x: FloatTensor<Self>,
        gamma: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        eps: Option<f32>,
        silu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);

    /// The activated output of either convolution, and the sums before the activation. `skip` is any tensor if there is no second
    /// picture.
    fn nhwc_with_sums(
        x: FloatTensor<Self>,
        skip: FloatTensor<Self>,
        w: FloatTensor<Self>,
        b: FloatTensor<Self>,
        kind: Kind,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);

    /// Gradients of x, skip, weights and bias of either; gradients that are not wanted are empty. `sums` is any tensor if there
    /// is no activation.
    #[allow(clippy::type_complexity)] // The extension macro returns tensors only in tuples.
    fn nhwc_backward(
        x: FloatTensor<Self>,
        skip: FloatTensor<Self>,
        w: FloatTensor<Self>,
        sums: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        task: BackwardTask,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);
}

/// [`crate::ops::conv`] by the kernels.
pub fn conv(x: Tensor<4>, w: Tensor<4>, b: Tensor<1>, stride: Stride, silu: bool, products: Products) -> Tensor<4> {
    let kind = Kind { stride, decode: false, silu, time: None, products };
    Tensor::from_dispatch(Dispatch::nhwc_conv(x.into_dispatch(), w.into_dispatch(), b.into_dispatch(), kind))
}

/// [`crate::ops::conv_over_time`] by the kernels.
pub fn conv_over_time(x: Tensor<5>, w: Tensor<5>, b: Tensor<1>, step: usize, newest: usize) -> Tensor<5> {
    let time = Some(Time { input: x.dims()[1], step, newest });
    let kind = Kind { stride: Stride::One, decode: false, silu: false, time, products: Products::F32 };
    Tensor::from_dispatch(Dispatch::nhwc_conv(x.into_dispatch(), w.into_dispatch(), b.into_dispatch(), kind))
}

/// [`crate::ops::decode`] by the kernels.
pub fn decode(x: Tensor<4>, skip: Tensor<4>, w: Tensor<4>, b: Tensor<1>, products: Products) -> Tensor<4> {
    let kind = Kind { stride: Stride::Up, decode: true, silu: true, time: None, products };
    let [x, skip, w, b] = [x.into_dispatch(), skip.into_dispatch(), w.into_dispatch(), b.into_dispatch()];
    Tensor::from_dispatch(Dispatch::nhwc_decode(x, skip, w, b, kind))
}

/// [`crate::ops::attention`] by the kernels.
pub fn attention(q: Tensor<3>, k: Tensor<3>, v: Tensor<3>, heads: usize) -> Tensor<3> {
    Tensor::from_dispatch(Dispatch::token_attention(q.into_dispatch(), k.into_dispatch(), v.into_dispatch(), heads))
}

/// [`crate::ops::channel_norm`] by the kernels.
pub fn channel_norm<const D: usize>(x: Tensor<D>, gamma: Tensor<1>, silu: bool) -> Tensor<D> {
    Tensor::from_dispatch(Dispatch::channel_norm(x.into_dispatch(), gamma.into_dispatch(), None, silu))
}

/// [`crate::ops::rms_norm`] by the kernels.
pub fn rms_norm(x: Tensor<3>, gamma: Tensor<1>, eps: f32) -> Tensor<3> {
    Tensor::from_dispatch(Dispatch::channel_norm(x.into_dispatch(), gamma.into_dispatch(), Some(eps), false))
}

pub(super) fn tensor(values: Vec<f32>, shape: Shape) -> FlexTensor {
    FlexTensor::new(Bytes::from_elems(values), Layout::contiguous(shape), DType::F32)
}

/// Floats of a contiguous tensor; [`super::fits`] lets only 32-bit floats come here.
pub(super) fn floats(t: &FlexTensor) -> &[f32] {
    t.as_slice::<f32>().expect("contiguous 32-bit floats")
}

/// Size of pictures `[batch, height, width, channels]`, or of the frames of clips `[batch, frames, height, width, channels]`.
fn size(t: &FlexTensor) -> Size {
    let shape = t.shape();
    let (batch, inner) = shape.split_at(shape.len() - 3);
    Size { batch: batch.iter().product(), height: inner[0], width: inner[1], channels: inner[2] }
}

/// A point-wise convolution sees no neighbours, so its pixels can be arranged in rows of a length that suits parallel work: the
/// pixels of all pictures together, or of each picture alone if they are `frames`.
fn regroup(size: Size, frames: bool) -> Size {
    let pictures = if frames { size.batch } else { 1 };
    let pixels = size.batch / pictures.max(1) * size.height * size.width;
    match (8..=128).rev().find(|width| pixels.is_multiple_of(*width)) {
        Some(width) => Size { batch: pictures, height: pixels / width, width, channels: size.channels },
        None => size,
    }
}

fn convolution<'a>(x: &'a FlexTensor, skip: &'a FlexTensor, w: &'a FlexTensor, kind: Kind) -> Convolution<'a> {
    let shape = w.shape();
    let (kernel, outputs) = (shape[0], shape[shape.len() - 1]);
    let pointwise = kernel == 1 && kind.stride == Stride::One;
    Convolution {
        x: floats(x),
        size: if pointwise { regroup(size(x), kind.time.is_some()) } else { size(x) },
        stride: kind.stride,
        skip: kind.decode.then(|| (floats(skip), size(skip))),
        time: kind.time,
        weights: floats(w),
        kernel,
        outputs,
    }
}

fn forward(
    x: FlexTensor,
    skip: FlexTensor,
    w: FlexTensor,
    b: FlexTensor,
    kind: Kind,
    finish: Finish,
) -> (FlexTensor, Option<FlexTensor>) {
    let [x, skip, w, b] = [x, skip, w, b].map(|t| t.to_contiguous());
    let convolution = convolution(&x, &skip, &w, kind);
    let mut out = x.shape();
    let axes = out.len();
    if let Some(time) = kind.time {
        out[axes - 4] = time.output();
    }
    out[axes - 3] = kind.stride.output(out[axes - 3]);
    out[axes - 2] = kind.stride.output(out[axes - 2]);
    out[axes - 1] = convolution.outputs;
    let (y, activated) = with_tile_for!(convolution, kind.products, tile => convolution.forward(tile, floats(&b), finish));
    (tensor(y, out.clone()), activated.map(|a| tensor(a, out)))
}

fn attention_of(q: &FlexTensor, k: &FlexTensor, heads: usize) -> Attention {
    let ([batch, queries, channels], [_, keys, _]) = (q.shape().dims(), k.shape().dims());
    Attention { batch, queries, keys, channels, heads }
}

impl CpuKernels for Flex {
    fn token_attention(q: FlexTensor, k: FlexTensor, v: FlexTensor, heads: usize) -> FlexTensor {
        let [q, k, v] = [q, k, v].map(|t| t.to_contiguous());
        let attention = attention_of(&q, &k, heads);
        tensor(with_tile!(tile => attention.forward(tile, Inputs { q: floats(&q), k: floats(&k), v: floats(&v) })), q.shape())
    }

    fn token_attention_backward(
        q: FlexTensor,
        k: FlexTensor,
        v: FlexTensor,
        gradient: FlexTensor,
        heads: usize,
    ) -> (FlexTensor, FlexTensor, FlexTensor) {
        let [q, k, v, gradient] = [q, k, v, gradient].map(|t| t.to_contiguous());
        let attention = attention_of(&q, &k, heads);
        let inputs = Inputs { q: floats(&q), k: floats(&k), v: floats(&v) };
        let [dq, dk, dv] = with_tile!(tile => attention.backward(tile, inputs, floats(&gradient)));
        (tensor(dq, q.shape()), tensor(dk, k.shape()), tensor(dv, v.shape()))
    }

    fn channel_norm(x: FlexTensor, gamma: FlexTensor, eps: Option<f32>, silu: bool) -> FlexTensor {
        let [x, gamma] = [x, gamma].map(|t| t.to_contiguous());
        let norm = ChannelNorm { x: floats(&x), gamma: floats(&gamma), eps, silu };
        tensor(with_tile!(tile => norm.forward(tile)), x.shape())
    }

    fn channel_norm_backward(
        x: FlexTensor,
        gamma: FlexTensor,
        gradient: FlexTensor,
        eps: Option<f32>,
        silu: bool,
    ) -> (FlexTensor, FlexTensor) {
        let [x, gamma, gradient] = [x, gamma, gradient].map(|t| t.to_contiguous());
        let norm = ChannelNorm { x: floats(&x), gamma: floats(&gamma), eps, silu };
        let (dx, dgamma) = with_tile!(tile => norm.backward(tile, floats(&gradient)));
        (tensor(dx, x.shape()), tensor(dgamma, gamma.shape()))
    }

    fn nhwc_conv(x: FlexTensor, w: FlexTensor, b: FlexTensor, kind: Kind) -> FlexTensor {
        let finish = if kind.silu { Finish::Silu } else { Finish::Plain };
        forward(x.clone(), x, w, b, kind, finish).0
    }

    fn nhwc_decode(x: FlexTensor, skip: FlexTensor, w: FlexTensor, b: FlexTensor, kind: Kind) -> FlexTensor {
        forward(x, skip, w, b, kind, Finish::Silu).0
    }

    fn nhwc_with_sums(x: FlexTensor, skip: FlexTensor, w: FlexTensor, b: FlexTensor, kind: Kind) -> (FlexTensor, FlexTensor) {
        let (sums, activated) = forward(x, skip, w, b, kind, Finish::SiluAndSums);
        (activated.unwrap_or_else(|| sums.clone()), sums)
    }

    fn nhwc_backward(
        x: FlexTensor,
        skip: FlexTensor,
        w: FlexTensor,
        sums: FlexTensor,
        gradient: FlexTensor,
        task: BackwardTask,
    ) -> (FlexTensor, FlexTensor, FlexTensor, FlexTensor) {
        let BackwardTask { kind, wanted } = task;
        let [x, skip, w, sums, gradient] = [x, skip, w, sums, gradient].map(|t| t.to_contiguous());
        let convolution = convolution(&x, &skip, &w, kind);
        let sums = kind.silu.then(|| floats(&sums));
        let found =
            with_tile_for!(convolution, kind.products, tile => convolution.backward(tile, sums, floats(&gradient), wanted));
        let like = |wanted: bool, values: Vec<f32>, shape: Shape| tensor(values, if wanted { shape } else { Shape::new([0]) });
        (
            like(wanted.x, found.x, x.shape()),
            like(wanted.skip, found.skip, skip.shape()),
            like(wanted.weights, found.weights, w.shape()),
            like(wanted.bias, found.bias, Shape::new([convolution.outputs])),
        )
    }
}

/// The state of the backward pass: the inputs (through the checkpointer), and the sums if there was an activation.
#[derive(Clone, Debug)]
struct Kept<B: Backend> {
    x: NodeId,
    skip: Option<NodeId>,
    w: NodeId,
    sums: Option<FloatTensor<B>>,
    kind: Kind,
}

impl<B: CpuKernels> Kept<B> {
    /// Gradients of x, skip, weights and bias, given the gradient of the output.
    fn gradients(self, gradient: FloatTensor<B>, wanted: Wanted, checkpointer: &mut Checkpointer) -> [FloatTensor<B>; 4] {
        let x: FloatTensor<B> = checkpointer.retrieve_node_output(self.x);
        let w: FloatTensor<B> = checkpointer.retrieve_node_output(self.w);
        let skip = match self.skip {
            Some(id) => checkpointer.retrieve_node_output(id),
            None => x.clone(),
        };
        let sums = self.sums.unwrap_or_else(|| gradient.clone());
        let (x, skip, w, b) = B::nhwc_backward(x, skip, w, sums, gradient, BackwardTask { kind: self.kind, wanted });
        [x, skip, w, b]
    }
}

#[derive(Debug)]
struct ConvBackward;

impl<B: CpuKernels> Backward<B, 3> for ConvBackward {
    type State = Kept<B>;

    fn backward(self, ops: Ops<Self::State, 3>, tape: &mut Tape, checkpointer: &mut Checkpointer) {
        let [x, w, b] = ops.parents;
        let wanted = Wanted { x: x.is_some(), skip: false, weights: w.is_some(), bias: b.is_some() };
        let [dx, _, dw, db] = ops.state.gradients(tape.consume::<B>(&ops.node), wanted, checkpointer);
        for (node, gradient) in [(x, dx), (w, dw), (b, db)] {
            if let Some(node) = node {
                tape.register::<B>(node.id, gradient);
            }
        }
    }
}

#[derive(Debug)]
struct DecodeBackward;

impl<B: CpuKernels> Backward<B, 4> for DecodeBackward {
    type State = Kept<B>;

    fn backward(self, ops: Ops<Self::State, 4>, tape: &mut Tape, checkpointer: &mut Checkpointer) {
        let [x, skip, w, b] = &ops.parents;
        let wanted = Wanted { x: x.is_some(), skip: skip.is_some(), weights: w.is_some(), bias: b.is_some() };
        let gradients = ops.state.gradients(tape.consume::<B>(&ops.node), wanted, checkpointer);
        for (node, gradient) in ops.parents.into_iter().zip(gradients) {
            if let Some(node) = node {
                tape.register::<B>(node.id, gradient);
            }
        }
    }
}

#[derive(Debug)]
struct AttentionBackward;

impl<B: CpuKernels> Backward<B, 3> for AttentionBackward {
    type State = ([NodeId; 3], usize);

    fn backward(self, ops: Ops<Self::State, 3>, tape: &mut Tape, checkpointer: &mut Checkpointer) {
        let gradient = tape.consume::<B>(&ops.node);
        let (inputs, heads) = ops.state;
        let [q, k, v]: [FloatTensor<B>; 3] = inputs.map(|id| checkpointer.retrieve_node_output(id));
        let (dq, dk, dv) = B::token_attention_backward(q, k, v, gradient, heads);
        for (node, gradient) in ops.parents.into_iter().zip([dq, dk, dv]) {
            if let Some(node) = node {
                tape.register::<B>(node.id, gradient);
            }
        }
    }
}

#[derive(Debug)]
struct NormBackward;

impl<B: CpuKernels> Backward<B, 2> for NormBackward {
    type State = ([NodeId; 2], Option<f32>, bool);

    fn backward(self, ops: Ops<Self::State, 2>, tape: &mut Tape, checkpointer: &mut Checkpointer) {
        let gradient = tape.consume::<B>(&ops.node);
        let (inputs, eps, silu) = ops.state;
        let [x, gamma]: [FloatTensor<B>; 2] = inputs.map(|id| checkpointer.retrieve_node_output(id));
        let (dx, dgamma) = B::channel_norm_backward(x, gamma, gradient, eps, silu);
        for (node, gradient) in ops.parents.into_iter().zip([dx, dgamma]) {
            if let Some(node) = node {
                tape.register::<B>(node.id, gradient);
            }
        }
    }
}

impl<B: CpuKernels, C: CheckpointStrategy> CpuKernels for Autodiff<B, C> {
    fn channel_norm(x: FloatTensor<Self>, gamma: FloatTensor<Self>, eps: Option<f32>, silu: bool) -> FloatTensor<Self> {
        match NormBackward.prepare::<C>([x.node(), gamma.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let inputs = [&x, &gamma].map(|t| prepared.checkpoint(t));
                prepared.finish((inputs, eps, silu), B::channel_norm(x.into_primitive(), gamma.into_primitive(), eps, silu))
            }
            OpsKind::UnTracked(prepared) => {
                prepared.finish(B::channel_norm(x.into_primitive(), gamma.into_primitive(), eps, silu))
            }
        }
    }

    fn channel_norm_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: Option<f32>,
        _: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        unreachable!("gradients of gradients are not offered")
    }

    fn token_attention(q: FloatTensor<Self>, k: FloatTensor<Self>, v: FloatTensor<Self>, heads: usize) -> FloatTensor<Self> {
        match AttentionBackward.prepare::<C>([q.node(), k.node(), v.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let inputs = [&q, &k, &v].map(|t| prepared.checkpoint(t));
                let y = B::token_attention(q.into_primitive(), k.into_primitive(), v.into_primitive(), heads);
                prepared.finish((inputs, heads), y)
            }
            OpsKind::UnTracked(prepared) => {
                prepared.finish(B::token_attention(q.into_primitive(), k.into_primitive(), v.into_primitive(), heads))
            }
        }
    }

    fn token_attention_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        unreachable!("gradients of gradients are not offered")
    }

    fn nhwc_conv(x: FloatTensor<Self>, w: FloatTensor<Self>, b: FloatTensor<Self>, kind: Kind) -> FloatTensor<Self> {
        match ConvBackward.prepare::<C>([x.node(), w.node(), b.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let (x_id, w_id) = (prepared.checkpoint(&x), prepared.checkpoint(&w));
                let (x, w, b) = (x.into_primitive(), w.into_primitive(), b.into_primitive());
                let (y, sums) = if kind.silu {
                    let (y, sums) = B::nhwc_with_sums(x.clone(), x, w, b, kind);
                    (y, Some(sums))
                } else {
                    (B::nhwc_conv(x, w, b, kind), None)
                };
                prepared.finish(Kept { x: x_id, skip: None, w: w_id, sums, kind }, y)
            }
            OpsKind::UnTracked(prepared) => {
                prepared.finish(B::nhwc_conv(x.into_primitive(), w.into_primitive(), b.into_primitive(), kind))
            }
        }
    }

    fn nhwc_decode(
        x: FloatTensor<Self>,
        skip: FloatTensor<Self>,
        w: FloatTensor<Self>,
        b: FloatTensor<Self>,
        kind: Kind,
    ) -> FloatTensor<Self> {
        match DecodeBackward.prepare::<C>([x.node(), skip.node(), w.node(), b.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let [x_id, skip_id, w_id] = [&x, &skip, &w].map(|t| prepared.checkpoint(t));
                let [x, skip, w, b] = [x, skip, w, b].map(|t| t.into_primitive());
                let (y, sums) = B::nhwc_with_sums(x, skip, w, b, kind);
                prepared.finish(Kept { x: x_id, skip: Some(skip_id), w: w_id, sums: Some(sums), kind }, y)
            }
            OpsKind::UnTracked(prepared) => {
                let [x, skip, w, b] = [x, skip, w, b].map(|t| t.into_primitive());
                prepared.finish(B::nhwc_decode(x, skip, w, b, kind))
            }
        }
    }

    fn nhwc_with_sums(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: Kind,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        unreachable!("only the differentiable operations are called from outside")
    }

    fn nhwc_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: BackwardTask,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        unreachable!("gradients of gradients are not offered")
    }
}
