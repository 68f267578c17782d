//! Flicker: how the error of a picture changes from one frame to the next, along the motion of the surfaces.

use renderflow_frame::Frame;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::tracks::Movement;
use renderflow_frame::warp::{self, Correspondence};

/// Taps that weigh less than this are not looked at, as [`warp::fetch`] leaves them out.
const LEAST_WEIGHT: f32 = 1.0 / 128.0;

/// Where each pixel of `current` was in `previous`, the frame before it, and whether it was seen there.
///
/// With both cameras by [`warp::correspond`] (depth, normal and object agree on the whole footprint); `movement` is that of the
/// objects from `current` to `previous`. Without cameras by [`Frame::motion_prev`], where the footprint lies in the picture and
/// shows the same object; nothing is valid without that either.
pub fn correspondence(current: &Frame, previous: &Frame, movement: Movement<'_>) -> Correspondence {
    if current.info.camera.is_some() && previous.info.camera.is_some() {
        return warp::correspond(current, previous, Some(&|id| movement.of(id)));
    }
    let (width, height) = (current.width, current.height);
    let mut out = Correspondence { source: Image::filled(width, height, [0.0; 2]), valid: Image::filled(width, height, 0.0) };
    let Some(motion) = current.motion_prev.as_ref().filter(|_| previous.width > 0 && previous.height > 0) else { return out };
    for (i, motion) in motion.pixels.iter().enumerate().take(width * height) {
        if !current.depth.pixels[i].is_finite() {
            continue;
        }
        let point = [(i % width) as f32 + 0.5 + motion[0], (i / width) as f32 + 0.5 + motion[1]];
        if shows(previous, point, current.object_id.pixels[i]) {
            out.source.pixels[i] = point;
            out.valid.pixels[i] = 1.0;
        }
    }
    out
}

/// Whether `frame` shows object `id` at all taps of a bilinear look-up at `point`.
fn shows(frame: &Frame, point: [f32; 2], id: u32) -> bool {
    let [x, y] = point;
    if !(x >= 0.0 && y >= 0.0 && x <= frame.width as f32 && y <= frame.height as f32) {
        return false;
    }
    let taps = |v: f32, size: usize| {
        let at = (v - 0.5).clamp(0.0, size as f32 - 1.0);
        let (low, t) = (at as usize, at.fract());
        [(t <= 1.0 - LEAST_WEIGHT).then_some(low), (t >= LEAST_WEIGHT).then_some((low + 1).min(size - 1))]
    };
    let (columns, rows) = (taps(x, frame.width), taps(y, frame.height));
    let mut footprint = rows.into_iter().flatten().flat_map(|y| columns.into_iter().flatten().map(move |x| y * frame.width + x));
    footprint.all(|i| frame.object_id.pixels[i] == id && frame.depth.pixels[i].is_finite())
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

/// Mean over the valid pixels and channels of `|(picture - warp(previous picture)) - (truth - warp(previous truth))|`: how much
/// more, or else, the picture changes on the surfaces than the truth does. `None` when nothing is valid or the sizes differ.
///
/// It is fair to any method: what changes in the truth (highlights that travel, shadows that move) may change, and must; the truth
/// itself gets exactly 0, and so does a constant error, however large: that is for the other metrics. Errors that stay on the
/// surface count only by what the bilinear look-up blurs of them; errors that stay on the screen while surfaces move under
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
    super::masked_mean(
        change.map(|(now, before)| (0..3).map(|c| f64::from((now[c] - before[c]).abs())).sum::<f64>() / 3.0),
        valid,
    )
}
