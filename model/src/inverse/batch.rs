//! Batches: random crops of examples, with augmentations that change the picture as the buffers (mirroring, permuted primaries)
//! or the picture alone (exposure, noise).

use super::example::{Example, Truth};
use super::graph::{CHANNELS, place};
use super::head::Pixel;
use super::loss::Target;
use crate::network::init::normal;
use crate::train::Share;
use crate::train::sequences::Crop;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use renderflow_frame::color::{display, linear_to_srgb};

/// Standard deviation of the exposure, stops.
const STOPS: f32 = 0.3;
/// Largest standard deviation of the noise, in display values. Half of the crops have none.
const NOISE: f32 = 0.02;
/// A mean normal shorter than this says nothing.
const SHORT: f32 = 0.1;

/// A change of an example.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// Whether left and right are swapped.
    pub mirror: bool,
    /// The primary that each colour channel takes.
    pub primaries: [usize; 3],
    /// Factor of the radiance.
    pub gain: f32,
    /// Standard deviation of noise in display values, and its seed.
    pub noise: (f32, u64),
}

impl Augmentation {
    /// No change.
    pub const NONE: Self = Self { mirror: false, primaries: [0, 1, 2], gain: 1.0, noise: (0.0, 0) };

    fn draw(rng: &mut Pcg64Mcg) -> Self {
        const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        Self {
            mirror: rng.random_bool(0.5),
            primaries: ORDERS[rng.random_range(0..ORDERS.len())],
            gain: (STOPS * normal(rng)).exp2(),
            noise: (if rng.random_bool(0.5) { rng.random_range(0.0..NOISE) } else { 0.0 }, rng.random()),
        }
    }

    /// Changes a pixel. Mirroring also moves the pixel, which [`Batch::of`] does.
    pub fn apply(&self, truth: &mut Truth) {
        if self.mirror {
            truth.normal[0] = -truth.normal[0];
        }
        truth.albedo = self.primaries.map(|from| truth.albedo[from]);
        truth.radiance = self.primaries.map(|from| self.gain * truth.radiance[from]);
    }
}

/// The inputs of the network for a batch of crops, and the truth.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// Number of crops.
    pub items: usize,
    /// Columns of a crop, even.
    pub width: usize,
    /// Rows of a crop, even.
    pub height: usize,
    /// Inputs of the network, `[items][height/2][width/2][4 CHANNELS]`, as [`place`] says.
    pub input: Vec<f32>,
    /// Display values, `[items][height][width]`.
    pub display: Vec<[f32; 3]>,
    /// True buffers, `[items][height][width]`.
    pub targets: Vec<Target>,
}

/// Place of a pixel in a picture: -1..=1 along the longer side, 0 in the middle.
fn position(x: usize, y: usize, size: [usize; 2]) -> [f32; 2] {
    let half = 0.5 * size[0].max(size[1]) as f32;
    [(x, size[0]), (y, size[1])].map(|(at, size)| (at as f32 + 0.5 - 0.5 * size as f32) / half)
}

/// Writes the inputs of the pixel in column `x` and row `y` of a picture of `size`.
pub(super) fn write_input(input: &mut [f32], rgb: [f32; 3], [x, y]: [usize; 2], size: [usize; 2], mirror: bool) {
    let [u, v] = position(x, y, size);
    input[..3].copy_from_slice(&rgb.map(|v| 2.0 * v - 1.0));
    input[3] = if mirror { -u } else { u };
    input[4] = v;
}

impl Batch {
    /// Draws the crops of `kind`, and makes the `share` of this process. Returns `None` if no example is as large as a crop.
    pub fn draw(examples: &[&Example], kind: Crop, share: Share, rng: &mut Pcg64Mcg) -> Option<Self> {
        let (size, items) = (kind.size, share.of(kind.batch));
        let fitting: Vec<&Example> =
            examples.iter().filter(|example| example.width.min(example.height) >= size).copied().collect();
        if fitting.is_empty() {
            return None;
        }
        let crops: Vec<_> = (0..kind.batch)
            .map(|_| {
                let (example, corner) = draw_corner(&fitting, size, rng);
                (example, corner, Augmentation::draw(rng))
            })
            .collect();
        let of = |(example, corner, augmentation): &(&Example, [usize; 2], Augmentation)| {
            Self::of(example, *corner, [size, size], augmentation)
        };
        let parts: Vec<Self> = crops[items.clone()].par_iter().map(of).collect();
        Some(Self {
            items: items.len(),
            width: size,
            height: size,
            input: parts.iter().flat_map(|part| part.input.iter().copied()).collect(),
            display: parts.iter().flat_map(|part| part.display.iter().copied()).collect(),
            targets: parts.iter().flat_map(|part| part.targets.iter().copied()).collect(),
        })
    }

    /// A batch of one crop, whose sides are even. Outside the example, its last row and column are repeated.
    pub fn of(example: &Example, [x0, y0]: [usize; 2], [width, height]: [usize; 2], augmentation: &Augmentation) -> Self {
        debug_assert!(width.is_multiple_of(2) && height.is_multiple_of(2));
        let mut batch = Self {
            items: 1,
            width,
            height,
            input: vec![0.0; width * height * CHANNELS],
            display: Vec::with_capacity(width * height),
            targets: Vec::with_capacity(width * height),
        };
        let mut noise = crate::data::step_rng(augmentation.noise.1, 0);
        for y in 0..height {
            for x in 0..width {
                let column = x0 + if augmentation.mirror { width - 1 - x } else { x };
                let mut truth = example.at(column.min(example.width - 1), (y0 + y).min(example.height - 1));
                augmentation.apply(&mut truth);
                let mut rgb = display(truth.radiance, 1.0);
                if augmentation.noise.0 > 0.0 {
                    rgb = rgb.map(|v| (v + augmentation.noise.0 * normal(&mut noise)).clamp(0.0, 1.0));
                }
                let input = &mut batch.input[place(width, CHANNELS, x, y)..][..CHANNELS];
                write_input(input, rgb, [column, y0 + y], [example.width, example.height], augmentation.mirror);
                batch.display.push(rgb);
                batch.targets.push(target(&truth));
            }
        }
        batch
    }
}

/// The buffers that a pixel should have.
pub(super) fn target(truth: &Truth) -> Target {
    let length = truth.normal.iter().map(|v| v * v).sum::<f32>().sqrt();
    let normal = if length > SHORT { truth.normal.map(|v| v / length) } else { [0.0; 3] };
    let albedo = truth.albedo.map(|v| linear_to_srgb(v.clamp(0.0, 1.0)));
    Target { pixel: Pixel { albedo, normal, depth: truth.depth, material: truth.material }, weight: truth.alpha }
}

/// Draws a crop in which at least one point in eight shows a surface, with up to four attempts: the network learns nothing from
/// sky.
fn draw_corner<'a>(examples: &[&'a Example], size: usize, rng: &mut Pcg64Mcg) -> (&'a Example, [usize; 2]) {
    let mut tries = 0;
    loop {
        let example = examples[rng.random_range(0..examples.len())];
        let corner = [rng.random_range(0..=example.width - size), rng.random_range(0..=example.height - size)];
        let step = size / 8;
        let covered = |i: &usize| example.alpha(corner[0] + (i % 8) * step, corner[1] + (i / 8) * step) > 0.0;
        tries += 1;
        if tries == 4 || (0..64).filter(covered).count() >= 8 {
            return (example, corner);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::Record;
    use crate::fusion::record::at;
    use rand::SeedableRng;

    fn example(width: usize, height: usize, seed: u64) -> Example {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut record = Record::<f32>::new(width, height);
        record.pixels.iter_mut().for_each(|v| *v = rng.random_range(0.1..1.0));
        record.pixels.chunks_exact_mut(at::COUNT).for_each(|stored| stored[at::ALPHA] = 1.0);
        Example::of(&record.to_half())
    }

    #[test]
    fn augmentations_are_exact() {
        let example = example(16, 12, 3);
        let augmentation = Augmentation { mirror: true, primaries: [2, 0, 1], gain: 0.5, noise: (0.0, 0) };
        let [plain, changed] =
            [Augmentation::NONE, augmentation].map(|augmentation| Batch::of(&example, [0, 0], [16, 12], &augmentation));
        for i in 0..192 {
            let (x, y) = (i % 16, i / 16);
            let mirrored = y * 16 + 15 - x;
            let (a, b) = (&plain.targets[mirrored].pixel, &changed.targets[i].pixel);
            assert_eq!(b.albedo, augmentation.primaries.map(|from| a.albedo[from]));
            assert_eq!(b.normal, [-a.normal[0], a.normal[1], a.normal[2]]);
            assert_eq!((b.depth, b.material), (a.depth, a.material));
            let radiance = example.at(15 - x, y).radiance;
            assert_eq!(changed.display[i], display(augmentation.primaries.map(|from| 0.5 * radiance[from]), 1.0));
            let at = |batch: &Batch, x: usize| batch.input[place(16, CHANNELS, x, y)..][..CHANNELS].to_vec();
            // The place is mirrored with the picture.
            assert_eq!(at(&changed, x)[3], -at(&plain, 15 - x)[3]);
            assert_eq!(at(&changed, x)[4], at(&plain, 15 - x)[4]);
        }
    }

    fn crop(size: usize, batch: usize) -> Crop {
        Crop { size, batch, from: 0.0 }
    }

    #[test]
    fn batches_depend_on_the_seed_alone() {
        let (small, large) = (example(32, 32, 1), example(80, 70, 2));
        let draw = |seed: u64| {
            Batch::draw(&[&small, &large], crop(64, 3), Share::WHOLE, &mut Pcg64Mcg::seed_from_u64(seed)).expect("a crop fits")
        };
        let (a, b) = (draw(4), draw(4));
        assert!(a.input == b.input && a.targets == b.targets && a.input != draw(5).input);
        assert_eq!((a.items, a.display.len()), (3, 3 * 64 * 64));
        assert!(Batch::draw(&[&small], crop(64, 1), Share::WHOLE, &mut Pcg64Mcg::seed_from_u64(1)).is_none());
    }
}
