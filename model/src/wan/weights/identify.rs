//! Identification of the network in a file: by its header, else by the configuration beside it, else by the shapes of its
//! tensors.

use super::save::{Header, Network, Provenance};
use super::source::{Source, Table};
use crate::wan::config::{DitConfig, VaceConfig, VaeConfig};
use crate::wan::names::{Naming, dit_original, vae_original};
use crate::{Error, Result, fusion, inverse};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Channels of a head in every published transformer.
const HEAD_DIM: usize = 128;
/// Names of configuration files beside weights.
const CONFIG: &str = "config.json";

/// The content of a file.
#[derive(Clone, Debug, PartialEq)]
pub enum Identity {
    /// The fusion network of this program.
    Fusion(Box<fusion::render::Header>),
    /// The inverse network of this program.
    Inverse(Box<inverse::find::Header>),
    /// A network of [`crate::wan`], of this program or published.
    Wan(Box<Found>),
    /// Something else, with the reason in a sentence.
    Unknown(String),
}

/// A network of [`crate::wan`] in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// The network, and in files of this program its history.
    pub header: Header,
    /// The names that the file uses.
    pub naming: Naming,
    /// How the network was identified.
    pub evidence: Evidence,
    /// Sentences on what the evidence leaves open, and what was assumed.
    pub assumed: Vec<String>,
}

/// How a network was identified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// By the header of this program.
    Header,
    /// By a configuration beside the file.
    Config(PathBuf),
    /// By the shapes of the tensors.
    Shapes,
}

/// Identifies the network in `source`. [`super::load`] and [`super::convert`] check whether each tensor fits.
///
/// # Errors
/// When a header or a configuration cannot be read or contradicts itself.
pub fn identify(source: &Source) -> Result<Identity> {
    if let Some(text) = source.header_text() {
        let broken = |e: serde_json::Error| Error::malformed(source.path(), format!("header: {e}"));
        let value: serde_json::Value = serde_json::from_str(text).map_err(broken)?;
        if value.get("inverse").is_some() {
            return Ok(Identity::Inverse(Box::new(serde_json::from_value(value).map_err(broken)?)));
        }
        if value.pointer("/network/kind").is_none() {
            return Ok(Identity::Fusion(Box::new(serde_json::from_value(value).map_err(broken)?)));
        }
        let header: Header = serde_json::from_value(value).map_err(broken)?;
        header.network.validate().map_err(|e| Error::malformed(source.path(), format!("header: {e}")))?;
        let naming = naming(source);
        return Ok(Identity::Wan(Box::new(Found { header, naming, evidence: Evidence::Header, assumed: Vec::new() })));
    }
    let shape = Shapes { source };
    if shape.dit("patch_embedding.weight").is_some() && shape.dit("blocks.0.attn1.to_q.weight").is_some() {
        let vace = shape.dit("vace_patch_embedding.weight").is_some();
        published(
            source,
            |path| if vace { VaceConfig::read(path).map(Network::WanVace) } else { DitConfig::read(path).map(Network::WanDit) },
            || {
                let (dit, mut assumed) = shape.transformer()?;
                Ok((if vace { Network::WanVace(shape.context(dit, &mut assumed)?) } else { Network::WanDit(dit) }, assumed))
            },
        )
    } else if shape.vae("encoder.conv_in.weight").is_some() && shape.vae("post_quant_conv.weight").is_some() {
        published(
            source,
            |path| VaeConfig::read(path).map(Network::WanVae),
            || {
                let (vae, assumed) = shape.autoencoder()?;
                Ok((Network::WanVae(vae), assumed))
            },
        )
    } else {
        Ok(Identity::Unknown("no tensor names of a network of this program".into()))
    }
}

/// Identifies a file of another program by the configuration beside it, or by its shapes.
fn published(
    source: &Source,
    read: impl FnOnce(&std::path::Path) -> Result<Network>,
    from_shapes: impl FnOnce() -> std::result::Result<(Network, Vec<String>), String>,
) -> Result<Identity> {
    let config = source.path().parent().map(|folder| folder.join(CONFIG)).filter(|path| path.is_file());
    let (network, evidence, assumed) = match config {
        Some(path) => (read(&path)?, Evidence::Config(path), Vec::new()),
        None => match from_shapes() {
            Ok((network, assumed)) => (network, Evidence::Shapes, assumed),
            Err(reason) => return Ok(Identity::Unknown(reason)),
        },
    };
    if let Err(error) = network.validate() {
        return Ok(Identity::Unknown(format!("its shapes describe no network: {error}")));
    }
    let name = source.path().file_name().map(|name| name.to_string_lossy().into_owned());
    let provenance = Provenance { sources: name.into_iter().collect(), ..Provenance::default() };
    let header = Header { network, provenance };
    Ok(Identity::Wan(Box::new(Found { header, naming: naming(source), evidence, assumed })))
}

/// The naming of a file, from parts of names that only one naming has.
fn naming(source: &Source) -> Naming {
    let original = ["self_attn", "downsamples", "time_embedding", "head", "residual"];
    let is = |name: &str| name.split('.').any(|part| original.contains(&part));
    if source.names().any(is) { Naming::Original } else { Naming::Diffusers }
}

/// Shapes by diffusers name, for a file of either naming.
struct Shapes<'a> {
    source: &'a Source,
}

impl Shapes<'_> {
    fn dit(&self, name: &str) -> Option<&[usize]> {
        self.source.shape(name).or_else(|| self.source.shape(&dit_original(name)))
    }

    fn vae(&self, name: &str) -> Option<&[usize]> {
        self.source.shape(name).or_else(|| self.source.shape(&vae_original(name)))
    }

    fn transformer(&self) -> std::result::Result<(DitConfig, Vec<String>), String> {
        let axis = |name: &str, axis: usize| self.dit(name).and_then(|shape| shape.get(axis).copied());
        let need = |name: &str, at: usize| axis(name, at).ok_or_else(|| format!("a transformer without {name}"));
        let Some(&[width, in_channels, f, h, w]) = self.dit("patch_embedding.weight") else {
            return Err("patch_embedding.weight has not the five axes of a video transformer's".into());
        };
        if !width.is_multiple_of(HEAD_DIM) {
            return Err(format!("a transformer of {width} channels: how many heads it has is told by a {CONFIG} beside it only"));
        }
        let layers = (0..).take_while(|i| self.dit(&format!("blocks.{i}.attn1.to_q.weight")).is_some()).count();
        let values = (f * h * w).max(1);
        let published = DitConfig::wan_1_3b();
        let config = DitConfig {
            heads: width / HEAD_DIM,
            head_dim: HEAD_DIM,
            ffn_dim: need("blocks.0.ffn.net.0.proj.weight", 0)?,
            layers,
            text_dim: axis("condition_embedder.text_embedder.linear_1.weight", 1),
            freq_dim: need("condition_embedder.time_embedder.linear_1.weight", 1)?,
            in_channels,
            out_channels: need("proj_out.weight", 0)? / values,
            patch_size: [f, h, w],
            cross_attn_norm: self.dit("blocks.0.norm2.weight").is_some(),
            ..published
        };
        Ok((
            config,
            vec![format!("heads of {HEAD_DIM} channels, epsilons 1e-6, tanh GELU and base 10000 of the rotations, as published")],
        ))
    }

    fn context(&self, dit: DitConfig, assumed: &mut Vec<String>) -> std::result::Result<VaceConfig, String> {
        let count = (0..).take_while(|i| self.dit(&format!("vace_blocks.{i}.proj_out.weight")).is_some()).count();
        if count == 0 || !dit.layers.is_multiple_of(count) {
            let layers = dit.layers;
            return Err(format!(
                "{count} context blocks for {layers} blocks: which belong together is told by a {CONFIG} beside it only"
            ));
        }
        let every = dit.layers / count;
        assumed.push(format!("hints go to every block of {every}, from block 0"));
        let channels = self.dit("vace_patch_embedding.weight").and_then(|shape| shape.get(1).copied());
        Ok(VaceConfig {
            vace_layers: (0..dit.layers).step_by(every).collect(),
            vace_in_channels: channels.ok_or("vace_patch_embedding.weight has one axis")?,
            dit,
        })
    }

    fn autoencoder(&self) -> std::result::Result<(VaeConfig, Vec<String>), String> {
        let axis = |name: &str, axis: usize| self.vae(name).and_then(|shape| shape.get(axis).copied());
        let need = |name: &str, at: usize| axis(name, at).ok_or_else(|| format!("an autoencoder without {name}"));
        let base_dim = need("encoder.conv_in.weight", 0)?.max(1);
        let (mut widths, mut blocks, mut temporal_downsample) = (vec![base_dim], vec![0], Vec::new());
        for i in 0.. {
            let part = |part: &str| format!("encoder.down_blocks.{i}.{part}");
            let (Some(width), Some(count)) = (widths.last_mut(), blocks.last_mut()) else { break };
            if let Some(out) = axis(&part("conv1.weight"), 0) {
                (*width, *count) = (out, *count + 1);
            } else if self.vae(&part("resample.1.weight")).is_some() {
                temporal_downsample.push(self.vae(&part("time_conv.weight")).is_some());
                widths.push(widths[widths.len() - 1]);
                blocks.push(0);
            } else {
                break;
            }
        }
        if blocks.iter().any(|count| *count != blocks[0]) || widths.iter().any(|width| !width.is_multiple_of(base_dim)) {
            return Err(format!("an autoencoder of {blocks:?} blocks of {widths:?} channels, which no configuration describes"));
        }
        let dim_mult: Vec<usize> = widths.iter().map(|width| width / base_dim).collect();
        let z_dim = need("post_quant_conv.weight", 0)?;
        let published = VaeConfig::wan();
        let (latents_mean, latents_std, assumed) = if z_dim == published.z_dim {
            (published.latents_mean, published.latents_std, "latent statistics of Wan2.1")
        } else {
            (vec![0.0; z_dim], vec![1.0; z_dim], "latents are left as they are: no statistics are known")
        };
        let config = VaeConfig {
            base_dim,
            decoder_base_dim: need("decoder.norm_out.gamma", 0)? / dim_mult[0].max(1),
            z_dim,
            dim_mult,
            num_res_blocks: blocks[0],
            temporal_downsample,
            in_channels: need("encoder.conv_in.weight", 1)?,
            out_channels: need("decoder.conv_out.weight", 0)?,
            latents_mean,
            latents_std,
        };
        Ok((config, vec![assumed.into()]))
    }
}

impl Table {
    /// Number of tensors and values of each part of the network, by the first part of their names.
    pub fn parts(&self) -> Vec<(String, usize, u64)> {
        let mut parts: BTreeMap<&str, (usize, u64)> = BTreeMap::new();
        for row in &self.rows {
            let sum = parts.entry(row.name.split('.').next().unwrap_or_default()).or_default();
            *sum = (sum.0 + 1, sum.1 + row.parameters);
        }
        parts.into_iter().map(|(name, (tensors, parameters))| (name.to_string(), tensors, parameters)).collect()
    }
}
