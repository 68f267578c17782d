//! Mending of datasets: what `render` and `repair` do about what is damaged. Everything but clocks and logs follows from the plan, so what
//! is mended has the bytes it had. What is no part of the dataset is never removed: where it is in the way, it is moved to `aside`.

use super::damage::{self, Depth};
use super::folder::frame_file;
use super::manifest::MANIFEST;
use super::plan::{Plan, SPLITS};
use super::record::{DESCRIPTIONS, FAILURES, RECORD, Record};
use super::render::{self, Summary};
use super::shard::Shard;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::{file, frame_file as frames};
use renderflow_scenes::Scene;
use serde::Deserialize;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// File name of the plan in a dataset.
pub const PLAN: &str = "plan.json";
/// Folder for what was in the way.
pub const ASIDE: &str = "aside";

/// What `repair` did.
#[derive(Clone, Debug, Default)]
pub struct Repaired {
    /// Frames made and kept, and sequences that were damaged.
    pub summary: Summary,
    /// The plan or the manifest, where it was written again.
    pub rewritten: Vec<&'static str>,
    /// Folders that hold a sequence and are none of the plan's.
    pub strangers: Vec<PathBuf>,
}

/// Makes `out` the folder of this plan.
///
/// # Errors
/// When it is another's, or cannot be written.
pub fn claim(plan: &Plan, out: &Path) -> Result<()> {
    let path = out.join(PLAN);
    let bytes = file::json(&path, plan)?;
    let there = match file::read_at_most(&path, file::LARGEST_TEXT) {
        Err(renderflow_frame::Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => None,
        there => Some(there?),
    };
    if there.as_ref() == Some(&bytes) {
        return Ok(());
    }
    match known_plan(out) {
        Some(known) if known != plan.hash() => {
            bail!("{}: the folder holds a dataset of another plan; choose another folder", path.display())
        }
        // A file that is no plan, in a folder that nothing says is a dataset.
        None if there.is_some() => drop(Plan::read(&path)?),
        _ if there.is_some() => eprintln!("note: {}: was damaged, written again", path.display()),
        _ => {}
    }
    Ok(file::write_atomic(&path, &bytes)?)
}

/// BLAKE3 of the plan that a dataset was made from: what most of its own plan, its manifest, its records and its logs say. Where as many
/// say another, its own plan is right.
fn known_plan(out: &Path) -> Option<String> {
    #[derive(Deserialize)]
    struct Mark {
        plan: String,
    }
    let own: Option<String> = Plan::read(&out.join(PLAN)).ok().map(|plan| plan.hash());
    let records = SPLITS.iter().flat_map(|split| std::fs::read_dir(out.join(split.name())).into_iter().flatten().flatten());
    let marked = std::iter::once(out.join(MANIFEST)).chain(records.map(|entry| entry.path().join(RECORD)));
    let marks = marked.filter_map(|path| Some(file::read_json::<Mark>(&path).ok()?.plan)).filter(|plan| plan.len() == 64);
    let logged: HashSet<String> = super::log::plans(out).iter().map(Plan::hash).collect();
    let mut votes: HashMap<String, usize> = HashMap::new();
    for vote in own.iter().cloned().chain(marks).chain(logged) {
        *votes.entry(vote).or_default() += 1;
    }
    votes.into_iter().max_by_key(|(plan, count)| (*count, own.as_ref() == Some(plan), plan.clone())).map(|(plan, _)| plan)
}

/// The plan of the dataset in `out`, or what is wrong with it.
///
/// # Errors
/// When there is no plan that can be read, nor anything that says which there was.
pub fn plan_of(out: &Path) -> Result<Result<Plan, String>> {
    let path = out.join(PLAN);
    let known = known_plan(out);
    let plan = match Plan::read(&path) {
        Ok(plan) => plan,
        Err(error) if known.is_some() => return Ok(Err(crate::console::message(&error))),
        Err(error) => return Err(error.context("not a dataset folder")),
    };
    let hash = plan.hash();
    Ok(match known.filter(|known| *known != hash) {
        Some(known) => Err(format!("{}: has BLAKE3 {hash}, the dataset was made from {known}", path.display())),
        None if file::json(&path, &plan)? != file::read(&path)? => {
            Err(format!("{}: is not written as this program writes it", path.display()))
        }
        None => Ok(plan),
    })
}

/// Mends the dataset in `out`: looks at it as closely as `verify` does, and makes again what is damaged or missing. `plan` is needed only where
/// the folder's own is damaged and no log holds it.
///
/// # Errors
/// As [`render::run`]; when the plan is damaged and cannot be found.
pub fn repair(out: &Path, plan: Option<&Plan>, stop: &AtomicBool) -> Result<Repaired> {
    let mut repaired = Repaired::default();
    let found = match plan_of(out) {
        // Nothing but a plan from elsewhere can help.
        Err(error) if plan.is_some() && out.join(PLAN).exists() => Err(crate::console::message(&error)),
        found => found?,
    };
    let own = match found {
        Ok(own) => {
            if let Some(plan) = plan {
                ensure!(own == *plan, "--plan: the dataset was made from another plan, which its {PLAN} holds");
            }
            own
        }
        Err(reason) => {
            let found = lost_plan(out, plan).with_context(|| reason.clone())?;
            eprintln!("note: {reason}; written again");
            if !out.join(PLAN).is_file() && out.join(PLAN).exists() {
                set_aside(out, &out.join(PLAN))?;
            }
            file::write_json(&out.join(PLAN), &found)?;
            repaired.rewritten.push(PLAN);
            found
        }
    };
    for folder in SPLITS.map(|split| out.join(split.name())).iter().chain(&[out.join("logs")]) {
        if folder.exists() && !folder.is_dir() {
            let aside = set_aside(out, folder)?;
            eprintln!("note: {}: is no folder, moved to {}", folder.display(), aside.display());
        }
    }
    let path = out.join(MANIFEST);
    if path.exists() && !path.is_file() {
        let aside = set_aside(out, &path)?;
        eprintln!("note: {}: is no file, moved to {}", path.display(), aside.display());
    }
    let before = file::read(&path).ok();
    repaired.summary = render::run_at(&own, out, Shard { index: 1, count: 1 }, (Depth::Pixels, &|_| true), stop)?;
    if before != file::read(&path).ok() {
        repaired.rewritten.push(MANIFEST);
    }
    repaired.strangers = damage::strangers(&own, out)?;
    Ok(repaired)
}

/// The plan of a dataset that has lost it: `given`, what is left of the file, or what its logs hold.
fn lost_plan(out: &Path, given: Option<&Plan>) -> Result<Plan> {
    let known = known_plan(out);
    let fits = |plan: &Plan| known.as_ref().is_none_or(|known| *known == plan.hash());
    if let Some(plan) = given {
        ensure!(fits(plan), "--plan: the dataset was made from another plan");
        return Ok(plan.clone());
    }
    if let Some(plan) = Plan::read(&out.join(PLAN)).ok().filter(|plan| known.is_some() && fits(plan)) {
        return Ok(plan);
    }
    let logged = super::log::plans(out).into_iter().rev().find(|plan| plan.check().is_ok() && fits(plan));
    logged.with_context(|| format!("no log of the dataset holds its plan; name it: {} --plan PLAN", damage::remedy(out)))
}

/// Why a sequence must not be gone on with: its files, whole among themselves, are of another scene than this version of the program composes
/// for its place.
pub fn other_version(plan: &Plan, folder: &Path, composed: &Scene) -> Option<String> {
    let there = damage::read_scene(&folder.join("scene.json")).ok()?;
    if (&there.name, there.seed) != (&composed.name, composed.seed) || damage::names_files(composed) {
        return None;
    }
    let hash = there.hash();
    let of_it = |number: usize| {
        let path = folder.join(frame_file(number, plan.storage));
        let info = file::read(&path).ok().and_then(|bytes| frames::info(&path, &bytes).ok());
        info.is_some_and(|info| info.scene_hash == hash)
    };
    (hash != composed.hash() && plan.numbers().any(of_it)).then(|| {
        format!(
            "{}: was begun by another version of this program, which makes another scene of the plan; \
             go on with that version, or render the plan into another folder",
            folder.display()
        )
    })
}

/// Whether a folder holds another sequence than the one whose scene is `composed`: its scene is another, and its record agrees.
pub fn is_misplaced(folder: &Path, record: Option<&Record>, composed: &Scene) -> bool {
    let (Some(record), Ok(scene)) = (record, damage::read_scene(&folder.join("scene.json"))) else { return false };
    let other = (&scene.name, scene.seed) != (&composed.name, composed.seed);
    // The hash of a scene that names files may be another one beside the frames; its seed is not.
    other && (scene.hash() == record.scene || (damage::names_files(&scene) && scene.seed == record.seed))
}

/// The numbers of files that are equal to another one.
pub fn doubles(files: &[(usize, PathBuf)]) -> HashSet<usize> {
    let mut seen: HashMap<String, usize> = HashMap::new();
    let mut doubles = HashSet::new();
    for (number, path) in files {
        let Ok(hash) = damage::hash(path) else { continue };
        if let Some(&first) = seen.get(&hash) {
            doubles.extend([first, *number]);
        }
        seen.entry(hash).or_insert(*number);
    }
    doubles
}

/// Moves what is at the places of a sequence's files, and is no file, out of the way.
pub fn clear_places(plan: &Plan, out: &Path, folder: &Path, note: impl Fn(String)) -> Result<()> {
    let files = plan.numbers().map(|number| frame_file(number, plan.storage));
    let names = files.chain(DESCRIPTIONS.iter().chain(&[RECORD, FAILURES, crate::truth::TIMING]).map(|name| (*name).to_owned()));
    let places = std::iter::once(folder.to_owned()).filter(|folder| !folder.is_dir());
    for path in places.chain(names.map(|name| folder.join(name)).filter(|path| !path.is_file())) {
        if std::fs::symlink_metadata(&path).is_ok() {
            let aside = set_aside(out, &path)?;
            note(format!("{}: is in the way, moved to {}", path.display(), aside.display()));
        }
    }
    Ok(())
}

/// Moves a file or folder of the dataset in `out` to its folder for what is in the way; returns where it is now.
pub fn set_aside(out: &Path, path: &Path) -> Result<PathBuf> {
    let inside = path.strip_prefix(out).unwrap_or(path);
    let name: Vec<_> = inside.iter().map(|part| part.to_string_lossy()).collect();
    let folder = out.join(ASIDE);
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot create folder", folder.display()))?;
    let free = |n: &u32| std::fs::symlink_metadata(folder.join(format!("{}-{n}", name.join("-")))).is_err();
    let number = (1..).find(free).context("no name is free")?;
    let aside = folder.join(format!("{}-{number}", name.join("-")));
    std::fs::rename(path, &aside).with_context(|| format!("{}: cannot move to {}", path.display(), aside.display()))?;
    Ok(aside)
}
