//! A point on a surface, ready for shading.

use crate::accel::Hit;
use crate::compile::RenderScene;
use crate::features::Features;
use crate::film::FirstHit;
use crate::geometry::Geometry;
use crate::light::Receiver;
use crate::material::{Principled, Side};
use crate::number::log2;
use crate::ray::Ray;
use crate::texture::Lookup;
use glam::{Vec2, Vec3A};
use renderflow_frame::Camera;
use renderflow_scenes::TextureSlot;

/// Smallest cosine between the shading normal and the viewer; a shading normal below is bent up to it.
const MIN_COS_VIEW: f32 = 1e-3;

/// The footprint of a ray: a cone that covers a sample's share of a pixel or of a lobe. Textures are looked up at the width of
/// the cone at the hit (Akenine-Moller et al. 2021, "Improved Shader and Texture Level of Detail Using Ray Cones").
#[derive(Clone, Copy, Debug, Default)]
pub struct Cone {
    /// Width at the origin of the ray, metres.
    width: f32,
    /// Growth of the width, metres a metre.
    spread: f32,
}

impl Cone {
    /// The cone of one of `samples` camera rays of a pixel, which covers that share of the pixel's area.
    pub fn camera(camera: &Camera, samples: u32) -> Self {
        Self { width: 0.0, spread: 1.0 / (camera.fl_y * (samples.max(1) as f32).sqrt()) }
    }

    /// After scattering with density `pdf` (per steradian), one of `samples`: each stands for a solid angle of `1 / (pdf
    /// samples)`.
    #[inline(always)]
    pub fn scattered(self, pdf: f32, samples: u32) -> Self {
        let own = (pdf * samples.max(1) as f32).sqrt().recip();
        Self { width: self.width, spread: self.spread + own.min(1.0) }
    }

    /// The cone after `t` metres.
    #[inline(always)]
    pub fn at(self, t: f32) -> Self {
        Self { width: self.width + self.spread * t, ..self }
    }
}

/// A surface point seen from `wo`; both normals are on the viewer's side.
#[derive(Clone, Copy, Debug)]
pub struct Interaction {
    /// Position relative to the scene's origin, metres.
    pub p: Vec3A,
    /// Unit geometric normal.
    pub n: Vec3A,
    /// Unit shading normal (interpolated, mapped); `ns . wo > 0`.
    pub ns: Vec3A,
    /// Direction of anisotropy in the surface, not perpendicular to `ns`, not unit; zero where there is no anisotropy.
    pub tangent: Vec3A,
    /// Material at this point.
    pub surface: Principled,
    /// Its index among the scene's.
    pub material: usize,
    /// Radiance emitted towards `wo`.
    pub emitted: Vec3A,
    /// The emitter it is, where light sampling can find it.
    pub emitter: Option<u32>,
    /// What the surface is to the viewer if light passes it.
    pub side: Side,
    /// Whether it is the front, from which corners run counter-clockwise, that is seen.
    pub front: bool,
    /// Index of the instance.
    pub instance: u32,
    /// The cone that arrived, at its width here.
    pub cone: Cone,
    offset: f32,
}

impl Interaction {
    /// Shading point of `hit` on `ray`, whose cone at its origin is `cone`.
    #[inline(always)]
    pub(crate) fn new<F: Features>(scene: &RenderScene, ray: &Ray, hit: &Hit, cone: Cone) -> Self {
        Self::at::<F, true>(scene, ray, hit, cone)
    }

    /// The guides' values of the point that [`Self::new`] makes; nothing else is looked up.
    #[inline(always)]
    pub(crate) fn guide<F: Features>(scene: &RenderScene, ray: &Ray, hit: &Hit, cone: Cone) -> FirstHit {
        let point = Self::at::<F, false>(scene, ray, hit, cone);
        FirstHit { albedo: point.surface.base_color, ns: point.ns }
    }

    /// The unit shading normal at `hit`, on the viewer's side, without the normal map.
    #[inline(always)]
    pub(crate) fn smooth_normal(scene: &RenderScene, ray: &Ray, hit: &Hit) -> Vec3A {
        let geometry = &scene.geometry;
        let wo = -ray.direction;
        let n = geometry.surface(hit).n;
        let ns = geometry.shading_normal(hit).unwrap_or(n);
        let n = if n.dot(wo) >= 0.0 { n } else { -n };
        face_viewer(if ns.dot(n) < 0.0 { -ns } else { ns }, n, wo)
    }

    /// The point; its roughness, metallic and emission only if `WHOLE`.
    #[inline(always)]
    fn at<F: Features, const WHOLE: bool>(scene: &RenderScene, ray: &Ray, hit: &Hit, cone: Cone) -> Self {
        let wo = -ray.direction;
        let geometry = &scene.geometry;
        let point = geometry.surface(hit);
        let material = &scene.materials[point.material];

        // Turn both normals to the viewer, the shading normal by the side the geometric one says.
        let mut n = point.n;
        let mut ns = geometry.shading_normal(hit).unwrap_or(n);
        let front = n.dot(wo) >= 0.0;
        if !front {
            n = -n;
        }
        let side = if ns.dot(n) < 0.0 { -1.0 } else { 1.0 };

        let cone = if F::TEXTURES { cone.at(hit.t) } else { cone };
        // Area of the footprint: the cone's, seen at a slant; in texture coordinates by the ratio of the triangle's areas.
        let across = || {
            let across = (point.corners[1] - point.corners[0]).cross(point.corners[2] - point.corners[0]).length();
            across * n.dot(wo).max(MIN_COS_VIEW)
        };
        let lookup = if F::TEXTURES { lookup(geometry.corner_uvs(hit), hit.weights, across(), cone) } else { Lookup::NOWHERE };
        let mut place = None;
        let mut texture = |slot: &TextureSlot| {
            let texture = &scene.textures[slot.texture];
            let place = match &mut place {
                Some(place) if material.same_places => place,
                place => {
                    let lookup = if slot.set == 0 { lookup } else { further_lookup(geometry, hit, slot.set, across(), cone) };
                    place.insert(texture.place(slot, lookup))
                }
            };
            texture.read::<false>(place)
        };
        if F::TEXTURES
            && let Some((slot, strength)) = &material.normal_texture
            && let Some((tangent, handedness)) = geometry.tangent(hit)
        {
            ns = map_normal(ns, tangent, handedness, Vec3A::from_vec4(texture(slot)), *strength);
        }
        let mut surface = material.surface;
        let mut tangent = Vec3A::ZERO;
        if WHOLE && F::FULL && surface.anisotropic > 0.0 {
            match geometry.tangent(hit) {
                Some((direction, handedness)) => tangent = turned(direction, ns, handedness, material.anisotropy_rotation),
                // No direction is better than another. The BSDF is then made here: see `CompiledMaterial::prepared`.
                None => surface.anisotropic = 0.0,
            }
        }
        let ns = face_viewer(ns * side, n, wo);

        if F::TEXTURES {
            if let Some(slot) = &material.base_color_texture {
                surface.base_color *= Vec3A::from_vec4(texture(slot));
                surface.base_color = surface.base_color.clamp(Vec3A::ZERO, Vec3A::ONE);
            }
            if material.has_colors() {
                surface.base_color *= Vec3A::from_vec4(geometry.color(hit)).clamp(Vec3A::ZERO, Vec3A::ONE);
            }
            if WHOLE && let Some(slot) = &material.metallic_roughness_texture {
                let value = texture(slot);
                surface.roughness = (surface.roughness * value.y).clamp(0.0, 1.0);
                surface.metallic = (surface.metallic * value.z).clamp(0.0, 1.0);
            }
        }
        if F::CLEAR
            && F::TEXTURES
            && WHOLE
            && let Some(slot) = &material.transmission_texture
        {
            surface.transmission = (surface.transmission * texture(slot).x).clamp(0.0, 1.0);
        }
        let (mut emitted, mut emitter) = (Vec3A::ZERO, None);
        if WHOLE && F::FULL && material.emissive != Vec3A::ZERO && (front || material.double_sided) {
            emitted = scene.emission(material, |set| if set == 0 { lookup.uv } else { geometry.uv(hit, set) });
            emitter = scene.emitter_id(point.instance, point.triangle);
        }
        Self {
            p: point.p,
            n,
            ns,
            tangent,
            surface,
            material: point.material,
            emitted,
            emitter,
            side: if F::CLEAR { material.side(front) } else { Side::Outside },
            front,
            instance: point.instance,
            cone,
            offset: point.offset,
        }
    }

    /// The point as light samples are drawn for it.
    #[inline(always)]
    pub fn receiver<F: Features>(&self) -> Receiver {
        let clear = F::CLEAR && self.surface.transmission > 0.0;
        Receiver { p: self.p, n: if clear { Vec3A::ZERO } else { self.n } }
    }

    /// A ray that leaves the surface on the viewer's side.
    #[inline(always)]
    pub fn spawn(&self, direction: Vec3A) -> Ray {
        Ray::leaving(self.p, self.n, self.offset, direction)
    }

    /// A ray that leaves the surface on the side of `direction`.
    #[inline(always)]
    pub fn spawn_either(&self, direction: Vec3A) -> Ray {
        let n = if self.n.dot(direction) < 0.0 { -self.n } else { self.n };
        Ray::leaving(self.p, n, self.offset, direction)
    }

    /// A point at the origin with the given normals and material.
    #[cfg(test)]
    pub(crate) fn for_tests(n: Vec3A, ns: Vec3A, surface: Principled) -> Self {
        let (p, tangent, emitted) = (Vec3A::ZERO, Vec3A::ZERO, Vec3A::ZERO);
        Self {
            p,
            n,
            ns,
            tangent,
            surface,
            material: 0,
            emitted,
            emitter: None,
            side: Side::Outside,
            front: true,
            instance: 0,
            cone: Cone::default(),
            offset: 0.0,
        }
    }
}

/// The look-up of a point with `weights` of the corners, whose texture coordinates are `a`, `b` and `c`; `across` is twice the
/// triangle's area as it is seen, square metres.
#[inline(always)]
fn lookup([a, b, c]: [Vec2; 3], weights: [f32; 3], across: f32, cone: Cone) -> Lookup {
    let density = (b - a).perp_dot(c - a).abs() / across;
    let uv = a * weights[0] + b * weights[1] + c * weights[2];
    Lookup { uv, footprint_log2: log2(cone.width) + 0.5 * log2(density) }
}

/// [`lookup`] in another set than the first. Out of line, so that look-ups in the first keep the smaller loop.
#[cold]
#[inline(never)]
fn further_lookup(geometry: &Geometry, hit: &Hit, set: usize, across: f32, cone: Cone) -> Lookup {
    lookup(geometry.further_uvs(hit, set), hit.weights, across, cone)
}

/// A tangent turned about `ns` by `angle`, radians, counter-clockwise towards the bitangent, which is glTF's.
#[inline(always)]
fn turned(tangent: Vec3A, ns: Vec3A, handedness: f32, angle: f32) -> Vec3A {
    if angle == 0.0 {
        return tangent;
    }
    tangent * angle.cos() + ns.cross(tangent) * (handedness * angle.sin())
}

/// Applies a tangent-space normal `value` (-1..=1) with `strength` on its x and y, as glTF defines it. Falls back to `ns` where
/// the tangent is parallel to it.
fn map_normal(ns: Vec3A, tangent: Vec3A, handedness: f32, value: Vec3A, strength: f32) -> Vec3A {
    let Some(t) = (tangent - ns * ns.dot(tangent)).try_normalize() else { return ns };
    let b = ns.cross(t) * handedness;
    (t * (value.x * strength) + b * (value.y * strength) + ns * value.z).try_normalize().unwrap_or(ns)
}

/// Bends a shading normal that faces away from the viewer until the viewer stands just above its horizon. Without it such points
/// would be black; bending (instead of the geometric normal) keeps the shading continuous across the place where it starts.
fn face_viewer(ns: Vec3A, n: Vec3A, wo: Vec3A) -> Vec3A {
    let cos = ns.dot(wo);
    if cos >= MIN_COS_VIEW {
        return ns;
    }
    let bent = (ns + wo * (MIN_COS_VIEW - cos)).normalize_or(n);
    // Normalising can lose the last bit, and `ns` opposite to `wo` leaves nothing to bend.
    if bent.dot(wo) > 0.0 { bent } else { wo }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bent_normals_face_the_viewer_and_bend_continuously() {
        let wo = Vec3A::new(0.6, 0.0, 0.8);
        let tangent = Vec3A::new(0.8, 0.0, -0.6);
        let mut previous = None::<Vec3A>;
        for i in 0..=2000 {
            let angle = i as f32 / 2000.0 * std::f32::consts::PI;
            let ns = wo * angle.cos() + tangent * angle.sin();
            let bent = face_viewer(ns, Vec3A::Z, wo);
            assert!(bent.dot(wo) > 0.0 && (bent.length() - 1.0).abs() < 1e-5, "{angle}");
            if angle < 3.0 {
                assert!(previous.is_none_or(|p| p.distance(bent) < 0.02), "jump at {angle}");
            }
            previous = Some(bent);
        }
    }

    #[test]
    fn flat_normal_map_changes_nothing_and_x_leans_along_the_tangent() {
        let ns = Vec3A::new(0.0, 0.6, 0.8);
        assert!(map_normal(ns, Vec3A::X, 1.0, Vec3A::Z, 1.0).distance(ns) < 1e-6);
        let leaning = map_normal(ns, Vec3A::X, 1.0, Vec3A::new(0.6, 0.0, 0.8), 1.0);
        assert!((leaning.dot(Vec3A::X) - 0.6).abs() < 1e-6);
        let up = map_normal(ns, Vec3A::X, -1.0, Vec3A::new(0.0, 0.6, 0.8), 1.0);
        assert!((up.dot(ns.cross(Vec3A::X)) + 0.6).abs() < 1e-6);
    }
}
