//! WebDataset shards: tar files of equal numbers of samples, with counts and hashes in a manifest.
//!
//! `OUT/<split>-000000.tar`, ... hold a sample a frame, `seq-000123_0007.{exr|rff, json}`; `OUT/<split>-sequences.tar` holds a
//! sample a sequence, `seq-000123.{hdr, json}`: what its frames share. Base names have no dot, because readers cut them at the
//! first one. Samples lie in the order of sequences and frames: clips can be read as they come, and everything else shuffles
//! shards and samples. The same dataset gives the same bytes.
//!
//! The folder belongs to this program: it was empty at first, and `manifest.json` (`unfinished.json` while there is work left)
//! carries a seal, a hash of all it says. A list that was edited is refused. Only shards that a sealed list names are ever
//! removed, and only where the file is the one the list describes, by size and hash.

pub mod list;
mod sample;
mod verify;
mod write;

pub use verify::verify;

use super::sequence::Sequence;
use super::whole;
use crate::util::cancel::Cancel;
use crate::util::output::Hold;
use crate::util::progress::Progress;
use anyhow::{Context, Result};
use clap::ValueEnum;
use renderflow_frame::file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// File name of the manifest of shards.
pub const MANIFEST: &str = "manifest.json";
/// The program and its version, as its files have them.
const PROGRAM: &str = concat!("renderflow ", env!("CARGO_PKG_VERSION"));
/// File name of the list of shards of a run that did not come to its end.
const UNFINISHED: &str = "unfinished.json";

/// Form of the frames in shards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Frames {
    /// The files as they are
    #[default]
    Stored,
    /// The compact training profile; OpenEXR files are converted
    Compact,
}

/// What is in a folder of shards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Format version, 1.
    pub version: u32,
    /// The program that made it.
    pub program: String,
    /// BLAKE3 of the dataset's own manifest, where it has one.
    pub dataset: Option<String>,
    /// Form of the frames.
    pub profile: Frames,
    /// Samples in each shard but the last of a split.
    pub samples_per_shard: u32,
    /// Frames by split.
    pub samples: BTreeMap<String, u64>,
    /// Sequences by split.
    pub sequences: BTreeMap<String, u64>,
    /// The shards; in each split, the shard of its sequences comes last.
    pub shards: Vec<Shard>,
    /// BLAKE3 of all this, hexadecimal; empty in folders of earlier versions.
    #[serde(default)]
    pub seal: String,
}

/// One tar file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shard {
    /// File name.
    pub file: String,
    /// `frames` or `sequences`.
    pub kind: Kind,
    /// Split of all its samples.
    pub split: String,
    /// Number of samples.
    pub samples: u64,
    /// First and last key.
    pub keys: [String; 2],
    /// Length of the file.
    pub bytes: u64,
    /// Of the file.
    pub blake3: String,
    /// BLAKE3 of what it was made from: keys, hashes of the files, profile.
    pub source: String,
}

/// What the samples of a shard are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// One a frame.
    Frames,
    /// One a sequence.
    Sequences,
}

/// One shard to write.
struct Planned<'a> {
    file: String,
    kind: Kind,
    split: &'static str,
    /// Sequence and index of each frame, or sequence and 0.
    samples: Vec<(&'a Sequence, usize)>,
}

/// The shards of a dataset, in the order of the manifest.
fn plan(sequences: &[Sequence], samples_per_shard: usize) -> Vec<Planned<'_>> {
    let mut planned = Vec::new();
    for split in sequences.chunk_by(|a, b| a.split == b.split) {
        let name = split[0].split.name();
        let frames: Vec<_> = split.iter().flat_map(|s| (0..s.numbers.len()).map(move |index| (s, index))).collect();
        for (number, samples) in frames.chunks(samples_per_shard).enumerate() {
            let file = format!("{name}-{number:06}.tar");
            planned.push(Planned { file, kind: Kind::Frames, split: name, samples: samples.to_vec() });
        }
        let samples = split.iter().map(|s| (s, 0)).collect();
        planned.push(Planned { file: format!("{name}-sequences.tar"), kind: Kind::Sequences, split: name, samples });
    }
    planned
}

/// Packs the dataset in `dataset` into `out`.
///
/// # Errors
/// When the dataset is not complete, a frame is missing or not the one its sequence recorded, or a file cannot be written; when
/// `out` holds files that this program did not pack, or another process writes to it. What is finished is kept; the same call
/// goes on. Shards of another dataset are replaced.
pub fn pack(dataset: &Path, out: &Path, samples_per_shard: u32, profile: Frames, cancel: &Cancel) -> Result<Manifest> {
    let mut hold = Hold::new(out)?;
    let whole = whole::open(dataset)?;
    let planned = plan(&whole.sequences, samples_per_shard as usize);
    let made_from: Vec<String> = planned.iter().map(|planned| sample::source_hash(planned, profile)).collect::<Result<_>>()?;
    let before = list::find(out)?;
    hold.begin()?;
    file::remove_leftovers(out);
    // Until this list is written again at the end, the folder holds no finished set of shards.
    list::unfinished(out, &before, &[], &[])?;
    let manifest_path = out.join(MANIFEST);
    if before.finished {
        std::fs::remove_file(&manifest_path).with_context(|| format!("{}: cannot remove", manifest_path.display()))?;
    }
    let total: usize = planned.iter().map(|shard| shard.samples.len()).sum();
    let progress = Progress::new("pack", total as u64);
    let mut shards: Vec<Shard> = Vec::new();
    for (planned, source) in planned.iter().zip(made_from) {
        progress.message(planned.file.clone());
        let same = before.shards.iter().find(|shard| shard.file == planned.file && shard.source == source);
        match same {
            Some(shard) if verify::is_whole(&out.join(&shard.file), shard) => {
                progress.resume(planned.samples.len() as u64);
                shards.push(shard.clone());
            }
            _ => shards.push(write::shard(out, planned, profile, source, &progress, cancel)?),
        }
        list::unfinished(out, &before, &shards, &[])?;
    }
    progress.finish();
    let mut removed = Vec::new();
    // The new manifest does not list shards of an earlier, larger set.
    for old in before.shards.iter().filter(|old| shards.iter().all(|new| new.file != old.file)) {
        list::remove(out, old, before.sealed)?;
        removed.push(old.file.clone());
    }
    list::unfinished(out, &before, &shards, &removed)?;
    let count = |kind: Kind| {
        let mut counts = BTreeMap::new();
        for shard in shards.iter().filter(|shard| shard.kind == kind) {
            *counts.entry(shard.split.clone()).or_insert(0) += shard.samples;
        }
        counts
    };
    let manifest = Manifest {
        version: 1,
        program: PROGRAM.into(),
        dataset: whole.manifest,
        profile,
        samples_per_shard,
        samples: count(Kind::Frames),
        sequences: count(Kind::Sequences),
        shards,
        seal: String::new(),
    };
    let manifest = manifest.sealed()?;
    file::write_json(&manifest_path, &manifest)?;
    let unfinished = out.join(UNFINISHED);
    std::fs::remove_file(&unfinished).with_context(|| format!("{}: cannot remove", unfinished.display()))?;
    Ok(manifest)
}
