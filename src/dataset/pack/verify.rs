//! Compares shards with their manifest: hashes, counts, names, and the hash in each sample.

use super::{Kind, MANIFEST, Manifest, Shard};
use crate::util::cancel::Cancel;
use crate::util::files;
use crate::util::progress::Progress;
use crate::util::text::plural;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::file;
use serde::Deserialize;
use std::collections::{BTreeMap, HashSet};
use std::io::{BufReader, Read};
use std::path::Path;

/// Whether the file at `path` is the one that `shard` describes.
pub fn is_whole(path: &Path, shard: &Shard) -> bool {
    std::fs::metadata(path).is_ok_and(|about| about.is_file() && about.len() == shard.bytes)
        && files::hash(path).is_ok_and(|blake3| blake3 == shard.blake3)
}

/// Reads every shard in `out`, and prints the result.
///
/// # Errors
/// When there is no manifest, or when anything differs from it; every fault is printed first.
pub fn verify(out: &Path, cancel: &Cancel) -> Result<()> {
    let manifest = Manifest::read(out).context("not a finished folder of shards")?;
    let progress = Progress::new("verify", manifest.shards.len() as u64);
    let mut faults = Vec::new();
    let (mut counts, mut keys) = (BTreeMap::new(), HashSet::new());
    for shard in &manifest.shards {
        cancel.check()?;
        progress.message(shard.file.clone());
        match check(&out.join(&shard.file), shard, &mut keys) {
            Ok(()) => *counts.entry((shard.split.clone(), shard.kind == Kind::Frames)).or_insert(0) += shard.samples,
            Err(error) => faults.push(crate::util::console::message(&error)),
        }
        progress.add(1);
    }
    progress.finish();
    for (name, expected, frames) in [("samples", &manifest.samples, true), ("sequences", &manifest.sequences, false)] {
        for (split, expected) in expected {
            let found = counts.get(&(split.clone(), frames)).copied().unwrap_or(0);
            if found != *expected && faults.is_empty() {
                faults.push(format!("{MANIFEST}: /{name}/{split}: {expected}, the shards have {found}"));
            }
        }
    }
    for path in files::list(out)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.ends_with(".tar") && manifest.shards.iter().all(|shard| shard.file != name) {
            faults.push(format!("{name}: is not in {MANIFEST}"));
        }
    }
    for fault in &faults {
        println!("FAULT {fault}");
    }
    if !faults.is_empty() {
        bail!("{}: {}", out.display(), plural(faults.len(), "fault"));
    }
    let (samples, bytes) = (manifest.samples.values().sum::<u64>(), manifest.shards.iter().map(|s| s.bytes).sum::<u64>());
    println!("{}, {}, {bytes} bytes, no faults", plural(manifest.shards.len(), "shard"), plural(samples, "sample"));
    Ok(())
}

/// Checks one shard; `keys` are the keys of all shards before it.
fn check(path: &Path, shard: &Shard, keys: &mut HashSet<String>) -> Result<()> {
    let bytes = file::open(path)?.metadata()?.len();
    ensure!(bytes == shard.bytes, "{}: {bytes} bytes, the manifest says {}", path.display(), shard.bytes);
    let blake3 = files::hash(path)?;
    ensure!(blake3 == shard.blake3, "{}: has BLAKE3 {blake3}, the manifest says {}", path.display(), shard.blake3);
    let found = samples(path, shard.kind, keys).with_context(|| path.display().to_string())?;
    ensure!(found == shard.samples, "{}: {}, the manifest says {}", path.display(), plural(found, "sample"), shard.samples);
    Ok(())
}

/// The keys in a sample's description that identify its frame.
#[derive(Deserialize)]
struct Described {
    key: String,
    #[serde(default)]
    file: String,
    #[serde(default)]
    blake3: String,
}

/// Reads an archive; returns the number of samples.
fn samples(path: &Path, kind: Kind, keys: &mut HashSet<String>) -> Result<u64> {
    let mut archive = tar::Archive::new(BufReader::with_capacity(1 << 20, file::open(path)?));
    let mut count = 0;
    let mut first: Option<(String, String, String)> = None;
    for entry in archive.entries()? {
        let mut entry = entry?;
        let name = entry.path()?.to_string_lossy().into_owned();
        // A sparse entry of a kilobyte may stand for any number of zeros.
        ensure!(entry.header().entry_type().is_file(), "{name}: is not a regular file");
        // As in readers of archives, the key ends at the first dot.
        let (key, ending) = name.split_once('.').with_context(|| format!("{name}: no ending"))?;
        let mut content = Vec::new();
        entry.read_to_end(&mut content)?;
        let Some((first_key, first_ending, hash)) = first.take() else {
            ensure!(keys.insert(format!("{kind:?} {key}")), "{key}: a second sample of this name");
            first = Some((key.to_owned(), ending.to_owned(), blake3::hash(&content).to_hex().to_string()));
            continue;
        };
        let described: Described = serde_json::from_slice(&content).with_context(|| name.clone())?;
        ensure!(key == first_key && ending == "json" && described.key == key, "{name}: is not the description of {first_key}");
        if kind == Kind::Frames {
            ensure!(described.file == first_ending && described.blake3 == hash, "{name}: is not of {first_key}.{first_ending}");
        }
        count += 1;
    }
    ensure!(first.is_none(), "the last sample has no description");
    Ok(count)
}
