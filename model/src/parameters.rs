//! Parameters of a module by name, to the host's memory and back, and their gradients on their device or in that memory.

use crate::{Error, Result};
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor};

/// Characters of the longest message of a driver that is passed on.
const LONGEST_REASON: usize = 400;

/// One parameter in the host's memory.
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
    export_some(module, &|_, _| true)
}

/// The parameters that learn (require a gradient), in the order of [`export`].
pub fn export_learning<M: Module>(module: &M) -> Vec<Parameter> {
    export_some(module, &|_, learns| learns)
}

/// The parameters that `wanted` accepts, in the order of [`export`]. It receives a name and whether the parameter learns.
pub fn export_some<M: Module>(module: &M, wanted: &dyn Fn(&str, bool) -> bool) -> Vec<Parameter> {
    let mut visitor = Export { path: Vec::new(), wanted, found: Vec::new() };
    module.visit(&mut visitor);
    visitor.found
}

/// Replaces the parameters of a module by `values`, in the order of [`export`], on `device`.
///
/// # Panics
/// When the number of parameters or of their values differs.
pub fn import<M: Module>(module: M, values: &[&[f32]], device: &Device) -> M {
    replace(module, on(device, values), true)
}

/// Replaces the parameters that learn, in the order of [`export_learning`]. The other parameters stay as they are.
///
/// # Panics
/// When the number of parameters or of their values differs.
pub fn import_learning<M: Module>(module: M, values: &[&[f32]], device: &Device) -> M {
    replace(module, on(device, values), false)
}

/// As [`import_learning`], with values that are on a device already, each in one dimension. The module records operations there.
///
/// # Panics
/// When the number of parameters or of their values differs.
pub fn import_tensors<M: Module>(module: M, values: impl IntoIterator<Item = Tensor<1>>) -> M {
    replace(module, values.into_iter().map(Tensor::from_inner), false)
}

/// The values as tensors of a device.
fn on<'a>(device: &'a Device, values: &'a [&[f32]]) -> impl Iterator<Item = Tensor<1>> + 'a {
    values.iter().map(move |values| Tensor::from_data(*values, device))
}

fn replace<M: Module>(module: M, values: impl Iterator<Item = Tensor<1>>, all: bool) -> M {
    let mut mapper = Import { values, all };
    let module = module.map(&mut mapper);
    assert!(mapper.values.next().is_none(), "more values than parameters");
    module
}

/// The values of gradients in the order of [`export`]. A gradient is `None` if the loss does not depend on the parameter.
///
/// # Errors
/// As [`read`].
pub fn gradients<M: Module>(module: &M, gradients: &mut Gradients) -> Result<Vec<Option<Vec<f32>>>> {
    let mut visitor = Collect { gradients, all: true, found: Vec::new() };
    module.visit(&mut visitor);
    read_gradients(visitor.found)
}

/// Gradients of the parameters that learn, on their device, each row-major in one dimension. A gradient is `None` if the loss
/// does not depend on the parameter.
pub type GradientList = Vec<Option<Tensor<1>>>;

/// Gradients in the order of [`export_learning`].
pub fn gradients_learning<M: Module>(module: &M, gradients: &mut Gradients) -> GradientList {
    let mut visitor = Collect { gradients, all: false, found: Vec::new() };
    module.visit(&mut visitor);
    visitor.found
}

/// The values of gradients.
///
/// # Errors
/// As [`read`].
pub fn read_gradients(gradients: GradientList) -> Result<Vec<Option<Vec<f32>>>> {
    gradients.into_iter().map(|gradient| gradient.map(read).transpose()).collect()
}

/// The values of a float tensor, row-major.
///
/// # Errors
/// [`Error::Device`] when its device has run out of memory, or is lost. What failed may be an earlier operation, because GPUs
/// compute later than they are told to.
pub fn read<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    let device = tensor.device();
    let failed = |reason: String| Error::Device { device: format!("{device:?}"), reason: words(&reason) };
    tensor.try_into_vec_as::<f32>().map_err(|error| failed(error.to_string()))
}

/// The message of a driver in one line, without what it says about its own code.
fn words(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ").chars().take(LONGEST_REASON).collect()
}

/// The values of a float tensor of the processor, row-major.
pub fn to_vec<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    // This fails only if the device has lost its memory, which cannot happen on the CPU.
    tensor.try_into_vec_as::<f32>().expect("tensor readable as f32")
}

struct Export<'a> {
    path: Vec<String>,
    wanted: &'a dyn Fn(&str, bool) -> bool,
    found: Vec<Parameter>,
}

impl ModuleVisitor for Export<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let (name, value) = (self.path.join("."), param.val());
        if (self.wanted)(&name, param.is_require_grad()) {
            let shape = value.dims().to_vec();
            self.found.push(Parameter { name, shape, values: to_vec(value.without_autodiff()) });
        }
    }

    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_string());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }
}

struct Import<V> {
    values: V,
    all: bool,
}

impl<V: Iterator<Item = Tensor<1>>> ModuleMapper for Import<V> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        if !self.all && !param.is_require_grad() {
            return param;
        }
        let values = self.values.next().expect("as many values as parameters");
        let require_grad = param.is_require_grad();
        param.map(|old| {
            let new = values.reshape(old.shape());
            if require_grad { new.require_grad() } else { new }
        })
    }
}

struct Collect<'a> {
    gradients: &'a mut Gradients,
    all: bool,
    found: GradientList,
}

impl ModuleVisitor for Collect<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if self.all || param.is_require_grad() {
            self.found.push(param.val().grad_remove(self.gradients).map(|gradient| gradient.flatten(0, D - 1)));
        }
    }
}
