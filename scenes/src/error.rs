//! Errors of describing, validating and loading scenes. Every message names the file and the place in it.

use std::fmt;
use std::path::{Path, PathBuf};

/// One violation in a scene: where (JSON pointer) and what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// JSON pointer (RFC 6901), for instance `/materials/3/roughness`.
    pub pointer: String,
    /// What is wrong there, for instance `1.4 is outside 0..=1`.
    pub reason: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.pointer, self.reason)
    }
}

/// What went wrong, with the file and the place it went wrong in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The scene file is not JSON, or a field is missing, unknown or of the wrong type.
    #[error("{}:{line}:{column}: {reason}", path.display())]
    Json {
        /// The scene file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong there.
        reason: String,
    },
    /// Values outside their range, or names that do not fit together; every violation is listed.
    #[error("{}", lines(file.as_deref(), problems))]
    Invalid {
        /// The scene file; `None` for a scene built in memory.
        file: Option<PathBuf>,
        /// At least one.
        problems: Vec<Problem>,
    },
    /// A model file is broken or asks for something this program does not read.
    #[error("{}{}{place}: {reason}", path.display(), if place.is_empty() { "" } else { " " })]
    Model {
        /// The model file.
        path: PathBuf,
        /// Place in it: a JSON pointer (glTF), a line (OBJ), an element (PLY), or empty.
        place: String,
        /// What is wrong there.
        reason: String,
    },
    /// An image cannot be read or decoded.
    #[error("{user}: cannot use texture {}: {reason}", path.display())]
    Texture {
        /// The object or material that wants the image.
        user: String,
        /// The image file, or the model file for an embedded image.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A name in a file leads to where this program may not read.
    #[error("{reason}")]
    Name {
        /// The name, why it is refused, and what to do.
        reason: String,
    },
    /// Something that a scene refers to cannot be loaded.
    #[error("{place}: {source}")]
    At {
        /// JSON pointer and name in the scene.
        place: String,
        /// The cause.
        source: Box<Error>,
    },
    /// A file of any kind, such as an environment map, cannot be read or written.
    #[error(transparent)]
    Frame(#[from] renderflow_frame::Error),
}

/// Result with this crate's [`enum@Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// For `map_err`: an I/O error with its file and what was tried.
    pub(crate) fn io(path: impl Into<PathBuf>, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Frame(renderflow_frame::Error::Io { path, action, source })
    }

    /// An error at `place` of the model file `path`.
    pub(crate) fn model(path: &Path, place: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Model { path: path.into(), place: place.into(), reason: reason.into() }
    }

    /// The same error, with the place in the scene that led to it in front.
    pub(crate) fn at(self, place: impl Into<String>) -> Self {
        Self::At { place: place.into(), source: Box::new(self) }
    }
}

fn lines(file: Option<&Path>, problems: &[Problem]) -> String {
    let prefix = file.map(|f| format!("{} ", f.display())).unwrap_or_default();
    problems.iter().map(|p| format!("{prefix}{p}")).collect::<Vec<_>>().join("\n")
}
