//! Samples of a frame together with samples of the frames around it.

use crate::util::clock::timed;
use anyhow::{Context, Result};
use glam::Mat3A;
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;
use renderflow_frame::{Camera, Environment, Frame, FrameInfo, warp};
use renderflow_model::fusion::Record;
use renderflow_model::fusion::batch::BEFORE;
use renderflow_model::fusion::fill::{Nearby, Paths, Samples, background};
use renderflow_model::fusion::record::NEIGHBOURS;

/// Samples come from at most this many frames away.
pub const REACH: usize = 8;

/// Samples of a frame that is so many frames away count 1/e of what they hold.
const FADING: f32 = 3.0;

/// Which other frames' samples are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Neighbours {
    /// None.
    #[default]
    #[value(skip)]
    Alone,
    /// Samples of up to eight frames before and after.
    Around,
    /// Samples of up to eight frames before.
    Before,
}

impl Neighbours {
    /// The part that it adds to the name of a method.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Alone => "",
            Self::Around => "+around",
            Self::Before => "+before",
        }
    }

    /// The part that it adds to a label.
    pub fn label(self) -> &'static str {
        match self {
            Self::Alone => "",
            Self::Around => ", frames before and after",
            Self::Before => ", frames before",
        }
    }

    /// The frames whose samples are used for frame `index` of `count`, nearest first, without the frame itself. They are at most
    /// `reach` frames away.
    pub fn of(self, reach: usize, index: usize, count: usize) -> Vec<usize> {
        let before = (1..=reach).filter_map(|step| index.checked_sub(step));
        let after = (1..=reach).map(|step| index + step).filter(|&other| other < count);
        let mut frames: Vec<usize> = match self {
            Self::Alone => Vec::new(),
            Self::Around => before.chain(after).collect(),
            Self::Before => before.collect(),
        };
        frames.sort_by_key(|&other| (other.abs_diff(index), other));
        frames
    }

    /// The fewest frames whose samples any frame of `count` gets, its own among them.
    pub fn fewest(self, count: usize) -> usize {
        match self {
            Self::Around => 1 + REACH.min(count.saturating_sub(1)),
            Self::Alone | Self::Before => 1,
        }
    }
}

/// Samples of one frame.
pub struct Traced {
    /// Their mean, scene-linear.
    pub raw: Rgb,
    /// Coverage by their camera rays.
    pub alpha: Image<f32>,
    /// Albedo and normal, averaged over each pixel, if they were asked for.
    pub guides: Option<[Rgb; 2]>,
    /// Samples for each pixel; their average where pixels have different numbers.
    pub spp: u32,
    /// Samples of each pixel; all have `spp` if there is none.
    pub counts: Option<Image<u32>>,
    /// What they are made of, if it was asked for: [`Frame::indirect`], [`Frame::hidden`] and [`Frame::variance`].
    pub paths: Option<[Rgb; 3]>,
    /// The G-buffer that came with them, if one was asked for.
    pub gbuffer: Option<Box<Frame>>,
    /// Wall seconds of tracing them.
    pub seconds: f64,
    /// What nearby frames need of it, if they may still use it.
    pub carried: Option<Ready>,
}

/// What nearby frames need of samples, made once for each frame.
pub struct Ready {
    /// See [`warp::held`].
    logarithms: Rgb,
    /// Wall seconds of making them.
    seconds: f64,
}

impl Traced {
    /// The samples of a path-traced frame, or its picture if it has no others, ready to be carried. `exposure` is the sequence's
    /// factor to display-linear.
    ///
    /// # Errors
    /// When the frame has no picture.
    pub fn of(mut frame: Frame, exposure: f32) -> Result<Self> {
        let raw = frame.raw.take().or(frame.beauty.take()).context("a frame has no picture")?;
        let guides = frame.guide_albedo.take().zip(frame.guide_normal.take()).map(|(albedo, normal)| [albedo, normal]);
        let (spp, counts) = (frame.info.spp, frame.samples.take());
        let paths = paths(&mut frame);
        let mut traced = Self { raw, alpha: frame.alpha, guides, spp, counts, paths, gbuffer: None, seconds: 0.0, carried: None };
        traced.carry(exposure)?;
        Ok(traced)
    }

    /// Prepares the samples for nearby frames. `exposure` is the sequence's factor to display-linear.
    pub fn carry(&mut self, exposure: f32) -> Result<()> {
        if self.carried.is_none() {
            let (logarithms, seconds) = timed(|| Ok(warp::logarithms(&self.raw, exposure)))?;
            self.carried = Some(Ready { logarithms, seconds });
        }
        Ok(())
    }

    /// What [`warp::held`] compares, if the samples were prepared.
    pub fn logarithms(&self) -> Option<&Rgb> {
        self.carried.as_ref().map(|ready| &ready.logarithms)
    }

    /// The samples in the form that the network takes; `background` is the environment behind their frame.
    ///
    /// # Errors
    /// When they have no guides.
    pub fn samples<'a>(&'a self, background: &'a Rgb) -> Result<Samples<'a>> {
        let [albedo, _] = self.guides.as_ref().context("samples without guides")?;
        let paths = self.paths.as_ref().map(|[indirect, hidden, variance]| Paths { indirect, hidden, variance });
        Ok(Samples { raw: &self.raw, alpha: &self.alpha, albedo, background, spp: self.spp, counts: self.counts.as_ref(), paths })
    }

    /// Samples of pixel `at`.
    pub fn count(&self, at: usize) -> u32 {
        self.counts.as_ref().map_or(self.spp, |counts| counts.pixels[at])
    }

    /// Wall seconds of preparing the samples for nearby frames.
    pub fn preparing(&self) -> f64 {
        self.carried.as_ref().map_or(0.0, |ready| ready.seconds)
    }
}

/// Takes what the samples of a frame are made of out of it.
pub fn paths(frame: &mut Frame) -> Option<[Rgb; 3]> {
    let parts = (frame.indirect.take(), frame.hidden.take(), frame.variance.take());
    let (Some(indirect), Some(hidden), Some(variance)) = parts else { return None };
    Some([indirect, hidden, variance])
}

/// Samples of another frame, to be added to the current frame's.
pub struct Carried<'a> {
    /// The samples, in the pixels of their own frame.
    pub samples: &'a Traced,
    /// For each pixel, the pixel of the other frame that shows the same surface.
    pub source: Image<Option<u32>>,
    /// How far its samples hold, 0..=1; all of them do if there is none.
    pub share: Option<Image<f32>>,
    /// From the current frame to the other one.
    pub movement: Movement<'a>,
    /// From the other camera's space to the current camera's.
    pub turn: Mat3A,
    /// From the other camera's space to the world's.
    pub to_world: Mat3A,
}

impl<'a> Carried<'a> {
    /// Carries `samples` of the frame `there` to the frame `current`, whose own samples are `own`. Both frames have the parts
    /// that [`surface`] keeps. `movement` leads from the current frame to the other one.
    ///
    /// The frames are `distance` frames apart. Farther samples count less. No pixel is met exactly, so what is finer than a pixel
    /// blurs a little more with each frame that is added.
    pub fn new(
        (current, own): (&Frame, &Traced),
        (there, samples): (&Frame, &'a Traced),
        movement: Movement<'a>,
        distance: usize,
    ) -> Self {
        let cameras = [current, there].map(|frame| frame.info.camera.camera_to_world.matrix3);
        let motion = |id| movement.of(id);
        let source = warp::nearest(current, there, Some(&motion));
        let logarithms = own.logarithms().zip(samples.logarithms());
        let share = logarithms.map(|(own, other)| {
            let mut held = warp::held(current, there, Some(&motion), &source, [own, other]);
            let fading = (-(distance as f32) / FADING).exp();
            held.pixels.iter_mut().for_each(|share| *share *= fading);
            held
        });
        Self { samples, source, share, movement, turn: cameras[0].inverse() * cameras[1], to_world: cameras[1] }
    }

    /// Turns normals of object `id` from the other frame to the current one, in camera space.
    fn turn(&self, id: u32) -> Mat3A {
        match self.movement.of(id) {
            // Objects move rigidly, or are scaled evenly.
            Some(motion) => self.turn * self.to_world.inverse() * motion.matrix3.inverse() * self.to_world,
            None => self.turn,
        }
    }
}

/// The part of a frame that is needed for carrying samples.
pub fn surface(frame: &Frame) -> Frame {
    Frame {
        width: frame.width,
        height: frame.height,
        albedo: frame.albedo.clone(),
        material: frame.material.clone(),
        transmittance: frame.transmittance.clone(),
        normal: frame.normal.clone(),
        depth: frame.depth.clone(),
        object_id: frame.object_id.clone(),
        info: FrameInfo { camera: frame.info.camera, ..FrameInfo::default() },
        ..Frame::default()
    }
}

/// Adds the samples of other frames to a record: `others` with their indices, nearest first. The nearest frame on each side is a
/// sum by itself, and the others there are another. `index` is that of the record's frame, and `camera` tells the camera of a
/// frame. `exposure` is the sequence's factor to display-linear.
///
/// # Errors
/// When samples have no guides.
pub fn offer<'a>(
    record: &mut Record<f32>,
    index: usize,
    others: impl IntoIterator<Item = (usize, &'a Carried<'a>)>,
    camera: impl Fn(usize) -> Camera,
    (environment, exposure): (&Environment, f32),
) -> Result<()> {
    let mut places = [(); NEIGHBOURS].map(|()| Vec::new());
    for (there, carried) in others {
        let side = if there < index { 0 } else { BEFORE };
        let place = side + usize::from(!places[side].is_empty());
        places[place].push((background(&camera(there), &carried.samples.alpha, environment), carried));
    }
    for (place, frames) in places.iter().enumerate().filter(|(_, frames)| !frames.is_empty()) {
        let mut near = Vec::with_capacity(frames.len());
        for (behind, carried) in frames {
            let samples = carried.samples.samples(behind)?;
            near.push(Nearby { samples, source: &carried.source, share: carried.share.as_ref() });
        }
        record.add_neighbours(place, &near, exposure);
    }
    Ok(())
}

/// Means over a frame's own samples and the samples carried to it; every sample counts as far as it holds. `ids` are the objects
/// at the pixels' centres.
pub fn add_up<'a>(own: &Traced, others: impl IntoIterator<Item = &'a Carried<'a>>, ids: &Image<u32>) -> (Rgb, Option<[Rgb; 2]>) {
    let others: Vec<&Carried> = others.into_iter().collect();
    let mean = |of: &(dyn Fn(&Traced) -> Option<&Rgb> + Sync), turned: bool| -> Option<Rgb> {
        let picture = of(own)?;
        let mut out = picture.clone();
        let row = |(y, row): (usize, &mut [[f32; 3]])| {
            // For each of the other frames, the turn of the last object that was met.
            let mut turns: Vec<Option<(u32, Mat3A)>> = vec![None; others.len()];
            for (x, value) in row.iter_mut().enumerate() {
                let i = y * picture.width + x;
                let (mut sum, mut count) = (glam::Vec3A::from_array(*value) * own.count(i) as f32, own.count(i) as f32);
                for (other, turn) in others.iter().zip(&mut turns) {
                    let (Some(source), Some(there)) = (other.source.pixels[i], of(other.samples)) else { continue };
                    let share = other.share.as_ref().map_or(1.0, |share| share.pixels[i]);
                    let weight = share * other.samples.count(source as usize) as f32;
                    if weight <= 0.0 {
                        continue;
                    }
                    let mut added = glam::Vec3A::from_array(there.pixels[source as usize]);
                    if turned {
                        let id = ids.pixels[i];
                        let known = turn.filter(|(known, _)| *known == id);
                        let (_, turn) = *turn.insert(known.unwrap_or_else(|| (id, other.turn(id))));
                        added = turn * added;
                    }
                    sum += added * weight;
                    count += weight;
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
            counts: None,
            paths: None,
            gbuffer: None,
            seconds: 0.0,
            carried: None,
        }
    }

    #[test]
    fn neighbours_stay_inside_the_sequence() {
        assert_eq!(Neighbours::Around.of(2, 3, 9), [2, 4, 1, 5]);
        assert_eq!(Neighbours::Before.of(2, 3, 9), [2, 1]);
        assert_eq!((Neighbours::Around.of(2, 0, 2), Neighbours::Around.of(2, 8, 9)), (vec![1], vec![7, 6]));
        assert_eq!((Neighbours::Before.of(2, 0, 9), Neighbours::Alone.of(2, 3, 9)), (vec![], vec![]));
        for (neighbours, count) in
            [(Neighbours::Around, 1), (Neighbours::Around, 4), (Neighbours::Around, 30), (Neighbours::Before, 9)]
        {
            let fewest = (0..count).map(|index| 1 + neighbours.of(REACH, index, count).len()).min();
            assert_eq!(fewest, Some(neighbours.fewest(count)));
        }
    }

    #[test]
    fn every_sample_counts_as_much() {
        let (own, other) = (traced(2, 1.0, [0.0, 0.0, 1.0]), traced(6, 5.0, [0.0, 0.0, 1.0]));
        let carried = |source| Carried {
            samples: &other,
            source: Image { width: 2, height: 1, pixels: source },
            share: None,
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
        // A third of the six samples holds in the first pixel, and none in the second, whose source is not finite.
        let mut broken = traced(6, 5.0, [0.0, 0.0, 1.0]);
        broken.raw.pixels[1] = [f32::NAN; 3];
        let share = Some(Image { width: 2, height: 1, pixels: vec![1.0 / 3.0, 0.0] });
        let held = Carried { samples: &broken, share, ..carried(vec![Some(0), Some(1)]) };
        let (raw, _) = add_up(&own, &[held], &Image::filled(2, 1, 7));
        assert_eq!(raw.pixels, [[3.0; 3], [1.0; 3]]);
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
            share: None,
            movement: tracks.between(0, 1),
            turn: cameras[0].inverse() * cameras[1],
            to_world: cameras[1],
        };
        assert!((carried.turn(7) * seen(1, 0.4)).abs_diff_eq(seen(0, 0.1), 1e-5));
        // Others stand still in the world.
        assert!((carried.turn(8) * seen(1, 0.4)).abs_diff_eq(seen(0, 0.4), 1e-5));
    }
}
