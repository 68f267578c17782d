//! Networks from files: this program's own, and published ones to begin with.

use super::load::{LoadOptions, LoadReport, is_context_path, is_text_path, load};
use super::save::{Header, Network, Provenance};
use super::source::Source;
use crate::wan::config::VaeConfig;
use crate::wan::flow::{BUFFERS, Flow, FlowConfig, Group};
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
    /// Reads a renderer that was saved with [`super::save()`] under [`Network::WanFlow`]. `change` may add or leave out adapters: one
    /// that the file lacks begins as in [`Self::new`] with `seed` (the inverse adapter's embedder with the file's embedder of albedo),
    /// one that the configuration lacks is not read.
    ///
    /// # Errors
    /// When the file holds something else, the configuration is changed in another way, or tensors do not fit; they are named.
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

    /// A renderer that begins with published weights: the transformer of Wan2.1 or VACE in `base`, and the embedder of VACE's context
    /// in `context`, or in `base` itself if that has one. What files lack begins so:
    ///
    /// - attribute embedder: the channels of the masked reference from VACE's `vace_patch_embedding`, or 0; all others 0;
    /// - embedders of environment and inverse adapter: copies of the albedo's, which is the transformer's;
    /// - projections of the environment: 0, so that at first the blocks run as published;
    /// - keyframe and inverse adapter: as in [`Self::new`] with `seed`; what they add to the tokens is 0 at first.
    ///
    /// # Errors
    /// When a tensor of the backbone is missing, a tensor is unknown or of another shape; they are named.
    pub fn adopt(
        config: &FlowConfig,
        base: &Source,
        context: Option<&Source>,
        seed: u64,
        device: &Device,
    ) -> Result<(Self, Adoption)> {
        let network = Self::new(config, seed, device)?;
        let entries = network.entries();
        // The backbone is what the transformer lists, whatever else a file may be lacking.
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
            adoption.zeroed.push(format!("attribute_embedding, last {} channels", BUFFERS * config.vae.z_dim));
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

    /// Begins the embedder of the inverse adapter with that of the albedo; `false` when there is no such adapter.
    fn copy_albedo_to_inverse(&mut self) -> bool {
        let copied = self.inverse.as_mut().map(|adapter| adapter.embed = self.dit.patch.copy());
        copied.is_some()
    }
}

/// VACE's embedder, under either naming.
const CONTEXT_WEIGHT: &str = "vace_patch_embedding.weight";
const CONTEXT_BIAS: &str = "vace_patch_embedding.bias";

/// Values of a tensor of this shape.
fn read(source: &Source, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
    match source.shape(name) {
        Some(found) if found != shape => {
            let reason = format!("has the shape {found:?} where {shape:?} is expected");
            Err(Error::Tensor { path: source.path().into(), tensor: name.into(), reason })
        }
        _ => source.read(name),
    }
}

/// A parameter of these values in place of another of the same shape.
fn given<const D: usize>(old: &Param<Tensor<D>>, values: Vec<f32>) -> Param<Tensor<D>> {
    let data = TensorData::new(values, old.lazy_shape());
    Param::initialized(old.id, Tensor::from_data(data, &old.lazy_device())).set_require_grad(true)
}

/// What became of the files a renderer began with; displays as a list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Adoption {
    /// Tensors of the backbone that were read.
    pub read: usize,
    /// Tensors of the file that the renderer does not need: text and VACE's context blocks.
    pub ignored: Vec<String>,
    /// What was copied, and from where.
    pub copied: Vec<(String, String)>,
    /// What is 0.
    pub zeroed: Vec<String>,
    /// What was drawn from the seed.
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
