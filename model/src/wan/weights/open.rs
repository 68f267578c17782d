//! Networks from files: this program's own, and published ones to begin with.

use super::load::{LoadOptions, LoadReport, is_context_path, is_text_path, load};
use super::save::{Header, Network, Provenance};
use super::source::Source;
use crate::wan::config::VaeConfig;
use crate::wan::flow::{Flow, FlowConfig, Group};
use crate::wan::names::{Entry, Named};
use crate::wan::vae::Vae;
use crate::{Error, Result};
use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};
use std::collections::HashSet;
use std::fmt;
use std::path::Path;

impl Vae {
    /// Reads an autoencoder from a file of this program, or from published weights of the configuration `published`.
    ///
    /// # Errors
    /// When the file cannot be read, when it holds another network, or when its tensors do not fit.
    pub fn open(path: &Path, published: &VaeConfig, device: &Device) -> Result<(Self, Provenance)> {
        let source = Source::open(path)?;
        let (config, mut provenance) = match source.header()? {
            Some(Header { network: Network::WanVae(config), provenance }) => (config, provenance),
            Some(_) => return Err(Error::malformed(path, "holds another network, not an autoencoder")),
            None => (published.clone(), Provenance::default()),
        };
        let (vae, _) = load(Self::new(&config, 0, device)?, &source, LoadOptions::default())?;
        provenance.sources.push(path.display().to_string());
        Ok((vae, provenance))
    }
}

impl Flow {
    /// Reads a renderer that was saved with [`super::save()`] as [`Network::WanFlow`]. `change` may add adapters to the
    /// configuration or remove them. An adapter that the file lacks begins as in [`Self::new`] with `seed`, but the embedder of
    /// the inverse adapter begins with the file's embedder of albedo. An adapter that the configuration lacks is not read.
    ///
    /// # Errors
    /// When the file holds something else, when the configuration is changed in another way, or when tensors do not fit. The
    /// message names the tensors.
    pub fn read(
        source: &Source,
        change: impl FnOnce(FlowConfig) -> FlowConfig,
        seed: u64,
        device: &Device,
    ) -> Result<(Self, Header, LoadReport)> {
        let malformed = |reason: &str| Error::malformed(source.path(), reason);
        let header =
            source.header()?.ok_or_else(|| malformed("not a file of this program; begin with published weights instead"))?;
        let Network::WanFlow(stored) = &header.network else {
            return Err(malformed("holds another network than the renderer"));
        };
        let config = change(stored.clone());
        let base = |config: &FlowConfig| FlowConfig { keyframes: None, inverse: None, ..config.clone() };
        if base(&config) != base(stored) {
            return Err(malformed("its renderer is of another configuration; only adapters can be added or left out"));
        }
        for (option, differs) in [
            ("keyframes", config.keyframes.is_some() && stored.keyframes.is_some() && config.keyframes != stored.keyframes),
            ("inverse", config.inverse.is_some() && stored.inverse.is_some() && config.inverse != stored.inverse),
        ] {
            if differs {
                return Err(malformed(&format!("its {option} adapter is of another configuration")));
            }
        }
        let has = |config: &FlowConfig, group| match group {
            Group::Base => true,
            Group::Keyframes => config.keyframes.is_some(),
            Group::Inverse => config.inverse.is_some(),
        };
        let options = LoadOptions {
            ignore: &|name| has(stored, Group::of_tensor(name)) && !has(&config, Group::of_tensor(name)),
            may_lack: &|name| !has(stored, Group::of_tensor(name)),
        };
        let (mut flow, report) = load(Self::new(&config, seed, device)?, source, options)?;
        if stored.inverse.is_none() {
            flow.copy_albedo_to_inverse();
        }
        Ok((flow, Header { network: Network::WanFlow(config), ..header }, report))
    }

    /// A renderer that begins with published weights: the transformer of Wan2.1 or VACE in `base`, and the embedder of VACE's
    /// context in `context`, or in `base` if it has one. The other parts begin as follows:
    ///
    /// - attribute embedder: the channels of the masked reference come from VACE's `vace_patch_embedding`, or are 0; all others
    ///   are 0;
    /// - embedders of environment and inverse adapter: copies of the albedo's embedder, which is the transformer's;
    /// - projections of the environment: 0, so that the blocks run as published before training;
    /// - keyframe and inverse adapter: as in [`Self::new`] with `seed`; before training they add 0 to the tokens.
    ///
    /// # Errors
    /// When a tensor of the backbone is missing, or when a tensor is unknown or has another shape. The message names the tensors.
    pub fn adopt(
        config: &FlowConfig,
        base: &Source,
        context: Option<&Source>,
        seed: u64,
        device: &Device,
    ) -> Result<(Self, Adoption)> {
        let network = Self::new(config, seed, device)?;
        let entries = network.entries();
        // The tensors of the transformer are the backbone, which the file must have.
        let backbone: HashSet<String> = network.dit.entries().into_iter().map(|e| e.diffusers).collect();
        let own = |entry: &&Entry| !backbone.contains(&entry.diffusers) && base.shape(&entry.diffusers).is_some();
        if let Some(entry) = entries.iter().find(own) {
            let reason = format!("holds {}: it is a renderer already, not weights to begin one with", entry.diffusers);
            return Err(Error::malformed(base.path(), reason));
        }
        let options = LoadOptions {
            ignore: &|name| is_text_path(name) || is_context_path(name),
            may_lack: &|name| !backbone.contains(name),
        };
        let (mut flow, report) = load(network, base, options)?;
        let mut adoption = Adoption { read: report.read, ignored: report.ignored, ..Adoption::default() };

        let width = config.dit.width();
        let reference = config.reference_channels() * config.dit.patch_values();
        let rows = config.attribute_channels() * config.dit.patch_values();
        let mut weight = vec![0.0; rows * width];
        let mut bias = vec![0.0; width];
        let holder = [context, Some(base)].into_iter().flatten().find(|source| source.shape(CONTEXT_WEIGHT).is_some());
        if let Some(source) = holder {
            let [pf, ph, pw] = config.dit.patch_size;
            let stored = read(source, CONTEXT_WEIGHT, &[width, config.reference_channels(), pf, ph, pw])?;
            for (out, row) in stored.chunks_exact(reference).enumerate() {
                row.iter().enumerate().for_each(|(i, &value)| weight[i * width + out] = value);
            }
            bias = read(source, CONTEXT_BIAS, &[width])?;
            let place = format!("{CONTEXT_WEIGHT} of {}", source.path().display());
            adoption.copied.push((format!("attribute_embedding, first {} channels", config.reference_channels()), place));
            adoption.zeroed.push(format!("attribute_embedding, last {} channels", config.buffer_channels()));
        } else if let Some(source) = context {
            return Err(Error::Tensor { path: source.path().into(), tensor: CONTEXT_WEIGHT.into(), reason: "missing".into() });
        } else {
            adoption.zeroed.push("attribute_embedding".into());
        }
        flow.attributes.weight = given(&flow.attributes.weight, weight);
        flow.attributes.bias = given(&flow.attributes.bias, bias);
        let albedo = "patch_embedding".to_string();
        flow.environment.embed = flow.dit.patch.copy();
        adoption.copied.push(("environment_embedding".into(), albedo.clone()));
        if flow.copy_albedo_to_inverse() {
            adoption.copied.push(("inverse_embedding".into(), albedo));
        }
        adoption.zeroed.push("blocks.*.environment_proj".into());
        for (group, name) in [(Group::Keyframes, "keyframe adapter"), (Group::Inverse, "inverse adapter")] {
            if entries.iter().any(|entry| Group::of_tensor(&entry.diffusers) == group) {
                adoption.drawn.push(format!("{name}, with its output 0"));
            }
        }
        Ok((flow, adoption))
    }

    /// Copies the albedo's embedder to the inverse adapter. Returns `false` if there is no such adapter.
    fn copy_albedo_to_inverse(&mut self) -> bool {
        let copied = self.inverse.as_mut().map(|adapter| adapter.embed = self.dit.patch.copy());
        copied.is_some()
    }
}

/// Name of the weights of VACE's embedder in either naming.
const CONTEXT_WEIGHT: &str = "vace_patch_embedding.weight";
const CONTEXT_BIAS: &str = "vace_patch_embedding.bias";

/// Reads a tensor that must have this shape.
fn read(source: &Source, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
    match source.shape(name) {
        Some(found) if found != shape => {
            let reason = format!("has the shape {found:?} where {shape:?} is expected");
            Err(Error::Tensor { path: source.path().into(), tensor: name.into(), reason })
        }
        _ => source.read(name),
    }
}

/// A parameter with these values, in place of another of the same shape.
fn given<const D: usize>(old: &Param<Tensor<D>>, values: Vec<f32>) -> Param<Tensor<D>> {
    let data = TensorData::new(values, old.lazy_shape());
    Param::initialized(old.id, Tensor::from_data(data, &old.lazy_device())).set_require_grad(true)
}

/// How each part of a renderer began. It displays as a list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Adoption {
    /// Number of tensors of the backbone that were read.
    pub read: usize,
    /// Tensors of the file that the renderer does not have: the text path and VACE's context blocks.
    pub ignored: Vec<String>,
    /// Parts that were copied, and their sources.
    pub copied: Vec<(String, String)>,
    /// Parts that are 0.
    pub zeroed: Vec<String>,
    /// Parts that were drawn from the seed.
    pub drawn: Vec<String>,
}

impl fmt::Display for Adoption {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} tensors read, {} not needed", self.read, self.ignored.len())?;
        self.copied.iter().try_for_each(|(what, from)| write!(f, "\n{what}: copied from {from}"))?;
        self.zeroed.iter().try_for_each(|what| write!(f, "\n{what}: 0"))?;
        self.drawn.iter().try_for_each(|what| write!(f, "\n{what}: drawn"))
    }
}
