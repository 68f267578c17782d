//! `manifest.json`: the whole dataset on one page, collected from the records of its sequences.

use super::damage::{self, Depth, Found};
use super::plan::{Counts, Denoise, Plan};
use super::record::{RECORD, Record};
use super::render::{remove_leftovers, sequence_folder};
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::{channel, file};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// File name of the manifest.
pub const MANIFEST: &str = "manifest.json";
/// Damaged sequences that a message names.
const SHOWN: usize = 20;

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

/// What a manifest says of the records of its dataset.
#[derive(Clone, Debug, Default)]
pub struct Listed {
    records: HashMap<u32, String>,
}

impl Listed {
    /// That of the manifest in `out`; nothing where there is none that can be read, or it is of another plan.
    pub fn read(plan: &Plan, out: &Path) -> Self {
        let Ok(manifest) = file::read_json::<Manifest>(&out.join(MANIFEST)) else { return Self::default() };
        if manifest.plan != plan.hash() {
            return Self::default();
        }
        let mut hashes: HashMap<String, String> =
            manifest.entries.into_iter().map(|entry| (entry.folder, entry.record)).collect();
        let of = |index| Some((index, hashes.remove(&folder_name(plan, index))?));
        Self { records: (0..plan.total()).filter_map(of).collect() }
    }

    /// BLAKE3 of the record of sequence `index`.
    pub fn of(&self, index: u32) -> Option<&str> {
        self.records.get(&index).map(String::as_str)
    }
}

/// Folder of sequence `index` in its dataset.
fn folder_name(plan: &Plan, index: u32) -> String {
    format!("{}/{}", plan.split(index), Plan::sequence_name(index))
}

/// Reads every record.
///
/// # Errors
/// Names the sequences that lack theirs or have that of another.
pub fn records(plan: &Plan, out: &Path) -> Result<Vec<Record>> {
    let all: Vec<u32> = (0..plan.total()).collect();
    let none = AtomicBool::new(false);
    accept(plan, out, &all, damage::sequences(plan, out, &all, &Listed::default(), Depth::Sizes, &none)?)
}

/// The records of the sequences `indices`, of which `found` tells.
///
/// # Errors
/// When some are not complete, or damaged; names them and the command that mends them.
pub(super) fn accept(plan: &Plan, out: &Path, indices: &[u32], found: Vec<Found>) -> Result<Vec<Record>> {
    let missing: Vec<u32> = indices.iter().zip(&found).filter(|(_, found)| found.unfinished).map(|(index, _)| *index).collect();
    if let Some(&first) = missing.first() {
        let failed: usize =
            missing.iter().map(|&index| super::record::failures(&sequence_folder(plan, out, index)).map_or(0, |f| f.len())).sum();
        bail!(
            "{} of {} sequences are not complete ({failed} failures recorded), the first is {}; render them, then merge: {}",
            missing.len(),
            indices.len(),
            Plan::sequence_name(first),
            damage::remedy(out)
        );
    }
    let first = |(index, found): (&u32, &Found)| Some(format!("{}: {}", folder_name(plan, *index), found.damage.first()?));
    let damaged: Vec<String> = indices.iter().zip(&found).filter_map(first).collect();
    if !damaged.is_empty() {
        let shown = damaged.iter().take(SHOWN).map(|line| format!("\n  {line}")).collect::<String>();
        let more = damaged.len().saturating_sub(SHOWN);
        let more = if more > 0 { format!("\n  and {more} more") } else { String::new() };
        bail!("{} sequences are damaged:{shown}{more}\nto mend them: {}", damaged.len(), damage::remedy(out));
    }
    Ok(found.into_iter().filter_map(|found| found.record).collect())
}

/// Collects the records into the manifest.
///
/// # Errors
/// When a sequence is not complete or damaged: every file is hashed. When splits share what they must not.
pub fn merge(plan: &Plan, out: &Path, stop: &AtomicBool) -> Result<Manifest> {
    merge_after(plan, out, &HashSet::new(), Depth::Hashes, stop)
}

/// [`merge`] where the sequences `proven` have just been looked at or made; at others it looks as closely as `depth` says.
pub(super) fn merge_after(plan: &Plan, out: &Path, proven: &HashSet<u32>, depth: Depth, stop: &AtomicBool) -> Result<Manifest> {
    let listed = Listed::read(plan, out);
    let progress = (depth >= Depth::Hashes).then(|| Progress::new("merge", u64::from(plan.total())));
    let look = |index: u32| {
        if stop.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let found = if proven.contains(&index) {
            damage::sequence(plan, out, index, None, Depth::Sizes)
        } else {
            damage::sequence(plan, out, index, listed.of(index), depth)
        };
        if let Some(progress) = &progress {
            progress.add(1);
        }
        Ok(found)
    };
    let all: Vec<u32> = (0..plan.total()).collect();
    let found = all.par_iter().with_max_len(1).map(|&index| look(index)).collect::<Result<_>>()?;
    if let Some(progress) = &progress {
        progress.finish();
    }
    let records = accept(plan, out, &all, found)?;
    let manifest = Manifest::new(plan, out, &records)?;
    let leaks: Vec<String> = leaks(plan, (0..).zip(&records)).iter().map(Leak::to_string).collect();
    ensure!(leaks.is_empty(), "splits share what they must not: {}", leaks.join("; "));
    remove_leftovers(out);
    let path = out.join(MANIFEST);
    match file::write_json(&path, &manifest) {
        // Another shard that came to its end at the same time has swept this one's file away, and written the same.
        Err(error) if file::read_json::<Manifest>(&path).ok().as_ref() != Some(&manifest) => Err(error.into()),
        _ => Ok(manifest),
    }
}

impl Entry {
    /// The entry of the sequence in `out` that has this record.
    fn new(plan: &Plan, out: &Path, record: &Record) -> Result<Self> {
        let path = sequence_folder(plan, out, record.index).join(RECORD);
        let bytes = file::read_at_most(&path, file::LARGEST_TEXT)?;
        Ok(Self {
            folder: folder_name(plan, record.index),
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

    /// This manifest as it must be: the entries of the sequences whose record is known come from it, the others stay as they are.
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
            let count = match plan.split(index).name() {
                "train" => &mut frames.train,
                "val" => &mut frames.val,
                _ => &mut frames.test,
            };
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

/// What splits share: scenes, mesh families, geometry, user files, environments. `records` are the sequences by the number of the folder
/// they lie in, whatever they say themselves.
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
                leaks
                    .push(Leak { places: [first, index].map(|index| folder_name(plan, index)), what: format!("{what} {which}") });
            }
        }
    }
    leaks.sort();
    leaks.dedup();
    leaks
}
