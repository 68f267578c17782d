//! The kernels of [`rows`] as one operation of burn's CPU backend, with its gradients.
use super::Kernel;
use super::extension::{floats, tensor, with_tile};
use super::rows::{self, Groups, Modulate};
use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients as Tape;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::{Shape, Tensor};
use burn_flex::FlexTensor;

/// Which operation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// [`crate::ops::gelu`] of the first tensor.
    Gelu,
    /// [`crate::ops::modulate`].
    Modulate(Option<f32>),
    /// [`crate::ops::gate`].
    Gate,
    /// [`crate::ops::turn`], the other way round if `true`.
    Turn(bool),
}

impl Kind {
    /// Which of the tensors its gradients are computed from.
    fn keeps(self) -> [bool; 3] {
        match self {
            Self::Gelu => [true, false, false],
            Self::Modulate(_) => [true, true, false],
            Self::Gate => [false, true, true],
            Self::Turn(_) => [false, true, true],
        }
    }
}

/// Operations on the rows of three tensors; one that needs fewer is given any others.
#[backend_extension(Flex, Autodiff)]
pub trait RowKernels: Backend {
    /// The operation; differentiable, but for the second and third tensor of [`Kind::Gelu`] and [`Kind::Turn`].
    fn row_operation(x: FloatTensor<Self>, a: FloatTensor<Self>, b: FloatTensor<Self>, kind: Kind) -> FloatTensor<Self>;

    /// Gradients of the three, given that of the result; any tensor for one that is not differentiated or not kept.
    fn row_operation_backward(
        x: FloatTensor<Self>,
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
        kind: Kind,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>);
}

/// [`crate::ops::gelu`] by the kernels.
pub fn gelu<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    let nothing = || Tensor::<1>::zeros([0], &x.device()).into_dispatch();
    let (a, b) = (nothing(), nothing());
    Tensor::from_dispatch(Dispatch::row_operation(x.into_dispatch(), a, b, Kind::Gelu))
}

/// [`crate::ops::modulate`] by the kernels.
pub fn modulate(x: Tensor<3>, factor: Tensor<3>, shift: Tensor<3>, eps: Option<f32>) -> Tensor<3> {
    let kind = Kind::Modulate(eps);
    Tensor::from_dispatch(Dispatch::row_operation(x.into_dispatch(), factor.into_dispatch(), shift.into_dispatch(), kind))
}

/// [`crate::ops::gate`] by the kernels.
pub fn gate(x: Tensor<3>, y: Tensor<3>, gate: Tensor<3>) -> Tensor<3> {
    Tensor::from_dispatch(Dispatch::row_operation(x.into_dispatch(), y.into_dispatch(), gate.into_dispatch(), Kind::Gate))
}

/// [`crate::ops::turn`] by the kernels.
pub fn turn(x: Tensor<3>, cos: Tensor<2>, sin: Tensor<2>) -> Tensor<3> {
    let kind = Kind::Turn(false);
    Tensor::from_dispatch(Dispatch::row_operation(x.into_dispatch(), cos.into_dispatch(), sin.into_dispatch(), kind))
}

/// Values of the last axis.
fn channels(t: &FlexTensor) -> usize {
    t.shape().last().copied().unwrap_or(1)
}

fn nothing() -> FlexTensor {
    tensor(Vec::new(), Shape::new([0]))
}

impl RowKernels for Flex {
    fn row_operation(x: FlexTensor, a: FlexTensor, b: FlexTensor, kind: Kind) -> FlexTensor {
        let [x, a, b] = [x, a, b].map(|t| t.to_contiguous());
        let [xs, at, bs] = [&x, &a, &b].map(floats);
        let width = channels(&x);
        let y = match kind {
            Kind::Gelu => with_tile!(tile => rows::gelu(tile, xs)),
            Kind::Modulate(eps) => {
                let groups = Groups::of(xs.len(), at.len(), width);
                Modulate { x: xs, factor: at, groups, eps }.forward(bs)
            }
            Kind::Gate => rows::gate(xs, at, bs, Groups::of(xs.len(), bs.len(), width)),
            Kind::Turn(back) => rows::turn(xs, at, bs, width, channels(&a), back),
        };
        tensor(y, x.shape())
    }

    fn row_operation_backward(
        x: FlexTensor,
        a: FlexTensor,
        b: FlexTensor,
        gradient: FlexTensor,
        kind: Kind,
    ) -> (FlexTensor, FlexTensor, FlexTensor) {
        let [x, a, b, gradient] = [x, a, b, gradient].map(|t| t.to_contiguous());
        let [xs, at, bs, g] = [&x, &a, &b, &gradient].map(floats);
        let width = channels(&gradient);
        match kind {
            Kind::Gelu => {
                let dx = with_tile!(tile => rows::gelu_gradient(tile, xs, g));
                (tensor(dx, gradient.shape()), nothing(), nothing())
            }
            Kind::Modulate(eps) => {
                let groups = Groups::of(xs.len(), at.len(), width);
                let [dx, dfactor, dshift] = Modulate { x: xs, factor: at, groups, eps }.backward(g);
                (tensor(dx, x.shape()), tensor(dfactor, a.shape()), tensor(dshift, a.shape()))
            }
            Kind::Gate => {
                let [dy, dgate] = rows::gate_gradient(at, bs, g, Groups::of(at.len(), bs.len(), width));
                (gradient, tensor(dy, a.shape()), tensor(dgate, b.shape()))
            }
            Kind::Turn(back) => {
                let dx = rows::turn(g, at, bs, width, channels(&a), !back);
                (tensor(dx, gradient.shape()), nothing(), nothing())
            }
        }
    }
}

#[derive(Debug)]
struct RowBackward;

impl<B: RowKernels> Backward<B, 3> for RowBackward {
    type State = ([Option<NodeId>; 3], Kind);

    fn backward(self, ops: Ops<Self::State, 3>, tape: &mut Tape, checkpointer: &mut Checkpointer) {
        let gradient = tape.consume::<B>(&ops.node);
        let (kept, kind) = ops.state;
        let [x, a, b] = kept.map(|id| match id {
            Some(id) => checkpointer.retrieve_node_output(id),
            None => gradient.clone(),
        });
        let (dx, da, db) = B::row_operation_backward(x, a, b, gradient, kind);
        for (node, gradient) in ops.parents.into_iter().zip([dx, da, db]) {
            if let Some(node) = node {
                tape.register::<B>(node.id, gradient);
            }
        }
    }
}

impl<B: RowKernels, C: CheckpointStrategy> RowKernels for Autodiff<B, C> {
    fn row_operation(x: FloatTensor<Self>, a: FloatTensor<Self>, b: FloatTensor<Self>, kind: Kind) -> FloatTensor<Self> {
        match RowBackward.prepare::<C>([x.node(), a.node(), b.node()]).compute_bound().stateful() {
            OpsKind::Tracked(mut prepared) => {
                let [keep_x, keep_a, keep_b] = kind.keeps();
                let kept = [(keep_x, &x), (keep_a, &a), (keep_b, &b)].map(|(keep, t)| keep.then(|| prepared.checkpoint(t)));
                prepared.finish((kept, kind), B::row_operation(x.into_primitive(), a.into_primitive(), b.into_primitive(), kind))
            }
            OpsKind::UnTracked(prepared) => {
                prepared.finish(B::row_operation(x.into_primitive(), a.into_primitive(), b.into_primitive(), kind))
            }
        }
    }

    fn row_operation_backward(
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: FloatTensor<Self>,
        _: Kind,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        unreachable!("gradients of gradients are not offered")
    }
}
