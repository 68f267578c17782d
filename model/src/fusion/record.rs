//! Records: the numbers that are known about each pixel of a frame, and the channels that the network reads from them.

use crate::bridge::{MAX_RADIANCE, log_curves};
use half::f16;
use half::slice::HalfFloatSliceExt;
use renderflow_frame::ibl;
use renderflow_frame::warp::{AGE_UNIT, OLDEST, age};

/// Number of keyframes: the nearest before the frame and the nearest after it.
pub const KEYS: usize = 2;
/// Most parts in a record. A part is a render with independent samples.
pub const PARTS: usize = 4;
/// Sums of samples of neighbouring frames that a record holds: of the nearest frame before and of all others before, and the same
/// after.
pub const NEIGHBOURS: usize = 4;
/// Most denoised pictures in a record: one for each part, then [`AROUND`] and [`ALL_BEFORE`].
pub const PICTURES: usize = PARTS + 2;
/// Index of the denoised picture of the first part with samples of frames before and after.
pub const AROUND: usize = PARTS;
/// Index of the denoised picture of the first part with samples of frames before.
pub const ALL_BEFORE: usize = PARTS + 1;
/// Number of terms of deferred shading, each with its own factor: lights, diffuse sky, reflections, bounced light.
pub const TERMS: usize = 4;

/// Added to the reflectance before samples are divided by it.
const LEAST: f32 = 0.02;

/// Indices of the numbers of a pixel. Radiance is exposed and linear, 0..=65504.
pub mod at {
    use super::{NEIGHBOURS, PARTS, PICTURES};

    /// Mean base colour in the pixel, 0..=1.
    pub const ALBEDO: usize = 0;
    /// Mean normal in the pixel, in camera space. It is shorter than 1 where normals vary.
    pub const NORMAL: usize = 3;
    /// Half the logarithm of depth divided by the frame's median depth, -2..=2.
    pub const DEPTH: usize = 6;
    /// Roughness, metallic, specular.
    pub const MATERIAL: usize = 7;
    /// Scale and bias of the split sum.
    pub const BRDF: usize = 10;
    /// Coverage.
    pub const ALPHA: usize = 12;
    /// Environment behind the pixel.
    pub const BACKGROUND: usize = 13;
    /// Unoccluded irradiance of the environment, divided by pi.
    pub const LIT: usize = BACKGROUND + 3;
    /// Unoccluded specular reflection of the environment, by the split sum.
    pub const REFLECTED: usize = LIT + 3;
    /// Terms of deferred shading, three channels each: lights, diffuse sky, reflections, bounced light.
    pub const TERMS: usize = REFLECTED + 3;
    /// Unoccluded irradiance of the sky without the lights, divided by pi.
    pub const SKY: usize = TERMS + 3 * super::TERMS;
    /// Visible share of the sky, of the near hemisphere, and of the strongest light.
    pub const OPEN: usize = SKY + 3;
    /// For each keyframe, warped with the help of the split sum: radiance of the surface, and the trust in it, 0..=1 (see
    /// [`renderflow_frame::warp::carry`]).
    pub const KEYS: usize = OPEN + 3;
    /// For each part: radiance of the surface divided by its reflectance ([`super::tint`]), times coverage; coverage.
    pub const SAMPLES: usize = KEYS + 4 * super::KEYS;
    /// The same for each sum of neighbours, as far as the samples hold. Coverage is 0 where no neighbour shows this surface.
    pub const NEARBY: usize = SAMPLES + 4 * PARTS;
    /// For each denoised picture: radiance of the surface.
    pub const DENOISED: usize = NEARBY + 4 * NEIGHBOURS;
    /// True radiance.
    pub const TRUTH: usize = DENOISED + 3 * PICTURES;
    /// Number of values per pixel.
    pub const COUNT: usize = TRUTH + 3;
}

/// The groups of inputs that are given besides the G-buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Groups {
    /// Terms of deferred shading.
    pub deferred: bool,
    /// Warped keyframes.
    pub keys: bool,
    /// Traced samples of the frame, with the unoccluded light of the environment.
    pub samples: bool,
    /// Samples of neighbouring frames. They require samples of the frame itself.
    pub neighbours: bool,
    /// A picture that another denoiser made from these samples. It requires samples.
    pub denoised: bool,
}

/// Number of channels per pixel in each group: G-buffer, deferred, keys, samples, neighbours, denoised.
pub const CHANNELS: [usize; 6] = [13, 18, 5 * KEYS, 5 + 6, 5 * NEIGHBOURS, 3];

impl Groups {
    /// All groups.
    pub const ALL: Self = Self { deferred: true, keys: true, samples: true, neighbours: true, denoised: true };

    /// Whether each group of [`CHANNELS`] is given.
    pub fn flags(self) -> [bool; 6] {
        [true, self.deferred, self.keys, self.samples, self.neighbours, self.denoised]
    }

    /// Number of channels per pixel in the groups that are given.
    pub fn channels(self) -> usize {
        CHANNELS.iter().zip(self.flags()).filter(|(_, given)| *given).map(|(channels, _)| channels).sum()
    }
}

/// What is known about one frame. `T` is `f32` for rendering, and `f16` for training data.
#[derive(Clone, Debug, Default)]
pub struct Record<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width][at::COUNT]`. The numbers of groups that are not given are 0.
    pub pixels: Vec<T>,
    /// Whether terms of deferred shading are given.
    pub deferred: bool,
    /// Distance to each keyframe in frames, negative before the frame; `None` if there is no such keyframe.
    pub distances: [Option<f32>; KEYS],
    /// Samples per pixel of each part; 0 if it is not given.
    pub parts: [u32; PARTS],
    /// Samples per pixel of each sum of neighbours, whether they hold or not; 0 if it is not given.
    pub neighbours: [u32; NEIGHBOURS],
    /// Whether each denoised picture is given.
    pub denoised: [bool; PICTURES],
}

impl<T> Record<T> {
    /// The groups that are given.
    pub fn groups(&self) -> Groups {
        let samples = self.parts[0] > 0;
        Groups {
            deferred: self.deferred,
            keys: self.distances.iter().any(Option::is_some),
            samples,
            neighbours: samples && self.neighbours.iter().any(|&spp| spp > 0),
            denoised: samples && self.denoised.contains(&true),
        }
    }
}

impl Record<f32> {
    /// An empty record of a frame.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0.0; width * height * at::COUNT], ..Self::default() }
    }

    /// The record in half precision.
    pub fn to_half(&self) -> Record<f16> {
        let mut pixels = vec![f16::ZERO; self.pixels.len()];
        pixels.convert_from_f32_slice(&self.pixels);
        Record {
            width: self.width,
            height: self.height,
            pixels,
            deferred: self.deferred,
            distances: self.distances,
            parts: self.parts,
            neighbours: self.neighbours,
            denoised: self.denoised,
        }
    }
}

/// The part of a record that one picture is rendered from.
#[derive(Clone, Copy, Debug)]
pub struct Selection {
    /// Groups that are used.
    pub groups: Groups,
    /// Age of each keyframe (see [`age`]); `None` if it is not used.
    pub ages: [Option<f32>; KEYS],
    /// Samples per pixel of each part; 0 if it is not used.
    pub parts: [f32; PARTS],
    /// Samples per pixel of each sum of neighbours; 0 if it is not used.
    pub neighbours: [f32; NEIGHBOURS],
    /// Index of the denoised picture. It is read only if the groups include one.
    pub picture: usize,
}

impl Selection {
    /// Everything in `record`, with the first of its denoised pictures.
    pub fn all<T>(record: &Record<T>) -> Self {
        let groups = record.groups();
        Self {
            groups,
            ages: record.distances.map(|distance| distance.map(age)),
            parts: record.parts.map(|spp| spp as f32),
            neighbours: record.neighbours.map(|spp| if groups.neighbours { spp as f32 } else { 0.0 }),
            picture: record.denoised.iter().position(|there| *there).unwrap_or(0),
        }
    }

    /// Samples per pixel of the frame itself.
    pub fn spp(&self) -> f32 {
        self.parts.iter().sum()
    }
}

/// Reflectance of a surface of this albedo under uniform light: its diffuse base and the split sum (Karis 2013). On glossy
/// textured surfaces, samples divided by it vary less than samples divided by the albedo. `stored` holds the numbers of the
/// pixel.
pub fn tint(albedo: [f32; 3], stored: &[f32]) -> [f32; 3] {
    let [_, metallic, specular] = [stored[at::MATERIAL], stored[at::MATERIAL + 1], stored[at::MATERIAL + 2]];
    let f0 = ibl::f0(albedo, metallic, specular);
    std::array::from_fn(|c| albedo[c] * (1.0 - metallic) + f0[c] * stored[at::BRDF] + stored[at::BRDF + 1] + LEAST)
}

/// The inputs of the head in one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelInputs {
    /// Coverage.
    pub alpha: f32,
    /// Environment behind the pixel.
    pub background: [f32; 3],
    /// Reflectance ([`tint`]) by which filtered samples are multiplied.
    pub tint: [f32; 3],
    /// Unoccluded specular reflection of the environment.
    pub reflected: [f32; 3],
    /// Terms of deferred shading.
    pub terms: [[f32; 3]; TERMS],
    /// Warped keyframes.
    pub keys: [[f32; 3]; KEYS],
    /// Logarithm of each keyframe's weight before training; minus infinity where the keyframe shows nothing.
    pub trust: [f32; KEYS],
    /// Samples divided by the reflectance, and their coverage, both times the number of samples.
    pub own: [f32; 4],
    /// The same for each neighbour.
    pub others: [[f32; 4]; NEIGHBOURS],
    /// Radiance of the surface in the denoised picture, if one is used.
    pub denoised: Option<[f32; 3]>,
}

impl PixelInputs {
    /// The inputs from the [`at::COUNT`] numbers of a pixel.
    pub fn new(stored: &[f32], selection: &Selection) -> Self {
        let three = |from: usize| [stored[from], stored[from + 1], stored[from + 2]];
        let mut pixel = Self {
            alpha: stored[at::ALPHA],
            background: three(at::BACKGROUND),
            tint: tint(three(at::ALBEDO), stored),
            trust: [f32::NEG_INFINITY; KEYS],
            ..Self::default()
        };
        let groups = selection.groups;
        if groups.deferred {
            pixel.terms = std::array::from_fn(|term| three(at::TERMS + 3 * term));
        }
        if groups.keys {
            for k in 0..KEYS {
                let valid = stored[at::KEYS + 4 * k + 3];
                if let (Some(age), true) = (selection.ages[k], valid > 0.0) {
                    pixel.keys[k] = three(at::KEYS + 4 * k);
                    pixel.trust[k] = valid.min(1.0).ln() - (age + 1.0 / AGE_UNIT).ln();
                }
            }
        }
        if groups.samples {
            pixel.reflected = three(at::REFLECTED);
            for (part, spp) in selection.parts.iter().enumerate().filter(|(_, spp)| **spp > 0.0) {
                for (sum, value) in pixel.own.iter_mut().zip(&stored[at::SAMPLES + 4 * part..]) {
                    *sum += spp * value;
                }
            }
        }
        if groups.neighbours {
            for (n, other) in pixel.others.iter_mut().enumerate() {
                *other = std::array::from_fn(|c| selection.neighbours[n] * stored[at::NEARBY + 4 * n + c]);
            }
        }
        pixel.denoised = groups.denoised.then(|| three(at::DENOISED + 3 * selection.picture));
        pixel
    }
}

/// A number of a record, in either precision.
pub trait Stored: Copy + Send + Sync {
    /// Converts numbers to single precision.
    fn read(from: &[Self], to: &mut [f32]);
}

impl Stored for f32 {
    fn read(from: &[Self], to: &mut [f32]) {
        to.copy_from_slice(from);
    }
}

impl Stored for f16 {
    fn read(from: &[Self], to: &mut [f32]) {
        from.convert_to_f32_slice(to);
    }
}

/// Most colours that the network reads from a pixel: terms, sky, keyframes, samples, light of the environment, neighbours,
/// denoised.
const COLOURS: usize = TERMS + 1 + KEYS + 3 + NEIGHBOURS + 1;

/// Appends the channels that the network reads from a pixel: [`Groups::channels`] numbers of about -1..=2.
pub fn push_channels(stored: &[f32], pixel: &PixelInputs, selection: &Selection, out: &mut Vec<f32>) {
    let groups = selection.groups;
    let covered = pixel.alpha > 0.0;
    let before = out.len();
    if !covered {
        out.resize(before + groups.channels(), 0.0);
        return;
    }
    // The logarithmic curve is applied to all colours together.
    let (mut places, mut count) = ([0; COLOURS], 0);
    let mut colour = |rgb: [f32; 3], out: &mut Vec<f32>| {
        places[count] = out.len();
        count += 1;
        out.extend(rgb);
    };
    out.extend_from_slice(&stored[at::ALBEDO..at::BACKGROUND]);
    if groups.deferred {
        for term in pixel.terms {
            colour(term, out);
        }
        colour([stored[at::SKY], stored[at::SKY + 1], stored[at::SKY + 2]], out);
        out.extend_from_slice(&stored[at::OPEN..at::OPEN + 3]);
    }
    if groups.keys {
        for k in 0..KEYS {
            let there = pixel.trust[k] > f32::NEG_INFINITY;
            // Dividing by the reflectance removes the texture, which would hide differences.
            let rgb: [f32; 3] = std::array::from_fn(|c| pixel.keys[k][c] / pixel.tint[c]);
            colour(rgb, out);
            out.push(if there { stored[at::KEYS + 4 * k + 3] } else { 0.0 });
            out.push(if there { 1.0 - 0.5 * selection.ages[k].unwrap_or(OLDEST) } else { 0.0 });
        }
    }
    let mut traced = |[r, g, b, coverage]: [f32; 4], spp: f32, light: &[[f32; 3]], out: &mut Vec<f32>| {
        let scale = if coverage > 0.0 { 1.0 / coverage } else { 0.0 };
        colour([r, g, b].map(|v| v * scale), out);
        out.push(if spp > 0.0 { coverage / spp } else { 0.0 });
        out.push(0.3 * (1.0 + spp).ln());
        light.iter().for_each(|rgb| colour(*rgb, out));
    };
    if groups.samples {
        let lit = [stored[at::LIT], stored[at::LIT + 1], stored[at::LIT + 2]];
        // Divided by the reflectance, as samples are.
        let reflected = std::array::from_fn(|c| pixel.reflected[c] / pixel.tint[c]);
        traced(pixel.own, selection.spp(), &[lit, reflected], out);
    }
    if groups.neighbours {
        for (other, spp) in pixel.others.iter().zip(selection.neighbours) {
            traced(*other, spp, &[], out);
        }
    }
    if let Some(denoised) = pixel.denoised {
        colour(std::array::from_fn(|c| denoised[c] / pixel.tint[c]), out);
    }
    debug_assert_eq!(out.len() - before, groups.channels());
    let mut curved = [0.0; (3 * COLOURS).next_multiple_of(16)];
    for (curved, at) in curved.chunks_exact_mut(3).zip(&places[..count]) {
        curved.copy_from_slice(&out[*at..at + 3]);
    }
    log_curves(&mut curved[..(3 * count).next_multiple_of(16)]);
    for (curved, at) in curved.chunks_exact(3).zip(&places[..count]) {
        out[*at..at + 3].copy_from_slice(curved);
    }
    for value in &mut out[before..] {
        *value = if value.is_finite() { value.clamp(-8.0, 8.0) } else { 0.0 };
    }
}

/// Clamps a number to the range of stored radiance. NaN becomes 0.
pub fn radiance(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(0.0, MAX_RADIANCE) }
}
