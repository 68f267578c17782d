//! The pictures that a side of the viewer can show.

use crate::dataset::contact::Channel;
use serde::{Deserialize, Serialize};

/// What a side shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Method {
    /// The split sum.
    #[serde(rename = "ibl")]
    Ibl,
    /// Deferred shading with shadow maps.
    #[serde(rename = "deferred")]
    Deferred,
    /// The network on deferred shading.
    #[serde(rename = "neural")]
    Neural,
    /// The network on a few traced samples.
    #[serde(rename = "neural+rays")]
    NeuralRays,
    /// Path tracing with OIDN, until it has converged.
    #[serde(rename = "denoised")]
    Denoised,
    /// Path tracing alone, until it has converged.
    #[serde(rename = "path")]
    Path,
    /// A channel of the G-buffer.
    #[serde(rename = "albedo")]
    Albedo,
    /// See [`Method::Albedo`].
    #[serde(rename = "normal")]
    Normal,
    /// See [`Method::Albedo`].
    #[serde(rename = "depth")]
    Depth,
    /// Roughness, metallic and specular as red, green and blue.
    #[serde(rename = "material")]
    Material,
    /// See [`Method::Albedo`].
    #[serde(rename = "objects")]
    Objects,
    /// See [`Method::Albedo`].
    #[serde(rename = "materials")]
    Materials,
}

impl Method {
    /// All of them, in the order in which the page lists them.
    pub const ALL: [Self; 12] = [
        Self::Ibl,
        Self::Deferred,
        Self::Neural,
        Self::NeuralRays,
        Self::Denoised,
        Self::Path,
        Self::Albedo,
        Self::Normal,
        Self::Depth,
        Self::Material,
        Self::Objects,
        Self::Materials,
    ];

    /// The name that people read.
    pub fn label(self) -> &'static str {
        match self {
            Self::Ibl => "split sum",
            Self::Deferred => "deferred shading",
            Self::Neural => "network",
            Self::NeuralRays => "network + samples",
            Self::Denoised => "path traced + OIDN",
            Self::Path => "path traced",
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth (logarithmic)",
            Self::Material => "roughness, metallic, specular",
            Self::Objects => "object ids",
            Self::Materials => "material ids",
        }
    }

    /// Whether the picture gets better the longer one looks at it.
    pub fn refines(self) -> bool {
        matches!(self, Self::Denoised | Self::Path)
    }

    /// The channel that it is; `None` for pictures of the scene.
    pub fn channel(self) -> Option<Channel> {
        Some(match self {
            Self::Albedo => Channel::Albedo,
            Self::Normal => Channel::Normal,
            Self::Depth => Channel::Depth,
            Self::Material => Channel::Material,
            Self::Objects => Channel::Objects,
            Self::Materials => Channel::Materials,
            _ => return None,
        })
    }
}

/// A half of the page's picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Left of the split.
    Left,
    /// Right of the split; alone where there is none.
    Right,
}

impl Side {
    /// Both.
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// Its place in lists of two.
    pub fn index(self) -> usize {
        self as usize
    }
}
