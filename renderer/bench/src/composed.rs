//! Sixteen scenes as data sets have them, which nobody arranged: composed from one seed, the same on every machine for as long as
//! the composer stays as it is.

use anyhow::Result;
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::description::Scene;
use renderflow_scenes::procedural::{Composition, ENVIRONMENT_COUNT, Layouts, MESH_COUNT, Pool, Request, compose};
use renderflow_scenes::seed::Seed;

/// Stands for all of them on the command line.
pub const ALL: &str = "composed";
/// What they are there for.
pub const ABOUT: &str = "composed_01 to composed_16, as data sets have them: seven grounds, four rooms, five outdoor scenes";
/// Number of scenes.
pub const COUNT: usize = 16;

/// Root of their seeds.
const SEED: u64 = 190_811;
/// Layout of each, in the shares of [`Layouts::default`].
const LAYOUTS: [&str; COUNT] = [
    "ground", "room", "outdoor", "ground", "ground", "outdoor", "room", "ground", "outdoor", "ground", "room", "outdoor",
    "ground", "ground", "outdoor", "room",
];
/// Share of rooms with lamps.
const LAMPS: f64 = 0.5;

/// Names of all, `composed_01` to `composed_16`.
pub fn names() -> impl Iterator<Item = String> {
    (1..=COUNT).map(|number| format!("{ALL}_{number:02}"))
}

/// The scene called `name`, `resolution` pixels along both sides; `None` where no scene of these is called that.
///
/// # Errors
/// When the resolution is out of range.
pub fn describe(name: &str, resolution: u32) -> Result<Option<Scene>> {
    let Some(number) = names().position(|known| known == name) else { return Ok(None) };
    let catalog = Catalog::new(SEED, MESH_COUNT, ENVIRONMENT_COUNT);
    let names = |list: &[&str]| list.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
    let (meshes, environments) = (names(catalog.mesh_families()), names(catalog.environment_families()));
    let only = |layout: &str| f64::from(u8::from(LAYOUTS[number] == layout));
    let layouts = Layouts { ground: only("ground"), room: only("room"), outdoor: only("outdoor") };
    let composition = Composition { layouts, lamps: LAMPS, ..Composition::opaque() };
    let pool = Pool {
        catalog: &catalog,
        mesh_families: &meshes,
        environment_families: &environments,
        models: &[],
        hdris: &[],
        builtin: &[],
        allowed: &[],
    };
    let request = Request {
        seed: Seed::root(SEED).child("sequence", number as u64),
        name: name.to_owned(),
        resolution: [resolution; 2],
        frames: 1,
        composition: &composition,
        pool: &pool,
    };
    Ok(Some(compose(&request)?.scene))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn there_are_sixteen_different_scenes() {
        let scenes: Vec<Scene> = names().map(|name| describe(&name, 64).unwrap().unwrap()).collect();
        assert_eq!(scenes.iter().map(|scene| &scene.name).collect::<HashSet<_>>().len(), COUNT);
        assert_eq!(scenes.iter().map(Scene::canonical_json).collect::<HashSet<_>>().len(), COUNT);
        assert!(scenes.iter().all(|scene| scene.resolution == [64; 2] && scene.frames == 1));
        let lamps = scenes.iter().filter(|scene| scene.materials.iter().any(|m| m.emissive.iter().any(|e| *e > 0.0)));
        assert!((1..=4).contains(&lamps.count()));
        assert!(
            ["composed", "composed_00", "composed_17", "composed_1"].iter().all(|name| describe(name, 16).unwrap().is_none())
        );
    }
}
