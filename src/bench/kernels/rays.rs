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
    /// One a pixel from the camera, in tiles of 8 x 8.
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

/// Side of a tile of primary rays, pixels.
const TILE: usize = 8;

/// All kinds of rays for what `camera` sees of `triangles`; about as many bounces as primary rays. Kinds without rays are left out.
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

/// Rays through the pixel centres, tile by tile, row by row in each.
fn tiled(camera: &Camera) -> Vec<[Vec3A; 2]> {
    let (width, height) = (camera.width, camera.height);
    let mut rays = Vec::with_capacity(width * height);
    for y0 in (0..height).step_by(TILE) {
        for x0 in (0..width).step_by(TILE) {
            for y in y0..(y0 + TILE).min(height) {
                for x in x0..(x0 + TILE).min(width) {
                    let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                    rays.push([camera.position(), camera.ray_direction(pixel)]);
                }
            }
        }
    }
    rays
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
    fn cosine_directions_have_their_mean() {
        let mut rng = Seed::root(3).rng();
        let n = Vec3A::new(0.3, -0.5, 0.8).normalize();
        let count = 20_000;
        let mean: f32 = (0..count).map(|_| cosine(n, [rng.random(), rng.random()]).dot(n)).sum::<f32>() / count as f32;
        // E[cos] = 2/3, variance 1/2 - 4/9 = 1/18.
        assert!((mean - 2.0 / 3.0).abs() < 4.0 * (1.0f32 / 18.0 / count as f32).sqrt(), "{mean}");
    }
}
