//! Unidirectional path tracing with environment sampling and multiple importance sampling.

use super::Settings;
use super::gbuffer::{self, FirstHit};
use crate::accel::Scratch;
use crate::compile::RenderScene;
use crate::features::Features;
use crate::interaction::Interaction;
use crate::material::{Bsdf, Mode};
use crate::ray::Ray;
use crate::sampler::PixelSampler;
use crate::stats::Stats;
use glam::{Vec2, Vec3A};

/// Surfaces a path passes before roulette may end it: direct light and the first two indirect bounces carry most of a picture.
const ROULETTE_FROM: u32 = 3;
/// Roulette never keeps a path for certain, or a path between white walls would only end at the bounce limit.
const ROULETTE_LIMIT: f32 = 0.95;

/// One camera sample.
pub(super) struct Sample {
    /// Finite; 0 where the estimate was not.
    pub radiance: Vec3A,
    pub first: Option<FirstHit>,
}

/// Camera ray of sample `index` of `pixel`, and the image point it goes through.
#[inline]
pub(super) fn camera_ray(
    scene: &RenderScene,
    settings: &Settings,
    sampler: &PixelSampler,
    pixel: (usize, usize),
    index: u32,
) -> (Ray, Vec2) {
    let [u, v, ..] = sampler.point(index, 0);
    let point = Vec2::new(pixel.0 as f32 + 0.5, pixel.1 as f32 + 0.5) + settings.filter.sample([u, v]);
    (crate::camera::ray(scene.camera(), point), point)
}

/// Traces one camera sample. `seen` is false where the pixel is known to see the environment alone: the same directions are then
/// looked up without asking the tree.
#[allow(clippy::too_many_arguments)] // The inner loop's whole state; a struct would only move the list.
#[inline]
pub(super) fn sample<F: Features>(
    scene: &RenderScene,
    settings: &Settings,
    sampler: &PixelSampler,
    pixel: (usize, usize),
    index: u32,
    seen: bool,
    scratch: &mut Scratch,
    stats: &mut Stats,
) -> Sample {
    let (ray, _) = camera_ray(scene, settings, sampler, pixel, index);
    let hit = if seen {
        stats.camera_rays += 1;
        scene.accel.closest(&ray, scratch)
    } else {
        stats.skipped_rays += 1;
        None
    };
    let (radiance, first) = match hit {
        None => (scene.light.radiance(ray.direction), None),
        Some(hit) => {
            let surface = Interaction::new::<F>(scene, &ray, &hit);
            let first = gbuffer::FirstHit::new(&surface);
            // Without light there is nothing to gather.
            let radiance = if scene.features().black_environment {
                Vec3A::ZERO
            } else {
                gather::<F>(scene, settings, sampler, index, surface, -ray.direction, scratch, stats)
            };
            (radiance, Some(first))
        }
    };
    if radiance.is_finite() {
        return Sample { radiance, first };
    }
    stats.non_finite_samples += 1;
    Sample { radiance: Vec3A::ZERO, first }
}

/// Radiance from `surface` towards `wo`.
#[allow(clippy::too_many_arguments)]
fn gather<F: Features>(
    scene: &RenderScene,
    settings: &Settings,
    sampler: &PixelSampler,
    index: u32,
    mut surface: Interaction,
    mut wo: Vec3A,
    scratch: &mut Scratch,
    stats: &mut Stats,
) -> Vec3A {
    let mut radiance = Vec3A::ZERO;
    let mut beta = Vec3A::ONE;
    for vertex in 1..=settings.max_bounces {
        let frame = ShadingFrame::new(surface.ns);
        let wo_local = frame.to_local(wo);
        let bsdf = Bsdf::<false>::new(&surface.surface, Mode::Conserving);

        // Sample the environment and weigh the direction against scattering having found it.
        if !F::FLAT_ENVIRONMENT {
            let [u, v, ..] = sampler.point(index, 2 * vertex);
            if let Some(light) = scene.light.sample([u, v])
                && surface.n.dot(light.wi) > 0.0
            {
                let scattering = bsdf.eval(wo_local, frame.to_local(light.wi));
                let weight = mis_weight(light.pdf, scattering.pdf) / light.pdf;
                let contribution = beta * scattering.f_cos * light.radiance * weight;
                // Not `> 0`: a NaN must reach the counter, not vanish here.
                if contribution != Vec3A::ZERO {
                    stats.shadow_rays += 1;
                    if !scene.accel.occluded(&surface.spawn(light.wi), scratch) {
                        radiance += contribution;
                    }
                }
            }
        }

        // Scatter.
        let [lobe, u, v, survive] = sampler.point(index, 2 * vertex - 1);
        let Some(scattering) = bsdf.sample(wo_local, lobe, [u, v]) else { break };
        let wi = frame.to_world(scattering.wi);
        // Directions below the true surface would pass through it. Rejecting them here and above alike loses their energy but
        // never gains any.
        if surface.n.dot(wi) <= 0.0 {
            break;
        }
        beta *= scattering.weight;
        if beta == Vec3A::ZERO {
            break;
        }
        if vertex >= ROULETTE_FROM {
            let keep = beta.max_element().min(ROULETTE_LIMIT);
            if survive >= keep {
                break;
            }
            beta /= keep;
        }

        // What the environment sends along `wi`, should the ray get there.
        let environment = || {
            let weight = if F::FLAT_ENVIRONMENT { 1.0 } else { mis_weight(scattering.pdf, scene.light.pdf(wi)) };
            beta * scene.light.radiance(wi) * weight
        };
        let ray = surface.spawn(wi);
        if vertex == settings.max_bounces {
            // No surface beyond: only whether something stands in the way matters.
            let contribution = environment();
            if contribution != Vec3A::ZERO {
                stats.shadow_rays += 1;
                if !scene.accel.occluded(&ray, scratch) {
                    radiance += contribution;
                }
            }
            break;
        }
        stats.bounce_rays += 1;
        let Some(hit) = scene.accel.closest(&ray, scratch) else {
            radiance += environment();
            break;
        };
        surface = Interaction::new::<F>(scene, &ray, &hit);
        wo = -wi;
    }
    radiance
}

/// Power heuristic (Veach 1997, beta = 2) for a strategy with density `a` > 0 against `b` >= 0; finite for every such pair.
#[inline]
fn mis_weight(a: f32, b: f32) -> f32 {
    let r = b / a;
    1.0 / (1.0 + r * r)
}

/// Orthonormal frame with the shading normal as +z.
struct ShadingFrame {
    t: Vec3A,
    b: Vec3A,
    n: Vec3A,
}

impl ShadingFrame {
    /// Duff et al. 2017, branchless and exact at both poles.
    #[inline]
    fn new(n: Vec3A) -> Self {
        let sign = 1f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let c = n.x * n.y * a;
        Self { t: Vec3A::new(1.0 + sign * n.x * n.x * a, sign * c, -sign * n.x), b: Vec3A::new(c, sign + n.y * n.y * a, -n.y), n }
    }

    #[inline]
    fn to_local(&self, v: Vec3A) -> Vec3A {
        Vec3A::new(self.t.dot(v), self.b.dot(v), self.n.dot(v))
    }

    #[inline]
    fn to_world(&self, v: Vec3A) -> Vec3A {
        (self.t * v.x + self.b * v.y + self.n * v.z).normalize()
    }
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

    #[test]
    fn shading_frames_are_orthonormal() {
        for i in 0..1000 {
            let t = i as f32 * 0.37;
            let z = (i as f32 / 499.5 - 1.0).clamp(-1.0, 1.0);
            let r = (1.0 - z * z).max(0.0).sqrt();
            let frame = ShadingFrame::new(Vec3A::new(r * t.cos(), r * t.sin(), z).normalize());
            assert!(frame.t.dot(frame.b).abs() < 1e-5 && frame.t.dot(frame.n).abs() < 1e-5 && frame.b.dot(frame.n).abs() < 1e-5);
            assert!((frame.t.length() - 1.0).abs() < 1e-5 && frame.t.cross(frame.b).dot(frame.n) > 0.999);
            let v = Vec3A::new(0.3, -0.5, 0.81);
            assert!(frame.to_world(frame.to_local(v)).distance(v.normalize()) < 1e-5);
        }
    }
}
