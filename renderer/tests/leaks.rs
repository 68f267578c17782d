//! No ray passes through a closed mesh: aimed at edges and vertices, bouncing in rooms, started in narrow gaps. `renderflow stress`
//! runs the same counts with more rays.

use renderflow_renderer::verify::geometry::{Losses, closed_room, edge_rays, narrow_gaps, vertex_rays};

const SCALES: [f32; 3] = [1e-6, 1.0, 1e6];

fn none_lost(what: &str, losses: Losses) {
    println!("{what}: {losses:?}");
    assert!(losses.rays > 0, "{what}: no ray was shot");
    assert_eq!((losses.missed, losses.unoccluded, losses.self_hits), (0, 0, 0), "{what}: {losses:?}");
}

#[test]
fn rays_aimed_at_edges_and_vertices_hit() {
    for (seed, scale) in (1..).zip(SCALES) {
        for offset in [0.0, 1.0, 1000.0] {
            none_lost(&format!("edges, scale {scale:e}, offset {offset}"), edge_rays(60_000, scale, offset, seed));
            none_lost(&format!("vertices, scale {scale:e}, offset {offset}"), vertex_rays(60_000, scale, offset, seed));
        }
    }
}

#[test]
fn closed_rooms_keep_their_rays() {
    for (seed, scale) in (1..).zip(SCALES) {
        for offset in [0.0, 1.0, 30.0] {
            none_lost(&format!("room, scale {scale:e}, offset {offset}"), closed_room(100_000, scale, offset, seed));
        }
    }
}

#[test]
fn narrow_gaps_are_crossed() {
    for (seed, scale) in (1..).zip(SCALES) {
        for (offset, gap) in [(0.0, 1e-5), (1.0, 1e-5), (10.0, 1e-4)] {
            none_lost(&format!("gap {gap:e}, scale {scale:e}, offset {offset}"), narrow_gaps(20_000, scale, offset, gap, seed));
        }
    }
}

/// The counts do not depend on the number of threads, and another seed shoots other rays.
#[test]
fn counts_are_reproducible() {
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    // A gap too narrow for its distance from the origin (eight units in the last place), so that there is something to count.
    let run = |threads: usize, seed| pool(threads).install(|| narrow_gaps(30_000, 1.0, 10.0, 1e-5, seed));
    let one = run(1, 1);
    assert!(one.missed + one.self_hits > 0, "{one:?}");
    assert_eq!(one, run(3, 1));
    assert_ne!(one, run(3, 2));
}
