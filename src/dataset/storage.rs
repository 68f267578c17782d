//! How frames are stored: the names of their files, writing and reading them.

use super::folder::frame_file;
use super::plan::Storage;
use anyhow::{Context, Result};
use renderflow_frame::{Frame, exr};
use std::path::Path;

impl Storage {
    /// File name of frame `number` of a sequence.
    pub fn file(self, number: usize) -> String {
        frame_file(number)
    }

    /// Writes a frame and returns the bytes it takes; says so where values were clamped.
    pub fn write(self, path: &Path, frame: &Frame) -> Result<u64> {
        let clamped = exr::write(path, frame)?;
        if clamped > 0 {
            eprintln!("warning: {}: {clamped} values beyond 65504 were clamped", path.display());
        }
        let about = std::fs::metadata(path).with_context(|| format!("{}: cannot read", path.display()))?;
        Ok(about.len())
    }

    /// Reads a frame, however it is stored.
    pub fn read(self, path: &Path) -> Result<Frame> {
        Ok(exr::read(path)?)
    }
}

/// As [`Storage::read`] from memory; `name` stands for the path in errors.
pub fn decode(name: &Path, bytes: &[u8]) -> Result<Frame> {
    Ok(exr::decode(name, bytes)?)
}
