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

/// Bytes of an entry without its keyframes at most; it may name a file of the user.
const ENTRY: u64 = 6 << 10;
/// Bytes of a keyframe in an entry at most.
const KEYFRAME: u64 = 24;

/// The hashes of records that the manifest of a dataset lists.
#[derive(Clone, Debug, Default)]
pub struct Listed {
    records: HashMap<u32, String>,
}

impl Listed {
    /// Reads the manifest in `out`; empty where it cannot be read or belongs to another plan.
    pub fn read(plan: &Plan, out: &Path) -> Self {
        #[derive(Deserialize)]
        struct Outline {
            plan: String,
            entries: Vec<Line>,
        }
        #[derive(Deserialize)]
        struct Line {
            folder: String,
            record: String,
        }
        let path = out.join(MANIFEST);
        let Ok(manifest) = file::read_long_json::<Outline>(&path, Manifest::largest(plan)) else { return Self::default() };
        if manifest.plan != plan.hash() {
            return Self::default();
        }
        let mut hashes: HashMap<String, String> = manifest.entries.into_iter().map(|line| (line.folder, line.record)).collect();
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
        Ok(Self::of(plan, record.index, record, blake3::hash(&bytes).to_hex().to_string()))
    }

    /// The entry of sequence `index`, whose record has the BLAKE3 `hash`.
    pub(super) fn of(plan: &Plan, index: u32, record: &Record, hash: String) -> Self {
        Self {
            folder: plan.place(index),
            record: hash,
            scene: record.scene.clone(),
            environment: record.environment.family.clone(),
            frames: record.frames.len(),
            // Damaged records may hold any numbers.
            bytes: record.frames.iter().fold(0, |sum: u64, frame| sum.saturating_add(frame.bytes)),
            keyframes: record.keyframes.clone(),
        }
    }
}

impl Manifest {
    /// Bytes that the manifest of a plan may have: enough for every sequence with its keyframes.
    pub(super) fn largest(plan: &Plan) -> u64 {
        let keyframes = plan.keyframe_numbers().count() as u64;
        (u64::from(plan.total()) * (ENTRY + KEYFRAME * keyframes)).min(file::LARGEST)
    }

    /// The manifest of complete sequences, in the plan's order.
    pub fn new(plan: &Plan, out: &Path, records: &[Record]) -> Result<Self> {
        let entries = records.iter().map(|record| Entry::new(plan, out, record)).collect::<Result<_>>()?;
        Ok(Self::with(plan, entries))
    }

    /// This manifest as it should be, with the entries that are `known`. There is one, or `None`, for each sequence; for `None`,
    /// the manifest's own entry stays.
    pub(super) fn corrected(self, plan: &Plan, known: Vec<Option<Entry>>) -> Result<Self> {
        let (there, wanted) = (self.entries.len(), known.len());
        ensure!(there == wanted, "/entries: has {there} entries, the plan {wanted} sequences");
        Ok(Self::with(plan, self.entries.into_iter().zip(known).map(|(entry, known)| known.unwrap_or(entry)).collect()))
    }

    /// The manifest with these entries, in the plan's order.
    pub(super) fn with(plan: &Plan, entries: Vec<Entry>) -> Self {
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

/// What splits must not share: its kind, and its name.
pub(super) type Thing = (&'static str, String);

/// The kinds of [`Thing`] that `stats` counts.
pub(super) const SCENE: &str = "scene";
pub(super) const GEOMETRY: &str = "geometry";

/// The scene, the environment, mesh families, geometry and user files of a sequence.
pub(super) fn things(record: &Record) -> Vec<Thing> {
    let mut things = vec![(SCENE, record.scene.clone()), ("environment family", record.environment.family.clone())];
    for object in &record.objects {
        things.push(match &object.file {
            Some(file) => ("model", file.clone()),
            None => ("mesh family", object.family.clone()),
        });
        things.extend(object.geometry.iter().map(|hash| (GEOMETRY, hash.clone())));
    }
    things
}

/// Finds what splits share, sequence by sequence. Of each thing, it keeps the first sequence that has it.
pub(super) struct Leaks<'a> {
    plan: &'a Plan,
    first: HashMap<Thing, u32>,
    found: Vec<Leak>,
}

impl<'a> Leaks<'a> {
    pub(super) fn new(plan: &'a Plan) -> Self {
        Self { plan, first: HashMap::new(), found: Vec::new() }
    }

    /// Adds what the sequence in folder number `index` has. Splits follow one another in the numbers, so sequences must come in
    /// their order.
    pub(super) fn add(&mut self, index: u32, things: Vec<Thing>) {
        for thing in things {
            let Some(&first) = self.first.get(&thing) else {
                self.first.insert(thing, index);
                continue;
            };
            if self.plan.split(first) != self.plan.split(index) {
                let (what, which) = thing;
                let places = [first, index].map(|index| self.plan.place(index));
                self.found.push(Leak { places, what: format!("{what} {which}") });
            }
        }
    }

    /// Number of different things of the kind `what`.
    pub(super) fn different(&self, what: &str) -> usize {
        self.first.keys().filter(|(kind, _)| *kind == what).count()
    }

    /// All that was found, in order.
    pub(super) fn finish(mut self) -> Vec<Leak> {
        self.found.sort();
        self.found.dedup();
        self.found
    }
}

/// Finds what splits share: scenes, mesh families, geometry, user files, environments. `records` come with the number of the
/// folder that they lie in, whatever they say themselves.
pub fn leaks<'a>(plan: &Plan, records: impl IntoIterator<Item = (u32, &'a Record)>) -> Vec<Leak> {
    let mut records: Vec<(u32, &Record)> = records.into_iter().collect();
    records.sort_by_key(|(index, _)| *index);
    let mut leaks = Leaks::new(plan);
    for (index, record) in records {
        leaks.add(index, things(record));
    }
    leaks.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_manifest_larger_than_a_text_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let plan: Plan = serde_json::from_value(serde_json::json!({
            "version": 2,
            "seed": 1,
            "sequences": { "train": 50_000 },
            "frames": 1,
            "resolution": [16, 16],
            "render": { "spp": 0 },
        }))
        .unwrap();
        let path = folder.path().join(MANIFEST);
        let mut manifest = std::io::BufWriter::new(std::fs::File::create(&path).unwrap());
        writeln!(manifest, "{{\"plan\": \"{}\", \"entries\": [", plan.hash()).unwrap();
        // As long as the entries of a very large dataset.
        let space = [&[b' '; (1 << 20) - 1][..], b"\n"].concat();
        while manifest.get_ref().metadata().unwrap().len() <= file::LARGEST_TEXT {
            manifest.write_all(&space).unwrap();
        }
        writeln!(manifest, "{{\"folder\": \"train/seq-000007\", \"record\": \"hash\", \"keyframes\": [0]}}]}}").unwrap();
        manifest.into_inner().unwrap();
        let listed = Listed::read(&plan, folder.path());
        assert_eq!((listed.of(7), listed.of(8)), (Some("hash"), None));
        // Where the plan has few sequences, so large a manifest is not that of its dataset.
        let small = Plan { sequences: Counts { train: 10, ..Counts::default() }, ..plan };
        assert!(file::read_long_json::<serde_json::Value>(&path, Manifest::largest(&small)).is_err());
    }
}
