//! Errors of networks, weights and training.

use std::path::PathBuf;

/// An error, with the file or the option that it concerns.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A tensor of a weights file does not fit the network.
    #[error("{}: tensor {tensor}: {reason}", path.display())]
    Tensor {
        /// The weights file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// What is wrong with it.
        reason: String,
    },
    /// An option is outside its range, or options contradict each other.
    #[error("{option}: {reason}")]
    Config {
        /// Name of the option in the configuration file.
        option: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// Input data cannot be used.
    #[error("{place}: {reason}")]
    Data {
        /// The clip, the frame or the input.
        place: String,
        /// What is wrong.
        reason: String,
    },
    /// The loss or a gradient was NaN or infinite in too many steps in a row. Those steps have not changed the weights.
    #[error("step {step}: {what} is not finite; lower the learning rate or inspect the data of this step")]
    Diverged {
        /// The last of these steps.
        step: u64,
        /// The loss, or the gradient of a named parameter.
        what: String,
    },
    /// The processes that train together cannot be joined, or do not fit together.
    #[error("{reason}")]
    Team {
        /// What is wrong.
        reason: String,
    },
    /// A device cannot be used, or failed while it computed.
    #[error("device {device}: {reason}")]
    Device {
        /// The device, as it is chosen.
        device: String,
        /// What is wrong.
        reason: String,
    },
    /// This build has no trained weights.
    #[error("this build has no trained weights: train some (`renderflow train`) and pass the file")]
    NoShippedWeights,
    /// A file, such as weights or a checkpoint, cannot be read or written, or is not in its format.
    #[error(transparent)]
    Frame(#[from] renderflow_frame::Error),
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An I/O error with its file and the operation, for `map_err`.
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
