//! Shapes that published scenes are made of: their parameters and meshes stay what they were, bit for bit.

use renderflow_scenes::seed::Seed;
use renderflow_scenes::shapes::{FAMILIES, Shape, mesh};

/// BLAKE3 over the parameters and all vertex data of the shapes that `draw` makes from 300 seeds.
fn hash(draw: impl Fn(u64) -> Shape) -> String {
    let mut hasher = blake3::Hasher::new();
    for i in 0..300 {
        let shape = draw(i);
        hasher.update(serde_json::to_string(&shape).unwrap().as_bytes());
        let m = mesh(&shape);
        let vectors = m.positions.iter().chain(&m.normals).flat_map(|p| p.to_array());
        for value in vectors.chain(m.uvs.iter().flat_map(|p| p.to_array())) {
            hasher.update(&value.to_bits().to_le_bytes());
        }
        for index in m.triangles.as_flattened() {
            hasher.update(&index.to_le_bytes());
        }
    }
    hasher.finalize().to_hex()[..16].into()
}

#[test]
fn shapes_of_published_scenes_stay() {
    let named = hash(|i| Shape::random_of(FAMILIES[i as usize % 19], &mut Seed::root(42).child("pinned", i).rng()));
    assert_eq!(named, "d2fad8718a61b6e8");
}
