//! `manifest.json`: the whole dataset on one page, collected from the records of its sequences.

use super::plan::{Counts, Denoise, Plan, SPLITS};
use super::record::{RECORD, Record};
use super::render::{remove_leftovers, sequence_folder};
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::{channel, file};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// File name of the manifest.
pub const MANIFEST: &str = "manifest.json";

/// A finished dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Format version, 2.
    pub version: u32,
    /// The program that made it.
    pub program: String,
    /// BLAKE3 of the plan.
    pub plan: String,
    /// Version of the channel conventions.
    pub format: u32,
    /// Denoiser of the beauty.
    pub denoiser: Denoise,
    /// Sequences by split.
    pub sequences: Counts,
    /// Frames by split.
    pub frames: Counts,
    /// Bytes of all frames.
    pub bytes: u64,
    /// The sequences.
    pub entries: Vec<Entry>,
}

/// A sequence of the manifest; `sequence.json` in its folder says more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Folder, such as `train/seq-000012`.
    pub folder: String,
    /// BLAKE3 of `sequence.json`, which holds those of all its files.
    pub record: String,
    /// BLAKE3 of the scene.
    pub scene: String,
    /// Environment family.
    pub environment: String,
    /// Frames.
    pub frames: usize,
    /// Bytes of its frames.
    pub bytes: u64,
    /// Numbers of the keyframes.
    pub keyframes: Vec<usize>,
}

/// Whether every sequence has its record.
pub fn complete(plan: &Plan, out: &Path) -> bool {
    (0..plan.total()).all(|index| sequence_folder(plan, out, index).join(RECORD).is_file())
}

/// Reads every record; the error names the sequences that lack theirs.
pub fn records(plan: &Plan, out: &Path) -> Result<Vec<Record>> {
    let hash = plan.hash();
    let (mut records, mut missing) = (Vec::new(), Vec::new());
    for index in 0..plan.total() {
        let folder = sequence_folder(plan, out, index);
        match Record::read(&folder)? {
            Some(record) => {
                ensure!(record.plan == hash, "{}: is of another plan", folder.join(RECORD).display());
                records.push(record);
            }
            None => missing.push(index),
        }
    }
    if let Some(&first) = missing.first() {
        let failed: usize =
            missing.iter().map(|&index| super::record::failures(&sequence_folder(plan, out, index)).map_or(0, |f| f.len())).sum();
        bail!(
            "{} of {} sequences are not complete ({failed} failures recorded), the first is {}; render them, then merge",
            missing.len(),
            plan.total(),
            Plan::sequence_name(first)
        );
    }
    Ok(records)
}

/// Collects the records into the manifest.
pub fn merge(plan: &Plan, out: &Path) -> Result<Manifest> {
    let records = records(plan, out)?;
    let manifest = Manifest::new(plan, out, &records)?;
    let leaks = leaks(&records);
    ensure!(leaks.is_empty() || plan.classic, "splits share what they must not: {}", leaks.join("; "));
    remove_leftovers(out);
    let path = out.join(MANIFEST);
    match file::write_json(&path, &manifest) {
        // Another shard that came to its end at the same time has swept this one's file away, and written the same.
        Err(error) if file::read_json::<Manifest>(&path).ok().as_ref() != Some(&manifest) => Err(error.into()),
        _ => Ok(manifest),
    }
}

impl Manifest {
    /// The manifest of complete sequences.
    pub fn new(plan: &Plan, out: &Path, records: &[Record]) -> Result<Self> {
        let mut frames = Counts::default();
        let mut entries = Vec::new();
        for record in records {
            let folder = sequence_folder(plan, out, record.index);
            let bytes = std::fs::read(folder.join(RECORD)).with_context(|| folder.join(RECORD).display().to_string())?;
            let count = record.frames.len();
            *match record.split.name() {
                "train" => &mut frames.train,
                "val" => &mut frames.val,
                _ => &mut frames.test,
            } += count as u32;
            entries.push(Entry {
                folder: format!("{}/{}", record.split, record.name),
                record: blake3::hash(&bytes).to_hex().to_string(),
                scene: record.scene.clone(),
                environment: record.environment.family.clone(),
                frames: count,
                bytes: record.frames.iter().map(|frame| frame.bytes).sum(),
                keyframes: record.keyframes.clone(),
            });
        }
        Ok(Self {
            version: 2,
            program: concat!("renderflow ", env!("CARGO_PKG_VERSION")).into(),
            plan: plan.hash(),
            format: channel::FORMAT,
            denoiser: plan.render.denoise,
            sequences: plan.sequences,
            frames,
            bytes: entries.iter().map(|entry| entry.bytes).sum(),
            entries,
        })
    }
}

/// What two splits share, a sentence each: scenes, mesh families, geometry, user files, environments.
pub fn leaks(records: &[Record]) -> Vec<String> {
    let mut seen: BTreeMap<(&str, String), &Record> = BTreeMap::new();
    let mut leaks = Vec::new();
    for split in SPLITS {
        for record in records.iter().filter(|record| record.split == split) {
            let mut things = vec![("scene", record.scene.clone()), ("environment family", record.environment.family.clone())];
            for object in &record.objects {
                things.push(match &object.file {
                    Some(file) => ("model", file.clone()),
                    None => ("mesh family", object.family.clone()),
                });
                things.extend(object.geometry.iter().map(|hash| ("geometry", hash.clone())));
            }
            for thing in things {
                if let Some(other) = seen.get(&thing).filter(|other| other.split != split) {
                    let (what, which) = &thing;
                    leaks.push(format!("{what} {which} is in {}/{} and {split}/{}", other.split, other.name, record.name));
                }
                seen.entry(thing).or_insert(record);
            }
        }
    }
    leaks.sort();
    leaks.dedup();
    leaks
}
