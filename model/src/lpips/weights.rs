//! Tensors of an LPIPS weights file, checked one by one.
use crate::error::{Error, Result};
use safetensors::{Dtype, SafeTensorError, SafeTensors};
use std::path::Path;

/// A parsed weights file.
pub struct Weights<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
}

impl<'a> Weights<'a> {
    pub fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self> {
        match SafeTensors::deserialize(bytes) {
            Ok(tensors) => Ok(Self { path, tensors }),
            Err(error) => Err(explain(path, bytes, &error)),
        }
    }

    /// The values of tensor `name`, which must be finite 32-bit floats of this shape.
    pub fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let tensor = self.tensors.tensor(name).map_err(|_| self.error(name, "is missing"))?;
        if tensor.dtype() != Dtype::F32 {
            return Err(self.error(name, format!("has element type {:?}, expected F32", tensor.dtype())));
        }
        if tensor.shape() != shape {
            return Err(self.error(name, format!("has shape {:?}, expected {shape:?}", tensor.shape())));
        }
        let values: Vec<f32> = bytemuck::pod_collect_to_vec(tensor.data());
        match values.iter().position(|v| !v.is_finite()) {
            Some(i) => Err(self.error(name, format!("element {i} is not finite"))),
            None => Ok(values),
        }
    }

    /// An error about tensor `name`.
    pub fn error(&self, name: &str, reason: impl Into<String>) -> Error {
        Error::Tensor { path: self.path.into(), tensor: name.into(), reason: reason.into() }
    }
}

/// An error that names the tensor that a cut-off file lacks, or the message of the parser.
fn explain(path: &Path, bytes: &[u8], error: &SafeTensorError) -> Error {
    if let Some((name, end, present)) = cut_off(bytes) {
        let reason = format!("ends at byte {end} of the data, but the file is cut off at byte {present}");
        return Error::Tensor { path: path.into(), tensor: name, reason };
    }
    Error::malformed(path, format!("is no safetensors file: {error}"))
}

/// The first tensor that reaches beyond the end of the file: its name, its end, and the number of bytes of data. The parser only
/// reports that the file is too short, so the header (a length and JSON) is read here again.
fn cut_off(bytes: &[u8]) -> Option<(String, u64, u64)> {
    let (length, rest) = bytes.split_first_chunk()?;
    let (header, data) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    let header: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(header).ok()?;
    let present = data.len() as u64;
    let ends = header.iter().filter_map(|(name, info)| Some((name, info.get("data_offsets")?.get(1)?.as_u64()?)));
    let (name, end) = ends.filter(|(_, end)| *end > present).min_by_key(|(_, end)| *end)?;
    Some((name.clone(), end, present))
}
