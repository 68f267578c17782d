//! A record of a network's intermediate results, for parity tests and for looking at activations.
//!
//! The record belongs to the thread that runs the network. Networks report their activations at all times; without a record, a
//! report costs one look at a thread-local variable.

use burn::tensor::Tensor;
use std::cell::RefCell;

/// One intermediate result, in the host's memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Activation {
    /// Name of the module that made it, as in diffusers.
    pub name: String,
    /// Shape, with the axes in diffusers' order.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub values: Vec<f32>,
}

thread_local! {
    static RECORD: RefCell<Option<Vec<Activation>>> = const { RefCell::new(None) };
}

/// Runs a network on this thread and returns its activations too, in the order in which they were made.
pub fn record<T>(run: impl FnOnce() -> T) -> (T, Vec<Activation>) {
    let before = RECORD.replace(Some(Vec::new()));
    let result = run();
    (result, RECORD.replace(before).unwrap_or_default())
}

/// Runs a part of a network whose activations are not recorded, such as the later chunks of a clip.
pub(super) fn unrecorded<T>(run: impl FnOnce() -> T) -> T {
    let before = RECORD.replace(None);
    let result = run();
    RECORD.set(before);
    result
}

/// Records the tensor that `make` returns. Without a record, `make` is not called.
pub(super) fn report<const D: usize>(name: &str, make: impl FnOnce() -> Tensor<D>) {
    if RECORD.with_borrow(Option::is_none) {
        return;
    }
    let tensor = make();
    let shape = tensor.dims().to_vec();
    let values = tensor.into_data().iter::<f32>().collect();
    RECORD.with_borrow_mut(|record| {
        if let Some(record) = record {
            record.push(Activation { name: name.into(), shape, values });
        }
    });
}
