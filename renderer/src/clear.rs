//! Light that goes straight through surfaces: through the share that a blended surface leaves open, and through panes.
//!
//! A blended surface stops a ray by chance, with the probability that its coverage at the place is. The chance is a hash of the
//! ray and of the triangle, so that every query of one ray agrees. Rays to pixel centres, which carry the G-buffer, stop where
//! the coverage is at least one half.
//!
//! A pane lets a share of the light straight through that depends on its angle and its colour. Shadow rays multiply these
//! shares. A path goes through with a probability, and is mirrored otherwise. It neither bends nor counts a surface, so that
//! light samples behind it find the same light.

use crate::accel::{Hit, Scratch};
use crate::compile::{Clear, CompiledMaterial, RenderScene};
use crate::features::Features;
use crate::film::FirstHit;
use crate::interaction::{Cone, Interaction};
use crate::material::glass::{fresnel, pane_transmittance, refraction_index};
use crate::material::{Principled, Side};
use crate::ray::Ray;
use crate::texture::Lookup;
use glam::Vec3A;
use renderflow_scenes::TextureSlot;

/// Surfaces rougher than this are what guides show; smoother ones show what lies behind them.
const SHOWN_ROUGHNESS: f32 = 0.25;
/// Most surfaces that guides look through.
const MOST_LOOKED_THROUGH: u32 = 8;
/// Most blended surfaces whose mean guides show, and the share of light behind them that may be left out.
const MOST_LAYERS: u32 = 16;
const LEAST_SHARE: f32 = 0.01;
/// Most panes that a path goes through between two other surfaces: so many that no light is left behind them, unless they mirror
/// and absorb next to nothing. Shadow rays know no limit.
const MOST_PANES: u32 = 1 << 16;

/// A number in 0..1 that depends on a ray and a triangle alone.
#[inline(always)]
fn chance(ray: &Ray, instance: u32, triangle: u32) -> f32 {
    let mut hash = 0x9e37_79b9_7f4a_7c15_u64 ^ (u64::from(instance) << 32 | u64::from(triangle));
    for v in [ray.origin.to_array(), ray.direction.to_array()].into_iter().flatten() {
        // The multiplication and the shift of splitmix64 (Steele, Lea and Flood 2014).
        hash = (hash ^ u64::from(v.to_bits())).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        hash ^= hash >> 29;
    }
    hash = hash.wrapping_mul(0x94d0_49bb_1331_11eb);
    (hash >> 40) as f32 / (1u32 << 24) as f32
}

impl RenderScene {
    /// Whether a blended surface that covers the share `covered` at `hit` stops `ray`.
    #[inline(always)]
    pub(crate) fn covers(&self, ray: &Ray, hit: &Hit, covered: f32) -> bool {
        let (instance, triangle) = self.geometry.locate(hit);
        chance(ray, instance, triangle) < covered
    }

    /// Share of light that goes straight through `material` at `hit`, if it is a pane there.
    #[inline(always)]
    pub(crate) fn pane_share(&self, material: &CompiledMaterial, hit: &Hit, direction: Vec3A) -> Vec3A {
        let surface = &material.surface;
        let (mut color, mut transmission, mut metallic) = (surface.base_color, surface.transmission, surface.metallic);
        if material.has_colors() {
            color *= Vec3A::from_vec4(self.geometry.color(hit));
        }
        if material.base_color_texture.is_some()
            || material.transmission_texture.is_some()
            || material.metallic_roughness_texture.is_some()
        {
            // Unfiltered: paths and shadow rays must see the same pane.
            let lookup = Lookup::sharp(self.geometry.uv(hit, 0));
            let lookup = |set| if set == 0 { lookup } else { Lookup::sharp(self.geometry.uv(hit, set)) };
            let value = |slot: &Option<TextureSlot>| slot.as_ref().map(|slot| self.slot_value(slot, lookup(slot.set)));
            color *= value(&material.base_color_texture).map_or(Vec3A::ONE, Vec3A::from_vec4);
            transmission *= value(&material.transmission_texture).map_or(1.0, |v| v.x);
            metallic *= value(&material.metallic_roughness_texture).map_or(1.0, |v| v.z);
        }
        let cos = self.geometry.surface(hit).n.dot(direction).abs();
        let share = transmission.clamp(0.0, 1.0) * (1.0 - metallic.clamp(0.0, 1.0));
        color.clamp(Vec3A::ZERO, Vec3A::ONE) * (share * pane_transmittance(surface.specular, cos))
    }

    /// The pane that `hit` is on, if it is one.
    #[inline(always)]
    pub(crate) fn pane(&self, hit: &Hit) -> Option<&CompiledMaterial> {
        Some(&self.materials[self.geometry.material(hit)]).filter(|material| material.clear == Clear::Pane)
    }
}

/// A ray on its way through panes.
#[derive(Clone, Copy)]
pub(crate) struct Straight {
    /// Starts behind the last pane.
    pub ray: Ray,
    /// What the ray meets that is no pane, or a pane that mirrors it.
    pub hit: Option<Hit>,
    /// Whether single-sided surfaces were passed from behind.
    pub through: bool,
    /// Weight of the path, by what the panes let through or kept.
    pub weight: Vec3A,
    /// Metres from the first origin to that of `ray`.
    pub before: f32,
}

impl Straight {
    /// Nothing passed so far.
    #[inline(always)]
    pub fn new(ray: Ray, hit: Option<Hit>, through: bool) -> Self {
        Self { ray, hit, through, weight: Vec3A::ONE, before: 0.0 }
    }

    /// Goes on through panes, by chance, until something else is met or a pane mirrors.
    #[inline(always)]
    pub fn go_on<F: Features>(self, scene: &RenderScene, scratch: &mut Scratch) -> Self {
        self.go_on_by(scene, scratch, |ray, scratch| scene.trace_noting::<F>(ray, scratch))
    }

    /// As [`Self::go_on`], to where a path stopped on the triangle `landed` ([`RenderScene::trace_to`]). Single-sided surfaces
    /// passed from behind are not noted.
    #[inline(always)]
    pub fn go_on_to<F: Features>(self, scene: &RenderScene, landed: (u32, u32), scratch: &mut Scratch) -> Self {
        self.go_on_by(scene, scratch, |ray, scratch| (scene.trace_to::<F>(ray, landed, scratch), false))
    }

    #[inline(always)]
    fn go_on_by(
        mut self,
        scene: &RenderScene,
        scratch: &mut Scratch,
        trace: impl Fn(&Ray, &mut Scratch) -> (Option<Hit>, bool),
    ) -> Self {
        if !scene.features().panes {
            return self;
        }
        for _ in 0..MOST_PANES {
            let Some((hit, pane)) = self.hit.and_then(|hit| Some((hit, scene.pane(&hit)?))) else { return self };
            let share = scene.pane_share(pane, &hit, self.ray.direction);
            let passes = share.max_element();
            let (instance, triangle) = scene.geometry.locate(&hit);
            if chance(&self.ray, !instance, triangle) >= passes {
                self.weight /= 1.0 - passes;
                return self;
            }
            self.weight *= share / passes;
            self.before += hit.t;
            self.ray = scene.geometry.behind(&hit, self.ray.direction);
            let (next, through) = trace(&self.ray, scratch);
            self.hit = next;
            self.through |= through;
        }
        // A way without an end.
        self.weight = Vec3A::ZERO;
        self
    }
}

/// What a path is inside of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Medium {
    /// What it absorbs, per metre.
    absorption: Vec3A,
    /// Square of its index of refraction: throughput that light gains when it leaves.
    gain: f32,
}

impl Medium {
    /// Outside of all bodies.
    pub const AIR: Self = Self { absorption: Vec3A::ZERO, gain: 1.0 };

    /// A medium that absorbs `absorption` per metre, of index of refraction `index`.
    #[inline(always)]
    pub fn of(absorption: Vec3A, index: f32) -> Self {
        Self { absorption, gain: index * index }
    }

    /// Square of the index of refraction.
    #[inline(always)]
    pub fn gain(&self) -> f32 {
        self.gain
    }

    /// What a ray is inside of that leaves `surface` along `wi`; on the other side of the surface it is air, or the body that the
    /// surface bounds. Bodies inside of bodies are bounded by air.
    #[inline(always)]
    pub fn along(self, scene: &RenderScene, surface: &Interaction, wi: Vec3A) -> Self {
        let crosses = surface.n.dot(wi) < 0.0;
        match (surface.side, crosses) {
            (Side::Outside, true) | (Side::Inside, false) => {
                let material = &scene.materials[surface.material];
                if material.clear == Clear::No {
                    return self;
                }
                Self::of(material.absorption, refraction_index(material.surface.specular))
            }
            (Side::Inside, true) => Self::AIR,
            _ => self,
        }
    }

    /// Share of light that is left after `distance` metres.
    #[inline(always)]
    pub fn over(&self, distance: f32) -> Vec3A {
        if self.absorption == Vec3A::ZERO {
            return Vec3A::ONE;
        }
        // An infinite distance times nothing would not be a number.
        (self.absorption * -distance.min(f32::MAX)).exp()
    }
}

/// What is seen through the surface that a ray meets.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Beyond {
    /// Share of its light that arrives; 0 where nothing is seen through.
    pub transmittance: Vec3A,
    /// World-space unit direction in which the environment is seen through clear surfaces; 0 where another surface is behind
    /// them.
    pub direction: Vec3A,
}

/// What is seen through the surface at `hit`, which the ray to a pixel's centre meets.
#[inline(never)]
pub(crate) fn beyond<F: Features>(scene: &RenderScene, ray: &Ray, hit: &Hit, cone: Cone, scratch: &mut Scratch) -> Beyond {
    let material = &scene.materials[scene.geometry.material(hit)];
    let mut beyond = match material.clear {
        Clear::No => Beyond::default(),
        _ => look_through::<F>(scene, *ray, *hit, cone, (true, scratch)).1,
    };
    if let Some(open) = scene.left_open(material, hit) {
        beyond.transmittance = Vec3A::splat(open) + beyond.transmittance * (1.0 - open);
    }
    beyond
}

/// What the denoiser and the networks are told of the ray that meets `hit`: the first surface that is not clear and smooth,
/// coloured by those before it. Where there is none, it is the colour of what is looked through, with the normal of its first
/// surface.
#[inline(always)]
pub(crate) fn first_hit<F: Features>(scene: &RenderScene, ray: &Ray, hit: &Hit, cone: Cone, scratch: &mut Scratch) -> FirstHit {
    if F::FULL && scene.features().blended {
        return composite::<F>(scene, ray, hit, cone, scratch);
    }
    layer::<F>(scene, ray, hit, cone, scratch)
}

#[inline(always)]
fn layer<F: Features>(scene: &RenderScene, ray: &Ray, hit: &Hit, cone: Cone, scratch: &mut Scratch) -> FirstHit {
    if !F::CLEAR || scene.materials[scene.geometry.material(hit)].clear == Clear::No {
        return Interaction::guide::<F>(scene, ray, hit, cone);
    }
    look_through::<F>(scene, *ray, *hit, cone, (false, scratch)).0
}

/// The mean over all chances of what a ray through blended surfaces meets, where it meets something; `met` is what it met by
/// chance. Without this, guides would be as noisy as the picture.
#[inline(never)]
fn composite<F: Features>(scene: &RenderScene, ray: &Ray, met: &Hit, mut cone: Cone, scratch: &mut Scratch) -> FirstHit {
    let (start, first_cone) = (ray, cone);
    let (mut ray, mut left) = (*ray, 1.0);
    let mut sum = FirstHit { albedo: Vec3A::ZERO, ns: Vec3A::ZERO };
    for _ in 0..MOST_LAYERS {
        let Some((hit, covered)) = scene.trace_layer(&ray, scratch) else { break };
        let seen = layer::<F>(scene, &ray, &hit, cone, scratch);
        sum.albedo += seen.albedo * (left * covered);
        sum.ns += seen.ns * (left * covered);
        left *= 1.0 - covered;
        if left < LEAST_SHARE {
            break;
        }
        cone = cone.at(hit.t);
        ray = scene.geometry.behind(&hit, ray.direction);
    }
    if left > 1.0 - LEAST_SHARE {
        return layer::<F>(scene, start, met, first_cone, scratch);
    }
    FirstHit { albedo: sum.albedo / (1.0 - left), ns: sum.ns / (1.0 - left) }
}

/// The first surface that shows itself behind clear and smooth ones, along the way that most of the light takes, and what is seen
/// through all of them. The flag says whether the ray is one to a pixel's centre.
#[inline(never)]
fn look_through<F: Features>(
    scene: &RenderScene,
    mut ray: Ray,
    mut hit: Hit,
    mut cone: Cone,
    (centre, scratch): (bool, &mut Scratch),
) -> (FirstHit, Beyond) {
    let mut seen = FirstHit { albedo: Vec3A::ONE, ns: Vec3A::ZERO };
    let mut shown = None;
    let mut beyond = Beyond { transmittance: Vec3A::ONE, direction: Vec3A::ZERO };
    let mut medium = Medium::AIR;
    for _ in 0..MOST_LOOKED_THROUGH {
        let surface = Interaction::new::<F>(scene, &ray, &hit, cone);
        let clear = scene.materials[surface.material].clear;
        if seen.ns == Vec3A::ZERO {
            seen.ns = surface.ns;
        }
        let absorbed = medium.over(hit.t);
        seen.albedo *= absorbed;
        beyond.transmittance *= absorbed;
        let Principled { base_color, specular, roughness, transmission, metallic, .. } = surface.surface;
        let share = transmission * (1.0 - metallic);
        if shown.is_none() && (clear == Clear::No || roughness > SHOWN_ROUGHNESS || share < 0.5) {
            shown = Some(FirstHit { albedo: seen.albedo * base_color, ns: surface.ns });
        }
        if clear == Clear::No || shown.is_some() && !centre {
            break;
        }
        seen.albedo *= base_color;
        let cos = -ray.direction.dot(surface.ns);
        let (direction, passed) = match surface.side {
            Side::Sheet | Side::Pane => (ray.direction, base_color * pane_transmittance(specular, cos)),
            side => {
                let index = refraction_index(specular);
                let eta = if side == Side::Inside { index } else { 1.0 / index };
                let rest = 1.0 - eta * eta * (1.0 - cos * cos);
                if rest < 0.0 {
                    (ray.direction + 2.0 * cos * surface.ns, Vec3A::ONE)
                } else {
                    let bent = eta * ray.direction + (eta * cos - rest.sqrt()) * surface.ns;
                    (bent, base_color * (1.0 - fresnel(cos.clamp(1e-4, 1.0), 1.0 / eta)))
                }
            }
        };
        let direction = direction.normalize_or(ray.direction);
        beyond.transmittance *= share * passed;
        medium = medium.along(scene, &surface, direction);
        cone = cone.at(hit.t);
        ray = surface.spawn_either(direction);
        let next = if centre { scene.trace_centre(&ray, scratch) } else { scene.trace::<F>(&ray, scratch) };
        let Some(next) = next else {
            beyond.direction = direction;
            break;
        };
        hit = next;
    }
    (shown.unwrap_or(seen), beyond)
}
