//! Parametric shapes and their meshes.
//!
//! Every shape is centred on its bounding box and, with its default-like parameters, about one metre in size. All but
//! [`Shape::Plane`] and [`Shape::Disc`] are closed solids: each edge belongs to two triangles and normals point outwards.
//! A body may consist of several pieces that run into one another (leaves and stem, legs and top); each piece is closed.

mod builder;
mod check;
mod conway;
mod families;
mod generate;
mod inspect;
mod model;
mod parts;
mod polygonise;
mod random;

use crate::Mesh;
use model::Model;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(crate) use check::Faults;
pub use families::buildings::{Column, Crown, House, Order, Roof, Tower};
pub use families::fractals::{Fractal, Holes, Recursion, Sponge};
pub use families::furnishings::{Lamp, LampKind, Shelf};
pub use families::furniture::{Carrier, Chair, Leg, Seat, Table};
pub use families::implicit::{Blobs, Csg, Cut, Gyroid, Minimal};
pub use families::machine::{Bolt, Bracket, Flange, Head};
pub use families::outlines::{Extrusion, Glyph, Outline};
pub use families::plants::{Cactus, CactusKind, Grass, Leaves, Mushroom, Rosette};
pub use families::polyhedra::{Crystals, Finish, Frame, Lattice, Polyhedron};
pub use families::round::{Base, Displaced, Relief, Supertoroid};
pub use families::sea::{Coral, Growth, Seashell};
pub use families::strands::{Braid, Chain, Course, Lace, Section, Sweep};
pub use families::terrain::{Land, Terrain};
pub use families::trees::{Habit, Tree};
pub use families::vessels::{Vessel, VesselKind};
pub use inspect::{MeshReport, geometry_hash, inspect, inward_normals};
pub use model::Stance;

/// A parametric shape, about 1 metre in size, centred at the origin; +Y is its upright axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields, tag = "family")]
pub enum Shape {
    /// A square in the plane y = 0, facing +y (open).
    Plane {
        /// Edge length, metres, 0.01..=10000.
        size: f32,
    },
    /// A round plate in the plane y = 0, facing +y (open).
    Disc {
        /// Metres, 0.01..=10000.
        radius: f32,
    },
    /// A box, sharp or with rounded edges.
    Box {
        /// Edge lengths along x, y, z, metres, each 0.01..=10000.
        size: [f32; 3],
        /// Radius of the rounded edges, metres, 0..=half the shortest edge; 0 = sharp.
        #[serde(default)]
        bevel: f32,
    },
    /// A sphere.
    Sphere {
        /// Metres, 0.01..=1000.
        radius: f32,
    },
    /// An upright cylinder, its rims rounded by `bevel`.
    Cylinder {
        /// Metres, 0.01..=1000.
        radius: f32,
        /// Metres, 0.01..=1000.
        height: f32,
        /// Radius of the rounded rims, metres, 0..=the smaller of `radius` and half the height.
        #[serde(default)]
        bevel: f32,
    },
    /// An upright cone, or a frustum when the top has a radius.
    Cone {
        /// Radius at the bottom, metres, 0.01..=1000.
        radius: f32,
        /// Radius at the top, metres, 0..=1000; 0 = pointed.
        #[serde(default)]
        top_radius: f32,
        /// Metres, 0.01..=1000.
        height: f32,
    },
    /// An upright cylinder with half spheres on both ends.
    Capsule {
        /// Metres, 0.01..=1000.
        radius: f32,
        /// Whole height, metres, at least twice the radius, ..=1000.
        height: f32,
    },
    /// A ring lying flat.
    Torus {
        /// From the centre to the middle of the tube, metres, 0.01..=1000.
        radius: f32,
        /// Radius of the tube, metres, 0.005..=0.95 of `radius`.
        tube: f32,
    },
    /// A (p, q) knot about a ring lying flat.
    TorusKnot {
        /// Turns about the ring's axis, 1..=7.
        p: u32,
        /// Turns about the ring's tube, 1..=7, without a common factor with `p`.
        q: u32,
        /// From the centre to the middle of the ring, metres, 0.05..=100; the path keeps within 0.4 of it.
        radius: f32,
        /// Radius of the rope, metres, 0.005..=0.3 of `radius`.
        tube: f32,
    },
    /// Superellipsoid |(|x|^(2/e) + |z|^(2/e))|^(e/n) + |y|^(2/n) = 1 (Barr 1981): box-like below 1, round at 1, pinched above.
    Superellipsoid {
        /// Extent along x, y, z, metres, each 0.01..=1000.
        size: [f32; 3],
        /// Exponent n of the upright profile, 0.2..=2.5.
        vertical: f32,
        /// Exponent e of the horizontal section, 0.2..=2.5.
        horizontal: f32,
    },
    /// A turned body: radii at equal steps of height, joined by a smooth curve.
    Lathe {
        /// Radii from bottom to top, metres, 2..=16 of them, each 0.01..=100.
        radii: Vec<f32>,
        /// Metres, 0.05..=100.
        height: f32,
        /// Thickness of the wall of a hollow vessel, metres, 0..=0.5 of the smallest radius; 0 = solid.
        #[serde(default)]
        wall: f32,
    },
    /// An upright pipe.
    Pipe {
        /// Outer radius, metres, 0.01..=1000.
        radius: f32,
        /// Inner radius, metres, 0.05..=0.95 of `radius`.
        inner_radius: f32,
        /// Metres, 0.01..=1000.
        height: f32,
    },
    /// A regular polygon or a star drawn upwards, turning and narrowing on its way.
    Prism {
        /// Corners of the polygon or points of the star, 3..=24.
        sides: u32,
        /// Radius of the corners, metres, 0.01..=1000.
        radius: f32,
        /// Metres, 0.01..=1000.
        height: f32,
        /// Radius of the notches between corners as a share of `radius`, 0.2..=1; absent = a plain polygon.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        star: Option<f32>,
        /// Turn of the top against the bottom, degrees, -360..=360.
        #[serde(default)]
        twist: f32,
        /// Size of the top as a share of the bottom, 0.1..=1.5; 1 when absent.
        #[serde(default = "one")]
        taper: f32,
    },
    /// A gear wheel lying flat, with a round hole.
    Gear {
        /// Teeth, 5..=48.
        teeth: u32,
        /// Radius to the tips, metres, 0.05..=100.
        radius: f32,
        /// Depth of the teeth as a share of `radius`, 0.03..=0.4.
        depth: f32,
        /// Radius of the hole as a share of `radius`, 0.05..=0.5, less than `1 - depth` by 0.05.
        hole: f32,
        /// Thickness of the wheel, metres, 0.01..=100.
        height: f32,
    },
    /// A helical spring standing upright.
    Spring {
        /// From the axis to the middle of the wire, metres, 0.05..=100.
        radius: f32,
        /// Radius of the wire, metres, 0.005..=0.6 of `radius`.
        tube: f32,
        /// Turns, 0.5..=12.
        turns: f32,
        /// Height between the ends of the wire, metres, 0.05..=100; turns closer than the wire is thick run into one another.
        height: f32,
    },
    /// A boulder: a sphere displaced by seeded fractal noise.
    Rock {
        /// Mean radius, metres, 0.01..=1000.
        radius: f32,
        /// Displacement as a share of the radius, 0..=0.6.
        roughness: f32,
        /// Bumps across the boulder, 0.3..=6.
        frequency: f32,
        /// Which boulder.
        #[serde(default)]
        seed: u32,
        /// Flat facets instead of a smooth surface.
        #[serde(default)]
        facets: bool,
    },
    /// A round arch standing on two pillars.
    Arch {
        /// Outer width, metres, 0.05..=100.
        width: f32,
        /// Whole height, metres, at least half the width, ..=100.
        height: f32,
        /// Extent along z, metres, 0.01..=100.
        depth: f32,
        /// Thickness of pillars and vault, metres, 0.01..=0.45 of the width.
        thickness: f32,
    },
    /// A solid flight of stairs climbing towards +x.
    Stairs {
        /// Steps, 2..=24.
        steps: u32,
        /// Extent along x, y, z, metres, each 0.05..=100.
        size: [f32; 3],
    },
    /// Gielis' supershape (2003): superformula r(a) = (|cos(m a / 4)|^k + |sin(m a / 4)|^k)^(-1/n) across and upright.
    Supershape {
        /// Lobes around the upright axis, 0..=16.
        lobes: u32,
        /// Lobes from pole to pole, 0..=16.
        vertical_lobes: u32,
        /// Exponent n, 0.3..=20.
        n: f32,
        /// Exponent k, 0.3..=20.
        k: f32,
        /// Largest extent, metres, 0.01..=1000.
        size: f32,
    },
    /// A ring whose outline and section are superellipses.
    Supertoroid(Supertoroid),
    /// A simple body displaced by noise.
    Displaced(Displaced),
    /// A section swept along a spline.
    Sweep(Sweep),
    /// A chain of links.
    Chain(Chain),
    /// Interlaced strands.
    Braid(Braid),
    /// A sea shell.
    Seashell(Seashell),
    /// A branching coral.
    Coral(Coral),
    /// A plate with a seeded outline and holes.
    Extrusion(Extrusion),
    /// A letter of an unknown script.
    Glyph(Glyph),
    /// Constructive solid geometry.
    Csg(Csg),
    /// Metaballs.
    Blobs(Blobs),
    /// A solid along a triply periodic minimal surface.
    Gyroid(Gyroid),
    /// A sponge of cubes.
    Sponge(Sponge),
    /// A self-similar solid.
    Fractal(Fractal),
    /// A polyhedron by Conway's operators.
    Polyhedron(Polyhedron),
    /// The open frame of a polyhedron.
    Lattice(Lattice),
    /// A cluster of crystals.
    Crystals(Crystals),
    /// A hollow vessel.
    Vessel(Vessel),
    /// A table, desk or stool.
    Table(Table),
    /// A chair, armchair, bench or sofa.
    Chair(Chair),
    /// Shelves or a cabinet.
    Shelf(Shelf),
    /// A lamp.
    Lamp(Lamp),
    /// A tower with windows.
    Tower(Tower),
    /// A house.
    House(House),
    /// A column.
    Column(Column),
    /// A block of land.
    Terrain(Terrain),
    /// A tree or bush.
    Tree(Tree),
    /// A cactus.
    Cactus(Cactus),
    /// Leaves about a middle.
    Rosette(Rosette),
    /// A tuft of grass.
    Grass(Grass),
    /// Mushrooms.
    Mushroom(Mushroom),
    /// A threaded bolt.
    Bolt(Bolt),
    /// A flange.
    Flange(Flange),
    /// An angle bracket.
    Bracket(Bracket),
}

fn one() -> f32 {
    1.0
}

/// Names of the families as scene files write them, in the order of [`Shape`].
pub const FAMILIES: [&str; 53] = [
    "plane",
    "disc",
    "box",
    "sphere",
    "cylinder",
    "cone",
    "capsule",
    "torus",
    "torus_knot",
    "superellipsoid",
    "lathe",
    "pipe",
    "prism",
    "gear",
    "spring",
    "rock",
    "arch",
    "stairs",
    "supershape",
    "supertoroid",
    "displaced",
    "sweep",
    "chain",
    "braid",
    "seashell",
    "coral",
    "extrusion",
    "glyph",
    "csg",
    "blobs",
    "gyroid",
    "sponge",
    "fractal",
    "polyhedron",
    "lattice",
    "crystals",
    "vessel",
    "table",
    "chair",
    "shelf",
    "lamp",
    "tower",
    "house",
    "column",
    "terrain",
    "tree",
    "cactus",
    "rosette",
    "grass",
    "mushroom",
    "bolt",
    "flange",
    "bracket",
];

/// How many of [`FAMILIES`], from the start, [`Shape::random`] draws from: the scenes of old seeds are made of these.
pub const RANDOM_FAMILIES: usize = 19;

/// For the families with files of their own: from a shape to its model, and from a name to a random shape.
macro_rules! models {
    ($($variant:ident $family:literal),* $(,)?) => {
        impl Shape {
            fn model(&self) -> Option<&dyn Model> {
                match self {
                    $(Self::$variant(model) => Some(model),)*
                    _ => None,
                }
            }

            fn random_model(family: &str, rng: &mut rand_pcg::Pcg64) -> Option<Self> {
                match family {
                    $($family => Some(Self::$variant($variant::draw(rng))),)*
                    _ => None,
                }
            }
        }
    };
}

models! {
    Supertoroid "supertoroid",
    Displaced "displaced",
    Sweep "sweep",
    Chain "chain",
    Braid "braid",
    Seashell "seashell",
    Coral "coral",
    Extrusion "extrusion",
    Glyph "glyph",
    Csg "csg",
    Blobs "blobs",
    Gyroid "gyroid",
    Sponge "sponge",
    Fractal "fractal",
    Polyhedron "polyhedron",
    Lattice "lattice",
    Crystals "crystals",
    Vessel "vessel",
    Table "table",
    Chair "chair",
    Shelf "shelf",
    Lamp "lamp",
    Tower "tower",
    House "house",
    Column "column",
    Terrain "terrain",
    Tree "tree",
    Cactus "cactus",
    Rosette "rosette",
    Grass "grass",
    Mushroom "mushroom",
    Bolt "bolt",
    Flange "flange",
    Bracket "bracket",
}

/// Triangles of `shape`, centred on its bounding box, with unit normals and texture coordinates, at most about 30,000.
///
/// `shape` should have passed [`Shape::validate`]; parameters out of range give an odd or empty mesh, never a panic.
pub fn mesh(shape: &Shape) -> Mesh {
    generate::mesh(shape)
}

/// The positions of [`mesh`], each once: enough to find where a shape fits, in a third of the time.
pub(crate) fn points(shape: &Shape) -> Vec<glam::Vec3> {
    generate::points(shape)
}

impl Shape {
    /// Name of the family, as in [`FAMILIES`].
    pub fn family(&self) -> &'static str {
        match self {
            Self::Plane { .. } => "plane",
            Self::Disc { .. } => "disc",
            Self::Box { .. } => "box",
            Self::Sphere { .. } => "sphere",
            Self::Cylinder { .. } => "cylinder",
            Self::Cone { .. } => "cone",
            Self::Capsule { .. } => "capsule",
            Self::Torus { .. } => "torus",
            Self::TorusKnot { .. } => "torus_knot",
            Self::Superellipsoid { .. } => "superellipsoid",
            Self::Lathe { .. } => "lathe",
            Self::Pipe { .. } => "pipe",
            Self::Prism { .. } => "prism",
            Self::Gear { .. } => "gear",
            Self::Spring { .. } => "spring",
            Self::Rock { .. } => "rock",
            Self::Arch { .. } => "arch",
            Self::Stairs { .. } => "stairs",
            Self::Supershape { .. } => "supershape",
            other => other.model().map_or("", Model::family),
        }
    }

    /// Whether the mesh encloses a volume.
    pub fn is_solid(&self) -> bool {
        !matches!(self, Self::Plane { .. } | Self::Disc { .. })
    }

    /// What kind of thing a shape is, for splits that share out all kinds: round, boxy, mechanical, organic, mineral, architecture,
    /// furniture, vessel, plant, terrain, abstract or ground.
    pub fn group(&self) -> &'static str {
        match self {
            Self::Plane { .. } | Self::Disc { .. } => "ground",
            Self::Box { .. } | Self::Prism { .. } => "boxy",
            Self::Gear { .. } | Self::Pipe { .. } | Self::Spring { .. } => "mechanical",
            Self::Rock { .. } => "mineral",
            Self::Arch { .. } | Self::Stairs { .. } => "architecture",
            Self::Lathe { .. } => "vessel",
            Self::Supershape { .. } | Self::TorusKnot { .. } => "abstract",
            other => other.model().map_or("round", Model::group),
        }
    }

    /// How a shape may rest on a floor.
    pub fn stance(&self) -> Stance {
        match self {
            Self::Plane { .. } | Self::Disc { .. } | Self::Lathe { .. } | Self::Arch { .. } | Self::Stairs { .. } => {
                Stance::Upright
            }
            other => other.model().map_or(Stance::Any, Model::stance),
        }
    }
}
