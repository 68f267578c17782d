//! Batches: random crops of records, random subsets of their inputs, and augmentations that change the truth exactly as the
//! inputs (mirroring, turns, exchanged primaries, exposure, coloured light).

use super::graph::MULTIPLE;
use super::head::Picture;
use super::record::{
    ALL_BEFORE, AROUND, CHANNELS, Groups, KEYS, MOST_CHANNELS, NEIGHBOURS, PARTS, PixelInputs, Record, Selection, Stored, at,
    channels_of, difference,
};
use crate::data::step_rng;
use crate::train::Share;
use crate::train::sequences::Crop;
use crate::{Error, Result};
use half::f16;
use pulp::{Arch, NullaryFnOnce};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// A combination of groups that the network is trained on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tier {
    /// Name in logs.
    pub name: &'static str,
    /// Groups that are given. What samples are made of is given in most batches, where all records know it.
    pub groups: Groups,
    /// Share of the batches.
    pub weight: f32,
}

impl Tier {
    /// Whether a record has the inputs of this tier, and room for a crop of `size` columns and rows.
    fn takes(&self, record: &Record<f16>, size: usize) -> bool {
        self.groups.are_in(record.groups()) && record.width.min(record.height) >= size
    }
}

const NONE: Groups = Groups { deferred: false, keys: false, samples: false, neighbours: false, denoised: false, paths: false };
const DEFERRED: Groups = Groups { deferred: true, ..NONE };
const RAYS: Groups = Groups { samples: true, paths: true, ..NONE };
const DENOISED: Groups = Groups { denoised: true, ..RAYS };

const fn with_keys(groups: Groups) -> Groups {
    Groups { keys: true, ..groups }
}

const fn with_neighbours(groups: Groups) -> Groups {
    Groups { neighbours: true, ..groups }
}

/// The combinations that are trained and reported.
pub const TIERS: [Tier; 10] = [
    Tier { name: "deferred", groups: DEFERRED, weight: 0.1 },
    Tier { name: CARRIED, groups: with_keys(DEFERRED), weight: 0.15 },
    Tier { name: "rays", groups: RAYS, weight: 0.15 },
    Tier { name: "rays+keys", groups: with_keys(RAYS), weight: 0.05 },
    Tier { name: "rays+around", groups: with_neighbours(RAYS), weight: 0.1 },
    Tier { name: "rays+around+keys", groups: with_keys(with_neighbours(RAYS)), weight: 0.05 },
    Tier { name: "denoised", groups: DENOISED, weight: 0.15 },
    Tier { name: "denoised+keys", groups: with_keys(DENOISED), weight: 0.05 },
    Tier { name: "denoised+around", groups: with_neighbours(DENOISED), weight: 0.15 },
    Tier { name: "denoised+around+keys", groups: with_keys(with_neighbours(DENOISED)), weight: 0.05 },
];

/// The tier of keyframes without samples. Training leaves it out unless it is named, since inference carries keyframes over what
/// the network makes of deferred shading alone, which has less error.
const CARRIED: &str = "deferred+keys";

/// The [`TIERS`] of these names; all of them but `deferred+keys` if there is no name.
///
/// # Errors
/// [`Error::Config`] with the first name that no tier has.
pub fn tiers(names: &[String]) -> Result<Vec<Tier>> {
    if names.is_empty() {
        return Ok(TIERS.into_iter().filter(|tier| tier.name != CARRIED).collect());
    }
    let find = |name: &String| {
        let found = TIERS.into_iter().find(|tier| tier.name == name);
        found.ok_or_else(|| Error::config("tiers", format!("there is no {name:?}")))
    };
    names.iter().map(find).collect()
}

/// Share of the batches with samples that tell what the samples are made of, where records know it.
const TOLD: f64 = 0.85;
/// Largest change of exposure in stops.
const STOPS: f32 = 1.0;
/// Largest further change of the light of each primary in stops.
const TINGE: f32 = 0.5;
/// Share of the crops in which several channels may take the same primary.
const REPEATED: f64 = 0.25;
/// Number of sums of neighbours before the frame. The others are those after it.
pub const BEFORE: usize = NEIGHBOURS / 2;

/// A change of inputs and truth together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// Whether left and right are swapped.
    pub mirror: bool,
    /// Whether top and bottom are swapped.
    pub flip: bool,
    /// Whether columns become rows, after the other two. The window must be a square.
    pub transpose: bool,
    /// The primary that each colour channel takes. Light of one primary never becomes light of another, so any choice is the
    /// picture of a scene.
    pub primaries: [usize; 3],
    /// Factor of the radiance in each channel: exposure and the colour of all lights.
    pub gains: [f32; 3],
}

impl Augmentation {
    /// No change.
    pub const NONE: Self = Self { mirror: false, flip: false, transpose: false, primaries: [0, 1, 2], gains: [1.0; 3] };

    fn draw(rng: &mut Pcg64Mcg) -> Self {
        const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let [mirror, flip, transpose] = [(); 3].map(|()| rng.random_bool(0.5));
        let primaries = if rng.random_bool(REPEATED) {
            [(); 3].map(|()| rng.random_range(0..3))
        } else {
            ORDERS[rng.random_range(0..ORDERS.len())]
        };
        let exposure = rng.random_range(-STOPS..STOPS);
        let gains = [(); 3].map(|()| (exposure + rng.random_range(-TINGE..TINGE)).exp2());
        Self { mirror, flip, transpose, primaries, gains }
    }

    /// The column and the row from which the pixel at the given ones comes.
    fn source(&self, (column, row): (usize, usize), (width, height): (usize, usize)) -> (usize, usize) {
        debug_assert!(!self.transpose || width == height);
        let (across, down) = if self.transpose { (row, column) } else { (column, row) };
        (if self.mirror { width - 1 - across } else { across }, if self.flip { height - 1 - down } else { down })
    }

    /// Changes the numbers of one pixel. [`Batch::of`] moves the pixel.
    pub fn apply(&self, stored: &mut [f32]) {
        if self.mirror {
            stored[at::NORMAL] = -stored[at::NORMAL];
        }
        if self.flip {
            stored[at::NORMAL + 1] = -stored[at::NORMAL + 1];
        }
        if self.transpose {
            // Rows run downwards, and the second axis of normals upwards.
            let [x, y] = [stored[at::NORMAL], stored[at::NORMAL + 1]];
            (stored[at::NORMAL], stored[at::NORMAL + 1]) = (-y, -x);
        }
        let mut turn = |from: usize, gains: [f32; 3]| {
            let before = [stored[from], stored[from + 1], stored[from + 2]];
            (0..3).for_each(|c| stored[from + c] = difference(gains[c] * before[self.primaries[c]]));
        };
        turn(at::ALBEDO, [1.0; 3]);
        let plain = (at::BACKGROUND..at::OPEN).step_by(3).chain([at::TRUTH, at::RAW_TRUTH]);
        let denoised = (at::DENOISED..at::PATHS).step_by(3);
        let paths = (at::PATHS..at::TRUTH).step_by(3);
        let counted = (at::KEYS..at::DENOISED).step_by(4);
        plain.chain(denoised).chain(paths).chain(counted).for_each(|from| turn(from, self.gains));
    }
}

/// A window of a record.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// Left column, even.
    pub x: usize,
    /// Top row, even.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// The inputs of the network and its head for a batch of crops, and the truth.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// Number of crops.
    pub items: usize,
    /// Columns, a multiple of [`MULTIPLE`].
    pub width: usize,
    /// Rows, a multiple of [`MULTIPLE`].
    pub height: usize,
    /// Groups that are given.
    pub groups: Groups,
    /// Inputs of the network, `[items][height/2][width/2][4 groups.channels()]`. A block of four pixels holds the groups one
    /// after another, each group its four pixels, and each pixel its channels.
    pub input: Vec<f32>,
    /// Inputs of the head, `[items][height][width]`.
    pub pixels: Vec<PixelInputs>,
    /// Exposed linear radiance, `[items][height][width]`; denoised where a denoiser was found.
    pub truth: Vec<[f32; 3]>,
    /// The same before it was denoised.
    pub raw: Vec<[f32; 3]>,
}

impl Batch {
    /// Draws the crops of `kind` for one of `tiers`, and makes the `share` of this process. Returns `None` if no record has the
    /// inputs of the tier.
    pub fn draw(records: &[&Record<f16>], tiers: &[Tier], kind: Crop, share: Share, rng: &mut Pcg64Mcg) -> Option<Self> {
        let (size, items) = (kind.size, share.of(kind.batch));
        let tier = &tiers[crate::train::draw_weighted(tiers.iter().map(|tier| tier.weight), rng)];
        let fitting: Vec<&Record<f16>> = records.iter().filter(|record| tier.takes(record, size)).copied().collect();
        if fitting.is_empty() {
            return None;
        }
        let known = tier.groups.paths && fitting.iter().all(|record| record.paths);
        let wanted = Groups { paths: known && rng.random_bool(TOLD), ..tier.groups };
        let crops: Vec<_> = (0..kind.batch)
            .map(|_| {
                let (record, window) = draw_window(&fitting, size, rng);
                (record, window, draw_selection(record, wanted, rng), Augmentation::draw(rng))
            })
            .collect();
        let parts: Vec<Self> = crops[items.clone()]
            .par_iter()
            .map(|(record, window, selection, augmentation)| Self::of(record, *window, selection, augmentation))
            .collect();
        let join = |field: fn(&Self) -> &Vec<f32>| parts.iter().flat_map(|part| field(part).iter().copied()).collect();
        Some(Self {
            items: items.len(),
            width: size,
            height: size,
            groups: wanted,
            input: join(|part| &part.input),
            pixels: parts.iter().flat_map(|part| part.pixels.iter().copied()).collect(),
            truth: parts.iter().flat_map(|part| part.truth.iter().copied()).collect(),
            raw: parts.iter().flat_map(|part| part.raw.iter().copied()).collect(),
        })
    }

    /// The batch of number `number` of a run with the seed `seed`: [`Self::draw`], until a record has the inputs of the tier that
    /// was drawn. Tiers without records are left out where most draws would fail.
    ///
    /// # Errors
    /// When no record of this size has the inputs of any tier.
    pub fn numbered(
        records: &[&Record<f16>],
        tiers: &[Tier],
        kind: Crop,
        share: Share,
        [seed, number]: [u64; 2],
    ) -> Result<Self> {
        let mut rng = step_rng(seed, number);
        for _ in 0..64 {
            if let Some(batch) = Self::draw(records, tiers, kind, share, &mut rng) {
                return Ok(batch);
            }
        }
        let filled: Vec<Tier> =
            tiers.iter().filter(|tier| records.iter().any(|record| tier.takes(record, kind.size))).copied().collect();
        if !filled.is_empty()
            && let Some(batch) = Self::draw(records, &filled, kind, share, &mut rng)
        {
            return Ok(batch);
        }
        let reason = format!("no record of at least {} pixels a side has the inputs that are trained", kind.size);
        Err(Error::Data { place: "sequences".into(), reason })
    }

    /// Name of the tier whose groups are given; "other" if there is none.
    pub fn tier(&self) -> &'static str {
        TIERS
            .iter()
            .find(|tier| Groups { paths: self.groups.paths, ..tier.groups } == self.groups)
            .map_or("other", |tier| tier.name)
    }

    /// A batch of one crop. Outside the record, its last row and column are repeated.
    pub fn of<T: Stored>(record: &Record<T>, window: Window, selection: &Selection, augmentation: &Augmentation) -> Self {
        let Window { width, height, .. } = window;
        debug_assert!(width.is_multiple_of(MULTIPLE) && height.is_multiple_of(MULTIPLE));
        let channels = selection.groups.channels();
        let mut pixels = vec![PixelInputs::default(); width * height];
        let [mut truth, mut raw] = [(); 2].map(|()| vec![[0.0; 3]; width * height]);
        let mut input = vec![0.0; width * height * channels];
        // Two rows of pixels make one row of blocks.
        let rows = (
            pixels.par_chunks_mut(2 * width),
            truth.par_chunks_mut(2 * width),
            raw.par_chunks_mut(2 * width),
            input.par_chunks_mut(2 * width * channels),
        );
        rows.into_par_iter().enumerate().for_each(|(pair, (pixels, truth, raw, input))| {
            Arch::new().dispatch(Blocks { record, window, selection, augmentation, pair, pixels, truth, raw, input });
        });
        Self { items: 1, width, height, groups: selection.groups, input, pixels, truth, raw }
    }

    /// The inputs of the head for crop `item`, given the outputs of the network for the whole batch.
    pub fn picture<'a>(&'a self, item: usize, fine: &'a [f32], coarse: &'a [f32]) -> Picture<'a> {
        let part = |values: &'a [f32]| {
            let count = values.len() / self.items;
            &values[item * count..(item + 1) * count]
        };
        let count = self.width * self.height;
        Picture {
            width: self.width,
            height: self.height,
            pixels: &self.pixels[item * count..(item + 1) * count],
            groups: self.groups,
            fine: part(fine),
            coarse: part(coarse),
        }
    }
}

/// One row of blocks of a batch of one crop.
struct Blocks<'a, T> {
    record: &'a Record<T>,
    window: Window,
    selection: &'a Selection,
    augmentation: &'a Augmentation,
    /// Number of the row.
    pair: usize,
    pixels: &'a mut [PixelInputs],
    truth: &'a mut [[f32; 3]],
    raw: &'a mut [[f32; 3]],
    input: &'a mut [f32],
}

impl<T: Stored> NullaryFnOnce for Blocks<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { record, window, selection, augmentation, pair, pixels, truth, raw, input } = self;
        let Window { x, y, width, height } = window;
        let channels = selection.groups.channels();
        let mut stored = [0.0; at::COUNT];
        let mut read = [0.0; MOST_CHANNELS];
        let amounts = selection.amounts();
        let changed = *augmentation != Augmentation::NONE;
        for i in 0..2 * width {
            let (column, row) = (i % width, i / width);
            let (across, down) = augmentation.source((column, 2 * pair + row), (width, height));
            let (source, line) = ((x + across).min(record.width - 1), (y + down).min(record.height - 1));
            let place = line * record.width + source;
            T::read(&record.pixels[place * at::COUNT..][..at::COUNT], &mut stored);
            if changed {
                augmentation.apply(&mut stored);
            }
            pixels[i] = PixelInputs::new(&stored, selection, record.spread_at(place));
            let three = |from: usize| [stored[from], stored[from + 1], stored[from + 2]];
            (truth[i], raw[i]) = (three(at::TRUTH), three(at::RAW_TRUTH));
            channels_of(&stored, &pixels[i], selection, &amounts, &mut read);
            let (block, sub) = (column / 2, row * 2 + column % 2);
            let (mut from, mut to) = (0, 4 * channels * block);
            for (count, given) in CHANNELS.into_iter().zip(selection.groups.flags()) {
                if given {
                    input[to + sub * count..][..count].copy_from_slice(&read[from..from + count]);
                    from += count;
                    to += 4 * count;
                }
            }
        }
    }
}

/// Draws a window in which at least one point in eight shows a surface, with up to four attempts: the network learns nothing from
/// sky.
fn draw_window<'a>(records: &[&'a Record<f16>], size: usize, rng: &mut Pcg64Mcg) -> (&'a Record<f16>, Window) {
    let mut tries = 0;
    loop {
        let record = records[rng.random_range(0..records.len())];
        let mut even = |room: usize| 2 * rng.random_range(0..=room / 2);
        let window = Window { x: even(record.width - size), y: even(record.height - size), width: size, height: size };
        let step = size / 8;
        let covered = |i: &usize| {
            let (x, y) = (window.x + (i % 8) * step, window.y + (i / 8) * step);
            record.pixels[(y * record.width + x) * at::COUNT + at::ALPHA] > f16::ZERO
        };
        tries += 1;
        if tries == 4 || (0..64).filter(covered).count() >= 8 {
            return (record, window);
        }
    }
}

/// Draws a subset of the inputs of a record: any number of parts, and neighbours on both sides or only before the frame. With
/// neighbours, which have as many samples as the first part, it takes that part alone. With a denoised picture, it takes the
/// samples from which that picture was made.
fn draw_selection(record: &Record<f16>, groups: Groups, rng: &mut Pcg64Mcg) -> Selection {
    let mut selection = Selection { groups, ..Selection::all(record) };
    let there = record.parts.iter().filter(|spp| **spp > 0).count();
    let before_alone = rng.random_bool(0.3);
    let (mut first, mut keep) = (rng.random_range(0..there.max(1)), rng.random_range(1..=there.max(1)));
    if groups.neighbours {
        first = 0;
    }
    if groups.neighbours || groups.denoised {
        keep = 1;
    }
    if groups.denoised {
        selection.picture = match (groups.neighbours, before_alone) {
            (false, _) => first,
            (true, false) => AROUND,
            (true, true) => ALL_BEFORE,
        };
    }
    for part in 0..PARTS {
        let used = part < there && (part + there - first) % there < keep;
        selection.parts[part] = if used { record.parts[part] as f32 } else { 0.0 };
    }
    for (n, spp) in selection.neighbours.iter_mut().enumerate() {
        *spp = if groups.neighbours && (n < BEFORE || !before_alone) { record.neighbours[n] as f32 } else { 0.0 };
    }
    // In one batch of five, one keyframe is used alone.
    if KEYS == 2 && rng.random_bool(0.2) {
        selection.ages[1] = None;
    }
    selection
}

#[cfg(test)]
mod tests {
    use super::super::record::{PATHS, PICTURES};
    use super::*;
    use rand::SeedableRng;

    fn crop(size: usize, batch: usize) -> Crop {
        Crop { size, batch, from: 0.0 }
    }

    fn record(width: usize, height: usize, seed: u64) -> Record<f32> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut record = Record::new(width, height);
        record.pixels.iter_mut().for_each(|v| *v = rng.random_range(0.1..1.0));
        record.deferred = true;
        record.distances = [Some(-3.0), Some(13.0)];
        record.parts = [2; PARTS];
        record.neighbours = [2; NEIGHBOURS];
        record.denoised = [true; PICTURES];
        record.paths = true;
        record
    }

    /// Reading an augmented record gives the mirrored, exchanged and scaled values of the plain record.
    #[test]
    fn augmentations_are_exact() {
        let record = record(16, 16, 3);
        let window = Window { x: 0, y: 0, width: 16, height: 16 };
        let changes = Augmentation { primaries: [2, 0, 0], gains: [0.5, 2.0, 4.0], ..Augmentation::NONE };
        let augmentation = Augmentation { mirror: true, ..changes };
        let selection = Selection::all(&record);
        let (plain, changed) =
            (Batch::of(&record, window, &selection, &Augmentation::NONE), Batch::of(&record, window, &selection, &augmentation));
        for i in 0..256 {
            let mirrored = i / 16 * 16 + 15 - i % 16;
            let (a, b) = (&plain.pixels[mirrored], &changed.pixels[i]);
            for c in 0..3 {
                let (from, gain) = (augmentation.primaries[c], augmentation.gains[c]);
                assert_eq!(b.background[c], gain * a.background[from]);
                assert_eq!(b.tint[c], a.tint[from]);
                assert_eq!((b.own[c], b.own[3]), (gain * a.own[from], a.own[3]));
                assert_eq!(b.reflected[c], gain * a.reflected[from]);
                assert_eq!(b.terms[2][c], gain * a.terms[2][from]);
                assert_eq!(b.keys[1][c], gain * a.keys[1][from]);
                assert_eq!(b.others[3][c], gain * a.others[3][from]);
                assert_eq!(b.denoised.unwrap()[c], gain * a.denoised.unwrap()[from]);
                (0..3).for_each(|k| assert!((b.paths[3 * k + c] - gain * a.paths[3 * k + from]).abs() < 1e-4));
                assert_eq!(changed.truth[i][c], gain * plain.truth[mirrored][from]);
                assert_eq!(changed.raw[i][c], gain * plain.raw[mirrored][from]);
            }
        }
    }

    /// Normals turn with the picture: surfaces that face away from its middle still do.
    #[test]
    fn normals_turn_with_the_picture() {
        let mut record = record(16, 16, 3);
        // Each pixel faces away from the middle. Rows run downwards, and the second axis of normals upwards.
        for (i, stored) in record.pixels.chunks_exact_mut(at::COUNT).enumerate() {
            let [right, down] = [i % 16, i / 16].map(|at| (2.0 * at as f32 - 15.0) / 32.0);
            stored[at::NORMAL..at::NORMAL + 3].copy_from_slice(&[right, -down, 0.5]);
            stored[at::ALPHA] = 1.0;
        }
        let groups = Groups::default();
        let selection = Selection { groups, ..Selection::all(&record) };
        let window = Window { x: 0, y: 0, width: 16, height: 16 };
        let normals = |augmentation: &Augmentation| {
            let batch = Batch::of(&record, window, &selection, augmentation);
            let channels = groups.channels();
            let pixel = move |i: usize| {
                let (column, row) = (i % 16, i / 16);
                4 * channels * (row / 2 * 8 + column / 2) + channels * (row % 2 * 2 + column % 2)
            };
            (0..256).map(|i| batch.input[pixel(i) + at::NORMAL..][..3].to_vec()).collect::<Vec<_>>()
        };
        let plain = normals(&Augmentation::NONE);
        for bits in 0..8 {
            let [mirror, flip, transpose] = [0, 1, 2].map(|bit| bits >> bit & 1 == 1);
            assert_eq!(normals(&Augmentation { mirror, flip, transpose, ..Augmentation::NONE }), plain, "{bits}");
        }
        // The pixels themselves move.
        let turned = Augmentation { mirror: true, transpose: true, ..Augmentation::NONE };
        let truth = |augmentation: &Augmentation| Batch::of(&record, window, &selection, augmentation).truth;
        assert_eq!(truth(&turned)[3 * 16 + 5], truth(&Augmentation::NONE)[5 * 16 + 12]);
    }

    #[test]
    fn batches_have_what_their_tier_reads_and_nothing_else() {
        let record = record(64, 48, 5).to_half();
        let mut bare = record.clone();
        (bare.deferred, bare.distances) = (false, [None; KEYS]);
        for tier in TIERS {
            let mut rng = Pcg64Mcg::seed_from_u64(1);
            let batch =
                Batch::draw(&[&bare, &record], &[tier], crop(32, 3), Share::WHOLE, &mut rng).expect("a record has everything");
            let groups = Groups { paths: batch.groups.paths, ..tier.groups };
            assert_eq!((batch.items, batch.pixels.len(), batch.groups), (3, 3 * 1024, groups));
            assert_eq!((batch.input.len(), batch.tier()), (3 * 1024 * groups.channels(), tier.name));
            // Most batches tell what samples are made of.
            let told = (0..40).filter(|_| {
                let batch =
                    Batch::draw(&[&record], &[tier], crop(32, 1), Share::WHOLE, &mut rng).expect("a record has everything");
                assert_eq!(batch.groups.paths, batch.pixels.iter().any(|pixel| pixel.paths != [0.0; PATHS]));
                batch.groups.paths
            });
            assert!(if tier.groups.samples { (21..40).contains(&told.count()) } else { told.count() == 0 }, "{}", tier.name);
            assert!(batch.pixels.iter().any(|pixel| pixel.own[3] > 0.0) == tier.groups.samples);
            assert!(batch.pixels.iter().any(|pixel| pixel.trust[0].is_finite()) == tier.groups.keys);
            assert!(batch.pixels.iter().all(|pixel| pixel.denoised.is_some()) == tier.groups.denoised);
            assert!(
                Batch::draw(&[&bare], &[tier], crop(32, 1), Share::WHOLE, &mut rng).is_some()
                    != (tier.groups.deferred || tier.groups.keys)
            );
        }
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        assert!(Batch::draw(&[&record], &TIERS, crop(64, 1), Share::WHOLE, &mut rng).is_none());
        assert!(Batch::numbered(&[&record], &TIERS, crop(64, 1), Share::WHOLE, [1, 0]).is_err());
        // A tier that is seldom drawn is the only one with records.
        let mut seldom = TIERS.to_vec();
        seldom[0].weight = 1e-6;
        let mut shaded = Record::<f32>::new(64, 48).to_half();
        shaded.deferred = true;
        let batch = Batch::numbered(&[&shaded], &seldom, crop(32, 1), Share::WHOLE, [1, 0]).expect("a record has this");
        assert_eq!(batch.tier(), "deferred");
    }
}
