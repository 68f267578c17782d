//! Parametric shapes and their meshes.
//!
//! Every shape is centred on its bounding box and, with its default-like parameters, about one metre in size. All but
//! [`Shape::Plane`] and [`Shape::Disc`] are closed solids: each edge belongs to two triangles and normals point outwards.
//! A body may consist of several pieces that run into one another (leaves and stem, legs and top); each piece is closed.

mod builder;
mod conway;
mod families;
mod generate;
mod inspect;
mod model;
mod parts;
mod polygonise;

use crate::Mesh;
use crate::draw::Draw;
use crate::family::{Faults, Tagged, below, family};
use model::Model;
use rand_pcg::Pcg64;

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
pub use inspect::{MeshReport, geometry_hash, inspect};
pub use model::Stance;

family! {
    /// A parametric shape, about 1 metre in size, centred at the origin; +Y is its upright axis.
    pub enum Shape by "family" |rng| {
        /// A square in the plane y = 0, facing +y (open).
        Plane = "plane" {
            /// Edge length, metres.
            size: f32 [0.01, 10000] = rng.log(0.5, 2.0);
        }
        /// A round plate in the plane y = 0, facing +y (open).
        Disc = "disc" {
            /// Metres.
            radius: f32 [0.01, 10000] = rng.log(0.3, 1.0);
        }
        /// A box, sharp or with rounded edges.
        Box = "box" {
            /// Edge lengths along x, y, z, metres.
            size: [f32; 3] [0.01, 10000] = [0; 3].map(|_| rng.between(0.4, 1.2));
            /// Radius of the rounded edges, metres, at most half the shortest edge; 0 = sharp.
            #[serde(default)]
            bevel: f32 [0, 5000; most 0.5 * least(size)] = if rng.chance(0.6) {
                Pcg64::tidy(least(&size) * rng.between(0.02, 0.3))
            } else {
                0.0
            };
        }
        /// A sphere.
        Sphere = "sphere" {
            /// Metres.
            radius: f32 [0.01, 1000] = rng.between(0.3, 0.55);
        }
        /// An upright cylinder, its rims rounded by `bevel`.
        Cylinder = "cylinder" {
            /// Metres.
            radius: f32 [0.01, 1000] = rng.between(0.15, 0.55);
            /// Metres.
            height: f32 [0.01, 1000] = rng.between(0.3, 1.3);
            /// Radius of the rounded rims, metres, at most the smaller of `radius` and half the height.
            #[serde(default)]
            bevel: f32 [0, 500; most radius.min(0.5 * height)] = if rng.chance(0.6) {
                Pcg64::tidy(radius.min(0.5 * height) * rng.between(0.03, 0.5))
            } else {
                0.0
            };
        }
        /// An upright cone, or a frustum when the top has a radius.
        Cone = "cone" {
            /// Radius at the bottom, metres.
            radius: f32 [0.01, 1000] = rng.between(0.25, 0.6);
            /// Radius at the top, metres; 0 = pointed.
            #[serde(default)]
            top_radius: f32 [0, 1000] = if rng.chance(0.4) { Pcg64::tidy(radius * rng.between(0.2, 0.8)) } else { 0.0 };
            /// Metres.
            height: f32 [0.01, 1000] = rng.between(0.5, 1.3);
        }
        /// An upright cylinder with half spheres on both ends.
        Capsule = "capsule" {
            /// Metres.
            radius: f32 [0.01, 500] = rng.between(0.12, 0.35);
            /// Whole height, metres, at least twice the radius.
            height: f32 [0.02, 1000; least 2.0 * radius] = Pcg64::tidy(radius * rng.between(2.5, 6.0));
        }
        /// A ring lying flat.
        Torus = "torus" {
            /// From the centre to the middle of the tube, metres.
            radius: f32 [0.01, 1000] = rng.between(0.3, 0.5);
            /// Radius of the tube, metres, at most 0.95 of `radius`.
            tube: f32 [0.005, 950; most 0.95 * radius] = Pcg64::tidy(radius * rng.between(0.15, 0.6));
        }
        /// A (p, q) knot about a ring lying flat.
        TorusKnot = "torus_knot" with {
            let (p, q) = [(2u32, 3u32), (3, 2), (2, 5), (3, 4), (3, 5), (1, 4), (1, 6), (5, 2)][rng.below(8) as usize];
            let thickest = (0.5 / p.max(q) as f32).clamp(0.1, 0.2);
        } {
            /// Turns about the ring's axis.
            p: u32 [1, 7];
            /// Turns about the ring's tube, without a common factor with `p`.
            q: u32 [1, 7];
            /// From the centre to the middle of the ring, metres; the path keeps within 0.4 of it.
            radius: f32 [0.05, 100] = rng.between(0.3, 0.45);
            /// Radius of the rope, metres, at most 0.3 of `radius`.
            tube: f32 [0.005, 30; most 0.3 * radius] = Pcg64::tidy(radius * rng.between(0.06, thickest));
        }, rules |faults, at| {
            if greatest_common_divisor(*p, *q) > 1 {
                faults.say(&below(at, "q"), format!("{q} shares a factor with p = {p}: the curve would be walked twice"));
            }
        }
        /// Superellipsoid |(|x|^(2/e) + |z|^(2/e))|^(e/n) + |y|^(2/n) = 1 (Barr 1981): box-like below 1, round at 1, pinched
        /// above.
        Superellipsoid = "superellipsoid" {
            /// Extent along x, y, z, metres.
            size: [f32; 3] [0.01, 1000] = [0; 3].map(|_| rng.between(0.5, 1.1));
            /// Exponent n of the upright profile.
            vertical: f32 [0.2, 2.5] = rng.log(0.25, 2.2);
            /// Exponent e of the horizontal section.
            horizontal: f32 [0.2, 2.5] = rng.log(0.25, 2.2);
        }
        /// A turned body: radii at equal steps of height, joined by a smooth curve.
        Lathe = "lathe" with {
            let count = 3 + rng.below(5) as usize;
            let radii: Vec<f32> = (0..count).map(|_| rng.between(0.12, 0.5)).collect();
            let wall = if rng.chance(0.5) { Pcg64::tidy(least(&radii) * rng.between(0.1, 0.4)) } else { 0.0 };
        } {
            /// Radii from bottom to top, metres.
            radii: Vec<f32> [0.01, 100; count 2, 16];
            /// Metres.
            height: f32 [0.05, 100] = rng.between(0.6, 1.3);
            /// Thickness of the wall of a hollow vessel, metres, at most half the smallest radius and half the height; 0 = solid.
            #[serde(default)]
            wall: f32 [0, 50; most 0.5 * least(radii).min(*height)];
        }
        /// An upright pipe.
        Pipe = "pipe" {
            /// Outer radius, metres.
            radius: f32 [0.01, 1000] = rng.between(0.25, 0.55);
            /// Inner radius, metres, from 0.05 to 0.95 of `radius`.
            inner_radius: f32 [0.0005, 950; least 0.05 * radius; most 0.95 * radius] = Pcg64::tidy(radius * rng.between(0.4, 0.9));
            /// Metres.
            height: f32 [0.01, 1000] = rng.between(0.2, 1.0);
        }
        /// A regular polygon or a star drawn upwards, turning and narrowing on its way.
        Prism = "prism" {
            /// Corners of the polygon or points of the star.
            sides: u32 [3, 24] = 3 + rng.below(8);
            /// Radius of the corners, metres.
            radius: f32 [0.01, 1000] = rng.between(0.3, 0.6);
            /// Metres.
            height: f32 [0.01, 1000] = rng.between(0.2, 1.2);
            /// Radius of the notches between corners as a share of `radius`; absent = a plain polygon.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            star: Option<f32> [0.2, 1] = rng.chance(0.5).then(|| rng.between(0.4, 0.85));
            /// Turn of the top against the bottom, degrees.
            #[serde(default)]
            twist: f32 [-360, 360] = if rng.chance(0.4) { rng.between(-120.0, 120.0) } else { 0.0 };
            /// Size of the top as a share of the bottom; 1 when absent.
            #[serde(default = "one")]
            taper: f32 [0.1, 1.5] = if rng.chance(0.4) { rng.between(0.3, 1.0) } else { 1.0 };
        }
        /// A gear wheel lying flat, with a round hole.
        Gear = "gear" with {
            let teeth = 7 + rng.below(18);
            let (depth, hole) = (rng.between(0.1, 0.25), rng.between(0.1, 0.45));
        } {
            /// Teeth.
            teeth: u32 [5, 48];
            /// Radius to the tips, metres.
            radius: f32 [0.05, 100] = rng.between(0.35, 0.6);
            /// Depth of the teeth as a share of `radius`.
            depth: f32 [0.03, 0.4];
            /// Radius of the hole as a share of `radius`, less than `1 - depth` by 0.05.
            hole: f32 [0.05, 0.5; most (0.95 - depth).min(0.5)];
            /// Thickness of the wheel, metres.
            height: f32 [0.01, 100] = rng.between(0.1, 0.4);
        }
        /// A helical spring standing upright.
        Spring = "spring" with {
            let (radius, turns) = (rng.between(0.2, 0.45), rng.between(2.0, 6.0));
            let height = rng.between(0.6, 1.1);
        } {
            /// From the axis to the middle of the wire, metres.
            radius: f32 [0.05, 100];
            /// Radius of the wire, metres, at most 0.6 of `radius`.
            // Drawn so thin that neighbouring turns stay apart.
            tube: f32 [0.005, 60; most 0.6 * radius] =
                Pcg64::tidy((0.3 * radius).min(0.42 * height / turns) * rng.between(0.4, 0.9)).max(0.01);
            /// Turns.
            turns: f32 [0.5, 12];
            /// Height between the ends of the wire, metres; turns closer than the wire is thick run into one another.
            height: f32 [0.05, 100];
        }
        /// A boulder: a sphere displaced by seeded fractal noise.
        Rock = "rock" {
            /// Mean radius, metres.
            radius: f32 [0.01, 1000] = rng.between(0.35, 0.55);
            /// Displacement as a share of the radius.
            roughness: f32 [0, 0.6] = rng.between(0.2, 0.6);
            /// Bumps across the boulder.
            frequency: f32 [0.3, 6] = rng.log(0.8, 3.0);
            /// Which boulder.
            #[serde(default)]
            seed: u32 = rng.below(1 << 30);
            /// Flat facets instead of a smooth surface.
            #[serde(default)]
            facets: bool = rng.chance(0.4);
        }
        /// A round arch standing on two pillars.
        Arch = "arch" {
            /// Outer width, metres.
            width: f32 [0.05, 100] = rng.between(0.6, 1.2);
            /// Whole height, metres, at least half the width.
            height: f32 [0.025, 100; least 0.5 * width] = Pcg64::tidy(width * rng.between(0.55, 1.3));
            /// Extent along z, metres.
            depth: f32 [0.01, 100] = rng.between(0.2, 0.6);
            /// Thickness of pillars and vault, metres, at most 0.45 of the width.
            thickness: f32 [0.01, 45; most 0.45 * width] = Pcg64::tidy(width * rng.between(0.12, 0.3));
        }
        /// A solid flight of stairs climbing towards +x.
        Stairs = "stairs" {
            /// Steps.
            steps: u32 [2, 24] = 3 + rng.below(8);
            /// Extent along x, y, z, metres.
            size: [f32; 3] [0.05, 100] = [rng.between(0.6, 1.2), rng.between(0.4, 1.0), rng.between(0.4, 1.0)];
        }
        /// Gielis' supershape (2003): superformula r(a) = (|cos(m a / 4)|^k + |sin(m a / 4)|^k)^(-1/n) across and upright.
        Supershape = "supershape" {
            /// Lobes around the upright axis.
            lobes: u32 [0, 16] = 2 + rng.below(9);
            /// Lobes from pole to pole.
            vertical_lobes: u32 [0, 16] = 2 * rng.below(4);
            /// Exponent n.
            n: f32 [0.3, 20] = rng.log(1.0, 8.0);
            /// Exponent k.
            k: f32 [0.3, 20] = rng.log(1.5, 8.0);
            /// Largest extent, metres.
            size: f32 [0.01, 1000] = rng.between(0.7, 1.1);
        }
    }
    or {
        /// A ring whose outline and section are superellipses.
        Supertoroid = "supertoroid";
        /// A simple body displaced by noise.
        Displaced = "displaced";
        /// A section swept along a spline.
        Sweep = "sweep";
        /// A chain of links.
        Chain = "chain";
        /// Interlaced strands.
        Braid = "braid";
        /// A sea shell.
        Seashell = "seashell";
        /// A branching coral.
        Coral = "coral";
        /// A plate with a seeded outline and holes.
        Extrusion = "extrusion";
        /// A letter of an unknown script.
        Glyph = "glyph";
        /// Constructive solid geometry.
        Csg = "csg";
        /// Metaballs.
        Blobs = "blobs";
        /// A solid along a triply periodic minimal surface.
        Gyroid = "gyroid";
        /// A sponge of cubes.
        Sponge = "sponge";
        /// A self-similar solid.
        Fractal = "fractal";
        /// A polyhedron by Conway's operators.
        Polyhedron = "polyhedron";
        /// The open frame of a polyhedron.
        Lattice = "lattice";
        /// A cluster of crystals.
        Crystals = "crystals";
        /// A hollow vessel.
        Vessel = "vessel";
        /// A table, desk or stool.
        Table = "table";
        /// A chair, armchair, bench or sofa.
        Chair = "chair";
        /// Shelves or a cabinet.
        Shelf = "shelf";
        /// A lamp.
        Lamp = "lamp";
        /// A tower with windows.
        Tower = "tower";
        /// A house.
        House = "house";
        /// A column.
        Column = "column";
        /// A block of land.
        Terrain = "terrain";
        /// A tree or bush.
        Tree = "tree";
        /// A cactus.
        Cactus = "cactus";
        /// Leaves about a middle.
        Rosette = "rosette";
        /// A tuft of grass.
        Grass = "grass";
        /// Mushrooms.
        Mushroom = "mushroom";
        /// A threaded bolt.
        Bolt = "bolt";
        /// A flange.
        Flange = "flange";
        /// An angle bracket.
        Bracket = "bracket";
    }
}

fn one() -> f32 {
    1.0
}

fn least(values: &[f32]) -> f32 {
    values.iter().copied().fold(f32::INFINITY, f32::min)
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// Names of the families as scene files write them, in the order of [`Shape`].
pub const FAMILIES: &[&str] = Shape::NAMES;

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
        self.name()
    }

    /// A random member of `family`, one of [`FAMILIES`], about one metre in size and in all ranges; a sphere for any other name.
    pub fn random_of(family: &str, rng: &mut Pcg64) -> Self {
        Self::draw(family, rng).unwrap_or_else(|| Self::Sphere { radius: rng.between(0.3, 0.55) })
    }

    /// Parameters out of their documented range: (JSON pointer below the shape, message such as `-1 is outside 0..=1`).
    pub fn validate(&self) -> Vec<(String, String)> {
        Faults::of(self)
    }

    /// Whether the mesh encloses a volume.
    pub fn is_solid(&self) -> bool {
        !matches!(self, Self::Plane { .. } | Self::Disc { .. })
    }

    /// Whether the mesh is one closed surface that bounds one body, as glass does.
    pub fn is_single(&self) -> bool {
        self.is_solid() && self.model().is_none() && !matches!(self, Self::Arch { .. } | Self::Stairs { .. })
    }

    /// What kind of thing a shape is, for splits that share out all kinds: round, boxy, mechanical, organic, mineral,
    /// architecture, furniture, vessel, plant, terrain, abstract or ground.
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
            Self::Gear { .. } | Self::Torus { .. } | Self::Pipe { .. } | Self::TorusKnot { .. } => Stance::Rim,
            Self::Cylinder { .. } | Self::Capsule { .. } | Self::Spring { .. } | Self::Lathe { wall: 0.0, .. } => Stance::Lying,
            Self::Rock { .. } | Self::Supershape { .. } | Self::Superellipsoid { .. } => Stance::Rolled,
            other => other.model().map_or(Stance::Upright, Model::stance),
        }
    }
}
