//! Parameters of a module by name: out to the host, back in, and their gradients.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

/// One parameter on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Path of fields, joined by dots.
    pub name: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub values: Vec<f32>,
}

/// All float parameters of `module` in a fixed order.
pub fn export<M: Module>(module: &M) -> Vec<Parameter> {
    let mut visitor = Export { path: Vec::new(), found: Vec::new() };
    module.visit(&mut visitor);
    visitor.found
}

/// The module with its parameters replaced by `values`, in the order of [`export`], on `device`.
///
/// # Panics
/// When the number of parameters or of their values differs.
pub fn import<M: Module>(module: M, values: &[&[f32]], device: &Device) -> M {
    let mut mapper = Import { values: values.iter(), device };
    let module = module.map(&mut mapper);
    assert!(mapper.values.next().is_none(), "more values than parameters");
    module
}

/// Gradients in the order of [`export`]; `None` where the loss does not depend on the parameter.
pub fn gradients<M: Module>(module: &M, gradients: &mut Gradients) -> Vec<Option<Vec<f32>>> {
    let mut visitor = Collect { gradients, found: Vec::new() };
    module.visit(&mut visitor);
    visitor.found
}

/// Values of a float tensor, row-major.
pub fn to_vec<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    // The error case is a device that lost its memory, a broken invariant on the CPU.
    tensor.try_into_vec_as::<f32>().expect("tensor readable as f32")
}

struct Export {
    path: Vec<String>,
    found: Vec<Parameter>,
}

impl ModuleVisitor for Export {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let value = param.val();
        let shape = value.dims().to_vec();
        self.found.push(Parameter { name: self.path.join("."), shape, values: to_vec(value.without_autodiff()) });
    }

    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_string());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }
}

struct Import<'a> {
    values: std::slice::Iter<'a, &'a [f32]>,
    device: &'a Device,
}

impl ModuleMapper for Import<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let values = self.values.next().expect("as many values as parameters");
        let require_grad = param.is_require_grad();
        param.map(|old| {
            let new = Tensor::from_data(TensorData::new(values.to_vec(), old.shape()), self.device);
            if require_grad { new.require_grad() } else { new }
        })
    }
}

struct Collect<'a> {
    gradients: &'a mut Gradients,
    found: Vec<Option<Vec<f32>>>,
}

impl ModuleVisitor for Collect<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.push(param.val().grad_remove(self.gradients).map(to_vec));
    }
}
