//! Finds the dataset that a folder belongs to, for commands that get a part of it: a split to train on, a sequence to export.

use super::damage::{self, Depth};
use super::manifest::Listed;
use super::merge;
use super::plan::{Plan, SPLITS};
use super::record::Record;
use crate::dataset::layout::{MANIFEST, PLAN};
use crate::util::cancel::Cancel;
use anyhow::{Context, Result, bail, ensure};
use std::path::{Path, PathBuf};

/// A folder of a dataset that has a plan.
#[derive(Clone, Debug)]
pub struct Home {
    /// Folder of the dataset.
    pub root: PathBuf,
    /// Its plan.
    pub plan: Plan,
    /// The sequences of the plan that lie in the folder.
    pub indices: Vec<u32>,
}

impl Home {
    /// The dataset that `folder` is, or of which it is a split or a sequence. `None` where there is no plan.
    ///
    /// # Errors
    /// When the plan cannot be read, when the folder is not a sequence of it, or when the folder's dataset has lost its plan.
    pub fn of(folder: &Path) -> Result<Option<Self>> {
        let full = std::path::absolute(folder).with_context(|| folder.display().to_string())?;
        let is_split = |path: &Path| SPLITS.iter().any(|split| path.file_name().is_some_and(|name| name == split.name()));
        let above = |levels: usize| (0..levels).try_fold(folder.to_owned(), |path, _| parent(&path));
        let (root, depth) = if folder.join(PLAN).exists() {
            (folder.to_owned(), 0)
        } else if is_split(&full) {
            (above(1).unwrap_or_default(), 1)
        } else if full.parent().is_some_and(is_split) {
            (above(2).unwrap_or_default(), 2)
        } else {
            return Ok(None);
        };
        let path = root.join(PLAN);
        if !path.exists() {
            keeps_its_plan(&root)?;
            return Ok(None);
        }
        let plan = Plan::read(&path)
            .with_context(|| format!("the plan of the dataset cannot be read; to repair it: {}", damage::remedy(&root)))?;
        let place = |index: u32| std::path::absolute(plan.folder(&root, index)).unwrap_or_default();
        let inside = |index: &u32| place(*index).starts_with(&full);
        let indices: Vec<u32> = (0..plan.total()).filter(inside).collect();
        if depth == 2 && indices.is_empty() {
            bail!("{}: is not a sequence of the dataset that it lies in; {REMOVE}", folder.display());
        }
        for stranger in damage::strangers(&plan, &root)? {
            let inside = std::path::absolute(&stranger).is_ok_and(|stranger| stranger.starts_with(&full));
            ensure!(!inside, "{}: is not a sequence of the dataset that it lies in; {REMOVE}", stranger.display());
        }
        Ok(Some(Self { root, plan, indices }))
    }

    /// Its sequences that have a folder.
    pub fn present(&self) -> Vec<u32> {
        let has_folder = |index: &u32| self.plan.folder(&self.root, *index).is_dir();
        self.indices.iter().copied().filter(has_folder).collect()
    }

    /// The records of the sequences `indices`, after a comparison with the plan, the folders, the scenes and the sizes of the
    /// files.
    ///
    /// # Errors
    /// When a sequence is not complete or damaged. The message names the command that repairs it.
    pub fn accept(&self, indices: &[u32]) -> Result<Vec<Record>> {
        let listed = Listed::read(&self.plan, &self.root);
        let found = damage::sequences(&self.plan, &self.root, indices, &listed, Depth::Sizes, &Cancel::default())?;
        merge::accept(&self.plan, &self.root, indices, found)
    }
}

/// Refuses a dataset that has a manifest but no plan: then nothing says what belongs to it.
///
/// # Errors
/// The message names the command that repairs it.
pub fn keeps_its_plan(root: &Path) -> Result<()> {
    ensure!(
        root.join(PLAN).exists() || !root.join(MANIFEST).exists(),
        "{}: no {PLAN} beside {MANIFEST}, so nothing says what belongs to the dataset; to repair it: {}",
        root.display(),
        damage::remedy(root)
    );
    Ok(())
}

/// What to do about a folder that does not belong to its dataset.
const REMOVE: &str = "move it out of there, or the sequences that are wanted to a folder without a plan";

/// The folder above, spelt as the user did where that is possible.
fn parent(path: &Path) -> Option<PathBuf> {
    match path.parent() {
        Some(parent) if path.file_name().is_some() => {
            Some(if parent.as_os_str().is_empty() { ".".into() } else { parent.to_owned() })
        }
        _ => std::path::absolute(path).ok()?.parent().map(Path::to_owned),
    }
}
