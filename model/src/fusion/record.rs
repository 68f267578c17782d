//! Records: the numbers that are known about each pixel of a frame, and the channels that the network reads from them.

use crate::bridge::{MAX_RADIANCE, log_curve_each};
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

/// Numbers of each part at [`at::PATHS`].
pub const PATHS: usize = 9;

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
    /// For each denoised picture: radiance of the surface; negative where the picture is darker than the share of the background.
    pub const DENOISED: usize = NEARBY + 4 * NEIGHBOURS;
    /// For each part, radiance of the surface divided by its reflectance, times coverage: what met two surfaces or more
    /// ([`renderflow_frame::Frame::indirect`]), and what hid from light samples ([`renderflow_frame::Frame::hidden`]). Then about
    /// the standard deviation of one sample's radiance, divided by the reflectance; samples that share a camera ray count as one.
    /// They mean nothing where [`super::Record::paths`] is false.
    pub const PATHS: usize = DENOISED + 3 * PICTURES;
    /// For each sum of neighbours, as far as the samples hold: indirect light, divided by the reflectance, times coverage. It
    /// means nothing where [`super::Record::paths`] is false.
    pub const NEARBY_INDIRECT: usize = PATHS + super::PATHS * PARTS;
    /// True radiance, denoised where a denoiser was found.
    pub const TRUTH: usize = NEARBY_INDIRECT + 3 * NEIGHBOURS;
    /// The same before it was denoised. It is noisy, but it does not share the errors of a denoiser that made inputs, too.
    pub const RAW_TRUTH: usize = TRUTH + 3;
    /// Number of values per pixel.
    pub const COUNT: usize = RAW_TRUTH + 3;
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
    /// What these samples are made of: indirect light, hidden light, and how much they vary. It requires samples.
    pub paths: bool,
}

/// Number of channels per pixel in each group: G-buffer, deferred, keys, samples, neighbours, denoised, paths.
pub const CHANNELS: [usize; 7] = [13, 18, 5 * KEYS, 5 + 6, 5 * NEIGHBOURS, 3, PATHS];

impl Groups {
    /// All groups.
    pub const ALL: Self = Self { deferred: true, keys: true, samples: true, neighbours: true, denoised: true, paths: true };

    /// Whether each group of [`CHANNELS`] is given.
    pub fn flags(self) -> [bool; 7] {
        [true, self.deferred, self.keys, self.samples, self.neighbours, self.denoised, self.paths]
    }

    /// Whether a record with the groups `there` has all of these, but for what samples are made of, which is never required.
    pub fn are_in(self, there: Self) -> bool {
        let needed = Self { paths: false, ..self };
        needed.flags().into_iter().zip(there.flags()).all(|(needed, there)| there || !needed)
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
    /// Samples of each pixel, relative to their number in `parts`, in every part of more than one sample; empty if all pixels
    /// have as many.
    pub spread: Vec<f32>,
    /// Samples per pixel of each sum of neighbours, whether they hold or not; 0 if it is not given.
    pub neighbours: [u32; NEIGHBOURS],
    /// Whether each denoised picture is given.
    pub denoised: [bool; PICTURES],
    /// Whether it is known what the samples of every part and of all neighbours are made of.
    pub paths: bool,
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
            paths: samples && self.paths,
        }
    }

    /// [`Self::spread`] of pixel `at`.
    pub fn spread_at(&self, at: usize) -> f32 {
        self.spread.get(at).copied().unwrap_or(1.0)
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
            spread: self.spread.iter().map(|spread| f16::from_f32(*spread).to_f32()).collect(),
            neighbours: self.neighbours,
            denoised: self.denoised,
            paths: self.paths,
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

    /// The samples of the frame itself and of its neighbours, for [`channels_of`].
    pub fn amounts(&self) -> [Amount; 1 + NEIGHBOURS] {
        std::array::from_fn(|n| Amount::of(if n == 0 { self.spp() } else { self.neighbours[n - 1] }))
    }
}

/// Reflectance of a surface of this albedo under uniform light: its diffuse base and the split sum (Karis 2013). On glossy
/// textured surfaces, samples divided by it vary less than samples divided by the albedo. `stored` holds the numbers of the
/// pixel.
#[inline(always)]
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
    /// Environment behind the pixel, and less where the samples, and the denoised picture if one is used, are darker than its
    /// share: the pixel then shows a darker part of it.
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
    /// Samples divided by the reflectance, and their coverage, both times the number of samples. None is negative.
    pub own: [f32; 4],
    /// The number of samples.
    pub spp: f32,
    /// What they are made of ([`at::PATHS`]): the first six numbers as in `own`, and the standard deviation of one sample.
    pub paths: [f32; PATHS],
    /// The same as `own` for each neighbour.
    pub others: [[f32; 4]; NEIGHBOURS],
    /// The part of them that is indirect light, where [`Groups::paths`] is given.
    pub others_indirect: [[f32; 3]; NEIGHBOURS],
    /// Radiance of the surface in the denoised picture, if one is used.
    pub denoised: Option<[f32; 3]>,
}

impl PixelInputs {
    /// The inputs from the [`at::COUNT`] numbers of a pixel, and its [`Record::spread`].
    #[inline(always)]
    pub fn new(stored: &[f32], selection: &Selection, spread: f32) -> Self {
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
        }
        let traced = Traced::of(stored, selection, spread);
        let denoised = groups.denoised.then(|| three(at::DENOISED + 3 * selection.picture));
        // How much darker the background is than was thought: by the samples, and at most by the denoised picture, which blurs.
        let (missed, open) = (traced.spp - traced.own[3], 1.0 - pixel.alpha);
        for (c, behind) in pixel.background.iter_mut().enumerate() {
            let darker = if missed > 0.0 { traced.own[c] * pixel.tint[c] / missed } else { 0.0 };
            let most = denoised.map_or(f32::NEG_INFINITY, |rgb| if open > 0.0 { pixel.alpha * rgb[c] / open } else { 0.0 });
            *behind = (*behind + darker.max(most).min(0.0)).max(0.0);
        }
        let positive = |[r, g, b, coverage]: [f32; 4]| [r.max(0.0), g.max(0.0), b.max(0.0), coverage];
        (pixel.own, pixel.spp, pixel.others) = (positive(traced.own), traced.spp, traced.others.map(positive));
        pixel.denoised = denoised.map(|rgb| rgb.map(|v| v.max(0.0)));
        if groups.paths {
            pixel.paths = paths_of(stored, selection, spread);
            if groups.neighbours {
                let indirect = |n: usize| three(at::NEARBY_INDIRECT + 3 * n).map(|v| selection.neighbours[n] * v.max(0.0));
                pixel.others_indirect = std::array::from_fn(indirect);
            }
        }
        pixel
    }
}

/// [`PixelInputs::paths`].
#[inline(always)]
fn paths_of(stored: &[f32], selection: &Selection, spread: f32) -> [f32; PATHS] {
    const VARIES: usize = 6;
    let (mut paths, mut varying) = ([0.0; PATHS], 0.0);
    for (part, spp) in selection.parts.iter().enumerate().filter(|(_, spp)| **spp > 0.0) {
        let stored: &[f32; PATHS] = stored[at::PATHS + PATHS * part..].first_chunk().expect("the numbers of a part");
        let spp = if *spp > 1.0 { spp * spread } else { *spp };
        (0..VARIES).for_each(|c| paths[c] += spp * stored[c].max(0.0));
        // One sample does not vary.
        if spp > 1.5 {
            varying += spp;
            (VARIES..PATHS).for_each(|c| paths[c] += spp * stored[c] * stored[c]);
        }
    }
    if varying > 0.0 {
        (VARIES..PATHS).for_each(|c| paths[c] = (paths[c] / varying).sqrt());
    }
    paths
}

/// The selected samples of a pixel, as [`PixelInputs`] has them. They are negative where samples are darker than the share of the
/// background.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Traced {
    pub own: [f32; 4],
    pub spp: f32,
    pub others: [[f32; 4]; NEIGHBOURS],
}

impl Traced {
    /// Arguments are those of [`PixelInputs::new`].
    #[inline(always)]
    pub fn of(stored: &[f32], selection: &Selection, spread: f32) -> Self {
        let mut traced = Self::default();
        if selection.groups.samples {
            for (part, spp) in selection.parts.iter().enumerate().filter(|(_, spp)| **spp > 0.0) {
                let spp = if *spp > 1.0 { spp * spread } else { *spp };
                traced.spp += spp;
                for (sum, value) in traced.own.iter_mut().zip(&stored[at::SAMPLES + 4 * part..]) {
                    *sum += spp * value;
                }
            }
        }
        if selection.groups.neighbours {
            for (n, other) in traced.others.iter_mut().enumerate() {
                *other = std::array::from_fn(|c| selection.neighbours[n] * stored[at::NEARBY + 4 * n + c]);
            }
        }
        traced
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
/// denoised, paths.
const COLOURS: usize = TERMS + 1 + KEYS + 3 + NEIGHBOURS + 1 + PATHS / 3;

/// Most channels per pixel.
pub const MOST_CHANNELS: usize = 84;
const _: () = {
    let [a, b, c, d, e, f, g] = CHANNELS;
    assert!(a + b + c + d + e + f + g == MOST_CHANNELS);
};

/// A number of samples per pixel, and the channel that tells it.
#[derive(Clone, Copy, Debug)]
pub struct Amount {
    spp: f32,
    channel: f32,
}

impl Amount {
    fn of(spp: f32) -> Self {
        Self { spp, channel: 0.3 * (1.0 + spp).ln() }
    }
}

/// The channels of a pixel as they are put together.
struct Channels<'a> {
    out: &'a mut [f32; MOST_CHANNELS],
    count: usize,
    /// Where the colours begin, to which the logarithmic curve is applied in the end.
    places: [usize; COLOURS],
    colours: usize,
}

impl Channels<'_> {
    #[inline(always)]
    fn put<const N: usize>(&mut self, values: [f32; N]) {
        self.out[self.count..self.count + N].copy_from_slice(&values);
        self.count += N;
    }

    #[inline(always)]
    fn colour(&mut self, rgb: [f32; 3]) {
        self.places[self.colours] = self.count;
        self.colours += 1;
        self.put(rgb);
    }

    /// Samples with their coverage, both times the number of samples.
    #[inline(always)]
    fn traced(&mut self, [r, g, b, coverage]: [f32; 4], amount: Amount) {
        let scale = if coverage > 0.0 { 1.0 / coverage } else { 0.0 };
        self.colour([r * scale, g * scale, b * scale]);
        self.put([if amount.spp > 0.0 { coverage / amount.spp } else { 0.0 }, amount.channel]);
    }

    #[inline(always)]
    fn curve(&mut self) {
        let mut curved = [0.0; (3 * COLOURS).next_multiple_of(16)];
        for (curved, at) in curved.chunks_exact_mut(3).zip(&self.places[..self.colours]) {
            curved.copy_from_slice(&self.out[*at..at + 3]);
        }
        log_curve_each(&mut curved[..(3 * self.colours).next_multiple_of(16)]);
        for (curved, at) in curved.chunks_exact(3).zip(&self.places[..self.colours]) {
            self.out[*at..at + 3].copy_from_slice(curved);
        }
    }
}

/// Writes the channels that the network reads from a pixel: [`Groups::channels`] numbers of about -1..=2. `amounts` are those of
/// the selection.
#[inline(always)]
pub fn channels_of(
    stored: &[f32],
    pixel: &PixelInputs,
    selection: &Selection,
    amounts: &[Amount; 1 + NEIGHBOURS],
    out: &mut [f32; MOST_CHANNELS],
) {
    let groups = selection.groups;
    if pixel.alpha <= 0.0 {
        out[..groups.channels()].fill(0.0);
        return;
    }
    let three = |from: usize| [stored[from], stored[from + 1], stored[from + 2]];
    let mut channels = Channels { out, count: 0, places: [0; COLOURS], colours: 0 };
    channels.put::<{ at::BACKGROUND }>(std::array::from_fn(|i| stored[at::ALBEDO + i]));
    if groups.deferred {
        pixel.terms.iter().for_each(|term| channels.colour(*term));
        channels.colour(three(at::SKY));
        channels.put(three(at::OPEN));
    }
    if groups.keys {
        for k in 0..KEYS {
            let there = pixel.trust[k] > f32::NEG_INFINITY;
            // Dividing by the reflectance removes the texture, which would hide differences.
            channels.colour(std::array::from_fn(|c| pixel.keys[k][c] / pixel.tint[c]));
            channels.put([
                if there { stored[at::KEYS + 4 * k + 3] } else { 0.0 },
                if there { 1.0 - 0.5 * selection.ages[k].unwrap_or(OLDEST) } else { 0.0 },
            ]);
        }
    }
    if groups.samples {
        let usual = pixel.spp == amounts[0].spp;
        channels.traced(pixel.own, if usual { amounts[0] } else { Amount::of(pixel.spp) });
        channels.colour(three(at::LIT));
        // Divided by the reflectance, as samples are.
        channels.colour(std::array::from_fn(|c| pixel.reflected[c] / pixel.tint[c]));
    }
    if groups.neighbours {
        pixel.others.iter().zip(&amounts[1..]).for_each(|(other, amount)| channels.traced(*other, *amount));
    }
    if let Some(denoised) = pixel.denoised {
        channels.colour(std::array::from_fn(|c| denoised[c] / pixel.tint[c]));
    }
    if groups.paths {
        let scale = if pixel.own[3] > 0.0 { 1.0 / pixel.own[3] } else { 0.0 };
        let [indirect, hidden, varies] = [0, 3, 6].map(|from| [pixel.paths[from], pixel.paths[from + 1], pixel.paths[from + 2]]);
        channels.colour(indirect.map(|v| v * scale));
        channels.colour(hidden.map(|v| v * scale));
        channels.colour(varies);
    }
    channels.curve();
    let count = channels.count;
    debug_assert_eq!(count, groups.channels());
    for value in &mut out[..count] {
        *value = if value.is_finite() { value.clamp(-8.0, 8.0) } else { 0.0 };
    }
}

/// Clamps a number to the range of stored radiance. NaN becomes 0.
pub fn radiance(v: f32) -> f32 {
    difference(v).max(0.0)
}

/// Clamps a difference to the range of stored radiance on both sides of 0. NaN becomes 0.
pub fn difference(v: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(-MAX_RADIANCE, MAX_RADIANCE) }
}
