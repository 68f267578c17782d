//! Names and layouts of a network's tensors in files: diffusers' and the original ones.

use burn::module::{Param, ParamId};
use burn::tensor::Tensor;

/// The order of a weight's axes in a file, relative to memory, where output channels come last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Layout {
    /// The order in memory.
    Same,
    /// A vector, followed by axes of length 1.
    Vector {
        /// Number of axes of length 1.
        ones: usize,
    },
    /// Memory `[in, out]`, file `[out, inner..]`, where the product of `inner` is `in`.
    Matrix {
        /// Lengths of the input axes in the file.
        inner: Vec<usize>,
    },
    /// Memory `[height, width, in, out]`, file `[out, in, height, width]`.
    Kernel2,
    /// Memory `[height, width, time, in, out]`, file `[out, in, time, height, width]`.
    Kernel3,
}

impl Layout {
    /// Shape in the file of a weight with the shape `memory`.
    pub fn stored_shape(&self, memory: &[usize]) -> Vec<usize> {
        match (self, memory) {
            (Self::Same, _) => memory.to_vec(),
            (Self::Vector { ones }, _) => memory.iter().copied().chain(std::iter::repeat_n(1, *ones)).collect(),
            (Self::Matrix { inner }, [.., out]) => std::iter::once(*out).chain(inner.iter().copied()).collect(),
            (Self::Kernel2, &[h, w, i, o]) => vec![o, i, h, w],
            (Self::Kernel3, &[h, w, t, i, o]) => vec![o, i, t, h, w],
            _ => memory.to_vec(),
        }
    }

    /// For each value of a stored row (one output channel), its row in memory. `None` if the orders agree.
    pub(crate) fn rows(&self, memory: &[usize]) -> Option<Vec<u32>> {
        match (self, memory) {
            (Self::Matrix { inner }, _) => Some((0..inner.iter().product::<usize>() as u32).collect()),
            (Self::Kernel2, &[h, w, i, _]) => Some(kernel_rows(h, w, 1, i)),
            (Self::Kernel3, &[h, w, t, i, _]) => Some(kernel_rows(h, w, t, i)),
            _ => None,
        }
    }
}

fn kernel_rows(h: usize, w: usize, t: usize, channels: usize) -> Vec<u32> {
    let mut rows = Vec::with_capacity(channels * t * h * w);
    for c in 0..channels {
        for k in 0..t {
            rows.extend((0..h * w).map(|yx| ((yx * t + k) * channels + c) as u32));
        }
    }
    rows
}

/// One tensor of a network.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The parameter.
    pub id: ParamId,
    /// Name in diffusers' files.
    pub diffusers: String,
    /// Name in the original files.
    pub original: String,
    /// Shape in both kinds of files.
    pub shape: Vec<usize>,
    /// Shape in memory.
    pub memory: Vec<usize>,
    /// Relation of the two shapes.
    pub layout: Layout,
}

impl Entry {
    /// Number of values.
    pub fn parameters(&self) -> u64 {
        self.shape.iter().map(|&n| n as u64).product()
    }

    /// Name under `naming`.
    pub fn name(&self, naming: Naming) -> &str {
        match naming {
            Naming::Diffusers => &self.diffusers,
            Naming::Original => &self.original,
        }
    }
}

/// The names that a file uses.
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Naming {
    /// The names of diffusers.
    #[default]
    Diffusers,
    /// The names of the original authors.
    Original,
}

/// Collects the tensors of a network in a fixed order.
#[derive(Debug)]
pub struct Listing {
    to_original: fn(&str) -> String,
    entries: Vec<Entry>,
}

impl Listing {
    pub(crate) fn new(to_original: fn(&str) -> String) -> Self {
        Self { to_original, entries: Vec::new() }
    }

    /// Adds a parameter by its diffusers name. Its values are not made.
    pub fn push<const D: usize>(&mut self, param: &Param<Tensor<D>>, name: String, layout: Layout) {
        let memory: Vec<usize> = param.lazy_shape().iter().copied().collect();
        let shape = layout.stored_shape(&memory);
        let original = (self.to_original)(&name);
        self.entries.push(Entry { id: param.id, diffusers: name, original, shape, memory, layout });
    }

    /// Adds what `add` lists under the prefix `diffusers`. In the original files the prefix is `original`.
    pub(crate) fn within(&mut self, diffusers: String, original: String, add: impl FnOnce(&mut Self, &str)) {
        let first = self.entries.len();
        add(self, &diffusers);
        for entry in &mut self.entries[first..] {
            if let Some(rest) = entry.diffusers.strip_prefix(&diffusers) {
                entry.original = (self.to_original)(&format!("{original}{rest}"));
            }
        }
    }

    pub(crate) fn into_entries(self) -> Vec<Entry> {
        self.entries
    }
}

/// A network whose tensors have names in published files.
pub trait Named: burn::module::Module {
    /// Every tensor with its names and shapes. No values are made, so listing takes little memory even for the largest network.
    fn entries(&self) -> Vec<Entry>;

    /// Number of values in all tensors.
    fn count(&self) -> u64 {
        self.entries().iter().map(Entry::parameters).sum()
    }
}

/// Replaces parts of a dotted name. Each rule holds some consecutive parts and their replacement.
fn replace_parts(name: &str, rules: &[(&str, &str)]) -> String {
    let parts: Vec<&str> = name.split('.').collect();
    let (mut out, mut at) = (Vec::new(), 0);
    while at < parts.len() {
        let rule = rules.iter().find_map(|(from, to)| {
            let from: Vec<&str> = from.split('.').collect();
            parts[at..].starts_with(&from).then_some((from.len(), *to))
        });
        let (length, part) = rule.unwrap_or((1, parts[at]));
        out.push(part);
        at += length;
    }
    out.join(".")
}

const DIT_TOP: &[(&str, &str)] = &[
    ("condition_embedder.time_embedder.linear_1", "time_embedding.0"),
    ("condition_embedder.time_embedder.linear_2", "time_embedding.2"),
    ("condition_embedder.time_proj", "time_projection.1"),
    ("condition_embedder.text_embedder.linear_1", "text_embedding.0"),
    ("condition_embedder.text_embedder.linear_2", "text_embedding.2"),
    ("scale_shift_table", "head.modulation"),
    ("proj_out", "head.head"),
];

const DIT_BLOCK: &[(&str, &str)] = &[
    ("attn1", "self_attn"),
    ("attn2", "cross_attn"),
    ("to_q", "q"),
    ("to_k", "k"),
    ("to_v", "v"),
    ("to_out.0", "o"),
    ("ffn.net.0.proj", "ffn.0"),
    ("ffn.net.2", "ffn.2"),
    // The two namings number the norms of a block differently. This norm comes before cross-attention.
    ("norm2", "norm3"),
    ("scale_shift_table", "modulation"),
    ("proj_in", "before_proj"),
    ("proj_out", "after_proj"),
];

/// The original name of a transformer's tensor.
pub fn dit_original(diffusers: &str) -> String {
    let in_block = diffusers.starts_with("blocks.") || diffusers.starts_with("vace_blocks.");
    replace_parts(diffusers, if in_block { DIT_BLOCK } else { DIT_TOP })
}

const VAE_PARTS: &[(&str, &str)] = &[
    ("quant_conv", "conv1"),
    ("post_quant_conv", "conv2"),
    ("encoder.conv_in", "encoder.conv1"),
    ("decoder.conv_in", "decoder.conv1"),
    ("down_blocks", "downsamples"),
    ("mid_block.resnets.0", "middle.0"),
    ("mid_block.attentions.0", "middle.1"),
    ("mid_block.resnets.1", "middle.2"),
    ("norm_out", "head.0"),
    ("conv_out", "head.2"),
    ("conv_shortcut", "shortcut"),
    ("norm1", "residual.0"),
    ("conv1", "residual.2"),
    ("norm2", "residual.3"),
    ("conv2", "residual.6"),
];

/// The original name of an autoencoder's tensor. The blocks of the decoder are named by [`Listing::within`] instead.
pub(crate) fn vae_original(diffusers: &str) -> String {
    replace_parts(diffusers, VAE_PARTS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_kernels_are_permuted_as_their_shapes_say() {
        // Each value encodes its place in the file. In memory it must be at the place that the layout determines.
        let (h, w, t, i, o) = (2, 3, 4, 5, 6);
        let rows = Layout::Kernel3.rows(&[h, w, t, i, o]).expect("permuted");
        for c in 0..i {
            for k in 0..t {
                for y in 0..h {
                    for x in 0..w {
                        let stored = ((c * t + k) * h + y) * w + x;
                        assert_eq!(rows[stored] as usize, ((y * w + x) * t + k) * i + c);
                    }
                }
            }
        }
        assert_eq!(Layout::Kernel3.stored_shape(&[h, w, t, i, o]), [o, i, t, h, w]);
        assert_eq!(Layout::Kernel2.stored_shape(&[h, w, i, o]), [o, i, h, w]);
        assert_eq!(Layout::Matrix { inner: vec![4, 1, 2] }.stored_shape(&[8, 7]), [7, 4, 1, 2]);
        assert_eq!(Layout::Vector { ones: 2 }.stored_shape(&[7]), [7, 1, 1]);
    }
}
