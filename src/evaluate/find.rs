//! Finds the sequences to evaluate, and names the test set and the class of each.

use super::results::place;
use crate::dataset::plan::SPLITS;
use crate::dataset::sequence::{self, Sequence};
use crate::dataset::testset::{SET, SetFile};
use anyhow::{Result, ensure};
use renderflow_frame::file;
use renderflow_frame::reach::plain_name;
use renderflow_scenes::procedural::Split;
use std::path::Path;

/// A sequence to evaluate.
#[derive(Debug)]
pub struct TestSequence {
    /// Test set.
    pub set: String,
    /// Class of scene.
    pub class: String,
    /// The sequence.
    pub sequence: Sequence,
}

impl TestSequence {
    /// Its set, class and name, as [`SequenceSummary::place`](super::results::SequenceSummary::place).
    pub fn place(&self) -> String {
        place(&self.set, &self.class, &self.sequence.name)
    }
}

/// Finds every sequence at or below `data`, ordered by set, class and name. The first folder between `data` and a sequence is the
/// set, and the second is the class; folders of splits do not count. Where there are fewer, the set is the name of `data`, and
/// the class is the kind of layout (`scene` where that is unknown). If `data` is a finished test set, or lies in one, names start
/// from the whole set.
///
/// # Errors
/// When there is none, when one cannot be read, or when two would have the same name in the results.
pub fn find(data: &Path) -> Result<Vec<TestSequence>> {
    let above = above(data);
    let mut tests: Vec<TestSequence> = sequence::find(data)?.into_iter().map(|sequence| named(data, &above, sequence)).collect();
    tests.sort_by_cached_key(|test| (test.set.clone(), test.class.clone(), test.sequence.name.clone()));
    for test in &tests {
        let summary = [".json", ".jsonl"].iter().any(|ending| test.sequence.name.ends_with(ending));
        let folder = test.sequence.folder.display();
        ensure!(!summary, "{folder}: results cannot have this name, which is that of a file among them; rename the folder");
    }
    for pair in tests.windows(2) {
        let name = |test: &TestSequence| (test.set.clone(), test.class.clone(), test.sequence.name.clone());
        ensure!(
            name(&pair[0]) != name(&pair[1]),
            "{} and {} would have the same name in the results",
            pair[0].sequence.folder.display(),
            pair[1].sequence.folder.display()
        );
    }
    Ok(tests)
}

/// The names of the folders from the test set, if `data` is one or lies in one, down to `data` itself.
fn above(data: &Path) -> Vec<String> {
    let Ok(whole) = data.canonicalize() else { return Vec::new() };
    let is_set = |folder: &&Path| file::read_json::<SetFile>(&folder.join(SET)).is_ok();
    let set = whole.ancestors().find(is_set).and_then(Path::parent);
    let inside = set.and_then(|root| whole.strip_prefix(root).ok()).unwrap_or(Path::new(""));
    inside.iter().map(|name| name.to_string_lossy().into_owned()).collect()
}

/// A sequence with the names of its set and its class.
fn named(data: &Path, above: &[String], sequence: Sequence) -> TestSequence {
    let between = sequence.folder.parent().and_then(|parent| parent.strip_prefix(data).ok()).unwrap_or(Path::new(""));
    let splits = SPLITS.map(Split::name);
    let names = above.iter().cloned().chain(between.iter().map(|name| name.to_string_lossy().into_owned()));
    let mut names = names.filter(|name| !splits.contains(&name.as_str()));
    let own = || file_name(data).unwrap_or_else(|| "data".into());
    let set = names.next().unwrap_or_else(own);
    // Results are written into a folder of this name.
    let layout = || {
        let recorded = sequence.record.as_ref().map(|record| record.layout.clone());
        recorded.filter(|layout| plain_name(layout).is_ok()).unwrap_or_else(|| "scene".into())
    };
    let class = names.next().unwrap_or_else(layout);
    TestSequence { set, class, sequence }
}

/// The last part of a path that has a name; `.` and `..` are resolved.
fn file_name(path: &Path) -> Option<String> {
    let path = path.canonicalize().ok()?;
    path.file_name().map(|name| name.to_string_lossy().into_owned())
}
