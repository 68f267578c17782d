//! The training log, with one JSON object per line.

use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

/// The field that every record has.
#[derive(Deserialize)]
struct Stepped {
    step: u64,
}

/// A log that records are appended to.
pub struct Log {
    path: PathBuf,
    file: File,
}

impl Log {
    /// Checks that the file at `path`, if there is one, is a training log: its first line must be a record.
    ///
    /// # Errors
    /// When the file is something else, or cannot be read.
    pub fn check(path: &Path) -> Result<()> {
        if std::fs::symlink_metadata(path).is_err() {
            return Ok(());
        }
        let mut first = String::new();
        let file = renderflow_frame::file::open(path)?;
        BufReader::new(file.take(1 << 20)).read_line(&mut first).map_err(Error::io(path, "read"))?;
        if first.is_empty() || serde_json::from_str::<Stepped>(&first).is_ok() {
            return Ok(());
        }
        Err(Error::malformed(path, "exists already and is not a training log; choose another output folder"))
    }

    /// Opens the log at `path`. Lines of steps after `resumed` are dropped, because a resumed run takes these steps again.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub fn open(path: &Path, resumed: u64) -> Result<Self> {
        let kept = match renderflow_frame::file::read_text(path) {
            Ok(text) => text
                .lines()
                .map(str::trim)
                .filter(|line| serde_json::from_str::<Stepped>(line).is_ok_and(|record| record.step <= resumed))
                .map(|line| format!("{line}\n"))
                .collect(),
            Err(error) if error.is_missing() => String::new(),
            Err(error) => return Err(error.into()),
        };
        renderflow_frame::file::write_atomic(path, kept.as_bytes())?;
        let file = File::options().append(true).open(path).map_err(Error::io(path, "open"))?;
        Ok(Self { path: path.into(), file })
    }

    /// Appends a record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, record: &impl Serialize) -> Result<()> {
        let mut line = serde_json::to_vec(record).map_err(|e| Error::malformed(&self.path, e.to_string()))?;
        line.push(b'\n');
        self.file.write_all(&line).map_err(Error::io(&self.path, "write"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opening_again_changes_nothing() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("log.jsonl");
        std::fs::write(&path, "{\"step\": 3}\r\r\r\n{\"step\": 9}\n  {\"step\": 4}\nno record\n").expect("write");
        for _ in 0..2 {
            drop(Log::open(&path, 5).expect("opens"));
            assert_eq!(std::fs::read_to_string(&path).expect("read"), "{\"step\": 3}\n{\"step\": 4}\n");
        }
    }
}
