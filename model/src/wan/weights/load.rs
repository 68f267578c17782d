//! Loading weights from a file into a network.

use super::source::{ElementType, Source};
use crate::wan::names::{Entry, Layout, Named, Naming};
use crate::{Error, Result};
use burn::module::{ModuleMapper, Param, ParamId};
use burn::tensor::{Tensor, TensorData};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Most problems that a message lists. Further ones are counted.
const TOLD: usize = 10;

/// Allowed differences between a file and a network. By default there are none.
#[derive(Clone, Copy)]
pub struct LoadOptions<'a> {
    /// Accepts names of tensors in the file that the network does not have.
    pub ignore: &'a dyn Fn(&str) -> bool,
    /// Accepts diffusers names of tensors that may be missing in the file. They keep their initial values.
    pub may_lack: &'a dyn Fn(&str) -> bool,
}

impl Default for LoadOptions<'_> {
    fn default() -> Self {
        Self { ignore: &|_| false, may_lack: &|_| false }
    }
}

/// The result of loading a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadReport {
    /// The names that the file uses.
    pub naming: Naming,
    /// Number of tensors that were read.
    pub read: usize,
    /// Tensors of the file that were ignored.
    pub ignored: Vec<String>,
    /// Tensors of the network that kept their initial values.
    pub kept: Vec<String>,
}

/// Whether a tensor of a transformer is part of its text path, which RenderFlow's backbone does not have. The name is of either
/// naming.
pub fn is_text_path(name: &str) -> bool {
    let parts: Vec<&str> = name.split('.').collect();
    let in_block = matches!(parts.first(), Some(&"blocks" | &"vace_blocks"));
    match (in_block, parts.get(2)) {
        (true, Some(&part)) => matches!(part, "attn2" | "cross_attn" | "norm2" | "norm3"),
        _ => parts[0] == "text_embedding" || name.starts_with("condition_embedder.text_embedder."),
    }
}

/// Whether a tensor is part of VACE's context path.
pub fn is_context_path(name: &str) -> bool {
    name.starts_with("vace_")
}

/// Loads the weights in `source`, of either naming, into `network`. Initial weights that have not been made yet are not made.
///
/// # Errors
/// [`Error::Frame`] with the tensors that are missing, that the network does not have, or that have another shape or an
/// unusable number format. [`Error::Frame`] and [`Error::Tensor`] when reading fails or a value is not finite.
pub fn load<M: Named>(network: M, source: &Source, options: LoadOptions) -> Result<(M, LoadReport)> {
    let entries = network.entries();
    let (wanted, report) = fit(&entries, source, options)?;
    let mut mapper = Reader { source, naming: report.naming, wanted, failed: None };
    let network = network.map(&mut mapper);
    match mapper.failed {
        Some(error) => Err(error),
        None => Ok((network, report)),
    }
}

/// Finds the tensors of a network in `source`.
///
/// # Errors
/// [`Error::Frame`] as for [`load`].
pub(super) fn fit<'a>(
    entries: &'a [Entry],
    source: &Source,
    options: LoadOptions,
) -> Result<(HashMap<ParamId, &'a Entry>, LoadReport)> {
    let naming = naming(entries, source);
    let mut problems = Vec::new();
    let mut report = LoadReport { naming, read: 0, ignored: Vec::new(), kept: Vec::new() };
    let mut wanted: HashMap<ParamId, &Entry> = HashMap::with_capacity(entries.len());
    for entry in entries {
        let name = entry.name(naming);
        match (source.shape(name), source.element(name)) {
            (None, _) if (options.may_lack)(&entry.diffusers) => report.kept.push(entry.diffusers.clone()),
            (None, _) => problems.push(format!("{name} {:?} is missing", entry.shape)),
            (Some(shape), _) if shape != entry.shape => {
                problems.push(format!("{name} has the shape {shape:?} where {:?} is expected", entry.shape));
            }
            (_, Some(ElementType::Other)) => problems.push(format!("{name} is not of floating-point numbers")),
            _ => {
                wanted.insert(entry.id, entry);
            }
        }
    }
    let known: HashSet<&str> = entries.iter().map(|entry| entry.name(naming)).collect();
    for name in source.names().filter(|name| !known.contains(name)) {
        if (options.ignore)(name) {
            report.ignored.push(name.to_string());
        } else {
            problems.push(format!("{name} {:?} is not part of the network", source.shape(name).unwrap_or_default()));
        }
    }
    if !problems.is_empty() {
        return Err(refusal(source, &problems));
    }
    report.read = wanted.len();
    Ok((wanted, report))
}

/// The naming under which more tensors of the network are found.
fn naming(entries: &[Entry], source: &Source) -> Naming {
    let found = |naming| entries.iter().filter(|entry| source.shape(entry.name(naming)).is_some()).count();
    if found(Naming::Original) > found(Naming::Diffusers) { Naming::Original } else { Naming::Diffusers }
}

fn refusal(source: &Source, problems: &[String]) -> Error {
    let mut reason = match problems.len() {
        1 => "1 tensor does not fit the network:".to_string(),
        n => format!("{n} tensors do not fit the network:"),
    };
    for problem in problems.iter().take(TOLD) {
        reason += &format!("\n  {problem}");
    }
    if problems.len() > TOLD {
        reason += &format!("\n  and {} more", problems.len() - TOLD);
    }
    Error::malformed(source.path(), reason)
}

struct Reader<'a> {
    source: &'a Source,
    naming: Naming,
    wanted: HashMap<ParamId, &'a Entry>,
    failed: Option<Error>,
}

impl ModuleMapper for Reader<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let entry = match self.wanted.get(&param.id) {
            Some(entry) if self.failed.is_none() => entry,
            _ => return param,
        };
        match self.source.read(entry.name(self.naming)) {
            Ok(values) => {
                let values = to_memory(values, &entry.layout, &entry.memory);
                let tensor = Tensor::from_data(TensorData::new(values, entry.memory.clone()), &param.lazy_device());
                Param::initialized(param.id, tensor).set_require_grad(true)
            }
            Err(error) => {
                self.failed = Some(error);
                param
            }
        }
    }
}

/// Number of rows that are transposed together, so that their cache lines stay in use.
const BLOCK: usize = 64;

/// Reorders the values of a file to the order in memory.
fn to_memory(values: Vec<f32>, layout: &Layout, memory: &[usize]) -> Vec<f32> {
    let (Some(rows), Some(&out)) = (layout.rows(memory), memory.last()) else { return values };
    let count = rows.len();
    if out == 0 || count == 0 {
        return values;
    }
    let mut stored_row = vec![0; count];
    for (stored, &row) in rows.iter().enumerate() {
        stored_row[row as usize] = stored;
    }
    let mut result = vec![0.0; values.len()];
    result.par_chunks_mut(BLOCK * out).zip(stored_row.par_chunks(BLOCK)).for_each(|(block, rows)| {
        for o in 0..out {
            let from = &values[o * count..][..count];
            for (to, &row) in block.chunks_exact_mut(out).zip(rows) {
                to[o] = from[row];
            }
        }
    });
    result
}

/// Reorders values in memory to the order of a file.
pub(super) fn to_file(values: Vec<f32>, layout: &Layout, memory: &[usize]) -> Vec<f32> {
    let (Some(rows), Some(&out)) = (layout.rows(memory), memory.last()) else { return values };
    let count = rows.len();
    if out == 0 || count == 0 {
        return values;
    }
    let mut result = vec![0.0; values.len()];
    result.par_chunks_mut(count).enumerate().for_each(|(o, to)| {
        for (to, &row) in to.iter_mut().zip(&rows) {
            *to = values[row as usize * out + o];
        }
    });
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_order_and_memory_order_are_inverse() {
        for (layout, memory) in [
            (Layout::Kernel3, vec![3, 3, 3, 5, 70]),
            (Layout::Kernel2, vec![3, 3, 7, 2]),
            (Layout::Matrix { inner: vec![130] }, vec![130, 67]),
            (Layout::Vector { ones: 3 }, vec![9]),
        ] {
            let values: Vec<f32> = (0..memory.iter().product::<usize>()).map(|i| i as f32).collect();
            let there = to_memory(values.clone(), &layout, &memory);
            assert!(layout.rows(&memory).is_none() || there != values);
            assert_eq!(to_file(there, &layout, &memory), values);
        }
        let matrix = Layout::Matrix { inner: vec![3] };
        assert_eq!(to_memory(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], &matrix, &[3, 2]), [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]);
    }

    #[test]
    fn text_and_context_are_told_from_the_backbone() {
        for name in [
            "blocks.3.attn2.to_q.weight",
            "blocks.3.cross_attn.q.weight",
            "blocks.3.norm2.bias",
            "blocks.3.norm3.bias",
            "condition_embedder.text_embedder.linear_1.weight",
            "text_embedding.2.bias",
        ] {
            assert!(is_text_path(name), "{name}");
        }
        for name in ["blocks.3.attn1.norm_q.weight", "blocks.3.self_attn.q.bias", "head.head.weight", "patch_embedding.weight"] {
            assert!(!is_text_path(name) && !is_context_path(name), "{name}");
        }
        assert!(is_context_path("vace_patch_embedding.bias") && is_context_path("vace_blocks.0.proj_in.bias"));
    }
}
