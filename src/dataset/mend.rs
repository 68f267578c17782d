//! Prepares the folders of a dataset for rendering and repair. Everything but clocks and logs follows from the plan, so what is
//! made again has the same bytes. Nothing that does not belong to the dataset is removed: what is in the way is moved to `aside`.

use super::damage;
use super::plan::{Plan, SPLITS};
use super::record::Record;
use crate::dataset::layout::{ASIDE, DESCRIPTIONS, FAILURES, MANIFEST, PLAN, RECORD, frame_file};
use crate::util::files;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::{file, frame_file as frames};
use renderflow_scenes::Scene;
use serde::Deserialize;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Makes `out` the folder of this plan.
///
/// # Errors
/// When it is the folder of another plan, or cannot be written.
pub fn claim(plan: &Plan, out: &Path) -> Result<()> {
    let path = out.join(PLAN);
    let bytes = file::json(&path, plan)?;
    let stored = match file::read_at_most(&path, file::LARGEST_TEXT) {
        Err(renderflow_frame::Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => None,
        stored => Some(stored?),
    };
    if stored.as_ref() == Some(&bytes) {
        return Ok(());
    }
    match known_plan(out) {
        Some(known) if known != plan.hash() => {
            bail!("{}: {OTHER_PLAN}", path.display())
        }
        // A file that is no plan, in a folder that does not look like a dataset.
        None if stored.is_some() => drop(Plan::read(&path)?),
        _ if stored.is_some() => eprintln!("note: {}: was damaged, written again", path.display()),
        _ => {}
    }
    if stored.is_some() {
        return Ok(file::write_atomic(&path, &bytes)?);
    }
    begin(&path, &bytes)
}

/// Writes the first plan of a folder. Another process may have begun on the folder at the same time.
fn begin(path: &Path, bytes: &[u8]) -> Result<()> {
    if !file::write_first(path, bytes)? {
        ensure!(file::holds(path, bytes)?, "{}: {OTHER_PLAN}", path.display());
    }
    Ok(())
}

/// Why a folder is refused.
const OTHER_PLAN: &str = "the folder holds a dataset of another plan; choose another folder";

/// BLAKE3 of the plan that a dataset was made from, by a vote of its plan, its manifest, its records and its logs. In a tie, its
/// own plan wins.
pub(super) fn known_plan(out: &Path) -> Option<String> {
    #[derive(Deserialize)]
    struct Mark {
        plan: String,
    }
    let own: Option<String> = Plan::read(&out.join(PLAN)).ok().map(|plan| plan.hash());
    let records = SPLITS.iter().flat_map(|split| files::list(&out.join(split.name())).unwrap_or_default());
    let marked = std::iter::once(out.join(MANIFEST)).chain(records.map(|folder| folder.join(RECORD)));
    let plan_in = |path: PathBuf| Some(file::read_long_json::<Mark>(&path, file::LARGEST).ok()?.plan);
    let marks = marked.filter_map(plan_in).filter(|plan| plan.len() == 64);
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
/// When there is no plan that can be read, and nothing that says which plan there was.
pub fn plan_of(out: &Path) -> Result<Result<Plan, String>> {
    let path = out.join(PLAN);
    let known = known_plan(out);
    let plan = match Plan::read(&path) {
        Ok(plan) => plan,
        Err(error) if known.is_some() => return Ok(Err(crate::util::console::message(&error))),
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

/// Why a sequence cannot be continued, if that is so: its files agree with each other, but this version of the program composes
/// another scene for it.
pub fn other_version(plan: &Plan, folder: &Path, composed: &Scene) -> Option<String> {
    let stored = damage::read_scene(&folder.join("scene.json")).ok()?;
    if (&stored.name, stored.seed) != (&composed.name, composed.seed) || damage::names_files(composed) {
        return None;
    }
    let hash = stored.hash();
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

/// Whether a folder holds another sequence than the one with the scene `composed`: its scene is different, and its record agrees
/// with that scene.
pub fn is_misplaced(folder: &Path, record: Option<&Record>, composed: &Scene) -> bool {
    let (Some(record), Ok(scene)) = (record, damage::read_scene(&folder.join("scene.json"))) else { return false };
    let other = (&scene.name, scene.seed) != (&composed.name, composed.seed);
    // The scene beside the frames may have another hash where it names files; its seed stays.
    other && (scene.hash() == record.scene || (damage::names_files(&scene) && scene.seed == record.seed))
}

/// The numbers of files that are equal to another file.
pub fn doubles(files: &[(usize, PathBuf)]) -> HashSet<usize> {
    let mut seen: HashMap<String, usize> = HashMap::new();
    let mut doubles = HashSet::new();
    for (number, path) in files {
        let Ok(hash) = files::hash(path) else { continue };
        if let Some(&first) = seen.get(&hash) {
            doubles.extend([first, *number]);
        }
        seen.entry(hash).or_insert(*number);
    }
    doubles
}

/// Moves everything that is in the place of a sequence's files but is not a file out of the way.
pub fn clear_places(plan: &Plan, out: &Path, folder: &Path, note: impl Fn(String)) -> Result<()> {
    let files = plan.numbers().map(|number| frame_file(number, plan.storage));
    let names = files
        .chain(DESCRIPTIONS.iter().chain(&[RECORD, FAILURES, crate::dataset::layout::TIMING]).map(|name| (*name).to_owned()));
    let places = std::iter::once(folder.to_owned()).filter(|folder| !folder.is_dir());
    for path in places.chain(names.map(|name| folder.join(name)).filter(|path| !path.is_file())) {
        if std::fs::symlink_metadata(&path).is_ok() {
            let aside = set_aside(out, &path)?;
            note(format!("{}: is in the way and was moved to {}", path.display(), aside.display()));
        }
    }
    Ok(())
}

/// Moves a file or folder of the dataset in `out` to the folder `aside`; returns its new path.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_that_begin_at_once_the_first_has_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(PLAN);
        begin(&path, b"one").unwrap();
        begin(&path, b"one").unwrap();
        assert!(begin(&path, b"other").unwrap_err().to_string().contains("another plan"));
        assert_eq!(std::fs::read(&path).unwrap(), b"one");
    }
}
