//! What a family with its own file provides.

use super::builder::Builder;
use rand_pcg::Pcg64;

/// How a body may rest on a floor, and how often a composed scene lets it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stance {
    /// Its +Y stays up: furniture, plants, vessels, buildings, terrain, plain solids.
    Upright,
    /// Two in five stand on their rim: wheels and rings.
    Rim,
    /// Three in ten lie on their long side.
    Lying,
    /// Half of them lie on any side.
    Rolled,
    /// A third of them lie on any side.
    Any,
}

/// A family of bodies, from parameters in their ranges to a surface.
pub(super) trait Model {
    /// What kind of thing it is.
    fn group(&self) -> &'static str;
    /// How it may rest.
    fn stance(&self) -> Stance;
    /// Largest extent of the finished mesh, metres.
    fn size(&self) -> f32;
    /// The surface, in any size and place, and the crease angle in degrees.
    fn surface(&self) -> (Builder, f64);
    /// A random member.
    fn draw(rng: &mut Pcg64) -> Self
    where
        Self: Sized;
}
