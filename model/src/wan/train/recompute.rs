//! Gradients of the renderer, with or without recomputed activations.
//!
//! With recomputation, the forward pass keeps only the tokens between blocks. The backward pass runs the blocks again, one at a
//! time, with the tokens and everything that blocks share ([`Shared::tensors`]) as leaves, and passes the gradients on. The
//! activations of one block are in memory at any time (Chen et al. 2016, with one checkpoint per block).

use crate::Result;
use crate::parameters::{self, GradientList};
use crate::wan::flow::{Flow, Shared};
use burn::module::Module;
use burn::tensor::{Gradients, Tensor};

/// The value of a loss function: a report to pass on, and the number to differentiate.
pub type LossValue<T> = Result<(T, Tensor<1>)>;

/// The gradients of `loss`, a function of the velocity `[b, z, f, h, w]` that `flow` predicts from prepared tokens and shared
/// tensors ([`Flow::prepare`]). One backward pass runs through the whole network.
///
/// # Errors
/// When `loss` fails.
pub fn plain<T>(
    flow: &Flow,
    (mut tokens, shared): (Tensor<3>, Shared),
    loss: impl FnOnce(Tensor<5>) -> LossValue<T>,
) -> Result<(T, GradientList)> {
    for i in 0..flow.config().dit.layers {
        tokens = flow.block(i, tokens, &shared);
    }
    let (report, loss) = loss(flow.finish(tokens, &shared))?;
    Ok((report, parameters::gradients_learning(flow, &mut loss.backward())))
}

/// The gradients of [`plain`], with the activations of one block in memory.
///
/// # Errors
/// When `loss` fails.
pub fn recomputed<T>(
    flow: &Flow,
    (first, shared): (Tensor<3>, Shared),
    loss: impl FnOnce(Tensor<5>) -> LossValue<T>,
) -> Result<(T, GradientList)> {
    let layers = flow.config().dit.layers;
    // The forward pass records nothing.
    let frozen = flow.clone().no_grad();
    let resting = shared.with_tensors(shared.tensors().into_iter().map(Tensor::detach).collect());
    let mut kept = Vec::with_capacity(layers + 1);
    kept.push(first.clone().detach());
    for i in 0..layers {
        let tokens = frozen.block(i, kept[i].clone(), &resting);
        kept.push(tokens);
    }

    let mut found = GradientList::new();
    let mut slopes = vec![None; resting.tensors().len()];
    let leaves = Leaves::of(&kept.pop().unwrap_or(first.clone()), &resting);
    let (report, loss) = loss(flow.finish(leaves.tokens.clone(), &leaves.shared))?;
    let mut slope = leaves.collect(flow, loss.backward(), &mut found, &mut slopes);
    drop(loss);
    for i in (0..layers).rev() {
        let leaves = Leaves::of(&kept.pop().unwrap_or(first.clone()), &resting);
        let tokens = flow.block(i, leaves.tokens.clone(), &leaves.shared);
        slope = match propagate([(tokens, slope)]) {
            Some(gradients) => leaves.collect(flow, gradients, &mut found, &mut slopes),
            None => None,
        };
    }
    // The operations before the blocks were recorded when they ran.
    let ends = shared.tensors().into_iter().zip(slopes);
    if let Some(mut gradients) = propagate([(first, slope)].into_iter().chain(ends)) {
        add(&mut found, parameters::gradients_learning(flow, &mut gradients));
    }
    Ok((report, found))
}

/// The inputs of a block, detached from the operations that made them.
struct Leaves {
    tokens: Tensor<3>,
    shared: Shared,
}

impl Leaves {
    fn of(tokens: &Tensor<3>, shared: &Shared) -> Self {
        let leaf = |x: Tensor<3>| x.detach().require_grad();
        Self { tokens: leaf(tokens.clone()), shared: shared.with_tensors(shared.tensors().into_iter().map(leaf).collect()) }
    }

    /// Adds the gradients of parameters and shared tensors to the sums, and returns the gradient of the tokens.
    fn collect(
        &self,
        flow: &Flow,
        mut gradients: Gradients,
        found: &mut GradientList,
        slopes: &mut [Option<Tensor<3>>],
    ) -> Option<Tensor<3>> {
        for (slope, leaf) in slopes.iter_mut().zip(self.shared.tensors()) {
            let new = leaf.grad_remove(&mut gradients);
            *slope = match (slope.take(), new) {
                (Some(sum), Some(new)) => Some(sum + new),
                (sum, new) => sum.or(new),
            };
        }
        add(found, parameters::gradients_learning(flow, &mut gradients));
        self.tokens.grad_remove(&mut gradients)
    }
}

/// Propagates gradients through the operations that made the tensors; `None` if no parameter before them learns.
fn propagate(ends: impl IntoIterator<Item = (Tensor<3>, Option<Tensor<3>>)>) -> Option<Gradients> {
    let mut sum: Option<Tensor<1>> = None;
    for (tensor, slope) in ends {
        let Some(slope) = slope.filter(|_| tensor.is_tracked()) else { continue };
        // The derivative of the sum of this product with respect to the tensor is the slope.
        let part = (tensor * Tensor::from_inner(slope)).sum();
        sum = Some(match sum {
            Some(sum) => sum + part,
            None => part,
        });
    }
    sum.map(|sum| sum.backward())
}

fn add(found: &mut GradientList, new: GradientList) {
    if found.is_empty() {
        *found = new;
        return;
    }
    for (sum, new) in found.iter_mut().zip(new) {
        *sum = match (sum.take(), new) {
            (Some(sum), Some(new)) => Some(sum + new),
            (sum, new) => sum.or(new),
        };
    }
}
