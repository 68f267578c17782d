//! Skins of a glTF file: joints that move the vertices of a mesh (glTF 2.0, section 3.7.3).

use super::Reader;
use crate::error::{Error, Result};
use crate::loaded::{Influence, Rows};
use glam::{Affine3A, DAffine3, DMat4, DVec3};
use gltf::Semantic;

/// The joints of a skin.
pub(crate) struct Skin {
    /// Place of each in the tree, and what takes a vertex to the space of the joint.
    joints: Vec<(usize, DAffine3)>,
    /// The point of the model's space that its matrices are counted from: where the first joint rests.
    pub origin: DVec3,
    /// Whether the joints mirror what they move, as the model rests.
    pub mirrors: bool,
}

impl Skin {
    /// The matrices of the joints, from the space of the mesh to that of the model counted from [`Self::origin`].
    pub(crate) fn matrices<'a>(&'a self, pose: &'a [DAffine3]) -> impl Iterator<Item = Affine3A> + 'a {
        self.joints.iter().map(|(place, inverse)| super::super::relative(pose[*place] * *inverse, self.origin))
    }

    /// Number of joints.
    pub(crate) fn joints(&self) -> usize {
        self.joints.len()
    }
}

/// The joints that the vertices of a primitive follow.
pub(super) struct Followed {
    pub rows: Rows<Influence>,
    /// The highest number of a joint, and the attribute it is in.
    pub highest: (usize, String),
}

impl Reader<'_> {
    /// The skin of a node; `None`, and a note, where it cannot be used.
    pub(super) fn skin(&mut self, skin: &gltf::Skin) -> Result<Option<Skin>> {
        let place = format!("/skins/{}", skin.index());
        let mut joints = Vec::new();
        for (number, joint) in skin.joints().enumerate() {
            let Some(&at) = self.places.get(&joint.index()) else {
                let what = format!("{place}/joints/{number}: node {} is not in the file's scene", joint.index());
                self.model.report.notes.push(format!("{what}; the skin is not used"));
                return Ok(None);
            };
            joints.push((at, DAffine3::IDENTITY));
        }
        if let Some(accessor) = skin.inverse_bind_matrices() {
            let place = format!("{place}/inverseBindMatrices");
            let matrices = self.buffers.floats::<16>(&accessor, &place)?;
            if matrices.len() < joints.len() {
                let reason = format!("{} matrices for {} joints", matrices.len(), joints.len());
                return Err(Error::model(self.path, place, reason));
            }
            for ((number, (_, inverse)), matrix) in joints.iter_mut().enumerate().zip(&matrices) {
                if !matrix.iter().all(|v| v.is_finite()) {
                    return Err(Error::model(self.path, place, format!("matrix {number} is not finite")));
                }
                *inverse = DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
            }
        }
        let Some(first) = joints.first() else {
            self.model.report.notes.push(format!("{place}: the skin has no joint and is not used"));
            return Ok(None);
        };
        let origin = self.rest[first.0].translation;
        let mut skin = Skin { joints, origin, mirrors: false };
        if let Some(joint) = skin.matrices(&self.rest).position(|matrix| !matrix.is_finite()) {
            return Err(Error::model(self.path, format!("{place}/joints/{joint}"), "the transform is not finite"));
        }
        let mirroring = skin.matrices(&self.rest).filter(|m| m.matrix3.as_dmat3().determinant() < 0.0).count();
        skin.mirrors = 2 * mirroring > skin.joints();
        Ok(Some(skin))
    }

    /// What the vertices of a primitive follow, by all sets of joints and weights; `None` where it has none.
    pub(super) fn followed(&mut self, primitive: &gltf::Primitive, vertices: usize, place: &str) -> Result<Option<Followed>> {
        if primitive.get(&Semantic::Joints(0)).is_none() {
            return Ok(None);
        }
        let mut found: Vec<(u32, Influence)> = Vec::new();
        let mut highest = (0, String::new());
        let mut sums = vec![0.0_f64; vertices];
        let mut firsts = vec![0; vertices];
        let mut negative = 0;
        for set in 0.. {
            let [joints, weights] = [Semantic::Joints(set), Semantic::Weights(set)];
            let here = format!("{place}/attributes/{}", joints.to_string());
            if primitive.get(&joints).is_some_and(|accessor| accessor.normalized()) {
                return Err(Error::model(self.path, here, "numbers of joints must not be normalised"));
            }
            let joints = self.attribute::<4, [f32; 4]>(primitive, joints, vertices, place)?;
            let weights = self.attribute::<4, [f32; 4]>(primitive, weights, vertices, place)?;
            if joints.is_empty() && weights.is_empty() {
                break;
            }
            if joints.len() != weights.len() {
                let reason = format!("{} sets of joints and {} of weights", joints.len(), weights.len());
                return Err(Error::model(self.path, here, reason));
            }
            for (vertex, (joints, weights)) in joints.iter().zip(&weights).enumerate() {
                if set == 0 {
                    firsts[vertex] = joints[0] as u32;
                }
                for (joint, weight) in joints.iter().zip(*weights) {
                    if !weight.is_finite() {
                        let place = format!("{place}/attributes/WEIGHTS_{set}");
                        return Err(Error::model(self.path, place, format!("a weight of vertex {vertex} is not finite")));
                    }
                    negative += usize::from(weight < 0.0);
                    if weight <= 0.0 {
                        continue;
                    }
                    if joint.fract() != 0.0 || !(0.0..=65535.0).contains(joint) {
                        return Err(Error::model(self.path, here, format!("vertex {vertex}: {joint} is no number of a joint")));
                    }
                    let joint = *joint as u32;
                    if joint as usize >= highest.0 {
                        highest = (joint as usize, here.clone());
                    }
                    sums[vertex] += f64::from(weight);
                    found.push((vertex as u32, Influence { joint, weight }));
                }
            }
        }
        for (vertex, influence) in &mut found {
            influence.weight = (f64::from(influence.weight) / sums[*vertex as usize]) as f32;
        }
        let mut free = 0;
        for (vertex, _) in sums.iter().enumerate().filter(|(_, sum)| **sum == 0.0) {
            free += 1;
            let joint = firsts[vertex];
            if joint as usize >= highest.0 {
                highest = (joint as usize, format!("{place}/attributes/JOINTS_0"));
            }
            found.push((vertex as u32, Influence { joint, weight: 1.0 }));
        }
        for (count, what) in [
            (negative, "weights of joints are negative and are not used"),
            (free, "vertices have no weight for any joint; they follow the first one that they name"),
        ] {
            if count > 0 {
                self.model.report.notes.push(format!("{place}: {count} {what}"));
            }
        }
        Ok(Some(Followed { rows: Rows::new(vertices, &found), highest }))
    }
}
