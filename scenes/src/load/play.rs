//! Where the parts of a model are in each frame of an animation.

use super::gltf::rig::Rig;
use super::{invertible, relative};
use crate::description::Animation;
use glam::{Affine3A, DAffine3, DVec3, Mat3A, Vec3A};

/// Most transforms of nodes and parts that are made for the frames of one object: 2 GiB in memory.
const MOST: usize = 1 << 25;
/// Size of a part that is hidden, in its own size.
const HIDDEN: f32 = 1e-9;

/// An animation of a file's tree, and the frames that it is played for.
pub(super) struct Play<'a> {
    pub rig: &'a Rig,
    pub animation: &'a Animation,
    pub frames: u32,
}

impl Play<'_> {
    /// Refuses more than fits into memory, with `parts` parts.
    pub(super) fn check(&self, parts: usize) -> Result<(), String> {
        let each = (self.rig.nodes() + parts).max(1);
        if each.saturating_mul(self.frames as usize) <= MOST {
            return Ok(());
        }
        let (frames, most) = (self.frames, MOST / each);
        Err(format!("{} nodes and {parts} parts in {frames} frames are too many; at most {most} frames", self.rig.nodes()))
    }

    /// Seconds of the animation at which each frame is.
    pub(super) fn seconds(&self) -> impl Iterator<Item = f64> {
        (0..self.frames).map(|frame| self.animation.second(frame, self.rig.length))
    }

    /// Model space of each node in each frame.
    pub(super) fn poses(&self) -> impl Iterator<Item = Vec<DAffine3>> {
        self.seconds().map(|second| self.rig.pose(second))
    }

    /// The transforms of each of `parts`: its node, if one moves it, and what is done before the node's transform. `placements`
    /// is one for each frame, or one for all.
    pub(super) fn transforms(
        &self,
        parts: &[(Option<usize>, DAffine3)],
        placements: &[DAffine3],
        origin: DVec3,
    ) -> Vec<Vec<Affine3A>> {
        let mut all = vec![Vec::with_capacity(self.frames as usize); parts.len()];
        for (frame, pose) in self.poses().enumerate() {
            let placement = placements[frame.min(placements.len() - 1)];
            for ((node, first), transforms) in parts.iter().zip(&mut all) {
                let moved = node.map_or(*first, |node| pose[node] * *first);
                transforms.push(relative(placement * moved, origin));
            }
        }
        all
    }
}

/// Transforms of which each keeps three dimensions and all mirror or none does: one list, or two of which one is hidden where the
/// other is seen; none where everything is flat. A list of equal transforms becomes one transform. Also whether there are frames
/// in which the animation flattens the part, so that it is hidden.
pub(super) fn seen(transforms: Vec<Affine3A>) -> (Vec<Vec<Affine3A>>, bool) {
    let sign = |t: &Affine3A| if invertible(*t) { t.matrix3.as_dmat3().determinant().signum() } else { 0.0 };
    let signs: Vec<f64> = transforms.iter().map(sign).collect();
    let lists = [1.0, -1.0].into_iter().filter(|wanted| signs.contains(wanted)).map(|wanted| {
        let shown = transforms.iter().zip(&signs).map(|(t, sign)| if *sign == wanted { *t } else { hidden(t, wanted as f32) });
        let mut list: Vec<Affine3A> = shown.collect();
        if list.iter().all(|t| *t == list[0]) {
            list.truncate(1);
        }
        list
    });
    (lists.collect(), signs.contains(&0.0))
}

/// A transform to a speck at the same place.
fn hidden(transform: &Affine3A, sign: f32) -> Affine3A {
    Affine3A { matrix3: Mat3A::from_diagonal((Vec3A::new(sign, 1.0, 1.0) * HIDDEN).into()), translation: transform.translation }
}
