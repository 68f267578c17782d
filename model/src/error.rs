//! Errors of networks, weights and training.

use std::path::PathBuf;

/// What went wrong, with the file or the option it went wrong in.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// One tensor of a weights file does not fit the network its configuration describes.
    #[error("{}: tensor {tensor}: {reason}", path.display())]
    Tensor {
        /// The weights file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// What is wrong with it.
        reason: String,
    },
    /// An option outside its range, or options that contradict each other.
    #[error("{option}: {reason}")]
    Config {
        /// Name of the option, as in the configuration file.
        option: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Training data that cannot be used.
    #[error("{place}: {reason}")]
    Data {
        /// Which clip and frame.
        place: String,
        /// What is wrong.
        reason: String,
    },
    /// The loss or a gradient was NaN or infinite in too many steps in a row; nothing of those steps was kept.
    #[error("step {step}: {what} is not finite; lower the learning rate or inspect the data of this step")]
    Diverged {
        /// Step that failed.
        step: u64,
        /// The loss, or the gradient of a named parameter.
        what: String,
    },
    /// This build carries no trained weights.
    #[error("this build carries no trained weights: train some (`renderflow train`) and pass the file")]
    NoShippedWeights,
    /// A file, such as weights or a checkpoint, cannot be read or written, or is not what it should be.
    #[error(transparent)]
    Frame(#[from] renderflow_frame::Error),
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// For `map_err`: an I/O error with its file and what was tried.
    pub fn io(path: impl Into<PathBuf>, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Frame(renderflow_frame::Error::Io { path, action, source })
    }

    /// A format error at `path`.
    pub fn malformed(path: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Frame(renderflow_frame::Error::malformed(path, reason))
    }

    /// A configuration error about `option`.
    pub fn config(option: &'static str, reason: impl Into<String>) -> Self {
        Self::Config { option, reason: reason.into() }
    }
}
