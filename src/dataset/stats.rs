//! Counts a dataset by the records of its sequences: families of its parts, and histograms of its pixels.

use super::contact;
use super::layout::{self, RECORD};
use super::manifest::{self, Leaks};
use super::plan::{Plan, SPLITS};
use super::record::Record;
use super::statistics::{AXES, Axis, Statistics};
use crate::util::cancel::Cancel;
use crate::util::picture;
use crate::util::text::short;
use anyhow::{Context, Result, ensure};
use renderflow_frame::frame_file;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Counts of one quantity over labelled bars.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bars {
    /// What is counted.
    pub title: String,
    /// (label, count) of each bar.
    pub bars: Vec<(String, u64)>,
}

/// All numbers of a dataset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Numbers {
    /// Number of complete sequences, and of sequences in the plan.
    pub sequences: [usize; 2],
    /// Frames.
    pub frames: usize,
    /// Bytes of all frames.
    pub bytes: u64,
    /// Distinct geometry of objects.
    pub meshes: usize,
    /// Distinct scenes.
    pub scenes: usize,
    /// Distinct environments (family and number, or file).
    pub environments: usize,
    /// What two splits share, one sentence each; empty in a good dataset.
    pub leaks: Vec<String>,
    /// Frames by split.
    pub splits: Bars,
    /// Everything that is counted by sequence or object.
    pub counts: Vec<Bars>,
    /// Everything that is counted by frame or pixel.
    pub histograms: Vec<Bars>,
}

/// Reads the records of the complete sequences in `out`, one after the other.
///
/// # Errors
/// When stopped, when there is no plan, when a record cannot be read, or when there is none.
pub fn numbers(out: &Path, cancel: &Cancel) -> Result<Numbers> {
    let plan = Plan::read(&out.join("plan.json")).context("not a dataset folder")?;
    let mut tally = Tally::new(&plan);
    for index in 0..plan.total() {
        cancel.check()?;
        if let Some(record) = Record::read(&plan.folder(out, index))? {
            tally.add(index, &record);
        }
    }
    ensure!(tally.sequences > 0, "{}: no sequence is complete yet", out.display());
    Ok(tally.finish())
}

/// A label of a bar: its rank, by which bars are sorted, and its text. Bars of one rank are sorted by their text.
type Label = (u32, String);

/// The counts of the records that were read so far. The records themselves are not kept.
struct Tally<'a> {
    plan: &'a Plan,
    sequences: usize,
    frames: usize,
    bytes: u64,
    /// Frames by split.
    splits: [u64; SPLITS.len()],
    environments: BTreeSet<String>,
    leaks: Leaks<'a>,
    /// Titles and bars, in the order of the page.
    counts: Vec<(&'static str, BTreeMap<Label, u64>)>,
    statistics: Statistics,
}

impl<'a> Tally<'a> {
    fn new(plan: &'a Plan) -> Self {
        Self {
            plan,
            sequences: 0,
            frames: 0,
            bytes: 0,
            splits: [0; SPLITS.len()],
            environments: BTreeSet::new(),
            leaks: Leaks::new(plan),
            counts: Vec::new(),
            statistics: Statistics::default(),
        }
    }

    /// Adds the record in folder number `index`, whatever it says itself.
    fn add(&mut self, index: u32, record: &Record) {
        self.sequences += 1;
        self.frames += record.frames.len();
        // Damaged records may hold any numbers.
        self.bytes = record.frames.iter().fold(self.bytes, |sum, frame| sum.saturating_add(frame.bytes));
        for (frames, split) in self.splits.iter_mut().zip(SPLITS) {
            *frames += if self.plan.split(index) == split { record.frames.len() as u64 } else { 0 };
        }
        self.environments.insert(format!("{} {:?}", record.environment.family, record.environment.number));
        self.leaks.add(index, manifest::things(record));
        self.statistics.add(&record.statistics);

        let named = |label: &str| ((0, label.to_owned()), 1);
        let objects = record.objects.len() as u32;
        let yes = |flag: bool| named(if flag { "yes" } else { "no" });
        self.count("layout", [named(&record.layout)]);
        self.count("camera", [named(&record.camera)]);
        self.count("objects move", [yes(record.moving)]);
        self.count("materials change", [yes(record.changing)]);
        self.count("concentration of the light", [(decade(record.environment.concentration), 1)]);
        self.count("objects in a scene", [((objects, objects.to_string()), 1)]);
        self.count("triangles in a scene", [(decade(record.triangles as f32), 1)]);
        let labels = (0..).zip(["all", "textured", "metal"].map(str::to_owned));
        self.count("materials on objects and structure", labels.zip(record.materials.map(|count| count as u64)));
        self.count("environment family", [named(&record.environment.family)]);
        self.count("mesh family", record.objects.iter().map(|object| named(&object.family)));
    }

    /// Adds to the bars with this title.
    fn count(&mut self, title: &'static str, labels: impl IntoIterator<Item = (Label, u64)>) {
        let known = self.counts.iter().position(|(known, _)| *known == title);
        let place = known.unwrap_or_else(|| {
            self.counts.push((title, BTreeMap::new()));
            self.counts.len() - 1
        });
        for (label, more) in labels {
            let count = self.counts[place].1.entry(label).or_default();
            *count = count.saturating_add(more);
        }
    }

    fn finish(self) -> Numbers {
        let splits = SPLITS.iter().zip(self.splits).map(|(split, frames)| (split.name().to_owned(), frames));
        let bars = |(title, bars): (&str, BTreeMap<Label, u64>)| Bars {
            title: title.into(),
            bars: bars.into_iter().map(|((_, label), count)| (label, count)).collect(),
        };
        Numbers {
            sequences: [self.sequences, self.plan.total() as usize],
            frames: self.frames,
            bytes: self.bytes,
            meshes: self.leaks.different(manifest::GEOMETRY),
            scenes: self.leaks.different(manifest::SCENE),
            environments: self.environments.len(),
            leaks: self.leaks.finish().iter().map(ToString::to_string).collect(),
            splits: Bars { title: "frames by split".into(), bars: splits.collect() },
            counts: self.counts.into_iter().map(bars).collect(),
            histograms: AXES.iter().map(|axis| histogram(axis, &self.statistics)).collect(),
        }
    }
}

/// The label of the power of ten that holds a number of several decades.
fn decade(value: f32) -> Label {
    let low = value.max(1.0).log10().floor() as u32;
    (low, format!("{} to {}", power(low), power(low.saturating_add(1))))
}

/// Ten to the power of `exponent`, as people write it: 1, 10, 100, 1k, ..., 100M, 1G, ...
fn power(exponent: u32) -> String {
    let unit = ["", "k", "M", "G", "T", "P", "E"].get(exponent as usize / 3);
    unit.map_or_else(|| format!("10^{exponent}"), |unit| format!("1{}{unit}", "0".repeat(exponent as usize % 3)))
}

fn histogram(axis: &Axis, statistics: &Statistics) -> Bars {
    let bars = axis.counts(statistics).into_iter().enumerate().map(|(i, count)| (short(axis.edge(i)), count));
    Bars { title: axis.title.into(), bars: bars.collect() }
}

/// Most pictures on the page of a dataset, and their longer side in pixels.
const PICTURES: [u32; 2] = [12, 192];

/// Names and PNG files of first frames, of complete sequences that are spread over the dataset in `out`. Frames without a picture
/// and frames that cannot be read are left out.
///
/// # Errors
/// When stopped, or when there is no plan.
pub fn pictures(out: &Path, cancel: &Cancel) -> Result<Vec<(String, Vec<u8>)>> {
    let plan = Plan::read(&out.join("plan.json")).context("not a dataset folder")?;
    let [most, side] = PICTURES;
    let mut complete = Vec::new();
    for index in 0..plan.total() {
        cancel.check()?;
        complete.extend(plan.folder(out, index).join(RECORD).is_file().then_some(index));
    }
    let count = complete.len().min(most as usize);
    let mut found = Vec::new();
    for index in (0..count).map(|i| complete[i * complete.len() / count]) {
        cancel.check()?;
        let path = plan.folder(out, index).join(layout::frame_file(0, plan.storage));
        match frame_file::read(&path) {
            Ok(frame) => {
                if let Some(picture) = contact::display(&frame) {
                    found.push((plan.place(index), picture::png(&picture::reduced(&picture, side as usize))?));
                }
            }
            Err(error) => eprintln!("note: not shown: {error}"),
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::agreement::Agreement;
    use crate::dataset::record::{EnvironmentEntry, FrameEntry, ObjectEntry};

    #[test]
    fn records_are_counted_one_after_the_other() {
        let plan: Plan = serde_json::from_value(serde_json::json!({
            "version": 2,
            "seed": 1,
            "sequences": { "train": 1, "test": 1 },
            "frames": 1,
            "resolution": [16, 16],
            "render": { "spp": 0 },
        }))
        .unwrap();
        let frame = FrameEntry { file: String::new(), number: 0, keyframe: true, spp: 0, bytes: u64::MAX, blake3: String::new() };
        let geometry = vec!["hash".to_owned(), "other".to_owned()];
        let object = ObjectEntry { name: String::new(), family: "sphere".into(), mesh: None, file: None, geometry };
        let record = |triangles: u64| Record {
            version: 1,
            name: String::new(),
            index: 0,
            split: SPLITS[0],
            plan: String::new(),
            seed: 0,
            scene: "same".into(),
            layout: "room".into(),
            camera: "orbit".into(),
            moving: false,
            changing: true,
            environment: EnvironmentEntry { concentration: f32::INFINITY, ..EnvironmentEntry::default() },
            objects: vec![object.clone(), object.clone()],
            materials: [3, 2, 0],
            triangles,
            keyframes: vec![0],
            descriptions: Vec::new(),
            frames: vec![frame.clone()],
            agreement: Agreement::default(),
            statistics: Statistics::default(),
        };
        let mut tally = Tally::new(&plan);
        tally.add(0, &record(20_000));
        tally.add(1, &record(3_000));
        let numbers = tally.finish();
        assert_eq!((numbers.sequences, numbers.frames, numbers.bytes), ([2, 2], 2, u64::MAX));
        assert_eq!([numbers.meshes, numbers.scenes, numbers.environments], [2, 1, 1]);
        assert!(
            numbers.leaks.contains(&"scene same is in train/seq-000000 and test/seq-000001".to_owned()),
            "{:?}",
            numbers.leaks
        );
        let bars = |bars: &Bars| bars.bars.iter().map(|(label, count)| format!("{label}: {count}")).collect::<Vec<_>>();
        assert_eq!(bars(&numbers.splits), ["train: 1", "val: 0", "test: 1"]);
        let named = |title: &str| bars(numbers.counts.iter().find(|bars| bars.title == title).unwrap());
        assert_eq!(named("triangles in a scene"), ["1k to 10k: 1", "10k to 100k: 1"]);
        assert_eq!(named("materials on objects and structure"), ["all: 6", "textured: 4", "metal: 0"]);
        assert_eq!((named("mesh family"), named("objects move")), (vec!["sphere: 4".to_owned()], vec!["no: 2".to_owned()]));
    }

    #[test]
    fn labels_are_written_as_people_write_numbers() {
        assert_eq!([0, 2, 3, 5, 6, 9, 40].map(power), ["1", "100", "1k", "100k", "1M", "1G", "10^40"]);
        for axis in super::super::statistics::AXES {
            for (label, _) in histogram(axis, &Statistics::default()).bars {
                assert!(label.parse::<f64>().is_ok() && !label.contains('e'), "{}: {label}", axis.title);
            }
        }
    }
}
