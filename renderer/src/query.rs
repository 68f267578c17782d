//! What paths ask of a compiled scene: rays, with holes and single-sided surfaces, and lights.

use crate::accel::{Candidate, Hit, Scratch};
use crate::compile::{CompiledMaterial, RenderScene};
use crate::features::Features;
use crate::interaction::Interaction;
use crate::light::{EnvironmentLight, LightSample, Source};
use crate::ray::Ray;
use crate::texture::Lookup;
use glam::{Vec2, Vec3A};

/// A shadow ray stops this share of its length before its light: the light itself must not stand in its way, nor what touches it.
const BEFORE_LIGHT: f32 = 1.0 - 1e-5;

impl RenderScene {
    /// Whether rays stop at a triangle: not behind single-sided surfaces, not where the alpha mask has a hole.
    #[inline(always)]
    fn stops(&self, candidate: &Candidate) -> bool {
        let material = &self.materials[self.geometry.material(&candidate.hit)];
        (candidate.front || material.double_sided) && self.is_there(material, || self.geometry.uv(&candidate.hit))
    }

    /// Whether the alpha mask of `material` leaves the surface there where the texture coordinates are `uv`.
    #[inline(always)]
    fn is_there(&self, material: &CompiledMaterial, uv: impl Fn() -> Vec2) -> bool {
        match (&material.alpha_mask, &material.base_color_texture) {
            (None, _) => true,
            (Some(mask), None) => mask.factor >= mask.cutoff,
            (Some(mask), Some(slot)) => mask.factor * self.textures[slot.texture].alpha(slot, uv()) >= mask.cutoff,
        }
    }

    /// The nearest surface along `ray`.
    #[inline(always)]
    pub(crate) fn trace<F: Features>(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        #[cfg(feature = "record")]
        crate::record::ray(ray, false);
        if F::FULL && self.features().cutouts {
            return self.geometry.closest_where(ray, scratch, |candidate| self.stops(candidate));
        }
        self.geometry.closest(ray, scratch)
    }

    /// The nearest surface along each of `rays`, which should be close to each other, in `hits`.
    #[inline(always)]
    pub(crate) fn trace_all<F: Features>(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) {
        if F::FULL && self.features().cutouts {
            rays.iter().zip(hits).for_each(|(ray, hit)| *hit = self.trace::<F>(ray, scratch));
            return;
        }
        #[cfg(feature = "record")]
        crate::record::packet(rays);
        self.geometry.closest_packet(rays, hits, scratch);
    }

    /// Whether a surface stands in the way of `ray` to the environment.
    #[inline(always)]
    pub(crate) fn shadowed<F: Features>(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        #[cfg(feature = "record")]
        crate::record::ray(ray, true);
        if F::FULL && self.features().cutouts {
            return self.geometry.occluded_where(ray, scratch, |candidate| self.stops(candidate));
        }
        self.geometry.occluded(ray, scratch)
    }

    /// Whether a surface stands in the way of `ray` to a light sample.
    #[inline(always)]
    pub(crate) fn hides<F: Features>(&self, ray: &Ray, light: &LightSample, scratch: &mut Scratch) -> bool {
        let Source::Emitter { id, .. } = light.source else { return self.shadowed::<F>(ray, scratch) };
        let end = light.distance * BEFORE_LIGHT;
        self.geometry.occluded_where(ray, scratch, |candidate| {
            candidate.hit.t < end && self.geometry.locate(&candidate.hit) != self.emitter(id) && self.stops(candidate)
        })
    }

    /// The environment.
    #[inline(always)]
    pub(crate) fn light(&self) -> &EnvironmentLight {
        self.lights.environment()
    }

    /// Whether there is light that is found by looking for it.
    #[inline(always)]
    pub(crate) fn samples_lights<F: Features>(&self) -> bool {
        !F::FLAT_ENVIRONMENT || F::FULL && self.features().emitters
    }

    /// A direction from `p` to light.
    #[inline(always)]
    pub(crate) fn sample_light<F: Features>(&self, p: Vec3A, choice: f32, u: [f32; 2]) -> Option<LightSample> {
        if F::FULL && self.features().emitters {
            let sample = self.lights.sample(p, choice, u)?;
            // A flat environment is left to scattering, which finds it without noise.
            return (!F::FLAT_ENVIRONMENT || matches!(sample.source, Source::Emitter { .. })).then_some(sample);
        }
        self.light().sample(u).map(LightSample::from)
    }

    /// What the environment sends from `wi`, and the density with which [`Self::sample_light`] finds that direction.
    #[inline(always)]
    pub(crate) fn environment_and_pdf<F: Features>(&self, wi: Vec3A) -> (Vec3A, f32) {
        if F::FLAT_ENVIRONMENT {
            return (self.light().radiance(wi), 0.0);
        }
        if F::FULL { self.lights.radiance_and_pdf(wi) } else { self.light().radiance_and_pdf(wi) }
    }

    /// Density with which [`Self::sample_light`] finds the emissive point `at`, which a ray of length `distance` along `wi` met.
    #[inline(always)]
    pub(crate) fn emitter_pdf(&self, at: &Interaction, wi: Vec3A, distance: f32) -> f32 {
        let cos = if at.front { -at.n.dot(wi) } else { at.n.dot(wi) };
        at.emitter.map_or(0.0, |id| self.lights.pdf_emitter(id, distance, cos))
    }

    /// Radiance that `material` emits where the texture coordinates are `uv`.
    #[inline(always)]
    pub(crate) fn emission(&self, material: &CompiledMaterial, uv: Vec2) -> Vec3A {
        // Unfiltered: scattering and light sampling must see the same light.
        let texture = |slot| Vec3A::from_vec4(self.slot_value(slot, Lookup::sharp(uv)));
        material.emissive * material.emissive_texture.as_ref().map_or(Vec3A::ONE, texture)
    }

    /// Radiance that emitter `id` emits at the point with the given weights of its corners; which side emits is up to the caller.
    pub(crate) fn emitted(&self, id: u32, weights: [f32; 3]) -> Vec3A {
        let (instance, triangle) = self.emitter(id);
        let instance = &self.geometry.instances[instance as usize];
        let material = &self.materials[instance.material];
        let mesh = self.geometry.mesh(instance.mesh);
        let corner = |v: u32| mesh.uvs.get(v as usize).copied().unwrap_or_default();
        let [a, b, c] = mesh.triangles[triangle as usize].map(corner);
        let uv = a * weights[0] + b * weights[1] + c * weights[2];
        // Where the mask has a hole there is nothing to emit.
        if self.is_there(material, || uv) { self.emission(material, uv) } else { Vec3A::ZERO }
    }
}
