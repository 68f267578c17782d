//! How far the samples of another frame hold for a frame: the surface may be the same while its light is not.

use super::window::{Sums, Table};
use super::{ObjectMotion, Surfaces, log_scale};
use crate::Frame;
use crate::fresnel::schlick_weight;
use crate::ibl::f0;
use crate::image::{Image, Rgb};
use glam::Vec3A;
use rayon::prelude::*;

/// The light of two frames is compared over so many pixels to each side.
const REACH: usize = 4;
/// A change of the mean logarithm by this leaves 1/e of the trust.
const CHANGE: f32 = 0.2;
/// Smallest roughness whose lobe is told from a mirror's.
const LEAST_ROUGHNESS: f32 = 0.05;
/// Angle, in radians, that is added to the width of every lobe.
const SHARPEST: f32 = 0.003;

/// The logarithms that [`held`] compares, of scene-linear radiance. `exposure` is the sequence's factor to display-linear. What
/// is below 0 counts as 0; NaN and infinity stay what they are.
pub fn logarithms(picture: &Rgb, exposure: f32) -> Rgb {
    let scale = log_scale(exposure);
    let pixels =
        picture.pixels.par_iter().with_min_len(1024).map(|rgb| rgb.map(|v| (scale * v.clamp(0.0, f32::INFINITY)).ln_1p()));
    Image { width: picture.width, height: picture.height, pixels: pixels.collect() }
}

/// How far the samples of `other` hold for each pixel of `current`, 0..=1; 0 where `sources` ([`super::nearest`]) has none.
///
/// Two things speak against them. The lobe that mirrors light is seen from elsewhere: if the mirrored direction turns by more
/// than the width of the lobe (the square of the roughness, as in GGX, plus 0.003 radians), then the mirrored share of the light,
/// by Schlick's reflectance (1994), is another. And the samples differ: `logarithms`
/// ([`logarithms`]) of the noisy pictures of `current` and of `other`, with equally many samples a pixel, have another mean
/// around the pixel. `object_motion` is as in [`super::correspond`], from `current` to `other`.
///
/// # Panics
/// When a channel of `current`, `sources` or the first picture does not have `current.width * current.height` pixels, or when a
/// source lies outside of the second picture.
pub fn held(
    current: &Frame,
    other: &Frame,
    object_motion: Option<&ObjectMotion<'_>>,
    sources: &Image<Option<u32>>,
    logarithms: [&Rgb; 2],
) -> Image<f32> {
    let (width, height) = (current.width, current.height);
    let change = |i: usize| {
        let there = logarithms[1].pixels[sources.pixels[i]? as usize];
        let change = Vec3A::from_array(there) - Vec3A::from_array(logarithms[0].pixels[i]);
        change.is_finite().then_some(change)
    };
    let table = Table::new(width, height, |i| {
        let sums = change(i).map_or([0.0; 4], |change| [change.x, change.y, change.z, 1.0].map(f64::from));
        Sums(sums)
    });
    let mut out = Image::filled(width, height, 0.0);
    let eyes = [current, other].map(|frame| frame.info.camera.camera_to_world.translation);
    out.pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        let mut surfaces = Surfaces { current, camera: &current.info.camera, object_motion, last: None };
        for (x, out) in row.iter_mut().enumerate() {
            let i = y * width + x;
            if change(i).is_none() {
                continue;
            }
            let Some(surface) = surfaces.at(x, y) else { continue };
            let around = table.around(i, REACH);
            let square: f64 = (0..3).map(|c| around.mean(c, 3).powi(2)).sum::<f64>() / 3.0;
            let alike = (-square as f32 / (CHANGE * CHANGE)).exp();
            let [p, n] = surface.here;
            let views = [(p, n, eyes[0]), (surface.p_world, surface.n_world, eyes[1])]
                .map(|(p, n, eye)| ((eye - p).normalize_or_zero(), n.normalize_or_zero()));
            *out = alike * (1.0 - moved(current, i, views)).max(0.0);
        }
    });
    out
}

/// Share of the light of pixel `i` that is mirrored or seen through the surface, and that comes from elsewhere in the other
/// frame. `views` holds the direction to the camera and the normal, now and there.
fn moved(frame: &Frame, i: usize, views: [(Vec3A, Vec3A); 2]) -> f32 {
    let [here, there] = views.map(|(view, n)| n * (2.0 * view.dot(n)) - view);
    let turn = (here - there).length_squared();
    let lost = |lobe: f32| 1.0 - (-turn / (lobe * lobe)).exp();
    let [roughness, metallic, specular] = frame.material.pixels[i];
    let albedo = frame.albedo.pixels[i];
    let mean = |rgb: [f32; 3]| rgb.iter().sum::<f32>() / 3.0;
    let normal = mean(f0(albedo, metallic, specular));
    let mirrored = normal + (1.0 - normal) * schlick_weight(views[0].0.dot(views[0].1).clamp(0.0, 1.0));
    let share = mirrored / (mirrored + (1.0 - metallic) * mean(albedo)).max(1e-3);
    let through = frame.transmittance.as_ref().map_or(0.0, |through| mean(through.pixels[i]));
    share * lost(roughness.max(LEAST_ROUGHNESS).powi(2) + SHARPEST) + through * lost(SHARPEST)
}
