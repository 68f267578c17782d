//! Tracing light paths.

use super::casters::{Caster, Casters};
use super::seen_area;
use crate::accel::Scratch;
use crate::camera::Projector;
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::features::Features;
use crate::integrator::Settings;
use crate::integrator::path::bsdf_of;
use crate::integrator::scatter::Scatterer;
use crate::interaction::{Cone, Interaction};
use crate::material::Prepared;
use crate::ray::Ray;
use crate::sampler::sobol::SEQUENCE;
use crate::sampler::{PixelSampler, Points, hash};
use crate::simd;
use crate::stats::Stats;
use glam::{DVec2, Vec3A};
use rayon::prelude::*;
use std::f32::consts::FRAC_PI_4;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Paths that are traced at a time.
const CHUNK: u64 = 4096;
/// Chunks whose results are held before they are stored.
const BATCH: usize = 256;
/// Tells the random numbers of light paths from those of pixels.
const STREAM: u64 = 0x4c49_4748;

/// What a light path brings to a pixel.
#[derive(Clone, Copy, Debug)]
pub(in crate::integrator) struct Deposit {
    pub pixel: u32,
    /// Radiance for one sample a pixel.
    pub radiance: Vec3A,
    /// Where the light came from.
    pub wi: Vec3A,
}

/// Traces the light paths of the samples `samples` and hands what they bring to `store`, always in the same order.
pub(in crate::integrator) fn trace<F: Features>(
    scene: &RenderScene,
    settings: &Settings,
    casters: &Casters,
    samples: Range<u32>,
    cancel: &AtomicBool,
    done: &(dyn Fn(u64) + Sync),
    store: &mut dyn FnMut(Deposit),
) -> Result<Stats> {
    let chunks: Vec<(usize, Range<u64>)> = (casters.list.iter().enumerate())
        .flat_map(|(number, caster)| {
            let all = u64::from(samples.start) * u64::from(caster.paths)..u64::from(samples.end) * u64::from(caster.paths);
            let starts = all.clone().step_by(CHUNK as usize);
            starts.map(move |start| (number, start..all.end.min(start + CHUNK)))
        })
        .collect();
    let mut stats = Stats::default();
    for batch in chunks.chunks(BATCH) {
        let results: Vec<_> = batch
            .par_iter()
            .with_max_len(1)
            .map(|(number, paths)| {
                if cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let result = simd::run(Chunk { tracer: Tracer::<F>::new(scene, settings, casters, *number), paths: paths.clone() });
                done(paths.end - paths.start);
                Some(result)
            })
            .collect();
        for result in results {
            let (deposits, more) = result.ok_or(Error::Cancelled)?;
            stats += more;
            deposits.into_iter().for_each(&mut *store);
        }
    }
    Ok(stats)
}

struct Chunk<'a, F: Features> {
    tracer: Tracer<'a, F>,
    paths: Range<u64>,
}

impl<F: Features> simd::Work for Chunk<'_, F> {
    type Output = (Vec<Deposit>, Stats);
    #[inline(always)]
    fn run(mut self) -> Self::Output {
        let mut deposits = Vec::new();
        for path in self.paths {
            self.tracer.stats.light_paths += 1;
            let Some(deposit) = self.tracer.path(path) else { continue };
            if deposit.radiance.is_finite() {
                deposits.push(deposit);
            } else {
                self.tracer.stats.non_finite_samples += 1;
            }
        }
        (deposits, self.tracer.stats)
    }
}

struct Tracer<'a, F: Features> {
    scene: &'a RenderScene,
    settings: &'a Settings,
    casters: &'a Casters,
    caster: &'a Caster,
    stream: u64,
    projector: Projector,
    camera_cone: Cone,
    bsdfs: &'a [Option<Prepared>],
    scratch: Scratch,
    points: Points,
    stats: Stats,
    features: std::marker::PhantomData<F>,
}

impl<'a, F: Features> Tracer<'a, F> {
    fn new(scene: &'a RenderScene, settings: &'a Settings, casters: &'a Casters, number: usize) -> Self {
        Self {
            scene,
            settings,
            casters,
            caster: &casters.list[number],
            stream: hash::child(STREAM, u64::from(casters.list[number].instance)),
            projector: Projector::new(scene.camera()),
            camera_cone: Cone::camera(scene.camera(), settings.camera_samples()),
            bsdfs: settings.bsdfs(scene),
            scratch: Scratch::default(),
            points: Points::default(),
            stats: Stats::default(),
            features: std::marker::PhantomData,
        }
    }

    /// Follows light path `number` of the caster.
    #[inline(always)]
    fn path(&mut self, number: u64) -> Option<Deposit> {
        let (scene, mode) = (self.scene, self.settings.bsdf);
        let stream = hash::child(self.stream, number / u64::from(SEQUENCE));
        let sampler = PixelSampler::of_kind(self.settings.sampler, scene.seed, scene.frame() as u64, stream);
        let index = (number % u64::from(SEQUENCE)) as u32;

        // From the sphere around the body to the body; whether the environment is seen from there is asked last.
        let [u, v, s, t] = self.points.point(&sampler, index, 0);
        let light = scene.light().sample([u, v])?;
        let Caster { instance, center, radius, .. } = *self.caster;
        let start = center + across(light.wi, [s, t]) * radius + light.wi * radius;
        let light_ray = Ray::new(start, -light.wi);
        self.stats.bounce_rays += 1;
        let hit = scene.trace::<F>(&light_ray, &mut self.scratch)?;
        if scene.geometry.locate(&hit).0 != instance {
            return None;
        }
        let lit = Interaction::new::<F>(scene, &light_ray, &hit, Cone::default());

        // From there to a surface.
        let [u, v, lobe, _] = self.points.point(&sampler, index, 1);
        let mut own = None;
        let scattered = Scatterer::<F>::new(&lit, bsdf_of::<F>(self.bsdfs, &lit, mode, &mut own), light.wi, mode).sample(lobe, [u, v])?;
        let ray = lit.spawn(scattered.wi);
        self.stats.bounce_rays += 1;
        let landed = scene.trace::<F>(&ray, &mut self.scratch)?;

        // From the camera to that surface.
        let p = scene.geometry.surface(&landed).p;
        let pixel = self.pixel(self.projector.project(p.as_dvec3())?)?;
        let eye = scene.camera().position();
        let camera_ray = Ray::new(eye, (p - eye).normalize());
        self.stats.shadow_rays += 1;
        let seen = scene.trace::<F>(&camera_ray, &mut self.scratch)?;
        if scene.geometry.locate(&seen) != scene.geometry.locate(&landed) {
            return None;
        }

        // The path as the camera would have found it.
        let wo = -camera_ray.direction;
        let first = Interaction::new::<F>(scene, &camera_ray, &seen, self.camera_cone);
        let away = lit.p - first.p;
        let distance = away.length();
        let w1 = away / distance;
        let mut own = None;
        let at_first = Scatterer::<F>::new(&first, bsdf_of::<F>(self.bsdfs, &first, mode, &mut own), wo, mode).eval(w1);
        if at_first.f_cos == Vec3A::ZERO {
            return None;
        }
        let mut towards = hit;
        towards.t = distance;
        let cone = first.cone.scattered(at_first.pdf, self.settings.spp);
        let second = Interaction::new::<F>(scene, &Ray::new(first.p, w1), &towards, cone);
        let mut own = None;
        let bsdf = bsdf_of::<F>(self.bsdfs, &second, mode, &mut own);
        let scatterer = Scatterer::<F>::new(&second, bsdf, -w1, mode);
        let at_second = scatterer.eval(light.wi);
        let (cos, cos_out) = (second.n.dot(light.wi), second.n.dot(-w1));
        if at_second.f_cos == Vec3A::ZERO || cos <= 0.0 || cos_out <= 0.0 {
            return None;
        }
        let reach = self.casters.reach(scene, &first, wo, w1, at_first.pdf);
        let ratio = self.casters.ratio::<F>(scene, reach, &second, (bsdf, &scatterer), (-w1, light.wi));
        let scattering = at_second.pdf / (light.pdf * scene.lights.environment_share());
        let weight = ratio * ratio / (1.0 + scattering * scattering + ratio * ratio);
        let density = self.casters.density[instance as usize] * light.pdf * cos / cos_out
            * scattered.pdf
            * first.n.dot(w1)
            * seen_area(scene, &first, wo);
        self.stats.shadow_rays += 1;
        if scene.shadowed::<F>(&lit.spawn(light.wi), &mut self.scratch) {
            return None;
        }
        let radiance = at_first.f_cos * at_second.f_cos * light.radiance * (weight / density);
        (radiance != Vec3A::ZERO).then_some(Deposit { pixel, radiance, wi: light.wi })
    }

    /// Number of the pixel that holds an image point.
    fn pixel(&self, point: DVec2) -> Option<u32> {
        let camera = self.scene.camera();
        let within = |v: f64, size: usize| (v >= 0.0 && v < size as f64).then_some(v as usize);
        let (x, y) = (within(point.x, camera.width)?, within(point.y, camera.height)?);
        u32::try_from(y * camera.width + x).ok()
    }
}

/// A point of the unit disk across the unit direction `n`, uniform (Shirley and Chiu's map).
#[inline(always)]
fn across(n: Vec3A, u: [f32; 2]) -> Vec3A {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    let (r, phi) = if a.abs() > b.abs() { (a, FRAC_PI_4 * (b / a)) } else { (b, 2.0 * FRAC_PI_4 - FRAC_PI_4 * (a / if b == 0.0 { 1.0 } else { b })) };
    let (sin, cos) = phi.sin_cos();
    let (t, s) = n.any_orthonormal_pair();
    t * (r * cos) + s * (r * sin)
}
