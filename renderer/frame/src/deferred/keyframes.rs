//! The picture without a network: what keyframes show, carried to the current frame, and deferred shading in the holes.

use crate::image::{Image, Rgb};
use crate::tracks::Movement;
use crate::{Frame, warp};
use rayon::prelude::*;

/// How a keyframe's picture is carried. PSNR halfway between keyframes 16 frames apart, 18 varied scenes at 256 x 256: deferred alone 29.0,
/// with keyframes by their ratio 32.1, as they are 30.8, as they are over albedo + 0.05 31.3, their difference over that 31.6 dB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Carry {
    /// By its ratio to the keyframe's own deferred picture, which the current one is multiplied with ([`warp::ratio_fetch`]): textures stay
    /// sharp and reflections in their new place.
    #[default]
    Ratio,
    /// As it is ([`warp::fetch`]).
    Fetch,
}

/// A frame whose truth is known.
#[derive(Clone, Copy, Debug)]
pub struct Keyframe<'a> {
    /// Its G-buffer; the header names its camera.
    pub frame: &'a Frame,
    /// Its truth, scene-linear.
    pub truth: &'a Rgb,
    /// Its deferred picture ([`super::Deferred::image`]).
    pub start: &'a Rgb,
    /// Frames from the current one to it: negative before, positive after, 0 = it is the current one.
    pub distance: f32,
    /// How objects moved from the current frame to it.
    pub movement: Movement<'a>,
}

/// Frames that count as age 1, and the largest age.
const AGE: [f32; 2] = [16.0, 2.0];
/// Added to the age: a keyframe next to the frame does not silence the other altogether.
const AGE_FLOOR: f32 = 1.0 / 16.0;

/// Scene-linear picture of `frame` (whose header names its camera): where the nearest keyframe before or the nearest after shows the same surface, their
/// pictures, weighted by nearness and mixed in a logarithmic curve; elsewhere `current`, the frame's own deferred picture. A keyframe at
/// distance 0 is returned as it is. `exposure` is the sequence's factor to display-linear. Keyframes of another size show nothing.
///
/// # Panics
/// When a channel of `frame` or `current` has not `frame.width * frame.height` pixels.
pub fn warp_fill(frame: &Frame, current: &Rgb, keyframes: &[Keyframe], exposure: f32, carry: Carry) -> Rgb {
    let fits = |key: &&Keyframe| {
        let size = (frame.width, frame.height);
        let same = |picture: &Rgb| (picture.width, picture.height) == size;
        (key.frame.width, key.frame.height) == size && same(key.truth) && same(key.start) && !key.distance.is_nan()
    };
    if let Some(key) = keyframes.iter().filter(fits).find(|key| key.distance == 0.0) {
        return key.truth.clone();
    }
    let nearest = |side: fn(f32) -> bool| {
        let candidates = keyframes.iter().filter(fits).filter(|key| side(key.distance));
        candidates.min_by(|a, b| a.distance.abs().total_cmp(&b.distance.abs()))
    };
    let carried: Vec<(f32, Rgb, Image<f32>)> = [nearest(|d| d < 0.0), nearest(|d| d > 0.0)]
        .into_iter()
        .flatten()
        .map(|key| {
            let found = warp::correspond(frame, key.frame, Some(&|id| key.movement.of(id)));
            let picture = match carry {
                Carry::Ratio => warp::ratio_fetch(key.truth, key.start, current, &found, exposure),
                Carry::Fetch => warp::fetch(key.truth, &found),
            };
            let age = (key.distance.abs() / AGE[0]).min(AGE[1]);
            (1.0 / (age + AGE_FLOOR), picture, found.valid)
        })
        .collect();
    let scale = if exposure.is_finite() && exposure > 0.0 { 8.0 * exposure } else { 8.0 };
    let mix = |i: usize| {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (weight, picture, valid) in &carried {
            let radiance = picture.pixels[i];
            // Only surfaces are carried, and nothing that is no number.
            if frame.alpha.pixels[i] > 0.0 && valid.pixels[i] > 0.0 && radiance.iter().all(|v| v.is_finite() && *v >= 0.0) {
                total += weight;
                (0..3).for_each(|c| sum[c] += weight * (scale * radiance[c]).ln_1p());
            }
        }
        if total > 0.0 { sum.map(|v| (v / total).exp_m1() / scale) } else { current.pixels[i] }
    };
    let pixels = (0..frame.width * frame.height).into_par_iter().with_min_len(1024).map(mix).collect();
    Rgb { width: frame.width, height: frame.height, pixels }
}
