//! Parts of the composed families: what fills the sky, stands on the horizon, covers the eye, and shines.

use super::Sun;
use crate::family::{Parameter, family};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) fn white() -> [f32; 3] {
    [1.0; 3]
}

pub(super) fn is_white(color: &[f32; 3]) -> bool {
    *color == white()
}

fn one() -> f32 {
    1.0
}

fn single() -> [u32; 2] {
    [1; 2]
}

fn is_single(panes: &[u32; 2]) -> bool {
    *panes == single()
}

family! {
    /// What fills the sky of a `scenery` behind clouds and hills.
    pub enum Air by "kind" {
        /// Clear air as in the family `daylight`; with a weak, small, cold "sun" it is a moonlit night.
        Clear = "clear" {
            /// The sun (or the moon).
            sun: Sun;
            /// Filter on the sun's disc, linear Rec.709; it also colours what the sun lights directly.
            #[serde(default = "white", skip_serializing_if = "is_white")]
            sun_tint: [f32; 3] [0, 4];
            /// Haze, as in `daylight`.
            turbidity: f32 [1, 12];
            /// Mean luminance of the clear upper half without the sun's disc.
            luminance: f32 [0.0001, 100];
            /// Filter on the sky's light, linear Rec.709.
            #[serde(default = "white", skip_serializing_if = "is_white")]
            tint: [f32; 3] [0, 4];
        }
        /// A smooth gradient without a sun.
        Gradient = "gradient" {
            /// Radiance at the zenith.
            zenith: [f32; 3] [0, 10000];
            /// Radiance at the horizon.
            horizon: [f32; 3] [0, 10000];
            /// Exponent of the sine of the elevation.
            sharpness: f32 [0.1, 10];
        }
        /// The overcast sky of the family `overcast`.
        Overcast = "overcast" {
            /// Radiance at the zenith.
            zenith: [f32; 3] [0, 10000];
            /// Brightening towards the hidden sun as a share of the sky's radiance.
            #[serde(default)]
            glow: f32 [0, 10];
            /// Elevation of the hidden sun, degrees.
            #[serde(default)]
            glow_elevation: f32 [0, 90];
            /// Azimuth of the hidden sun, degrees.
            #[serde(default)]
            glow_azimuth: f32 [-3600, 3600];
        }
    }
}

/// Kinds of clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CloudKind {
    /// Heaps with clear gaps.
    Cumulus,
    /// Fields of small regular puffs.
    Altocumulus,
    /// Thin streaks of ice, drawn out along `direction`.
    Cirrus,
    /// A grey sheet of little contrast that reaches down to the horizon.
    Stratus,
    /// Towering masses with dark bases.
    Storm,
}

impl Parameter for CloudKind {}

family! {
    /// A layer of clouds; layers are listed from the highest to the lowest.
    pub struct CloudLayer {
        /// What kind.
        kind: CloudKind;
        /// Share of the sky covered.
        coverage: f32 [0, 1];
        /// Size; 1 = about a dozen heaps across the sky.
        scale: f32 [0.2, 5];
        /// Factor on the optical thickness.
        #[serde(default = "one")]
        depth: f32 [0.02, 3];
        /// Azimuth along which the layer is drawn out, degrees.
        #[serde(default)]
        direction: f32 [-3600, 3600];
        /// Which clouds.
        seed: u32;
    }
}

family! {
    /// Stars and the milky way.
    pub struct Stars {
        /// Stars above the horizon and below it.
        count: u32 [1, 4000];
        /// Luminance of the whole map that the stars bring on average before anything hides them.
        luminance: f32 [0, 10];
        /// Radiance at the brightest part of the milky way.
        #[serde(default)]
        milky_way: [f32; 3] [0, 10];
        /// Which stars, and how the milky way lies.
        seed: u32;
    }
}

family! {
    /// A soft bright place in the sky: a town behind the hills, the last light of the evening.
    pub struct Glow {
        /// Elevation of the middle, degrees.
        elevation: f32 [-30, 90];
        /// Azimuth of the middle, degrees.
        azimuth: f32 [-3600, 3600];
        /// Angle at which it has fallen to 1/e, degrees.
        width: f32 [3, 90];
        /// How much flatter than wide it is.
        #[serde(default = "one")]
        flatness: f32 [1, 8];
        /// Radiance added in the middle.
        radiance: [f32; 3] [0, 1000];
    }
}

/// What stands on the horizon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HorizonKind {
    /// Rounded hills, two behind each other.
    Hills,
    /// Three mountain ranges behind each other; the far ones carry snow.
    Ridges,
    /// Sand dunes with sharp crests.
    Dunes,
    /// Trees, some pointed, some round.
    Trees,
    /// High buildings with rows of windows.
    Skyline,
    /// Low houses with pitched roofs.
    Roofs,
    /// Steep rock with ledges.
    Cliffs,
}

impl Parameter for HorizonKind {}

family! {
    /// A silhouette all around that hides part of the sky and of the sun.
    pub struct Horizon {
        /// What it is.
        kind: HorizonKind;
        /// Elevation of its highest points, degrees.
        height: f32 [0.2, 75];
        /// Diffuse reflectance, linear Rec.709.
        color: [f32; 3] [0, 1];
        /// Share of the sky's colour before its farthest part.
        #[serde(default)]
        haze: f32 [0, 1];
        /// Share of windows with light (`skyline` and `roofs`).
        #[serde(default)]
        lit: f32 [0, 1];
        /// Luminance of the whole map that lit windows bring on average.
        #[serde(default)]
        luminance: f32 [0, 100];
        /// Which hills or houses.
        seed: u32;
    }
}

/// What covers the eye.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CoverKind {
    /// Leaves and twigs: dappled light.
    Leaves,
    /// Bars of a glazed barrel roof.
    Ribs,
    /// Parallel beams overhead.
    Lattice,
    /// Rock with one opening.
    Cave,
    /// A round pavilion: a ceiling on columns with arches.
    Arcade,
}

impl Parameter for CoverKind {}

family! {
    /// Something between the eye and the sky with holes in it; it dims the sun where it stands before it.
    pub struct Cover {
        /// What it is.
        kind: CoverKind;
        /// Share that is closed.
        amount: f32 [0.02, 0.98];
        /// Size of its parts.
        scale: f32 [0.2, 5];
        /// Elevation of a cave's opening, degrees.
        #[serde(default)]
        elevation: f32 [-10, 90];
        /// Azimuth of the opening, of the beams or of the roof's axis, degrees.
        #[serde(default)]
        azimuth: f32 [-3600, 3600];
        /// Diffuse reflectance, linear Rec.709.
        color: [f32; 3] [0, 1];
        /// Which leaves.
        seed: u32;
    }
}

family! {
    /// What lies below the horizon.
    pub enum Ground by "kind" {
        /// A matt plane.
        Plain = "plain" {
            /// Diffuse reflectance, linear Rec.709.
            color: [f32; 3] [0, 1];
            /// Strength of patches.
            #[serde(default)]
            variation: f32 [0, 1];
            /// Which patches.
            #[serde(default)]
            seed: u32;
        }
        /// Water that mirrors the sky and glitters under the sun.
        Water = "water" {
            /// Diffuse reflectance of what light leaves the water.
            color: [f32; 3] [0, 1];
            /// Wind over it, metres a second: a wider and dimmer path of light.
            wind: f32 [0.2, 15];
        }
    }
}

/// How lamps stand around.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Anywhere around, most of them low.
    Scattered,
    /// Two rows of posts along a street.
    Street,
    /// Sagging strings of bulbs overhead.
    Strings,
    /// Upright panels, for instance of neon.
    Signs,
    /// One fire of several flames near the ground.
    Fire,
}

impl Parameter for Layout {}

/// Colours of a group of lamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Palette {
    /// Sodium street light.
    Sodium,
    /// Warm white.
    Warm,
    /// Cold white.
    Cool,
    /// Saturated signs.
    Neon,
    /// Sodium, warm, neutral and cold white.
    Mixed,
    /// Flames.
    Flame,
    /// Red, yellow, green, blue bulbs.
    Bulbs,
}

impl Parameter for Palette {}

family! {
    /// A group of lamps.
    pub struct LightGroup {
        /// Where they stand.
        layout: Layout;
        /// Their colours.
        palette: Palette;
        /// How many.
        count: u32 [1, 64];
        /// Typical angular radius, degrees.
        radius: f32 [0.1, 10];
        /// Azimuth of the street, the strings or the fire, degrees.
        #[serde(default)]
        azimuth: f32 [-3600, 3600];
        /// Typical elevation, degrees.
        elevation: f32 [-20, 85];
        /// Luminance of the whole map that the group brings on average.
        luminance: f32 [0, 100];
        /// Which lamps.
        seed: u32;
    }
}

family! {
    /// A window, panel or glazed door in a face of a `room`.
    pub struct Opening {
        /// Where it is.
        wall: super::Wall;
        /// Centre from the middle of the face, sideways and up, metres.
        offset: [f32; 2] [-50, 50];
        /// Width and height, metres; the opening lies inside its face.
        size: [f32; 2] [0.05, 100];
        /// Radiance.
        radiance: [f32; 3] [0, 10000];
        /// Radiance below the eye's height (what is seen of the ground outside); absent = as above.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lower: Option<[f32; 3]> [0, 10000];
        /// Panes sideways and up, with bars between them.
        #[serde(default = "single", skip_serializing_if = "is_single")]
        panes: [u32; 2] [1, 12];
        /// Whether the top is a pointed-free half circle (or half ellipse).
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        arch: bool;
        /// Coloured glass, another colour a pane; absent = clear.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        glass: Option<u32>;
    }
}

family! {
    /// Parallel sunlight that falls through the openings of a `room`.
    pub struct Beam {
        /// Where it comes from, degrees above the horizon.
        elevation: f32 [1, 89];
        /// Where it comes from, degrees about the vertical.
        azimuth: f32 [-3600, 3600];
        /// Irradiance of a surface that faces it.
        irradiance: [f32; 3] [0, 10000];
    }
}

/// Finish of the faces of a `room`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Finish {
    /// Plaster.
    #[default]
    Plain,
    /// Boards of differing shades.
    Planks,
    /// Squares with dark joints.
    Tiles,
    /// Rows of bricks.
    Bricks,
    /// Dark ribs across walls and ceiling.
    Ribs,
    /// Rough rock.
    Rock,
}

impl Parameter for Finish {}

family! {
    /// What stands in a `room`.
    #[derive(Default)]
    pub struct Furnishing {
        /// Pillars from floor to ceiling in two rows.
        #[serde(default)]
        pillars: u32 [0, 12];
        /// Boxes on the floor (shelves, tables, crates).
        #[serde(default)]
        boxes: u32 [0, 16];
        /// Finish of the faces.
        #[serde(default)]
        finish: Finish;
        /// Strength of the finish.
        #[serde(default)]
        contrast: f32 [0, 1];
        /// Size of boards, tiles, bricks, metres.
        #[serde(default = "one")]
        scale: f32 [0.05, 5];
        /// Which boxes and shades.
        #[serde(default)]
        seed: u32;
    }
}

family! {
    /// A lit paper or cloth behind the object in a `studio`.
    pub struct Backdrop {
        /// Azimuth of its middle, degrees.
        azimuth: f32 [-3600, 3600];
        /// Width, degrees.
        width: f32 [10, 360];
        /// Elevation of its upper edge, degrees.
        top: f32 [0, 85];
        /// Elevation of its lower edge, degrees; a sweep runs out below the object.
        bottom: f32 [-90, 0];
        /// Radiance at the lower edge.
        base: [f32; 3] [0, 100];
        /// Radiance at the upper edge.
        rise: [f32; 3] [0, 100];
    }
}

/// What an `abstract` sky is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// The colours in turn along the axis.
    Gradient,
    /// The colours in turn by octants about the axis.
    Quadrants,
    /// A checker of cells about 90/scale degrees wide.
    Checker,
    /// Soft round blobs; the first colour lies between them.
    Blobs,
    /// Round spots with sharp rims; the first colour lies between them.
    Spots,
    /// Bands about the axis.
    Bands,
    /// Veins, as in marble.
    Marble,
}

impl Parameter for Figure {}
