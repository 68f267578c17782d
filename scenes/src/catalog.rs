//! The meshes and environments of a plan, by number.
//!
//! Number k has family k modulo the number of families, and its parameters follow from the plan's seed and k alone: any of them
//! can be made on any machine without the others, and a larger catalogue begins with the smaller one.

use crate::draw::Draw;
use crate::seed::Seed;
use crate::shapes::{self, Shape};
use crate::sky::{self, Sky};
use rand_pcg::Pcg64;

/// Meshes and environments of a plan by number.
///
/// ```
/// use renderflow_scenes::catalog::Catalog;
/// let catalog = Catalog::new(5, 4096, 512);
/// assert_eq!(catalog.mesh(17).family(), catalog.mesh_family(17));
/// assert_eq!(catalog.environment(100), catalog.environment(100));
/// ```
#[derive(Clone, Debug)]
pub struct Catalog {
    root: Seed,
    meshes: u32,
    environments: u32,
    mesh_families: Vec<&'static str>,
}

impl Catalog {
    /// The catalogue of a plan's seed with this many meshes and environments. Numbers beyond them can be asked for, too.
    pub fn new(seed: u64, meshes: u32, environments: u32) -> Self {
        let root = Seed::root(seed);
        // What is open (a plain square, a disc) is floor, not an object.
        let solid = |family: &&str| Shape::random_of(family, &mut root.child("solid", 0).rng()).is_solid();
        let mesh_families = shapes::FAMILIES.iter().copied().filter(solid).collect();
        Self { root, meshes, environments, mesh_families }
    }

    /// Mesh `k`: its family's random member under the seed of `("mesh", k)`.
    pub fn mesh(&self, k: u32) -> Shape {
        Shape::random_of(self.mesh_family(k), &mut self.root.child("mesh", u64::from(k)).rng())
    }

    /// Family of mesh `k`.
    pub fn mesh_family(&self, k: u32) -> &'static str {
        self.mesh_families[k as usize % self.mesh_families.len()]
    }

    /// Environment `k`: its family's random member under the seed of `("environment", k)`.
    pub fn environment(&self, k: u32) -> Sky {
        let place = k as usize % self.environment_families().len();
        sky::random_at(place, &mut self.root.child("environment", u64::from(k)).rng())
    }

    /// Family of environment `k`, a name of [`sky::ENVIRONMENTS`].
    pub fn environment_family(&self, k: u32) -> &'static str {
        let families = self.environment_families();
        families[k as usize % families.len()]
    }

    /// Number of meshes.
    pub fn meshes(&self) -> u32 {
        self.meshes
    }

    /// Number of environments.
    pub fn environments(&self) -> u32 {
        self.environments
    }

    /// Families of meshes, in the order of [`shapes::FAMILIES`].
    pub fn mesh_families(&self) -> &[&'static str] {
        &self.mesh_families
    }

    /// Families of environments, in the order of [`sky::ENVIRONMENTS`].
    pub fn environment_families(&self) -> &'static [&'static str] {
        &sky::ENVIRONMENTS
    }

    /// A number of a mesh of `family`; `None` where the catalogue has none.
    pub(crate) fn draw_mesh(&self, family: &str, rng: &mut Pcg64) -> Option<u32> {
        draw(&self.mesh_families, self.meshes, family, rng)
    }

    /// A number of an environment of `family`; `None` where the catalogue has none.
    pub(crate) fn draw_environment(&self, family: &str, rng: &mut Pcg64) -> Option<u32> {
        draw(self.environment_families(), self.environments, family, rng)
    }
}

/// One of the numbers below `count` whose family is `family`.
fn draw(families: &[&str], count: u32, family: &str, rng: &mut Pcg64) -> Option<u32> {
    let first = families.iter().position(|f| *f == family)? as u32;
    let step = families.len() as u32;
    (first < count).then(|| first + step * rng.below((count - first).div_ceil(step)))
}
