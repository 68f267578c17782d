//! Finds what is damaged in a dataset. `verify`, `render`, `repair`, `merge`, `pack`, `export` and `train` all judge by it.
//!
//! A sequence is whole when its record fits the plan and the folder, its scene is the one in the record, and every file is the
//! one in the record. The caller chooses how much of the files is read ([`Depth`]). BLAKE3 hashes some gigabytes a second;
//! decoding a frame is fifty times slower, and rendering it is thousands of times slower. So commands that continue earlier work
//! hash everything.

use super::check::Part;
use super::check::{self, Header};
use super::manifest::Listed;
use super::plan::Plan;
use super::record::{Checked, FrameEntry, Record};
use crate::dataset::layout::{DESCRIPTIONS, RECORD};
use crate::util::cancel::Cancel;
use crate::util::files;
use anyhow::Result;
use rayon::prelude::*;
use renderflow_frame::file;
use renderflow_frame::words::shell;
use renderflow_scenes::Scene;
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::description::{EnvironmentSource, Geometry};
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// How closely a sequence is examined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Depth {
    /// The record and the scene are read; other files are compared by size.
    Sizes,
    /// Every file is hashed.
    Hashes,
    /// Every frame is also decoded, and compared with the plan, its camera and its neighbours.
    Pixels,
}

/// One thing that is wrong with a sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// What is damaged.
    pub part: Part,
    /// The reason, in words. It starts with the name of the file where there is one.
    pub reason: String,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.reason)
    }
}

/// What an examination found in a sequence.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Its record, right or wrong, if it can be read.
    pub record: Option<Record>,
    /// BLAKE3 of the record's file.
    pub record_hash: Option<String>,
    /// What the files are like; empty below [`Depth::Pixels`].
    pub checked: Checked,
    /// What is wrong.
    pub damage: Vec<Damage>,
    /// Whether the sequence has no record: it was never finished, or its record was lost.
    pub unfinished: bool,
}

impl Findings {
    /// Whether nothing is wrong.
    pub fn is_whole(&self) -> bool {
        self.damage.is_empty()
    }

    /// Whether the record can be trusted and confirms the file of frame `number`. Only meaningful from [`Depth::Hashes`] on.
    pub fn vouches_for(&self, number: usize) -> bool {
        self.record.is_some() && !self.damage.iter().any(|d| matches!(d.part, Part::Record) || d.part == Part::Frame(number))
    }

    fn add(&mut self, part: Part, reason: impl Into<String>) {
        self.damage.push(Damage { part, reason: reason.into() });
    }

    fn has(&self, part: Part) -> bool {
        self.damage.iter().any(|damage| damage.part == part)
    }
}

/// Examines sequence `index` of the dataset in `out`. `listed` is the BLAKE3 of its record in the dataset's manifest.
pub fn sequence(plan: &Plan, out: &Path, index: u32, listed: Option<&str>, depth: Depth) -> Findings {
    let folder = plan.folder(out, index);
    let mut found = Findings::default();
    let record = match Record::read_with_bytes(&folder) {
        Ok(None) => {
            found.unfinished = true;
            found.add(Part::Record, format!("{RECORD}: is not there, so the sequence is not complete"));
            return found;
        }
        Err(error) => {
            found.add(Part::Record, relative(&folder, &crate::util::console::message(&error)));
            return found;
        }
        Ok(Some((record, bytes))) => {
            for misfit in record.misfits(plan, index) {
                found.add(Part::Record, format!("{RECORD}: {misfit}"));
            }
            let hash = blake3::hash(&bytes).to_hex().to_string();
            if found.is_whole() && file::json(&folder, &record).ok().as_ref() != Some(&bytes) {
                found.add(Part::Record, format!("{RECORD}: is not written as this program writes it"));
            }
            if let Some(listed) = listed.filter(|listed| found.is_whole() && *listed != hash) {
                found.add(Part::Record, format!("{RECORD}: has BLAKE3 {hash}, manifest.json says {listed}"));
            }
            found.record_hash = Some(hash);
            record
        }
    };
    if found.is_whole() {
        scene(&mut found, plan, index, &folder, &record);
    }
    if !found.has(Part::Record) {
        files(&mut found, plan, &folder, &record, depth);
    }
    found.record = Some(record);
    found
}

/// Compares the scene with the record and the folder.
fn scene(found: &mut Findings, plan: &Plan, index: u32, folder: &Path, record: &Record) {
    let path = folder.join("scene.json");
    let scene = match read_scene(&path) {
        Ok(scene) => scene,
        Err(error) => return found.add(Part::Description, relative(folder, &crate::util::console::message(&error))),
    };
    let expected = plan.scene_name(index);
    let hash = scene.hash();
    let reason = if scene.name != expected {
        Some(format!("scene.json: /name is {:?}, that of this folder is {expected:?}", scene.name))
    } else if hash != record.scene && !names_files(&scene) {
        Some(format!("scene.json: is scene {hash}, {RECORD} says {}", record.scene))
    } else if scene.seed != record.seed {
        Some(format!("scene.json: /seed is {}, {RECORD} says {}", scene.seed, record.seed))
    } else {
        None
    };
    // For a scene that names no files, the hash says everything.
    if reason.is_none() && !names_files(&scene) {
        return;
    }
    let file = fault(folder, "scene.json", None, record.hash_of("scene.json").unwrap_or_default(), Depth::Hashes);
    match (reason, file) {
        (None, None) => {}
        (None, Some(file)) => found.add(Part::Description, file),
        (Some(reason), Some(_)) => found.add(Part::Description, reason),
        // The file is the one that was recorded, so the record contradicts itself.
        (Some(reason), None) => found.add(Part::Record, reason),
    }
}

/// Reads and validates a scene.
pub(super) fn read_scene(path: &Path) -> Result<Scene> {
    Ok(Scene::from_json(path, &file::read_text(path)?)?)
}

/// Whether a scene names files. Its copy beside the frames may name them by other paths, and then has another hash.
pub(super) fn names_files(scene: &Scene) -> bool {
    let textured = |m: &renderflow_scenes::description::Material| {
        [&m.base_color_texture, &m.metallic_roughness_texture, &m.normal_texture, &m.emissive_texture].iter().any(|t| t.is_some())
    };
    matches!(scene.environment.source, EnvironmentSource::File(_))
        || scene.materials.iter().any(textured)
        || scene.objects.iter().any(|object| matches!(object.geometry, Geometry::File(_)))
        || scene.lights.iter().any(|light| light.kind.ies().is_some())
}

/// Compares the files with a record that fits the plan.
fn files(found: &mut Findings, plan: &Plan, folder: &Path, record: &Record, depth: Depth) {
    for (name, hash) in &record.descriptions {
        // The content of the scene was already compared.
        let known = found.damage.iter().any(|damage| damage.reason.starts_with(name.as_str()));
        if let Some(reason) = fault(folder, name, None, hash, depth).filter(|_| !known) {
            found.add(Part::Description, reason);
        }
    }
    if depth == Depth::Pixels {
        match check::read(plan, folder, Header { scene: &record.scene, seed: record.seed, files: None }) {
            Ok(reading) => {
                for (part, reason) in reading.faults {
                    found.add(part, reason);
                }
                found.checked = reading.checked;
            }
            Err(error) if !found.has(Part::Description) => {
                found.add(Part::Description, relative(folder, &crate::util::console::message(&error)));
            }
            Err(_) => {}
        }
    }
    let read: HashMap<usize, &FrameEntry> = found.checked.frames.iter().map(|frame| (frame.number, frame)).collect();
    let frames = record.frames.par_iter().filter(|frame| !found.has(Part::Frame(frame.number)));
    let damaged: Vec<Damage> = frames
        .filter_map(|frame| {
            let reason = match read.get(&frame.number) {
                Some(&read) => {
                    (read.blake3 != frame.blake3).then(|| differs(&frame.file, &read.blake3, &frame.blake3)).or_else(|| {
                        (read != frame).then(|| format!("{RECORD}: what it says of {} is not what the file holds", frame.file))
                    })
                }
                None => fault(folder, &frame.file, Some(frame.bytes), &frame.blake3, depth),
            };
            reason.map(|reason| Damage { part: Part::Frame(frame.number), reason })
        })
        .collect();
    found.damage.extend(damaged);
    if depth == Depth::Pixels && found.is_whole() {
        let parts = [
            ("statistics", record.statistics == found.checked.statistics),
            ("agreement", record.agreement == found.checked.agreement),
        ];
        for (name, _) in parts.iter().filter(|(_, same)| !same) {
            found.add(Part::Record, format!("{RECORD}: /{name}: is not that of the frames"));
        }
    }
}

fn differs(name: &str, found: &str, recorded: &str) -> String {
    format!("{name}: has BLAKE3 {found}, {RECORD} says {recorded}")
}

/// Describes what is wrong with a recorded file.
fn fault(folder: &Path, name: &str, bytes: Option<u64>, blake3: &str, depth: Depth) -> Option<String> {
    let path = folder.join(name);
    let length = match std::fs::metadata(&path) {
        Ok(about) if about.is_file() => about.len(),
        Ok(about) if about.is_dir() => return Some(format!("{name}: is a folder, not a file")),
        Ok(_) => return Some(format!("{name}: is no regular file")),
        Err(error) if error.kind() == ErrorKind::NotFound => return Some(format!("{name}: is not there")),
        Err(error) => return Some(format!("{name}: cannot read: {error}")),
    };
    if let Some(bytes) = bytes.filter(|bytes| *bytes != length) {
        return Some(format!("{name}: has {length} bytes, {RECORD} says {bytes}"));
    }
    if depth < Depth::Hashes {
        return None;
    }
    match files::hash(&path) {
        Ok(found) => (found != blake3).then(|| differs(name, &found, blake3)),
        Err(error) => Some(relative(folder, &crate::util::console::message(&error))),
    }
}

/// Removes the folder from a message about files in it.
pub(super) fn relative(folder: &Path, message: &str) -> String {
    message.replace(&format!("{}/", folder.display()), "")
}

/// What the plan would make of a sequence, as far as that can be found out without rendering.
pub enum Made {
    /// The same record.
    Same,
    /// A different record: the place in it, and both values.
    Other(String),
    /// A different scene: this version of the program composes the plan differently, so it could not continue the sequence.
    OtherVersion,
    /// Unknown, for instance because a model of the user is missing.
    Unknown(String),
}

/// Compares a sequence that is whole at [`Depth::Pixels`] with the record that this program would write for it. Loading the scene
/// takes most of the time; it is skipped where the manifest lists this very record.
pub fn against_plan(plan: &Plan, catalog: &Catalog, index: u32, listed: bool, found: &Findings) -> Made {
    let Some(record) = &found.record else { return Made::Unknown(format!("no {RECORD}")) };
    let make = || -> Result<Made> {
        let composed = plan.compose(catalog, index)?;
        if composed.scene.hash() != record.scene {
            return Ok(Made::OtherVersion);
        }
        let made = if listed {
            record.with_composed(&composed)
        } else {
            let loaded = renderflow_scenes::load::load(&composed.scene, &plan.reach())?;
            Record::new(plan, index, &composed, &loaded, found.checked.clone())?
        };
        // Through text: a single-precision 3.6 would otherwise print as 3.5999999046325684.
        let value = |record: &Record| serde_json::from_str(&serde_json::to_string(record)?);
        Ok(difference("", &value(record)?, &value(&made)?).map_or(Made::Same, Made::Other))
    };
    crate::util::panic::guarded(make).unwrap_or_else(|error| Made::Unknown(crate::util::console::message(&error)))
}

/// Finds the first place where two values differ.
fn difference(pointer: &str, there: &serde_json::Value, made: &serde_json::Value) -> Option<String> {
    use serde_json::Value::{Array, Object};
    match (there, made) {
        (Object(a), Object(b)) if a.keys().eq(b.keys()) => {
            a.iter().zip(b.values()).find_map(|((key, a), b)| difference(&format!("{pointer}/{key}"), a, b))
        }
        (Array(a), Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(i, (a, b))| difference(&format!("{pointer}/{i}"), a, b))
        }
        _ if there == made => None,
        _ => {
            let short = |value: &serde_json::Value| value.to_string().chars().take(80).collect::<String>();
            Some(format!("{RECORD}: {pointer}: is {}, the plan makes {}", short(there), short(made)))
        }
    }
}

/// Examines the sequences `indices` in parallel. The results are in the same order.
///
/// # Errors
/// When `stop` was set.
pub fn sequences(
    plan: &Plan,
    out: &Path,
    indices: &[u32],
    listed: &Listed,
    depth: Depth,
    stop: &Cancel,
) -> Result<Vec<Findings>> {
    let look = |&index: &u32| {
        stop.check()?;
        Ok(sequence(plan, out, index, listed.of(index), depth))
    };
    indices.par_iter().with_max_len(1).map(look).collect()
}

/// Folders in a dataset that hold a sequence but do not belong to the plan: training would take them for data of their split.
///
/// # Errors
/// When a folder cannot be listed.
pub fn strangers(plan: &Plan, out: &Path) -> Result<Vec<PathBuf>> {
    let known: HashSet<PathBuf> = (0..plan.total()).map(|index| plan.folder(out, index)).collect();
    let mut strangers = Vec::new();
    for parent in std::iter::once(out.to_owned()).chain(super::plan::SPLITS.map(|split| out.join(split.name()))) {
        let holds = |path: &Path| path.join("transforms.json").exists() || path.join(RECORD).exists();
        strangers.extend(list(&parent)?.into_iter().filter(|path| !known.contains(path) && path.is_dir() && holds(path)));
    }
    Ok(strangers)
}

/// Files in the folder of sequence `index` that do not belong to it. Nothing reads them.
///
/// # Errors
/// When the folder cannot be listed.
pub fn strays(plan: &Plan, out: &Path, index: u32) -> Result<Vec<PathBuf>> {
    let folder = plan.folder(out, index);
    let others = [RECORD, super::layout::FAILURES, crate::dataset::layout::TIMING, crate::dataset::layout::AUDIT];
    let frames: HashSet<String> = plan.numbers().map(|number| super::layout::frame_file(number, plan.storage)).collect();
    let own = |name: &str| DESCRIPTIONS.contains(&name) || others.contains(&name) || frames.contains(name);
    let name = |path: &PathBuf| path.file_name().is_some_and(|name| name.to_str().is_some_and(own));
    Ok(list(&folder)?.into_iter().filter(|path| !name(path)).collect())
}

/// The content of a folder, by name; empty where there is no folder.
fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => return Ok(Vec::new()),
        entries => entries.map_err(renderflow_frame::Error::io(folder, "list"))?,
    };
    let mut paths = Vec::new();
    for entry in entries {
        paths.push(entry.map_err(renderflow_frame::Error::io(folder, "list"))?.path());
    }
    paths.sort();
    Ok(paths)
}

/// The command that repairs a dataset.
pub fn remedy(out: &Path) -> String {
    format!("renderflow dataset repair {}", shell(&out.to_string_lossy()))
}
