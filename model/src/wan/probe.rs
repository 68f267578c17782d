//! A window into a running network, for parity tests and for looking at activations.

use burn::tensor::Tensor;

/// One intermediate result, on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct Activation {
    /// Where it was taken, as diffusers calls that module.
    pub name: String,
    /// Shape, in diffusers' order of axes.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub values: Vec<f32>,
}

/// Receives activations; an idle one costs nothing.
#[derive(Default)]
pub struct Probe<'a>(Option<&'a mut dyn FnMut(Activation)>);

impl<'a> Probe<'a> {
    /// Hands every activation to `receive`.
    pub fn new(receive: &'a mut dyn FnMut(Activation)) -> Self {
        Self(Some(receive))
    }

    /// Receives nothing.
    pub fn idle() -> Self {
        Self(None)
    }

    /// Reports what `make` returns, called only if somebody listens.
    pub(crate) fn report<const D: usize>(&mut self, name: &str, make: impl FnOnce() -> Tensor<D>) {
        if let Some(receive) = &mut self.0 {
            let tensor = make();
            let shape = tensor.dims().to_vec();
            let values = tensor.into_data().iter::<f32>().collect();
            receive(Activation { name: name.into(), shape, values });
        }
    }
}
