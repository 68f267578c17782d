//! Writes datasets in the names and conventions of other tools.
//!
//! Each form is described in its module. No form loses anything that its tool could read, and each states its ranges in JSON.

mod coco;
mod cosmos;
mod nerfstudio;
pub(crate) mod picture;
mod png;

use super::manifest::Manifest;
use super::plan::Plan;
use super::sequence::{Sequence, split_named};
use super::whole;
use crate::dataset::layout::{MANIFEST, PLAN};
use crate::util::cancel::Cancel;
use crate::util::files;
use crate::util::output::{self, Claim};
use crate::util::progress::Progress;
use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, file};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// nerfstudio's data parser
    Nerfstudio,
    /// Cosmos DiffusionRenderer
    Cosmos,
    /// PNG files
    Png,
    /// COCO instances
    Coco,
}

/// What an exported folder holds.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Mark {
    version: u32,
    form: Form,
    /// What tells the dataset from others, see [`identity`]. Earlier versions wrote none for a dataset without a manifest.
    dataset: Option<String>,
}

/// File name of [`Mark`].
const MARK: &str = "export.json";

/// Writes the dataset in `dataset` to `out`; returns the numbers of sequences and frames.
///
/// # Errors
/// When the dataset is not complete, when a frame cannot be read or lacks something that the form needs, or when a file cannot be
/// written; when `out` is the dataset, inside of it or above it, or holds files that this form did not write.
pub fn export(dataset: &Path, to: Form, out: &Path, cancel: &Cancel) -> Result<(usize, usize)> {
    let sequences = whole::open(dataset)?.sequences;
    let root = root(dataset)?;
    let (from, target) = (output::resolved(&root)?, output::resolved(out)?);
    let place =
        |relation: &str| format!("{}: is {relation} the dataset {}; choose another folder", out.display(), root.display());
    ensure!(target != from, "{}", place("the folder of"));
    ensure!(!target.starts_with(&from), "{}", place("inside of"));
    ensure!(!from.starts_with(&target), "{}", place("above"));
    // PNG files of version 1 had exact values beside the pictures.
    let version = if to == Form::Png { 2 } else { 1 };
    let mark = Mark { version, form: to, dataset: Some(identity(&root, &sequences)?) };
    let claim = Claim::new(out, MARK, &mark, "files of another form or of another dataset")?;
    sequences.iter().try_for_each(|sequence| ready(sequence, to))?;
    let categories = if to == Form::Coco { coco::Categories::of(&root, &sequences)? } else { Default::default() };
    let frames = sequences.iter().map(|sequence| sequence.numbers.len()).sum();
    let progress = Progress::new("export", frames as u64);
    let job = Job { progress: Some(&progress), cancel, claim: &claim };
    match to {
        Form::Nerfstudio => sequences.iter().try_for_each(|sequence| nerfstudio::sequence(sequence, out, &job))?,
        Form::Cosmos => sequences.iter().try_for_each(|sequence| cosmos::sequence(sequence, out, &job))?,
        Form::Png => sequences.iter().try_for_each(|sequence| png::sequence(sequence, out, &job))?,
        Form::Coco => {
            let splits = || sequences.chunk_by(|a, b| a.split == b.split);
            splits().try_for_each(|split| coco::holds_no_more(split, out))?;
            splits().try_for_each(|split| coco::split(split, &categories, out, &job))?;
        }
    }
    progress.finish();
    Ok((sequences.len(), frames))
}

/// The whole dataset, if `dataset` is a split or a sequence of one; otherwise `dataset` itself.
fn root(dataset: &Path) -> Result<PathBuf> {
    let full = output::resolved(dataset)?;
    let is_whole = |folder: &Path| {
        file::read_json::<Plan>(&folder.join(PLAN)).is_ok() || file::read_json::<Manifest>(&folder.join(MANIFEST)).is_ok()
    };
    // A plan that lies beside a folder says nothing about it, unless the folder has the place of a split or of a sequence.
    let split = full.ancestors().take(2).position(|folder| split_named(folder).is_some());
    let above = split.and_then(|level| full.ancestors().nth(level + 1));
    let above = above.filter(|above| !is_whole(&full) && is_whole(above));
    Ok(above.map_or_else(|| dataset.to_owned(), Path::to_owned))
}

/// What tells the dataset in `root` from others: BLAKE3 of its manifest or else of its plan, and where it has neither, of all
/// that is in `sequences`.
fn identity(root: &Path, sequences: &[Sequence]) -> Result<String> {
    if let Some(hash) = [MANIFEST, PLAN].iter().find_map(|name| files::hash(&root.join(name)).ok()) {
        return Ok(hash);
    }
    let digest = |sequence: &Sequence| -> Result<(String, String)> {
        let all: Vec<usize> = (0..sequence.len()).collect();
        Ok((format!("{}/{}", sequence.split, sequence.name), sequence.digest(&all)?))
    };
    let digests = sequences.iter().map(digest).collect::<Result<Vec<_>>>()?;
    Ok(blake3::hash(&serde_json::to_vec(&digests)?).to_hex().to_string())
}

/// Checks a sequence as far as that is possible without decoding its frames.
fn ready(sequence: &Sequence, to: Form) -> Result<()> {
    for index in 0..sequence.numbers.len() {
        let (path, file) = (sequence.file(index), &sequence.transforms.files[index]);
        ensure!(path.is_file(), "{}: is not there", path.display());
        let recorded = sequence.record.iter().flat_map(|record| &record.frames).find(|frame| frame.file == *file);
        let traced = recorded.is_none_or(|frame| frame.spp > 0);
        ensure!(traced || to == Form::Png, "{}: {NO_BEAUTY}", path.display());
    }
    Ok(())
}

/// Said of a frame without a picture.
const NO_BEAUTY: &str = "has no beauty (a frame of G-buffers only)";

/// What all forms share.
struct Job<'a> {
    /// Counts frames; `None` while they are only read.
    progress: Option<&'a Progress>,
    cancel: &'a Cancel,
    /// The right to write to the folder.
    claim: &'a Claim,
}

impl Job<'_> {
    /// The same without progress, for frames that are only read.
    fn quiet(&self) -> Self {
        Self { progress: None, ..*self }
    }

    /// Writes a file of the export.
    fn write(&self, path: PathBuf, bytes: &[u8]) -> Result<()> {
        self.claim.write()?;
        Ok(file::write_atomic(&path, bytes)?)
    }

    /// Calls `f` with every frame of a sequence, in parallel. The results are in order.
    fn frames<T: Send>(&self, sequence: &Sequence, f: impl Fn(usize, Frame) -> Result<T> + Sync) -> Result<Vec<T>> {
        if let Some(progress) = self.progress {
            progress.message(sequence.name.clone());
        }
        let results = (0..sequence.numbers.len()).into_par_iter().map(|index| {
            self.cancel.check()?;
            let path = sequence.file(index);
            let result = f(index, sequence.frame(index)?).with_context(|| path.display().to_string())?;
            if let Some(progress) = self.progress {
                progress.add(1);
            }
            Ok(result)
        });
        results.collect()
    }
}

/// The picture as people see it: exposure, clamp, sRGB.
fn displayed(frame: &Frame, exposure: f32) -> Result<Rgb> {
    let beauty = frame.beauty.as_ref().context(NO_BEAUTY)?;
    Ok(beauty.map(|pixel| color::display(*pixel, exposure)))
}
