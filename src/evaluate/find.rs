//! Finds sequences below a folder and says which test set and class of scene each belongs to.

use crate::dataset::SequenceFolder;
use crate::dataset::record::Record;
use crate::testset::{SET, SetFile};
use anyhow::{Context, Result, ensure};
use renderflow_frame::file;
use renderflow_frame::reach::plain_name;
use renderflow_scenes::procedural::Split;
use std::path::{Path, PathBuf};

/// A sequence to evaluate.
#[derive(Clone, Debug)]
pub struct TestSequence {
    /// Test set.
    pub set: String,
    /// Class of scene.
    pub class: String,
    /// The sequence.
    pub folder: SequenceFolder,
    /// What its maker wrote down, where it did.
    pub record: Option<Record>,
}

/// Every sequence at or below `data`, by set, class and name. Of the folders between `data` and a sequence, those named as splits apart,
/// the first is the set and the second the class; where there are fewer, the set is the name of `data` and the class the kind of
/// layout (`scene` where that is not known). Where `data` is a finished test set or inside of one, names are those of the whole set.
///
/// # Errors
/// When there is none, or one cannot be read.
pub fn find(data: &Path) -> Result<Vec<TestSequence>> {
    let mut folders = Vec::new();
    collect(data, &mut folders)?;
    ensure!(!folders.is_empty(), "{}: no sequence (a folder with transforms.json) inside", data.display());
    let above = above(data);
    let mut tests = folders.iter().map(|path| open(data, &above, path)).collect::<Result<Vec<_>>>()?;
    tests.sort_by_cached_key(|test| (test.set.clone(), test.class.clone(), test.folder.name()));
    for pair in tests.windows(2) {
        let name = |test: &TestSequence| (test.set.clone(), test.class.clone(), test.folder.name());
        ensure!(
            name(&pair[0]) != name(&pair[1]),
            "{} and {} would have the same name in the results",
            pair[0].folder.path.display(),
            pair[1].folder.path.display()
        );
    }
    Ok(tests)
}

/// The names of folders that `data` itself stands for: those from the test set on that it is or is inside of.
fn above(data: &Path) -> Vec<String> {
    let Ok(whole) = data.canonicalize() else { return Vec::new() };
    let is_set = |folder: &&Path| file::read_json::<SetFile>(&folder.join(SET)).is_ok();
    let set = whole.ancestors().find(is_set).and_then(Path::parent);
    let inside = set.and_then(|root| whole.strip_prefix(root).ok()).unwrap_or(Path::new(""));
    inside.iter().map(|name| name.to_string_lossy().into_owned()).collect()
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    if folder.join("transforms.json").is_file() {
        found.push(folder.to_owned());
        return Ok(());
    }
    let unreadable = || format!("{}: cannot list", folder.display());
    for entry in std::fs::read_dir(folder).with_context(unreadable)? {
        let path = entry.with_context(unreadable)?.path();
        if path.is_dir() {
            collect(&path, found)?;
        }
    }
    Ok(())
}

fn open(data: &Path, above: &[String], path: &Path) -> Result<TestSequence> {
    let folder = SequenceFolder::open(path)?;
    let record = Record::read(path)?;
    let between = path.parent().and_then(|parent| parent.strip_prefix(data).ok()).unwrap_or(Path::new(""));
    let splits = [Split::Train, Split::Val, Split::Test].map(|split| split.name());
    let names = above.iter().cloned().chain(between.iter().map(|name| name.to_string_lossy().into_owned()));
    let mut names = names.filter(|name| !splits.contains(&name.as_str()));
    let own = || file_name(data).unwrap_or_else(|| "data".into());
    let set = names.next().unwrap_or_else(own);
    // Results are written into a folder of this name.
    let layout = || {
        let recorded = record.as_ref().map(|record| record.layout.clone());
        recorded.filter(|layout| plain_name(layout).is_ok()).unwrap_or_else(|| "scene".into())
    };
    let class = names.next().unwrap_or_else(layout);
    Ok(TestSequence { set, class, folder, record })
}

/// Last part of a path that has a name, `.` and `..` followed.
fn file_name(path: &Path) -> Option<String> {
    let path = path.canonicalize().ok()?;
    path.file_name().map(|name| name.to_string_lossy().into_owned())
}
