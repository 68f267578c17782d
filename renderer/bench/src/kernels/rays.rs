//! The rays that are timed: the same for every tracer, and made from ours.

use glam::{Vec2, Vec3A};
use rand::RngExt;
use rand::seq::SliceRandom;
use renderflow_frame::Camera;
use renderflow_renderer::accel::{Accel, Scratch};
use renderflow_renderer::ray::Ray;
use renderflow_scenes::seed::Seed;
use serde::Serialize;

/// A kind of rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// One a pixel from the camera, in tiles of 8 x 8, in each of them in blocks of 4 x 4.
    Primary,
    /// Cosine-distributed from where primary rays hit, in their order: the nearest hit is wanted.
    Diffuse,
    /// The same in random order.
    Shuffled,
    /// As diffuse with other directions: whether anything is hit.
    Shadow,
}

impl Kind {
    /// As in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Primary => "primary",
            Self::Diffuse => "diffuse",
            Self::Shuffled => "shuffled",
            Self::Shadow => "shadow",
        }
    }
}

/// Origin and direction of each ray, relative to the scene's origin, metres.
pub struct Rays {
    /// What they are.
    pub kind: Kind,
    /// Origin, unit direction.
    pub rays: Vec<[Vec3A; 2]>,
}

/// Sides of tiles of primary rays, and of blocks in them that a packet covers, pixels.
const TILES: [usize; 2] = [8, 4];

/// All kinds of rays for what `camera` sees of `triangles`; about as many bounces as primary rays. Kinds without rays are left
/// out.
pub fn make(camera: &Camera, triangles: &[[Vec3A; 3]], accel: &Accel) -> Vec<Rays> {
    let primary = tiled(camera);
    let mut scratch = Scratch::default();
    let reach = triangles.iter().flatten().map(|v| v.abs().max_element()).fold(0.0, f32::max);
    // Off the surface by more than any tracer's rounding, so that all of them agree on what is hit.
    let offset = 1e-4 * reach;
    let points: Vec<[Vec3A; 2]> = primary
        .iter()
        .filter_map(|&[origin, direction]| {
            let hit = accel.closest(&Ray::new(origin, direction), &mut scratch)?;
            let [a, b, c] = triangles[hit.primitive as usize];
            let n = (b - a).cross(c - a).normalize_or_zero();
            let n = if n.dot(direction) > 0.0 { -n } else { n };
            let p = a * hit.weights[0] + b * hit.weights[1] + c * hit.weights[2];
            (n != Vec3A::ZERO).then_some([p + n * offset, n])
        })
        .collect();
    let bounces = |label: &str| -> Vec<[Vec3A; 2]> {
        let mut rng = Seed::root(1).child(label, 0).rng();
        let rounds = if points.is_empty() { 0 } else { primary.len().div_ceil(points.len()) };
        (0..rounds).flat_map(|_| &points).map(|&[p, n]| [p, cosine(n, [rng.random(), rng.random()])]).collect()
    };
    let diffuse = bounces("diffuse");
    let mut shuffled = diffuse.clone();
    shuffled.shuffle(&mut Seed::root(1).child("shuffle", 0).rng());
    let shadow = bounces("shadow");
    let all = [(Kind::Primary, primary), (Kind::Diffuse, diffuse), (Kind::Shuffled, shuffled), (Kind::Shadow, shadow)];
    all.into_iter().filter(|(_, rays)| !rays.is_empty()).map(|(kind, rays)| Rays { kind, rays }).collect()
}

/// Rays through the pixel centres, tile by tile, block by block in each, row by row in those.
fn tiled(camera: &Camera) -> Vec<[Vec3A; 2]> {
    let mut rays = Vec::with_capacity(camera.width * camera.height);
    tile([0, 0], [camera.width, camera.height], &TILES, &mut |x, y| {
        let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        rays.push([camera.position(), camera.ray_direction(pixel)]);
    });
    rays
}

/// Visits the pixels from `low` to before `high` in squares of the first of `sides`, each of those in squares of the next, and so
/// on.
fn tile(low: [usize; 2], high: [usize; 2], sides: &[usize], visit: &mut impl FnMut(usize, usize)) {
    let Some((&side, rest)) = sides.split_first() else {
        (low[1]..high[1]).for_each(|y| (low[0]..high[0]).for_each(|x| visit(x, y)));
        return;
    };
    for y in (low[1]..high[1]).step_by(side) {
        for x in (low[0]..high[0]).step_by(side) {
            tile([x, y], [(x + side).min(high[0]), (y + side).min(high[1])], rest, visit);
        }
    }
}

/// A direction about `n` with density cos / pi (Malley's method).
fn cosine(n: Vec3A, u: [f32; 2]) -> Vec3A {
    let (radius, phi) = (u[0].sqrt(), std::f32::consts::TAU * u[1]);
    let (s, t) = n.any_orthonormal_pair();
    let d = s * (radius * phi.cos()) + t * (radius * phi.sin()) + n * (1.0 - u[0]).max(0.0).sqrt();
    d.normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_visit_every_pixel_once_block_by_block() {
        let mut seen = Vec::new();
        tile([0, 0], [13, 9], &TILES, &mut |x, y| seen.push([x, y]));
        assert!(seen[..16].iter().all(|p| p[0] < 4 && p[1] < 4) && seen[..64].iter().all(|p| p[0] < 8 && p[1] < 8));
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 13 * 9);
    }

    #[test]
    fn cosine_directions_have_their_mean() {
        let mut rng = Seed::root(3).rng();
        let n = Vec3A::new(0.3, -0.5, 0.8).normalize();
        let count = 20_000;
        let mean: f32 = (0..count).map(|_| cosine(n, [rng.random(), rng.random()]).dot(n)).sum::<f32>() / count as f32;
        // E[cos] = 2/3, variance 1/2 - 4/9 = 1/18.
        assert!((mean - 2.0 / 3.0).abs() < 4.0 * (1.0f32 / 18.0 / count as f32).sqrt(), "{mean}");
    }
}
