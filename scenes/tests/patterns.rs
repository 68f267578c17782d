//! Patterns: their maps, how scenes say them and what loading makes of them.

use renderflow_scenes::pattern::{Map, MapSet, Maps, Pattern};
use std::path::Path;

fn all() -> impl Iterator<Item = Pattern> {
    Pattern::KINDS.iter().map(|kind| Pattern::named(kind).unwrap())
}

/// Run by hand: `RENDERFLOW_PATTERNS=folder cargo test --release -p renderflow-scenes --test patterns write -- --ignored --nocapture`.
#[test]
#[ignore = "writes the maps of every kind as PNG into the folder $RENDERFLOW_PATTERNS, prints seconds"]
fn write_maps() {
    let folder = std::env::var_os("RENDERFLOW_PATTERNS").expect("a folder in RENDERFLOW_PATTERNS");
    let folder = Path::new(&folder);
    let mut total = 0.0;
    for pattern in all() {
        let started = std::time::Instant::now();
        let maps = pattern.maps(MapSet::ALL);
        let seconds = started.elapsed().as_secs_f64();
        total += seconds;
        println!("{:16} {:6.1} ms", pattern.kind(), 1e3 * seconds);
        let save = |what: &str, map: &Map| {
            let n = maps.size as u32;
            let bytes = |t: [u16; 4]| t.map(|v| (v >> 8) as u8);
            let texels: Vec<u8> = match map {
                Map::Constant(_) => return,
                Map::Bytes(t) => t.iter().flatten().copied().collect(),
                Map::Words(t) => t.iter().flat_map(|t| bytes(*t)).collect(),
            };
            let path = folder.join(format!("{}.{what}.png", pattern.kind()));
            image::RgbaImage::from_raw(n, n, texels).unwrap().save(path).unwrap();
        };
        let Maps { base_color, metallic_roughness, normal, .. } = &maps;
        save("base", base_color.as_ref().unwrap());
        save("surface", metallic_roughness.as_ref().unwrap());
        save("normal", normal.as_ref().unwrap());
    }
    println!("mean {:.1} ms", 1e3 * total / Pattern::KINDS.len() as f64);
}
