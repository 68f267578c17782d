//! Weights files: safetensors with the network's configuration inside.

use crate::config::NetworkConfig;
use crate::network::Network;
use crate::parameters::{self, Parameter};
use crate::{Error, Result};
use burn::tensor::Device;
use half::f16;
use half::slice::HalfFloatSliceExt;
use renderflow_frame::file;
use renderflow_frame::words::plain;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;

/// Most bytes of weights that are read whole: a billion values in single precision.
pub(crate) const LARGEST: u64 = 4 << 30;

/// Key of the header entry in the file's metadata (a single one, so that the same weights give the same bytes).
pub(crate) const HEADER: &str = "renderflow";

/// What a weights file says about itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WeightsHeader {
    /// The network.
    pub network: NetworkConfig,
    /// Steps of base training behind the weights; 0 = untrained.
    pub steps: u64,
    /// Steps of keyframe training; 0 = none.
    #[serde(default)]
    pub keyframe_steps: u64,
    /// Seed of the training run.
    pub seed: u64,
}

/// Number format of stored weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Half precision: what ships.
    #[default]
    F16,
    /// Single precision.
    F32,
}

/// Encodes a weights file.
///
/// # Errors
/// When a value is not finite; the message names the tensor.
pub fn encode(header: &WeightsHeader, weights: &[Parameter], precision: Precision) -> Result<Vec<u8>> {
    let header = serde_json::to_string(header).map_err(|e| Error::malformed(TO_BE_WRITTEN, e.to_string()))?;
    encode_with(&header, weights, precision)
}

/// Names a file in messages that has no path yet.
const TO_BE_WRITTEN: &str = "weights to be written";

/// [`encode`] with any header.
pub(crate) fn encode_with(header: &str, weights: &[Parameter], precision: Precision) -> Result<Vec<u8>> {
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

/// A safetensors file with one metadata entry.
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

/// Parses a safetensors file that carries this project's header.
pub(crate) fn open<'a>(path: &Path, bytes: &'a [u8]) -> Result<(SafeTensors<'a>, String)> {
    let malformed = |e: safetensors::SafeTensorError| Error::malformed(path, format!("not a safetensors file: {e}"));
    let tensors = SafeTensors::deserialize(bytes).map_err(malformed)?;
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(malformed)?;
    let header = metadata.metadata().as_ref().and_then(|entries| entries.get(HEADER));
    let header = header
        .ok_or_else(|| Error::malformed(path, format!("no \"{HEADER}\" entry in the metadata: not weights of this program")))?;
    Ok((tensors, header.clone()))
}

/// Values of one tensor as f32, its shape checked.
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

/// A number of values that the network of a valid configuration has at least: its matrices between hidden layers.
fn least_values(config: &NetworkConfig) -> u64 {
    let conv = |from: usize, to: usize| 9 * from as u64 * to as u64;
    let dense = |from: usize, to: usize| from as u64 * to as u64;
    let residuals = |blocks: usize, width: usize| 2 * blocks as u64 * conv(width, width);
    let (widths, tokens, condition) = (config.widths, config.token_width, config.condition_width);
    let nexts = [widths[1], widths[2], tokens];
    let levels = (0..3).map(|level| {
        let (width, next) = (widths[level], nexts[level]);
        residuals(config.encoder_blocks[level] + config.decoder_blocks[level], width)
            + conv(width, next)
            + conv(next + width, width)
            + 2 * dense(condition, 2 * width)
    });
    // Queries, keys, values and outputs of two attentions, the perceptron, two modulations.
    let block = (8 + 2 * config.mlp_ratio as u64) * dense(tokens, tokens) + 2 * dense(condition, 2 * tokens);
    let environment = dense(tokens, tokens) + dense(tokens, condition) + dense(condition, condition);
    let keyframes = config.keyframes.as_ref().map_or(0, |keyframes| {
        let [half, quarter, eighth] = keyframes.widths;
        let passes = conv(half, quarter) + conv(quarter, eighth) + conv(eighth + quarter, quarter) + conv(quarter + half, half);
        passes + residuals(2, half) + residuals(2, quarter) + residuals(2, eighth)
    });
    levels.sum::<u64>() + config.transformer_blocks as u64 * block + environment + keyframes
}

/// Decodes a weights file; `path` stands in errors.
///
/// # Errors
/// When the bytes are no weights file, or a tensor is missing, superfluous or of another shape; the message names file and tensor.
pub fn decode(path: &Path, bytes: &[u8], device: &Device) -> Result<(Network, WeightsHeader)> {
    let (tensors, header) = open(path, bytes)?;
    let header: WeightsHeader =
        serde_json::from_str(&header).map_err(|e| Error::malformed(path, format!("header: {}", plain(&e.to_string()))))?;
    header.network.validate().map_err(|e| Error::malformed(path, format!("header: {e}")))?;
    // The network is made before its tensors are compared: a header of 200 bytes could ask for a hundred gigabytes.
    let (least, most) = (least_values(&header.network), bytes.len() as u64 / 2);
    if least > most {
        let reason = format!("the network its header describes has more than {least} values; {most} at most are in the file");
        return Err(Error::malformed(path, reason));
    }
    let network = Network::new(&header.network, 0, device)?;
    let expected = parameters::export(&network);
    let mut values = Vec::with_capacity(expected.len());
    for parameter in &expected {
        values.push(read_tensor(path, &tensors, &parameter.name, &parameter.shape)?);
    }
    if let Some(extra) = tensors.names().into_iter().find(|&name| expected.iter().all(|p| p.name != *name)) {
        return Err(Error::Tensor {
            path: path.into(),
            tensor: extra.to_string(),
            reason: "not part of the network its header describes".into(),
        });
    }
    let values: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
    Ok((parameters::import(network, &values, device), header))
}

/// Reads a weights file.
///
/// # Errors
/// As [`decode`], and when the file cannot be read.
pub fn load(path: &Path, device: &Device) -> Result<(Network, WeightsHeader)> {
    let bytes = file::read_at_most(path, LARGEST).map_err(Error::unreadable)?;
    decode(path, &bytes, device)
}

/// Writes a weights file, beside its place and renamed.
///
/// # Errors
/// As [`encode`], and when the file cannot be written.
pub fn save(path: &Path, header: &WeightsHeader, weights: &[Parameter], precision: Precision) -> Result<()> {
    Ok(renderflow_frame::file::write_atomic(path, &encode(header, weights, precision)?)?)
}

/// Writes the weights of one file to another in `precision`; what they say about themselves is kept.
///
/// # Errors
/// As [`load`] and [`save`].
pub fn convert(from: &Path, to: &Path, precision: Precision) -> Result<()> {
    let (network, header) = load(from, &Device::flex())?;
    save(to, &header, &parameters::export(&network), precision)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The least is close to the truth, and never above it.
    #[test]
    fn a_network_has_the_values_counted_for_it() {
        let plain = NetworkConfig { encoder_blocks: [0, 2, 1], mlp_ratio: 5, ..NetworkConfig::tiny() };
        let keyframes = NetworkConfig { keyframes: Some(Default::default()), ..NetworkConfig::default() };
        for config in [NetworkConfig::tiny(), plain, NetworkConfig::default(), keyframes] {
            let network = Network::new(&config, 0, &Device::flex()).expect("a valid network");
            let all: usize = parameters::export(&network).iter().map(|p| p.values.len()).sum();
            let (least, all) = (least_values(&config), all as u64);
            assert!(least <= all && 10 * least >= 7 * all, "{least} counted of {all}");
        }
    }
}
