//! Geometry of a scene at one frame: placed triangles, their attributes and the trees over them.
//!
//! Instances are flattened into one world-space tree, which rays query fastest, until that would take too much memory; then the
//! meshes that are used most often get a tree in object space each, shared by their instances (see [`Sharing`]).

mod attributes;
mod flatten;
mod sharing;
mod start;

pub use sharing::Sharing;

use crate::accel::{Accel, Candidate, FLATTENED, Hit, Instances, MAX_COORDINATE, Placement, Scratch};
use crate::ray::Ray;
use flatten::Flattened;
use glam::{Affine3A, DVec3, Vec3, Vec3A, Vec4};
use renderflow_scenes::{Instance, Mesh};
use sharing::{can_share, shared_meshes};
use start::Start;

/// How often each kind of tree was built, or fitted to what moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Builds {
    /// The tree over flattened triangles.
    pub flattened: usize,
    /// That tree, fitted to triangles that moved.
    pub refitted: usize,
    /// Trees of shared meshes, all together.
    pub objects: usize,
    /// The tree over instances of shared meshes.
    pub instances: usize,
}

/// Where a flattened triangle's attributes are.
#[derive(Clone, Copy, Debug)]
struct PlacedTriangle {
    /// Indices into the world-space vertex arrays.
    vertices: [u32; 3],
    instance: u32,
    /// Index into the triangles of the instance's mesh.
    in_mesh: u32,
}

/// What shading needs of an instance.
#[derive(Clone, Copy, Debug)]
struct PlacedInstance {
    material: usize,
    smooth: bool,
    tangents: bool,
}

/// Which attributes the materials of a scene look at.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wanted {
    /// Sets of texture coordinates that some material looks something up with.
    pub uv_sets: usize,
    /// Whether each material needs tangents.
    pub tangents: Vec<bool>,
    /// Whether some mesh has colours.
    pub colors: bool,
}

/// The geometry of a hit; what only some materials need is asked of [`Geometry`] by the same hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfacePoint {
    /// World-space corners, metres relative to the scene's origin.
    pub corners: [Vec3A; 3],
    /// The point, interpolated between them: its error depends on the triangle, not on where the ray began. On an edge it is
    /// drawn into the triangle by twice `offset`.
    pub p: Vec3A,
    /// Unit geometric normal on the side from which the corners run counter-clockwise.
    pub n: Vec3A,
    /// Distance along `n`, metres, that a new ray must start off the surface at least.
    pub offset: f32,
    /// Index into the scene's materials.
    pub material: usize,
    /// Index into the scene's instances.
    pub instance: u32,
    /// Index into the triangles of the instance's mesh; lights that are triangles are found by it.
    pub triangle: u32,
}

/// Placed geometry of a scene at one frame.
pub(crate) struct Geometry {
    /// Tree over the flattened instances.
    flat: Accel,
    /// Trees of the shared meshes and their instances.
    shared: Option<Instances>,
    /// Of each shared tree: its mesh, and the triangles in it (by number in the mesh).
    objects: Vec<(usize, Vec<u32>)>,
    /// The shared tree of each instance, `None` where it is flattened.
    object_of: Vec<Option<u32>>,
    /// One for each triangle of `flat`, in the order given to its builder.
    triangles: Vec<PlacedTriangle>,
    /// World-space unit shading normals of flattened vertices, zero where a mesh has none; empty when no mesh has any.
    normals: Vec<[f32; 3]>,
    /// Of flattened vertices; empty when no material looks anything up.
    uvs: Vec<[f32; 2]>,
    /// The same of each further set.
    more_uvs: Vec<Vec<[f32; 2]>>,
    /// World-space tangents of flattened vertices with handedness; empty when no material needs them.
    tangents: Vec<[f32; 4]>,
    /// Colours of flattened vertices, white where a mesh has none; empty when no mesh has any.
    colors: Vec<[f32; 4]>,
    placed: Vec<PlacedInstance>,
    /// Whether every instance on a material has tangents, by material.
    directed: Vec<bool>,
    pub instances: Vec<Instance>,
    meshes: Vec<Mesh>,
    wanted: Wanted,
    frame: usize,
    flattened: Flattened,
    /// Triangles of shared meshes that are left out.
    dropped: usize,
    builds: Builds,
}

impl Geometry {
    /// Places `instances` of `meshes` at frame 0. Every index must lead somewhere; the scene compiler checks them.
    pub fn new(meshes: Vec<Mesh>, instances: Vec<Instance>, wanted: Wanted, sharing: Sharing) -> Self {
        let shared = shared_meshes(&meshes, &instances, sharing);
        let (mut objects, mut trees) = (Vec::new(), Vec::new());
        let mut builds = Builds::default();
        let mut tree_of = vec![None; meshes.len()];
        for (index, mesh) in meshes.iter().enumerate().filter(|(index, _)| shared[*index]) {
            let (kept, corners): (Vec<u32>, Vec<[Vec3A; 3]>) = mesh
                .triangles
                .iter()
                .zip(0u32..)
                .map(|(triangle, number)| (number, triangle.map(|v| Vec3A::from(mesh.positions[v as usize]))))
                .filter(|(_, corners)| usable(corners))
                .unzip();
            tree_of[index] = Some(objects.len() as u32);
            trees.push(Accel::build(&corners));
            objects.push((index, kept));
            builds.objects += 1;
        }
        let object_of: Vec<Option<u32>> = instances.iter().map(|i| tree_of[i.mesh].filter(|_| can_share(i))).collect();
        let left_out = |&object: &u32| {
            let (mesh, kept): &(usize, Vec<u32>) = &objects[object as usize];
            meshes[*mesh].triangles.len() - kept.len()
        };
        let dropped = object_of.iter().flatten().map(left_out).sum();
        let placed: Vec<PlacedInstance> = instances
            .iter()
            .map(|instance| {
                let mesh = &meshes[instance.mesh];
                let mapped = wanted.tangents[instance.material];
                PlacedInstance {
                    material: instance.material,
                    smooth: !mesh.normals.is_empty(),
                    tangents: mapped && !mesh.tangents.is_empty() && !mesh.uvs.is_empty(),
                }
            })
            .collect();
        let mut directed = vec![true; wanted.tangents.len()];
        placed.iter().for_each(|instance| directed[instance.material] &= instance.tangents);
        let mut geometry = Self {
            flat: Accel::build(&[]),
            shared: None,
            objects,
            object_of,
            triangles: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            more_uvs: vec![Vec::new(); wanted.uv_sets.saturating_sub(1)],
            tangents: Vec::new(),
            colors: Vec::new(),
            placed,
            directed,
            instances,
            meshes,
            wanted,
            frame: 0,
            flattened: Flattened::default(),
            dropped,
            builds,
        };
        geometry.flatten();
        if geometry.object_of.iter().any(Option::is_some) {
            geometry.shared = Some(Instances::new(trees, geometry.placements()));
            geometry.builds.instances += 1;
        }
        geometry
    }

    /// Triangles and vertices that flattening will make: what the world-space tree must be able to hold.
    pub fn flattened_size(meshes: &[Mesh], instances: &[Instance], sharing: Sharing) -> (usize, usize) {
        let shared = shared_meshes(meshes, instances, sharing);
        let flattened = instances.iter().filter(|i| !(shared[i.mesh] && can_share(i))).map(|i| &meshes[i.mesh]);
        flattened.fold((0, 0), |(t, v), mesh| (t + mesh.triangles.len(), v + mesh.positions.len()))
    }

    /// Moves to `frame`. What stands still is left alone, trees of shared meshes are kept.
    pub fn set_frame(&mut self, frame: usize) {
        self.move_flattened(frame);
        let mut shared = self.instances.iter().zip(&self.object_of).filter(|(_, object)| object.is_some());
        let shared = shared.any(|(instance, _)| instance.transform(frame) != instance.transform(self.frame));
        self.frame = frame;
        if shared {
            let placements = self.placements();
            if let Some(instances) = &mut self.shared {
                instances.place(placements);
                self.builds.instances += 1;
            }
        }
    }

    /// Number of triangles in the trees; triangles of shared meshes count once per instance.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len() + self.object_of.iter().flatten().map(|&o| self.objects[o as usize].1.len()).sum::<usize>()
    }

    /// Triangles left out because two corners are equal, or one is not finite or farther than 1e12 m from the origin; those of
    /// shared meshes once an instance.
    pub fn dropped_triangles(&self) -> usize {
        self.dropped + self.flattened.dropped
    }

    /// How often each kind of tree was built.
    pub fn builds(&self) -> Builds {
        self.builds
    }

    /// Bytes of the trees and of what was made for them; the meshes themselves are not counted.
    pub fn memory(&self) -> usize {
        self.flat.memory()
            + self.shared.as_ref().map_or(0, Instances::memory)
            + self.objects.iter().map(|(_, kept)| size_of_val(kept.as_slice())).sum::<usize>()
            + size_of_val(self.triangles.as_slice())
            + size_of_val(self.normals.as_slice())
            + size_of_val(self.uvs.as_slice())
            + self.more_uvs.iter().map(|uvs| size_of_val(uvs.as_slice())).sum::<usize>()
            + size_of_val(self.tangents.as_slice())
            + size_of_val(self.colors.as_slice())
            + self.flattened.memory()
    }

    /// Triangles whose pictures together cover that of everything: those in the world-space tree, and the sides of boxes around
    /// parts of the shared meshes. Of the former only what is in boxes that `open` wants opened; of the others it takes care
    /// itself.
    pub fn cover(&self, open: impl FnMut([Vec3A; 2]) -> bool, mut triangle: impl FnMut([Vec3A; 3])) {
        /// Two triangles a side; corner k has the upper plane of axis a where bit a of k is set.
        const SIDES: [[usize; 3]; 12] = [
            [0, 2, 6],
            [0, 6, 4],
            [1, 3, 7],
            [1, 7, 5],
            [0, 1, 5],
            [0, 5, 4],
            [2, 3, 7],
            [2, 7, 6],
            [0, 1, 3],
            [0, 3, 2],
            [4, 5, 7],
            [4, 7, 6],
        ];
        let parts = self.shared.iter().flat_map(|s| s.placements().iter().flat_map(|p| s.parts(p)));
        parts.flat_map(|corners| SIDES.map(|side| side.map(|k| corners[k]))).for_each(&mut triangle);
        self.flat.walk(open, triangle);
    }

    /// The nearest triangle along `ray`, front or back.
    #[inline]
    pub fn closest(&self, ray: &Ray, scratch: &mut Scratch) -> Option<Hit> {
        let hit = self.flat.closest(ray, scratch);
        match &self.shared {
            None => hit,
            Some(shared) => nearer(shared, ray, scratch, self.before(hit.as_ref())).or(hit),
        }
    }

    /// [`Self::closest`] of each ray, the same hits; several times as fast for rays from one point close to each other, sixteen
    /// at a time (see [`Accel::closest_packet`]). `hits` is as long as `rays`.
    pub fn closest_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>], scratch: &mut Scratch) {
        self.flat.closest_packet(rays, hits, scratch);
        if let Some(shared) = &self.shared {
            for (ray, hit) in rays.iter().zip(hits) {
                *hit = nearer(shared, ray, scratch, self.before(hit.as_ref())).or(*hit);
            }
        }
    }

    /// Distance of a flattened hit, if any, and its instance: of what lies at the same distance the first instance is hit.
    #[inline]
    fn before(&self, hit: Option<&Hit>) -> (f32, u32) {
        hit.map_or((f32::INFINITY, 0), |h| (h.t, self.triangles[h.primitive as usize].instance))
    }

    /// Whether any triangle stands in the way of `ray`.
    #[inline]
    pub fn occluded(&self, ray: &Ray, scratch: &mut Scratch) -> bool {
        self.flat.occluded(ray, scratch) || self.shared.as_ref().is_some_and(|shared| blocked(shared, ray, scratch))
    }

    /// Whether an instance is ever placed elsewhere than at frame 0, or its mesh deforms.
    pub fn moves(&self) -> bool {
        self.instances.iter().any(|instance| instance.transforms.len() > 1 || self.meshes[instance.mesh].deforms())
    }

    /// Whether every instance on a material has tangents, so that anisotropy has a direction everywhere on it.
    pub fn directs(&self, material: usize) -> bool {
        self.directed[material]
    }

    /// Whether all vertices of an instance are at the same places at two frames.
    pub fn rests(&self, instance: &Instance, a: usize, b: usize) -> bool {
        instance.transform(a) == instance.transform(b) && self.meshes[instance.mesh].same_pose(a, b)
    }

    /// The nearest triangle along `ray` that `accept` accepts. The filter sees some triangles beyond the nearest, in no order; it
    /// may ask for anything about the hit it is shown.
    #[inline]
    pub fn closest_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> Option<Hit> {
        let hit = self.flat.closest_where(ray, scratch, &accept);
        match &self.shared {
            None => hit,
            Some(shared) => {
                let (limit, instance) = self.before(hit.as_ref());
                shared.closest_where(ray, scratch, limit, instance, &accept).or(hit)
            }
        }
    }

    /// Whether any triangle that `accept` accepts stands in the way of `ray`.
    #[inline]
    pub fn occluded_where(&self, ray: &Ray, scratch: &mut Scratch, accept: impl Fn(&Candidate) -> bool) -> bool {
        self.flat.occluded_where(ray, scratch, &accept)
            || self.shared.as_ref().is_some_and(|shared| shared.occluded_where(ray, scratch, &accept))
    }

    /// Tree and placement of a hit in a shared mesh.
    #[inline(always)]
    fn shared(&self, hit: &Hit) -> Option<(&Placement, &Accel)> {
        if hit.instance == FLATTENED { None } else { self.shared.as_ref().map(|shared| shared.of(hit)) }
    }

    /// Index of the instance that was hit, and of the triangle in its mesh.
    #[inline(always)]
    pub fn locate(&self, hit: &Hit) -> (u32, u32) {
        match self.shared(hit) {
            None => {
                let triangle = &self.triangles[hit.primitive as usize];
                (triangle.instance, triangle.in_mesh)
            }
            Some((placement, _)) => (placement.instance, self.objects[placement.object as usize].1[hit.primitive as usize]),
        }
    }

    /// Index of the material that was hit.
    #[inline]
    pub fn material(&self, hit: &Hit) -> usize {
        self.placed[self.locate(hit).0 as usize].material
    }

    /// Place, side and material of a hit.
    // Always inlined, so that corners are not copied for callers that do not read them.
    #[inline(always)]
    pub fn surface(&self, hit: &Hit) -> SurfacePoint {
        if let Some((placement, tree)) = self.shared(hit) {
            return shared_surface(self, hit, placement, tree);
        }
        let corners = self.flat.corners(hit);
        let triangle = &self.triangles[hit.primitive as usize];
        let (n, doubled_area) = normal(corners[1] - corners[0], corners[2] - corners[0]);
        let reach = corners.iter().fold(Vec3A::ZERO, |m, c| m.max(c.abs()));
        let start = Start::new(&corners, n, doubled_area, reach);
        SurfacePoint {
            corners,
            p: interpolate(corners, start.inward(hit.weights)),
            n,
            offset: start.offset,
            material: self.placed[triangle.instance as usize].material,
            instance: triangle.instance,
            triangle: triangle.in_mesh,
        }
    }

    /// The ray that goes on along `direction` behind `hit`.
    pub fn behind(&self, hit: &Hit, direction: Vec3A) -> Ray {
        let point = self.surface(hit);
        let n = if point.n.dot(direction) < 0.0 { -point.n } else { point.n };
        Ray::leaving(point.p, n, point.offset, direction)
    }

    /// Vertices of a hit in a shared mesh, the mesh and its placement.
    fn shared_vertices(&self, hit: &Hit) -> Option<([usize; 3], &Mesh, &Placement)> {
        let (placement, _) = self.shared(hit)?;
        let (mesh, kept) = &self.objects[placement.object as usize];
        let mesh = &self.meshes[*mesh];
        Some((mesh.triangles[kept[hit.primitive as usize] as usize].map(|v| v as usize), mesh, placement))
    }

    /// World-space point at `frame` of what `hit` is now.
    pub fn point_at(&self, hit: &Hit, frame: usize) -> DVec3 {
        let (instance, triangle) = self.locate(hit);
        let instance = &self.instances[instance as usize];
        let mesh = &self.meshes[instance.mesh];
        let transform = instance.transform(frame);
        let vertex = |v: u32| place(&transform, mesh.position_at(v as usize, frame)).as_dvec3();
        let corners = mesh.triangles[triangle as usize].map(vertex);
        corners.iter().zip(hit.weights).map(|(&c, w)| c * f64::from(w)).sum()
    }

    /// A mesh as it was given.
    pub fn mesh(&self, index: usize) -> &Mesh {
        &self.meshes[index]
    }

    /// Instances of shared meshes at the current frame.
    fn placements(&self) -> Vec<Placement> {
        let all = self.instances.iter().zip(&self.object_of).zip(0u32..);
        all.filter_map(|((instance, object), index)| Placement::new(index, (*object)?, instance.transform(self.frame))).collect()
    }
}

/// Out of line, so that scenes without shared meshes keep the smaller loop.
#[inline(never)]
fn nearer(shared: &Instances, ray: &Ray, scratch: &mut Scratch, (limit, instance): (f32, u32)) -> Option<Hit> {
    shared.closest(ray, scratch, limit, instance)
}

#[inline(never)]
fn blocked(shared: &Instances, ray: &Ray, scratch: &mut Scratch) -> bool {
    shared.occluded(ray, scratch)
}

#[inline(never)]
fn shared_surface(geometry: &Geometry, hit: &Hit, placement: &Placement, tree: &Accel) -> SurfacePoint {
    let transform = &placement.transform;
    let object = tree.corners(hit);
    let corners = object.map(|c| transform.transform_point3a(c));
    // The normal is made from the exact corners: those in the world have lost digits to the translation. The cofactors of a
    // mirroring transform turn it, as mirrored corners run the other way round.
    let [x, y, z] = cofactors_unsigned(transform);
    let (flat, _) = normal(object[1] - object[0], object[2] - object[0]);
    let n = (x * flat.x + y * flat.y + z * flat.z).normalize_or(flat);
    // Largest coordinates on the way to the world, where roundings are made.
    let m = &transform.matrix3;
    let extent = object.iter().fold(Vec3A::ZERO, |m, c| m.max(c.abs()));
    let reach = m.x_axis.abs() * extent.x + m.y_axis.abs() * extent.y + m.z_axis.abs() * extent.z + transform.translation.abs();
    let start = Start::new(&corners, n, (corners[1] - corners[0]).cross(corners[2] - corners[0]).length(), reach);
    let (instance, triangle) = geometry.locate(hit);
    SurfacePoint {
        corners,
        p: transform.transform_point3a(interpolate(object, start.inward(hit.weights))),
        n,
        offset: start.offset,
        material: geometry.placed[instance as usize].material,
        instance,
        triangle,
    }
}

/// Two equal corners leave nothing to hit (a transform that flattens everything to a point makes thousands of such triangles),
/// and numbers too large would overflow in the test.
fn usable(p: &[Vec3A; 3]) -> bool {
    let flat = p[0] == p[1] || p[1] == p[2] || p[2] == p[0];
    !flat && p.iter().all(|v| v.is_finite() && v.abs().max_element() <= MAX_COORDINATE)
}

#[inline(always)]
fn interpolate(corners: [Vec3A; 3], [a, b, c]: [f32; 3]) -> Vec3A {
    corners[0] * a + corners[1] * b + corners[2] * c
}

/// Unit vector along `a x b` and the length of that. Where it underflows, overflows or vanishes the direction is taken from `a`
/// and `b` made of size 1; of parallel edges any normal will do.
#[inline]
fn normal(a: Vec3A, b: Vec3A) -> (Vec3A, f32) {
    let n = a.cross(b);
    let square = n.length_squared();
    let length = square.sqrt();
    (if square > 1e-30 && square < 1e30 { n / length } else { normal_of_any_size(a, b) }, length)
}

#[cold]
fn normal_of_any_size(a: Vec3A, b: Vec3A) -> Vec3A {
    let unit = |v: Vec3A| v / v.abs().max_element().max(f32::MIN_POSITIVE);
    let (a, b) = (unit(a).as_dvec3(), unit(b).as_dvec3());
    let any = || unit(a.as_vec3a()).try_normalize().map_or(Vec3A::Y, |a| a.any_orthonormal_vector());
    a.cross(b).try_normalize().map_or_else(any, |n| n.as_vec3a())
}

/// Object to world. One function, so that geometry and motion round alike and still points have exactly no motion.
fn place(transform: &Affine3A, p: Vec3) -> Vec3A {
    transform.transform_point3a(p.into())
}

/// The cofactor matrix, by columns: the inverse transpose up to a factor, but without a division that could fail.
fn cofactors_unsigned(transform: &Affine3A) -> [Vec3A; 3] {
    let m = transform.matrix3;
    [m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)]
}

/// As the inverse transpose, its sign included.
fn cofactors(transform: &Affine3A) -> [Vec3A; 3] {
    let sign = if transform.matrix3.determinant() < 0.0 { -1.0 } else { 1.0 };
    cofactors_unsigned(transform).map(|c| c * sign)
}

/// Normals are moved by the inverse transpose; where the transform flattens the mesh they become zero, and the flat normal is
/// used.
fn place_normal([x, y, z]: &[Vec3A; 3], n: Vec3) -> Vec3A {
    (*x * n.x + *y * n.y + *z * n.z).normalize_or_zero()
}

/// Tangents are moved like edges; mirroring changes their handedness.
fn place_tangent(transform: &Affine3A, t: Vec4) -> [f32; 4] {
    let d = (transform.matrix3 * Vec3A::new(t.x, t.y, t.z)).normalize_or_zero();
    [d.x, d.y, d.z, t.w * transform.matrix3.determinant().signum()]
}

/// Appends `values`, then `filler` up to `count` entries.
fn append<T: Copy>(to: &mut Vec<T>, values: impl Iterator<Item = T>, count: usize, filler: T) {
    let end = to.len() + count;
    to.extend(values.take(count));
    to.resize(end, filler);
}

#[cfg(test)]
mod tests;
