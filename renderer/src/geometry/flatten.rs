//! Flattening instances into the world-space tree, and moving them there from frame to frame.

use super::{Geometry, PlacedTriangle, append, cofactors, place, place_normal, place_tangent, usable};
use crate::accel::Accel;
use glam::Vec3A;

/// Frames whose tree is sorted as at the first of them and only fitted to where things are.
const EPOCH: usize = 16;
/// A tree whose expected cost has grown beyond this is sorted again: rays slow down in proportion to the cost, and sorting pays
/// from some ten million rays on (docs/measurements/renderer-notes.md, trees).
const WORST_GROWTH: f32 = 1.03;

/// How the world-space tree stands to the frames.
#[derive(Default)]
pub(super) struct Flattened {
    /// Frame at which the tree was sorted.
    sorted: usize,
    /// Frame at which everything stands.
    placed: usize,
    /// The tree sorted at `sorted`, where that of the geometry was made for the current frame alone.
    kept: Option<Accel>,
    /// Corners of the tree's triangles in the order given to its builder; empty where nothing ever moves.
    corners: Vec<[Vec3A; 3]>,
    /// First vertex and first triangle of each instance.
    starts: Vec<[usize; 2]>,
    /// Triangles left out.
    pub dropped: usize,
}

impl Flattened {
    pub fn memory(&self) -> usize {
        size_of_val(self.corners.as_slice()) + self.kept.as_ref().map_or(0, Accel::memory)
    }
}

impl Geometry {
    /// Brings the flattened instances to `frame`. What stands still is left alone; where things move, the tree is fitted to them.
    ///
    /// The tree is a function of the frame alone and does not depend on earlier frames. Hits are those of any other tree, so that
    /// no more than speed should depend on it; this way nothing can.
    pub(super) fn move_flattened(&mut self, frame: usize) {
        let same = |geometry: &Self, a: usize, b: usize| {
            let mut flattened = geometry.instances.iter().zip(&geometry.object_of).filter(|(_, object)| object.is_none());
            flattened.all(|(instance, _)| geometry.rests(instance, a, b))
        };
        if same(self, frame, self.flattened.placed) && same(self, frame - frame % EPOCH, self.flattened.sorted) {
            return;
        }
        let epoch = frame - frame % EPOCH;
        if let Some(kept) = self.flattened.kept.take() {
            self.flat = kept;
        }
        if !same(self, epoch, self.flattened.sorted) {
            if !self.place_flattened(epoch) {
                self.gather_flattened(epoch);
            }
            self.sort_flattened(epoch);
        }
        if same(self, frame, self.flattened.placed) {
            return;
        }
        if !self.place_flattened(frame) {
            // Other triangles are usable now.
            self.gather_flattened(frame);
            self.sort_flattened(frame);
            return;
        }
        self.flat.refit(&self.flattened.corners);
        self.builds.refitted += 1;
        // Written so that NaN builds.
        let fine = self.flat.quality() <= WORST_GROWTH;
        if !fine {
            let fresh = Accel::build(&self.flattened.corners);
            self.builds.flattened += 1;
            self.flattened.kept = Some(std::mem::replace(&mut self.flat, fresh));
        }
    }

    /// Flattens at the current frame from the beginning.
    pub fn flatten(&mut self) {
        self.gather_flattened(self.frame);
        self.sort_flattened(self.frame);
    }

    /// Builds the tree over the triangles that stand at `frame`.
    fn sort_flattened(&mut self, frame: usize) {
        self.flat = Accel::build(&self.flattened.corners);
        self.builds.flattened += 1;
        self.flattened.sorted = frame;
        let moves = |(instance, object): (&renderflow_scenes::Instance, &Option<u32>)| {
            object.is_none() && (instance.transforms.len() > 1 || self.meshes[instance.mesh].deforms())
        };
        if !self.instances.iter().zip(&self.object_of).any(moves) {
            self.flattened.corners = Vec::new();
        }
    }

    /// Collects triangles and vertices of the flattened instances as they are at `frame`.
    fn gather_flattened(&mut self, frame: usize) {
        let any_normals = self.meshes.iter().any(|m| !m.normals.is_empty());
        let any_tangents = self.wanted.tangents.contains(&true);
        self.triangles.clear();
        self.normals.clear();
        self.uvs.clear();
        self.more_uvs.iter_mut().for_each(Vec::clear);
        self.tangents.clear();
        self.colors.clear();
        let flattened = &mut self.flattened;
        flattened.corners.clear();
        flattened.starts.clear();
        (flattened.dropped, flattened.placed) = (0, frame);
        let mut positions: Vec<Vec3A> = Vec::new();
        let mut first = 0;
        for (index, instance) in self.instances.iter().enumerate() {
            flattened.starts.push([first, self.triangles.len()]);
            if self.object_of[index].is_some() {
                continue;
            }
            let mesh = &self.meshes[instance.mesh];
            let transform = instance.transform(frame);
            let count = mesh.positions.len();
            let posed = mesh.posed(frame);
            positions.clear();
            positions.extend(posed.positions.iter().map(|&p| place(&transform, p)));
            if any_normals {
                let cofactors = cofactors(&transform);
                let normals = posed.normals.iter().map(|&n| place_normal(&cofactors, n).to_array());
                append(&mut self.normals, normals, count, [0.0; 3]);
            }
            if self.wanted.uv_sets > 0 {
                append(&mut self.uvs, mesh.uvs.iter().map(|uv| uv.to_array()), count, [0.0; 2]);
            }
            for (further, uvs) in self.more_uvs.iter_mut().enumerate() {
                append(uvs, mesh.uv_set(further + 1).iter().map(|uv| uv.to_array()), count, [0.0; 2]);
            }
            if self.wanted.colors {
                append(&mut self.colors, mesh.colors.iter().map(|c| c.to_array()), count, [1.0; 4]);
            }
            if any_tangents {
                append(&mut self.tangents, posed.tangents.iter().map(|&t| place_tangent(&transform, t)), count, [0.0; 4]);
            }
            for (in_mesh, triangle) in mesh.triangles.iter().enumerate() {
                let p = triangle.map(|v| positions[v as usize]);
                if !usable(&p) {
                    flattened.dropped += 1;
                    continue;
                }
                flattened.corners.push(p);
                let vertices = triangle.map(|v| first as u32 + v);
                self.triangles.push(PlacedTriangle { vertices, instance: index as u32, in_mesh: in_mesh as u32 });
            }
            first += count;
        }
        flattened.starts.push([first, self.triangles.len()]);
    }

    /// Moves the flattened instances that stand elsewhere at `frame`. False when other triangles are usable there: all must be
    /// gathered.
    fn place_flattened(&mut self, frame: usize) -> bool {
        let flattened = &mut self.flattened;
        if flattened.corners.len() != self.triangles.len() {
            return false;
        }
        let before = std::mem::replace(&mut flattened.placed, frame);
        let mut positions: Vec<Vec3A> = Vec::new();
        for (index, instance) in self.instances.iter().enumerate() {
            let transform = instance.transform(frame);
            let mesh = &self.meshes[instance.mesh];
            let rests = transform == instance.transform(before) && mesh.same_pose(frame, before);
            if self.object_of[index].is_some() || rests {
                continue;
            }
            let posed = mesh.posed(frame);
            let [first, mut at] = flattened.starts[index];
            let [_, end] = flattened.starts[index + 1];
            positions.clear();
            positions.extend(posed.positions.iter().map(|&p| place(&transform, p)));
            let corners = mesh.triangles.iter().map(|triangle| triangle.map(|v| positions[v as usize]));
            for (in_mesh, p) in corners.enumerate().filter(|(_, p)| usable(p)) {
                if at == end || self.triangles[at].in_mesh as usize != in_mesh {
                    return false;
                }
                flattened.corners[at] = p;
                at += 1;
            }
            if at != end {
                return false;
            }
            if let Some(normals) = self.normals.get_mut(first..) {
                let cofactors = cofactors(&transform);
                normals.iter_mut().zip(posed.normals.iter()).for_each(|(to, &n)| *to = place_normal(&cofactors, n).to_array());
            }
            if let Some(tangents) = self.tangents.get_mut(first..) {
                tangents.iter_mut().zip(posed.tangents.iter()).for_each(|(to, &t)| *to = place_tangent(&transform, t));
            }
        }
        true
    }
}
