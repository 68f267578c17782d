//! Datasets in the names and conventions that other tools read.
//!
//! What each form holds is written in its module; none loses anything that the tool could read, and every one states its ranges
//! in JSON.

mod coco;
mod cosmos;
mod nerfstudio;
pub(crate) mod picture;
mod png;

use super::manifest::{MANIFEST, Manifest};
use super::plan::Plan;
use super::source::{self, Source};
use crate::output::{self, Claim};
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, file, frame_file};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Writes a dataset in the names and conventions that another tool reads.
#[derive(Args)]
#[command(after_help = "Example: renderflow dataset export data --to nerfstudio --out nerf\n\
nerfstudio: a folder a sequence: transforms.json (world +Z up), images, 16-bit depths in millimetres, masks of what stands still\n\
cosmos:     <clip>.<frame>.{rgb,basecolor,metallic,roughness,normal,depth,env_ldr,env_log}.png of DiffusionRenderer\n\
png:        every channel as a PNG that can be looked at, 16 bits where 8 would lose something, with data_ranges.json\n\
coco:       images and instances with run lengths; categories are mesh families, with the same ids in every split\n\
The folder must be empty, or one of this form and dataset; it may not be the dataset's own, inside of it or above it.")]
pub struct Options {
    /// Dataset folder, or a split or sequence of it
    dataset: PathBuf,
    /// Tool to write for
    #[arg(long, value_enum)]
    to: Form,
    /// Folder to write to
    #[arg(long)]
    out: PathBuf,
}

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

impl Options {
    /// Exports.
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        let (sequences, frames) = export(&self.dataset, self.to, &self.out, cancel)?;
        println!("{sequences} sequences, {frames} frames: {}", self.out.display());
        Ok(())
    }
}

/// What an exported folder holds.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Mark {
    version: u32,
    form: Form,
    /// BLAKE3 of the manifest of the dataset, where it has one.
    dataset: Option<String>,
}

/// File name of [`Mark`].
const MARK: &str = "export.json";

/// Writes the dataset in `dataset` to `out`; returns how many sequences and frames.
///
/// # Errors
/// When the dataset is not complete, a frame cannot be read or lacks what the form needs, or a file cannot be written; when `out`
/// is the dataset, inside of it or above it, or holds files that this form did not write.
pub fn export(dataset: &Path, to: Form, out: &Path, cancel: &AtomicBool) -> Result<(usize, usize)> {
    let sources = source::open(dataset)?.sequences;
    let root = root(dataset)?;
    let (from, target) = (output::resolved(&root)?, output::resolved(out)?);
    let place =
        |relation: &str| format!("{}: is {relation} the dataset {}; choose another folder", out.display(), root.display());
    ensure!(target != from, "{}", place("the folder of"));
    ensure!(!target.starts_with(&from), "{}", place("inside of"));
    ensure!(!from.starts_with(&target), "{}", place("above"));
    let manifest = file::read_at_most(&root.join(MANIFEST), file::LARGEST_TEXT).ok();
    let mark = Mark { version: 1, form: to, dataset: manifest.map(|bytes| blake3::hash(&bytes).to_hex().to_string()) };
    let claim = Claim::new(out, MARK, &mark, "files of another form or of another dataset")?;
    sources.iter().try_for_each(|source| ready(source, to))?;
    let categories = if to == Form::Coco { coco::Categories::of(&root, &sources)? } else { Default::default() };
    let frames = sources.iter().map(|source| source.numbers.len()).sum();
    let progress = Progress::new("export", frames as u64);
    let job = Job { progress: Some(&progress), cancel, claim: &claim };
    match to {
        Form::Nerfstudio => sources.iter().try_for_each(|source| nerfstudio::sequence(source, out, &job))?,
        Form::Cosmos => sources.iter().try_for_each(|source| cosmos::sequence(source, out, &job))?,
        Form::Png => sources.iter().try_for_each(|source| png::sequence(source, out, &job))?,
        Form::Coco => {
            sources.chunk_by(|a, b| a.split == b.split).try_for_each(|split| coco::split(split, &categories, out, &job))?;
        }
    }
    progress.finish();
    Ok((sources.len(), frames))
}

/// The whole dataset that `dataset` is a split or a sequence of; itself where there is none.
fn root(dataset: &Path) -> Result<PathBuf> {
    let full = output::resolved(dataset)?;
    let is_whole = |folder: &&Path| {
        file::read_json::<Plan>(&folder.join("plan.json")).is_ok() || file::read_json::<Manifest>(&folder.join(MANIFEST)).is_ok()
    };
    let above = full.ancestors().skip(1).take(2).find(is_whole);
    Ok(above.filter(|_| !is_whole(&full.as_path())).map_or_else(|| dataset.to_owned(), Path::to_owned))
}

/// Checks what can be told of a sequence without decoding its frames.
fn ready(source: &Source, to: Form) -> Result<()> {
    for index in 0..source.numbers.len() {
        let (path, file) = (source.file(index), &source.sequence.files[index]);
        ensure!(path.is_file(), "{}: is not there", path.display());
        let recorded = source.record.iter().flat_map(|record| &record.frames).find(|frame| frame.file == *file);
        let traced = recorded.is_none_or(|frame| frame.spp > 0);
        ensure!(traced || to == Form::Png, "{}: {NO_BEAUTY}", path.display());
    }
    Ok(())
}

/// Said of a frame without a picture.
const NO_BEAUTY: &str = "has no beauty (a frame of G-buffers only)";

/// What all forms do with frames.
struct Job<'a> {
    /// Frames done; `None` where they are only looked at.
    progress: Option<&'a Progress>,
    cancel: &'a AtomicBool,
    /// The right to write to the folder.
    claim: &'a Claim,
}

impl Job<'_> {
    /// The same without progress, for frames that are only looked at.
    fn quiet(&self) -> Self {
        Self { progress: None, ..*self }
    }

    /// Writes a file of the export.
    fn write(&self, path: PathBuf, bytes: &[u8]) -> Result<()> {
        self.claim.write()?;
        Ok(file::write_atomic(&path, bytes)?)
    }

    /// Calls `f` with every frame of a sequence, in parallel; the results are in order.
    fn frames<T: Send>(&self, source: &Source, f: impl Fn(usize, Frame) -> Result<T> + Sync) -> Result<Vec<T>> {
        if let Some(progress) = self.progress {
            progress.message(source.name.clone());
        }
        let results = (0..source.numbers.len()).into_par_iter().map(|index| {
            if self.cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            let path = source.file(index);
            let result = f(index, frame_file::read(&path)?).with_context(|| path.display().to_string())?;
            if let Some(progress) = self.progress {
                progress.add(1);
            }
            Ok(result)
        });
        results.collect()
    }
}

/// The picture that people look at: exposure, clamp, sRGB.
fn displayed(frame: &Frame, exposure: f32) -> Result<Rgb> {
    let beauty = frame.beauty.as_ref().context(NO_BEAUTY)?;
    Ok(beauty.map(|pixel| color::display(*pixel, exposure)))
}
