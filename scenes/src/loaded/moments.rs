//! A sequence between its frames: where things are while a shutter is open.

use super::{Instance, LoadedScene, Mesh, PunctualLight};
use glam::{Affine3A, Mat3A, Quat, Vec3A};
use renderflow_frame::Camera;
use std::sync::Arc;

impl LoadedScene {
    /// The scene with moments between its frames: behind each frame come the moments `offsets`, in frames from it. All lists with
    /// an entry a frame become lists with an entry a moment, so that entry `f (1 + n) + k` of `n` offsets is frame `f` for `k` =
    /// 0, and otherwise its moment `offsets[k - 1]`.
    ///
    /// Between two frames, and beyond the first and the last one, things go on evenly from one to the other: translations,
    /// scales and weights along a line, rotations along the shortest arc (Shoemake 1985).
    ///
    /// Materials keep their change and know nothing of moments.
    pub fn with_moments(&self, offsets: &[f64]) -> Self {
        let times = Times { frames: self.cameras.len(), offsets };
        let mut scene = self.clone();
        scene.cameras = times.each(&self.cameras, camera_between);
        for Instance { transforms, .. } in &mut scene.instances {
            *transforms = times.each(transforms, between);
        }
        for PunctualLight { transforms, .. } in &mut scene.lights {
            *transforms = times.each(transforms, between);
        }
        for Mesh { deformation, .. } in &mut scene.meshes {
            *deformation = deformation.take().map(|old| Arc::new(old.with_moments(&times)));
        }
        scene
    }

    /// Bytes of the lists that [`Self::with_moments`] makes with so many moments a frame.
    pub fn moments_memory(&self, moments: usize) -> u64 {
        let lists = self.instances.iter().map(|instance| &instance.transforms).chain(self.lights.iter().map(|l| &l.transforms));
        let moving = lists.filter(|transforms| transforms.len() > 1).count() * size_of::<Affine3A>();
        let posed: usize = self.meshes.iter().flat_map(|mesh| &mesh.deformation).map(|d| d.pose_memory()).sum();
        let entries = (self.cameras.len() as u64).saturating_mul(1 + moments as u64);
        entries.saturating_mul((moving + posed + size_of::<Camera>()) as u64)
    }
}

/// The frames of a sequence, each followed by its moments.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times<'a> {
    frames: usize,
    offsets: &'a [f64],
}

impl Times<'_> {
    /// Which two of `count` entries, one a frame, and how far from the first towards the second, for every frame and moment in
    /// order. Beyond the last entry that one is held.
    pub fn spans(self, count: usize) -> impl Iterator<Item = (usize, usize, f32)> {
        (0..self.frames).flat_map(move |frame| {
            std::iter::once(0.0).chain(self.offsets.iter().copied()).map(move |offset| {
                let last = count - 1;
                let time = frame as f64 + offset;
                let first = (time.floor().max(0.0) as usize).min(last.saturating_sub(1));
                // A list that ends before the sequence does stands still from there on.
                let held = count < self.frames;
                let share = time - first as f64;
                (first, (first + 1).min(last), if held { share.min(1.0) } else { share } as f32)
            })
        })
    }

    /// `entries`, one a frame, at every frame and moment. A single one stays alone.
    fn each<T: Copy>(self, entries: &[T], between: impl Fn(&T, &T, f32) -> T) -> Vec<T> {
        match entries {
            [] | [_] => entries.to_vec(),
            _ => self.spans(entries.len()).map(|(a, b, share)| mixed(&entries[a], &entries[b], share, &between)).collect(),
        }
    }
}

/// Frames themselves come out to the bit.
fn mixed<T: Copy>(a: &T, b: &T, share: f32, between: impl Fn(&T, &T, f32) -> T) -> T {
    match share {
        0.0 => *a,
        1.0 => *b,
        share => between(a, b, share),
    }
}

/// A transform on the way from `a` to `b`; `share` 0 is `a` and 1 is `b`. What is equal at both stays so to the bit.
pub(super) fn between(a: &Affine3A, b: &Affine3A, share: f32) -> Affine3A {
    if a == b {
        return *a;
    }
    let [from, to] = [a, b].map(|transform| rotation(&transform.matrix3));
    let [rest_a, rest_b] = [(from, a), (to, b)].map(|(turn, transform)| Mat3A::from_quat(turn.conjugate()) * transform.matrix3);
    let rest = rest_a + (rest_b - rest_a) * share;
    Affine3A {
        matrix3: Mat3A::from_quat(from.slerp(to, share)) * rest,
        translation: a.translation + (b.translation - a.translation) * share,
    }
}

/// The rotation in a matrix: what is left of it without scale, shear and mirroring (Gram and Schmidt); none where it flattens.
fn rotation(matrix: &Mat3A) -> Quat {
    let x = matrix.x_axis.normalize_or_zero();
    let y = (matrix.y_axis - x * x.dot(matrix.y_axis)).normalize_or_zero();
    if x == Vec3A::ZERO || y == Vec3A::ZERO {
        return Quat::IDENTITY;
    }
    Quat::from_mat3a(&Mat3A::from_cols(x, y, x.cross(y)))
}

/// Lenses and sizes of pictures stay within those of the two cameras.
fn camera_between(a: &Camera, b: &Camera, share: f32) -> Camera {
    let within = share.clamp(0.0, 1.0);
    let [fl_x, fl_y, cx, cy] =
        [(a.fl_x, b.fl_x), (a.fl_y, b.fl_y), (a.cx, b.cx), (a.cy, b.cy)].map(|(a, b)| a + (b - a) * within);
    Camera { camera_to_world: between(&a.camera_to_world, &b.camera_to_world, share), fl_x, fl_y, cx, cy, ..*a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loaded::{Displacement, Influence, LoadReport, Poses, Rows, Shape};
    use glam::{DVec3, Vec3};
    use renderflow_frame::Environment;

    fn near(a: &Affine3A, b: &Affine3A, bound: f32) -> bool {
        a.abs_diff_eq(*b, bound)
    }

    /// Half-way of a turn is half the turn, sheared and mirrored bodies included, and the ends are themselves.
    #[test]
    fn transforms_turn_and_stretch_evenly() {
        let shear = Mat3A::from_cols(Vec3A::X, Vec3A::new(0.3, 1.0, 0.0), Vec3A::new(0.0, 0.2, -2.0));
        let at = |angle: f32, scale: f32, x: f32| Affine3A {
            matrix3: Mat3A::from_rotation_y(angle) * shear * scale,
            translation: Vec3A::new(x, 1.0, 2.0),
        };
        let (a, b) = (at(0.2, 1.0, 0.0), at(1.4, 3.0, 8.0));
        assert!(near(&between(&a, &b, 0.5), &at(0.8, 2.0, 4.0), 1e-5));
        assert!(near(&between(&a, &b, 0.0), &a, 1e-6));
        assert!(near(&between(&a, &b, 1.0), &b, 1e-5));
        // It goes on beyond both.
        assert!(near(&between(&a, &b, -0.25), &at(-0.1, 0.5, -2.0), 1e-5));
        assert!(near(&between(&a, &b, 1.25), &at(1.7, 3.5, 10.0), 1e-5));
        assert_eq!(between(&a, &a, 0.3), a);
    }

    /// What is flattened or has vanished stays finite.
    #[test]
    fn flattened_bodies_stay_finite() {
        let flat = Affine3A::from_scale(Vec3::new(0.0, 1.0, 1.0));
        let gone = Affine3A::from_scale(Vec3::ZERO);
        for (a, b) in [(flat, gone), (gone, Affine3A::IDENTITY), (flat, Affine3A::from_rotation_x(3.0))] {
            assert!(between(&a, &b, 0.4).is_finite());
        }
    }

    /// A skin and a morph target go on between the frames, and a mesh that rests stays as it is.
    #[test]
    fn what_deforms_goes_on_between_frames() {
        let shape = Shape {
            displacements: Rows::new(
                1,
                &[(0, Displacement { target: 0, position: Vec3::X, normal: Vec3::ZERO, tangent: Vec3::ZERO })],
            ),
            influences: Rows::new(1, &[(0, Influence { joint: 0, weight: 1.0 })]),
        };
        let joints = [0.0, 90.0_f32].map(|degrees| Affine3A::from_rotation_z(degrees.to_radians()));
        let still = Mesh { positions: vec![Vec3::X], ..Mesh::default() };
        let moving = still.clone().deformed(&Arc::new(shape), Poses::new(2, vec![0.0, 1.0], Arc::new(joints.to_vec())));
        let scene = LoadedScene {
            name: String::new(),
            seed: 0,
            hash: String::new(),
            files: String::new(),
            meshes: vec![still, moving],
            instances: vec![],
            materials: vec![],
            textures: vec![],
            origin: DVec3::ZERO,
            environment: Environment::constant([0.0; 3]),
            lights: vec![],
            cameras: vec![Camera::default(); 2],
            report: LoadReport::default(),
        };
        let [still, moving] = <[Mesh; 2]>::try_from(scene.with_moments(&[-0.5, 0.5]).meshes).expect("two meshes");
        let place = |time: f32| Affine3A::from_rotation_z((90.0 * time).to_radians()).transform_point3(Vec3::X * (1.0 + time));
        assert_eq!(scene.moments_memory(2), 2 * 3 * (size_of::<Camera>() + size_of::<Affine3A>() + size_of::<f32>()) as u64);
        for (pose, time) in [0.0, -0.5, 0.5, 1.0, 0.5, 1.5].into_iter().enumerate() {
            assert!(moving.position_at(0, pose).distance(place(time)) < 1e-5, "pose {pose}");
            assert_eq!(still.position_at(0, pose), Vec3::X);
        }
    }

    #[test]
    fn frames_come_out_to_the_bit_and_moments_lie_between() {
        let times = Times { frames: 3, offsets: &[-0.25, 0.25] };
        let line = |a: &f32, b: &f32, share: f32| a + (b - a) * share;
        let got = times.each(&[1.0, 5.0, 7.0], line);
        assert_eq!(got, [1.0, 0.0, 2.0, 5.0, 4.0, 5.5, 7.0, 6.5, 7.5]);
        assert_eq!(times.each(&[4.0], line), [4.0]);
        // A shorter list holds its last entry.
        assert_eq!(times.each(&[1.0, 5.0], line), [1.0, 0.0, 2.0, 5.0, 4.0, 5.0, 5.0, 5.0, 5.0]);
    }
}
