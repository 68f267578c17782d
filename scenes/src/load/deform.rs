//! Parts of a model whose vertices move against each other, as it rests and as an animation moves it.

use super::gltf::rig::Rig;
use super::gltf::skin::Skin;
use super::model::Part;
use crate::Mesh;
use crate::loaded::{Poses, Shape};
use glam::{Affine3A, DAffine3, Vec3};
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;

/// What moves the vertices of a part.
pub(crate) struct Deformer {
    /// The mesh before anything moves it.
    pub base: Rc<Mesh>,
    pub shape: Arc<Shape>,
    pub skin: Option<Rc<Skin>>,
    /// Weights of its morph targets as the model rests.
    pub weights: Vec<f32>,
}

impl Deformer {
    /// The one pose of a model whose nodes are where `pose` has them.
    pub(crate) fn posed(&self, pose: &[DAffine3], weights: Vec<f32>) -> Poses {
        Poses::new(1, weights, Arc::new(self.skin.iter().flat_map(|skin| skin.matrices(pose)).collect()))
    }

    /// The mesh in one pose for all frames.
    pub(crate) fn still(&self, poses: Poses) -> Mesh {
        Mesh::clone(&self.base).deformed(&self.shape, poses)
    }

    /// The vertices of the mesh at a second of an animation, whose nodes are then where `pose` has them.
    pub(super) fn positions(&self, rig: &Rig, node: usize, pose: &[DAffine3], seconds: f64) -> Vec<Vec3> {
        self.still(self.posed(pose, self.weights_at(rig, node, seconds))).positions
    }

    /// The weights of its targets at a second of an animation.
    fn weights_at(&self, rig: &Rig, node: usize, seconds: f64) -> Vec<f32> {
        let mut weights = rig.weights(node, seconds).unwrap_or_else(|| self.weights.clone());
        // Primitives of one mesh should have as many targets.
        weights.resize(self.weights.len(), 0.0);
        weights
    }

    /// Numbers that each frame takes, in transforms.
    pub(super) fn size(&self) -> usize {
        self.skin.as_ref().map_or(0, |skin| skin.joints()) + self.weights.len().div_ceil(16)
    }
}

/// Where the vertices of each of `parts` are in frames at the given seconds of an animation; `None` for those that are rigid.
pub(super) fn play(rig: &Rig, seconds: &[f64], parts: &[Part]) -> Vec<Option<Poses>> {
    // Parts of one skin share its matrices.
    let mut joints: HashMap<*const Skin, (Rc<Skin>, Vec<Affine3A>)> = HashMap::new();
    for skin in parts.iter().filter_map(|part| part.deformer.as_ref()?.skin.as_ref()) {
        joints.entry(Rc::as_ptr(skin)).or_insert_with(|| (Rc::clone(skin), vec![]));
    }
    if !joints.is_empty() {
        for pose in seconds.iter().map(|&second| rig.pose(second)) {
            joints.values_mut().for_each(|(skin, matrices)| matrices.extend(skin.matrices(&pose)));
        }
    }
    let joints: HashMap<*const Skin, Arc<Vec<Affine3A>>> =
        joints.into_iter().map(|(key, (_, matrices))| (key, Arc::new(matrices))).collect();
    let poses = |part: &Part| {
        let deformer = part.deformer.as_ref()?;
        let at = |&second: &f64| deformer.weights_at(rig, part.node, second);
        let matrices = deformer.skin.as_ref().and_then(|skin| joints.get(&Rc::as_ptr(skin)).cloned()).unwrap_or_default();
        Some(Poses::new(seconds.len(), seconds.iter().flat_map(at).collect(), matrices))
    };
    parts.iter().map(poses).collect()
}
