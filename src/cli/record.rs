//! What made the files of a folder, so that work goes on where it stopped and others are not mixed in.

use anyhow::{Result, bail, ensure};
use renderflow_frame::file;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Writes `record` as the file `name` of the folder `out`, or says that the folder holds what was made in another way.
pub(super) fn claim<R: Serialize + DeserializeOwned + PartialEq>(out: &Path, name: &str, record: &R) -> Result<()> {
    let path = out.join(name);
    if path.is_file() {
        let there: R = file::read_json(&path)?;
        if &there != record {
            bail!("{}: the folder holds pictures of other weights or options; choose another folder", path.display());
        }
        return Ok(());
    }
    let is_empty = !out.exists() || std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_none());
    ensure!(is_empty, "{}: not empty, and no {name} says what made its pictures; choose another folder", out.display());
    Ok(file::write_json(&path, record)?)
}
