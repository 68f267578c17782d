//! `transforms.json`: cameras of a sequence in nerfstudio's keys, with the convention stated.

use crate::{Camera, Result};
use std::path::Path;

/// One sequence's cameras and where its frames are.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// Camera of each frame.
    pub cameras: Vec<Camera>,
    /// File of each frame, relative to the folder of `transforms.json`.
    pub files: Vec<String>,
    /// Indices of the keyframes.
    pub keyframes: Vec<usize>,
    /// Exposure factor of the sequence.
    pub exposure: f32,
    /// Environment map, relative file name.
    pub environment: String,
    /// Rotation of the environment, radians about +Y.
    pub environment_rotation: f32,
    /// Gain of the environment.
    pub environment_intensity: f32,
}

/// Writes `transforms.json`.
///
/// # Errors
/// When the file cannot be written.
pub fn write(_path: &Path, _sequence: &Sequence) -> Result<()> {
    todo!()
}

/// Reads `transforms.json`.
///
/// # Errors
/// When the file cannot be read or lacks a key; the message names it.
pub fn read(_path: &Path) -> Result<Sequence> {
    todo!()
}
