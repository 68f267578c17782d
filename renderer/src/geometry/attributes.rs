//! What the vertices around a hit have besides their places: normals, texture coordinates, tangents, colours.

use super::{FLATTENED, Geometry, cofactors, interpolate, place_normal, place_tangent};
use crate::accel::Hit;
use glam::{Vec2, Vec3A, Vec4};

impl Geometry {
    /// World-space unit shading normals of the corners (zero where one says nothing), `None` where the mesh has none.
    #[inline(always)]
    pub fn corner_normals(&self, hit: &Hit) -> Option<[Vec3A; 3]> {
        if hit.instance != FLATTENED {
            return self.shared_normals(hit);
        }
        let triangle = &self.triangles[hit.primitive as usize];
        let smooth = self.placed[triangle.instance as usize].smooth;
        smooth.then(|| triangle.vertices.map(|v| Vec3A::from_array(self.normals[v as usize])))
    }

    #[inline(never)]
    fn shared_normals(&self, hit: &Hit) -> Option<[Vec3A; 3]> {
        let (vertices, mesh, placement) = self.shared_vertices(hit)?;
        if mesh.normals.is_empty() {
            return None;
        }
        let cofactors = cofactors(&placement.transform);
        Some(vertices.map(|v| place_normal(&cofactors, mesh.normals[v])))
    }

    /// World-space unit shading normal, interpolated; `None` where the mesh has none or they cancel.
    #[inline(always)]
    pub fn shading_normal(&self, hit: &Hit) -> Option<Vec3A> {
        interpolate(self.corner_normals(hit)?, hit.weights).try_normalize()
    }

    /// Texture coordinates of the corners in the first set; 0 where the mesh has none. Must not be asked for when no material
    /// looks anything up.
    #[inline(always)]
    pub fn corner_uvs(&self, hit: &Hit) -> [Vec2; 3] {
        if hit.instance != FLATTENED {
            return self.shared_uvs(hit, 0);
        }
        let triangle = &self.triangles[hit.primitive as usize];
        triangle.vertices.map(|v| self.uvs.get(v as usize).map_or(Vec2::ZERO, |&uv| Vec2::from_array(uv)))
    }

    #[inline(never)]
    fn shared_uvs(&self, hit: &Hit, set: usize) -> [Vec2; 3] {
        let Some((vertices, mesh, _)) = self.shared_vertices(hit) else { return [Vec2::ZERO; 3] };
        let uvs = mesh.uv_set(set);
        vertices.map(|v| uvs.get(v).copied().unwrap_or(Vec2::ZERO))
    }

    /// [`Self::corner_uvs`] in another set than the first.
    #[inline(never)]
    pub fn further_uvs(&self, hit: &Hit, set: usize) -> [Vec2; 3] {
        if hit.instance != FLATTENED {
            return self.shared_uvs(hit, set);
        }
        let Some(uvs) = set.checked_sub(1).and_then(|further| self.more_uvs.get(further)) else { return [Vec2::ZERO; 3] };
        let triangle = &self.triangles[hit.primitive as usize];
        triangle.vertices.map(|v| uvs.get(v as usize).map_or(Vec2::ZERO, |&uv| Vec2::from_array(uv)))
    }

    /// Texture coordinates of a hit in a set.
    #[inline(always)]
    pub fn uv(&self, hit: &Hit, set: usize) -> Vec2 {
        let [a, b, c] = if set == 0 { self.corner_uvs(hit) } else { self.further_uvs(hit, set) };
        a * hit.weights[0] + b * hit.weights[1] + c * hit.weights[2]
    }

    /// Colour and opacity of the vertices around a hit, interpolated; white where the mesh has none.
    #[inline(never)]
    pub fn color(&self, hit: &Hit) -> Vec4 {
        let corners = if hit.instance == FLATTENED {
            let triangle = &self.triangles[hit.primitive as usize];
            triangle.vertices.map(|v| self.colors.get(v as usize).map_or(Vec4::ONE, |&color| Vec4::from_array(color)))
        } else {
            let Some((vertices, mesh, _)) = self.shared_vertices(hit) else { return Vec4::ONE };
            vertices.map(|v| mesh.colors.get(v).copied().unwrap_or(Vec4::ONE))
        };
        let [a, b, c] = corners;
        a * hit.weights[0] + b * hit.weights[1] + c * hit.weights[2]
    }

    /// World-space tangent of a hit, interpolated but not normalised, and its handedness (1 or -1); `None` where the mesh has
    /// none or its material wants none.
    #[inline(always)]
    pub fn tangent(&self, hit: &Hit) -> Option<(Vec3A, f32)> {
        if !self.placed[self.locate(hit).0 as usize].tangents {
            return None;
        }
        let corners = if hit.instance == FLATTENED {
            self.triangles[hit.primitive as usize].vertices.map(|v| self.tangents[v as usize])
        } else {
            let (vertices, mesh, placement) = self.shared_vertices(hit)?;
            vertices.map(|v| place_tangent(&placement.transform, mesh.tangents[v]))
        };
        let [a, b, c] = corners.map(Vec4::from_array);
        let sum = a * hit.weights[0] + b * hit.weights[1] + c * hit.weights[2];
        Some((Vec3A::from_vec4(sum), if sum.w < 0.0 { -1.0 } else { 1.0 }))
    }
}
