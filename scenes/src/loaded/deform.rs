//! Meshes whose vertices move against each other along a sequence: morph targets, and a skin after them.

use super::Mesh;
use super::moments::{Times, between};
use glam::{Affine3A, Mat3A, Vec3, Vec3A, Vec4};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;

/// Vertices that one thread poses at least.
const FEWEST: usize = 1 << 12;

/// How far a morph target moves one vertex at a weight of 1, in the space of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// Number of the target, an index into the weights of a pose.
    pub target: u32,
    /// Added to the position, metres.
    pub position: Vec3,
    /// Added to the normal before that is made unit again.
    pub normal: Vec3,
    /// Added to the direction of the tangent before that is made unit again.
    pub tangent: Vec3,
}

/// A joint that a vertex follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influence {
    /// Number of the joint, an index into the matrices of a pose.
    pub joint: u32,
    /// Its share, > 0; those of a vertex add up to 1.
    pub weight: f32,
}

/// A list of any length for each of several rows.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows<T> {
    /// Where the list of each row ends in `items`.
    ends: Vec<usize>,
    items: Vec<T>,
}

impl<T> Default for Rows<T> {
    fn default() -> Self {
        Self { ends: vec![], items: vec![] }
    }
}

impl<T: Copy> Rows<T> {
    /// The items, each with its row, in `rows` lists that keep their order.
    ///
    /// # Panics
    /// When the row of an item is not below `rows`.
    pub fn new(rows: usize, items: &[(u32, T)]) -> Self {
        let mut ends = vec![0; rows];
        items.iter().for_each(|(row, _)| ends[*row as usize] += 1);
        let mut sum = 0;
        for end in &mut ends {
            // First the begin of each list; filling it moves that to its end.
            sum += std::mem::replace(end, sum);
        }
        let mut sorted: Vec<T> = items.iter().map(|(_, item)| *item).collect();
        for (row, item) in items {
            let place = &mut ends[*row as usize];
            sorted[*place] = *item;
            *place += 1;
        }
        Self { ends, items: sorted }
    }

    /// The list of a row; empty beyond the last one.
    pub fn of(&self, row: usize) -> &[T] {
        let Some(&end) = self.ends.get(row) else { return &[] };
        let start = row.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.items[start..end]
    }

    /// Whether no row has anything.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }
}

/// What moves each vertex of a mesh as it was read: one row a vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    /// What morph targets add.
    pub displacements: Rows<Displacement>,
    /// Which joints it follows.
    pub influences: Rows<Influence>,
}

/// Weights of morph targets and matrices of joints, of every frame of a sequence or of a single one for all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Poses {
    /// Frames that have a pose of their own.
    count: usize,
    /// As many for each pose.
    weights: Vec<f32>,
    /// As many for each pose, from the mesh's space at rest to that of its instance; none = there is no skin.
    joints: Arc<Vec<Affine3A>>,
}

impl Poses {
    /// `count` poses one after the other, each with an equal share of the `weights` and of the `joints`.
    ///
    /// # Panics
    /// When `count` is 0 or does not divide both.
    pub fn new(count: usize, weights: Vec<f32>, joints: Arc<Vec<Affine3A>>) -> Self {
        assert!(count > 0 && weights.len().is_multiple_of(count) && joints.len().is_multiple_of(count));
        Self { count, weights, joints }
    }

    fn of<'a, T>(&self, all: &'a [T], frame: usize) -> &'a [T] {
        let each = all.len() / self.count;
        let first = frame.min(self.count - 1) * each;
        &all[first..first + each]
    }

    fn weights(&self, frame: usize) -> &[f32] {
        self.of(&self.weights, frame)
    }

    fn joints(&self, frame: usize) -> &[Affine3A] {
        self.of(&self.joints, frame)
    }

    /// Whether two frames have the same pose.
    pub fn same(&self, a: usize, b: usize) -> bool {
        self.weights(a) == self.weights(b) && self.joints(a) == self.joints(b)
    }

    /// A pose for every frame and moment of `times`.
    pub(super) fn with_moments(&self, times: &Times<'_>) -> Self {
        if self.count < 2 {
            return self.clone();
        }
        let (mut weights, mut joints) = (Vec::new(), Vec::new());
        let mut count = 0;
        for (a, b, share) in times.spans(self.count) {
            let mixed = |(a, b): (&f32, &f32)| if share == 1.0 { *b } else { a + (b - a) * share };
            weights.extend(self.weights(a).iter().zip(self.weights(b)).map(mixed));
            let turned = |(a, b): (&Affine3A, &Affine3A)| if share == 1.0 { *b } else { between(a, b, share) };
            joints.extend(self.joints(a).iter().zip(self.joints(b)).map(turned));
            count += 1;
        }
        Self { count, weights, joints: Arc::new(joints) }
    }

    /// Whether there is more than one pose.
    fn change(&self) -> bool {
        (1..self.count).any(|frame| !self.same(0, frame))
    }
}

/// How the vertices of a mesh move from frame to frame: first the morph targets, then the joints, whose matrices are mixed for
/// each vertex (glTF 2.0, sections 3.7.2.2 and 3.7.3.3). Kept are weights and matrices of each frame; vertices are posed when
/// they are asked for.
#[derive(Clone, Debug)]
pub struct Deformation {
    shape: Arc<Shape>,
    /// The row of the shape for each vertex of the mesh.
    rows: Vec<u32>,
    poses: Poses,
    /// The vertices before anything moves them. While a scene is loaded the mesh itself holds these.
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    tangents: Vec<Vec4>,
}

/// The vertices of a mesh at a frame, in the space of its instance.
#[derive(Clone, Debug)]
pub struct Posed<'a> {
    /// As [`Mesh::positions`].
    pub positions: Cow<'a, [Vec3]>,
    /// As [`Mesh::normals`]; zero where a joint flattens the surface.
    pub normals: Cow<'a, [Vec3]>,
    /// As [`Mesh::tangents`]; of zero length where a joint flattens them.
    pub tangents: Cow<'a, [Vec4]>,
}

impl Deformation {
    /// For a mesh whose vertex `i` is row `i` of `shape`.
    ///
    /// # Panics
    /// When the shape names a target or, where the poses have joints, a joint that the poses do not have.
    pub fn new(vertices: usize, shape: Arc<Shape>, poses: Poses) -> Self {
        let [weights, joints] = [poses.weights(0).len(), poses.joints(0).len()];
        assert!(shape.displacements.items.iter().all(|d| (d.target as usize) < weights));
        assert!(joints == 0 || shape.influences.items.iter().all(|i| (i.joint as usize) < joints));
        let rows = (0..vertices as u32).collect();
        Self { shape, rows, poses, positions: vec![], normals: vec![], tangents: vec![] }
    }

    /// The same with a pose for every frame and moment of `times`.
    pub(super) fn with_moments(&self, times: &Times<'_>) -> Self {
        Self { poses: self.poses.with_moments(times), ..self.clone() }
    }

    /// Bytes of one of its poses; 0 where all are the same one.
    pub(super) fn pose_memory(&self) -> usize {
        if self.poses.count < 2 {
            return 0;
        }
        size_of_val(self.poses.weights(0)) + size_of_val(self.poses.joints(0))
    }

    /// New vertices, of which number `i` is a copy of the old number `order[i]`.
    pub(crate) fn reorder(&mut self, order: &[usize]) {
        self.rows = order.iter().map(|&old| self.rows[old]).collect();
    }

    /// Sum of `part` of the displacements of a vertex, times their weights.
    fn displaced(&self, vertex: usize, frame: usize, part: impl Fn(&Displacement) -> Vec3) -> Vec3 {
        let list = self.shape.displacements.of(self.rows[vertex] as usize);
        if list.is_empty() {
            return Vec3::ZERO;
        }
        let weights = self.poses.weights(frame);
        list.iter().map(|displacement| part(displacement) * weights[displacement.target as usize]).sum()
    }

    /// The mixed matrix of a vertex, `None` where nothing of a skin moves it.
    fn skin(&self, vertex: usize, frame: usize) -> Option<Affine3A> {
        let joints = self.poses.joints(frame);
        let list = self.shape.influences.of(self.rows[vertex] as usize);
        if joints.is_empty() || list.is_empty() {
            return None;
        }
        let mut sum = Affine3A { matrix3: Mat3A::ZERO, translation: Vec3A::ZERO };
        for influence in list {
            let joint = &joints[influence.joint as usize];
            sum.matrix3 += joint.matrix3 * influence.weight;
            sum.translation += joint.translation * influence.weight;
        }
        Some(sum)
    }

    fn position(&self, vertex: usize, frame: usize) -> Vec3 {
        let morphed = self.positions[vertex] + self.displaced(vertex, frame, |d| d.position);
        self.skin(vertex, frame).map_or(morphed, |skin| skin.transform_point3(morphed))
    }

    /// Normals are moved by the inverse transpose of the mixed matrix, its sign included.
    fn normal(&self, vertex: usize, frame: usize) -> Vec3 {
        let morphed = self.normals[vertex] + self.displaced(vertex, frame, |d| d.normal);
        let Some(skin) = self.skin(vertex, frame) else { return morphed.normalize_or_zero() };
        let m = skin.matrix3;
        let cofactors =
            Mat3A::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)) * morphed.to_vec3a();
        (cofactors * mirror(&m)).to_vec3().normalize_or_zero()
    }

    fn tangent(&self, vertex: usize, frame: usize) -> Vec4 {
        let own = self.tangents[vertex];
        let morphed = own.truncate() + self.displaced(vertex, frame, |d| d.tangent);
        let Some(skin) = self.skin(vertex, frame) else { return morphed.normalize_or_zero().extend(own.w) };
        let moved = (skin.matrix3 * morphed.to_vec3a()).to_vec3();
        moved.normalize_or_zero().extend(own.w * mirror(&skin.matrix3))
    }

    fn posed(&self, frame: usize) -> Posed<'static> {
        let vertices = |count: usize| (0..count).into_par_iter().with_min_len(FEWEST);
        Posed {
            positions: vertices(self.positions.len()).map(|v| self.position(v, frame)).collect(),
            normals: vertices(self.normals.len()).map(|v| self.normal(v, frame)).collect(),
            tangents: vertices(self.tangents.len()).map(|v| self.tangent(v, frame)).collect(),
        }
    }
}

/// -1 where a matrix mirrors, else 1.
fn mirror(matrix: &Mat3A) -> f32 {
    if matrix.determinant() < 0.0 { -1.0 } else { 1.0 }
}

impl Mesh {
    /// Whether its vertices move against each other along the sequence.
    pub fn deforms(&self) -> bool {
        self.deformation.is_some()
    }

    /// Whether its vertices are at the same places, in its own space, at two frames.
    pub fn same_pose(&self, a: usize, b: usize) -> bool {
        self.deformation.as_ref().is_none_or(|deformation| deformation.poses.same(a, b))
    }

    /// Where a vertex is at `frame`, in the space of the mesh.
    ///
    /// # Panics
    /// When there is no such vertex.
    pub fn position_at(&self, vertex: usize, frame: usize) -> Vec3 {
        match &self.deformation {
            None => self.positions[vertex],
            Some(deformation) => deformation.position(vertex, frame),
        }
    }

    /// Its vertices at `frame`: its own where it does not deform, and the same numbers as [`Self::position_at`] where it does.
    pub fn posed(&self, frame: usize) -> Posed<'_> {
        match &self.deformation {
            Some(deformation) => deformation.posed(frame),
            None => Posed {
                positions: Cow::Borrowed(&self.positions),
                normals: Cow::Borrowed(&self.normals),
                tangents: Cow::Borrowed(&self.tangents),
            },
        }
    }

    /// The mesh, whose vertices are those before anything moves them, moved by `shape` and `poses`: vertex `i` by row `i`.
    ///
    /// # Panics
    /// As [`Deformation::new`].
    pub fn deformed(self, shape: &Arc<Shape>, poses: Poses) -> Self {
        let mut mesh = self.moved_by(shape, poses);
        mesh.settle();
        mesh
    }

    /// As [`Self::deformed`], still to be worked on. Until [`Self::settle`] it holds the vertices before anything moves them.
    pub(crate) fn moved_by(self, shape: &Arc<Shape>, poses: Poses) -> Self {
        let deformation = Deformation::new(self.positions.len(), Arc::clone(shape), poses);
        Self { deformation: Some(Arc::new(deformation)), ..self }
    }

    /// Takes the vertices of the first frame, and hands those before any movement to its deformation, which goes where all poses
    /// are the same.
    pub(crate) fn settle(&mut self) {
        let Some(shared) = self.deformation.take() else { return };
        let mut deformation = Arc::unwrap_or_clone(shared);
        deformation.positions = std::mem::take(&mut self.positions);
        deformation.normals = std::mem::take(&mut self.normals);
        deformation.tangents = std::mem::take(&mut self.tangents);
        let Posed { positions, normals, tangents } = deformation.posed(0);
        (self.positions, self.normals, self.tangents) = (positions.into_owned(), normals.into_owned(), tangents.into_owned());
        self.deformation = deformation.poses.change().then(|| Arc::new(deformation));
    }
}
