//! Tracing light paths.

use super::casters::{CausticCaster, CausticCasters, PathStart};
use super::{MOST_SURFACES, longest, seen_area, slant, turned};
use crate::accel::{Hit, Scratch};
use crate::camera::{Projector, disk};
use crate::clear::{Medium, Straight};
use crate::compile::RenderScene;
use crate::error::{Error, Result};
use crate::features::Features;
use crate::integrator::scatter::Scatterer;
use crate::integrator::tracer::{Origin, bsdf_of};
use crate::interaction::{Cone, Interaction};
use crate::light::{LightId, LightSample, Receiver, Source, direction_and_distance};
use crate::material::{Prepared, Side};
use crate::query::Sight;
use crate::ray::Ray;
use crate::sampler::sobol::SEQUENCE;
use crate::sampler::{PixelSampler, Points, hash};
use crate::settings::Settings;
use crate::simd;
use crate::stats::Stats;
use glam::{DVec2, Vec3A};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Paths that are traced at a time.
const CHUNK: u64 = 4096;
/// Chunks whose results are held before they are stored.
const BATCH: usize = 128;
/// Tells the random numbers of light paths from those of pixels.
const STREAM: u64 = 0x4c49_4748;

/// Share of the sphere's radius by which a path from within begins beside its light.
const BESIDE: f32 = 1e-4;
/// Light paths go on after their second surface with this times their throughput.
const SURVIVAL: f32 = 0.5;

/// What a light path brings to a pixel.
#[derive(Clone, Copy, Debug)]
pub(in crate::integrator) struct Deposit {
    pub pixel: u32,
    /// Radiance for one sample a pixel.
    pub radiance: Vec3A,
    /// Where the light came from.
    pub from: Origin,
}

/// The light at the beginning of a path.
struct Light<'a> {
    /// The body that the path is aimed at.
    caster: &'a CausticCaster,
    /// As it was drawn for the middle of the body.
    sample: LightSample,
    begins: PathStart,
    /// Radiance, or irradiance from one direction; 1 of a lamp, whose irradiance depends on the place.
    radiance: Vec3A,
    /// Density of the direction in which the path leaves a light that stands somewhere, per steradian; 1 of others.
    aimed: f32,
}

impl Light<'_> {
    /// The point that it comes from; `None` where it comes from far away.
    #[inline(always)]
    fn point(&self) -> Option<Vec3A> {
        match self.begins {
            PathStart::Near { point, .. } => Some(point),
            PathStart::Environment | PathStart::Distant => None,
        }
    }

    /// Paths for one sample a pixel per square metre across their direction, at `p` on the body; of an environment or a triangle
    /// also per steradian of directions to it.
    #[inline(always)]
    fn density(&self, p: impl FnOnce() -> Vec3A) -> f32 {
        let LightSample { pdf, wi, distance, source } = self.sample;
        let Some(point) = self.point() else { return self.caster.density() * pdf };
        let (to_p, paths) = (p() - point, self.caster.paths as f32 * self.aimed);
        match source {
            // Per square metre of the triangle, then per steradian in which it is seen from `p`.
            Source::Emitter { n, .. } => {
                let of_area = pdf * -n.dot(wi) / (distance * distance);
                paths * of_area * to_p.length() / n.dot(to_p)
            }
            _ => paths * pdf / to_p.length_squared(),
        }
    }

    /// Density with which a light sample for `at` has the direction `wi` and `distance`; `None` where scattering never finds the
    /// light.
    #[inline(always)]
    fn drawn(&self, scene: &RenderScene, at: &Receiver, (wi, distance): (Vec3A, f32)) -> Option<f32> {
        let PathStart::Near { light: light @ LightId::Triangle(_), n, .. } = self.begins else {
            return matches!(self.begins, PathStart::Environment).then_some(self.sample.pdf);
        };
        let LightSample { pdf, wi: to_light, distance: before, .. } = self.sample;
        let of_area = pdf * -n.dot(to_light) / (before * before);
        let share = scene.lights.probability(at, light) / scene.lights.probability(&self.caster.receiver(), light);
        Some(share * of_area * distance * distance / -n.dot(wi))
    }
}

/// The light paths that [`trace`] follows.
pub(in crate::integrator) struct LightPaths<'a> {
    pub scene: &'a RenderScene,
    pub settings: &'a Settings,
    pub casters: &'a CausticCasters,
    /// The samples of each pixel whose light paths these are.
    pub samples: Range<u32>,
}

/// Traces `paths` and hands what they bring to `store`, always in the same order. `done` is told the number of paths that are
/// traced.
///
/// # Errors
/// [`Error::Cancelled`] when `cancel` was set.
pub(in crate::integrator) fn trace<F: Features>(
    paths: &LightPaths,
    cancel: &AtomicBool,
    done: &(dyn Fn(u64) + Sync),
    store: &mut dyn FnMut(Deposit),
) -> Result<Stats> {
    let LightPaths { scene, settings, casters, samples } = paths;
    let mut chunks = casters.list.iter().enumerate().flat_map(|(number, caster)| {
        let all = caster.numbers(samples);
        let starts = all.clone().step_by(CHUNK as usize);
        starts.map(move |start| (number, start..all.end.min(start + CHUNK)))
    });
    let mut stats = Stats::default();
    loop {
        let batch: Vec<(usize, Range<u64>)> = chunks.by_ref().take(BATCH).collect();
        if batch.is_empty() {
            return Ok(stats);
        }
        let results: Vec<_> = batch
            .par_iter()
            .with_max_len(1)
            .map(|(number, paths)| {
                if cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let result =
                    simd::run(Chunk { tracer: Tracer::<F>::new(scene, settings, casters, *number), paths: paths.clone() });
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
            self.tracer.path(path, &mut deposits);
        }
        (deposits, self.tracer.stats)
    }
}

struct Tracer<'a, F: Features> {
    scene: &'a RenderScene,
    settings: &'a Settings,
    casters: &'a CausticCasters,
    caster: &'a CausticCaster,
    stream: u64,
    projector: Projector,
    /// See [`Settings::shares`], of the sample that the path under way belongs to.
    shares: u32,
    camera_cone: Cone,
    /// Most surfaces of a path.
    longest: usize,
    /// Surfaces of the path under way, from the light on, but for the last.
    vertices: Vec<(Hit, Vec3A)>,
    /// What panes between them made of its weight.
    passed: Vec3A,
    bsdfs: &'a [Option<Prepared>],
    scratch: Scratch,
    points: Points,
    stats: Stats,
    features: std::marker::PhantomData<F>,
}

impl<'a, F: Features> Tracer<'a, F> {
    fn new(scene: &'a RenderScene, settings: &'a Settings, casters: &'a CausticCasters, number: usize) -> Self {
        Self {
            scene,
            settings,
            casters,
            caster: &casters.list[number],
            stream: hash::child(STREAM, u64::from(casters.list[number].instance)),
            projector: Projector::new(scene.camera()),
            shares: settings.shares(0),
            camera_cone: Cone::camera(scene.camera(), settings.camera_shares(0)),
            longest: longest(settings),
            vertices: Vec::new(),
            passed: Vec3A::ONE,
            bsdfs: settings.bsdfs(scene),
            scratch: Scratch::default(),
            points: Points::default(),
            stats: Stats::default(),
            features: std::marker::PhantomData,
        }
    }

    /// Follows light path `number` of the caster.
    #[inline(always)]
    fn path(&mut self, number: u64, deposits: &mut Vec<Deposit>) {
        let (scene, mode) = (self.scene, self.settings.bsdf);
        let stream = hash::child(self.stream, number / u64::from(SEQUENCE));
        let sampler = PixelSampler::of_kind(self.settings.sampler, scene.seed, scene.frame() as u64, stream);
        let index = (number % u64::from(SEQUENCE)) as u32;
        self.stats.light_paths += 1;
        let shares = self.settings.shares(self.caster.sample(number));
        if shares != self.shares {
            self.shares = shares;
            self.camera_cone = Cone::camera(scene.camera(), self.settings.camera_shares(self.caster.sample(number)));
        }

        // From the sphere around the body to the body; whether the light is seen from there is asked last.
        let Some((light, mut ray)) = self.begin(&sampler, index) else { return };
        let start = ray.origin;
        self.stats.bounce_rays += 1;
        self.passed = Vec3A::ONE;
        let Some(mut hit) = self.meet(&mut ray) else { return };
        if scene.geometry.locate(&hit).0 != self.caster.instance {
            return;
        }
        self.vertices.clear();
        let mut lit = None;
        let mut medium = Medium::AIR;
        // The way from there to the body is known.
        let to_light = Ray::new(start, -ray.direction);
        let mut density = light.density(|| scene.geometry.surface(&hit).p);
        let mut beta = Vec3A::ONE;
        while self.vertices.len() < self.longest - 1 {
            let at = Interaction::new::<F>(scene, &ray, &hit, Cone::default());
            let mut own = None;
            let bsdf = bsdf_of::<F>(self.bsdfs, &at, mode, &mut own);
            let [u, v, lobe, survive] = self.points.point(&sampler, index, 1 + self.vertices.len() as u32);
            let scatterer = Scatterer::<F>::new(&at, bsdf, -ray.direction, mode);
            let Some(scattered) = scatterer.sample(lobe, [u, v]) else { return };
            beta *= scattered.weight;
            density *= scattered.pdf * at.n.dot(-ray.direction) / slant::<F>(&at, scattered.wi);
            let inside = F::CLEAR && at.side == Side::Inside;
            if !self.vertices.is_empty() {
                // What is inside of a body mostly leaves it, and from there it is seen.
                let survival = if inside { medium.gain() } else { SURVIVAL };
                let keep = (survival * beta.max_element()).min(1.0);
                if survive >= keep {
                    return;
                }
                density *= keep;
                beta /= keep;
            }
            self.vertices.push((hit, at.p));
            if F::CLEAR {
                ray = at.spawn_either(scattered.wi);
                medium = medium.along(scene, &at, scattered.wi);
            } else {
                ray = at.spawn(scattered.wi);
            }
            self.stats.bounce_rays += 1;
            let Some(next) = self.meet(&mut ray) else { return };
            hit = next;
            let Some(mut deposit) = self.connect(&hit, &light, density) else { continue };
            if lit.is_none() {
                self.stats.shadow_rays += 1;
                let distance = light.point().map_or(f32::INFINITY, |point| point.distance(start));
                let before = LightSample { distance, ..light.sample };
                let (sight, share) = scene.sight_of::<F>(&to_light, &before, &mut self.scratch);
                if sight != Sight::Clear {
                    return;
                }
                lit = Some(share);
            }
            if F::CLEAR {
                deposit.radiance *= lit.unwrap_or(Vec3A::ONE);
            }
            if deposit.radiance.is_finite() {
                deposits.push(deposit);
            } else {
                self.stats.non_finite_samples += 1;
            }
        }
    }

    /// Draws light for the body, and a ray to it that begins on or in the sphere around it.
    #[inline(always)]
    fn begin(&mut self, sampler: &PixelSampler, index: u32) -> Option<(Light<'a>, Ray)> {
        let (scene, caster) = (self.scene, self.caster);
        let [u, v, s, t] = self.points.point(sampler, index, 0);
        let sample = if F::FULL && scene.features().lights() {
            let [choice, more, ..] = self.points.point(sampler, index, 1 + MOST_SURFACES);
            scene.lights.sample(&caster.receiver(), [choice, more], [u, v])?
        } else {
            LightSample::from(scene.environment_light().sample([u, v])?)
        };
        let begins = PathStart::of(&sample, caster.center);
        if !self.casters.follow(&begins) {
            return None;
        }
        let PathStart::Near { point, n, .. } = begins else {
            let radiance = match sample.source {
                Source::Environment { radiance } => radiance,
                Source::Punctual { irradiance, .. } => irradiance,
                Source::Emitter { .. } => return None,
            };
            let start = caster.center + across(sample.wi, [s, t]) * caster.radius + sample.wi * caster.radius;
            return Some((Light { caster, sample, begins, radiance, aimed: 1.0 }, Ray::new(start, -sample.wi)));
        };
        let (direction, aimed) = caster.direction(point, [s, t]);
        let radiance = match sample.source {
            // Only the side that the middle of the body sees.
            Source::Emitter { .. } if n.dot(direction) <= 0.0 => return None,
            Source::Emitter { id, barycentrics, .. } => scene.emitted(id, barycentrics),
            // What it sends depends on where it arrives.
            _ => Vec3A::ONE,
        };
        // On the sphere, or from within beside the light.
        let along = (caster.center - point).dot(direction);
        let beside = (caster.center - point - direction * along).length_squared();
        let inside = (caster.radius * caster.radius - beside).max(0.0).sqrt();
        let start = point + direction * (along - inside).max(BESIDE * caster.radius);
        Some((Light { caster, sample, begins, radiance, aimed }, Ray::new(start, direction)))
    }

    /// The surface that `ray` meets, unless it passes another from behind: a path from the camera would end there. Behind panes
    /// the ray begins at the last one.
    #[inline(always)]
    fn meet(&mut self, ray: &mut Ray) -> Option<Hit> {
        let (hit, through) = self.scene.trace_noting::<F>(ray, &mut self.scratch);
        if !F::CLEAR {
            return hit.filter(|_| !through);
        }
        let straight = Straight::new(*ray, hit, through).go_on::<F>(self.scene, &mut self.scratch);
        self.passed *= straight.weight;
        *ray = straight.ray;
        straight.hit.filter(|_| !straight.through && self.passed != Vec3A::ZERO)
    }

    /// What the path brings to the camera from the surface `landed`, if nothing hides its beginning.
    #[inline(always)]
    fn connect(&mut self, landed: &Hit, light: &Light<'_>, density: f32) -> Option<Deposit> {
        let (scene, mode) = (self.scene, self.settings.bsdf);
        // From the camera to that surface.
        let p = scene.geometry.surface(landed).p;
        let pixel = self.pixel(self.projector.project(p.as_dvec3())?)?;
        let eye = scene.camera().position();
        let mut ray = Ray::new(eye, (p - eye).normalize());
        self.stats.shadow_rays += 1;
        // The path stopped there already, by chance where the surface is blended: this ray may not pass it.
        let end = scene.geometry.locate(landed);
        let mut hit = scene.trace_to::<F>(&ray, end, &mut self.scratch)?;
        let mut value = light.radiance;
        if F::CLEAR {
            // Surfaces seen from behind are passed here as they are by camera rays.
            let straight = Straight::new(ray, Some(hit), false).go_on_to::<F>(scene, end, &mut self.scratch);
            hit = straight.hit?;
            hit.t += straight.before;
            value *= straight.weight * self.passed;
        }
        if scene.geometry.locate(&hit) != end {
            return None;
        }
        // The path as the camera would have found it.
        let mut cone = self.camera_cone;
        let (mut reach, mut area) = (0.0, 0.0);
        let mut medium = Medium::AIR;
        for (vertex, next) in (1..).zip(self.vertices.iter().rev().map(Some).chain([None])) {
            let at = Interaction::new::<F>(scene, &ray, &hit, cone);
            let wo = -ray.direction;
            let (wi, distance) = match next {
                Some((_, p)) => {
                    let away = *p - at.p;
                    let distance = away.length();
                    if distance == 0.0 {
                        return None;
                    }
                    (away / distance, distance)
                }
                None => match light.point() {
                    None => (light.sample.wi, f32::INFINITY),
                    Some(point) => direction_and_distance(point - at.p)?,
                },
            };
            let mut own = None;
            let bsdf = bsdf_of::<F>(self.bsdfs, &at, mode, &mut own);
            let scatterer = Scatterer::<F>::new(&at, bsdf, wo, mode);
            let scattering = scatterer.eval(wi);
            value *= scattering.f_cos;
            if F::CLEAR {
                medium = medium.along(scene, &at, wi);
                value *= medium.over(distance);
            }
            if value == Vec3A::ZERO || at.n.dot(wo) <= 0.0 {
                return None;
            }
            if vertex == 1 {
                area = seen_area(scene, &at, wo) * slant::<F>(&at, wi);
                reach = area / scattering.pdf;
            } else if next.is_some() {
                reach *= turned::<F>(&at, (bsdf, &scatterer), (wo, wi)) / scattering.pdf;
            } else {
                let ratio = self.casters.ratio::<F>(scene, reach, &at, (bsdf, &scatterer), (wo, wi), &light.begins);
                let drawn = light.drawn(scene, &at.receiver::<F>(), (wi, distance)).map_or(0.0, |pdf| scattering.pdf / pdf);
                let weight = ratio * ratio / (1.0 + drawn * drawn + ratio * ratio);
                if let PathStart::Near { light: LightId::Lamp(number), .. } = light.begins {
                    value *= scene.lights.irradiance(number, at.p);
                }
                let radiance = value * (weight / (density * area));
                let from = match light.begins {
                    PathStart::Environment => Origin::Environment(wi),
                    _ => Origin::Emitter,
                };
                return (radiance != Vec3A::ZERO).then_some(Deposit { pixel, radiance, from });
            }
            cone = at.cone.scattered(scattering.pdf, self.shares);
            ray = Ray::new(at.p, wi);
            hit = next?.0;
            hit.t = distance;
        }
        None
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
    let at = disk(u);
    let (t, s) = n.any_orthonormal_pair();
    t * at.x + s * at.y
}
