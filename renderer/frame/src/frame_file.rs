//! Reads and writes frames in either form, OpenEXR or compact. The reader looks at the first bytes of a file, not at its ending.

use crate::{Frame, FrameInfo, Result, compact, exr};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Endings of frame files.
pub const EXTENSIONS: [&str; 2] = ["exr", compact::EXTENSION];

/// The form in which frames are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// OpenEXR with every channel ([`crate::exr`]).
    #[default]
    Full,
    /// The channels that training reads, in about a seventh of the bytes ([`crate::compact`]).
    Compact,
}

impl Profile {
    /// Ending of the files, without a dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Full => EXTENSIONS[0],
            Self::Compact => EXTENSIONS[1],
        }
    }

    /// The bytes of a frame file and the number of values that were clamped; errors give `name` as the path.
    ///
    /// # Errors
    /// As [`exr::encode`].
    pub fn encode(self, name: &Path, frame: &Frame) -> Result<(Vec<u8>, usize)> {
        match self {
            Self::Full => exr::encode(name, frame),
            Self::Compact => compact::encode(name, frame).map(|(bytes, loss)| (bytes, loss.clamped)),
        }
    }

    /// Writes a frame and returns the number of values that were clamped.
    ///
    /// # Errors
    /// As [`exr::write()`].
    pub fn write(self, path: &Path, frame: &Frame) -> Result<usize> {
        match self {
            Self::Full => exr::write(path, frame),
            Self::Compact => compact::write(path, frame).map(|loss| loss.clamped),
        }
    }
}

/// Reads a frame file of either form.
///
/// # Errors
/// As [`exr::read`] and [`compact::read`]; a file of neither form gets the error of the OpenEXR reader.
pub fn read(path: &Path) -> Result<Frame> {
    decode(path, &crate::file::read(path)?)
}

/// [`read`] from memory; `name` stands for the path in errors.
///
/// # Errors
/// As [`read`].
pub fn decode(name: &Path, bytes: &[u8]) -> Result<Frame> {
    if bytes.starts_with(&compact::SIGNATURE) { compact::decode(name, bytes) } else { exr::decode(name, bytes) }
}

/// The header values of a frame file of either form; pixels are not decompressed. Errors give `name` as the path.
///
/// # Errors
/// When the bytes are not a frame file or the header is damaged.
pub fn info(name: &Path, bytes: &[u8]) -> Result<FrameInfo> {
    if bytes.starts_with(&compact::SIGNATURE) { compact::info(name, bytes) } else { exr::info(name, bytes) }
}
