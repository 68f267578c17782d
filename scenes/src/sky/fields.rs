//! Parts that several families share.

use crate::family::{Parameter, below, family};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

family! {
    /// The sun's place, size and strength.
    pub struct Sun {
        /// Degrees above the horizon.
        elevation: f32 [-5, 90];
        /// Degrees about the vertical: 0 = -Z, 90 = +X.
        #[serde(default)]
        azimuth: f32 [-3600, 3600];
        /// Angular radius of the disc, degrees; the real sun has 0.27. The irradiance does not depend on it.
        #[serde(default = "real_radius")]
        radius: f32 [0.2, 10];
        /// Gain on the disc alone; 1 = natural, 0 = hidden.
        #[serde(default = "one")]
        gain: f32 [0, 100];
    }
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

impl Parameter for LampShape {}

family! {
    /// A flat lamp that faces the centre.
    pub struct Lamp {
        /// Centre of the lamp seen from the origin, metres; 0.2..=100 away.
        position: [f32; 3];
        /// Width and height, metres.
        size: [f32; 2] [0.02, 20];
        /// Turn about the line to the origin, degrees.
        #[serde(default)]
        roll: f32 [-3600, 3600];
        /// Outline.
        #[serde(default)]
        shape: LampShape;
        /// Colour, linear Rec.709.
        color: [f32; 3] [0, 1];
        /// Radiance of a white lamp.
        power: f32 [0, 100000];
        /// Share of the half extent over which the radiance falls to zero at the rim.
        #[serde(default)]
        softness: f32 [0, 1];
        /// What is cut out of the lamp; absent = nothing.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mask: Option<Mask>;
    }, rules |faults, at| {
        let distance = position.iter().map(|v| v * v).sum::<f32>().sqrt();
        if !(0.2..=100.0).contains(&distance) {
            faults.say(&below(at, "position"), format!("{distance} m from the centre is outside 0.2..=100"));
        }
    }
}

family! {
    /// A pattern of light and dark in a lamp.
    pub enum Mask by "kind" {
        /// A ring light: dark in the middle.
        Ring = "ring" {
            /// Radius of the hole over that of the lamp.
            inner: f32 [0.05, 0.95];
        }
        /// Slats as of a venetian blind.
        Slats = "slats" {
            /// How many.
            count: u32 [1, 24];
            /// Share between them that is open.
            open: f32 [0.05, 0.95];
        }
        /// A grid of bright cells.
        Cells = "cells" {
            /// Cells across and upwards.
            cells: [u32; 2] [1, 24];
            /// Side of a cell over its spacing.
            open: f32 [0.05, 0.95];
        }
        /// A gobo of irregular holes.
        Leaves = "leaves" {
            /// Share that is open.
            open: f32 [0.05, 0.95];
            /// Which holes.
            seed: u32;
        }
    }
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

impl Parameter for Wall {}

family! {
    /// A bright rectangle in a face of a room.
    pub struct Window {
        /// Where it is.
        wall: Wall;
        /// Centre from the middle of the face, sideways and up, metres.
        offset: [f32; 2] [-50, 50];
        /// Width and height, metres; the window lies inside its face.
        size: [f32; 2] [0.05, 100];
        /// Radiance.
        radiance: [f32; 3] [0, 10000];
    }
}
