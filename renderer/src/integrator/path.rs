//! Unidirectional path tracing with sampled lights and multiple importance sampling.

use super::scatter::Scatterer;
use super::{DirectLight, Settings};
use crate::accel::Scratch;
use crate::compile::RenderScene;
use crate::features::{Brdf, Features};
use crate::film::FirstHit;
use crate::interaction::{Cone, Interaction};
use crate::light::{Ahead, LightGroups, LightSample, Source};
use crate::material::{Mode, Prepared};
use crate::ray::Ray;
use crate::sampler::{PixelSampler, Points};
use crate::simd;
use crate::stats::Stats;
use glam::{Vec2, Vec3A};
use renderflow_frame::frame::LIGHT_GROUPS;

/// Surfaces a path passes before roulette may end it.
const ROULETTE_FROM: u32 = 3;
/// Roulette spares paths of at least this throughput. Measured on 7 scenes of `examples/efficiency.rs` (soft sun, studio, overcast,
/// interior, glossy, lamps, the common scene): 0.3 in place of 1 lowers relMSE at equal samples to 0.69 in the geometric mean (0.75 on the
/// common scene) for 4 % more instructions there. From the second surface on: 3 % more error; from the fourth with 1: 20 % more.
const ROULETTE_BELOW: f32 = 0.3;
/// Surfaces from which on roulette keeps no path for certain, or a path between white walls would only end at the bounce limit.
const ROULETTE_ALWAYS: u32 = 8;
const ROULETTE_LIMIT: f32 = 0.95;

/// One camera sample.
pub(super) struct Sample {
    /// Finite; 0 where the estimate was not.
    pub radiance: Vec3A,
    pub first: Option<FirstHit>,
}

/// What one thread needs to trace paths.
pub(super) struct Tracer<'a, F: Features> {
    scene: &'a RenderScene,
    settings: &'a Settings,
    /// Directions of the light groups, where asked for.
    directions: Option<LightGroups>,
    /// Largest contribution of indirect light, as it counts for one branch.
    limit: f32,
    /// Radiance of the current sample, all and by group.
    radiance: Vec3A,
    groups: [Vec3A; LIGHT_GROUPS],
    /// Cone of a camera ray: what one of the samples of a pixel covers.
    camera_cone: Cone,
    scratch: Scratch,
    points: Points,
    ahead: Ahead,
    /// BSDFs made before, by material.
    bsdfs: &'a [Option<Prepared>],
    stats: Stats,
    features: std::marker::PhantomData<F>,
}

/// The arguments of [`Tracer::sample`].
struct CameraSample<'t, 'a, F: Features> {
    tracer: &'t mut Tracer<'a, F>,
    sampler: &'t PixelSampler,
    pixel: (usize, usize),
    index: u32,
    seen: bool,
}

impl<F: Features> simd::Work for CameraSample<'_, '_, F> {
    type Output = Sample;
    #[inline(always)]
    fn run(self) -> Sample {
        self.tracer.trace(self.sampler, self.pixel, self.index, self.seen)
    }
}

/// Where light came from.
#[derive(Clone, Copy)]
enum Origin {
    Environment(Vec3A),
    Emitter,
}

/// Camera ray of sample `index` of `pixel`.
#[inline]
pub(super) fn camera_ray(
    scene: &RenderScene,
    settings: &Settings,
    sampler: &PixelSampler,
    pixel: (usize, usize),
    index: u32,
) -> Ray {
    camera_ray_at(scene, settings, sampler.point(index, 0), pixel)
}

/// As [`camera_ray`], with the numbers of its set.
#[inline(always)]
fn camera_ray_at(scene: &RenderScene, settings: &Settings, [u, v, ..]: [f32; 4], pixel: (usize, usize)) -> Ray {
    let point = Vec2::new(pixel.0 as u32 as f32 + 0.5, pixel.1 as u32 as f32 + 0.5) + settings.filter.sample([u, v]);
    crate::camera::ray(scene.camera(), point)
}

impl<'a, F: Features> Tracer<'a, F> {
    pub fn new(scene: &'a RenderScene, settings: &'a Settings) -> Self {
        let groups = settings.light_groups as usize;
        Self {
            scene,
            settings,
            directions: LightGroups::new(groups, scene.environment().rotation)
                .ok()
                .map(|groups| if scene.features().emitters { groups.with_emitters() } else { groups }),
            limit: settings.clamp_indirect.unwrap_or(f32::INFINITY),
            radiance: Vec3A::ZERO,
            groups: [Vec3A::ZERO; LIGHT_GROUPS],
            camera_cone: Cone::camera(scene.camera(), settings.spp),
            scratch: Scratch::default(),
            points: Points::default(),
            ahead: Ahead::default(),
            bsdfs: if settings.bsdf == Mode::Conserving { scene.bsdfs() } else { &[] },
            stats: Stats::default(),
            features: std::marker::PhantomData,
        }
    }

    /// Shares of the last sample by light group.
    pub fn groups(&self) -> &[Vec3A; LIGHT_GROUPS] {
        &self.groups
    }

    pub fn into_stats(self) -> Stats {
        self.stats
    }

    /// Traces one camera sample. `seen` is false where the pixel is known to see the environment alone: the same directions are then
    /// looked up without asking the tree.
    #[inline]
    pub fn sample(&mut self, sampler: &PixelSampler, pixel: (usize, usize), index: u32, seen: bool) -> Sample {
        simd::run(CameraSample { tracer: self, sampler, pixel, index, seen })
    }

    #[inline(always)]
    fn trace(&mut self, sampler: &PixelSampler, pixel: (usize, usize), index: u32, seen: bool) -> Sample {
        self.stats.samples += 1;
        if F::FLAT_ENVIRONMENT && !seen && self.directions.is_none() {
            // The same from everywhere: no need to know whither.
            self.stats.skipped_rays += 1;
            return Sample { radiance: self.scene.light().radiance(Vec3A::Y), first: None };
        }
        let ray = camera_ray_at(self.scene, self.settings, self.points.point(sampler, index, 0), pixel);
        self.radiance = Vec3A::ZERO;
        if self.directions.is_some() {
            self.groups = [Vec3A::ZERO; LIGHT_GROUPS];
        }
        let hit = if seen {
            self.stats.camera_rays += 1;
            self.scene.trace::<F>(&ray, &mut self.scratch)
        } else {
            self.stats.skipped_rays += 1;
            None
        };
        let first = match hit {
            None => {
                self.add(self.scene.light().radiance(ray.direction), Origin::Environment(ray.direction));
                None
            }
            Some(hit) => {
                let surface = Interaction::new::<F>(self.scene, &ray, &hit, self.camera_cone);
                let first = FirstHit { albedo: surface.surface.base_color, ns: surface.ns };
                if F::FULL && surface.emitted != Vec3A::ZERO {
                    self.add(surface.emitted, Origin::Emitter);
                }
                // Without light there is nothing to gather.
                if !(self.settings.skips.dark_scenes && self.scene.features().dark()) {
                    self.gather(sampler, index, &surface, -ray.direction);
                }
                Some(first)
            }
        };
        if self.radiance.is_finite() {
            return Sample { radiance: self.radiance, first };
        }
        self.stats.non_finite_samples += 1;
        self.groups = [Vec3A::ZERO; LIGHT_GROUPS];
        Sample { radiance: Vec3A::ZERO, first }
    }

    #[inline(always)]
    fn add(&mut self, contribution: Vec3A, from: Origin) {
        self.radiance += contribution;
        if let Some(directions) = &self.directions {
            let group = match from {
                Origin::Environment(wi) => directions.group(wi),
                Origin::Emitter => directions.emitters(),
            };
            self.groups[group] += contribution;
        }
    }

    /// Adds what `surface` scatters towards `wo`.
    #[inline(always)]
    fn gather(&mut self, sampler: &PixelSampler, index: u32, surface: &Interaction, wo: Vec3A) {
        let branches = self.settings.branches;
        for branch in 0..branches {
            self.follow(sampler, (index, branch), Path::new(branches), *surface, wo);
        }
    }

    /// Follows branch `branch` of sample `index` from its first surface on.
    #[inline(always)]
    fn follow(
        &mut self,
        sampler: &PixelSampler,
        (index, branch): (u32, u32),
        mut path: Path,
        mut surface: Interaction,
        mut wo: Vec3A,
    ) {
        let scene = self.scene;
        let skips = self.settings.skips;
        let sampled_lights = self.settings.direct != DirectLight::Scattering;
        // The light sample of the first surface is that of all branches; each goes on with numbers of its own, which are stratified over
        // all branches of all samples of the pixel.
        let own_index = index * self.settings.branches + branch;
        for vertex in 1..=self.settings.max_bounces {
            path.vertex = vertex;
            let own;
            let bsdf = match self.bsdfs.get(surface.material) {
                Some(Some(prepared)) => F::Bsdf::prepared(prepared),
                _ => {
                    own = F::Bsdf::new(&surface.surface, self.settings.bsdf);
                    &own
                }
            };
            let scatterer = Scatterer::<F>::new(&surface, bsdf, wo, self.settings.bsdf);
            if skips.black_surfaces && scatterer.is_black() {
                break;
            }
            if scene.samples_lights::<F>() && sampled_lights {
                if vertex > 1 {
                    self.sample_light(sampler, own_index, &path, path.beta, &surface, &scatterer);
                } else if branch == 0 {
                    self.sample_light(sampler, index, &path, Vec3A::ONE, &surface, &scatterer);
                }
            }

            // Scatter.
            let [lobe, u, v, survive] = self.points.point(sampler, own_index, 2 * vertex - 1);
            let Some(scattered) = scatterer.sample(lobe, [u, v]) else { break };
            let wi = scattered.wi;
            path.beta *= scattered.weight;
            if path.beta == Vec3A::ZERO || !path.survives(survive) {
                break;
            }
            // As one density of all draws.
            let pdf = path.draws() * scattered.pdf;

            let ray = surface.spawn(wi);
            let last = vertex == self.settings.max_bounces;
            if last && !(F::FULL && scene.features().emitters) {
                // No surface beyond: only whether something stands in the way matters.
                let contribution = path.beta * self.environment_behind(wi, pdf);
                if contribution != Vec3A::ZERO || !skips.zero_contributions {
                    self.stats.shadow_rays += 1;
                    let hidden = if skips.last_any_hit {
                        scene.shadowed::<F>(&ray, &mut self.scratch)
                    } else {
                        scene.trace::<F>(&ray, &mut self.scratch).is_some()
                    };
                    if !hidden {
                        self.add_scattered(&path, contribution, Origin::Environment(wi));
                    }
                }
                break;
            }
            self.stats.bounce_rays += 1;
            let Some(hit) = scene.trace::<F>(&ray, &mut self.scratch) else {
                let contribution = path.beta * self.environment_behind(wi, pdf);
                self.add_scattered(&path, contribution, Origin::Environment(wi));
                break;
            };
            let cone = surface.cone.scattered(scattered.pdf, self.settings.spp);
            let next = Interaction::new::<F>(scene, &ray, &hit, cone);
            if F::FULL && next.emitted != Vec3A::ZERO {
                let weight = match self.settings.direct {
                    DirectLight::Scattering => 1.0,
                    DirectLight::Mis => mis_weight(pdf, scene.emitter_pdf(&next, wi, hit.t)),
                    // What is too faint or too small to be drawn as a light is found by scattering alone.
                    DirectLight::Lights if scene.emitter_pdf(&next, wi, hit.t) > 0.0 => 0.0,
                    DirectLight::Lights => 1.0,
                };
                self.add_scattered(&path, path.beta * next.emitted * weight, Origin::Emitter);
            }
            if last {
                break;
            }
            surface = next;
            wo = -wi;
        }
    }

    /// Adds light that reached surface `path.vertex` from its light source.
    #[inline(always)]
    fn add_scattered(&mut self, path: &Path, contribution: Vec3A, from: Origin) {
        if path.vertex == 1 {
            return self.add(contribution, from);
        }
        let largest = contribution.max_element() * path.branches;
        if largest > self.limit {
            self.stats.clamped_contributions += 1;
            return self.add(contribution * (self.limit / largest), from);
        }
        self.add(contribution, from);
    }

    /// Draws a point or direction of light and weighs it against scattering having found it.
    #[inline(always)]
    fn sample_light(
        &mut self,
        sampler: &PixelSampler,
        index: u32,
        path: &Path,
        beta: Vec3A,
        surface: &Interaction,
        scatterer: &Scatterer<'_, F>,
    ) {
        let scene = self.scene;
        let light = if F::FULL && scene.features().emitters {
            let [u, v, choice, _] = self.points.point(sampler, index, 2 * path.vertex);
            scene.sample_light::<F>(surface.p, choice, [u, v])
        } else {
            self.ahead.sample(scene.light(), (sampler, &mut self.points), index, 2 * path.vertex).map(LightSample::from)
        };
        let Some(light) = light else { return };
        let scattering = scatterer.eval(light.wi);
        // Not `> 0`: a NaN must reach the counter, not vanish here.
        if scattering.f_cos == Vec3A::ZERO && self.settings.skips.zero_contributions {
            return;
        }
        let (radiance, origin) = match light.source {
            Source::Environment { radiance } => (radiance, Origin::Environment(light.wi)),
            Source::Emitter { id, barycentrics, .. } => (scene.emitted(id, barycentrics), Origin::Emitter),
        };
        let weight =
            if self.settings.direct == DirectLight::Mis { mis_weight(light.pdf, path.draws() * scattering.pdf) } else { 1.0 };
        let contribution = beta * scattering.f_cos * radiance * (weight / light.pdf);
        if contribution != Vec3A::ZERO || !self.settings.skips.zero_contributions {
            self.stats.shadow_rays += 1;
            if !scene.hides::<F>(&surface.spawn(light.wi), &light, &mut self.scratch) {
                self.add_scattered(path, contribution, origin);
            }
        }
    }

    /// What the environment sends along `wi`, weighed against its own sampling having found that direction.
    #[inline(always)]
    fn environment_behind(&self, wi: Vec3A, pdf: f32) -> Vec3A {
        if F::FLAT_ENVIRONMENT || self.settings.direct == DirectLight::Scattering {
            return self.scene.light().radiance(wi);
        }
        if self.settings.direct == DirectLight::Lights {
            return Vec3A::ZERO;
        }
        let (radiance, light_pdf) = self.scene.environment_and_pdf::<F>(wi);
        radiance * mis_weight(pdf, light_pdf)
    }
}

/// Where a path stands.
#[derive(Clone, Copy)]
struct Path {
    /// The surface it is at, the first being 1.
    vertex: u32,
    /// Throughput from the camera; the share of the branch is in it.
    beta: Vec3A,
    /// Into how many the first surface splits the path.
    branches: f32,
}

impl Path {
    /// One of `branches` before the first surface.
    #[inline(always)]
    fn new(branches: u32) -> Self {
        let branches = branches as f32;
        Self { vertex: 1, beta: Vec3A::splat(1.0 / branches), branches }
    }

    /// Directions drawn at this surface for one light sample.
    #[inline(always)]
    fn draws(&self) -> f32 {
        if self.vertex == 1 { self.branches } else { 1.0 }
    }

    /// Plays roulette with the number `u`; survivors stand for those that end.
    #[inline(always)]
    fn survives(&mut self, u: f32) -> bool {
        if self.vertex < ROULETTE_FROM {
            return true;
        }
        let limit = if self.vertex < ROULETTE_ALWAYS { 1.0 } else { ROULETTE_LIMIT };
        let keep = (self.beta.max_element() * (self.branches / ROULETTE_BELOW)).min(limit);
        // A NaN goes on to be counted.
        if u >= keep {
            return false;
        }
        self.beta /= keep;
        true
    }
}

/// Power heuristic (Veach 1997, beta = 2) for a strategy with density `a` > 0 (times its number of draws) against `b` >= 0; finite
/// for every such pair. The balance heuristic gives 1.5 % less error in the geometric mean over the scenes of `examples/efficiency.rs`,
/// within the noise of the measurement.
#[inline]
fn mis_weight(a: f32, b: f32) -> f32 {
    let r = b / a;
    1.0 / (1.0 + r * r)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_finite_and_sum_to_one() {
        for (a, b) in [(1.0, 0.0), (1e-30, 1e30), (1e30, 1e-30), (f32::MAX, f32::MAX), (1e-38, 1e-38), (2.0, 3.0)] {
            let w = mis_weight(a, b);
            assert!((0.0..=1.0).contains(&w), "{a} {b} {w}");
            if b > 0.0 {
                assert!((w + mis_weight(b, a) - 1.0).abs() < 1e-6);
            }
        }
    }
}
