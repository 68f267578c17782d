//! A point on a surface, ready for shading.

use crate::accel::Hit;
use crate::compile::RenderScene;
use crate::features::Features;
use crate::material::Surface;
use crate::ray::Ray;
use crate::texture::Lookup;
use glam::{Vec2, Vec3A};
use renderflow_scenes::TextureSlot;

/// Smallest cosine between the shading normal and the viewer; a shading normal below is bent up to it.
const MIN_COS_VIEW: f32 = 1e-3;
/// New rays start this far off the surface, as a share of the largest coordinate of the triangle's corners: sixteen roundings of a
/// number of that size, while interpolating a point and testing a triangle take fewer. There is no absolute length in it.
const OFFSET: f32 = 16.0 * f32::EPSILON;

/// A surface point seen from `wo`; both normals are on the viewer's side.
#[derive(Clone, Copy, Debug)]
pub struct Interaction {
    /// World-space position, metres.
    pub p: Vec3A,
    /// Unit geometric normal.
    pub n: Vec3A,
    /// Unit shading normal (interpolated, mapped); `ns . wo > 0`.
    pub ns: Vec3A,
    /// Material at this point.
    pub surface: Surface,
    /// Index of the instance.
    pub instance: u32,
    offset: f32,
}

impl Interaction {
    /// Shading point of `hit` on `ray`.
    #[inline]
    pub(crate) fn new<F: Features>(scene: &RenderScene, ray: &Ray, hit: &Hit) -> Self {
        let wo = -ray.direction;
        let corners = scene.accel.corners(hit);
        let [b0, b1, b2] = hit.weights;
        let triangle = &scene.triangles[hit.primitive as usize];
        let instance = &scene.placed[triangle.instance as usize];
        let material = &scene.materials[instance.material];

        // Interpolated, not `ray.at(t)`: the error then depends on the triangle alone, not on how far away the ray began.
        let p = corners[0] * b0 + corners[1] * b1 + corners[2] * b2;
        let mut n = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(wo);
        let offset = OFFSET * corners.iter().fold(Vec3A::ZERO, |m, c| m.max(c.abs())).max_element();

        // Surfaces are two-sided: turn both normals to the viewer, the shading normal by the side the geometric one says.
        let mut ns = if instance.smooth {
            let [a, b, c] = triangle.vertices.map(|v| Vec3A::from_array(scene.normals[v as usize]));
            (a * b0 + b * b1 + c * b2).try_normalize().unwrap_or(n)
        } else {
            n
        };
        if n.dot(wo) < 0.0 {
            n = -n;
        }
        let side = if ns.dot(n) < 0.0 { -1.0 } else { 1.0 };

        let uv = if F::TEXTURES && !scene.uvs.is_empty() {
            let [a, b, c] = triangle.vertices.map(|v| Vec2::from_array(scene.uvs[v as usize]));
            a * b0 + b * b1 + c * b2
        } else {
            Vec2::ZERO
        };
        let texture =
            |slot: &TextureSlot| scene.textures[slot.texture].value(slot, Lookup { uv, footprint_log2: f32::NEG_INFINITY });
        if F::NORMAL_MAPS
            && instance.tangents
            && let Some((slot, strength)) = &material.normal_texture
        {
            let [a, b, c] = triangle.vertices.map(|v| scene.tangents[v as usize]);
            let tangent = [0, 1, 2].map(|k| a[k] * b0 + b[k] * b1 + c[k] * b2);
            let handedness = if a[3] * b0 + b[3] * b1 + c[3] * b2 < 0.0 { -1.0 } else { 1.0 };
            ns = map_normal(ns, Vec3A::from_array(tangent), handedness, Vec3A::from_vec4(texture(slot)), *strength);
        }
        let ns = face_viewer(ns * side, n, wo);

        let mut surface = material.surface;
        if F::TEXTURES {
            if let Some(slot) = &material.base_color_texture {
                surface.base_color *= Vec3A::from_vec4(texture(slot));
                surface.base_color = surface.base_color.clamp(Vec3A::ZERO, Vec3A::ONE);
            }
            if let Some(slot) = &material.metallic_roughness_texture {
                let value = texture(slot);
                surface.roughness = (surface.roughness * value.y).clamp(0.0, 1.0);
                surface.metallic = (surface.metallic * value.z).clamp(0.0, 1.0);
            }
        }
        Self { p, n, ns, surface, instance: triangle.instance, offset }
    }

    /// A ray that leaves the surface on the viewer's side.
    #[inline]
    pub fn spawn(&self, direction: Vec3A) -> Ray {
        Ray::new(self.p + self.n * self.offset, direction)
    }
}

/// Applies a tangent-space normal `value` (-1..=1) with `strength` on its x and y, as glTF defines it. Falls back to `ns` where the
/// tangent is parallel to it.
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
