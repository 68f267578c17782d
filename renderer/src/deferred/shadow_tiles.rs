//! Shadow maps of distant lights: what a rasteriser would draw from the light, found by parallel rays.
//!
//! A map is assembled from tiles of a fixed grid; the sizes of texels are a factor of sqrt(2) apart. A tile is traced only if a
//! visible point looks it up, and a tile of one frame serves the next where nothing moves. The content of a map depends on the
//! frame alone, never on which tiles were kept.

use super::lamps::lamps;
use super::{Lighting, ShadowMap, Shadows, axes};
use crate::accel::Scratch;
use crate::compile::RenderScene;
use crate::features::{Features, with_features};
use crate::ray::Ray;
use glam::{IVec2, Vec2, Vec3A};
use rayon::prelude::*;
use renderflow_frame::Frame;
use renderflow_frame::environment::DominantLight;
use renderflow_frame::image::Image;
use std::collections::HashMap;
use std::f32::consts::SQRT_2;
use std::sync::Arc;

/// Largest number of texels that the receivers of a light span along one side, before rounding to the next size of texels.
pub const SHADOW_MAP_SIZE: usize = 1024;
/// The same for the maps of the sky.
const SKY_MAP_SIZE: usize = 128;
/// Smallest number of texels for the receivers of a light.
const SMALLEST: usize = 128;
/// Texels along one side of a map, as a multiple of the side of a square that has one pixel for each receiver. Finer maps would
/// not show in the picture.
const FINENESS: f32 = 2.0;
/// Texels along each side of a tile.
const TILE: usize = 32;
/// Blocks of texels that are traced together.
const BLOCK: usize = 4;
/// Share of the receivers, nearest to the camera, that may get a finer map of their own.
const NEAR: f32 = 0.5;
/// They get one where it is at most this wide, as a share of the width of the map of all receivers.
const WORTH: f32 = 0.5;
/// Share of the receivers, the nearest, that the sky's maps are fitted to where they lie within [`WORTH`] of the width of all
/// receivers.
const SKY_SHARE: f32 = 0.75;
/// Largest number of receivers that the sky's coarse maps are fitted to.
const SKY_RECEIVERS: usize = 4096;
/// How far beyond a receiver the taps of a sky map reach, and the least reach of the taps of a light's map, both in texels.
const SKY_REACH: f32 = 4.0;
const LEAST_REACH: f32 = 4.0;
/// Largest reach of taps as a share of the map's width; [`ShadowMap::visibility`] spreads them no farther.
const FARTHEST: f32 = 0.25;
/// A receiver this close to a map's border, in texels, is left to the next map. It is more than the margin of [`super::shade`].
const ROOM: f32 = 12.0;
/// Number of frames for which an unused tile is kept.
const KEPT: u64 = 8;

/// Makes the shadow maps of a sequence's frames, and keeps the tiles that they are made of.
#[derive(Default)]
pub struct ShadowTiles {
    tiles: HashMap<Name, Tile>,
    /// Hash of the scene that the tiles show.
    scene: String,
    /// Number of calls so far.
    age: u64,
}

/// Which tile it is: the bits of the light's direction, the size of the texels, and the position in the grid.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Name {
    light: [u32; 3],
    level: i32,
    at: IVec2,
}

struct Tile {
    /// Depth of each texel, row by row.
    depth: Arc<[f32]>,
    /// The last call that used it.
    used: u64,
}

/// Shadow maps of `lighting` at the scene's current frame, whose G-buffer is `frame`, and the scene's own lights without an
/// area. The maps are fitted to the receivers, the points that the frame shows. A light gets a second, finer map where the
/// nearer half of its receivers spans less than half the width of all. Everything between the receivers and the light casts a
/// shadow, however far away it is. A receiver outside the sky's maps is under an open sky. A light's map has about four texels
/// for each receiver and at most [`SHADOW_MAP_SIZE`] squared; a map of the sky has at most 128 squared. A frame without
/// receivers has no maps.
pub fn shadow_maps(scene: &RenderScene, lighting: &Lighting, frame: &Frame) -> Shadows {
    ShadowTiles::default().maps(scene, lighting, frame)
}

impl ShadowTiles {
    /// As [`shadow_maps`]. Where nothing in the scene moves, tiles of earlier calls are used again. A scene with another hash
    /// starts without tiles; scenes that have no hash must therefore not share a `ShadowTiles`.
    pub fn maps(&mut self, scene: &RenderScene, lighting: &Lighting, frame: &Frame) -> Shadows {
        let receivers = &receivers(frame)[..];
        let part = |share: f32| &receivers[..(receivers.len() as f32 * share) as usize];
        let size = (FINENESS * (receivers.len() as f32).sqrt()) as usize;
        let size = size.clamp(SMALLEST, SHADOW_MAP_SIZE);
        let of_light = |light: &DominantLight| {
            let reach = reach(light.angular_radius, scene.first_along(-light.direction));
            let Some(all) = Plan::new(light.direction, receivers, size) else { return Vec::new() };
            let near = Plan::new(light.direction, part(NEAR), size).filter(|near| near.extent < WORTH * all.extent);
            let near = near.and_then(|near| near.look(receivers, &reach));
            // What the finer map shows needs no other.
            let rest: Vec<Vec3A> =
                receivers.iter().copied().filter(|p| !near.as_ref().is_some_and(|near| near.holds(*p))).collect();
            near.into_iter().chain(all.look(&rest, &reach)).collect()
        };
        let few = |receivers: &[Vec3A]| -> Vec<Vec3A> {
            receivers.iter().step_by(receivers.len().div_ceil(SKY_RECEIVERS).max(1)).copied().collect()
        };
        let (most, all) = (few(part(SKY_SHARE)), few(receivers));
        let of_cell = |direction: Vec3A| {
            let whole = Plan::new(direction, &all, SKY_MAP_SIZE)?;
            let most = Plan::new(direction, &most, SKY_MAP_SIZE).filter(|most| most.extent < WORTH * whole.extent);
            most.unwrap_or(whole).look(&all, |_, _| SKY_REACH)
        };
        let lights: Vec<Vec<Plan>> = lighting.lights.par_iter().map(of_light).collect();
        let sky: Vec<Plan> = lighting.sky.par_iter().filter_map(|cell| of_cell(cell.direction)).collect();
        let counts: Vec<usize> = lights.iter().map(Vec::len).collect();
        let mut maps = self.draw(scene, lights.into_iter().flatten().chain(sky).collect()).into_iter();
        let lights = counts.into_iter().map(|count| maps.by_ref().take(count).collect()).collect();
        Shadows { lights, sky: maps.collect(), lamps: lamps(scene, frame) }
    }

    /// The maps of `plans`, in order.
    fn draw(&mut self, scene: &RenderScene, plans: Vec<Plan>) -> Vec<ShadowMap> {
        if self.scene != scene.hash || scene.geometry.moves() {
            self.tiles.clear();
            self.scene.clone_from(&scene.hash);
        }
        self.age += 1;
        let age = self.age;
        let mut missing = Vec::new();
        for (number, plan) in plans.iter().enumerate() {
            for at in plan.wanted() {
                match self.tiles.get_mut(&plan.name(at)) {
                    Some(tile) => tile.used = age,
                    None => missing.push((number, at)),
                }
            }
        }
        let starts: Vec<f32> = plans.par_iter().map(|plan| scene.first_along(plan.axes[2])).collect();
        let trace = |scratch: &mut Scratch, &(number, at): &(usize, IVec2)| -> (Name, Arc<[f32]>) {
            let plan = &plans[number];
            let depth = with_features!(scene.features(), false, trace(scene, plan, at, starts[number], scratch));
            (plan.name(at), depth.into())
        };
        let traced: Vec<_> = missing.par_iter().map_init(Scratch::default, trace).collect();
        self.tiles.extend(traced.into_iter().map(|(name, depth)| (name, Tile { depth, used: age })));
        let maps = plans.par_iter().map(|plan| plan.assemble(&self.tiles)).collect();
        self.tiles.retain(|_, tile| tile.used + KEPT > age);
        maps
    }
}

/// How far beyond a receiver the taps of a light of angular `radius` reach, texels, given the size of a texel in metres and the
/// depth of the deepest receiver, where casters stand behind `start`.
fn reach(radius: f32, start: f32) -> impl Fn(f32, f32) -> f32 {
    move |texel, deepest| radius.clamp(0.0, 0.6).tan() / texel * (deepest - start).max(0.0) + LEAST_REACH
}

/// World-space points (relative to the camera's origin) that `frame` shows, the nearest to the camera first.
fn receivers(frame: &Frame) -> Vec<Vec3A> {
    let (width, camera) = (frame.depth.width, &frame.info.camera);
    let mut seen: Vec<(f32, usize)> = frame.depth.pixels.iter().copied().enumerate().map(|(i, depth)| (depth, i)).collect();
    seen.retain(|(depth, _)| depth.is_finite());
    seen.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let point = |(depth, i)| camera.unproject(Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5), depth);
    seen.into_iter().map(point).collect()
}

/// A map to be put together.
struct Plan {
    light: Vec3A,
    axes: [Vec3A; 3],
    /// Metres from the first to the last receiver along the longer side.
    extent: f32,
    /// Metres along the third axis of the receiver farthest from the light.
    deepest: f32,
    /// Texels are sqrt(2)^level metres wide.
    level: i32,
    texel: f32,
    /// The first tile, and how many along both axes.
    first: IVec2,
    count: IVec2,
    /// Which of them something looks at, row by row.
    wanted: Vec<bool>,
}

impl Plan {
    /// A map of the square of `receivers` with texels of which `size` cover it, or up to 1.5 times as many.
    fn new(light: Vec3A, receivers: &[Vec3A], size: usize) -> Option<Self> {
        let axes = axes(light);
        let (mut low, mut high, mut deepest) = (Vec2::INFINITY, Vec2::NEG_INFINITY, f32::NEG_INFINITY);
        for p in receivers.iter().filter(|p| p.is_finite()) {
            let at = Vec2::new(p.dot(axes[0]), p.dot(axes[1]));
            (low, high, deepest) = (low.min(at), high.max(at), deepest.max(p.dot(axes[2])));
        }
        let extent = (high - low).max_element();
        if !extent.is_finite() {
            return None;
        }
        // A lone receiver far from the origin: texels must be told apart there.
        let extent = extent.max(1e-3 * (1e-3 + high.abs().max(low.abs()).max_element()));
        let level = (2.0 * (extent / size.max(1) as f32).log2()).floor() as i32;
        let texel = 2.0_f32.powi(level.div_euclid(2)) * if level.rem_euclid(2) == 1 { SQRT_2 } else { 1.0 };
        let tile = |at: Vec2| (at / (texel * TILE as f32)).floor().as_ivec2();
        let (first, last) = (tile(low), tile(high));
        let count = last - first + 1;
        Some(Self { light, axes, extent, deepest, level, texel, first, count, wanted: Vec::new() })
    }

    /// Texel coordinates of a world-space point from the grid's origin.
    fn place(&self, p: Vec3A) -> Vec2 {
        Vec2::new(p.dot(self.axes[0]), p.dot(self.axes[1])) / self.texel
    }

    /// The plan with the tiles that `receivers` look at, as many texels around each as `reach` says for the size of a texel and
    /// the largest depth, and farther out none; `None` where there are none.
    fn look(mut self, receivers: &[Vec3A], reach: impl Fn(f32, f32) -> f32) -> Option<Self> {
        let most = FARTHEST * (self.count.max_element() * TILE as i32) as f32 + TILE as f32;
        let reach = reach(self.texel, self.deepest).min(most);
        let room = (reach / TILE as f32).ceil() as i32;
        (self.first, self.count) = (self.first - room, self.count + 2 * room);
        let tile = |at: Vec2| (at / TILE as f32).floor().as_ivec2() - self.first;
        let index = |at: IVec2| (at.y * self.count.x + at.x) as usize;
        // Bounds of the receivers in each tile.
        let mut bounds = vec![(Vec2::INFINITY, Vec2::NEG_INFINITY); (self.count.x * self.count.y) as usize];
        for at in receivers.iter().filter(|p| p.is_finite()).map(|p| self.place(*p)) {
            let tile = tile(at);
            if tile.cmpge(IVec2::ZERO).all() && tile.cmplt(self.count).all() {
                let (low, high) = &mut bounds[index(tile)];
                (*low, *high) = (low.min(at), high.max(at));
            }
        }
        let mut wanted = vec![false; bounds.len()];
        for (low, high) in bounds.into_iter().filter(|(low, _)| low.is_finite()) {
            let (low, high) = (tile(low - reach).max(IVec2::ZERO), tile(high + reach).min(self.count - 1));
            for y in low.y..=high.y {
                wanted[index(IVec2::new(low.x, y))..=index(IVec2::new(high.x, y))].fill(true);
            }
        }
        let any = wanted.contains(&true);
        self.wanted = wanted;
        any.then_some(self)
    }

    /// Whether a receiver lies well within the map.
    fn holds(&self, p: Vec3A) -> bool {
        let at = self.place(p) - (self.first * TILE as i32).as_vec2();
        at.min_element() >= ROOM && (at + ROOM).cmple((self.count * TILE as i32).as_vec2()).all()
    }

    /// Places of the tiles that something looks at.
    fn wanted(&self) -> impl Iterator<Item = IVec2> + '_ {
        let place = |i: usize| self.first + IVec2::new(i as i32 % self.count.x, i as i32 / self.count.x);
        self.wanted.iter().enumerate().filter(|(_, wanted)| **wanted).map(move |(i, _)| place(i))
    }

    fn name(&self, at: IVec2) -> Name {
        Name { light: self.light.to_array().map(f32::to_bits), level: self.level, at }
    }

    fn assemble(&self, tiles: &HashMap<Name, Tile>) -> ShadowMap {
        let (width, height) = (self.count.x as usize * TILE, self.count.y as usize * TILE);
        let mut depth = Image::filled(width, height, f32::INFINITY);
        for at in self.wanted() {
            let Some(tile) = tiles.get(&self.name(at)) else { continue };
            let corner = (at - self.first) * TILE as i32;
            for (y, row) in tile.depth.chunks_exact(TILE).enumerate() {
                let start = (corner.y as usize + y) * width + corner.x as usize;
                depth.pixels[start..start + TILE].copy_from_slice(row);
            }
        }
        let low = (self.first * TILE as i32).as_vec2() * self.texel;
        ShadowMap::new(self.light, low.to_array(), width as f32 * self.texel, depth)
    }
}

/// The depths of tile `at`; rays begin at `start`, before everything there is.
fn trace<F: Features>(scene: &RenderScene, plan: &Plan, at: IVec2, start: f32, scratch: &mut Scratch) -> Vec<f32> {
    let [right, down, away] = plan.axes;
    let corner = (at * TILE as i32).as_vec2();
    let mut depth = vec![f32::INFINITY; TILE * TILE];
    let place = |block: usize, i: usize| {
        let (column, row) = (block % (TILE / BLOCK) * BLOCK, block / (TILE / BLOCK) * BLOCK);
        (column + i % BLOCK, row + i / BLOCK)
    };
    let mut rays = [Ray::new(Vec3A::ZERO, Vec3A::Z); BLOCK * BLOCK];
    for block in 0..(TILE / BLOCK).pow(2) {
        for (i, ray) in rays.iter_mut().enumerate() {
            let (x, y) = place(block, i);
            let at = (corner + Vec2::new(x as f32 + 0.5, y as f32 + 0.5)) * plan.texel;
            *ray = Ray::new(right * at.x + down * at.y + away * start, away);
        }
        let mut hits = [None; BLOCK * BLOCK];
        scene.trace_casters::<F>(&rays, &mut hits, scratch);
        for (i, hit) in hits.iter().enumerate() {
            if let Some(hit) = hit {
                let (x, y) = place(block, i);
                depth[y * TILE + x] = start + hit.t;
            }
        }
    }
    depth
}

impl RenderScene {
    /// A coordinate along the unit vector `axis` before that of everything in the scene.
    fn first_along(&self, axis: Vec3A) -> f32 {
        let (mut first, mut last) = (f32::INFINITY, f32::NEG_INFINITY);
        let mut meet = |p: Vec3A| (first, last) = (first.min(p.dot(axis)), last.max(p.dot(axis)));
        let mut boxes = Vec::new();
        self.geometry.cover(
            |sides| {
                boxes.push(sides);
                false
            },
            |corners| corners.into_iter().for_each(&mut meet),
        );
        for sides in boxes {
            for k in 0..8 {
                meet(Vec3A::from_array([0, 1, 2].map(|i| sides[k >> i & 1][i])));
            }
        }
        let room = 1e-3 * (last - first).max(0.0) + 1e-6 * first.abs().max(last.abs());
        if first.is_finite() && last.is_finite() { first - room } else { 0.0 }
    }
}

#[cfg(test)]
mod tests;
