//! The denoisers that truth can ask for.

use serde::{Deserialize, Serialize};

/// How the beauty is denoised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Denoise {
    /// OIDN where this machine has it. Elsewhere the picture stays raw, after one warning.
    #[default]
    Auto,
    /// Intel Open Image Denoise. A machine without it fails and says how to get it.
    Oidn,
    /// The network inside the program. It also reads OIDN's picture where OIDN is there. It is for pictures of up to 32 samples a
    /// pixel, not for the truth of datasets.
    Neural,
    /// None: the beauty is the raw mean.
    None,
}
