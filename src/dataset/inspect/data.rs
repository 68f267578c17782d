//! Weights, plans, cameras of sequences, and datasets.

use super::Counts;
use crate::dataset::check::verify_frame;
use crate::dataset::layout::is_aside;
use crate::dataset::learned::Dataset;
use crate::dataset::plan::Plan;
use crate::dataset::sequence::{Sequence, folders};
use crate::util::files;
use crate::util::text::plural;
use anyhow::{Context, Result, anyhow, ensure};
use rayon::prelude::*;
use renderflow_frame::transforms;
use renderflow_model::fusion::Fusion;
use renderflow_model::inverse::Inverse;
use renderflow_model::lpips::{Backbone, Lpips};
use renderflow_model::wan::weights as wan;
use renderflow_scenes::load::Capture;
use serde::de::IgnoredAny;
use serde_json::{Map, Value, json};
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

/// Longest header of a safetensors file that its own reader accepts, bytes.
const LONGEST_HEADER: u64 = 100_000_000;

/// The JSON header of a safetensors file; `None` when there is none that can be read.
fn header(path: &Path) -> Result<Option<Map<String, Value>>> {
    let unreadable = || format!("{}: cannot read", path.display());
    let mut file = renderflow_frame::file::open(path)?;
    let size = file.metadata().with_context(unreadable)?.len();
    let mut length = [0; 8];
    if file.read_exact(&mut length).is_err() {
        return Ok(None);
    }
    let length = u64::from_le_bytes(length);
    if length > LONGEST_HEADER.min(size) {
        return Ok(None);
    }
    let mut text = Vec::new();
    file.take(length).read_to_end(&mut text).with_context(unreadable)?;
    Ok(serde_json::from_slice(&text).ok())
}

/// Heads of the LPIPS network in a file; 0 in any other.
fn lpips_heads(header: &Map<String, Value>) -> usize {
    header.keys().filter(|name| name.starts_with("lin.")).count()
}

/// Whether a safetensors file holds LPIPS weights.
pub(super) fn is_lpips(path: &Path) -> Result<bool> {
    Ok(header(path)?.is_some_and(|h| lpips_heads(&h) > 0))
}

/// Numbers of tensors and of values in them.
fn tensors(found: &mut Counts, header: &Map<String, Value>) {
    let shapes = header.iter().filter(|(name, _)| *name != "__metadata__").filter_map(|(_, info)| info.get("shape")?.as_array());
    let sizes: Vec<u64> = shapes.map(|shape| shape.iter().filter_map(Value::as_u64).product()).collect();
    found.add("tensors", sizes.len());
    found.add("parameters", sizes.iter().sum::<u64>());
}

/// Weights of one of the networks, this program's or published ones.
pub(super) fn weights(path: &Path) -> Result<Counts> {
    let source = wan::Source::open(path)?;
    if let wan::Identity::Wan(known) = wan::identify(&source)? {
        let wan::Found { header, assumed, .. } = *known;
        wan::check(&source, &header.network)?;
        // Every value is read, as it would be for use.
        source.names().try_for_each(|name| source.read(name).map(drop))?;
        let table = source.table();
        let mut found = Counts::default();
        found.add("network", header.network.name());
        found.add("tensors", table.rows.len());
        found.add("parameters", table.parameters());
        found.add("steps", header.provenance.steps);
        if let wan::Network::WanFlow(config) = &header.network {
            found.add("keyframes", config.keyframes.is_some());
            found.add("inverse", config.inverse.is_some());
        }
        found.notes = assumed;
        return Ok(found);
    }
    let (network, steps) = if Inverse::recognises(path) {
        ("inverse", Inverse::load(path)?.header().steps)
    } else {
        ("fusion", Fusion::load(path)?.header().steps)
    };
    let mut found = Counts::default();
    found.add("network", network);
    tensors(&mut found, &header(path)?.unwrap_or_default());
    found.add("steps", steps);
    Ok(found)
}

/// Weights of LPIPS.
pub(super) fn lpips(path: &Path) -> Result<Counts> {
    let header = header(path)?.unwrap_or_default();
    let (backbone, name) = match lpips_heads(&header) {
        7 => (Backbone::Squeeze, "squeeze"),
        _ => (Backbone::Alex, "alex"),
    };
    Lpips::load_file(path, backbone)?;
    let mut found = Counts::default();
    found.add("backbone", name);
    tensors(&mut found, &header);
    Ok(found)
}

/// A dataset plan.
pub(super) fn plan(path: &Path) -> Result<Counts> {
    let plan = Plan::read(path)?;
    let mut found = Counts::default();
    found.add("sequences", plan.total());
    found.add("train", plan.sequences.train);
    found.add("val", plan.sequences.val);
    found.add("test", plan.sequences.test);
    found.add("frames", plan.frames);
    found.add("frame_step", plan.frame_step);
    found.add("size", json!(plan.resolution));
    found.add("spp", plan.render.spp);
    found.add("meshes", plan.meshes);
    found.add("environments", plan.environments);
    Ok(found)
}

/// Cameras of a sequence, or those of other programs. Their frames need not be there; checking a dataset folder checks them.
pub(super) fn transforms(path: &Path) -> Result<Counts> {
    if !renderflow_frame::file::read_json::<HashMap<String, IgnoredAny>>(path)?.contains_key("convention") {
        let capture = Capture::read(path)?;
        let mut found = Counts::default();
        found.add("cameras", capture.len());
        found.add("size", capture.size().map(|size| json!(size)).unwrap_or_default());
        return Ok(found);
    }
    let sequence = transforms::read(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut found = Counts::default();
    found.add("cameras", sequence.cameras.len());
    found.add("size", sequence.cameras.first().map(|c| json!([c.width, c.height])).unwrap_or_default());
    found.add("keyframes", sequence.keyframes.len());
    found.add("moving_objects", sequence.tracks.objects.len());
    found.add("missing_frames", sequence.files.iter().filter(|f| !folder.join(f).is_file()).count());
    Ok(found)
}

/// A sequence, a folder of sequences, or a folder of such folders: every frame and map is read.
pub(super) fn dataset(path: &Path) -> Result<Counts> {
    let splits = splits(path)?;
    let sequences: Vec<&Sequence> = splits.iter().flat_map(|d| &d.sequences).collect();
    for sequence in &sequences {
        sequence.light()?;
    }
    let frames: Vec<(&Sequence, usize)> = sequences.iter().flat_map(|s| (0..s.len()).map(move |i| (*s, i))).collect();
    // The first fault in order is reported, so that the message does not depend on threads.
    let faults: Vec<Option<anyhow::Error>> = frames.par_iter().map(|(s, i)| frame(s, *i).err()).collect();
    let broken = faults.iter().flatten().count();
    if let Some(first) = faults.into_iter().flatten().next() {
        return Err(if broken > 1 {
            anyhow!("{} (and {})", crate::util::console::message(&first), plural(broken - 1, "more frame"))
        } else {
            first
        });
    }
    let mut found = Counts::default();
    found.add("splits", splits.len());
    found.add("sequences", sequences.len());
    found.add("frames", frames.len());
    found.add("keyframes", sequences.iter().map(|s| s.transforms.keyframes.len()).sum::<usize>());
    Ok(found)
}

/// The datasets in a folder: itself, or its folders.
fn splits(path: &Path) -> Result<Vec<Dataset>> {
    if !folders(path)?.is_empty() {
        return Ok(vec![Dataset::open(path)?]);
    }
    let mut found = Vec::new();
    for folder in files::list(path)?.into_iter().filter(|path| path.is_dir() && !is_aside(path)) {
        if !folders(&folder)?.is_empty() {
            found.push(Dataset::open(&folder)?);
        }
    }
    ensure!(!found.is_empty(), "{}: no sequence (a folder with transforms.json) inside", path.display());
    Ok(found)
}

/// Reads one frame of a sequence and compares it with its camera.
fn frame(sequence: &Sequence, index: usize) -> Result<()> {
    let frame = sequence.frame(index)?;
    verify_frame(&frame).with_context(|| sequence.file(index).display().to_string())
}
