//! The lists of shards in a folder: which lists are this program's own, what they may name, and what may be removed because of
//! them.

use super::{Kind, MANIFEST, Manifest, PROGRAM, Shard, UNFINISHED, verify};
use crate::dataset::plan::SPLITS;
use crate::util::output;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::{file, reach};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::path::Path;

/// The shards of a run that is not finished, and the shards of the previous run that are still there.
#[derive(Serialize, Deserialize)]
pub struct Unfinished {
    version: u32,
    program: String,
    /// Whether the run started from a list without a seal.
    adopted: bool,
    shards: Vec<Shard>,
    seal: String,
}

/// What earlier runs left in a folder.
pub struct EarlierShards {
    /// Their shards.
    pub shards: Vec<Shard>,
    /// Whether they finished: the manifest is there.
    pub finished: bool,
    /// Whether the list is as this program wrote it. Lists of earlier versions have no seal.
    pub sealed: bool,
}

/// BLAKE3 of a list without its seal.
fn seal(list: &impl Serialize) -> Result<String> {
    Ok(blake3::hash(&serde_json::to_vec(list)?).to_hex().to_string())
}

impl Manifest {
    /// The manifest with its seal.
    pub(super) fn sealed(mut self) -> Result<Self> {
        self.seal.clear();
        self.seal = seal(&self)?;
        Ok(self)
    }

    /// Reads the manifest in `out`, and checks its version, its seal, and the names in it.
    ///
    /// # Errors
    /// When one of these is wrong. The message names file and entry.
    pub(super) fn read(out: &Path) -> Result<Self> {
        let path = out.join(MANIFEST);
        let manifest: Self = file::read_json(&path)?;
        ensure!(manifest.version == 1, "{}: /version: {} is not 1", path.display(), manifest.version);
        check_names(&path, "/shards", &manifest.shards)?;
        ensure!(manifest.seal.is_empty() || manifest.clone().sealed()?.seal == manifest.seal, "{}", changed(&path));
        Ok(manifest)
    }
}

/// Said of a list whose seal does not fit.
fn changed(path: &Path) -> String {
    format!("{}: /seal: the file was changed after it was written; choose another folder", path.display())
}

/// The form of `unfinished.json`, of this version or of earlier ones.
#[derive(Deserialize)]
#[serde(untagged)]
enum Listed {
    Sealed(Unfinished),
    Plain(Vec<Shard>),
}

/// Finds what earlier runs left in `out`. Nothing is changed.
///
/// # Errors
/// When the folder holds files but no list of this program's shards; when a list was changed, or names a file that is not named
/// as a shard.
pub fn find(out: &Path) -> Result<EarlierShards> {
    let (unfinished, finished) = (out.join(UNFINISHED), output::exists(&out.join(MANIFEST)));
    if output::exists(&unfinished) {
        let listed: Listed = read(&unfinished)?;
        let (pointer, shards, sealed) = match listed {
            Listed::Plain(shards) => ("", shards, false),
            Listed::Sealed(mut list) => {
                ensure!(list.version == 1, "{}: /version: {} is not 1", unfinished.display(), list.version);
                let written = std::mem::take(&mut list.seal);
                ensure!(seal(&list)? == written, "{}", changed(&unfinished));
                ("/shards", list.shards, !list.adopted)
            }
        };
        check_names(&unfinished, pointer, &shards)?;
        if finished {
            // The run was stopped after it had written the manifest.
            Manifest::read(out).context("not a folder of shards that this program packed; choose another")?;
        }
        return Ok(EarlierShards { shards, finished, sealed });
    }
    if finished {
        let manifest = Manifest::read(out).context("not a folder of shards that this program packed; choose another")?;
        return Ok(EarlierShards { sealed: !manifest.seal.is_empty(), shards: manifest.shards, finished });
    }
    if !output::is_empty(out)? {
        bail!(
            "{}: not empty, and no {MANIFEST} says that this program packed what is in it; choose another folder",
            out.display()
        );
    }
    Ok(EarlierShards { shards: Vec::new(), finished, sealed: true })
}

fn read(path: &Path) -> Result<Listed> {
    let value: serde_json::Value = file::read_json(path)?;
    serde_json::from_value(value).ok().with_context(|| format!("{}: not a list of shards; choose another folder", path.display()))
}

/// Checks that every entry is named as this program names shards.
fn check_names(path: &Path, pointer: &str, shards: &[Shard]) -> Result<()> {
    let mut names = HashSet::new();
    for (number, shard) in shards.iter().enumerate() {
        let at = |field: &str| format!("{}: {pointer}/{number}/{field}", path.display());
        let name = reach::plain_name(&shard.file).map_err(anyhow::Error::msg).with_context(|| at("file"))?;
        ensure!(SPLITS.iter().any(|split| split.name() == shard.split), "{}: {:?} is no split", at("split"), shard.split);
        let part = name.strip_prefix(shard.split.as_str()).and_then(|rest| rest.strip_prefix('-')?.strip_suffix(".tar"));
        let own = match shard.kind {
            Kind::Sequences => part == Some("sequences"),
            Kind::Frames => part.is_some_and(|part| part.parse::<u32>().is_ok_and(|number| format!("{number:06}") == part)),
        };
        ensure!(own, "{}: no shard of the split {} is called {name:?}", at("file"), shard.split);
        ensure!(names.insert(name), "{}: {name:?} a second time", at("file"));
    }
    Ok(())
}

/// Writes the list of a run that continues: the shards that it has finished, and the shards of the run `before` that it has
/// neither replaced nor `removed`.
pub fn unfinished(out: &Path, before: &EarlierShards, shards: &[Shard], removed: &[String]) -> Result<()> {
    let still = |old: &&Shard| shards.iter().all(|new| new.file != old.file) && !removed.contains(&old.file);
    let shards = shards.iter().chain(before.shards.iter().filter(still)).cloned().collect();
    let list = Unfinished { version: 1, program: PROGRAM.into(), adopted: !before.sealed, shards, seal: String::new() };
    let seal = seal(&list)?;
    Ok(file::write_json(&out.join(UNFINISHED), &Unfinished { seal, ..list })?)
}

/// Removes a shard that no set holds any more. It stays, with a note, unless it is known to be the file in a `sealed` list.
pub fn remove(out: &Path, old: &Shard, sealed: bool) -> Result<()> {
    let path = out.join(&old.file);
    let Ok(about) = std::fs::symlink_metadata(&path) else { return Ok(()) };
    let reason = if !sealed {
        "its folder was packed by an earlier version, which left no seal"
    } else if !about.is_file() {
        "it is no regular file"
    } else if !verify::is_whole(&path, old) {
        "it is not the file that was packed"
    } else {
        return std::fs::remove_file(&path).with_context(|| format!("{}: cannot remove", path.display()));
    };
    eprintln!("note: {}: is no longer in the set, but was not removed: {reason}", path.display());
    Ok(())
}
