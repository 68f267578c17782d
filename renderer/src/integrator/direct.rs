//! Direct light: light samples and light found by scattering, combined by multiple importance sampling.

use super::light_paths::{MOST_SURFACES, PathStart};
use super::path::Path;
use super::scatter::Scatterer;
use super::tracer::{Origin, Tracer};
use crate::features::Features;
use crate::interaction::Interaction;
use crate::light::{LightId, LightSample, Source};
use crate::query::Sight;
use crate::sampler::PixelSampler;
use crate::settings::DirectLight;
use glam::Vec3A;

impl<F: Features> Tracer<'_, F> {
    /// Draws a point or direction of light, weighted against finding it by scattering.
    #[inline(always)]
    pub(super) fn sample_light(
        &mut self,
        sampler: &PixelSampler,
        path: &Path,
        surface: &Interaction,
        (bsdf, scatterer): (&F::Bsdf, &Scatterer<'_, F>),
        wo: Vec3A,
    ) {
        let scene = self.scene;
        if !scene.samples_lights::<F>() || self.settings.direct == DirectLight::Scattering {
            return;
        }
        let set = 2 * path.vertex;
        let light = if F::FULL && scene.features().lights() {
            let [u, v, choice, more] = self.points.point(sampler, path.index, set);
            scene.sample_light::<F>(&surface.receiver::<F>(), [choice, more], [u, v])
        } else {
            self.light_samples
                .sample(scene.environment_light(), (sampler, &mut self.points), path.index, set)
                .map(LightSample::from)
        };
        let Some(light) = light else { return };
        let scattering = scatterer.eval(light.wi);
        // Not `> 0`: a NaN must reach the counter, not vanish here.
        let skips = self.settings.skips;
        if scattering.f_cos == Vec3A::ZERO && skips.zero_contributions {
            return;
        }
        let (radiance, origin) = match light.source {
            Source::Environment { radiance } => (radiance, Origin::Environment(light.wi)),
            Source::Emitter { id, barycentrics, .. } => (scene.emitted(id, barycentrics), Origin::Emitter),
            Source::Punctual { irradiance, .. } => (irradiance, Origin::Emitter),
        };
        // No scattered ray meets a light without an area.
        let alone = matches!(light.source, Source::Punctual { .. });
        let rest = match self.settings.direct {
            DirectLight::Mis => {
                self.light_paths(path, surface, (bsdf, scatterer), (wo, light.wi), || PathStart::of(&light, surface.p))
            }
            _ => 0.0,
        };
        // Weighted against light paths of density `rest`.
        let contribution = |rest: f32| {
            let weight = match self.settings.direct {
                DirectLight::Mis if !alone => {
                    let scattering = path.draws() * scattering.pdf / light.pdf;
                    1.0 / (1.0 + scattering * scattering + rest * rest)
                }
                DirectLight::Mis => 1.0 / (1.0 + rest * rest),
                _ => 1.0,
            };
            path.beta * scattering.f_cos * radiance * (weight / light.pdf)
        };
        let weighed = contribution(rest);
        if weighed != Vec3A::ZERO || !skips.zero_contributions {
            self.stats.shadow_rays += 1;
            let ray = if F::CLEAR { surface.spawn_either(light.wi) } else { surface.spawn(light.wi) };
            let (sight, share) = scene.sight_of::<F>(&ray, &light, &mut self.scratch);
            let arriving = match sight {
                Sight::Hidden => {
                    // What enters a clear body stops at its far wall, which casts no shadow.
                    let enters = F::CLEAR && surface.ns.dot(light.wi) * surface.ns.dot(wo) < 0.0;
                    if path.vertex == 1 && !enters {
                        self.hidden += weighed;
                    }
                    return;
                }
                Sight::Through => contribution(0.0),
                Sight::Clear => weighed,
            };
            let arriving = if F::CLEAR {
                arriving * share * self.medium.along(scene, surface, light.wi).over(light.distance)
            } else {
                arriving
            };
            self.add_scattered(path, arriving, origin);
        }
    }

    /// Radiance of the environment along `wi`, weighted against finding this direction by a light sample. `pdf` is the density of
    /// `wi` times the number of draws.
    #[inline(always)]
    pub(super) fn environment_behind(
        &self,
        (wi, pdf): (Vec3A, f32),
        path: &Path,
        surface: &Interaction,
        scatterer: (&F::Bsdf, &Scatterer<'_, F>),
        wo: Vec3A,
    ) -> Vec3A {
        if F::FLAT_ENVIRONMENT || self.settings.direct == DirectLight::Scattering {
            return self.scene.environment_light().radiance(wi);
        }
        if self.settings.direct == DirectLight::Lights {
            return Vec3A::ZERO;
        }
        let (radiance, light_pdf) = self.scene.environment_and_pdf::<F>(wi);
        // Where no light samples are drawn, no light paths start either.
        if light_pdf == 0.0 {
            return radiance;
        }
        let rest = self.light_paths(path, surface, scatterer, (wo, wi), || PathStart::Environment);
        let light = light_pdf / pdf;
        radiance / (1.0 + light * light * (1.0 + rest * rest))
    }

    /// Density of light paths relative to light samples, for the path that came from `wo` and leaves `surface` along `wi` for the
    /// light that begins at `start`.
    #[inline(always)]
    fn light_paths(
        &self,
        path: &Path,
        surface: &Interaction,
        scatterer: (&F::Bsdf, &Scatterer<'_, F>),
        (wo, wi): (Vec3A, Vec3A),
        start: impl FnOnce() -> PathStart,
    ) -> f32 {
        match self.casters {
            Some(casters) if (2..=MOST_SURFACES).contains(&path.vertex) && path.reach > 0.0 => {
                casters.ratio::<F>(self.scene, path.reach, surface, scatterer, (wo, wi), &start())
            }
            _ => 0.0,
        }
    }

    /// Weight of the emission of `at`, which a path that came from `wo` met from `from` at `distance` along `wi`; `pdf` as for
    /// [`Self::environment_behind`].
    #[inline(always)]
    pub(super) fn emitter_weight(
        &self,
        (wi, pdf): (Vec3A, f32),
        path: &Path,
        (from, at): (&Interaction, &Interaction),
        scatterer: (&F::Bsdf, &Scatterer<'_, F>),
        wo: Vec3A,
        distance: f32,
    ) -> f32 {
        let light_pdf = || self.scene.emitter_pdf(&from.receiver::<F>(), at, wi, distance);
        match self.settings.direct {
            DirectLight::Scattering => 1.0,
            DirectLight::Mis => {
                let light = light_pdf();
                // Where no light samples are drawn, no light paths start either.
                let rest = at.emitter.filter(|_| light > 0.0).map_or(0.0, |id| {
                    let start = || PathStart::Near { light: LightId::Triangle(id), point: at.p, n: at.n };
                    self.light_paths(path, from, scatterer, (wo, wi), start)
                });
                mis_weight(pdf, light, rest)
            }
            // An emitter that is too faint or too small to be drawn as a light is found by scattering alone.
            DirectLight::Lights if light_pdf() > 0.0 => 0.0,
            DirectLight::Lights => 1.0,
        }
    }
}

/// Power heuristic (Veach 1997, beta = 2) for a strategy with density `a` > 0 (times its number of draws) against one of `b` >= 0
/// and one that is `rest` times as dense as that; finite for all such densities. The balance heuristic is no better
/// (docs/measurements/renderer-notes.md, heuristic).
#[inline(always)]
fn mis_weight(a: f32, b: f32, rest: f32) -> f32 {
    let r = b / a;
    1.0 / (1.0 + r * r * (1.0 + rest * rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_finite_and_sum_to_one() {
        for (a, b) in [(1.0, 0.0), (1e-30, 1e30), (1e30, 1e-30), (f32::MAX, f32::MAX), (1e-38, 1e-38), (2.0, 3.0)] {
            let w = mis_weight(a, b, 0.0);
            assert!((0.0..=1.0).contains(&w), "{a} {b} {w}");
            if b > 0.0 {
                assert!((w + mis_weight(b, a, 0.0) - 1.0).abs() < 1e-6);
            }
        }
    }
}
