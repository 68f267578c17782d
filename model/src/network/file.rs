//! Weights files of a network whose header says its size.

use crate::parameters::{self, Parameter};
use crate::{Error, Result, weights};
use burn::module::Module;
use safetensors::SafeTensors;
use std::path::Path;

/// The parameters in a weights file of `bytes` bytes. `values` is the number of values that the network of its header has, and
/// `fresh` makes that network.
///
/// # Errors
/// When a tensor is missing, left over, of another shape or not finite, or when the header asks for more than the file has.
pub(crate) fn read<M: Module>(
    path: &Path,
    tensors: &SafeTensors,
    bytes: usize,
    values: usize,
    fresh: impl FnOnce() -> Result<M>,
) -> Result<Vec<Parameter>> {
    // The network is made before its tensors are compared, so a wrong header could ask for too much memory.
    let most = bytes / 2;
    if values > most {
        let reason = format!("the network its header describes has {values} values; {most} at most are in the file");
        return Err(Error::malformed(path, reason));
    }
    let fresh = parameters::export(&fresh()?);
    if let Some(extra) = tensors.names().into_iter().find(|name| fresh.iter().all(|parameter| parameter.name != **name)) {
        let reason = "not part of the network its header describes".into();
        return Err(Error::Tensor { path: path.into(), tensor: extra.to_owned(), reason });
    }
    let read = |parameter: Parameter| -> Result<Parameter> {
        let values = weights::read_tensor(path, tensors, &parameter.name, &parameter.shape)?;
        Ok(Parameter { values, ..parameter })
    };
    fresh.into_iter().map(read).collect()
}
