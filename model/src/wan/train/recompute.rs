//! Gradients of the renderer, with or without activations that are computed again.
//!
//! Recomputed, the forward pass keeps the tokens between blocks only; the backward pass then runs one block at a time once more, with
//! its tokens and everything blocks share ([`Shared::tensors`]) as leaves, and hands the gradients on. At any time the activations of
//! one block are in memory (Chen et al. 2016 with a checkpoint a block).

use crate::Result;
use crate::parameters;
use crate::wan::flow::{Flow, Shared};
use burn::module::Module;
use burn::tensor::{Gradients, Tensor};

/// Gradients in the order of [`parameters::export_learning`].
pub type Found = Vec<Option<Vec<f32>>>;

/// What a loss returns: anything to be passed on, and the number to be differentiated.
pub type Judged<T> = Result<(T, Tensor<1>)>;

/// The gradients of `loss` of the velocity `[b, z, f, h, w]` that `flow` gives to tokens and shared tensors as `Flow::prepare` makes
/// them, by one backward pass through everything.
///
/// # Errors
/// Those of `loss`.
pub fn plain<T>(
    flow: &Flow,
    (mut tokens, shared): (Tensor<3>, Shared),
    loss: impl FnOnce(Tensor<5>) -> Judged<T>,
) -> Result<(T, Found)> {
    for i in 0..flow.config().dit.layers {
        tokens = flow.block(i, tokens, &shared);
    }
    let (judged, loss) = loss(flow.finish(tokens, &shared))?;
    Ok((judged, parameters::gradients_learning(flow, &mut loss.backward())))
}

/// [`plain`] in the memory of one block.
///
/// # Errors
/// Those of `loss`.
pub fn recomputed<T>(
    flow: &Flow,
    (first, shared): (Tensor<3>, Shared),
    loss: impl FnOnce(Tensor<5>) -> Judged<T>,
) -> Result<(T, Found)> {
    let layers = flow.config().dit.layers;
    // Nothing is recorded on the way forward.
    let frozen = flow.clone().no_grad();
    let resting = shared.with_tensors(shared.tensors().into_iter().map(Tensor::detach).collect());
    let mut kept = Vec::with_capacity(layers + 1);
    kept.push(first.clone().detach());
    for i in 0..layers {
        let tokens = frozen.block(i, kept[i].clone(), &resting);
        kept.push(tokens);
    }

    let mut found = Found::new();
    let mut slopes = vec![None; resting.tensors().len()];
    let leaves = Leaves::of(&kept.pop().unwrap_or(first.clone()), &resting);
    let (judged, loss) = loss(flow.finish(leaves.tokens.clone(), &leaves.shared))?;
    let mut slope = leaves.collect(flow, loss.backward(), &mut found, &mut slopes);
    drop(loss);
    for i in (0..layers).rev() {
        let leaves = Leaves::of(&kept.pop().unwrap_or(first.clone()), &resting);
        let tokens = flow.block(i, leaves.tokens.clone(), &leaves.shared);
        slope = match pull([(tokens, slope)]) {
            Some(gradients) => leaves.collect(flow, gradients, &mut found, &mut slopes),
            None => None,
        };
    }
    // What precedes the blocks was recorded when it was made.
    let ends = shared.tensors().into_iter().zip(slopes);
    if let Some(mut gradients) = pull([(first, slope)].into_iter().chain(ends)) {
        add(&mut found, parameters::gradients_learning(flow, &mut gradients));
    }
    Ok((judged, found))
}

/// The inputs of a stage, cut from what made them.
struct Leaves {
    tokens: Tensor<3>,
    shared: Shared,
}

impl Leaves {
    fn of(tokens: &Tensor<3>, shared: &Shared) -> Self {
        let leaf = |x: Tensor<3>| x.detach().require_grad();
        Self { tokens: leaf(tokens.clone()), shared: shared.with_tensors(shared.tensors().into_iter().map(leaf).collect()) }
    }

    /// Adds the gradients of parameters and shared tensors to those found before, and returns that of the tokens.
    fn collect(
        &self,
        flow: &Flow,
        mut gradients: Gradients,
        found: &mut Found,
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

/// Continues gradients to what the tensors were made of; `None` where nothing behind them learns.
fn pull(ends: impl IntoIterator<Item = (Tensor<3>, Option<Tensor<3>>)>) -> Option<Gradients> {
    let mut sum: Option<Tensor<1>> = None;
    for (tensor, slope) in ends {
        let Some(slope) = slope.filter(|_| tensor.is_tracked()) else { continue };
        // The derivative of this product's sum with respect to the tensor is the slope.
        let part = (tensor * Tensor::from_inner(slope)).sum();
        sum = Some(match sum {
            Some(sum) => sum + part,
            None => part,
        });
    }
    sum.map(|sum| sum.backward())
}

fn add(found: &mut Found, new: Found) {
    if found.is_empty() {
        *found = new;
        return;
    }
    for (sum, new) in found.iter_mut().zip(new) {
        match (&mut *sum, new) {
            (Some(sum), Some(new)) => sum.iter_mut().zip(new).for_each(|(sum, new)| *sum += new),
            (sum @ None, new) => *sum = new,
            (Some(_), None) => {}
        }
    }
}
