//! Opens a dataset with all its sequences, which must be complete, for [`pack`](super::pack) and [`export`](super::export).

use super::damage;
use super::home::{self, Home};
use super::manifest::Manifest;
use super::plan::SPLITS;
use super::sequence::{Sequence, folders};
use crate::dataset::layout::MANIFEST;
use crate::util::files;
use anyhow::{Result, bail, ensure};
use renderflow_frame::file;
use std::path::Path;

/// A dataset with all its sequences.
#[derive(Debug)]
pub struct WholeDataset {
    /// By split, then by name.
    pub sequences: Vec<Sequence>,
    /// BLAKE3 of its `manifest.json`, if there is one.
    pub manifest: Option<String>,
}

/// Opens the sequences in `dataset/{train,val,test}`; `dataset` may also be one of those folders, or a sequence.
///
/// # Errors
/// When there are none; when there is a manifest but no plan; as [`Sequence::open`]; when a name would not do in an archive, or
/// another sequence of the split has it; when
/// the dataset has a plan and is not whole: files are missing or have another size, records or the manifest are wrong, or there
/// are sequences that do not belong to the plan.
pub fn open(dataset: &Path) -> Result<WholeDataset> {
    let path = dataset.join(MANIFEST);
    let manifest = match file::open(&path) {
        Ok(_) => Some(files::hash(&path)?),
        Err(error) if error.is_missing() => None,
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
    let mut paths = folders(dataset)?;
    for split in SPLITS {
        let folder = dataset.join(split.name());
        if folder.is_dir() {
            paths.extend(folders(&folder)?);
        }
    }
    let mut sequences = paths.iter().map(|path| Sequence::open(path)).collect::<Result<Vec<_>>>()?;
    sequences.iter().try_for_each(fits_archive)?;
    let place = |sequence: &Sequence| SPLITS.iter().position(|split| *split == sequence.split);
    sequences.sort_by(|a, b| (place(a), &a.name).cmp(&(place(b), &b.name)));
    if let Some([first, second]) =
        sequences.windows(2).find(|pair| pair[0].split == pair[1].split && pair[0].name == pair[1].name)
    {
        let (split, one, other) = (first.split.name(), first.folder.display(), second.folder.display());
        bail!("{one} and {other}: two sequences of {split} have one name");
    }
    ensure!(!sequences.is_empty(), "{}: no sequence in it or in its train, val or test", dataset.display());
    if let Some(home) = home {
        let records = home.accept(&home.indices)?;
        let whole = home.root == dataset && records.len() == home.plan.total() as usize;
        if manifest.is_some() && whole {
            let expected = file::json(&path, &Manifest::new(&home.plan, dataset, &records)?)?;
            ensure!(
                file::holds(&path, &expected)?,
                "{}: is not that of its sequences; to repair it: {}",
                path.display(),
                damage::remedy(dataset)
            );
        }
    }
    Ok(WholeDataset { sequences, manifest })
}

/// Checks that the name of a sequence will do in an archive: readers of archives cut names at the first dot, and some fail at
/// other signs.
fn fits_archive(sequence: &Sequence) -> Result<()> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let name = &sequence.name;
    let fits = !name.is_empty() && name.chars().all(plain);
    ensure!(fits, "{}: a name of letters, digits, - and _ is needed", sequence.folder.display());
    Ok(())
}

/// Name of stored frame `index` in every form that leaves the folders: `seq-000123_0007`.
pub fn key(sequence: &Sequence, index: usize) -> String {
    format!("{}_{:04}", sequence.name, sequence.numbers[index])
}
