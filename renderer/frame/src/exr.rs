//! Frame files: one single-part, scan-line, ZIP16 OpenEXR file a frame, channels by the table in [`crate::channel`].

use crate::{Frame, Result};
use std::path::Path;

/// Writes a frame; half-float values beyond 65504 are clamped. Returns how many were.
///
/// # Errors
/// When a channel holds NaN, or the file cannot be written (nothing is left behind).
pub fn write(_path: &Path, _frame: &Frame) -> Result<usize> {
    todo!()
}

/// Reads a frame written by [`write`]; optional channels may be absent.
///
/// # Errors
/// When the file is missing, is no OpenEXR, or lacks a channel; the message names it.
pub fn read(_path: &Path) -> Result<Frame> {
    todo!()
}
