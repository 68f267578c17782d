//! Where moving objects are in each frame of a sequence, so that keyframes many frames away can be warped along with them.

use glam::Affine3A;
use std::collections::BTreeMap;

/// Object-to-world transforms of the objects that move, one for every stored frame. Objects that are not listed stand still.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracks {
    /// Transforms by object id. There are none for an object that no single transform follows, because its parts move against
    /// each other or it changes its shape: its movement is unknown.
    pub objects: BTreeMap<u32, Vec<Affine3A>>,
}

/// Stands for the map of an object whose movement is unknown.
const UNKNOWN: Affine3A = Affine3A::NAN;

impl Tracks {
    /// Movement of every object from stored frame `from` to stored frame `to`.
    pub fn between(&self, from: usize, to: usize) -> Movement<'_> {
        Movement { tracks: Some(self), from, to }
    }
}

/// How objects moved between two frames; by default nothing moved.
#[derive(Clone, Copy, Debug, Default)]
pub struct Movement<'a> {
    tracks: Option<&'a Tracks>,
    from: usize,
    to: usize,
}

impl Movement<'_> {
    /// The map of world-space points of object `id` from the first frame to the second; `None` where it did not move, and a map
    /// of NaN where its movement is unknown.
    /// An object whose transform cannot be inverted, or is missing at a frame, counts as still: such an object is not visible.
    pub fn of(&self, id: u32) -> Option<Affine3A> {
        let track = self.tracks?.objects.get(&id)?;
        if track.is_empty() {
            return Some(UNKNOWN);
        }
        let map = *track.get(self.to)? * track.get(self.from)?.inverse();
        map.is_finite().then_some(map)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3, Vec3A};

    #[test]
    fn points_move_with_their_object() {
        let place = |t: f32| Affine3A::from_rotation_translation(Quat::from_rotation_y(t), Vec3::new(t, 0.0, 2.0 * t));
        let tracks = Tracks { objects: BTreeMap::from([(7, vec![place(0.1), place(0.5), place(1.2)])]) };
        let p_object = Vec3A::new(0.3, -0.2, 0.9);
        let moved = tracks.between(2, 0).of(7).unwrap().transform_point3a(place(1.2).transform_point3a(p_object));
        assert!(moved.abs_diff_eq(place(0.1).transform_point3a(p_object), 1e-5));
        assert_eq!(tracks.between(0, 2).of(1), None);
        assert_eq!(tracks.between(0, 9).of(7), None);
        assert_eq!(Movement::default().of(7), None);
    }

    #[test]
    fn an_object_without_transforms_is_lost_and_not_still() {
        let tracks = Tracks { objects: BTreeMap::from([(7, vec![]), (8, vec![Affine3A::IDENTITY; 2])]) };
        assert!(tracks.between(0, 1).of(7).is_some_and(|map| !map.is_finite()));
        assert_eq!(tracks.between(0, 1).of(8), Some(Affine3A::IDENTITY));
        assert_eq!(tracks.between(0, 1).of(9), None);
    }
}
