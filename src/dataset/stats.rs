//! Counts a dataset by the records of its sequences: families of its parts, and histograms of its pixels.

use super::layout::{self, RECORD};
use super::plan::{Plan, SPLITS};
use super::record::Record;
use super::statistics::{AXES, Axis, Statistics};
use super::{contact, manifest};
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

/// Reads the records of the complete sequences in `out`.
///
/// # Errors
/// When stopped, when there is no plan, when a record cannot be read, or when there is none.
pub fn numbers(out: &Path, cancel: &Cancel) -> Result<Numbers> {
    let plan = Plan::read(&out.join("plan.json")).context("not a dataset folder")?;
    // Each record has the number of its folder beside it.
    let (mut records, mut places) = (Vec::new(), Vec::new());
    for index in 0..plan.total() {
        cancel.check()?;
        let record = Record::read(&plan.folder(out, index))?;
        places.extend(record.as_ref().map(|_| index));
        records.extend(record);
    }
    ensure!(!records.is_empty(), "{}: no sequence is complete yet", out.display());
    let mut statistics = Statistics::default();
    for record in &records {
        cancel.check()?;
        statistics.add(&record.statistics);
    }
    let count = |title: &str, labels: &mut dyn Iterator<Item = String>| {
        let mut counts: BTreeMap<String, u64> = BTreeMap::new();
        for label in labels {
            *counts.entry(label).or_default() += 1;
        }
        Bars { title: title.into(), bars: counts.into_iter().collect() }
    };
    // Damaged records may hold any numbers.
    let sum = |values: &mut dyn Iterator<Item = u64>| values.fold(0, u64::saturating_add);
    let yes = |flag: bool| if flag { "yes" } else { "no" }.to_owned();
    let objects = || records.iter().flat_map(|record| &record.objects);
    // Numbers over several decades.
    let decades = |title: &str, values: &mut dyn Iterator<Item = f32>| {
        let mut counts: BTreeMap<u32, u64> = BTreeMap::new();
        for value in values {
            *counts.entry(value.max(1.0).log10().floor() as u32).or_default() += 1;
        }
        let label = |low: u32| format!("{} to {}", power(low), power(low + 1));
        Bars { title: title.into(), bars: counts.into_iter().map(|(low, count)| (label(low), count)).collect() }
    };
    let counts = vec![
        count("layout", &mut records.iter().map(|r| r.layout.clone())),
        count("camera", &mut records.iter().map(|r| r.camera.clone())),
        count("objects move", &mut records.iter().map(|r| yes(r.moving))),
        count("materials change", &mut records.iter().map(|r| yes(r.changing))),
        decades("concentration of the light", &mut records.iter().map(|r| r.environment.concentration)),
        count("objects in a scene", &mut records.iter().map(|r| format!("{:02}", r.objects.len()))),
        decades("triangles in a scene", &mut records.iter().map(|r| r.triangles as f32)),
        Bars {
            title: "materials on objects and structure".into(),
            bars: ["all", "textured", "metal"]
                .iter()
                .enumerate()
                .map(|(i, label)| ((*label).to_owned(), sum(&mut records.iter().map(|r| r.materials[i] as u64))))
                .collect(),
        },
        count("environment family", &mut records.iter().map(|r| r.environment.family.clone())),
        count("mesh family", &mut objects().map(|object| object.family.clone())),
    ];
    let leaks = manifest::leaks(&plan, places.iter().copied().zip(&records)).iter().map(ToString::to_string).collect();
    let splits = SPLITS.iter().map(|&split| {
        let of_split = records.iter().zip(&places).filter(|(_, place)| plan.split(**place) == split);
        let frames = of_split.map(|(r, _)| r.frames.len() as u64).sum();
        (split.name().to_owned(), frames)
    });
    let distinct = |labels: &mut dyn Iterator<Item = String>| labels.collect::<BTreeSet<_>>().len();
    Ok(Numbers {
        sequences: [records.len(), plan.total() as usize],
        frames: records.iter().map(|r| r.frames.len()).sum(),
        bytes: sum(&mut records.iter().flat_map(|r| &r.frames).map(|frame| frame.bytes)),
        meshes: distinct(&mut objects().flat_map(|object| object.geometry.clone())),
        scenes: distinct(&mut records.iter().map(|r| r.scene.clone())),
        environments: distinct(&mut records.iter().map(|r| format!("{} {:?}", r.environment.family, r.environment.number))),
        leaks,
        splits: Bars { title: "frames by split".into(), bars: splits.collect() },
        counts,
        histograms: AXES.iter().map(|axis| histogram(axis, &statistics)).collect(),
    })
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
