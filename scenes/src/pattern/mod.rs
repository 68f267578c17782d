//! Patterns made from parameters: base colour, roughness, metallic and normals of surfaces that repeat without a seam.
//!
//! A pattern is one square of texture, evaluated in double precision where a scene is loaded: the same bytes on every machine.
//! Lengths are in widths of the texture; how large that is on a surface the material's `texture_transform` says.

mod fabric;
mod field;
mod foliage;
mod geometric;
mod masonry;
mod metal;
pub(crate) mod random;
mod sheet;
mod stone;
mod wood;

pub use fabric::{CrackedPaint, Knitted, Leather, Woven};
pub use foliage::Leaves;
pub use geometric::{Camouflage, Checker, Corrugated, Dots, Graffiti, Stripes};
pub use masonry::{Bricks, Cobbles, Concrete, Mosaic, Plaster, Tiles};
pub use metal::{Brushed, CarbonFibre, ChippedPaint, Hammered, Rust, Scratched, TreadPlate};
pub use sheet::{Map, MapSet, Maps};
pub use stone::{Blotches, CrackedEarth, Granite, Marble, Sand, Terrazzo};
pub use wood::{Parquet, Planks, Wood};

use crate::family::Faults;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// One list for the type, its names and everything that asks each kind the same.
macro_rules! patterns {
    ($($(#[$doc:meta])* $kind:ident = $name:literal,)*) => {
        /// A procedural texture of a material. Every parameter has a default.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "snake_case", tag = "kind")]
        pub enum Pattern {
            $($(#[$doc])* $kind($kind),)*
        }

        impl Pattern {
            /// Names of all kinds, as scene files have them.
            pub const KINDS: &'static [&'static str] = &[$($name),*];

            /// Name of the kind, as scene files have it.
            pub fn kind(&self) -> &'static str {
                match self {
                    $(Self::$kind(_) => $name,)*
                }
            }

            /// A pattern of the named kind with its defaults; `None` for any other name.
            pub fn named(kind: &str) -> Option<Self> {
                match kind {
                    $($name => Some(Self::$kind($kind::default())),)*
                    _ => None,
                }
            }

            /// What is out of range: JSON pointers below the pattern, and reasons.
            pub fn validate(&self) -> Vec<(String, String)> {
                match self {
                    $(Self::$kind(kind) => Faults::of(kind),)*
                }
            }

            /// Makes the maps that are wanted. Parameters out of range give some other picture, but only [`Self::validate`]
            /// tells.
            pub fn maps(&self, wanted: MapSet) -> Maps {
                match self {
                    $(Self::$kind(kind) => kind.maps(wanted),)*
                }
            }

            /// Whether there can be a normal map.
            pub fn has_relief(&self) -> bool {
                match self {
                    $(Self::$kind(kind) => kind.depth > 0.0,)*
                }
            }

            /// The same pattern with another `seed` and `resolution` (texels along an edge, 64..=2048).
            pub fn with(mut self, seed: u32, resolution: u32) -> Self {
                match &mut self {
                    $(Self::$kind(kind) => (kind.seed, kind.resolution) = (seed, resolution),)*
                }
                self
            }
        }
    };
}

patterns! {
    /// Squares of two colours in turn, with fine grooves between them and wear.
    Checker = "checker",
    /// Stripes of uneven widths along u, as on awnings and shirts: ground, first and second stripe, thin line.
    Stripes = "stripes",
    /// Discs on a lattice: ground, one half of the discs, the other half; they can stand out as studs.
    Dots = "dots",
    /// Woodland camouflage: ground, then three colours of patches above each other.
    Camouflage = "camouflage",
    /// Sprayed and poured paint: wall, two fills with dark outlines, and the outline's colour.
    Graffiti = "graffiti",
    /// A round ripple of ribs, as on corrugated sheet, cords and grooved panels: rib, groove.
    Corrugated = "corrugated",
    /// Bricks in running bond: lighter brick, darker brick, mortar.
    Bricks = "bricks",
    /// Square tiles with bevels and grout: most tiles, the others, grout.
    Tiles = "tiles",
    /// Stones set close together, from gravel to cobbles: light stone, dark stone, warm stone, what lies between.
    Cobbles = "cobbles",
    /// Bits of stone or glass set in cement: three colours of bits, cement.
    Mosaic = "mosaic",
    /// Rendered wall with stains that run down: plaster, second tone, stain.
    Plaster = "plaster",
    /// Cast concrete with pores, blotches and the lines of its formwork: light, dark, pore.
    Concrete = "concrete",
    /// Boards side by side along u: light wood, dark wood, gaps.
    Planks = "planks",
    /// One piece of wood, cut along the trunk, grain along u, with knots: early wood, late wood, knots.
    Wood = "wood",
    /// Blocks of parquet in turn along and across: light wood, dark wood, joints.
    Parquet = "parquet",
    /// Polished marble: ground, clouds, veins.
    Marble = "marble",
    /// Granite, polished or rough: four minerals.
    Granite = "granite",
    /// Chips of stone ground flush in a binder: three kinds of chips, binder.
    Terrazzo = "terrazzo",
    /// Earth that dried and tore: earth, second tone, depth of the cracks.
    CrackedEarth = "cracked_earth",
    /// Wind ripples in sand or snow: crest, trough, grains of another colour.
    Sand = "sand",
    /// Soft blotches of three colours into each other.
    Blotches = "blotches",
    /// Rust on metal: metal, light rust, dark rust. Rust is a dielectric, metal is not.
    Rust = "rust",
    /// Bare metal with fine scratches in any direction: metal, tarnish.
    Scratched = "scratched",
    /// Paint on metal with chips down to it, rimmed by primer: paint, primer, metal.
    ChippedPaint = "chipped_paint",
    /// Metal brushed along u: metal, darker lines.
    Brushed = "brushed",
    /// Metal beaten with a round hammer: metal, tarnish between the dents.
    Hammered = "hammered",
    /// Sheet with raised lozenges turned in turn, for stairs and floors: metal, dirt.
    TreadPlate = "tread_plate",
    /// Carbon fibre in twill of two over two: fibres lit, fibres dark.
    CarbonFibre = "carbon_fibre",
    /// Plain weave, from gauze to basketry: warp (runs along v), weft (runs along u), what shows between.
    Woven = "woven",
    /// Stocking stitch: yarn, second yarn of its rows, depth between stitches.
    Knitted = "knitted",
    /// Leather: grain, second tone, creases.
    Leather = "leather",
    /// Old paint, cracked and flaking off: paint, second tone, what lies below, cracks.
    CrackedPaint = "cracked_paint",
    /// Leaves that overlap, with holes between them: leaf, second tone, vein. The holes are in the alpha of the colour.
    Leaves = "leaves",
}
