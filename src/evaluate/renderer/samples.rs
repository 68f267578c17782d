//! Samples of a frame, and samples of its neighbours carried to it.

use glam::Mat3A;
use rayon::prelude::*;
use renderflow_frame::Frame;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;

/// Samples of one frame.
pub struct Traced {
    pub raw: Rgb,
    /// Coverage by their camera rays.
    pub alpha: Image<f32>,
    /// Albedo and normal, averaged over each pixel, if they were asked for.
    pub guides: Option<[Rgb; 2]>,
    /// Samples for each pixel.
    pub spp: u32,
    /// Wall seconds of tracing them.
    pub seconds: f64,
    /// Whether nearby frames may still use it.
    pub carried: bool,
}

/// The G-buffer of the current frame, and its seconds.
#[derive(Clone, Copy)]
pub struct Buffer<'a> {
    /// Stored index of the frame.
    pub index: usize,
    /// The G-buffer with its camera.
    pub frame: &'a Frame,
    /// Wall seconds of making it.
    pub seconds: f64,
}

/// Samples of another frame, to be added to the current frame's.
pub struct Carried<'a> {
    pub samples: &'a Traced,
    /// For each pixel, the pixel of the other frame that shows the same surface.
    pub source: Image<Option<u32>>,
    /// From the current frame to the other one.
    pub movement: Movement<'a>,
    /// From the other camera's space to the current camera's.
    pub turn: Mat3A,
    /// From the other camera's space to the world's.
    pub to_world: Mat3A,
}

impl Carried<'_> {
    /// Turns normals of object `id` from the other frame to the current one, in camera space.
    fn turn(&self, id: u32) -> Mat3A {
        match self.movement.of(id) {
            // Objects move rigidly, or are scaled evenly.
            Some(motion) => self.turn * self.to_world.inverse() * motion.matrix3.inverse() * self.to_world,
            None => self.turn,
        }
    }
}

/// Means over a frame's own samples and the samples carried to it; every sample counts the same. `ids` are the objects at the
/// pixels' centres.
pub fn add_up(own: &Traced, others: &[Carried], ids: &Image<u32>) -> (Rgb, Option<[Rgb; 2]>) {
    let mean = |of: &(dyn Fn(&Traced) -> Option<&Rgb> + Sync), turned: bool| -> Option<Rgb> {
        let picture = of(own)?;
        let mut out = picture.clone();
        let row = |(y, row): (usize, &mut [[f32; 3]])| {
            // For each of the other frames, the turn of the last object that was met.
            let mut turns: Vec<Option<(u32, Mat3A)>> = vec![None; others.len()];
            for (x, value) in row.iter_mut().enumerate() {
                let i = y * picture.width + x;
                let (mut sum, mut count) = (glam::Vec3A::from_array(*value) * own.spp as f32, own.spp as f32);
                for (other, turn) in others.iter().zip(&mut turns) {
                    let (Some(source), Some(there)) = (other.source.pixels[i], of(other.samples)) else { continue };
                    let mut added = glam::Vec3A::from_array(there.pixels[source as usize]);
                    if turned {
                        let id = ids.pixels[i];
                        let known = turn.filter(|(known, _)| *known == id);
                        let (_, turn) = *turn.insert(known.unwrap_or_else(|| (id, other.turn(id))));
                        added = turn * added;
                    }
                    sum += added * other.samples.spp as f32;
                    count += other.samples.spp as f32;
                }
                *value = (sum / count).to_array();
            }
        };
        out.pixels.par_chunks_mut(picture.width.max(1)).enumerate().for_each(row);
        Some(out)
    };
    let raw = mean(&|traced| Some(&traced.raw), false);
    let albedo = mean(&|traced| traced.guides.as_ref().map(|guides| &guides[0]), false);
    let normal = mean(&|traced| traced.guides.as_ref().map(|guides| &guides[1]), true);
    (raw.unwrap_or_default(), albedo.zip(normal).map(|(albedo, normal)| [albedo, normal]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Quat};
    use renderflow_frame::tracks::Tracks;
    use std::collections::BTreeMap;

    fn traced(spp: u32, value: f32, normal: [f32; 3]) -> Traced {
        let flat = |value| Rgb::filled(2, 1, value);
        Traced {
            raw: flat([value; 3]),
            alpha: Image::filled(2, 1, 1.0),
            guides: Some([flat([0.5; 3]), flat(normal)]),
            spp,
            seconds: 0.0,
            carried: false,
        }
    }

    #[test]
    fn every_sample_counts_as_much() {
        let (own, other) = (traced(2, 1.0, [0.0, 0.0, 1.0]), traced(6, 5.0, [0.0, 0.0, 1.0]));
        let carried = |source| Carried {
            samples: &other,
            source: Image { width: 2, height: 1, pixels: source },
            movement: Movement::default(),
            turn: Mat3A::from_quat(Quat::from_rotation_y(0.5)),
            to_world: Mat3A::IDENTITY,
        };
        let (raw, guides) = add_up(&own, &[carried(vec![Some(1), None])], &Image::filled(2, 1, 7));
        assert_eq!(raw.pixels, [[4.0; 3], [1.0; 3]]);
        let [albedo, normal] = guides.unwrap();
        assert_eq!(albedo.pixels, [[0.5; 3]; 2]);
        // Six of eight normals are turned with their camera.
        let expected = glam::Vec3A::new(0.75 * 0.5_f32.sin(), 0.0, 0.25 + 0.75 * 0.5_f32.cos());
        assert!(glam::Vec3A::from_array(normal.pixels[0]).abs_diff_eq(expected, 1e-6), "{normal:?}");
        assert_eq!(normal.pixels[1], [0.0, 0.0, 1.0]);
    }

    #[test]
    fn normals_turn_back_with_their_object() {
        // Object 7 turned by 0.3 about y between the frames, the camera by 0.2.
        let place = |angle: f32| Affine3A::from_quat(Quat::from_rotation_y(angle));
        let tracks = Tracks { objects: BTreeMap::from([(7, vec![place(0.1), place(0.4)])]) };
        let cameras = [0.5_f32, 0.7].map(|angle| Mat3A::from_quat(Quat::from_rotation_y(angle)));
        let n_object = glam::Vec3A::new(0.6, 0.0, 0.8);
        let seen = |frame: usize, angle: f32| cameras[frame].inverse() * (place(angle).matrix3 * n_object);
        let samples = traced(1, 0.0, [0.0; 3]);
        let carried = Carried {
            samples: &samples,
            source: Image::filled(2, 1, Some(0)),
            movement: tracks.between(0, 1),
            turn: cameras[0].inverse() * cameras[1],
            to_world: cameras[1],
        };
        assert!((carried.turn(7) * seen(1, 0.4)).abs_diff_eq(seen(0, 0.1), 1e-5));
        // Others stand still in the world.
        assert!((carried.turn(8) * seen(1, 0.4)).abs_diff_eq(seen(0, 0.4), 1e-5));
    }
}
