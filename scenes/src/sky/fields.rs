//! Parts that several families share.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The sun's place, size and strength.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// Degrees above the horizon, -5..=90.
    pub elevation: f32,
    /// Degrees about the vertical: 0 = -Z, 90 = +X.
    #[serde(default)]
    pub azimuth: f32,
    /// Angular radius of the disc, degrees, 0.2..=10; the real sun has 0.27. The irradiance does not depend on it.
    #[serde(default = "real_radius")]
    pub radius: f32,
    /// Gain on the disc alone, 0..=100; 1 = natural, 0 = hidden.
    #[serde(default = "one")]
    pub gain: f32,
}

fn real_radius() -> f32 {
    0.27
}

fn one() -> f32 {
    1.0
}

/// Outline of a lamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LampShape {
    /// A softbox.
    #[default]
    Rectangle,
    /// A round reflector (an ellipse when the sides differ).
    Ellipse,
}

/// A flat lamp that faces the centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lamp {
    /// Centre of the lamp seen from the origin, metres, 0.2..=100 away.
    pub position: [f32; 3],
    /// Width and height, metres, each 0.02..=20.
    pub size: [f32; 2],
    /// Turn about the line to the origin, degrees.
    #[serde(default)]
    pub roll: f32,
    /// Outline.
    #[serde(default)]
    pub shape: LampShape,
    /// Colour, linear Rec.709, each 0..=1.
    pub color: [f32; 3],
    /// Radiance of a white lamp, 0..=100000.
    pub power: f32,
    /// Share of the half extent over which the radiance falls to zero at the rim, 0..=1.
    #[serde(default)]
    pub softness: f32,
    /// What is cut out of the lamp; absent = nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<Mask>,
}

/// A pattern of light and dark in a lamp.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "kind")]
pub enum Mask {
    /// A ring light: dark in the middle.
    Ring {
        /// Radius of the hole over that of the lamp, 0.05..=0.95.
        inner: f32,
    },
    /// Slats as of a venetian blind.
    Slats {
        /// How many, 1..=24.
        count: u32,
        /// Share between them that is open, 0.05..=0.95.
        open: f32,
    },
    /// A grid of bright cells.
    Cells {
        /// Cells across and upwards, each 1..=24.
        cells: [u32; 2],
        /// Side of a cell over its spacing, 0.05..=0.95.
        open: f32,
    },
    /// A gobo of irregular holes.
    Leaves {
        /// Share that is open, 0.05..=0.95.
        open: f32,
        /// Which holes.
        seed: u32,
    },
}

/// Face of a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Wall {
    /// At -Z; sideways is +X, up is +Y.
    North,
    /// At +X; sideways is +Z, up is +Y.
    East,
    /// At +Z; sideways is -X, up is +Y.
    South,
    /// At -X; sideways is -Z, up is +Y.
    West,
    /// At +Y; sideways is +X, "up" is +Z.
    Ceiling,
}

/// A bright rectangle in a face of a room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// Where it is.
    pub wall: Wall,
    /// Centre from the middle of the face, sideways and up, metres.
    pub offset: [f32; 2],
    /// Width and height, metres, each 0.05..; the window lies inside its face.
    pub size: [f32; 2],
    /// Radiance, each 0..=10000.
    pub radiance: [f32; 3],
}
