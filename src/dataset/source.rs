//! The sequences of a dataset on disk, for what reads all of them: [`pack`](super::pack) and [`export`](super::export).

use super::damage;
use super::folder::{frame_number, read_transforms};
use super::home::{self, Home};
use super::manifest::{MANIFEST, Manifest};
use super::plan::SPLITS;
use super::record::Record;
use anyhow::{Context, Result, ensure};
use renderflow_frame::file;
use renderflow_frame::transforms::Sequence;
use std::path::{Path, PathBuf};

/// One sequence. Frames are read on demand.
#[derive(Clone, Debug)]
pub struct Source {
    /// `train`, `val` or `test`.
    pub split: &'static str,
    /// Name of its folder, without a dot.
    pub name: String,
    /// Its folder.
    pub folder: PathBuf,
    /// Cameras, files, keyframes, exposure.
    pub sequence: Sequence,
    /// Number of each stored frame in the sequence.
    pub numbers: Vec<usize>,
    /// `sequence.json`, where there is one.
    pub record: Option<Record>,
}

impl Source {
    /// Name of frame `index` in every form that leaves the folders: `seq-000123_0007`.
    pub fn key(&self, index: usize) -> String {
        format!("{}_{:04}", self.name, self.numbers[index])
    }

    /// File of frame `index`.
    pub fn file(&self, index: usize) -> PathBuf {
        self.folder.join(&self.sequence.files[index])
    }
}

/// A dataset folder.
#[derive(Clone, Debug)]
pub struct Sources {
    /// By split (train, val, test), then by name.
    pub sequences: Vec<Source>,
    /// BLAKE3 of its `manifest.json`, where there is one.
    pub manifest: Option<String>,
}

/// Finds the sequences in `dataset/{train,val,test}`; or `dataset` is one of those folders, or a sequence itself, whose split is by its folder or
/// its record, and else train.
///
/// # Errors
/// When there are none; when there is a manifest and no plan; when a sequence's `transforms.json` cannot be read or a name would not do in an
/// archive; when the dataset has a plan and is not whole: files are missing or of another size, records or the manifest are not right, or
/// there are sequences of no plan.
pub fn open(dataset: &Path) -> Result<Sources> {
    let path = dataset.join(MANIFEST);
    let manifest = match file::read_at_most(&path, file::LARGEST_TEXT) {
        Ok(bytes) => Some(bytes),
        Err(renderflow_frame::Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => None,
        Err(error) => return Err(error.into()),
    };
    let home = Home::of(dataset)?;
    ensure!(
        manifest.is_some() || home.as_ref().is_none_or(|home| home.root != dataset),
        "{}: no {MANIFEST}, so the dataset is not complete; render what is missing and merge it: {}",
        dataset.display(),
        damage::remedy(dataset)
    );
    home::keeps_its_plan(dataset)?;
    let mut sequences = Vec::new();
    if dataset.join("transforms.json").is_file() {
        let full = std::path::absolute(dataset).with_context(|| dataset.display().to_string())?;
        sequences.push(sequence(full.parent().and_then(split_named), full.clone())?);
    }
    for folder in sequence_folders(dataset)? {
        sequences.push(sequence(split_named(&std::path::absolute(dataset)?), folder)?);
    }
    for split in SPLITS.map(|split| split.name()) {
        let folder = dataset.join(split);
        for folder in if folder.is_dir() { sequence_folders(&folder)? } else { Vec::new() } {
            sequences.push(sequence(Some(split), folder)?);
        }
    }
    ensure!(!sequences.is_empty(), "{}: no sequence in it or in its train, val or test", dataset.display());
    if let Some(home) = home {
        let records = home.accept(&home.indices)?;
        let whole = home.root == dataset && records.len() == home.plan.total() as usize;
        if let Some(bytes) = manifest.as_ref().filter(|_| whole) {
            let made = file::json(&path, &Manifest::new(&home.plan, dataset, &records)?)?;
            ensure!(made == *bytes, "{}: is not that of its sequences; to mend it: {}", path.display(), damage::remedy(dataset));
        }
    }
    Ok(Sources { sequences, manifest: manifest.map(|bytes| blake3::hash(&bytes).to_hex().to_string()) })
}

/// The split that a folder is called after.
fn split_named(folder: &Path) -> Option<&'static str> {
    let name = folder.file_name()?.to_str()?;
    SPLITS.map(|split| split.name()).into_iter().find(|split| *split == name)
}

/// Folders with `transforms.json` in `folder`, by name.
fn sequence_folders(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| format!("{}: cannot list", folder.display()))? {
        let path = entry.with_context(|| format!("{}: cannot list", folder.display()))?.path();
        if path.join("transforms.json").is_file() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

fn sequence(split: Option<&'static str>, folder: PathBuf) -> Result<Source> {
    let name = folder.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
    // Readers of archives cut names at the first dot, and some break at other signs.
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    ensure!(!name.is_empty() && name.chars().all(plain), "{}: a name of letters, digits, - and _ is needed", folder.display());
    let sequence = read_transforms(&folder)?;
    let mut numbers = Vec::with_capacity(sequence.files.len());
    for file in &sequence.files {
        let number = frame_number(file);
        numbers.push(number.with_context(|| format!("{}: {file} is no frame of this program", folder.display()))?);
    }
    ensure!(numbers.is_sorted_by(|a, b| a < b), "{}: its frames are not in order", folder.display());
    let record = Record::read(&folder)?;
    let split = split.or(record.as_ref().map(|record| record.split.name())).unwrap_or("train");
    Ok(Source { split, name, folder, sequence, numbers, record })
}
