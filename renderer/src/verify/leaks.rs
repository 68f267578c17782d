//! Rays that geometry loses: none, at any size and anywhere; and answers that sharing meshes changes.

use super::geometry::{self, Losses};
use super::{Check, Effort, Outcome, Ticker, Worst};

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "geometry.edges",
        about: "rays aimed at edges of closed meshes from inside: none escapes, flattened and instanced, from 1e-6 to 1e6 times the size",
        run: |effort, ticker| aimed(effort, ticker, geometry::edge_rays),
    },
    Check {
        name: "geometry.vertices",
        about: "the same for rays aimed at vertices",
        run: |effort, ticker| aimed(effort, ticker, geometry::vertex_rays),
    },
    Check {
        name: "geometry.room",
        about: "rays bouncing in closed rooms that hold closed objects: none leaks or meets the triangle it left",
        run: room,
    },
    Check {
        name: "geometry.gaps",
        about: "rays between parallel squares close to each other: none passes through or meets its own",
        run: gaps,
    },
    Check {
        name: "geometry.instances",
        about: "a field of turned, stretched and mirrored instances answers as when flattened",
        run: instances,
    },
];

/// Size and distance from the origin (in sizes) that rays are shot at.
const PLACES: [(f32, f32); 7] = [(1.0, 0.0), (1.0, 10.0), (1.0, 1000.0), (1e-6, 0.0), (1e-6, 10.0), (1e6, 0.0), (1e6, 10.0)];

/// Rays shot between two reports of progress.
const STEP: u64 = 1 << 19;

/// Shoots `total` rays at every place: how many were lost and met their own triangle, the worst place of each.
fn everywhere(
    total: u64,
    ticker: &Ticker<'_>,
    places: &[(f32, f32)],
    shoot: impl Fn(u64, f32, f32, u64) -> Losses,
) -> Vec<Outcome> {
    ticker.expect(places.len() as u64 * total);
    let (mut lost, mut own) = (Worst::default(), Worst::default());
    let mut rays = 0;
    for (scale, offset) in places {
        let mut sum = Losses::default();
        let mut left = total;
        while left > 0 && !ticker.cancelled() {
            let count = left.min(STEP);
            // Every step has random numbers of its own.
            sum = sum + shoot(count, *scale, *offset, left);
            ticker.add(count);
            left -= count;
        }
        let place = || format!("{} rays, size {scale:e}, {offset} sizes from the origin: {sum:?}", sum.rays);
        lost.see((sum.missed + sum.unoccluded) as f64, place);
        own.see(sum.self_hits as f64, place);
        rays += sum.rays;
    }
    [lost.at_most("rays lost", 0.0), own.at_most("rays that met the triangle they left", 0.0)]
        .map(|outcome| Outcome { cases: rays, ..outcome })
        .to_vec()
}

fn aimed(effort: Effort, ticker: &Ticker<'_>, shoot: fn(u64, f32, f32, u64) -> Losses) -> Vec<Outcome> {
    let mut outcomes = everywhere(effort.pick(30_000, 1_000_000), ticker, &PLACES, shoot);
    // These rays start in the open.
    outcomes.truncate(1);
    outcomes
}

fn room(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let mut outcomes = everywhere(effort.pick(200_000, 10_000_000), ticker, &PLACES[..1], geometry::closed_room);
    let others: Vec<_> = PLACES[1..].iter().copied().filter(|(_, offset)| *offset < 1000.0).collect();
    let found = everywhere(effort.pick(50_000, 1_000_000), ticker, &others, geometry::closed_room);
    outcomes.extend(found.into_iter().map(|o| Outcome { name: format!("{}, other sizes and places", o.name), ..o }));
    // Coordinates are rounded to 6e-5 of the room there, and a ray that starts nearer than that to a corner may start behind the
    // other wall: 18 of 1,000,224 did. Scenes are compiled around a near origin and do not get there.
    let mut far = everywhere(effort.pick(50_000, 1_000_000), ticker, &[(1.0, 1000.0)], geometry::closed_room);
    far.truncate(1);
    outcomes.extend(far.into_iter().map(|o| {
        let share = o.worst / o.cases.max(1) as f64;
        Outcome::at_most("share of rays lost, 1000 sizes from the origin", o.cases, share, 1e-4, o.detail)
    }));
    outcomes
}

fn gaps(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let mut outcomes = Vec::new();
    for gap in [1e-2, 1e-3, 1e-4] {
        let shoot = |count, scale, offset, seed| geometry::narrow_gaps(count, scale, offset, gap, seed);
        // Farther out the squares themselves are rounded onto each other.
        let found = everywhere(effort.pick(20_000, 500_000), ticker, &[PLACES[0], PLACES[3], PLACES[5]], shoot);
        outcomes.extend(found.into_iter().map(|o| Outcome { name: format!("{}, gap {gap:e} of the edge", o.name), ..o }));
    }
    // Near the origin, and a little away from it, still narrower ones.
    for (offset, gap) in [(0.0, 1e-5), (1.0, 1e-5), (10.0, 1e-4)] {
        let shoot = |count, scale, offset, seed| geometry::narrow_gaps(count, scale, offset, gap, seed);
        let places = [1e-6, 1.0, 1e6].map(|scale| (scale, offset));
        let found = everywhere(effort.pick(20_000, 500_000), ticker, &places, shoot);
        let name = |o: &Outcome| format!("{}, gap {gap:e} of the edge, {offset} sizes from the origin", o.name);
        outcomes.extend(found.into_iter().map(|o| Outcome { name: name(&o), ..o }));
    }
    outcomes
}

fn instances(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let total = effort.pick(100_000, 4_000_000);
    ticker.expect(total);
    let (mut decided, mut other, mut distance, mut normal) =
        (Worst::default(), Worst::default(), Worst::default(), Worst::default());
    let mut left: u64 = total;
    while left > 0 && !ticker.cancelled() {
        let count = left.min(STEP);
        let found = geometry::instanced_equals_flattened(count, left);
        let place = || format!("{found:?}");
        let share = |n: u64| n as f64 / found.rays.max(1) as f64;
        decided.see(share(found.decided_otherwise), place);
        other.see(share(found.other_triangle), place);
        distance.see(found.largest_distance.into(), place);
        normal.see(found.largest_normal.into(), place);
        ticker.add(count);
        left -= count;
    }
    // Outlines move by a rounding of their corners: a ray in a million or so passes on the other side.
    [
        decided.at_most("share of rays that hit in one and not in the other", 2e-5),
        other.at_most("share of rays that hit another triangle at another distance", 2e-5),
        // At grazing incidence a rounding of the corners moves the point hit by many times its size.
        distance.at_most("largest distance of the points hit, sizes of the scene", 1e-3),
        normal.at_most("largest difference of normals", 1e-4),
    ]
    .map(|outcome| Outcome { cases: total, ..outcome })
    .to_vec()
}
