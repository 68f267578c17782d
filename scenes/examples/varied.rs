//! Writes scenes composed from knobs, one file each, and says what they are:
//!
//! `cargo run --release -p renderflow-scenes --example varied -- OUT_FOLDER COUNT FRAMES EDGE [COMPOSITION.json [MODEL...]]`

use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::procedural::varied::{Composition, Pool, Request, compose_varied};
use renderflow_scenes::seed::Seed;
use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, count, frames, edge, rest @ ..] = arguments.as_slice() else {
        return Err("usage: varied OUT_FOLDER COUNT FRAMES EDGE [COMPOSITION.json [MODEL...]]".into());
    };
    let folder = PathBuf::from(folder);
    std::fs::create_dir_all(&folder)?;
    let (composition, models) = match rest {
        [path, models @ ..] => (serde_json::from_str(&std::fs::read_to_string(path)?)?, models),
        [] => (Composition::default(), rest),
    };
    let catalog = Catalog::new(5, 4096, 512);
    let names = |list: &[&str]| list.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
    let (meshes, environments) = (names(catalog.mesh_families()), names(catalog.environment_families()));
    let pool = Pool {
        catalog: &catalog,
        mesh_families: &meshes,
        environment_families: &environments,
        models,
        hdris: &[],
        builtin: &[],
        allowed: &[],
    };
    for number in 0..count.parse()? {
        let begin = Instant::now();
        let request = Request {
            seed: Seed::root(5).child("sequence", number),
            name: format!("scene-{number:03}"),
            resolution: [edge.parse()?; 2],
            frames: frames.parse()?,
            composition: &composition,
            pool: &pool,
        };
        let made = compose_varied(&request)?;
        let seconds = begin.elapsed().as_secs_f64();
        std::fs::write(folder.join(format!("{}.json", made.scene.name)), made.scene.canonical_json())?;
        println!(
            "{} {} {} {} objects, moving {}, changing {}, {}, {:.1} ms",
            made.scene.name,
            made.layout.name(),
            made.camera.name(),
            made.meshes.len(),
            made.moving,
            made.changing,
            made.environment,
            1e3 * seconds
        );
    }
    Ok(())
}
