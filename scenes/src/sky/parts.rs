//! Parts of the composed families: what fills the sky, stands on the horizon, covers the eye, and shines.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Sun;

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

/// What fills the sky of a `scenery` behind clouds and hills.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "kind")]
pub enum Air {
    /// Clear air as in the family `daylight`; with a weak, small, cold "sun" it is a moonlit night.
    Clear {
        /// The sun (or the moon).
        sun: Sun,
        /// Filter on the sun's disc, linear Rec.709, each 0..=4; it also colours what the sun lights directly.
        #[serde(default = "white", skip_serializing_if = "is_white")]
        sun_tint: [f32; 3],
        /// Haze, as in `daylight`, 1..=12.
        turbidity: f32,
        /// Mean luminance of the clear upper half without the sun's disc, 0.0001..=100.
        luminance: f32,
        /// Filter on the sky's light, linear Rec.709, each 0..=4.
        #[serde(default = "white", skip_serializing_if = "is_white")]
        tint: [f32; 3],
    },
    /// A smooth gradient without a sun.
    Gradient {
        /// Radiance at the zenith, each 0..=10000.
        zenith: [f32; 3],
        /// Radiance at the horizon, each 0..=10000.
        horizon: [f32; 3],
        /// Exponent of the sine of the elevation, 0.1..=10.
        sharpness: f32,
    },
    /// The overcast sky of the family `overcast`.
    Overcast {
        /// Radiance at the zenith, each 0..=10000.
        zenith: [f32; 3],
        /// Brightening towards the hidden sun as a share of the sky's radiance, 0..=10.
        #[serde(default)]
        glow: f32,
        /// Elevation of the hidden sun, degrees, 0..=90.
        #[serde(default)]
        glow_elevation: f32,
        /// Azimuth of the hidden sun, degrees.
        #[serde(default)]
        glow_azimuth: f32,
    },
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

/// A layer of clouds; layers are listed from the highest to the lowest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CloudLayer {
    /// What kind.
    pub kind: CloudKind,
    /// Share of the sky covered, 0..=1.
    pub coverage: f32,
    /// Size, 0.2..=5; 1 = about a dozen heaps across the sky.
    pub scale: f32,
    /// Factor on the optical thickness, 0.02..=3.
    #[serde(default = "one")]
    pub depth: f32,
    /// Azimuth along which the layer is drawn out, degrees.
    #[serde(default)]
    pub direction: f32,
    /// Which clouds.
    pub seed: u32,
}

/// Stars and the milky way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stars {
    /// Stars above the horizon and below it, 1..=4000.
    pub count: u32,
    /// Luminance of the whole map that the stars bring on average before anything hides them, 0..=10.
    pub luminance: f32,
    /// Radiance at the brightest part of the milky way, each 0..=10.
    #[serde(default)]
    pub milky_way: [f32; 3],
    /// Which stars, and how the milky way lies.
    pub seed: u32,
}

/// A soft bright place in the sky: a town behind the hills, the last light of the evening.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Glow {
    /// Elevation of the middle, degrees, -30..=90.
    pub elevation: f32,
    /// Azimuth of the middle, degrees.
    pub azimuth: f32,
    /// Angle at which it has fallen to 1/e, degrees, 3..=90.
    pub width: f32,
    /// How much flatter than wide it is, 1..=8.
    #[serde(default = "one")]
    pub flatness: f32,
    /// Radiance added in the middle, each 0..=1000.
    pub radiance: [f32; 3],
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

/// A silhouette all around that hides part of the sky and of the sun.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Horizon {
    /// What it is.
    pub kind: HorizonKind,
    /// Elevation of its highest points, degrees, 0.2..=75.
    pub height: f32,
    /// Diffuse reflectance, linear Rec.709, each 0..=1.
    pub color: [f32; 3],
    /// Share of the sky's colour before its farthest part, 0..=1.
    #[serde(default)]
    pub haze: f32,
    /// Share of windows with light, 0..=1 (`skyline` and `roofs`).
    #[serde(default)]
    pub lit: f32,
    /// Luminance of the whole map that lit windows bring on average, 0..=100.
    #[serde(default)]
    pub luminance: f32,
    /// Which hills or houses.
    pub seed: u32,
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

/// Something between the eye and the sky with holes in it; it dims the sun where it stands before it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cover {
    /// What it is.
    pub kind: CoverKind,
    /// Share that is closed, 0.02..=0.98.
    pub amount: f32,
    /// Size of its parts, 0.2..=5.
    pub scale: f32,
    /// Elevation of a cave's opening, degrees, -10..=90.
    #[serde(default)]
    pub elevation: f32,
    /// Azimuth of the opening, of the beams or of the roof's axis, degrees.
    #[serde(default)]
    pub azimuth: f32,
    /// Diffuse reflectance, linear Rec.709, each 0..=1.
    pub color: [f32; 3],
    /// Which leaves.
    pub seed: u32,
}

/// What lies below the horizon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "kind")]
pub enum Ground {
    /// A matt plane.
    Plain {
        /// Diffuse reflectance, linear Rec.709, each 0..=1.
        color: [f32; 3],
        /// Strength of patches, 0..=1.
        #[serde(default)]
        variation: f32,
        /// Which patches.
        #[serde(default)]
        seed: u32,
    },
    /// Water that mirrors the sky and glitters under the sun.
    Water {
        /// Diffuse reflectance of what light leaves the water, each 0..=1.
        color: [f32; 3],
        /// Wind over it, metres a second, 0.2..=15: a wider and dimmer path of light.
        wind: f32,
    },
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

/// A group of lamps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LightGroup {
    /// Where they stand.
    pub layout: Layout,
    /// Their colours.
    pub palette: Palette,
    /// How many, 1..=64.
    pub count: u32,
    /// Typical angular radius, degrees, 0.1..=10.
    pub radius: f32,
    /// Azimuth of the street, the strings or the fire, degrees.
    #[serde(default)]
    pub azimuth: f32,
    /// Typical elevation, degrees, -20..=85.
    pub elevation: f32,
    /// Luminance of the whole map that the group brings on average, 0..=100.
    pub luminance: f32,
    /// Which lamps.
    pub seed: u32,
}

/// A window, panel or glazed door in a face of a `room`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Opening {
    /// Where it is.
    pub wall: super::Wall,
    /// Centre from the middle of the face, sideways and up, metres.
    pub offset: [f32; 2],
    /// Width and height, metres, each 0.05..; the opening lies inside its face.
    pub size: [f32; 2],
    /// Radiance, each 0..=10000.
    pub radiance: [f32; 3],
    /// Radiance below the eye's height (what is seen of the ground outside), each 0..=10000; absent = as above.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<[f32; 3]>,
    /// Panes sideways and up, each 1..=12, with bars between them.
    #[serde(default = "single", skip_serializing_if = "is_single")]
    pub panes: [u32; 2],
    /// Whether the top is a pointed-free half circle (or half ellipse).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub arch: bool,
    /// Coloured glass, another colour a pane; absent = clear.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub glass: Option<u32>,
}

/// Parallel sunlight that falls through the openings of a `room`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Beam {
    /// Where it comes from, degrees above the horizon, 1..=89.
    pub elevation: f32,
    /// Where it comes from, degrees about the vertical.
    pub azimuth: f32,
    /// Irradiance of a surface that faces it, each 0..=10000.
    pub irradiance: [f32; 3],
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

/// What stands in a `room`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Furnishing {
    /// Pillars from floor to ceiling in two rows, 0..=12.
    #[serde(default)]
    pub pillars: u32,
    /// Boxes on the floor (shelves, tables, crates), 0..=16.
    #[serde(default)]
    pub boxes: u32,
    /// Finish of the faces.
    #[serde(default)]
    pub finish: Finish,
    /// Strength of the finish, 0..=1.
    #[serde(default)]
    pub contrast: f32,
    /// Size of boards, tiles, bricks, metres, 0.05..=5.
    #[serde(default = "one")]
    pub scale: f32,
    /// Which boxes and shades.
    #[serde(default)]
    pub seed: u32,
}

/// A lit paper or cloth behind the object in a `studio`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Backdrop {
    /// Azimuth of its middle, degrees.
    pub azimuth: f32,
    /// Width, degrees, 10..=360.
    pub width: f32,
    /// Elevation of its upper edge, degrees, 0..=85.
    pub top: f32,
    /// Elevation of its lower edge, degrees, -90..=0; a sweep runs out below the object.
    pub bottom: f32,
    /// Radiance at the lower edge, each 0..=100.
    pub base: [f32; 3],
    /// Radiance at the upper edge, each 0..=100.
    pub rise: [f32; 3],
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
