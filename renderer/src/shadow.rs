//! Shadow maps of distant lights: what a rasteriser would draw from the light, found by parallel rays.

use crate::accel::Scratch;
use crate::compile::RenderScene;
use crate::features::{Features, with_features};
use crate::ray::Ray;
use glam::Vec3A;
use rayon::prelude::*;
use renderflow_frame::deferred::{Lighting, ShadowMap, Shadows, axes};
use renderflow_frame::image::Image;

/// Texels along each side of a map.
pub const SHADOW_MAP_SIZE: usize = 1024;
/// Texels along each side of a map of the sky.
pub const SKY_MAP_SIZE: usize = 128;
/// Room around the receivers, as a share of the map: filters reach beyond the outermost.
const ROOM: f32 = 0.06;
/// Share of the receivers, the nearest to the camera, that may get a finer map of their own.
const NEAR: f32 = 0.5;
/// They do where it is so much smaller.
const WORTH: f32 = 0.5;
/// Share of the receivers, the nearest, that the sky's maps are fitted to where they are so much closer together than all.
const SKY_SHARE: f32 = 0.75;
/// Blocks of texels that are traced together.
const BLOCK: usize = 4;

/// Shadow maps of `lighting` at the scene's current frame, as [`renderflow_frame::deferred::shade`] takes them. They are fitted to
/// `receivers`, world-space points with the nearest to the camera first ([`renderflow_frame::deferred::receivers`]); where the nearer half of
/// them lies on less than half the width, a light gets a second, finer map. Whatever stands between the receivers and the light casts, however
/// far. Receivers beyond the sky's maps are
/// under an open sky. Maps are [`SHADOW_MAP_SIZE`] wide, those of the sky [`SKY_MAP_SIZE`]. Without receivers there is nothing to shadow and no map.
pub fn shadow_maps(scene: &RenderScene, lighting: &Lighting, receivers: &[Vec3A]) -> Shadows {
    let near = &receivers[..(receivers.len() as f32 * NEAR) as usize];
    let lights = lighting.lights.iter().map(|light| {
        let (Some(all), few) = (Fit::new(light.direction, receivers), Fit::new(light.direction, near)) else { return Vec::new() };
        let few = few.filter(|few| few.extent < WORTH * all.extent);
        few.iter().chain([&all]).map(|fit| fill(scene, light.direction, fit, SHADOW_MAP_SIZE)).collect()
    });
    let most = &receivers[..(receivers.len() as f32 * SKY_SHARE) as usize];
    let sky = lighting.sky.iter().filter_map(|cell| {
        let (all, most) = (Fit::new(cell.direction, receivers)?, Fit::new(cell.direction, most));
        let fit = most.filter(|most| most.extent < WORTH * all.extent).unwrap_or(all);
        Some(fill(scene, cell.direction, &fit, SKY_MAP_SIZE))
    });
    Shadows { lights: lights.collect(), sky: sky.collect() }
}

/// One map over all `receivers`, `None` where there are none; `light` is the unit direction towards the light.
pub fn shadow_map(scene: &RenderScene, light: Vec3A, receivers: &[Vec3A], size: usize) -> Option<ShadowMap> {
    Fit::new(light, receivers).map(|fit| fill(scene, light, &fit, size))
}

/// The square of a map, metres along its first two axes.
struct Fit {
    low: [f32; 2],
    extent: f32,
}

impl Fit {
    fn new(light: Vec3A, receivers: &[Vec3A]) -> Option<Self> {
        let [right, down, _] = axes(light);
        let (mut low, mut high) = (glam::Vec2::INFINITY, glam::Vec2::NEG_INFINITY);
        for p in receivers.iter().filter(|p| p.is_finite()) {
            let at = glam::Vec2::new(p.dot(right), p.dot(down));
            (low, high) = (low.min(at), high.max(at));
        }
        let extent = (high - low).max_element();
        if !extent.is_finite() {
            return None;
        }
        let wide = (extent * (1.0 + 2.0 * ROOM)).max(1e-6 * (1.0 + high.abs().max_element()));
        let middle = 0.5 * (low + high);
        Some(Self { low: (middle - 0.5 * wide).to_array(), extent: wide })
    }
}

fn fill(scene: &RenderScene, light: Vec3A, fit: &Fit, size: usize) -> ShadowMap {
    with_features!(scene.features(), false, trace(scene, light, fit, size))
}

fn trace<F: Features>(scene: &RenderScene, light: Vec3A, fit: &Fit, size: usize) -> ShadowMap {
    let [right, down, away] = axes(light);
    // Rays start before everything there is.
    let start = scene.first_along(away);
    let texel = fit.extent / size.max(1) as f32;
    let mut depth = Image::filled(size, size, f32::INFINITY);
    depth.pixels.par_chunks_mut((size * BLOCK).max(1)).enumerate().for_each_init(Scratch::default, |scratch, (band, rows)| {
        let height = rows.len() / size;
        let mut rays = Vec::with_capacity(BLOCK * BLOCK);
        let mut hits = Vec::new();
        for first in (0..size).step_by(BLOCK) {
            let width = BLOCK.min(size - first);
            rays.clear();
            for i in 0..width * height {
                let (x, y) = (first + i % width, band * BLOCK + i / width);
                let across = right * (fit.low[0] + (x as f32 + 0.5) * texel) + down * (fit.low[1] + (y as f32 + 0.5) * texel);
                rays.push(Ray::new(across + away * start, away));
            }
            hits.clear();
            hits.resize(rays.len(), None);
            scene.trace_all::<F>(&rays, &mut hits, scratch);
            for (i, hit) in hits.iter().enumerate() {
                if let Some(hit) = hit {
                    rows[i / width * size + first + i % width] = start + hit.t;
                }
            }
        }
    });
    ShadowMap::new(light, fit.low, fit.extent, depth)
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
