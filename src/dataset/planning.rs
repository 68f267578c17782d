//! Makes a plan: decides how many sequences each split gets, and which families and files.

use super::plan::{Counts, Plan, SPLITS, Sources, Splits, UserFile};
use crate::util::cancel::Cancel;
use crate::util::console::message;
use crate::util::files;
use crate::util::progress::Progress;
use anyhow::{Context, Result, ensure};
use renderflow_frame::hdr;
use renderflow_frame::reach::Reach;
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::procedural::{Families, Split, deal, families};
use renderflow_scenes::{seed::Seed, shapes};
use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

/// Endings of model files.
pub const MODELS: [&str; 4] = ["gltf", "glb", "obj", "ply"];
/// Endings of environment maps.
pub const MAPS: [&str; 2] = ["hdr", "exr"];

/// Deals `sequences` to the splits: a tenth each to validation and test, rounded; the rest to training.
pub fn share_out(sequences: u32) -> Counts {
    let tenth = (sequences + 5) / 10;
    // A plan with fewer than ten sequences is only for looking at: all go to training.
    let held = if sequences < 10 { 0 } else { tenth };
    Counts { train: sequences - 2 * held, val: held, test: held }
}

/// Deals all sequences to one split.
pub fn all_to(split: Split, sequences: u32) -> Counts {
    let of = |other: Split| if split == other { sequences } else { 0 };
    Counts { train: of(Split::Train), val: of(Split::Val), test: of(Split::Test) }
}

/// What each split may draw from: its [`families`] of the catalogue, and its part of the files in two of the user's folders.
/// About one file in six goes to the test split and one in six goes to the validation split, by the plan's seed and the files'
/// contents. Files that cannot be used are left out, with a warning.
///
/// # Errors
/// When stopped, when a folder cannot be listed, or when it has no file that can be used.
pub fn splits(plan: &Plan, models: Option<&Path>, hdris: Option<&Path>, cancel: &Cancel) -> Result<Splits> {
    let (catalog, seed) = (plan.catalog(), Seed::root(plan.seed));
    let mut splits = Splits::default();
    for split in SPLITS {
        let sources = splits.of_mut(split);
        Families { meshes: sources.mesh_families, environments: sources.environment_families } = families(&catalog, split);
    }
    if let Some(folder) = models {
        deal_files(&mut splits, &seed, model_groups(folder, &plan.allowed.0, cancel)?, |sources, file| sources.models.push(file));
    }
    if let Some(folder) = hdris {
        let groups = usable_maps(folder, cancel)?.into_iter().map(|file| vec![file]).collect();
        deal_files(&mut splits, &seed, groups, |sources, file| sources.hdris.push(file));
    }
    for split in SPLITS {
        let sources = splits.of_mut(split);
        sources.models.sort_by(|a, b| a.path.cmp(&b.path));
        sources.hdris.sort_by(|a, b| a.path.cmp(&b.path));
    }
    Ok(splits)
}

/// Deals groups of files, each as a whole.
fn deal_files(splits: &mut Splits, seed: &Seed, groups: Vec<Vec<UserFile>>, mut add: impl FnMut(&mut Sources, UserFile)) {
    let by_hash: BTreeMap<String, Vec<UserFile>> = groups.into_iter().map(|group| (group[0].blake3.clone(), group)).collect();
    let names = BTreeMap::from([("files", by_hash.keys().cloned().collect())]);
    deal(seed, names, |split, hash| by_hash[&hash].iter().for_each(|file| add(splits.of_mut(split), file.clone())));
}

/// The models below `folder`, in groups that share a mesh: the same body under two names must not be in two splits. Models that
/// cannot be read are left out, with a warning.
fn model_groups(folder: &Path, allowed: &[PathBuf], cancel: &Cancel) -> Result<Vec<Vec<UserFile>>> {
    let files = user_files(folder, &MODELS, cancel)?;
    let progress = Progress::new("models", files.len() as u64);
    let mut groups: Vec<(HashSet<String>, Vec<UserFile>)> = Vec::new();
    for file in files {
        cancel.check()?;
        let path = Path::new(&file.path);
        let view = ModelView { ground: false, ..ModelView::default() };
        let reach = Reach::of(path).allow(allowed);
        let read = load::describe_model(path, None, &view, &reach).and_then(|scene| load::load(&scene, &reach));
        progress.add(1);
        let mut hashes: HashSet<String> = match read {
            Ok(loaded) => loaded.meshes.iter().map(shapes::geometry_hash).collect(),
            Err(error) => {
                progress.hide(|| eprintln!("warning: left out: {error}"));
                continue;
            }
        };
        let mut members = vec![file];
        let (same, others): (Vec<_>, Vec<_>) = groups.into_iter().partition(|(known, _)| !known.is_disjoint(&hashes));
        groups = others;
        for (known, files) in same {
            hashes.extend(known);
            members.extend(files);
        }
        members.sort_by(|a, b| a.path.cmp(&b.path));
        groups.push((hashes, members));
    }
    progress.finish();
    ensure!(!groups.is_empty(), "{}: no model ending in {} that can be read", folder.display(), MODELS.join(", "));
    Ok(groups.into_iter().map(|(_, files)| files).collect())
}

/// The environment maps below `folder`. Maps that cannot be used are left out, with a warning.
fn usable_maps(folder: &Path, cancel: &Cancel) -> Result<Vec<UserFile>> {
    let files = user_files(folder, &MAPS, cancel)?;
    let progress = Progress::new("maps", files.len() as u64);
    let mut usable = Vec::new();
    for file in files {
        cancel.check()?;
        let read = hdr::read(Path::new(&file.path));
        progress.add(1);
        match read {
            Ok(_) => usable.push(file),
            Err(error) => progress.hide(|| eprintln!("warning: left out: {error}")),
        }
    }
    progress.finish();
    ensure!(!usable.is_empty(), "{}: no map ending in {} that can be used", folder.display(), MAPS.join(", "));
    Ok(usable)
}

/// The files in `paths` and below them that have one of `endings`, with their hashes, by path.
///
/// # Errors
/// When a file cannot be read, or when `paths` names a file with another ending.
pub fn files_in(paths: &[PathBuf], endings: &[&str]) -> Result<Vec<UserFile>> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            files.extend(user_files(path, endings, &Cancel::default())?);
        } else {
            ensure!(files::has_ending(path, endings), "{}: its name does not end in {}", path.display(), endings.join(", "));
            files.push(user_file(path)?);
        }
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    files.dedup_by(|a, b| a.path == b.path);
    Ok(files)
}

fn user_file(path: &Path) -> Result<UserFile> {
    let full = std::path::absolute(path).with_context(|| path.display().to_string())?;
    Ok(UserFile { blake3: files::hash(path)?, path: full.to_string_lossy().into_owned() })
}

/// The files below `folder` that have one of `endings`, with their hashes. Files that cannot be read, such as pipes, are left
/// out, with a warning.
fn user_files(folder: &Path, endings: &[&str], cancel: &Cancel) -> Result<Vec<UserFile>> {
    let mut usable = Vec::new();
    for path in files::walk(folder, endings)? {
        cancel.check()?;
        match user_file(&path) {
            Ok(file) => usable.push(file),
            Err(error) => eprintln!("warning: left out: {}", message(&error)),
        }
    }
    Ok(usable)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_are_shared_out_without_loss() {
        for n in [1, 2, 9, 10, 14, 15, 100, 1300] {
            let counts = share_out(n);
            assert_eq!(counts.train + counts.val + counts.test, n);
            assert!(n < 10 || counts.test >= 1 && counts.train > counts.test);
        }
        assert_eq!(share_out(1300), Counts { train: 1040, val: 130, test: 130 });
    }
}
