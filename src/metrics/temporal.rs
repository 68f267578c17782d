//! Flicker: how the error of a picture changes from one frame to the next, along the motion of the surfaces.

use renderflow_frame::Frame;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;
use renderflow_frame::warp::{self, Correspondence};

/// Where each pixel of `current` was in `previous`, the frame before it, and whether it was seen there (see
/// [`warp::correspond`]);
/// `movement` is that of the objects from `current` to `previous`.
pub fn correspondence(current: &Frame, previous: &Frame, movement: Movement<'_>) -> Correspondence {
    warp::correspond(current, previous, Some(&|id| movement.of(id)))
}

/// A picture and its truth, display values in 0..=1.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// What a method made.
    pub picture: &'a Rgb,
    /// What it should be.
    pub truth: &'a Rgb,
}

impl Pair<'_> {
    fn error(self) -> Rgb {
        let pixels = self.picture.pixels.iter().zip(&self.truth.pixels).map(|(p, t)| std::array::from_fn(|c| p[c] - t[c]));
        Rgb { width: self.picture.width, height: self.picture.height, pixels: pixels.collect() }
    }
}

/// Mean over pixels and channels of `|(picture - warp(previous picture)) - (truth - warp(previous truth))|`: how much more, or
/// else, the picture changes on the surfaces than the truth does. Pixels count whose surface the previous frame shows in the
/// whole footprint. `None` when there are none, or the sizes differ.
///
/// It is fair to any method: what changes in the truth (highlights that travel, shadows that move) may change, and must; the
/// truth itself gets exactly 0, and so does a constant error, however large: that is for the other metrics. Errors that stay on
/// the surface count only by what the bilinear look-up blurs of them; errors that stay on the screen while surfaces move under
/// them ("shower door"), noise and popping count in full. As the warp is linear, the error alone is warped.
pub fn temporal(current: Pair<'_>, previous: Pair<'_>, correspondence: &Correspondence) -> Option<f64> {
    let size = |i: &Rgb| (i.width, i.height, i.pixels.len());
    let expected = size(current.truth);
    let valid = &correspondence.valid;
    if [current.picture, previous.picture, previous.truth].iter().any(|i| size(i) != expected)
        || (valid.width, valid.height, valid.pixels.len()) != expected
    {
        return None;
    }
    let before = warp::fetch(&previous.error(), correspondence);
    let change = current.error().pixels.into_iter().zip(before.pixels);
    let whole = valid.pixels.iter().map(|share| f32::from(u8::from(*share >= 1.0))).collect();
    super::masked_mean(
        change.map(|(now, before)| (0..3).map(|c| f64::from((now[c] - before[c]).abs())).sum::<f64>() / 3.0),
        &Image { pixels: whole, ..*valid },
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Affine3A, Vec3};
    use renderflow_frame::{Camera, FrameInfo};

    const WIDTH: usize = 24;
    const HEIGHT: usize = 16;

    /// A wall of object 1 two metres in front of the camera, seen everywhere; its pixels are `motion` pixels away where the
    /// camera is at the origin. One metre is ten pixels.
    fn wall(motion: [f32; 2]) -> Frame {
        let camera = Camera {
            width: WIDTH,
            height: HEIGHT,
            fl_x: 20.0,
            fl_y: 20.0,
            cx: 12.0,
            cy: 8.0,
            camera_to_world: Affine3A::from_translation(Vec3::new(0.1 * motion[0], -0.1 * motion[1], 0.0)),
            ..Camera::default()
        };
        Frame {
            width: WIDTH,
            height: HEIGHT,
            depth: Image::filled(WIDTH, HEIGHT, 2.0),
            normal: Rgb::filled(WIDTH, HEIGHT, [0.0, 0.0, 1.0]),
            object_id: Image::filled(WIDTH, HEIGHT, 1),
            info: FrameInfo { camera, ..FrameInfo::default() },
            ..Frame::default()
        }
    }

    /// What hangs on a wall: no two pixels alike.
    fn pattern(shift: usize) -> Rgb {
        Rgb::from_fn(WIDTH, HEIGHT, |x, y| [0, 1, 2].map(|c| (((x + shift) * 37 + y * 11 + c * 5) % 16) as f32 / 16.0))
    }

    fn plus(picture: &Rgb, error: impl Fn(usize) -> f32) -> Rgb {
        Rgb::from_fn(picture.width, picture.height, |x, y| picture.at(x, y).map(|v| v + error(x)))
    }

    fn measured(motion: [f32; 2], error: impl Fn(usize) -> f32, error_before: impl Fn(usize) -> f32) -> f64 {
        let (truth, truth_before) = (pattern(3), pattern(0));
        let (picture, picture_before) = (plus(&truth, error), plus(&truth_before, error_before));
        let found = correspondence(&wall(motion), &wall([0.0; 2]), Movement::default());
        let pair = |picture, truth| Pair { picture, truth };
        temporal(pair(&picture, &truth), pair(&picture_before, &truth_before), &found).unwrap()
    }

    #[test]
    fn only_an_error_that_changes_counts() {
        for motion in [[3.0, 0.0], [0.4, -1.3], [0.0, 0.0]] {
            assert_eq!(measured(motion, |_| 0.0, |_| 0.0), 0.0, "the truth flickers by {motion:?}");
            assert!(measured(motion, |_| 0.3, |_| 0.3) < 1e-6, "a constant error");
            assert!((measured(motion, |_| 0.1, |_| -0.1) - 0.2).abs() < 1e-6, "the whole picture flickers");
        }
        // Every fourth column is too bright. On the wall it is three pixels to the left one frame later.
        let stripes = |from: usize| move |x: usize| if x >= from && (x - from).is_multiple_of(4) { 0.4 } else { 0.0 };
        assert!(measured([3.0, 0.0], stripes(1), stripes(4)) < 1e-6, "an error that stays on the surface");
        // On the screen: half of the columns of the surface change by 0.4.
        let stays = measured([3.0, 0.0], stripes(1), stripes(1));
        assert!((stays - 0.2).abs() < 0.02, "an error that stays on the screen: {stays}");
    }

    #[test]
    fn pixels_that_cannot_be_followed_are_left_out() {
        let (mut current, mut previous) = (wall([2.5, 0.0]), wall([0.0; 2]));
        current.depth.pixels[5] = f32::INFINITY;
        // Pixel (10, 0) came from between (12, 0) and (13, 0), (9, 0) from between (11, 0) and (12, 0).
        previous.object_id.pixels[12] = 2;
        let found = correspondence(&current, &previous, Movement::default());
        for x in 0..WIDTH {
            let expected = x != 5 && x != 9 && x != 10 && (x as f32) < WIDTH as f32 - 2.5;
            assert_eq!(*found.valid.at(x, 0) >= 1.0, expected, "column {x}");
            assert_eq!(*found.valid.at(x, 1) >= 1.0, (x as f32) < WIDTH as f32 - 2.5, "column {x}");
        }
        let truth = pattern(0);
        let pair = Pair { picture: &truth, truth: &truth };
        assert_eq!(temporal(pair, pair, &found), Some(0.0));
        let far = correspondence(&wall([100.0, 0.0]), &previous, Movement::default());
        assert_eq!(temporal(pair, pair, &far), None);
        let small = truth.crop(0, 0, 4, 4);
        assert_eq!(temporal(Pair { picture: &small, truth: &truth }, pair, &found), None);
        let nothing = correspondence(&wall([0.0; 2]), &Frame::default(), Movement::default());
        assert!(nothing.valid.pixels.iter().all(|v| *v == 0.0));
    }
}
