//! Scenes composed from the knobs of a plan: valid, reproducible, free of collisions, and within their knobs and pools.

use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::procedural::varied::{Composed, Composition, Pool, Request, compose_varied};
use renderflow_scenes::seed::Seed;

fn names(list: &[&str]) -> Vec<String> {
    list.iter().map(|&name| name.to_owned()).collect()
}

/// Composes with every family of the catalogue.
fn compose(number: u64, composition: &Composition, frames: u32) -> Composed {
    let catalog = Catalog::new(5, 4096, 512);
    let (meshes, environments) = (names(catalog.mesh_families()), names(catalog.environment_families()));
    let pool = Pool {
        catalog: &catalog,
        mesh_families: &meshes,
        environment_families: &environments,
        models: &[],
        hdris: &[],
        builtin: &[],
    };
    let seed = Seed::root(5).child("sequence", number);
    let request = Request { seed, name: format!("scene-{number}"), resolution: [128, 128], frames, composition, pool: &pool };
    compose_varied(&request).unwrap_or_else(|e| panic!("scene {number}: {e}"))
}

#[test]
fn scenes_are_valid_and_reproducible() {
    for number in 0..20 {
        let composed = compose(number, &Composition::default(), 30);
        composed.scene.validate().unwrap_or_else(|e| panic!("scene {number}: {e}"));
        assert_eq!(composed.scene.hash(), compose(number, &Composition::default(), 30).scene.hash());
        assert!(!composed.meshes.is_empty());
    }
}
