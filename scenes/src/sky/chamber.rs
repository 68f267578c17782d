//! The family `room`: a box lit through openings, its inter-reflections solved on a coarse grid of patches (radiosity), with
//! pillars, boxes, patches of sunlight, bars and coloured panes.

use super::canvas::{Dome, Emitter, disc, flat_by, luminance, rgb, smoothstep, toward};
use super::parts::{Beam, Finish, Furnishing, Opening};
use super::room::{form_factor, place};
use super::{Wall, Window, fits};
use crate::family::{below, family};
use crate::noise;
use crate::seed::Seed;
use glam::DVec3;
use rand::RngExt;
use std::f64::consts::PI;
use std::sync::Arc;

/// Patches along the side of a face, for light that has bounced and for light straight from the openings.
const COARSE: usize = 8;
const FINE: usize = 16;

family! {
    /// A room with inter-reflections, pillars and boxes, lit through openings.
    pub struct Room {
        /// Extent of the room along x, y, z, metres.
        size: [f32; 3] [1, 100];
        /// Height of the point the map is seen from above the floor, metres, at most 0.9 of the room's height.
        eye_height: f32 [0.1, 90; most 0.9 * size[1]];
        /// Diffuse reflectance of the walls, linear Rec.709.
        walls: [f32; 3] [0, 0.95];
        /// Diffuse reflectance of the floor, linear Rec.709.
        floor: [f32; 3] [0, 0.95];
        /// Diffuse reflectance of the ceiling, linear Rec.709.
        ceiling: [f32; 3] [0, 0.95];
        /// Windows, doors and lit panels.
        openings: Vec<Opening> [; count 1, 48];
        /// Sunlight through the openings; absent = none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        beam: Option<Beam>;
        /// What stands in it and how its faces are finished.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        furnishing: Option<Furnishing>;
    }, rules |faults, at| {
        for (index, opening) in openings.iter().enumerate() {
            fits(faults, &below(at, format!("openings/{index}")), opening.wall.face(*size), opening.size, opening.offset);
        }
    }
}

/// An opening in the eye's coordinates.
struct Pane {
    centre: DVec3,
    half_u: DVec3,
    half_v: DVec3,
    /// Mean radiance, holes for bars and arch taken off.
    mean: DVec3,
    opening: Opening,
}

impl Pane {
    fn new(opening: &Opening, size: DVec3, eye: f64) -> Self {
        let Opening { wall, offset, size: extent, radiance, .. } = opening.clone();
        let (centre, half_u, half_v) = place(&Window { wall, offset, size: extent, radiance }, size, eye);
        let mut pane = Self { centre, half_u, half_v, mean: DVec3::ZERO, opening: opening.clone() };
        let mark = |k: usize| 2.0 * (k as f64 + 0.5) / 24.0 - 1.0;
        pane.mean = (0..576).map(|i| pane.radiance(mark(i % 24), mark(i / 24))).sum::<DVec3>() / 576.0;
        pane
    }

    /// Radiance seen through it at a, b in -1..=1.
    fn radiance(&self, a: f64, b: f64) -> DVec3 {
        let opening = &self.opening;
        if opening.arch {
            // The upper part is a half ellipse, as high as half the width where there is room.
            let rise = (f64::from(opening.size[0]) / f64::from(opening.size[1])).min(2.0);
            let up = (b - (1.0 - rise)) / rise;
            if up > 0.0 && a * a + up * up > 1.0 {
                return DVec3::ZERO;
            }
        }
        let [columns, rows] = opening.panes.map(f64::from);
        let (x, y) = ((0.5 + 0.5 * a) * columns, (0.5 + 0.5 * b) * rows);
        let bar = |x: f64, n: f64| n > 1.0 && (x - x.round()).abs() < 0.07 && x.round() > 0.5 && x.round() < n - 0.5;
        if bar(x, columns) || bar(y, rows) {
            return DVec3::ZERO;
        }
        let below = (self.centre + self.half_v * b).y < 0.0;
        let base = rgb(if below { opening.lower.unwrap_or(opening.radiance) } else { opening.radiance });
        match opening.glass {
            None => base,
            Some(seed) => {
                let mut rng = Seed::root(u64::from(seed)).child("glass", x as u64 * 64 + y as u64).rng();
                const GLASS: [[f32; 3]; 6] = [
                    [0.9, 0.08, 0.05],
                    [0.08, 0.15, 0.9],
                    [0.95, 0.7, 0.1],
                    [0.1, 0.6, 0.2],
                    [0.55, 0.1, 0.65],
                    [0.9, 0.88, 0.8],
                ];
                base * rgb(GLASS[rng.random_range(0..GLASS.len())]) * rng.random_range(0.6..1.3f64)
            }
        }
    }

    /// Where a ray from `p` along `d` passes the opening's plane, in -1..=1 each; `None` beside it or behind.
    fn crossed(&self, p: DVec3, d: DVec3) -> Option<(f64, f64)> {
        let normal = self.half_u.cross(self.half_v);
        let t = (self.centre - p).dot(normal) / d.dot(normal);
        if !(t.is_finite() && t > 0.0) {
            return None;
        }
        let q = p + d * t - self.centre;
        let (a, b) = (q.dot(self.half_u) / self.half_u.length_squared(), q.dot(self.half_v) / self.half_v.length_squared());
        (a.abs() <= 1.0 && b.abs() <= 1.0).then_some((a, b))
    }
}

/// A box that stands in the room.
#[derive(Clone)]
struct Block {
    low: DVec3,
    high: DVec3,
    color: DVec3,
    /// Irradiance of its faces, ordered as [`faces`].
    light: [DVec3; 6],
}

impl Block {
    /// Distance in lengths of `d` and face index where a ray from `p` enters; `None` when it misses or starts inside.
    fn enter(&self, p: DVec3, d: DVec3) -> Option<(f64, usize)> {
        let (mut near, mut far, mut face) = (0.0f64, f64::INFINITY, usize::MAX);
        for k in 0..3 {
            if d[k].abs() < 1e-12 {
                if p[k] < self.low[k] || p[k] > self.high[k] {
                    return None;
                }
                continue;
            }
            let (a, b) = ((self.low[k] - p[k]) / d[k], (self.high[k] - p[k]) / d[k]);
            if a.min(b) > near {
                (near, face) = (a.min(b), 2 * k + usize::from(d[k] < 0.0));
            }
            far = far.min(a.max(b));
        }
        (near < far && face != usize::MAX).then_some((near, face))
    }
}

/// Outward side of face k: 2 * axis + (0 = low, 1 = high).
fn axis_of(face: usize) -> (usize, f64) {
    (face / 2, if face.is_multiple_of(2) { -1.0 } else { 1.0 })
}

/// The room with its light.
struct Chamber {
    low: DVec3,
    high: DVec3,
    /// Reflectance of the faces -x, +x, -y, +y, -z, +z.
    albedo: [DVec3; 6],
    panes: Vec<Pane>,
    blocks: Vec<Block>,
    /// Direction towards the sun and its irradiance on a facing surface.
    beam: Option<(DVec3, DVec3)>,
    finish: Furnishing,
    direct: Vec<DVec3>,
    bounced: Vec<DVec3>,
}

impl Chamber {
    /// Point at the shares s, t of a face along its two other axes.
    fn point(&self, face: usize, s: f64, t: f64) -> DVec3 {
        let (axis, _) = axis_of(face);
        let mut p = if face.is_multiple_of(2) { self.low } else { self.high };
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        p[i] = self.low[i] + (self.high[i] - self.low[i]) * s;
        p[j] = self.low[j] + (self.high[j] - self.low[j]) * t;
        p
    }

    fn inward(face: usize) -> DVec3 {
        let (axis, side) = axis_of(face);
        let mut n = DVec3::ZERO;
        n[axis] = -side;
        n
    }

    /// Irradiance of a surface at `p` straight from the openings' own light.
    fn light_of_openings(&self, p: DVec3, n: DVec3) -> DVec3 {
        self.panes.iter().map(|pane| pane.mean * form_factor(p, n, pane.centre, pane.half_u, pane.half_v)).sum()
    }

    /// Irradiance by the beam at `p`.
    fn light_of_beam(&self, p: DVec3, n: DVec3) -> DVec3 {
        let Some((sun, irradiance)) = self.beam else { return DVec3::ZERO };
        let cos = n.dot(sun);
        if cos <= 0.0 {
            return DVec3::ZERO;
        }
        let start = p + n * 1e-4;
        let Some(tint) = self.panes.iter().find_map(|pane| {
            let (a, b) = pane.crossed(start, sun)?;
            let radiance = pane.radiance(a, b);
            // Coloured glass colours the patch on the floor too.
            let level = luminance(rgb(pane.opening.radiance)).max(1e-9);
            Some(if pane.opening.glass.is_some() { radiance / level } else { DVec3::splat(f64::from(radiance != DVec3::ZERO)) })
        }) else {
            return DVec3::ZERO;
        };
        if tint == DVec3::ZERO || self.blocks.iter().any(|block| block.enter(start, sun).is_some()) {
            return DVec3::ZERO;
        }
        irradiance * tint * cos
    }

    /// Solves for the light: direct on the fine grid, bounced by Jacobi steps on the coarse one.
    fn illuminate(&mut self) {
        let grid = |n: usize| (0..6 * n * n).map(move |i| (i / (n * n), (i % n) as f64, ((i / n) % n) as f64));
        self.direct = grid(FINE)
            .map(|(face, s, t)| {
                self.light_of_openings(self.point(face, s / (FINE - 1) as f64, t / (FINE - 1) as f64), Self::inward(face))
            })
            .collect();
        let patches: Vec<(usize, DVec3, DVec3)> = grid(COARSE)
            .map(|(face, s, t)| {
                let n = Self::inward(face);
                let spread = |k: usize| (f64::from(k as u32) + 0.5) / 3.0;
                let beam: DVec3 = (0..9)
                    .map(|k| self.point(face, (s + spread(k % 3)) / COARSE as f64, (t + spread(k / 3)) / COARSE as f64))
                    .map(|p| self.light_of_beam(p, n))
                    .sum();
                let p = self.point(face, (s + 0.5) / COARSE as f64, (t + 0.5) / COARSE as f64);
                (face, p, self.light_of_openings(p, n) + beam / 9.0)
            })
            .collect();
        let extent = self.high - self.low;
        let area = |face: usize| {
            let (axis, _) = axis_of(face);
            extent[(axis + 1) % 3] * extent[(axis + 2) % 3] / (COARSE * COARSE) as f64
        };
        let kernels: Vec<f64> = patches
            .iter()
            .flat_map(|&(from, p, _)| {
                let row = patches.iter().map(move |&(to, q, _)| {
                    if from == to {
                        return 0.0;
                    }
                    let v = q - p;
                    let r2 = v.length_squared() + 0.3 * area(to);
                    (v.dot(Self::inward(from)) * -v.dot(Self::inward(to))).max(0.0) * area(to) / (PI * r2 * r2)
                });
                let row: Vec<f64> = row.collect();
                // The room is closed: all that leaves arrives.
                let sum: f64 = row.iter().sum();
                row.into_iter().map(move |k| k / sum)
            })
            .collect();
        let count = patches.len();
        let mean = patches.iter().map(|patch| patch.2).sum::<DVec3>() / count as f64;
        let rho = self.albedo.iter().sum::<DVec3>() / 6.0;
        let mut bounced = vec![mean * rho / (DVec3::ONE - rho.min(DVec3::splat(0.95))); count];
        for _ in 0..5 {
            let leaving: Vec<DVec3> =
                patches.iter().zip(&bounced).map(|(&(face, _, direct), more)| self.albedo[face] * (direct + *more)).collect();
            bounced = kernels.chunks_exact(count).map(|row| row.iter().zip(&leaving).map(|(k, b)| *b * *k).sum()).collect();
        }
        self.bounced = bounced;
        let average = self.bounced.iter().sum::<DVec3>() / count as f64;
        for index in 0..self.blocks.len() {
            let Block { low, high, .. } = self.blocks[index];
            for face in 0..6 {
                let (axis, side) = axis_of(face);
                let mut n = DVec3::ZERO;
                n[axis] = side;
                let p = 0.5 * (low + high) + n * (0.5 * (high - low) + 0.01);
                self.blocks[index].light[face] = self.light_of_openings(p, n) * 0.8 + average;
            }
        }
    }

    /// Bilinear value of a grid of a face; `centred` grids have their samples at cell centres.
    fn at(grid: &[DVec3], n: usize, face: usize, s: f64, t: f64, centred: bool) -> DVec3 {
        let place =
            |x: f64| if centred { (x * n as f64 - 0.5).clamp(0.0, (n - 1) as f64) } else { x.clamp(0.0, 1.0) * (n - 1) as f64 };
        let (x, y) = (place(s), place(t));
        let (i, j) = ((x as usize).min(n - 2), (y as usize).min(n - 2));
        let (fx, fy) = (x - i as f64, y - j as f64);
        let value = |i: usize, j: usize| grid[face * n * n + j * n + i];
        value(i, j).lerp(value(i + 1, j), fx).lerp(value(i, j + 1).lerp(value(i + 1, j + 1), fx), fy)
    }

    /// Factor on the reflectance at a place of a face.
    fn pattern(&self, face: usize, p: DVec3) -> f64 {
        let Furnishing { finish, contrast, scale, seed, .. } = self.finish;
        let (contrast, scale) = (f64::from(contrast), f64::from(scale));
        let (axis, _) = axis_of(face);
        // Along the floor or the wall, and across it.
        let (a, b) = match axis {
            0 => (p.z, p.y),
            1 => (p.z, p.x),
            _ => (p.x, p.y),
        };
        let shade = |i: f64, j: f64| 0.5 - noise::gradient(DVec3::new(i + 0.37, j + 0.61, 0.43 + face as f64), seed);
        let joint = |x: f64| smoothstep(0.02, 0.06, (x - x.round()).abs());
        let dark = match finish {
            Finish::Plain => 0.5 * shade(0.4 * a, 0.4 * b),
            Finish::Planks => {
                let board = b / scale;
                1.0 - joint(board) * (0.3 + 0.7 * shade(board.floor() * 1.7, (0.15 * a / scale).floor()))
            }
            Finish::Tiles => {
                let (x, y) = (a / scale, b / scale);
                let odd = f64::from((x.floor() as i64 + y.floor() as i64) % 2 != 0);
                1.0 - joint(x) * joint(y) * (0.55 + 0.45 * odd)
            }
            Finish::Bricks => {
                let y = b / (0.35 * scale);
                let x = a / scale + 0.5 * (y.floor().rem_euclid(2.0));
                1.0 - joint(x) * joint(y) * (0.4 + 0.6 * shade(x.floor() * 1.3, y.floor() * 1.7))
            }
            Finish::Ribs => {
                let x = (if axis == 2 { p.x } else { p.z }) / scale;
                if face == 2 { 0.0 } else { 1.0 - smoothstep(0.1, 0.14, (x - x.round()).abs()) }
            }
            Finish::Rock => 0.5 - 1.3 * noise::fractal(p * (1.0 / scale), 4, seed),
        };
        (1.0 - contrast * dark.clamp(-0.4, 1.0)).max(0.02)
    }

    /// First block along a ray.
    fn first_block(&self, p: DVec3, d: DVec3) -> Option<(f64, usize, usize)> {
        let hits =
            self.blocks.iter().enumerate().filter_map(|(index, block)| block.enter(p, d).map(|(t, face)| (t, index, face)));
        hits.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn radiance(&self, d: DVec3) -> DVec3 {
        let mut wall = (f64::INFINITY, 0);
        for k in 0..3 {
            let t = if d[k] > 0.0 {
                self.high[k] / d[k]
            } else if d[k] < 0.0 {
                self.low[k] / d[k]
            } else {
                f64::INFINITY
            };
            if t < wall.0 {
                wall = (t, 2 * k + usize::from(d[k] > 0.0));
            }
        }
        if let Some((t, index, face)) = self.first_block(DVec3::ZERO, d)
            && t < wall.0
        {
            let block = &self.blocks[index];
            let (axis, side) = axis_of(face);
            let mut n = DVec3::ZERO;
            n[axis] = side;
            return block.color * (block.light[face] + self.light_of_beam(d * t, n)) / PI;
        }
        let (t, face) = wall;
        let p = d * t;
        let (axis, _) = axis_of(face);
        let share = |k: usize| (p[k] - self.low[k]) / (self.high[k] - self.low[k]);
        let (s, u) = (share((axis + 1) % 3), share((axis + 2) % 3));
        let light = Self::at(&self.direct, FINE, face, s, u, false)
            + Self::at(&self.bounced, COARSE, face, s, u, true)
            + self.light_of_beam(p, Self::inward(face));
        self.albedo[face] * self.pattern(face, p) * light / PI
    }
}

/// Pillars in two rows and boxes on the floor, out of the middle where the object stands.
fn blocks(low: DVec3, high: DVec3, walls: DVec3, f: &Furnishing) -> Vec<Block> {
    let mut rng = Seed::root(u64::from(f.seed)).child("furniture", 0).rng();
    let extent = high - low;
    let mut found = Vec::new();
    let mut push = |low: DVec3, high: DVec3, color: DVec3| found.push(Block { low, high, color, light: [DVec3::ZERO; 6] });
    let long = if extent.z >= extent.x { 2 } else { 0 };
    let short = 2 - long;
    let half = 0.03 * extent[short].min(12.0);
    for k in 0..f.pillars {
        let pairs = f.pillars.div_ceil(2);
        let mut p = DVec3::ZERO;
        p[long] = low[long] + extent[long] * (f64::from(k / 2) + 0.5) / f64::from(pairs);
        p[short] = if k.is_multiple_of(2) { 0.27 } else { -0.27 } * extent[short];
        push((p - DVec3::splat(half)).with_y(low.y), (p + DVec3::splat(half)).with_y(high.y), walls * 0.9);
    }
    for _ in 0..f.boxes {
        let wide = [0, 1].map(|_| rng.random_range(0.05..0.16f64));
        let tall = extent.y * rng.random_range(0.1..0.6f64);
        // Along the walls: a random place of the rim between 62% and 98% of the way out.
        let side = rng.random_range(0..4u32);
        let (out, along) = (0.5 * rng.random_range(0.62..0.95f64), rng.random_range(-0.45..0.45f64));
        let (x, z) = [(out, along), (-out, along), (along, out), (along, -out)][side as usize];
        let (half_x, half_z) = (0.5 * wide[0] * extent.x, 0.5 * wide[1] * extent.z);
        let centre = DVec3::new(
            (x * extent.x).clamp(low.x + half_x, high.x - half_x),
            low.y + 0.5 * tall,
            (z * extent.z).clamp(low.z + half_z, high.z - half_z),
        );
        let tone = DVec3::new(rng.random_range(0.1..0.7), rng.random_range(0.1..0.6), rng.random_range(0.08..0.6));
        let color = DVec3::splat(luminance(tone)).lerp(tone, 0.6);
        let half = DVec3::new(half_x, 0.5 * tall, half_z);
        // The eye stays outside.
        if (centre - half).max(-(centre + half)).max_element() > 0.15 {
            push(centre - half, centre + half, color);
        }
    }
    found
}

pub(super) fn chamber(r: &Room) -> Dome {
    let (size, eye) = (rgb(r.size), f64::from(r.eye_height));
    let (low, high) = (DVec3::new(-0.5 * size.x, -eye, -0.5 * size.z), DVec3::new(0.5 * size.x, size.y - eye, 0.5 * size.z));
    let (walls, floor, ceiling) = (rgb(r.walls), rgb(r.floor), rgb(r.ceiling));
    let panes: Vec<Pane> = r.openings.iter().map(|opening| Pane::new(opening, size, eye)).collect();
    let beam = r.beam.as_ref().map(|beam| (toward(beam.elevation, beam.azimuth), rgb(beam.irradiance)));
    let finish = r.furnishing.clone().unwrap_or_default();
    let blocks = blocks(low, high, walls, &finish);
    let albedo = [walls, walls, floor, ceiling, walls, walls];
    let mut room = Chamber { low, high, albedo, panes, blocks, beam, finish, direct: Vec::new(), bounced: Vec::new() };
    room.illuminate();
    let room = Arc::new(room);
    let mut emitters: Vec<Emitter> = (0..room.panes.len()).map(|index| opening(&room, index)).collect();
    if let Some((sun, irradiance)) = beam {
        let radius = 0.5f64.to_radians();
        let radiance = irradiance / (PI * radius.sin().powi(2));
        let view = room.clone();
        emitters.push(disc(sun, radius, move |d| {
            let clear = |pane: &Pane| pane.crossed(DVec3::ZERO, d).is_some_and(|(a, b)| pane.radiance(a, b) != DVec3::ZERO);
            let open = view.panes.iter().any(clear) && view.first_block(DVec3::ZERO, d).is_none();
            if open { radiance } else { DVec3::ZERO }
        }));
    }
    emitters.retain(|emitter| luminance(emitter.energy) > 0.0);
    Dome { background: Box::new(move |d| room.radiance(d)), emitters, points: Vec::new() }
}

/// The opening itself, as far as nothing stands before it.
fn opening(room: &Arc<Chamber>, index: usize) -> Emitter {
    let pane = &room.panes[index];
    let (centre, half_u, half_v) = (pane.centre, pane.half_u, pane.half_v);
    let view = room.clone();
    let cells = if room.panes.len() <= 4 { 72 } else { 36 };
    flat_by(cells, centre, half_u, half_v, move |a, b| {
        let light = view.panes[index].radiance(a, b);
        let p = centre + half_u * a + half_v * b;
        if light == DVec3::ZERO || view.first_block(DVec3::ZERO, p).is_some_and(|(t, ..)| t < 1.0) { DVec3::ZERO } else { light }
    })
}

impl Wall {
    /// Width and height of the face in a room of `size`.
    pub(super) fn face(self, size: [f32; 3]) -> [f32; 2] {
        match self {
            Self::North | Self::South => [size[0], size[1]],
            Self::East | Self::West => [size[2], size[1]],
            Self::Ceiling => [size[0], size[2]],
        }
    }
}
