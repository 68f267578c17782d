//! Welded triangle meshes: surfaces are built from closed pieces whose shared points become one vertex, then normals are found.

use crate::Mesh;
use glam::{DVec2, DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// Hash by multiplication: the keys are our own lattice points, so nobody can make them collide. Halves the time of a mesh.
type FastHash = BuildHasherDefault<Multiply>;

#[derive(Default)]
struct Multiply(u64);

impl Hasher for Multiply {
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }
    fn write_u32(&mut self, word: u32) {
        self.write_u64(u64::from(word));
    }
    fn write_u64(&mut self, word: u64) {
        self.0 = (self.0.rotate_left(23) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 29)
    }
}

/// A mesh under construction. Points closer than about a micrometre are one vertex, so seams and poles close by themselves.
#[derive(Default)]
pub(super) struct Builder {
    points: Vec<DVec3>,
    cells: HashMap<[i64; 3], u32, FastHash>,
    triangles: Vec<[u32; 3]>,
    uvs: Vec<[DVec2; 3]>,
}

impl Builder {
    /// Index of the vertex at `p`.
    pub fn point(&mut self, p: DVec3) -> u32 {
        // The odd offset keeps round coordinates (0, 0.5, ...) away from cell borders, where rounding noise would split a vertex.
        let key = (p * f64::from(1u32 << 20) + 0.137_19).round();
        let next = self.points.len() as u32;
        let points = &mut self.points;
        *self.cells.entry([key.x as i64, key.y as i64, key.z as i64]).or_insert_with(|| {
            points.push(p);
            next
        })
    }

    /// One triangle, counter-clockwise seen from outside; nothing when two corners are the same vertex.
    pub fn triangle(&mut self, corners: [(DVec3, DVec2); 3]) {
        let index = corners.map(|c| self.point(c.0));
        if index[0] != index[1] && index[1] != index[2] && index[2] != index[0] {
            self.triangles.push(index);
            self.uvs.push(corners.map(|c| c.1));
        }
    }

    /// A planar or bent quadrilateral, split along its shorter diagonal.
    pub fn quad(&mut self, [a, b, c, d]: [(DVec3, DVec2); 4]) {
        if a.0.distance_squared(c.0) <= b.0.distance_squared(d.0) {
            self.triangle([a, b, c]);
            self.triangle([a, c, d]);
        } else {
            self.triangle([b, c, d]);
            self.triangle([b, d, a]);
        }
    }

    /// The surface `f(u, v)` over the unit square in `nu x nv` cells; outward is du x dv.
    pub fn grid(&mut self, nu: usize, nv: usize, repeat: [f64; 2], f: impl Fn(f64, f64) -> DVec3) {
        let corner = |i: usize, j: usize| {
            let (u, v) = (i as f64 / nu as f64, j as f64 / nv as f64);
            // Texture rows run down.
            (f(u, v), DVec2::new(u * repeat[0], (1.0 - v) * repeat[1]))
        };
        for j in 0..nv {
            for i in 0..nu {
                self.quad([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)]);
            }
        }
    }

    /// Surface of revolution about +Y of the polyline `profile` of (radius, height), which runs from the bottom outwards and up
    /// (and down again inside, if hollow). It is closed when it starts and ends on the axis or at the same point.
    pub fn lathe(&mut self, profile: &[DVec2], segments: usize) {
        let mut length = vec![0.0];
        for pair in profile.windows(2) {
            length.push(length[length.len() - 1] + pair[0].distance(pair[1]));
        }
        let total = length[length.len() - 1].max(1e-9);
        for j in 0..profile.len() - 1 {
            for i in 0..segments {
                let corner = |i: usize, j: usize| {
                    let u = i as f64 / segments as f64;
                    let (sin, cos) = (u * std::f64::consts::TAU).sin_cos();
                    let p = profile[j];
                    (DVec3::new(p.x * sin, p.y, p.x * cos), DVec2::new(u, 1.0 - length[j] / total))
                };
                self.quad([corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)]);
            }
        }
    }

    /// A plane region (triangles counter-clockwise in x, y) drawn out along z through `layers` of (z, map of the plane).
    pub fn extrude(&mut self, region: &[[DVec2; 3]], layers: &[(f64, &dyn Fn(DVec2) -> DVec2)]) {
        let lift = |p: DVec2, layer: usize| {
            let q = layers[layer].1(p);
            DVec3::new(q.x, q.y, layers[layer].0)
        };
        let (first, last) = (0, layers.len() - 1);
        for &[a, b, c] in region {
            let uv = |p: DVec2| DVec2::new(p.x, -p.y);
            self.triangle([(lift(a, last), uv(a)), (lift(b, last), uv(b)), (lift(c, last), uv(c))]);
            self.triangle([(lift(a, first), uv(a)), (lift(c, first), uv(c)), (lift(b, first), uv(b))]);
        }
        // An edge walked once is on the rim; its outside is to the right.
        let key = |p: DVec2| ((p.x * 1e6).round() as i64, (p.y * 1e6).round() as i64);
        let edges = || region.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let walked: std::collections::HashSet<_> = edges().map(|(a, b)| (key(a), key(b))).collect();
        for (a, b) in edges().filter(|&(a, b)| !walked.contains(&(key(b), key(a)))) {
            let width = a.distance(b);
            for layer in 0..last {
                let (z0, z1) = (layers[layer].0, layers[layer + 1].0);
                self.quad([
                    (lift(a, layer), DVec2::new(0.0, -z0)),
                    (lift(b, layer), DVec2::new(width, -z0)),
                    (lift(b, layer + 1), DVec2::new(width, -z1)),
                    (lift(a, layer + 1), DVec2::new(0.0, -z1)),
                ]);
            }
        }
    }

    /// Turns what stands along +Z to stand along +Y.
    pub fn turn_z_to_y(&mut self) {
        for p in &mut self.points {
            *p = DVec3::new(p.x, p.z, -p.y);
        }
        self.cells.clear();
    }

    /// Adds the triangles of `other` (its points stay its own).
    pub fn absorb(&mut self, other: Self) {
        let base = self.points.len() as u32;
        self.points.extend(other.points);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + base)));
        self.uvs.extend(other.uvs);
    }

    /// Adds the triangles of `other`, whose points on ours become ours.
    pub fn weld(&mut self, other: Self) {
        let index: Vec<u32> = other.points.iter().map(|&p| self.point(p)).collect();
        for (t, uv) in other.triangles.iter().zip(other.uvs) {
            self.face(t.map(|i| index[i as usize]), uv);
        }
    }

    /// How many triangles there are.
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Where a vertex is.
    pub fn position(&self, vertex: u32) -> DVec3 {
        self.points[vertex as usize]
    }

    /// A new vertex at `p`, welded to nothing.
    pub fn vertex(&mut self, p: DVec3) -> u32 {
        self.points.push(p);
        self.points.len() as u32 - 1
    }

    /// A triangle of vertices made before; nothing when two of them are the same.
    pub fn face(&mut self, t: [u32; 3], uv: [DVec2; 3]) {
        if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
            self.triangles.push(t);
            self.uvs.push(uv);
        }
    }

    /// Moves every point.
    pub fn map_points(&mut self, map: impl Fn(DVec3) -> DVec3) {
        self.points.iter_mut().for_each(|p| *p = map(*p));
        self.cells.clear();
    }

    /// Lowest and highest corner of the bounding box of all points; zeros without points.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        if self.points.is_empty() {
            return (DVec3::ZERO, DVec3::ZERO);
        }
        self.points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)))
    }

    /// Scales so that the largest extent is `size`.
    pub fn fit(&mut self, size: f64) {
        let (low, high) = self.bounds();
        let scale = size / (high - low).max_element().max(1e-12);
        self.map_points(|p| (p - low) * scale);
    }

    /// Keeps the connected piece of the largest volume alone: no crumbs in the air, no bubbles inside.
    pub fn keep_largest(&mut self) {
        let mut root: Vec<u32> = (0..self.points.len() as u32).collect();
        fn find(root: &mut [u32], mut i: u32) -> u32 {
            while root[i as usize] != i {
                root[i as usize] = root[root[i as usize] as usize];
                i = root[i as usize];
            }
            i
        }
        for t in &self.triangles {
            let a = find(&mut root, t[0]);
            for &other in &t[1..] {
                let b = find(&mut root, other);
                root[b as usize] = a;
            }
        }
        let mut volume = vec![0.0; self.points.len()];
        let mut used = vec![false; self.points.len()];
        for t in &self.triangles {
            let [a, b, c] = t.map(|i| self.points[i as usize]);
            volume[find(&mut root, t[0]) as usize] += a.dot(b.cross(c));
            t.iter().for_each(|&i| used[i as usize] = true);
        }
        let best = (0..volume.len()).max_by(|&a, &b| volume[a].total_cmp(&volume[b]));
        let Some(best) = best.map(|b| find(&mut root, b as u32)) else { return };
        let mut kept = Self::default();
        let mut index = vec![u32::MAX; self.points.len()];
        for i in 0..self.points.len() {
            if used[i] && find(&mut root, i as u32) == best {
                index[i] = kept.vertex(self.points[i]);
            }
        }
        for (t, &uv) in self.triangles.iter().zip(&self.uvs) {
            if index[t[0] as usize] != u32::MAX {
                kept.face(t.map(|i| index[i as usize]), uv);
            }
        }
        *self = kept;
    }

    /// A round tube about the polyline `path`; open paths get flat caps.
    pub fn sweep(&mut self, path: &[DVec3], closed: bool, radius: f64, sides: usize, repeat: f64) {
        let n = path.len();
        let rings = if closed { n + 1 } else { n };
        let tangent = |i: usize| {
            let (before, after) = if closed { ((i + n - 1) % n, (i + 1) % n) } else { (i.saturating_sub(1), (i + 1).min(n - 1)) };
            (path[after] - path[before]).normalize_or(DVec3::Y)
        };
        // Parallel transport: each frame is the last one made perpendicular to the new tangent.
        let mut normals = vec![tangent(0).any_orthonormal_vector()];
        for i in 1..rings {
            let t = tangent(i % n);
            let last = normals[i - 1];
            normals.push((last - t * last.dot(t)).normalize_or(t.any_orthonormal_vector()));
        }
        // A closed path comes back turned; spread that turn over its length.
        let turn = if closed {
            let (a, b, t) = (normals[0], normals[n], tangent(0));
            b.cross(a).dot(t).atan2(b.dot(a))
        } else {
            0.0
        };
        let ring = |i: usize, k: usize| {
            let t = tangent(i % n);
            let (a, b) = (normals[i], t.cross(normals[i]));
            let angle = std::f64::consts::TAU * k as f64 / sides as f64 + turn * i as f64 / n as f64;
            path[i % n] + radius * (a * angle.cos() + b * angle.sin())
        };
        let uv = |i: usize, k: usize| DVec2::new(k as f64 / sides as f64, (1.0 - i as f64 / (rings - 1) as f64) * repeat);
        for i in 0..rings - 1 {
            for k in 0..sides {
                let corner = |i, k| (ring(i, k), uv(i, k));
                self.quad([corner(i, k), corner(i, k + 1), corner(i + 1, k + 1), corner(i + 1, k)]);
            }
        }
        if !closed {
            for k in 0..sides {
                let flat = |k: usize| {
                    let (sin, cos) = (std::f64::consts::TAU * k as f64 / sides as f64).sin_cos();
                    DVec2::new(0.5 + 0.5 * cos, 0.5 + 0.5 * sin)
                };
                let centre = DVec2::splat(0.5);
                self.triangle([(path[0], centre), (ring(0, k + 1), flat(k + 1)), (ring(0, k), flat(k))]);
                self.triangle([(path[n - 1], centre), (ring(n - 1, k), flat(k)), (ring(n - 1, k + 1), flat(k + 1))]);
            }
        }
    }

    /// Middle of the bounding box.
    fn centre(&self) -> DVec3 {
        let low = self.points.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = self.points.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        if self.points.is_empty() { DVec3::ZERO } else { 0.5 * (low + high) }
    }

    /// The points of the finished mesh alone, each once.
    pub fn finish_points(self) -> Vec<Vec3> {
        let centre = self.centre();
        self.points.iter().map(|&p| (p - centre).as_vec3()).collect()
    }

    /// The finished mesh, centred on its bounding box. Faces that meet at less than `crease` degrees share smooth normals.
    pub fn finish(self, name: &str, crease: f64) -> Mesh {
        let face: Vec<DVec3> = self.triangles.iter().map(|t| self.area_vector(t).normalize_or_zero()).collect();
        // Corners around each vertex, as (triangle, angle of the triangle there); the angle as weight makes normals independent
        // of how faces are split.
        let mut around: Vec<Vec<(u32, f64)>> = vec![Vec::new(); self.points.len()];
        for (index, corners) in self.triangles.iter().enumerate() {
            for k in 0..3 {
                around[corners[k] as usize].push((index as u32, self.angle(index, k)));
            }
        }
        let centre = self.centre();

        let limit = crease.to_radians().cos();
        let mut mesh = Mesh { name: name.into(), ..Mesh::default() };
        let mut made: HashMap<(u32, [u32; 3], [u32; 2]), u32, FastHash> = HashMap::default();
        for (index, corners) in self.triangles.iter().enumerate() {
            let mut out = [0; 3];
            for k in 0..3 {
                let vertex = corners[k];
                let mut sum = DVec3::ZERO;
                for &(other, angle) in &around[vertex as usize] {
                    if face[other as usize].dot(face[index]) >= limit {
                        sum += face[other as usize] * angle;
                    }
                }
                let normal = sum.normalize_or(face[index]).as_vec3().normalize_or(Vec3::Y);
                let uv: Vec2 = self.uvs[index][k].as_vec2();
                // Corners of one vertex become one output vertex when all they carry is equal.
                let rounded = normal.to_array().map(|c| ((c * 4096.0).round() as i32) as u32);
                let next = mesh.positions.len() as u32;
                out[k] = *made.entry((vertex, rounded, uv.to_array().map(f32::to_bits))).or_insert(next);
                if out[k] == next {
                    mesh.positions.push((self.points[vertex as usize] - centre).as_vec3());
                    mesh.normals.push(normal);
                    mesh.uvs.push(uv);
                }
            }
            mesh.triangles.push(out);
        }
        mesh
    }

    fn area_vector(&self, &[a, b, c]: &[u32; 3]) -> DVec3 {
        let [a, b, c] = [a, b, c].map(|i| self.points[i as usize]);
        (b - a).cross(c - a)
    }

    /// Angle of triangle `index` at its corner `k`.
    fn angle(&self, index: usize, k: usize) -> f64 {
        let at = |i: usize| self.points[self.triangles[index][(k + i) % 3] as usize];
        let (e1, e2) = (at(1) - at(0), at(2) - at(0));
        e1.cross(e2).length().atan2(e1.dot(e2))
    }
}
