//! What paths ask of a compiled scene: rays, with holes and single-sided surfaces, and lights.
//!
//! **Single-sided surfaces.** A ray passes a single-sided surface that it meets from behind, and every segment of a path is
//! judged in the direction from the camera to the light: camera rays, bounce rays and shadow rays alike, and rays to pixel
//! centres. (This is how glTF's back faces are culled, carried on beyond the first surface.) Such a surface can let a path
//! through in one direction only, so a path from the light must not be judged by the way it travels. Light paths therefore end
//! where they would pass a surface from behind: seen from the camera's side they would meet its front. What camera paths carry
//! through surfaces from behind no light path finds, and it is weighed that way. The picture is the same with and without light
//! paths.

use crate::accel::{Candidate, Hit, Scratch};
use crate::compile::{Clear, CompiledMaterial, RenderScene};
use crate::features::Features;
use crate::geometry::Geometry;
use crate::interaction::Interaction;
use crate::light::{EnvironmentLight, LightSample, Receiver, Source};
use crate::material::Principled;
use crate::ray::Ray;
use crate::texture::Lookup;
use glam::{Vec2, Vec3A, Vec4};
use renderflow_frame::color::luminance;
use renderflow_scenes::{Mesh, TextureSlot};
use std::cell::Cell;

/// A shadow ray stops this share of its length before its light: the light itself must not stand in its way, nor what touches it.
const BEFORE_LIGHT: f32 = 1.0 - 1e-5;
/// A surface passed from behind counts if it lies before this share of the distance: one that coincides with what is hit does
/// not.
const BEFORE_HIT: f32 = 1.0 - 1e-5;

/// Clear surfaces that let this share of the light through cast no shadow in shadow maps.
const LIT_THROUGH: f32 = 0.5;

/// Kinds of rays to blended surfaces: those that are samples of what is seen, and those that decide once and for all.
const SAMPLE: u8 = 0;
const CENTRE: u8 = 1;

/// What lies along a ray to the environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sight {
    /// A surface that stops it.
    Hidden,
    /// Surfaces that it passes from behind, and no other.
    Through,
    /// Nothing but holes.
    Clear,
}

impl Sight {
    fn of(hidden: bool, passed: bool) -> Self {
        match (hidden, passed) {
            (true, _) => Self::Hidden,
            (false, true) => Self::Through,
            (false, false) => Self::Clear,
        }
    }
}

/// A point of a surface, at which something is looked up.
trait Spot: Copy {
    /// Texture coordinates of a set.
    fn uv(&self, set: usize) -> Vec2;
    /// Colour and opacity of the vertices.
    fn color(&self) -> Vec4;
}

#[derive(Clone, Copy)]
struct OfHit<'a> {
    geometry: &'a Geometry,
    hit: &'a Hit,
}

impl Spot for OfHit<'_> {
    #[inline(always)]
    fn uv(&self, set: usize) -> Vec2 {
        self.geometry.uv(self.hit, set)
    }

    #[inline(always)]
    fn color(&self) -> Vec4 {
        self.geometry.color(self.hit)
    }
}

/// A point of a triangle, by the weights of its corners.
#[derive(Clone, Copy)]
struct OfMesh<'a> {
    mesh: &'a Mesh,
    corners: [u32; 3],
    weights: [f32; 3],
}

impl OfMesh<'_> {
    fn mixed<T: Copy + Default + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>>(&self, values: &[T]) -> T {
        let [a, b, c] = self.corners.map(|v| values.get(v as usize).copied().unwrap_or_default());
        a * self.weights[0] + b * self.weights[1] + c * self.weights[2]
    }
}

impl Spot for OfMesh<'_> {
    fn uv(&self, set: usize) -> Vec2 {
        self.mixed(self.mesh.uv_set(set))
    }

    fn color(&self) -> Vec4 {
        if self.mesh.colors.is_empty() { Vec4::ONE } else { self.mixed(&self.mesh.colors) }
    }
}

impl RenderScene {
    /// Whether `ray` stops at a triangle: not behind single-sided surfaces, not where the alpha mask has a hole, and on blended
    /// surfaces by chance, or for rays of `KIND` [`CENTRE`] where they cover at least one half.
    #[inline(always)]
    fn stops<const KIND: u8>(&self, ray: &Ray, candidate: &Candidate) -> bool {
        let material = &self.materials[self.geometry.material(&candidate.hit)];
        (candidate.front || material.both_sides()) && self.meets::<KIND>(material, ray, &candidate.hit)
    }

    /// Whether `ray` passes a triangle because it meets it from behind.
    #[inline(always)]
    fn is_behind(&self, ray: &Ray, candidate: &Candidate) -> bool {
        let material = &self.materials[self.geometry.material(&candidate.hit)];
        !(candidate.front || material.both_sides()) && self.meets::<SAMPLE>(material, ray, &candidate.hit)
    }

    /// Whether the surface at `hit` is there for `ray`.
    #[inline(always)]
    fn meets<const KIND: u8>(&self, material: &CompiledMaterial, ray: &Ray, hit: &Hit) -> bool {
        let spot = OfHit { geometry: &self.geometry, hit };
        let Some(opacity) = material.opacity else { return self.is_there(material, spot) };
        let covered = self.coverage(material, opacity, spot);
        if KIND == CENTRE { covered >= 0.5 } else { self.covers(ray, hit, covered) }
    }

    /// Share of a blended surface of the given opacity that covers what lies behind it at `spot`.
    #[inline(always)]
    fn coverage(&self, material: &CompiledMaterial, opacity: f32, spot: impl Spot) -> f32 {
        opacity * self.alpha(material, spot)
    }

    /// Opacity at `spot` by the texture and the colours of vertices.
    #[inline(always)]
    fn alpha(&self, material: &CompiledMaterial, spot: impl Spot) -> f32 {
        let texture = |slot: &TextureSlot| self.textures[slot.texture].alpha(slot, spot.uv(slot.set));
        let alpha = material.base_color_texture.as_ref().map_or(1.0, texture);
        if material.has_colors() { alpha * spot.color().w } else { alpha }
    }

    /// Share of what lies behind that a blended surface leaves open at `hit`; `None` for other surfaces.
    pub(crate) fn left_open(&self, material: &CompiledMaterial, hit: &Hit) -> Option<f32> {
        let opacity = material.opacity?;
        Some((1.0 - self.coverage(material, opacity, OfHit { geometry: &self.geometry, hit })).clamp(0.0, 1.0))
    }

    /// Whether the alpha mask of `material` leaves the surface there at `spot`.
    #[inline(always)]
    fn is_there(&self, material: &CompiledMaterial, spot: impl Spot) -> bool {
        material.alpha_mask.is_none_or(|mask| mask.factor * self.alpha(material, spot) >= mask.cutoff)
    }

    /// The nearest surface along `ray`.
    #[inline(always)]
    pub(crate) fn trace<F: Features>(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        #[cfg(feature = "record")]
        crate::record::ray(ray, false);
        if F::FULL && self.features().cutouts {
            return self.geometry.closest_where(ray, scratch, |candidate| self.stops::<SAMPLE>(ray, candidate));
        }
        self.geometry.closest(ray, scratch)
    }

    /// As [`Self::trace`], for a ray to where a path stopped on a triangle, which is `landed` to [`Geometry::locate`]: it stops
    /// there too, and only what lies before is left to chance. A second chance would count the surface's coverage twice.
    #[inline(always)]
    pub(crate) fn trace_to<F: Features>(&self, ray: &Ray, landed: (u32, u32), scratch: &mut Scratch) -> Option<Hit> {
        if F::FULL && self.features().blended {
            self.trace_to_blended(ray, landed, scratch)
        } else {
            self.trace::<F>(ray, scratch)
        }
    }

    /// Out of line, so that one loop serves all sets of features.
    #[inline(never)]
    fn trace_to_blended(&self, ray: &Ray, landed: (u32, u32), scratch: &mut Scratch) -> Option<Hit> {
        #[cfg(feature = "record")]
        crate::record::ray(ray, false);
        self.geometry.closest_where(ray, scratch, |candidate| {
            let material = &self.materials[self.geometry.material(&candidate.hit)];
            let there = || self.geometry.locate(&candidate.hit) == landed || self.meets::<SAMPLE>(material, ray, &candidate.hit);
            (candidate.front || material.both_sides()) && there()
        })
    }

    /// As [`Self::trace`], for a ray that decides what is seen at a point: blended surfaces are there where they cover at least
    /// one half.
    #[inline(always)]
    pub(crate) fn trace_centre(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        self.geometry.closest_where(ray, scratch, |candidate| self.stops::<CENTRE>(ray, candidate))
    }

    /// The nearest surface along `ray` that covers anything, and the share that it covers.
    pub(crate) fn trace_layer(&self, ray: &Ray, scratch: &mut Scratch) -> Option<(Hit, f32)> {
        let covered = |hit: &Hit| {
            let (material, spot) = (&self.materials[self.geometry.material(hit)], OfHit { geometry: &self.geometry, hit });
            match material.opacity {
                Some(opacity) => self.coverage(material, opacity, spot),
                None => f32::from(u8::from(self.is_there(material, spot))),
            }
        };
        let hit = self.geometry.closest_where(ray, scratch, |candidate| {
            let material = &self.materials[self.geometry.material(&candidate.hit)];
            (candidate.front || material.both_sides()) && covered(&candidate.hit) > 0.0
        })?;
        Some((hit, covered(&hit)))
    }

    /// As [`Self::trace`], and whether the ray passes a single-sided surface from behind on its way there, or to the environment.
    #[inline(always)]
    pub(crate) fn trace_noting<F: Features>(&self, ray: &Ray, scratch: &mut Scratch) -> (Option<Hit>, bool) {
        if !(F::FULL && self.features().cutouts) {
            return (self.trace::<F>(ray, scratch), false);
        }
        #[cfg(feature = "record")]
        crate::record::ray(ray, false);
        // The query shows everything before the hit, and some of what lies beyond.
        let nearest_passed = Cell::new(f32::INFINITY);
        let hit = self.geometry.closest_where(ray, scratch, |candidate| {
            if self.is_behind(ray, candidate) {
                nearest_passed.set(nearest_passed.get().min(candidate.hit.t));
            }
            self.stops::<SAMPLE>(ray, candidate)
        });
        (hit, nearest_passed.get() < hit.map_or(f32::INFINITY, |hit| hit.t * BEFORE_HIT))
    }

    /// The nearest surface along each of `rays`, which should be close to each other, in `hits`.
    #[inline(always)]
    pub(crate) fn trace_all<F: Features>(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) {
        self.trace_packet::<F, SAMPLE>(rays, hits, scratch);
    }

    /// As [`Self::trace_all`], for rays that decide what is seen at a point: blended surfaces are there where they cover at least
    /// one half. Bit `k` of what is returned tells whether ray `k` passes a surface: a hole, or a back that is not there.
    #[inline(always)]
    pub(crate) fn trace_centres<F: Features>(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) -> u64 {
        self.trace_packet::<F, CENTRE>(rays, hits, scratch)
    }

    /// As [`Self::trace_centres`], for rays from a light that tell where shadows begin. Clear surfaces that let at least half of
    /// the light through are not there: windows light their rooms (docs/measurements/renderer-notes.md, clear-surfaces).
    pub(crate) fn trace_casters<F: Features>(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) {
        self.trace_centres::<F>(rays, hits, scratch);
        if !self.features().clear {
            return;
        }
        let lit = |hit: &Hit| self.is_lit_through(&self.materials[self.geometry.material(hit)]);
        for (ray, hit) in rays.iter().zip(hits).filter(|(_, hit)| hit.as_ref().is_some_and(lit)) {
            *hit = self
                .geometry
                .closest_where(ray, scratch, |candidate| self.stops::<CENTRE>(ray, candidate) && !lit(&candidate.hit));
        }
    }

    /// Whether a surface lets at least half of the light that meets it through. Textures are left out.
    fn is_lit_through(&self, material: &CompiledMaterial) -> bool {
        let Principled { transmission, metallic, base_color, .. } = material.surface;
        material.clear != Clear::No && transmission * (1.0 - metallic) * luminance(base_color.to_array()) >= LIT_THROUGH
    }

    #[inline(always)]
    fn trace_packet<F: Features, const KIND: u8>(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) -> u64 {
        #[cfg(feature = "record")]
        crate::record::packet(rays);
        self.geometry.closest_packet(rays, hits, scratch);
        let mut passed = 0;
        if F::FULL && self.features().cutouts {
            // What is nearest of all and stops every ray is what the ray meets; elsewhere holes and back faces decide.
            let open = |hit: &Hit| !self.materials[self.geometry.material(hit)].is_solid();
            for (k, (ray, hit)) in rays.iter().zip(hits).enumerate().filter(|(_, (_, hit))| hit.as_ref().is_some_and(open)) {
                let nearest = hit.map_or(0.0, |hit| hit.t);
                *hit = if KIND == CENTRE { self.trace_centre(ray, scratch) } else { self.trace::<F>(ray, scratch) };
                passed |= u64::from(hit.is_none_or(|hit| hit.t > nearest)) << (k & 63);
            }
        }
        passed
    }

    /// What there is along `ray` to the environment, and the share of light that panes on the way let through.
    #[inline(always)]
    pub(crate) fn sight<F: Features>(&self, ray: &Ray, scratch: &mut Scratch) -> (Sight, Vec3A) {
        #[cfg(feature = "record")]
        crate::record::ray(ray, true);
        if !(F::FULL && self.features().cutouts || F::CLEAR && self.features().panes) {
            let sight = if self.geometry.occluded(ray, scratch) { Sight::Hidden } else { Sight::Clear };
            return (sight, Vec3A::ONE);
        }
        let (passed, share) = (Cell::new(false), Cell::new(Vec3A::ONE));
        let hidden = self.geometry.occluded_where(ray, scratch, |candidate| {
            if self.is_behind(ray, candidate) {
                passed.set(true);
            }
            self.stops::<SAMPLE>(ray, candidate) && !self.passes_pane::<F>(ray, &candidate.hit, &share)
        });
        (Sight::of(hidden, passed.get()), share.get())
    }

    /// What there is along `ray` before a light sample, as [`Self::sight`] has it.
    #[inline(always)]
    pub(crate) fn sight_of<F: Features>(&self, ray: &Ray, light: &LightSample, scratch: &mut Scratch) -> (Sight, Vec3A) {
        let own = match light.source {
            Source::Emitter { id, .. } => Some(self.emitter(id)),
            Source::Punctual { .. } if light.distance < f32::INFINITY => None,
            _ => return self.sight::<F>(ray, scratch),
        };
        let end = light.distance * BEFORE_LIGHT;
        let (passed, share) = (Cell::new(false), Cell::new(Vec3A::ONE));
        let cutouts = self.features().cutouts;
        let hidden = self.geometry.occluded_where(ray, scratch, |candidate| {
            if candidate.hit.t >= end || own.is_some_and(|own| self.geometry.locate(&candidate.hit) == own) {
                return false;
            }
            if cutouts && self.is_behind(ray, candidate) {
                passed.set(true);
            }
            self.stops::<SAMPLE>(ray, candidate) && !self.passes_pane::<F>(ray, &candidate.hit, &share)
        });
        (Sight::of(hidden, passed.get()), share.get())
    }

    /// Whether light goes straight through what is at `hit`; `share` is multiplied by how much of it.
    #[inline(always)]
    fn passes_pane<F: Features>(&self, ray: &Ray, hit: &Hit, share: &Cell<Vec3A>) -> bool {
        if !F::CLEAR {
            return false;
        }
        let Some(pane) = self.pane(hit) else { return false };
        let left = share.get() * self.pane_share(pane, hit, ray.direction);
        share.set(left);
        left != Vec3A::ZERO
    }

    /// The environment as light samples are drawn from it.
    #[inline(always)]
    pub(crate) fn environment_light(&self) -> &EnvironmentLight {
        self.lights.environment()
    }

    /// Whether there are lights to sample.
    #[inline(always)]
    pub(crate) fn samples_lights<F: Features>(&self) -> bool {
        !F::FLAT_ENVIRONMENT || F::FULL && self.features().lights()
    }

    /// A direction from `at` to light.
    #[inline(always)]
    pub(crate) fn sample_light<F: Features>(&self, at: &Receiver, choice: [f32; 2], u: [f32; 2]) -> Option<LightSample> {
        if F::FULL && self.features().lights() {
            let sample = self.lights.sample(at, choice, u)?;
            // A flat environment is left to scattering, which finds it without noise.
            return (!F::FLAT_ENVIRONMENT || !matches!(sample.source, Source::Environment { .. })).then_some(sample);
        }
        self.environment_light().sample(u).map(LightSample::from)
    }

    /// What the environment sends from `wi`, and the density with which [`Self::sample_light`] finds that direction.
    #[inline(always)]
    pub(crate) fn environment_and_pdf<F: Features>(&self, wi: Vec3A) -> (Vec3A, f32) {
        if F::FLAT_ENVIRONMENT {
            return (self.environment_light().radiance(wi), 0.0);
        }
        if F::FULL { self.lights.radiance_and_pdf(wi) } else { self.environment_light().radiance_and_pdf(wi) }
    }

    /// Density with which [`Self::sample_light`] for `from` finds the emissive point `at`, which a ray of length `distance` along
    /// `wi` met.
    #[inline(always)]
    pub(crate) fn emitter_pdf(&self, from: &Receiver, at: &Interaction, wi: Vec3A, distance: f32) -> f32 {
        let cos = if at.front { -at.n.dot(wi) } else { at.n.dot(wi) };
        at.emitter.map_or(0.0, |id| self.lights.pdf_emitter(from, id, distance, cos))
    }

    /// Radiance that `material` emits where the texture coordinates of each set are `uv`.
    #[inline(always)]
    pub(crate) fn emission(&self, material: &CompiledMaterial, uv: impl Fn(usize) -> Vec2) -> Vec3A {
        // Unfiltered: scattering and light sampling must see the same light.
        let texture = |slot: &TextureSlot| Vec3A::from_vec4(self.slot_value(slot, Lookup::sharp(uv(slot.set))));
        material.emissive * material.emissive_texture.as_ref().map_or(Vec3A::ONE, texture)
    }

    /// Radiance that emitter `id` emits at the point with the given weights of its corners; which side emits is up to the caller.
    pub(crate) fn emitted(&self, id: u32, weights: [f32; 3]) -> Vec3A {
        let (instance, triangle) = self.emitter(id);
        let instance = &self.geometry.instances[instance as usize];
        let material = &self.materials[instance.material];
        let mesh = self.geometry.mesh(instance.mesh);
        let spot = OfMesh { mesh, corners: mesh.triangles[triangle as usize], weights };
        let emission = || self.emission(material, |set| spot.uv(set));
        // Where the mask has a hole there is nothing to emit.
        match material.opacity {
            Some(opacity) => emission() * self.coverage(material, opacity, spot),
            None if self.is_there(material, spot) => emission(),
            None => Vec3A::ZERO,
        }
    }
}
