//! Geometry of a scene at one frame: placed triangles, their attributes and the tree over them.

use crate::accel::{Accel, MAX_COORDINATE};
use glam::{Affine3A, DVec3, Vec3, Vec3A};
use renderflow_scenes::{Instance, Mesh};

/// Where a triangle's attributes are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedTriangle {
    /// Indices into the world-space vertex arrays.
    pub vertices: [u32; 3],
    pub instance: u32,
    /// Index into the triangles of the instance's mesh.
    pub in_mesh: u32,
}

/// What shading needs of an instance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedInstance {
    pub material: usize,
    pub smooth: bool,
    pub tangents: bool,
}

/// Which attributes the materials of a scene look at.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wanted {
    /// Some material looks something up.
    pub uvs: bool,
    /// Whether a material needs tangents, one a material.
    pub tangents: Vec<bool>,
}

/// Placed geometry of a scene at one frame.
pub(crate) struct Geometry {
    pub accel: Accel,
    /// One a triangle of `accel`, in the order given to its builder.
    pub triangles: Vec<PlacedTriangle>,
    /// World-space unit shading normals, zero where a mesh has none; empty when no mesh has any.
    pub normals: Vec<[f32; 3]>,
    /// Empty when no material looks anything up.
    pub uvs: Vec<[f32; 2]>,
    /// World-space tangents with handedness; empty when no material needs them.
    pub tangents: Vec<[f32; 4]>,
    pub placed: Vec<PlacedInstance>,
    pub instances: Vec<Instance>,
    meshes: Vec<Mesh>,
    wanted: Wanted,
    frame: usize,
    dropped: usize,
    builds: usize,
}

impl Geometry {
    /// Places `instances` of `meshes` at frame 0. Every index must lead somewhere; the scene compiler checks them.
    pub fn new(meshes: Vec<Mesh>, instances: Vec<Instance>, wanted: Wanted) -> Self {
        let mut geometry = Self {
            accel: Accel::build(&[]),
            triangles: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            tangents: Vec::new(),
            placed: Vec::new(),
            instances,
            meshes,
            wanted,
            frame: 0,
            dropped: 0,
            builds: 0,
        };
        geometry.build();
        geometry
    }

    /// Moves to `frame`. The tree is built again only if something moved.
    pub fn set_frame(&mut self, frame: usize) {
        let moved = self.instances.iter().any(|i| i.transform(frame) != i.transform(self.frame));
        self.frame = frame;
        if moved {
            self.build();
        }
    }

    /// Triangles in the tree, all instances together.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Triangles left out because two placed corners are equal, or one is not finite or farther than 1e12 m from the origin.
    pub fn dropped_triangles(&self) -> usize {
        self.dropped
    }

    /// How often the tree was built.
    pub fn builds(&self) -> usize {
        self.builds
    }

    /// World-space point at `frame` of what is now at barycentric `weights` of triangle `primitive`.
    pub fn point_at(&self, primitive: u32, weights: [f32; 3], frame: usize) -> DVec3 {
        let triangle = &self.triangles[primitive as usize];
        let instance = &self.instances[triangle.instance as usize];
        let mesh = &self.meshes[instance.mesh];
        let transform = instance.transform(frame);
        let corners = mesh.triangles[triangle.in_mesh as usize].map(|v| place(&transform, mesh.positions[v as usize]).as_dvec3());
        corners.iter().zip(weights).map(|(&c, w)| c * f64::from(w)).sum()
    }

    /// World-space corners of every triangle in the tree.
    pub fn corners(&self) -> impl Iterator<Item = [Vec3A; 3]> + '_ {
        self.accel.triangles()
    }

    /// Flattens all instances at the current frame and builds their tree.
    fn build(&mut self) {
        let any_normals = self.meshes.iter().any(|m| !m.normals.is_empty());
        let any_tangents = self.wanted.tangents.contains(&true);
        self.triangles.clear();
        self.normals.clear();
        self.uvs.clear();
        self.tangents.clear();
        self.placed.clear();
        self.dropped = 0;
        let mut corners: Vec<[Vec3A; 3]> = Vec::new();
        let mut positions: Vec<Vec3A> = Vec::new();
        let mut first = 0u32;
        for (index, instance) in self.instances.iter().enumerate() {
            let mesh = &self.meshes[instance.mesh];
            let transform = instance.transform(self.frame);
            let count = mesh.positions.len();
            positions.clear();
            positions.extend(mesh.positions.iter().map(|&p| place(&transform, p)));

            let placed = PlacedInstance {
                material: instance.material,
                smooth: !mesh.normals.is_empty(),
                tangents: self.wanted.tangents[instance.material] && !mesh.tangents.is_empty() && !mesh.uvs.is_empty(),
            };
            if any_normals {
                append(&mut self.normals, place_normals(&transform, &mesh.normals), count, [0.0; 3]);
            }
            if self.wanted.uvs {
                append(&mut self.uvs, mesh.uvs.iter().map(|uv| uv.to_array()), count, [0.0; 2]);
            }
            if any_tangents {
                let handedness = transform.matrix3.determinant().signum();
                let tangents = mesh.tangents.iter().map(|t| {
                    let d = (transform.matrix3 * Vec3A::new(t.x, t.y, t.z)).normalize_or_zero();
                    [d.x, d.y, d.z, t.w * handedness]
                });
                append(&mut self.tangents, tangents, count, [0.0; 4]);
            }

            for (in_mesh, triangle) in mesh.triangles.iter().enumerate() {
                let p = triangle.map(|v| positions[v as usize]);
                // Two equal corners leave nothing to hit; a transform that flattens everything to a point makes thousands of them.
                let flat = p[0] == p[1] || p[1] == p[2] || p[2] == p[0];
                if flat || !p.iter().all(|v| v.is_finite() && v.abs().max_element() <= MAX_COORDINATE) {
                    self.dropped += 1;
                    continue;
                }
                corners.push(p);
                let vertices = triangle.map(|v| first + v);
                self.triangles.push(PlacedTriangle { vertices, instance: index as u32, in_mesh: in_mesh as u32 });
            }
            self.placed.push(placed);
            first += count as u32;
        }
        self.accel = Accel::build(&corners);
        self.builds += 1;
    }
}

/// Object to world. One function, so that geometry and motion round alike and still points have exactly no motion.
fn place(transform: &Affine3A, p: Vec3) -> Vec3A {
    transform.transform_point3a(p.into())
}

/// Normals are moved by the inverse transpose; where the transform flattens the mesh they become zero, and the flat normal is used.
fn place_normals<'a>(transform: &Affine3A, normals: &'a [Vec3]) -> impl Iterator<Item = [f32; 3]> + 'a {
    // The cofactor matrix: the inverse transpose up to a factor, but without a division that could fail.
    let m = transform.matrix3;
    let sign = if m.determinant() < 0.0 { -1.0 } else { 1.0 };
    let cofactors = [m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)].map(|c| c * sign);
    normals.iter().map(move |n| (cofactors[0] * n.x + cofactors[1] * n.y + cofactors[2] * n.z).normalize_or_zero().to_array())
}

/// Appends `values`, then `filler` up to `count` entries.
fn append<T: Copy>(to: &mut Vec<T>, values: impl Iterator<Item = T>, count: usize, filler: T) {
    let end = to.len() + count;
    to.extend(values.take(count));
    to.resize(end, filler);
}
