//! Saving a network to a safetensors file, with its configuration and its provenance in the header.

use super::load::to_file;
use super::source::Source;
use crate::wan::config::{DitConfig, VaceConfig, VaeConfig};
use crate::wan::dit::Dit;
use crate::wan::flow::{Flow, FlowConfig};
use crate::wan::names::{Entry, Named, Naming};
use crate::wan::vace::Vace;
use crate::wan::vae::Vae;
use crate::weights::HEADER;
use crate::{Error, Result};
use burn::module::{ModuleVisitor, Param, ParamId};
use burn::tensor::{Device, Tensor};
use renderflow_frame::file::Draft;
use safetensors::tensor::{Dtype, View};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// The network in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", content = "config", rename_all = "kebab-case")]
pub enum Network {
    /// The autoencoder.
    WanVae(VaeConfig),
    /// The transformer.
    WanDit(DitConfig),
    /// The transformer with its context path.
    WanVace(VaceConfig),
    /// The renderer. The weights of its autoencoder are in another file.
    WanFlow(FlowConfig),
}

impl Network {
    /// Checks that the numbers describe a network.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::WanVae(config) => config.validate(),
            Self::WanDit(config) => config.validate(),
            Self::WanVace(config) => config.validate(),
            Self::WanFlow(config) => config.validate(),
        }
    }

    /// Every tensor of the network. No weights are made.
    ///
    /// # Errors
    /// When the configuration is invalid.
    pub fn entries(&self) -> Result<Vec<Entry>> {
        let device = Device::flex();
        Ok(match self {
            Self::WanVae(config) => Vae::new(config, 0, &device)?.entries(),
            Self::WanDit(config) => Dit::new(config, 0, &device)?.entries(),
            Self::WanVace(config) => Vace::new(config, 0, &device)?.entries(),
            Self::WanFlow(config) => Flow::new(config, 0, &device)?.entries(),
        })
    }

    /// Name for messages.
    pub fn name(&self) -> &'static str {
        match self {
            Self::WanVae(_) => "Wan autoencoder",
            Self::WanDit(_) => "Wan transformer",
            Self::WanVace(_) => "Wan transformer with VACE's context path",
            Self::WanFlow(_) => "renderer on Wan's transformer",
        }
    }
}

/// The history of weights.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Provenance {
    /// Files that the weights were read from, oldest first.
    pub sources: Vec<String>,
    /// Seed of initial weights that were drawn.
    pub seed: Option<u64>,
    /// Number of training steps since then.
    pub steps: u64,
    /// Version of the program that wrote the file.
    pub program: String,
}

/// The header of this program's files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The network.
    pub network: Network,
    /// Its provenance.
    pub provenance: Provenance,
}

/// Number format of stored weights.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// Half precision.
    F16,
    /// bfloat16, as in the published transformers.
    Bf16,
}

impl Source {
    /// The header of the file, or `None` for files of other programs.
    ///
    /// # Errors
    /// When the header does not describe a network of [`crate::wan`].
    pub fn header(&self) -> Result<Option<Header>> {
        let broken = |e: serde_json::Error| Error::malformed(self.path(), format!("header: {e}"));
        self.header_text().map(|text| serde_json::from_str(text).map_err(broken)).transpose()
    }
}

/// Writes `network` with the names of `naming`. Tensors are converted one at a time.
///
/// # Errors
/// When a value is not finite or too large for `precision` (the message names the tensor), or when the file cannot be written.
pub fn save<M: Named>(path: &Path, network: &M, header: &Header, precision: Precision, naming: Naming) -> Result<()> {
    let entries = network.entries();
    let by_id: HashMap<ParamId, &Entry> = entries.iter().map(|entry| (entry.id, entry)).collect();
    let mut writer = Writer { path, by_id, precision, naming, views: Vec::with_capacity(entries.len()), failed: None };
    network.visit(&mut writer);
    if let Some(error) = writer.failed {
        return Err(error);
    }
    write(path, writer.views, header, || Ok(()))
}

/// Writes a safetensors file of `views` with `header`. It replaces the file at its place only if `sound` returns no error at the
/// end.
pub(super) fn write(
    path: &Path,
    views: Vec<(String, impl View)>,
    header: &Header,
    sound: impl FnOnce() -> Result<()>,
) -> Result<()> {
    let text = serde_json::to_string(header).map_err(|e| Error::malformed(path, e.to_string()))?;
    let metadata = HashMap::from([(HEADER.to_string(), text)]);
    let draft = Draft::new(path)?;
    safetensors::serialize_to_file(views, Some(metadata), draft.temporary()).map_err(|e| match e {
        safetensors::SafeTensorError::IoError(e) => Error::io(path, "write")(e),
        e => Error::malformed(path, e.to_string()),
    })?;
    sound()?;
    Ok(draft.finish()?)
}

struct Writer<'a> {
    path: &'a Path,
    by_id: HashMap<ParamId, &'a Entry>,
    precision: Precision,
    naming: Naming,
    views: Vec<(String, LazyView<'a>)>,
    failed: Option<Error>,
}

impl ModuleVisitor for Writer<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let Some(&entry) = self.by_id.get(&param.id) else { return };
        let tensor = param.val().without_autodiff();
        let values = move || tensor.clone().into_data().iter::<f32>().collect::<Vec<f32>>();
        let most = self.precision.largest();
        let name = entry.name(self.naming).to_string();
        if let Some(value) = values().into_iter().find(|v| !v.is_finite() || v.abs() > most) {
            let reason = format!("value {value} cannot be stored");
            self.failed.get_or_insert(Error::Tensor { path: self.path.into(), tensor: name, reason });
            return;
        }
        self.views.push((name, LazyView { entry, precision: self.precision, values: Box::new(values) }));
    }
}

/// A tensor that is converted only when it is written.
struct LazyView<'a> {
    entry: &'a Entry,
    precision: Precision,
    values: Box<dyn Fn() -> Vec<f32>>,
}

impl View for LazyView<'_> {
    fn dtype(&self) -> Dtype {
        self.precision.dtype()
    }

    fn shape(&self) -> &[usize] {
        &self.entry.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        let values = to_file((self.values)(), &self.entry.layout, &self.entry.memory);
        Cow::Owned(self.precision.bytes(&values))
    }

    fn data_len(&self) -> usize {
        self.entry.parameters() as usize * self.precision.size()
    }
}
