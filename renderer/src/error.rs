//! Errors of compiling and rendering scenes.

/// What went wrong, and where in the scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The loaded scene refers to something it does not hold.
    #[error("/{place}: {reason}")]
    Inconsistent {
        /// Place in the loaded scene, such as `instances/3/material`.
        place: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The scene has more of something than the renderer can count.
    #[error("the scene has {count} {what}; at most {limit} can be rendered")]
    TooLarge {
        /// Triangles, vertices.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// A setting is outside its range.
    #[error("setting {name}: {value} is outside {range}")]
    Setting {
        /// Field of [`crate::Settings`].
        name: &'static str,
        /// The value given.
        value: u64,
        /// The values allowed.
        range: String,
    },
    /// Two films do not belong together.
    #[error("films cannot be merged: {0}")]
    Merge(String),
    /// A map of sample counts cannot be used.
    #[error("sample map: {0}")]
    SampleMap(String),
    /// The caller asked to stop; nothing was produced.
    #[error("rendering was cancelled")]
    Cancelled,
}

/// Result with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A reference that leads nowhere.
    pub(crate) fn inconsistent(place: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Inconsistent { place: place.into(), reason: reason.into() }
    }
}
