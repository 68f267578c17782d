//! Counts of rays that geometry loses, and of answers that change when meshes are shared instead of flattened.
//!
//! Every count is a function of its arguments alone, whatever the number of threads. Rays go in blocks over rayon's threads.

use crate::accel::Scratch;
use crate::geometry::{Geometry, Sharing, Wanted};
use crate::ray::Ray;
use glam::{Affine3A, EulerRot, Mat3A, Quat, Vec3, Vec3A};
use rayon::prelude::*;
use renderflow_scenes::{Instance, Mesh};
use std::ops::Add;

/// Rays of one block; each has its own random numbers.
const BLOCK: u64 = 1 << 13;

/// Rays that must hit something, and those that did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Rays shot.
    pub rays: u64,
    /// Nearest-hit queries that found nothing.
    pub missed: u64,
    /// Any-hit queries that found nothing.
    pub unoccluded: u64,
    /// Rays that met the triangle they started on, or its neighbour in one plane.
    pub self_hits: u64,
}

impl Add for Losses {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            rays: self.rays + other.rays,
            missed: self.missed + other.missed,
            unoccluded: self.unoccluded + other.unoccluded,
            self_hits: self.self_hits + other.self_hits,
        }
    }
}

/// Rays of one scene asked twice, once with every mesh flattened and once with every mesh shared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Rays shot.
    pub rays: u64,
    /// Rays that hit in one and not in the other.
    pub decided_otherwise: u64,
    /// Rays that hit another triangle at a distance that differs by more than 1e-5 of it: the outline of what is in front.
    pub other_triangle: u64,
    /// Largest difference of the points hit on the same triangle, as a share of the scene's size.
    pub largest_distance: f32,
    /// Largest difference of geometric normals on the same triangle.
    pub largest_normal: f32,
}

/// Random numbers of one block: PCG RXS-M-XS over a 64-bit state, written out so that counts never change with a dependency.
struct Random(u64);

impl Random {
    fn new(seed: u64, block: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ block.wrapping_mul(0xd1b5_4a32_d192_ed03));
        random.next();
        random
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let word = ((self.0 >> ((self.0 >> 59) + 5)) ^ self.0).wrapping_mul(12_605_985_483_714_917_081);
        (word >> 43) ^ word
    }

    /// In [0, 1).
    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u32 << 24) as f32
    }

    /// In 0..n.
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    /// Uniform on the unit sphere.
    fn direction(&mut self) -> Vec3A {
        let z = 1.0 - 2.0 * self.unit();
        let (sin, cos) = (std::f32::consts::TAU * self.unit()).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3A::new(r * cos, r * sin, z).normalize()
    }
}

/// Aims `count` rays, from inside closed meshes of size `scale` at a distance of `offset` times their size from the origin, at
/// random points of random edges. Half of the rays meet the meshes flattened, half shared by instances, some of them mirrored.
pub fn edge_rays(count: u64, scale: f32, offset: f32, seed: u64) -> Losses {
    aimed(count, scale, offset, seed, |triangle, random| {
        let k = random.below(3);
        // Also the middle and the ends exactly.
        let at = [random.unit(), 0.5, 0.0, 1e-6][random.below(4)];
        triangle[k].lerp(triangle[(k + 1) % 3], at)
    })
}

/// As [`edge_rays`], aimed at vertices.
pub fn vertex_rays(count: u64, scale: f32, offset: f32, seed: u64) -> Losses {
    aimed(count, scale, offset, seed, |triangle, random| triangle[random.below(3)])
}

fn aimed(count: u64, scale: f32, offset: f32, seed: u64, target: impl Fn(&[Vec3A; 3], &mut Random) -> Vec3A + Sync) -> Losses {
    let turned = Quat::from_euler(EulerRot::XYZ, 0.3, 0.7, 1.1);
    let mut scenes = Vec::new();
    for (mesh, turn, mirror) in [(bumpy(24), turned, 1.0), (block(1), Quat::IDENTITY, 1.0), (block(5), turned, -1.0)] {
        let transform = Affine3A {
            matrix3: Mat3A::from_quat(turn) * Mat3A::from_diagonal(Vec3::new(mirror, 1.0, 1.0) * scale),
            translation: Vec3A::new(1.0, -0.6, 0.8) * (offset * scale),
        };
        for sharing in [Sharing::Never, Sharing::Always] {
            scenes.push((transform, geometry(vec![mesh.clone()], vec![instance(0, transform)], sharing)));
        }
    }
    blocks(count, seed, |random, rays| {
        let mut losses = Losses::default();
        let mut scratch = Scratch::default();
        for _ in 0..rays {
            let (transform, geometry) = &scenes[random.below(scenes.len())];
            let triangles = &geometry.mesh(0).triangles;
            let triangle = triangles[random.below(triangles.len())];
            let corners = triangle.map(|v| transform.transform_point3a(geometry.mesh(0).positions[v as usize].into()));
            // The centre exactly is where the numbers of a symmetric mesh cancel.
            let inside = if random.below(4) == 0 { Vec3A::ZERO } else { random.direction() * (0.4 * random.unit()) };
            let origin = transform.transform_point3a(inside);
            let Some(direction) = (target(&corners, random) - origin).try_normalize() else { continue };
            let ray = Ray::new(origin, direction);
            losses.rays += 1;
            losses.missed += u64::from(geometry.closest(&ray, &mut scratch).is_none());
            losses.unoccluded += u64::from(!geometry.occluded(&ray, &mut scratch));
        }
        losses
    })
}

/// Lets rays bounce `count` times in closed rooms of size `scale`, `offset` times their size from the origin, that hold closed
/// objects which touch nothing. Rays leave surfaces as the renderer's do. A ray that meets nothing has leaked; then another path
/// begins.
pub fn closed_room(count: u64, scale: f32, offset: f32, seed: u64) -> Losses {
    let turned = Quat::from_euler(EulerRot::XYZ, 0.4, 1.0, 0.2);
    let mut scenes = Vec::new();
    for (walls, turn) in [(block(1), Quat::IDENTITY), (block(12), turned), (bumpy(20), turned)] {
        let room =
            Affine3A { matrix3: Mat3A::from_quat(turn) * scale, translation: Vec3A::new(1.0, -0.6, 0.8) * (offset * scale) };
        let mut instances = vec![instance(0, room)];
        for (k, place) in
            [Vec3::new(0.22, -0.18, 0.15), Vec3::new(-0.24, 0.1, 0.1), Vec3::new(0.0, -0.1, -0.28)].iter().enumerate()
        {
            let inside = Affine3A::from_scale_rotation_translation(Vec3::splat(0.15), Quat::from_rotation_y(k as f32), *place);
            instances.push(instance(1 + k % 2, room * inside));
        }
        for sharing in [Sharing::Never, Sharing::Always] {
            let meshes = vec![walls.clone(), bumpy(12), block(3)];
            scenes.push((room, geometry(meshes, instances.clone(), sharing)));
        }
    }
    blocks(count, seed, |random, rays| {
        let mut losses = Losses::default();
        let mut scratch = Scratch::default();
        while losses.rays < rays {
            let (room, geometry) = &scenes[random.below(scenes.len())];
            // The centre is free of objects.
            let mut ray = Ray::new(room.transform_point3a(random.direction() * 0.05), random.direction());
            let mut from = None;
            for _ in 0..32 {
                losses.rays += 1;
                let Some(hit) = geometry.closest(&ray, &mut scratch) else {
                    losses.missed += 1;
                    break;
                };
                losses.unoccluded += u64::from(!geometry.occluded(&ray, &mut scratch));
                let point = geometry.surface(&hit);
                // The same triangle, or its neighbour in one plane.
                let same_plane = from.is_some_and(|(instance, n, p, offset): (u32, Vec3A, Vec3A, f32)| {
                    instance == point.instance && point.corners.iter().all(|&c| (c - p).dot(n).abs() <= offset)
                });
                losses.self_hits += u64::from(same_plane);
                from = Some((point.instance, point.n, point.p, point.offset));
                let n = if point.n.dot(ray.direction) > 0.0 { -point.n } else { point.n };
                // Cosine-distributed, and a few that graze.
                let grazing = if random.below(8) == 0 { 1e-3 } else { 1.0 };
                let mut direction = (random.direction() + n * grazing).normalize_or(n);
                if direction.dot(n) <= 0.0 {
                    direction -= n * (2.0 * direction.dot(n));
                    direction = direction.normalize_or(n);
                }
                if direction.dot(n) <= 0.0 {
                    direction = n;
                }
                ray = Ray::leaving(point.p, n, point.offset, direction);
            }
        }
        losses
    })
}

/// Starts `count` rays in slits between parallel squares that stand `gap` times their edge (`scale`) apart, `offset` times that
/// edge from the origin: each leaves one square as the renderer's rays do and must meet the other.
pub fn narrow_gaps(count: u64, scale: f32, offset: f32, gap: f32, seed: u64) -> Losses {
    let mut scenes = Vec::new();
    for turn in [Quat::IDENTITY, Quat::from_euler(EulerRot::XYZ, 0.5, 0.2, 0.9)] {
        let place =
            Affine3A { matrix3: Mat3A::from_quat(turn) * scale, translation: Vec3A::new(1.0, -0.6, 0.8) * (offset * scale) };
        let square =
            |y: f32| [Vec3::new(-0.5, y, -0.5), Vec3::new(0.5, y, -0.5), Vec3::new(0.5, y, 0.5), Vec3::new(-0.5, y, 0.5)];
        let positions = [square(0.0), square(gap)].concat();
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let mesh = Mesh { name: "slit".into(), positions, triangles, ..Mesh::default() };
        for sharing in [Sharing::Never, Sharing::Always] {
            scenes.push((place, geometry(vec![mesh.clone()], vec![instance(0, place)], sharing)));
        }
    }
    blocks(count, seed, |random, rays| {
        let mut losses = Losses::default();
        let mut scratch = Scratch::default();
        for _ in 0..rays {
            let (place, geometry) = &scenes[random.below(scenes.len())];
            let up = random.below(2) == 0;
            // From outside onto one square, then from its other side across the gap.
            let axis = (place.matrix3 * Vec3A::Y).normalize() * if up { 1.0 } else { -1.0 };
            let target = place.transform_point3a(Vec3A::new(
                0.8 * random.unit() - 0.4,
                if up { 0.0 } else { gap },
                0.8 * random.unit() - 0.4,
            ));
            let Some(hit) = geometry.closest(&Ray::new(target - axis * (0.5 * scale), axis), &mut scratch) else {
                losses.missed += 1;
                continue;
            };
            let point = geometry.surface(&hit);
            let n = if point.n.dot(axis) < 0.0 { -point.n } else { point.n };
            let direction = (random.direction() + n * 1.01).normalize_or(n);
            let direction = (direction + n * 0.05).normalize_or(n);
            losses.rays += 1;
            let from = geometry.locate(&hit).1;
            match geometry.closest(&Ray::leaving(point.p, n, point.offset, direction), &mut scratch) {
                Some(next) => losses.self_hits += u64::from(geometry.locate(&next).1 / 2 == from / 2),
                None => losses.missed += 1,
            }
        }
        losses
    })
}

/// Shoots `count` rays at a field of turned, stretched and mirrored instances, flattened and shared.
pub fn instanced_equals_flattened(count: u64, seed: u64) -> Agreement {
    let mut random = Random::new(seed, u64::MAX);
    let mut instances = Vec::new();
    for _ in 0..60 {
        let axis = random.direction();
        let stretch = Vec3::new(1.0 - 2.0 * random.below(2) as f32, 0.4 + random.unit(), 0.4 + random.unit());
        let place = Affine3A::from_scale_rotation_translation(
            stretch * (0.1 + 0.2 * random.unit()),
            Quat::from_axis_angle(axis.into(), 6.0 * random.unit()),
            Vec3::from(random.direction() * random.unit().cbrt()),
        );
        instances.push(instance(random.below(2), place));
    }
    let make = |sharing| geometry(vec![bumpy(12), block(2)], instances.clone(), sharing);
    let (flattened, shared) = (make(Sharing::Never), make(Sharing::Always));
    let parts: Vec<(u64, u64)> = (0..count.div_ceil(BLOCK)).map(|b| (b, BLOCK.min(count - b * BLOCK))).collect();
    let one = |&(block, rays): &(u64, u64)| {
        let mut random = Random::new(seed, block);
        let mut scratch = Scratch::default();
        let mut found = Agreement::default();
        for _ in 0..rays {
            let origin = random.direction() * 2.0;
            let direction = (random.direction() * random.unit() - origin).normalize_or(Vec3A::Y);
            let ray = Ray::new(origin, direction);
            found.rays += 1;
            let hits = [&flattened, &shared].map(|geometry| geometry.closest(&ray, &mut scratch));
            let [Some(a), Some(b)] = hits else {
                found.decided_otherwise += u64::from(hits[0].is_some() != hits[1].is_some());
                continue;
            };
            if flattened.locate(&a) != shared.locate(&b) {
                found.other_triangle += u64::from((a.t - b.t).abs() > 1e-5 * a.t);
                continue;
            }
            let (a, b) = (flattened.surface(&a), shared.surface(&b));
            found.largest_distance = found.largest_distance.max(a.p.distance(b.p));
            found.largest_normal = found.largest_normal.max(a.n.distance(b.n));
        }
        found
    };
    parts.par_iter().map(one).reduce(Agreement::default, |a, b| Agreement {
        rays: a.rays + b.rays,
        decided_otherwise: a.decided_otherwise + b.decided_otherwise,
        other_triangle: a.other_triangle + b.other_triangle,
        largest_distance: a.largest_distance.max(b.largest_distance),
        largest_normal: a.largest_normal.max(b.largest_normal),
    })
}

/// Sums `work` over `count` rays in blocks.
fn blocks(count: u64, seed: u64, work: impl Fn(&mut Random, u64) -> Losses + Sync) -> Losses {
    let one = |block: u64| work(&mut Random::new(seed, block), BLOCK.min(count - block * BLOCK));
    (0..count.div_ceil(BLOCK)).into_par_iter().map(one).reduce(Losses::default, Add::add)
}

fn geometry(meshes: Vec<Mesh>, instances: Vec<Instance>, sharing: Sharing) -> Geometry {
    Geometry::new(meshes, instances, Wanted { uv_sets: 0, tangents: vec![false], colors: false }, sharing)
}

fn instance(mesh: usize, transform: Affine3A) -> Instance {
    Instance { name: String::new(), mesh, material: 0, object_id: 1, transforms: vec![transform] }
}

/// A closed sphere of radius about 0.5 with dents and bumps that is seen whole from its centre.
fn bumpy(rings: u32) -> Mesh {
    let segments = 2 * rings;
    let mut mesh = Mesh { name: "bumpy".into(), ..Mesh::default() };
    let pole = |y: f32| Vec3::new(0.0, 0.5 * y, 0.0);
    mesh.positions.push(pole(1.0));
    for i in 1..rings {
        for j in 0..segments {
            let (theta, phi) =
                (std::f32::consts::PI * i as f32 / rings as f32, std::f32::consts::TAU * j as f32 / segments as f32);
            let r = 0.5 + 0.03 * (5.0 * theta).sin() * (7.0 * phi).cos();
            mesh.positions.push(r * Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()));
        }
    }
    mesh.positions.push(pole(-1.0));
    let at = |i: u32, j: u32| match i {
        0 => 0,
        i if i == rings => 1 + (rings - 1) * segments,
        i => 1 + (i - 1) * segments + j % segments,
    };
    for i in 0..rings {
        for j in 0..segments {
            let (a, b, c, d) = (at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1));
            if i > 0 {
                mesh.triangles.push([a, b, c]);
            }
            if i + 1 < rings {
                mesh.triangles.push([b, d, c]);
            }
        }
    }
    mesh
}

/// A closed cube of edge 1 about the origin, its sides cut into `n` by `n` squares; corners that coincide are one vertex.
fn block(n: u32) -> Mesh {
    let mut mesh = Mesh { name: "block".into(), ..Mesh::default() };
    let mut numbers = std::collections::BTreeMap::new();
    let mut vertex = |place: [u32; 3]| {
        *numbers.entry(place).or_insert_with(|| {
            mesh.positions.push(Vec3::from_array(place.map(|v| v as f32 / n as f32 - 0.5)));
            mesh.positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        for side in [0, n] {
            for (i, j) in (0..n * n).map(|k| (k % n, k / n)) {
                let mut at = |i, j| {
                    let mut place = [0; 3];
                    (place[axis], place[(axis + 1) % 3], place[(axis + 2) % 3]) = (side, i, j);
                    vertex(place)
                };
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                // Counter-clockwise from outside: against the axis on the lower side.
                let [b, d] = if side == 0 { [d, b] } else { [b, d] };
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
