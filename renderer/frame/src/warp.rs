//! Warps the picture of a keyframe to another frame: finds where the surface point of each pixel stood in the keyframe, and
//! whether it was visible there. It does the same for the raw samples of neighbouring frames, pixel by pixel.

mod carry;
mod hold;
mod window;

pub use carry::{Carried, TINT, carry};
pub use hold::{held, logarithms};

use crate::image::{Image, Rgb};
use crate::tracks::Movement;
use crate::{Camera, Frame};
use glam::{Affine3A, Mat3A, Vec2, Vec3A, Vec4};
use rayon::prelude::*;

/// Depth in the keyframe may differ from the point's by this share ...
const DEPTH_TOLERANCE: f32 = 0.01;
/// ... plus this share of the depth's change over the footprint along the surface: shading normals are not the surface's own.
const SLOPE_TOLERANCE: f32 = 0.5;
/// Least cosine between the two world-space normals (30 degrees).
const MIN_NORMAL_COSINE: f32 = 0.866;
/// A lens shows a point where it lies if the direction there is that of the point up to this, at distance 1.
const SAME_DIRECTION: f32 = 1e-3;
/// Taps with less weight than this are left out, so that a still camera reads exactly one pixel in spite of rounding.
const LEAST_WEIGHT: f32 = 1.0 / 128.0;
/// Trust, 0..=1, in a pixel that the keyframe does not show.
pub const FILLED: f32 = 0.03;
/// Weight of the start image beside keyframes whose weight is their trust over their age.
const START: f32 = 0.05;
/// Bits of the four taps of a bilinear look-up.
const ALL_TAPS: u8 = 0b1111;
/// Albedo of a pixel may differ by this, in each channel, from the albedo of the pixel that its samples come from ...
const ALBEDO_TOLERANCE: f32 = 0.05;
/// ... plus this share of the larger of the two.
const ALBEDO_SHARE: f32 = 0.1;
/// Largest factor by which a keyframe may raise or lower the start image, see [`ratio_fetch`].
pub const MAX_RATIO: f32 = 16.0;
/// Display-linear value added to both sides of a ratio, so that black stays finite.
const RATIO_FLOOR: f32 = 0.01;
/// Distance in frames that counts as age 1.
pub const AGE_UNIT: f32 = 16.0;
/// Age of every keyframe that is farther away.
pub const OLDEST: f32 = 2.0;
/// Added to the age where keyframes are weighted by its inverse, so that a keyframe next to the frame does not silence the other
/// one.
const AGE_FLOOR: f32 = 1.0 / AGE_UNIT;
/// Scale of display-linear radiance in the logarithm that warped keyframes are mixed in.
const LOG_SCALE: f32 = 8.0;

/// A frame whose truth is known.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Its G-buffer and camera.
    pub frame: Frame,
    /// Its path-traced picture, scene-linear.
    pub truth: Rgb,
    /// Its picture by a method without paths, such as deferred shading; `None` where there is none.
    pub start: Option<Rgb>,
}

/// A keyframe in relation to the frame that it is warped to.
#[derive(Clone, Copy, Debug)]
pub struct Neighbour<'a> {
    /// The keyframe.
    pub key: &'a Keyframe,
    /// Frames from the current frame to the keyframe: negative before it, positive after it, 0 where it is the keyframe.
    pub distance: f32,
    /// How objects moved from the current frame to the keyframe.
    pub movement: Movement<'a>,
}

impl Neighbour<'_> {
    /// Where each pixel of `frame` finds itself in the keyframe.
    pub fn correspond(&self, frame: &Frame) -> Correspondence {
        correspond(frame, &self.key.frame, Some(&|id| self.movement.of(id)))
    }
}

/// Age of a keyframe `distance` frames away: in units of [`AGE_UNIT`] frames, at most [`OLDEST`].
pub fn age(distance: f32) -> f32 {
    (distance.abs() / AGE_UNIT).min(OLDEST)
}

/// Where each pixel of the current frame finds itself in a keyframe.
#[derive(Clone, Debug, PartialEq)]
pub struct Correspondence {
    /// Image point in the keyframe (pixels from its top left, centres at +0.5), (0, 0) where there is none.
    pub source: Image<[f32; 2]>,
    /// Share of the bilinear footprint that shows the surface, 0..=1: the sum of the weights of these taps. It is 1 where all
    /// taps show it.
    pub valid: Image<f32>,
    /// Whether each tap shows the surface, one bit for each: left above, right above, left below, right below.
    taps: Image<u8>,
}

/// How objects moved between the current frame and the keyframe, see [`correspond`].
pub type ObjectMotion<'a> = dyn Fn(u32) -> Option<Affine3A> + Sync + 'a;

/// Correspondence of `current` into `key`, by depth and both cameras.
///
/// Motion vectors lead only from one frame to the next, but a keyframe may be many frames away. Moving objects are therefore
/// given by transforms: `object_motion` maps an object id of `current` to the rigid or affine map that takes the object's
/// world-space points at the current frame to where they were at the keyframe. `None`, for all objects or for one, means it did
/// not move. A map that is not finite means that nobody knows how it moved: then its pixels have no source.
///
/// A pixel has a source where its centre hit something and its point projects into the keyframe. A tap of the bilinear footprint
/// there shows the surface if it has the same object at the depth of the surface's plane (1 % and an allowance for slope) with a
/// world-space normal within 30 degrees. Next to silhouettes some taps do and others do not; only the former are looked up.
pub fn correspond(current: &Frame, key: &Frame, object_motion: Option<&ObjectMotion<'_>>) -> Correspondence {
    let (width, height) = (current.width, current.height);
    let mut out = Correspondence {
        source: Image::filled(width, height, [0.0; 2]),
        valid: Image::filled(width, height, 0.0),
        taps: Image::filled(width, height, 0),
    };
    let (camera, key_camera) = (&current.info.camera, &key.info.camera);
    if key.width == 0 || key.height == 0 {
        return out;
    }
    let view = KeyView { frame: key, camera: key_camera, world_to_key: key_camera.world_to_camera() };
    let row = width.max(1);
    let rows = (out.source.pixels.par_chunks_mut(row), out.valid.pixels.par_chunks_mut(row), out.taps.pixels.par_chunks_mut(row));
    rows.into_par_iter().enumerate().for_each(|(y, (source, valid, taps))| {
        let mut surfaces = Surfaces { current, camera, object_motion, last: None };
        for x in 0..width {
            let Some(surface) = surfaces.at(x, y) else { continue };
            if let Some(point) = view.locate(surface.p_world) {
                source[x] = point.to_array();
                (valid[x], taps[x]) = view.shows(point, &surface);
            }
        }
    });
    out
}

/// For each pixel of `current`, the index of the pixel of `other` that its surface point falls into; `None` where that pixel
/// shows something else.
///
/// It serves samples of path tracing, whose noise a look-up between pixels would smear: the samples of a pixel are taken whole or
/// not at all. `object_motion` is as in [`correspond`], from `current` to `other`. A pixel has a source where its centre hit
/// something, the point projects into `other`, and the pixel there shows the same object and an albedo that differs by at most
/// 0.05 and 10 % in each channel.
pub fn nearest(current: &Frame, other: &Frame, object_motion: Option<&ObjectMotion<'_>>) -> Image<Option<u32>> {
    let (width, height) = (current.width, current.height);
    let mut out = Image::filled(width, height, None);
    let (camera, other_camera) = (&current.info.camera, &other.info.camera);
    if other.width == 0 || other.height == 0 {
        return out;
    }
    let view = KeyView { frame: other, camera: other_camera, world_to_key: other_camera.world_to_camera() };
    out.pixels.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
        let mut surfaces = Surfaces { current, camera, object_motion, last: None };
        for (x, place) in row.iter_mut().enumerate() {
            let Some(surface) = surfaces.at(x, y) else { continue };
            let Some(point) = view.locate(surface.p_world) else { continue };
            let (column, line) = ((point.x as usize).min(other.width - 1), (point.y as usize).min(other.height - 1));
            let there = line * other.width + column;
            let same = other.object_id.pixels[there] == surface.id
                && other.depth.pixels[there].is_finite()
                && alike(current.albedo.pixels[y * width + x], other.albedo.pixels[there]);
            *place = same.then_some(there as u32);
        }
    });
    out
}

/// Whether two albedos may belong to one surface.
fn alike(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= ALBEDO_TOLERANCE + ALBEDO_SHARE * a.max(b))
}

/// The surface at the centre of a pixel, at its position in the other frame.
struct Surface {
    p_world: Vec3A,
    n_world: Vec3A,
    /// Position and normal in the current frame.
    here: [Vec3A; 2],
    id: u32,
}

/// Looks up the surfaces of a row of pixels.
struct Surfaces<'a> {
    current: &'a Frame,
    camera: &'a Camera,
    object_motion: Option<&'a ObjectMotion<'a>>,
    /// Motion of the last object; neighbouring pixels mostly show the same one.
    last: Option<(u32, Option<Affine3A>)>,
}

impl Surfaces<'_> {
    /// `None` where the centre of pixel (x, y) hit nothing, or an object that moved nobody knows how.
    fn at(&mut self, x: usize, y: usize) -> Option<Surface> {
        let i = y * self.current.width + x;
        let depth = self.current.depth.pixels[i];
        if !depth.is_finite() {
            return None;
        }
        let id = self.current.object_id.pixels[i];
        let motion = match self.last {
            Some((known, motion)) if known == id => motion,
            _ => self.object_motion.and_then(|motion| motion(id)),
        };
        self.last = Some((id, motion));
        let pixel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
        let mut p_world = self.camera.unproject(pixel, depth);
        let mut n_world = self.camera.camera_to_world.matrix3 * Vec3A::from_array(self.current.normal.pixels[i]);
        let here = [p_world, n_world];
        if let Some(motion) = motion {
            if !motion.is_finite() {
                return None;
            }
            p_world = motion.transform_point3a(p_world);
            n_world = moved_normal(&motion.matrix3, n_world);
        }
        Some(Surface { p_world, n_world, here, id })
    }
}

/// A normal carried by an affine map: by the inverse transpose, normalised; unchanged by a singular map.
fn moved_normal(map: &Mat3A, n: Vec3A) -> Vec3A {
    if map.determinant().abs() < 1e-12 { n } else { (map.inverse().transpose() * n).normalize_or(n) }
}

struct KeyView<'a> {
    frame: &'a Frame,
    camera: &'a Camera,
    world_to_key: Affine3A,
}

impl KeyView<'_> {
    /// Image point of a world-space point, if it lies in the picture.
    fn locate(&self, p_world: Vec3A) -> Option<Vec2> {
        let p = self.world_to_key.transform_point3a(p_world);
        let depth = -p.z;
        if depth.is_nan() || depth <= 0.0 {
            return None;
        }
        let bends = self.camera.distortion.is_some();
        let point = if bends {
            self.camera.project(p_world)?.0
        } else {
            Vec2::new(self.camera.cx + self.camera.fl_x * p.x / depth, self.camera.cy - self.camera.fl_y * p.y / depth)
        };
        let inside =
            point.x >= 0.0 && point.y >= 0.0 && point.x <= self.frame.width as f32 && point.y <= self.frame.height as f32;
        (inside && (!bends || self.reveals(point, p / depth))).then_some(point)
    }

    /// Whether the lens shows `direction` (camera space, z = -1) at `point`. Far outside of the picture its formula folds, and
    /// takes points into the picture where it shows others.
    fn reveals(&self, point: Vec2, direction: Vec3A) -> bool {
        self.camera.direction_cam(point).distance(direction) <= SAME_DIRECTION * direction.length()
    }

    /// The taps around `point` in which the keyframe shows this surface: the share of the footprint, and a bit for each.
    fn shows(&self, point: Vec2, surface: &Surface) -> (f32, u8) {
        let p = self.world_to_key.transform_point3a(surface.p_world);
        let n = self.world_to_key.matrix3 * surface.n_world;
        let depth = -p.z;
        let shown = |i: usize| {
            let seen = self.frame.depth.pixels[i];
            if self.frame.object_id.pixels[i] != surface.id || !seen.is_finite() {
                return false;
            }
            if Vec3A::from_array(self.frame.normal.pixels[i]).dot(n) < MIN_NORMAL_COSINE {
                return false;
            }
            // Depth at the tap of the plane through the point.
            let tap = Vec2::new((i % self.frame.width) as f32 + 0.5, (i / self.frame.width) as f32 + 0.5);
            let along = n.dot(self.camera.direction_cam(tap));
            let plane = if along.abs() > 1e-4 { n.dot(p) / along } else { depth };
            let change = (plane - depth).abs().min(0.1 * depth);
            let expected = depth + change.copysign(plane - depth);
            (seen - expected).abs() <= DEPTH_TOLERANCE * depth + SLOPE_TOLERANCE * change
        };
        let (mut share, mut all, mut taps) = (0.0, 0.0, 0);
        for (tap, (i, weight)) in footprint(point, self.frame.width, self.frame.height).into_iter().enumerate() {
            all += weight;
            // Taps without weight are not read, so they do no harm.
            if weight <= 0.0 || shown(i) {
                share += weight;
                taps |= 1 << tap;
            }
        }
        if share > 0.0 { (share / all, taps) } else { (0.0, 0) }
    }
}

/// The four taps (index, weight) of a bilinear look-up at `point`, weights summing to 1; taps outside the picture repeat its
/// border, taps of almost no weight get none.
fn footprint(point: Vec2, width: usize, height: usize) -> [(usize, f32); 4] {
    let at = (point - 0.5).max(Vec2::ZERO).min(Vec2::new(width as f32 - 1.0, height as f32 - 1.0));
    let (x, y) = (at.x as usize, at.y as usize);
    let (right, below) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
    let snap = |t: f32| {
        if t < LEAST_WEIGHT {
            0.0
        } else if t > 1.0 - LEAST_WEIGHT {
            1.0
        } else {
            t
        }
    };
    let (s, t) = (snap(at.x - x as f32), snap(at.y - y as f32));
    [
        (y * width + x, (1.0 - s) * (1.0 - t)),
        (y * width + right, s * (1.0 - t)),
        (below * width + x, (1.0 - s) * t),
        (below * width + right, s * t),
    ]
}

/// A look-up between the pixels of a keyframe.
#[derive(Clone, Copy)]
struct Lookup {
    point: [f32; 2],
    /// The taps that are read, as in [`Correspondence`].
    taps: u8,
}

impl Lookup {
    /// Bilinear value of `picture` from the taps that are read.
    fn sample(self, picture: &Rgb) -> Vec3A {
        let (mut sum, mut total) = (Vec3A::ZERO, 0.0);
        let taps = footprint(Vec2::from_array(self.point), picture.width, picture.height);
        for (_, (i, weight)) in taps.into_iter().enumerate().filter(|(tap, _)| self.taps >> tap & 1 == 1) {
            if weight > 0.0 {
                sum += Vec3A::from_array(picture.pixels[i]) * weight;
                total += weight;
            }
        }
        // The weights of all four taps are 1 in all, up to rounding.
        if self.taps == ALL_TAPS || total <= 0.0 { sum } else { sum / total }
    }
}

/// Bilinear fetch of `picture` (of the keyframe) at each pixel's source, from the taps that show the surface; 0 where none does.
pub fn fetch(picture: &Rgb, correspondence: &Correspondence) -> Rgb {
    per_pixel(correspondence, |_, lookup| lookup.map_or(Vec3A::ZERO, |lookup| lookup.sample(picture)))
}

/// The current start image, corrected by how far the keyframe's truth was from its own start there: `(start + e) * (key_truth +
/// e) / (key_start + e) - e`, the fraction bilinear and clamped to `1/16..=16`, the result at least 0. Also returns how much each
/// pixel can be trusted, 0..=1.
///
/// Textures and reflections come from `current_start`, at full sharpness and in their new place. Only what the start image lacks
/// (shadows, bounced light) comes from the keyframe. Where the keyframe does not show the surface, the fraction is that of the
/// pixels around, as their trust there ([`FILLED`]) says. `exposure` is the sequence's factor to display-linear; `e` is 0.01
/// there. The result is `current_start` where no fraction is finite, and exactly `key_truth` for an unmoved camera (inside the
/// clamp).
pub fn ratio_fetch(
    key_truth: &Rgb,
    key_start: &Rgb,
    current_start: &Rgb,
    correspondence: &Correspondence,
    exposure: f32,
) -> (Rgb, Image<f32>) {
    let floor = if exposure > 0.0 && exposure.is_finite() { RATIO_FLOOR / exposure } else { RATIO_FLOOR };
    let ratios = per_pixel(correspondence, |_, lookup| {
        let Some(lookup) = lookup else { return Vec3A::NAN };
        let ratio = (lookup.sample(key_truth) + floor) / (lookup.sample(key_start) + floor);
        ratio.clamp(Vec3A::splat(1.0 / MAX_RATIO), Vec3A::splat(MAX_RATIO))
    });
    let Image { width, height, .. } = ratios;
    let known = ratios.pixels.iter().zip(&correspondence.valid.pixels).map(|(ratio, valid)| {
        let known = ratio.iter().all(|v| v.is_finite());
        let logarithm = if known { ratio.map(f32::ln) } else { [0.0; 3] };
        (Vec3A::from_array(logarithm) * *valid).extend(if known { *valid } else { 0.0 })
    });
    let filled = spread(width, height, known.collect());
    let trust = |i: usize| {
        let known = ratios.pixels[i].iter().all(|v| v.is_finite());
        if known { correspondence.valid.pixels[i] } else { FILLED * f32::from(u8::from(filled[i].w > 0.0)) }
    };
    let pixel = |i: usize| {
        let start = Vec3A::from_array(current_start.pixels[i]);
        let ratio = Vec3A::from_array(ratios.pixels[i]);
        let ratio = if ratio.is_finite() { ratio } else { Vec3A::from_vec4(filled[i]).exp() };
        ((start + floor) * ratio - floor).max(Vec3A::ZERO).to_array()
    };
    let all = || (0..width * height).into_par_iter().with_min_len(1024);
    let picture = Image { width, height, pixels: all().map(pixel).collect() };
    (picture, Image { width, height, pixels: all().map(trust).collect() })
}

/// Spreads values to the pixels that have none: pulls means down a pyramid and pushes them up where finer levels know nothing
/// (Gortler et al. 1996). A pixel holds a value times its weight, and the weight, 0..=1. The result holds values, and 1 if any
/// weight was above 0.
fn spread(width: usize, height: usize, pixels: Vec<Vec4>) -> Vec<Vec4> {
    let mut levels = vec![(width, height, pixels)];
    while let Some((width, height, pixels)) = levels.last().filter(|(width, height, _)| width.max(height) > &1) {
        let (w, h) = (width.div_ceil(2), height.div_ceil(2));
        let sum = |i: usize| {
            let (x, y) = (2 * (i % w), 2 * (i / w));
            let (right, below) = ((x + 2).min(*width), (y + 2).min(*height));
            (y..below).flat_map(|y| (x..right).map(move |x| y * width + x)).map(|i| pixels[i]).sum()
        };
        let coarser = (0..w * h).map(sum).collect();
        levels.push((w, h, coarser));
    }
    // The whole picture's mean.
    let (mut w, mut h, top) = levels.pop().unwrap_or_default();
    let mut coarse: Vec<Vec4> = top.into_iter().map(|sum| if sum.w > 0.0 { sum / sum.w } else { Vec4::ZERO }).collect();
    for (width, height, pixels) in levels.into_iter().rev() {
        let value = |i: usize| {
            let at = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5) / 2.0;
            let under: Vec4 = footprint(at, w, h).into_iter().map(|(i, weight)| coarse[i] * weight).sum();
            let own = pixels[i];
            if own.w > 0.0 { under.lerp(own / own.w, own.w.min(1.0)) } else { under }
        };
        let finer = (0..width * height).into_par_iter().with_min_len(1024).map(value).collect();
        (w, h, coarse) = (width, height, finer);
    }
    coarse
}

/// Scene-linear picture of `frame` from keyframes: the warped pictures ([`carry`]) of the nearest keyframe before and the
/// nearest after, weighted by trust over age, and with a small weight `start`, the picture of `frame` by the method of
/// [`Keyframe::start`]. They are mixed in a logarithmic curve. A keyframe at distance 0 is returned as it is.
/// `exposure` is the sequence's factor to display-linear. Keyframes without a start or of another size show nothing.
///
/// # Panics
/// When a channel of `frame` or `start` does not have `frame.width * frame.height` pixels.
pub fn fill(frame: &Frame, start: &Rgb, keyframes: &[Neighbour], exposure: f32) -> Rgb {
    let size = (frame.width, frame.height);
    let usable = keyframes.iter().filter_map(|near| {
        let key_start = near.key.start.as_ref()?;
        let fits = |picture: &Rgb| (picture.width, picture.height) == size;
        let key = near.key;
        let same = (key.frame.width, key.frame.height) == size && fits(&key.truth) && fits(key_start);
        (same && !near.distance.is_nan()).then_some((near, key_start))
    });
    let usable: Vec<_> = usable.collect();
    if let Some((near, _)) = usable.iter().find(|(near, _)| near.distance == 0.0) {
        return near.key.truth.clone();
    }
    let nearest = |side: fn(f32) -> bool| {
        let candidates = usable.iter().filter(|(near, _)| side(near.distance));
        candidates.min_by(|(a, _), (b, _)| a.distance.abs().total_cmp(&b.distance.abs()))
    };
    let near = [nearest(|d| d < 0.0), nearest(|d| d > 0.0)].map(|near| near.map(|(near, _)| *near));
    let carried = near.into_iter().zip(carry(frame, Some(start), near, exposure));
    let warped: Vec<(f32, Rgb, Image<f32>)> = carried
        .filter_map(|(near, carried)| {
            let (picture, trust) = carried?.shaded?;
            Some((1.0 / (age(near?.distance) + AGE_FLOOR), picture, trust))
        })
        .collect();
    let scale = log_scale(exposure);
    let mix = |i: usize| {
        let own = start.pixels[i];
        let usable = |radiance: &[f32; 3]| radiance.iter().all(|v| v.is_finite() && *v >= 0.0);
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        if usable(&own) {
            (sum, total) = (own.map(|v| START * (scale * v).ln_1p()), START);
        }
        let mut carried = false;
        for (weight, picture, trust) in &warped {
            let radiance = picture.pixels[i];
            // Only surfaces are warped, and only finite radiance.
            if frame.alpha.pixels[i] > 0.0 && trust.pixels[i] > 0.0 && usable(&radiance) {
                let weight = weight * trust.pixels[i];
                carried = true;
                total += weight;
                (0..3).for_each(|c| sum[c] += weight * (scale * radiance[c]).ln_1p());
            }
        }
        if carried { sum.map(|v| (v / total).exp_m1() / scale) } else { own }
    };
    let pixels = (0..frame.width * frame.height).into_par_iter().with_min_len(1024).map(mix).collect();
    Rgb { width: frame.width, height: frame.height, pixels }
}

/// Scale of scene radiance in the logarithm that warped keyframes are mixed in.
fn log_scale(exposure: f32) -> f32 {
    if exposure.is_finite() && exposure > 0.0 { LOG_SCALE * exposure } else { LOG_SCALE }
}

/// A picture of `f(index, lookup)`, without a look-up where nothing shows the surface.
fn per_pixel(correspondence: &Correspondence, f: impl Fn(usize, Option<Lookup>) -> Vec3A + Sync) -> Rgb {
    let Image { width, height, pixels: sources } = &correspondence.source;
    let pixels = (sources, &correspondence.taps.pixels)
        .into_par_iter()
        .with_min_len(1024)
        .enumerate()
        .map(|(i, (point, taps))| f(i, (*taps != 0).then_some(Lookup { point: *point, taps: *taps })).to_array())
        .collect();
    Image { width: *width, height: *height, pixels }
}
