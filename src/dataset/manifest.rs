//! `manifest.json`: the whole dataset on one page, collected from the records of its sequences.

use super::denoise::Denoise;
use super::plan::{Counts, Plan};
use super::record::Record;
use crate::dataset::layout::{MANIFEST, RECORD};
use anyhow::{Result, ensure};
use renderflow_frame::{channel, file};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fmt;
use std::path::Path;

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
    /// BLAKE3 of `sequence.json`, which holds the hashes of all its files.
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

/// The hashes of records that the manifest of a dataset lists.
#[derive(Clone, Debug, Default)]
pub struct Listed {
    records: HashMap<u32, String>,
}

impl Listed {
    /// Reads the manifest in `out`; empty where it cannot be read or belongs to another plan.
    pub fn read(plan: &Plan, out: &Path) -> Self {
        let Ok(manifest) = file::read_json::<Manifest>(&out.join(MANIFEST)) else { return Self::default() };
        if manifest.plan != plan.hash() {
            return Self::default();
        }
        let mut hashes: HashMap<String, String> =
            manifest.entries.into_iter().map(|entry| (entry.folder, entry.record)).collect();
        let of = |index| Some((index, hashes.remove(&plan.place(index))?));
        Self { records: (0..plan.total()).filter_map(of).collect() }
    }

    /// BLAKE3 of the record of sequence `index`.
    pub fn of(&self, index: u32) -> Option<&str> {
        self.records.get(&index).map(String::as_str)
    }
}

impl Entry {
    /// The entry of the sequence in `out` that has this record.
    fn new(plan: &Plan, out: &Path, record: &Record) -> Result<Self> {
        let path = plan.folder(out, record.index).join(RECORD);
        let bytes = file::read_at_most(&path, file::LARGEST_TEXT)?;
        Ok(Self {
            folder: plan.place(record.index),
            record: blake3::hash(&bytes).to_hex().to_string(),
            scene: record.scene.clone(),
            environment: record.environment.family.clone(),
            frames: record.frames.len(),
            bytes: record.frames.iter().map(|frame| frame.bytes).sum(),
            keyframes: record.keyframes.clone(),
        })
    }
}

impl Manifest {
    /// The manifest of complete sequences, in the plan's order.
    pub fn new(plan: &Plan, out: &Path, records: &[Record]) -> Result<Self> {
        let entries = records.iter().map(|record| Entry::new(plan, out, record)).collect::<Result<_>>()?;
        Ok(Self::with(plan, entries))
    }

    /// This manifest as it should be: entries come from the records that are known; the others stay.
    pub(super) fn corrected(&self, plan: &Plan, out: &Path, records: &[Option<Record>]) -> Result<Self> {
        let mut entries = self.entries.clone();
        for (entry, record) in entries.iter_mut().zip(records) {
            if let Some(record) = record {
                *entry = Entry::new(plan, out, record)?;
            }
        }
        ensure!(entries.len() == records.len(), "/entries: has {} entries, the plan {} sequences", entries.len(), records.len());
        Ok(Self::with(plan, entries))
    }

    fn with(plan: &Plan, entries: Vec<Entry>) -> Self {
        let mut frames = Counts::default();
        for (index, entry) in (0..).zip(&entries) {
            let count = frames.of_mut(plan.split(index));
            *count = count.saturating_add(entry.frames.try_into().unwrap_or(u32::MAX));
        }
        Self {
            version: 2,
            program: concat!("renderflow ", env!("CARGO_PKG_VERSION")).into(),
            plan: plan.hash(),
            format: channel::FORMAT,
            denoiser: plan.render.denoise,
            sequences: plan.sequences,
            frames,
            bytes: entries.iter().fold(0, |sum: u64, entry| sum.saturating_add(entry.bytes)),
            entries,
        }
    }
}

/// Something that two splits share.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Leak {
    /// The two sequences, by split and name of their folders.
    pub places: [String; 2],
    /// What they share: its kind and its name.
    pub what: String,
}

impl fmt::Display for Leak {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [one, other] = &self.places;
        write!(f, "{} is in {one} and {other}", self.what)
    }
}

/// Finds what splits share: scenes, mesh families, geometry, user files, environments. `records` come with the number of the
/// folder that they lie in, whatever they say themselves.
pub fn leaks<'a>(plan: &Plan, records: impl IntoIterator<Item = (u32, &'a Record)>) -> Vec<Leak> {
    let mut records: Vec<(u32, &Record)> = records.into_iter().collect();
    // Splits follow one another in the numbers.
    records.sort_by_key(|(index, _)| *index);
    let mut seen: HashMap<(&str, String), u32> = HashMap::new();
    let mut leaks = Vec::new();
    for (index, record) in records {
        let mut things = vec![("scene", record.scene.clone()), ("environment family", record.environment.family.clone())];
        for object in &record.objects {
            things.push(match &object.file {
                Some(file) => ("model", file.clone()),
                None => ("mesh family", object.family.clone()),
            });
            things.extend(object.geometry.iter().map(|hash| ("geometry", hash.clone())));
        }
        for thing in things {
            let first = *seen.entry(thing.clone()).or_insert(index);
            if plan.split(first) != plan.split(index) {
                let (what, which) = thing;
                leaks.push(Leak { places: [first, index].map(|index| plan.place(index)), what: format!("{what} {which}") });
            }
        }
    }
    leaks.sort();
    leaks.dedup();
    leaks
}
