//! Conversion of a weights file, tensor by tensor: names, number format and shards change, and values stay the same. The network
//! itself is not made, so memory holds two copies of the largest tensor.

use super::load::{self, LoadOptions, LoadReport};
use super::save::{Header, Network, Precision, write};
use super::source::Source;
use crate::wan::names::{Entry, Naming};
use crate::{Error, Result};
use half::{bf16, f16};
use safetensors::tensor::{Dtype, View};
use std::borrow::Cow;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Writes the network that `header` describes from `source` to the safetensors file `path`, with the names of `naming`.
///
/// # Errors
/// When a tensor does not fit the network (as for [`super::load`]), when a value cannot be stored in `precision`, or when a file
/// cannot be read or written. The message names the tensor.
pub fn convert(source: &Source, path: &Path, header: &Header, precision: Precision, naming: Naming) -> Result<LoadReport> {
    let entries = header.network.entries()?;
    let (wanted, report) = load::fit(&entries, source, LoadOptions::default())?;
    let failed = Mutex::new(None);
    let views = entries.iter().filter(|entry| wanted.contains_key(&entry.id)).map(|entry| {
        let view = Copied { source, entry, from: report.naming, path, precision, failed: &failed };
        (entry.name(naming).to_string(), view)
    });
    let sound = || failed.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err);
    write(path, views.collect(), header, sound)?;
    Ok(report)
}

/// Checks that `source` holds every tensor of `network` and no others.
///
/// # Errors
/// When a tensor does not fit, as for [`super::load`].
pub fn check(source: &Source, network: &Network) -> Result<LoadReport> {
    Ok(load::fit(&network.entries()?, source, LoadOptions::default())?.1)
}

/// A tensor of `source` that is read only when it is written.
struct Copied<'a> {
    source: &'a Source,
    entry: &'a Entry,
    from: Naming,
    path: &'a Path,
    precision: Precision,
    /// The first error. The writer asks for bytes and cannot receive errors.
    failed: &'a Mutex<Option<Error>>,
}

impl Copied<'_> {
    fn values(&self) -> Result<Vec<f32>> {
        let name = self.entry.name(self.from);
        let values = self.source.read(name)?;
        let most = self.precision.largest();
        match values.iter().find(|v| v.abs() > most) {
            Some(value) => {
                let reason = format!("value {value} cannot be stored");
                Err(Error::Tensor { path: self.path.into(), tensor: name.into(), reason })
            }
            None => Ok(values),
        }
    }
}

impl View for Copied<'_> {
    fn dtype(&self) -> Dtype {
        self.precision.dtype()
    }

    fn shape(&self) -> &[usize] {
        &self.entry.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        let values = self.values().unwrap_or_else(|error| {
            self.failed.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            vec![0.0; self.entry.parameters() as usize]
        });
        Cow::Owned(self.precision.bytes(&values))
    }

    fn data_len(&self) -> usize {
        self.entry.parameters() as usize * self.precision.size()
    }
}

impl Precision {
    pub(super) fn dtype(self) -> Dtype {
        match self {
            Self::F32 => Dtype::F32,
            Self::F16 => Dtype::F16,
            Self::Bf16 => Dtype::BF16,
        }
    }

    /// Largest value of the format.
    pub(super) fn largest(self) -> f32 {
        match self {
            Self::F32 => f32::MAX,
            Self::F16 => f16::MAX.to_f32(),
            Self::Bf16 => bf16::MAX.to_f32(),
        }
    }

    /// Bytes per value.
    pub(super) fn size(self) -> usize {
        if self == Self::F32 { 4 } else { 2 }
    }

    /// Encodes values, rounded to the nearest.
    pub(super) fn bytes(self, values: &[f32]) -> Vec<u8> {
        match self {
            Self::F32 => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
            Self::F16 => values.iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect(),
            Self::Bf16 => values.iter().flat_map(|&v| bf16::from_f32(v).to_le_bytes()).collect(),
        }
    }
}
