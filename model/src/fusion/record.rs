//! What is known of a frame, a record of numbers a pixel, and what the network reads of it.

use crate::bridge::{MAX_RADIANCE, log_curves};
use half::f16;
use half::slice::HalfFloatSliceExt;
use renderflow_frame::ibl;

/// Keyframes that are carried: the nearest before and the nearest after.
pub const KEYS: usize = 2;
/// Renders of independent samples that a record holds, at most.
pub const PARTS: usize = 4;
/// Neighbouring frames whose samples a record holds, at most.
pub const NEIGHBOURS: usize = 4;
/// Denoised pictures that a record holds, at most: one of each part alone, then [`AROUND`] and [`ALL_BEFORE`].
pub const PICTURES: usize = PARTS + 2;
/// Of the denoised pictures, the one of the first part with all neighbours.
pub const AROUND: usize = PARTS;
/// Of the denoised pictures, the one of the first part with the neighbours before the frame.
pub const ALL_BEFORE: usize = PARTS + 1;
/// Terms of deferred shading that get a factor of their own: lights, diffuse sky, reflections, bounced light.
pub const TERMS: usize = 4;

/// Added to the albedo where keyframes are divided by it: what a dielectric reflects without its base.
pub const TINT: f32 = 0.04;
/// Least of what samples are divided by.
const LEAST: f32 = 0.02;
/// Frames that count as age 1, and the largest age.
const AGE: [f32; 2] = [16.0, 2.0];

/// Where the numbers of a pixel begin. Radiance is exposed and linear, 0..=65504.
pub mod at {
    use super::{KEYS, NEIGHBOURS, PARTS, PICTURES};

    /// Base colour over the pixel, 0..=1.
    pub const ALBEDO: usize = 0;
    /// Normal over the pixel in camera space, shorter than 1 where it varies.
    pub const NORMAL: usize = 3;
    /// Half the logarithm of depth over the frame's median, -2..=2.
    pub const DEPTH: usize = 6;
    /// Roughness, metallic, specular.
    pub const MATERIAL: usize = 7;
    /// Scale and bias of the split sum.
    pub const BRDF: usize = 10;
    /// Coverage.
    pub const ALPHA: usize = 12;
    /// Environment behind the pixel.
    pub const BACKGROUND: usize = 13;
    /// Irradiance of the environment over pi, nothing in its way.
    pub const LIT: usize = BACKGROUND + 3;
    /// What the surface mirrors of the environment by the split sum, nothing in its way.
    pub const REFLECTED: usize = LIT + 3;
    /// Deferred terms, three channels each: lights, diffuse sky, reflections, bounced light.
    pub const TERMS: usize = REFLECTED + 3;
    /// Irradiance of the sky without the lights over pi, nothing in its way.
    pub const SKY: usize = TERMS + 3 * super::TERMS;
    /// Open share of the sky, of the near hemisphere; seen share of the strongest light.
    pub const OPEN: usize = SKY + 3;
    /// Of each keyframe carried over deferred shading: radiance of the surface, validity.
    pub const KEYS_SHADED: usize = OPEN + 3;
    /// The same carried over the albedo.
    pub const KEYS_TINTED: usize = KEYS_SHADED + 4 * KEYS;
    /// Of each part: radiance of the surface over its tint ([`super::tint`]), times coverage; coverage.
    pub const SAMPLES: usize = KEYS_TINTED + 4 * KEYS;
    /// The same of each neighbour; coverage 0 where it does not show this surface.
    pub const NEARBY: usize = SAMPLES + 4 * PARTS;
    /// Of each denoised picture: radiance of the surface.
    pub const DENOISED: usize = NEARBY + 4 * NEIGHBOURS;
    /// True radiance.
    pub const TRUTH: usize = DENOISED + 3 * PICTURES;
    /// Numbers a pixel.
    pub const COUNT: usize = TRUTH + 3;
}

/// Which groups of inputs are given besides the G-buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Groups {
    /// Terms of deferred shading.
    pub deferred: bool,
    /// Carried keyframes.
    pub keys: bool,
    /// Traced samples of the frame, and with them what the environment alone gives.
    pub samples: bool,
    /// Samples of its neighbours; only where there are some of its own.
    pub neighbours: bool,
    /// A picture that another denoiser made of these samples; only where there are some.
    pub denoised: bool,
}

/// Channels a pixel that the network reads of each group: G-buffer, deferred, keys, samples, neighbours, denoised.
pub const CHANNELS: [usize; 6] = [13, 18, 5 * KEYS, 5 + 6, 5 * NEIGHBOURS, 3];

impl Groups {
    /// Whether each of the groups of [`CHANNELS`] is there.
    pub fn flags(self) -> [bool; 6] {
        [true, self.deferred, self.keys, self.samples, self.neighbours, self.denoised]
    }

    /// Channels a pixel of the groups that are there.
    pub fn channels(self) -> usize {
        CHANNELS.iter().zip(self.flags()).filter(|(_, given)| *given).map(|(channels, _)| channels).sum()
    }
}

/// One frame. `T` is `f32` where it is rendered, `f16` where it is kept to learn from.
#[derive(Clone, Debug, Default)]
pub struct Record<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width][at::COUNT]`; 0 where a group is not given.
    pub pixels: Vec<T>,
    /// Whether there are deferred terms.
    pub deferred: bool,
    /// Frames to each keyframe, where there is one.
    pub distances: [Option<f32>; KEYS],
    /// Samples a pixel of each part, 0 = not there.
    pub parts: [u32; PARTS],
    /// Samples a pixel of each neighbour, 0 = not there.
    pub neighbours: [u32; NEIGHBOURS],
    /// Which denoised pictures are there.
    pub denoised: [bool; PICTURES],
}

impl<T> Record<T> {
    /// What is given.
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

    /// In half precision.
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

impl Record<f16> {
    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        2 * self.pixels.len()
    }
}

/// What is selection of a record for one picture.
#[derive(Clone, Copy, Debug)]
pub struct Selection {
    /// Groups.
    pub groups: Groups,
    /// Age of each keyframe (see [`age`]), where it is used.
    pub ages: [Option<f32>; KEYS],
    /// Which parts.
    pub parts: [bool; PARTS],
    /// Samples a pixel of the selection parts.
    pub spp: f32,
    /// Samples a pixel of each neighbour, 0 where it is not used.
    pub neighbours: [f32; NEIGHBOURS],
    /// Which denoised picture; read only where the groups have one.
    pub picture: usize,
}

impl Selection {
    /// Everything that `record` has; of several denoised pictures the first.
    pub fn all<T>(record: &Record<T>) -> Self {
        let groups = record.groups();
        Self {
            groups,
            ages: record.distances.map(|distance| distance.map(age)),
            parts: record.parts.map(|spp| spp > 0),
            spp: record.parts.iter().sum::<u32>() as f32,
            neighbours: record.neighbours.map(|spp| if groups.neighbours { spp as f32 } else { 0.0 }),
            picture: record.denoised.iter().position(|there| *there).unwrap_or(0),
        }
    }
}

/// Age of a keyframe `distance` frames away: in units of 16 frames, 2 at most.
pub fn age(distance: f32) -> f32 {
    (distance.abs() / AGE[0]).min(AGE[1])
}

/// What a surface of this albedo in a pixel reflects of light that is the same from everywhere: diffuse base and split sum (Karis 2013).
/// Samples over it vary less than samples over the albedo where a textured surface shines. `stored` is the pixel's record.
pub fn tint(albedo: [f32; 3], stored: &[f32]) -> [f32; 3] {
    let [_, metallic, specular] = [stored[at::MATERIAL], stored[at::MATERIAL + 1], stored[at::MATERIAL + 2]];
    let f0 = ibl::f0(albedo, metallic, specular);
    std::array::from_fn(|c| albedo[c] * (1.0 - metallic) + f0[c] * stored[at::BRDF] + stored[at::BRDF + 1] + LEAST)
}

/// What the head acts on in one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelInputs {
    /// Coverage.
    pub alpha: f32,
    /// Environment behind the pixel.
    pub background: [f32; 3],
    /// What filtered samples are multiplied with.
    pub tint: [f32; 3],
    /// What the surface mirrors of the environment, nothing in its way.
    pub reflected: [f32; 3],
    /// Deferred terms.
    pub terms: [[f32; 3]; TERMS],
    /// Carried keyframes.
    pub keys: [[f32; 3]; KEYS],
    /// Logarithm of the weight that each keyframe has at first; minus infinity where it shows nothing.
    pub trust: [f32; KEYS],
    /// Samples over the tint and their coverage, both times the number of samples.
    pub own: [f32; 4],
    /// The same of each neighbour.
    pub others: [[f32; 4]; NEIGHBOURS],
    /// Radiance of the surface in the denoised picture, where there is one.
    pub denoised: Option<[f32; 3]>,
}

impl PixelInputs {
    /// Of one record of [`at::COUNT`] numbers.
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
            let from = keys_at(groups);
            for k in 0..KEYS {
                let valid = stored[from + 4 * k + 3];
                if let (Some(age), true) = (selection.ages[k], valid > 0.0) {
                    pixel.keys[k] = three(from + 4 * k);
                    pixel.trust[k] = -(age + 1.0 / AGE[0]).ln();
                }
            }
        }
        if groups.samples {
            pixel.reflected = three(at::REFLECTED);
            let used = selection.parts.iter().filter(|part| **part).count().max(1) as f32;
            let scale = selection.spp / used;
            for part in (0..PARTS).filter(|part| selection.parts[*part]) {
                for (sum, value) in pixel.own.iter_mut().zip(&stored[at::SAMPLES + 4 * part..]) {
                    *sum += scale * value;
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

/// Numbers of a pixel in either precision.
pub trait Stored: Copy + Send + Sync {
    /// As single precision.
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

/// Which of the two ways to carry keyframes is read: over deferred shading where that is there.
fn keys_at(groups: Groups) -> usize {
    if groups.deferred { at::KEYS_SHADED } else { at::KEYS_TINTED }
}

/// Colours that the network reads of a pixel, at most: terms, sky, keyframes, samples and what the environment gives, neighbours,
/// denoised.
const COLOURS: usize = TERMS + 1 + KEYS + 3 + NEIGHBOURS + 1;

/// Appends what the network reads of a pixel, [`Groups::channels`] numbers of about -1..=2.
pub fn push_channels(stored: &[f32], pixel: &PixelInputs, selection: &Selection, out: &mut Vec<f32>) {
    let groups = selection.groups;
    let covered = pixel.alpha > 0.0;
    let before = out.len();
    if !covered {
        out.resize(before + groups.channels(), 0.0);
        return;
    }
    // Colours go through the curve together.
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
            // Over the tint, so that texture does not hide what differs.
            let rgb: [f32; 3] = std::array::from_fn(|c| pixel.keys[k][c] / pixel.tint[c]);
            colour(rgb, out);
            out.push(f32::from(u8::from(there)));
            out.push(if there { 1.0 - 0.5 * selection.ages[k].unwrap_or(AGE[1]) } else { 0.0 });
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
        // As samples are: over the tint.
        let reflected = std::array::from_fn(|c| pixel.reflected[c] / pixel.tint[c]);
        traced(pixel.own, selection.spp, &[lit, reflected], out);
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

/// A number that may be stored as radiance.
pub fn radiance(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(0.0, MAX_RADIANCE) }
}
