//! Makes a page about a dataset from the records of its sequences: tables of families and histograms of pixels.

use super::log::Costs;
use super::manifest;
use super::plan::{Plan, SPLITS};
use super::record::Record;
use super::statistics::{AXES, Axis, Statistics};
use crate::util::output::GENERATOR;
use crate::util::text::escape;
use anyhow::{Context, Result, ensure};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

/// Counts of one quantity over labelled bars.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bars {
    /// What is counted.
    pub title: String,
    /// (label, count) of each bar.
    pub bars: Vec<(String, u64)>,
}

/// All numbers of the page.
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
pub fn numbers(out: &Path) -> Result<Numbers> {
    let plan = Plan::read(&out.join("plan.json")).context("not a dataset folder")?;
    // Each record has the number of its folder beside it.
    let (mut records, mut places) = (Vec::new(), Vec::new());
    for index in 0..plan.total() {
        let record = Record::read(&plan.folder(out, index))?;
        places.extend(record.as_ref().map(|_| index));
        records.extend(record);
    }
    ensure!(!records.is_empty(), "{}: no sequence is complete yet", out.display());
    let mut statistics = Statistics::default();
    for record in &records {
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
    // A light's concentration spans five decades.
    let decade = |value: f32| {
        let low = value.max(1.0).log10().floor() as i32;
        format!("{low}: {:e} to {:e}", 10f64.powi(low), 10f64.powi(low + 1))
    };
    let counts = vec![
        count("layout", &mut records.iter().map(|r| r.layout.clone())),
        count("camera", &mut records.iter().map(|r| r.camera.clone())),
        count("objects move", &mut records.iter().map(|r| yes(r.moving))),
        count("materials change", &mut records.iter().map(|r| yes(r.changing))),
        count("concentration of the light (log10)", &mut records.iter().map(|r| decade(r.environment.concentration))),
        count("objects in a scene", &mut records.iter().map(|r| format!("{:02}", r.objects.len()))),
        count("triangles in a scene (log10)", &mut records.iter().map(|r| decade(r.triangles as f32))),
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

fn histogram(axis: &Axis, statistics: &Statistics) -> Bars {
    let label = |i| {
        let edge = axis.edge(i);
        if edge >= 10.0 || edge == 0.0 { format!("{edge:.0}") } else { format!("{edge:.2e}").replace("e0", "") }
    };
    let bars = axis.counts(statistics).into_iter().enumerate().map(|(i, count)| (label(i), count));
    Bars { title: axis.title.into(), bars: bars.collect() }
}

/// The page; it needs no other files.
pub fn html(numbers: &Numbers, costs: &Costs) -> Result<String> {
    let mut page = String::new();
    let [complete, planned] = numbers.sequences;
    write!(
        page,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">{GENERATOR}<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
         <title>Dataset</title><style>{STYLE}</style><h1>Dataset</h1><p>{complete} of {planned} sequences, {} frames, {:.1} MiB \
         ({:.0} bytes per frame); {} distinct scenes, {} distinct meshes, {} distinct environments; {} things shared by splits.</p>",
        numbers.frames,
        numbers.bytes as f64 / f64::from(1 << 20),
        numbers.bytes as f64 / numbers.frames.max(1) as f64,
        numbers.scenes,
        numbers.meshes,
        numbers.environments,
        numbers.leaks.len()
    )?;
    for leak in &numbers.leaks {
        write!(page, "<p class=\"leak\">{}</p>", escape(leak))?;
    }
    if costs.frames > 0 {
        let [compile, render, denoise, write] = costs.stages;
        write!(
            page,
            "<p>{} frames made in {:.1} s, {:.3} per second; one frame takes compile {compile:.3}, render {render:.3}, denoise {denoise:.3}, \
             write {write:.3} s; memory at most {:.0} MiB; {} failures.</p>",
            costs.frames,
            costs.wall,
            costs.frames as f64 / costs.wall.max(1e-9),
            costs.peak,
            costs.failures
        )?;
    }
    page += "<h2>Pixels</h2><div class=\"all\">";
    for bars in &numbers.histograms {
        upright(&mut page, bars)?;
    }
    page += "</div><h2>Sequences and objects</h2><div class=\"all\">";
    for bars in std::iter::once(&numbers.splits).chain(&numbers.counts) {
        lying(&mut page, bars)?;
    }
    page += "</div></html>";
    Ok(page)
}

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:1.5rem auto;max-width:78rem;padding:0 1rem;color:#222}\
.all{display:flex;flex-wrap:wrap;gap:1.2rem}figure{margin:0;flex:1 1 22rem;max-width:38rem}figcaption{font-weight:600}\
svg{width:100%;height:auto}rect{fill:#4e79a7}text{font:10px system-ui,sans-serif;fill:#333}.leak{color:#b00020}";

/// Draws many bars side by side, and labels a few of them.
fn upright(page: &mut String, bars: &Bars) -> Result<()> {
    let (width, height) = (400.0, 130.0);
    let most = bars.bars.iter().map(|bar| bar.1).max().unwrap_or(0).max(1) as f64;
    let step = width / bars.bars.len().max(1) as f64;
    write!(
        page,
        "<figure><figcaption>{}</figcaption><svg viewBox=\"0 0 {width} {}\" role=\"img\">",
        escape(&bars.title),
        height + 16.0
    )?;
    for (i, (label, count)) in bars.bars.iter().enumerate() {
        let tall = height * *count as f64 / most;
        let (x, y) = (i as f64 * step, height - tall);
        write!(
            page,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{tall:.1}\"><title>from {}: {count}</title></rect>",
            step - 1.0,
            escape(label)
        )?;
        if i.is_multiple_of(bars.bars.len().div_ceil(8)) {
            write!(page, "<text x=\"{x:.1}\" y=\"{}\">{}</text>", height + 12.0, escape(label))?;
        }
    }
    page.push_str("</svg></figure>");
    Ok(())
}

/// Draws one bar in each line, with its label.
fn lying(page: &mut String, bars: &Bars) -> Result<()> {
    let most = bars.bars.iter().map(|bar| bar.1).max().unwrap_or(0).max(1) as f64;
    write!(
        page,
        "<figure><figcaption>{}</figcaption><svg viewBox=\"0 0 400 {}\" role=\"img\">",
        escape(&bars.title),
        15 * bars.bars.len()
    )?;
    for (i, (label, count)) in bars.bars.iter().enumerate() {
        let y = 15 * i;
        write!(
            page,
            "<text x=\"0\" y=\"{}\">{}</text><rect x=\"150\" y=\"{}\" width=\"{:.1}\" height=\"12\"/><text x=\"{:.1}\" y=\"{}\">{count}</text>",
            y + 11,
            escape(label),
            y + 1,
            200.0 * *count as f64 / most,
            154.0 + 200.0 * *count as f64 / most,
            y + 11
        )?;
    }
    page.push_str("</svg></figure>");
    Ok(())
}
