//! Weights files of this program: safetensors with a header in JSON.

use crate::parameters::Parameter;
use crate::{Error, Result};
use half::f16;
use half::slice::HalfFloatSliceExt;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// Key of the header in the file's metadata. It is the only entry, so that equal weights give equal bytes.
pub(crate) const HEADER: &str = "renderflow";

/// Number format of stored weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Half precision, as in the built-in weights.
    #[default]
    F16,
    /// Single precision.
    F32,
}

/// Name for messages of a file that has no path yet.
const TO_BE_WRITTEN: &str = "weights to be written";

/// Encodes a weights file with a header.
///
/// # Errors
/// When a value is not finite. The message names the tensor.
pub(crate) fn encode(header: &str, weights: &[Parameter], precision: Precision) -> Result<Vec<u8>> {
    let path = Path::new(TO_BE_WRITTEN);
    let mut blobs = Vec::with_capacity(weights.len());
    for parameter in weights {
        if let Some(value) = parameter.values.iter().find(|v| !v.is_finite() || v.abs() > f16::MAX.to_f32()) {
            let reason = format!("value {value} cannot be stored");
            return Err(Error::Tensor { path: path.into(), tensor: parameter.name.clone(), reason });
        }
        blobs.push(match precision {
            Precision::F16 => parameter.values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect::<Vec<u8>>(),
            Precision::F32 => parameter.values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        });
    }
    let dtype = match precision {
        Precision::F16 => Dtype::F16,
        Precision::F32 => Dtype::F32,
    };
    write_safetensors(
        path,
        header,
        weights.iter().zip(&blobs).map(|(p, blob)| (p.name.as_str(), dtype, p.shape.as_slice(), blob.as_slice())),
    )
}

/// Encodes a safetensors file with a header.
pub(crate) fn write_safetensors<'a>(
    path: &Path,
    header: &str,
    tensors: impl Iterator<Item = (&'a str, Dtype, &'a [usize], &'a [u8])>,
) -> Result<Vec<u8>> {
    let mut views = Vec::new();
    for (name, dtype, shape, bytes) in tensors {
        let view = TensorView::new(dtype, shape.to_vec(), bytes).map_err(|e| Error::Tensor {
            path: path.into(),
            tensor: name.into(),
            reason: e.to_string(),
        })?;
        views.push((name, view));
    }
    let metadata = HashMap::from([(HEADER.to_string(), header.to_string())]);
    safetensors::serialize(views, Some(metadata)).map_err(|e| Error::malformed(path, e.to_string()))
}

/// Parses a safetensors file with a header of this program, and returns its tensors and the header.
pub(crate) fn open<'a>(path: &Path, bytes: &'a [u8]) -> Result<(SafeTensors<'a>, String)> {
    let malformed = |e: safetensors::SafeTensorError| Error::malformed(path, format!("not a safetensors file: {e}"));
    let tensors = SafeTensors::deserialize(bytes).map_err(malformed)?;
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(malformed)?;
    let header = metadata.metadata().as_ref().and_then(|entries| entries.get(HEADER));
    let header = header.ok_or_else(|| {
        Error::malformed(path, format!("no \"{HEADER}\" entry in the metadata: it does not hold weights of this program"))
    })?;
    Ok((tensors, header.clone()))
}

/// The values of a tensor as f32. Its shape must be `shape`.
pub(crate) fn read_tensor(path: &Path, tensors: &SafeTensors, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
    let broken = |reason: String| Error::Tensor { path: path.into(), tensor: name.into(), reason };
    let view = tensors.tensor(name).map_err(|_| broken("missing".into()))?;
    if view.shape() != shape {
        return Err(broken(format!("shape {:?} where {shape:?} is expected", view.shape())));
    }
    let values: Vec<f32> = match view.dtype() {
        Dtype::F16 => {
            let halves: Vec<f16> = view.data().chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]])).collect();
            let mut out = vec![0.0; halves.len()];
            halves.convert_to_f32_slice(&mut out);
            out
        }
        Dtype::F32 => view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
        other => return Err(broken(format!("element type {other:?} where f16 or f32 is expected"))),
    };
    if values.iter().any(|v| !v.is_finite()) {
        return Err(broken("holds NaN or infinity".into()));
    }
    Ok(values)
}
