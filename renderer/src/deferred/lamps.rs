//! The lights of the scene itself that have no area: points, spots, and light from one direction. A ray from each pixel to each
//! of them finds their shadows.

use crate::accel::Scratch;
use crate::compile::RenderScene;
use crate::features::{Features, with_features};
use crate::light::{Arriving, DistantLight, Lamp, LightSample};
use crate::query::Sight;
use crate::ray::Ray;
use glam::{Vec2, Vec3A};
use rayon::prelude::*;
use renderflow_frame::Frame;
use renderflow_frame::color::luminance;
use renderflow_frame::ibl::nearest_hit;

/// Most lights of the scene that are shaded. Where there are more, those count that light the frame's surfaces most.
pub const LAMPS: usize = 8;
/// Number of pixels by which they are compared.
const COMPARED: usize = 1024;
/// Distance from the camera times this is how far from the surface rays begin.
const LEAVE: f32 = 1e-3;

/// A light without an area, and what each pixel sees of it.
#[derive(Clone, Debug)]
pub struct LampView {
    light: Local,
    /// Share of its light, by colour, that reaches each pixel. A covered pixel whose centre missed has that of the nearest hit.
    seen: Vec<[f32; 3]>,
}

#[derive(Clone, Debug)]
enum Local {
    Lamp(Lamp),
    Distant(DistantLight),
}

impl Local {
    /// What arrives at `p` with nothing in the way.
    fn arriving(&self, p: Vec3A) -> Option<Arriving> {
        match self {
            Self::Lamp(lamp) => lamp.arriving(p),
            Self::Distant(DistantLight { wi, irradiance }) => {
                Some(Arriving { wi: *wi, distance: f32::INFINITY, irradiance: *irradiance })
            }
        }
    }

    /// As a light sample of a point.
    fn sample(&self, arriving: Arriving) -> LightSample {
        LightSample::punctual(arriving, matches!(self, Self::Lamp(_)).then_some(0), 1.0)
    }
}

impl LampView {
    /// Direction to the light from pixel `i`, which shows the world-space point `p`, and the irradiance of a surface there that
    /// faces the light; `None` where nothing arrives.
    pub(super) fn at(&self, i: usize, p: Vec3A) -> Option<(Vec3A, Vec3A)> {
        let seen = Vec3A::from_array(*self.seen.get(i)?);
        if seen == Vec3A::ZERO {
            return None;
        }
        let Arriving { wi, irradiance, .. } = self.light.arriving(p)?;
        Some((wi, irradiance * seen))
    }
}

/// The lights of `scene` without an area at its current frame, whose G-buffer is `frame`, the strongest first.
pub fn lamps(scene: &RenderScene, frame: &Frame) -> Vec<LampView> {
    let (lamps, distant) = scene.lights_without_area();
    let all: Vec<Local> = lamps.into_iter().map(Local::Lamp).chain(distant.into_iter().map(Local::Distant)).collect();
    if all.is_empty() {
        return Vec::new();
    }
    let (width, camera) = (frame.depth.width.max(1), &frame.info.camera);
    let point = |i: usize| {
        let depth = frame.depth.pixels[i];
        let at = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        depth.is_finite().then(|| camera.unproject(at, depth))
    };
    let pixels = frame.depth.pixels.len();
    let few: Vec<Vec3A> = (0..pixels).step_by(pixels.div_ceil(COMPARED).max(1)).filter_map(point).collect();
    let strength = |light: &Local| -> f64 {
        let at = |p: &Vec3A| light.arriving(*p).map_or(0.0, |arriving| f64::from(luminance(arriving.irradiance.to_array())));
        few.iter().map(at).sum()
    };
    let mut ranked: Vec<(f64, Local)> = all.into_iter().map(|light| (strength(&light), light)).collect();
    ranked.retain(|(strength, _)| *strength > 0.0);
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    ranked.truncate(LAMPS);
    let covered = |i: usize| frame.alpha.pixels.get(i).is_some_and(|alpha| *alpha > 0.0);
    let missed = (0..pixels).filter(|&i| !frame.depth.pixels[i].is_finite() && covered(i));
    let nearest = |i: usize| nearest_hit(frame, i % width, i / width);
    let borrowed: Vec<(usize, usize)> = missed.filter_map(|i| Some((i, nearest(i)?))).collect();
    let view = |(_, light): (f64, Local)| {
        let trace = |scratch: &mut Scratch, i: usize| {
            let Some(p) = point(i) else { return [0.0; 3] };
            let n = camera.camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[i]);
            let away = LEAVE * p.distance(camera.position());
            with_features!(scene.features(), false, seen(scene, &light, p, n, away, scratch)).to_array()
        };
        let mut seen: Vec<[f32; 3]> = (0..pixels).into_par_iter().with_min_len(256).map_init(Scratch::default, trace).collect();
        borrowed.iter().for_each(|&(i, hit)| seen[i] = seen[hit]);
        LampView { light, seen }
    };
    ranked.into_iter().map(view).collect()
}

/// Share of a light that reaches a surface with the normal `n`.
fn seen<F: Features>(scene: &RenderScene, light: &Local, p: Vec3A, n: Vec3A, away: f32, scratch: &mut Scratch) -> Vec3A {
    let Some(arriving) = light.arriving(p).filter(|arriving| arriving.wi.dot(n) > 0.0) else { return Vec3A::ZERO };
    let ray = Ray::leaving(p, n.normalize_or_zero(), away, arriving.wi);
    match scene.sight_of::<F>(&ray, &light.sample(arriving), scratch) {
        (Sight::Hidden, _) => Vec3A::ZERO,
        (_, share) => share,
    }
}
