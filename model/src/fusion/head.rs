//! The head: it computes the picture from the outputs of the network, and the derivative of a loss with respect to the outputs
//! from its derivative with respect to the picture.
//!
//! The head has no parameters and needs few operations per pixel, so it runs fused on the host. Let `M` be the samples of the
//! frame and its neighbours, blended with predicted weights: radiance divided by the reflectance, times coverage, and coverage.
//! For each scale `l` of 1, 2 and 4 pixels, the samples are filtered by
//!
//! `F_l(x) = sum_j exp(k_l(x, j)) M_l(x + j) / sum_j exp(k_l(x, j)) coverage_l(x + j)`, with j over 5 x 5 pixels.
//!
//! Pixels that see no surface therefore have no influence. The three scales are enlarged bilinearly and blended. The candidates
//! are these filtered samples, the specular reflection of the environment, the picture of another denoiser, the warped keyframes,
//! and the sum of the terms of deferred shading, each times `exp(g)`. They are mixed with softmax weights. Then a share of the
//! specular reflection and a residual times the reflectance are added, and the environment is put behind the surface. The
//! specular reflection is a candidate because kernels blur reflections, and the split sum does not.

mod filter;

pub use filter::KERNEL;

use super::record::{Groups, KEYS, NEIGHBOURS, PixelInputs, TERMS};
use crate::bridge::MAX_RADIANCE;
use crate::kernels::exp_each;
use filter::{NOTHING, Scale, filter, four, quarter, taps, unfilter};
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

/// Number of scales.
const SCALES: usize = 3;
/// Number of candidates that every picture has: filtered samples, keyframes, deferred shading. With samples there are two more:
/// the specular reflection of the environment, and the denoised picture.
const CANDIDATES: usize = 2 + KEYS;
const MIRRORED: usize = CANDIDATES;
const DENOISED: usize = CANDIDATES + 1;
const MIXED: usize = CANDIDATES + 2;

/// Number of outputs per pixel: for every picture, added by samples, and added by neighbours.
const BASE: usize = CANDIDATES + TERMS + 3;
const TRACED: usize = KERNEL + SCALES + 3;
const MERGE: usize = 1 + NEIGHBOURS;

/// Largest absolute logarithm of a factor.
const MOST: f32 = 4.0;
/// Logits of samples and of keyframes before training. The logit of deferred shading is 0.
const TRUST: [f32; 2] = [5.0, 3.0];
/// Logit of the denoised picture before training.
const TRUST_DENOISED: f32 = 8.0;
/// Logit of the finest scale before training.
const FINEST: f32 = 1.0;

/// Number of outputs at half size for these groups: four pixels, and with samples the kernel of scale 2.
pub fn fine(groups: Groups) -> usize {
    let traced = if groups.samples { 4 * TRACED + KERNEL } else { 0 };
    4 * BASE + traced + if groups.neighbours { 4 * MERGE } else { 0 }
}

/// The inputs of the head for one picture or crop. Width and height are even, and with samples multiples of 4.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width]`.
    pub pixels: &'a [PixelInputs],
    /// Groups that are given.
    pub groups: Groups,
    /// `[height/2][width/2][fine(groups)]`.
    pub fine: &'a [f32],
    /// `[height/4][width/4][KERNEL]`; empty without samples.
    pub coarse: &'a [f32],
}

/// The part of the forward pass that the backward pass needs.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    scales: Vec<Scale>,
}

/// Derivatives of a loss.
struct Derivatives {
    /// With respect to [`Picture::fine`].
    fine: Vec<f32>,
    /// With respect to [`Picture::coarse`].
    coarse: Vec<f32>,
    /// With respect to the filtered samples of each scale.
    filtered: Vec<Vec<[f32; 3]>>,
}

/// The outputs that mix the candidates of one pixel, after their non-linearities.
struct Mix {
    weights: [f32; MIXED],
    factors: [f32; TERMS],
    candidates: [[f32; 3]; MIXED],
    /// Share of the specular reflection that is added.
    shine: f32,
    /// Weights of the scales.
    scales: [f32; SCALES],
}

impl Picture<'_> {
    /// The outputs of pixel `i` that every picture has.
    #[inline(always)]
    fn base(&self, i: usize) -> &[f32] {
        let (block, sub) = self.place(i);
        &self.fine[block * fine(self.groups) + sub * BASE..][..BASE]
    }

    /// Index of the first output of pixel `i` that samples add.
    #[inline(always)]
    fn traced_at(&self, i: usize) -> usize {
        let (block, sub) = self.place(i);
        block * fine(self.groups) + 4 * BASE + sub * TRACED
    }

    #[inline(always)]
    fn merge_at(&self, i: usize) -> usize {
        let (block, sub) = self.place(i);
        block * fine(self.groups) + 4 * BASE + 4 * TRACED + KERNEL + sub * MERGE
    }

    /// Index of the kernel of pixel `i` of a scale in the outputs of that scale.
    #[inline(always)]
    fn kernel_at(&self, scale: usize, i: usize) -> usize {
        match scale {
            0 => self.traced_at(i),
            1 => i * fine(self.groups) + 4 * BASE + 4 * TRACED,
            _ => i * KERNEL,
        }
    }

    #[inline(always)]
    fn kernel(&self, scale: usize, i: usize) -> &[f32] {
        let outputs = if scale == 2 { self.coarse } else { self.fine };
        &outputs[self.kernel_at(scale, i)..][..KERNEL]
    }

    /// The block of 2 x 2 pixels that a pixel is in, and its index in the block.
    #[inline(always)]
    fn place(&self, i: usize) -> (usize, usize) {
        let (x, y) = (i % self.width, i / self.width);
        ((y / 2) * (self.width / 2) + x / 2, (y % 2) * 2 + x % 2)
    }

    /// Weights of the frame's own samples and of its neighbours. Absent neighbours have no coverage, so their weights do not
    /// matter.
    #[inline(always)]
    fn merging(&self, i: usize) -> [f32; MERGE] {
        if !self.groups.neighbours {
            return std::array::from_fn(|n| if n == 0 { 1.0 } else { 0.0 });
        }
        let logits = &self.fine[self.merge_at(i)..][..MERGE];
        softmax(std::array::from_fn(|n| logits[n]))
    }

    #[inline(always)]
    fn merged(&self, i: usize) -> [f32; 4] {
        let (pixel, weights) = (&self.pixels[i], self.merging(i));
        let mut sum = pixel.own.map(|v| v * weights[0]);
        for (other, weight) in pixel.others.iter().zip(&weights[1..]) {
            for (sum, value) in sum.iter_mut().zip(other) {
                *sum += weight * value;
            }
        }
        sum
    }

    #[inline(always)]
    fn mix(&self, i: usize, scales: &[Scale]) -> Mix {
        let (pixel, outputs) = (&self.pixels[i], self.base(i));
        let (logits, factors) = (&outputs[..CANDIDATES], &outputs[CANDIDATES..CANDIDATES + TERMS]);
        let mut mix = Mix {
            weights: [f32::NEG_INFINITY; MIXED],
            factors: [1.0; TERMS],
            candidates: [[0.0; 3]; MIXED],
            shine: 0.0,
            scales: [0.0; SCALES],
        };
        if self.groups.samples {
            let outputs = &self.fine[self.traced_at(i) + KERNEL..][..SCALES + 3];
            mix.scales = softmax([outputs[0] + FINEST, outputs[1], outputs[2]]);
            mix.candidates[MIRRORED] = pixel.reflected;
            mix.weights[MIRRORED] = outputs[SCALES];
            mix.shine = outputs[SCALES + 1];
            if let Some(denoised) = pixel.denoised {
                mix.candidates[DENOISED] = denoised;
                mix.weights[DENOISED] = outputs[SCALES + 2] + TRUST_DENOISED;
            }
            let filtered = self.filtered(i, &mix.scales, scales);
            if filtered[3] > NOTHING {
                mix.candidates[0] = std::array::from_fn(|c| filtered[c] * pixel.tint[c]);
                mix.weights[0] = logits[0] + TRUST[0];
            }
        }
        if self.groups.keys {
            for k in 0..KEYS {
                mix.candidates[1 + k] = pixel.keys[k];
                mix.weights[1 + k] = logits[1 + k] + TRUST[1] + pixel.trust[k];
            }
        }
        if self.groups.deferred {
            mix.factors = exp(std::array::from_fn(|term| factors[term].clamp(-MOST, MOST)));
            for (term, factor) in pixel.terms.iter().zip(mix.factors) {
                (0..3).for_each(|c| mix.candidates[1 + KEYS][c] += term[c] * factor);
            }
            mix.weights[1 + KEYS] = logits[1 + KEYS];
        }
        mix.weights = softmax(mix.weights);
        mix
    }

    /// The blended filtered samples at pixel `i`, divided by the reflectance, and the sum of their weights.
    #[inline(always)]
    fn filtered(&self, i: usize, shares: &[f32; SCALES], scales: &[Scale]) -> [f32; 4] {
        let mut sum = [0.0; 4];
        for (scale, share) in scales.iter().zip(shares) {
            for (at, weight) in taps(i, self.width, scale) {
                let there = scale.filtered[at];
                // A pixel without samples has no influence.
                let weight = share * weight * f32::from(u8::from(there[3] > NOTHING));
                (0..3).for_each(|c| sum[c] += weight * there[c]);
                sum[3] += weight;
            }
        }
        if sum[3] > NOTHING { [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], sum[3]] } else { [0.0; 4] }
    }

    /// The picture, exposed and linear, 0..=65504.
    pub fn draw(&self) -> (Vec<[f32; 3]>, Tape) {
        let mut scales = Vec::new();
        if self.groups.samples {
            let merged = each_pixel(&Merged(self), self.width, self.pixels.len());
            scales.push(Scale { width: self.width, height: self.height, merged, filtered: Vec::new() });
            for level in 1..SCALES {
                let finer = &scales[level - 1];
                let (width, height) = (finer.width / 2, finer.height / 2);
                let merged = (0..width * height).map(|i| quarter(finer, i, width)).collect();
                scales.push(Scale { width, height, merged, filtered: Vec::new() });
            }
            for (level, scale) in scales.iter_mut().enumerate() {
                scale.filtered = each_pixel(&Filtered { picture: self, level, scale }, scale.width, scale.merged.len());
            }
        }
        (each_pixel(&Composed { picture: self, scales: &scales }, self.width, self.pixels.len()), Tape { scales })
    }

    /// The colour of a pixel that a surface covers, before it is clamped.
    #[inline(always)]
    fn compose(&self, i: usize, mix: &Mix) -> [f32; 3] {
        let (pixel, residual) = (&self.pixels[i], &self.base(i)[CANDIDATES + TERMS..]);
        std::array::from_fn(|c| {
            let mixed: f32 = mix.candidates.iter().zip(mix.weights).map(|(candidate, weight)| candidate[c] * weight).sum();
            let added = pixel.tint[c] * residual[c] + mix.shine * pixel.reflected[c];
            let value = pixel.alpha * (mixed + added) + (1.0 - pixel.alpha) * pixel.background[c];
            if value.is_nan() { 0.0 } else { value }
        })
    }

    /// The derivatives of a loss with respect to `fine` and `coarse`, given its derivatives with respect to the pixels of
    /// [`Self::draw`].
    pub fn backward(&self, tape: &Tape, slopes: &[[f32; 3]]) -> (Vec<f32>, Vec<f32>) {
        Arch::new().dispatch(Backward { picture: self, scales: &tape.scales, slopes })
    }

    #[inline(always)]
    fn propagate(&self, scales: &[Scale], slopes: &[[f32; 3]]) -> (Vec<f32>, Vec<f32>) {
        let mut found = Derivatives {
            fine: vec![0.0; self.fine.len()],
            coarse: vec![0.0; self.coarse.len()],
            filtered: scales.iter().map(|scale| vec![[0.0; 3]; scale.merged.len()]).collect(),
        };
        for (i, slope) in slopes.iter().enumerate() {
            let pixel = &self.pixels[i];
            if pixel.alpha <= 0.0 || slope.iter().all(|v| *v == 0.0) {
                continue;
            }
            let mix = self.mix(i, scales);
            let value = self.compose(i, &mix);
            // Clamped values have no derivative.
            let d: [f32; 3] =
                std::array::from_fn(|c| if value[c] > 0.0 && value[c] < MAX_RADIANCE { slope[c] * pixel.alpha } else { 0.0 });
            let (block, sub) = self.place(i);
            let base = block * fine(self.groups) + sub * BASE;
            let along: [f32; MIXED] = std::array::from_fn(|k| (0..3).map(|c| d[c] * mix.candidates[k][c]).sum());
            let mean: f32 = along.iter().zip(mix.weights).map(|(v, w)| v * w).sum();
            for (k, along) in along[..CANDIDATES].iter().enumerate() {
                found.fine[base + k] = mix.weights[k] * (along - mean);
            }
            if self.groups.deferred {
                let weight = mix.weights[1 + KEYS];
                for (term, factor) in mix.factors.iter().enumerate() {
                    let inside = self.base(i)[CANDIDATES + term].abs() < MOST;
                    let slope: f32 = (0..3).map(|c| d[c] * pixel.terms[term][c]).sum();
                    found.fine[base + CANDIDATES + term] = if inside { weight * factor * slope } else { 0.0 };
                }
            }
            for (c, d) in d.iter().enumerate() {
                found.fine[base + CANDIDATES + TERMS + c] = d * pixel.tint[c];
            }
            if self.groups.samples {
                let at = self.traced_at(i) + KERNEL + SCALES;
                found.fine[at] = mix.weights[MIRRORED] * (along[MIRRORED] - mean);
                found.fine[at + 1] = along[MIRRORED];
                found.fine[at + 2] = mix.weights[DENOISED] * (along[DENOISED] - mean);
                let d: [f32; 3] = std::array::from_fn(|c| d[c] * mix.weights[0] * pixel.tint[c]);
                self.spread(i, &mix, d, scales, &mut found);
            }
        }
        if self.groups.samples {
            let mut merged: Vec<[f32; 4]> = Vec::new();
            for level in (0..SCALES).rev() {
                let scale = &scales[level];
                let mut into = vec![[0.0; 4]; scale.merged.len()];
                let out = if level == 2 { &mut found.coarse } else { &mut found.fine };
                for (i, d) in found.filtered[level].iter().enumerate() {
                    if d.iter().any(|v| *v != 0.0) {
                        let at = self.kernel_at(level, i);
                        let kernel = self.kernel(level, i);
                        unfilter(scale, i, kernel, *d, &mut out[at..at + KERNEL], &mut into);
                    }
                }
                // The pixels from which the coarser scale was averaged.
                for (j, d) in merged.iter().enumerate() {
                    for at in four(j, scale.width / 2, scale.width) {
                        (0..4).for_each(|c| into[at][c] += 0.25 * d[c]);
                    }
                }
                merged = into;
            }
            if self.groups.neighbours {
                for (i, d) in merged.iter().enumerate() {
                    let (pixel, weights) = (&self.pixels[i], self.merging(i));
                    let dot = |v: &[f32; 4]| (0..4).map(|c| d[c] * v[c]).sum::<f32>();
                    let along: [f32; MERGE] =
                        std::array::from_fn(|n| if n == 0 { dot(&pixel.own) } else { dot(&pixel.others[n - 1]) });
                    let mean: f32 = along.iter().zip(weights).map(|(v, w)| v * w).sum();
                    let at = self.merge_at(i);
                    for n in 0..MERGE {
                        found.fine[at + n] = weights[n] * (along[n] - mean);
                    }
                }
            }
        }
        (found.fine, found.coarse)
    }

    /// Propagates `d`, the derivative with respect to the blended samples of pixel `i`, to the filtered samples of each scale and
    /// to the weights of the scales.
    #[inline(always)]
    fn spread(&self, i: usize, mix: &Mix, d: [f32; 3], scales: &[Scale], found: &mut Derivatives) {
        let blended = self.filtered(i, &mix.scales, scales);
        if blended[3] <= NOTHING {
            return;
        }
        let mut along = [0.0; SCALES];
        for (level, scale) in scales.iter().enumerate() {
            for (at, weight) in taps(i, self.width, scale) {
                let there = scale.filtered[at];
                if there[3] <= NOTHING {
                    continue;
                }
                let share = weight / blended[3];
                for c in 0..3 {
                    along[level] += share * d[c] * (there[c] - blended[c]);
                    found.filtered[level][at][c] += mix.scales[level] * share * d[c];
                }
            }
        }
        let mean: f32 = along.iter().zip(mix.scales).map(|(v, w)| v * w).sum();
        let at = self.traced_at(i) + KERNEL;
        for (level, along) in along.iter().enumerate() {
            found.fine[at + level] = mix.scales[level] * (along - mean);
        }
    }
}

/// What is computed for every pixel of a picture or a scale. All that it calls is inlined, so that it is compiled for the
/// processor.
trait Pixels: Sync {
    type Value: Clone + Default + Send;
    fn at(&self, i: usize) -> Self::Value;
}

/// `what` for the first `count` pixels, in rows of `width`.
fn each_pixel<P: Pixels>(what: &P, width: usize, count: usize) -> Vec<P::Value> {
    let mut values = vec![P::Value::default(); count];
    let rows = values.par_chunks_mut(width.max(1)).enumerate();
    rows.for_each(|(y, row)| Arch::new().dispatch(Row { what, first: y * width, row }));
    values
}

/// The pixels of a row, from the pixel `first` on.
struct Row<'a, P: Pixels> {
    what: &'a P,
    first: usize,
    row: &'a mut [P::Value],
}

impl<P: Pixels> NullaryFnOnce for Row<'_, P> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (x, value) in self.row.iter_mut().enumerate() {
            *value = self.what.at(self.first + x);
        }
    }
}

/// The samples of a pixel and of its neighbours, blended.
struct Merged<'a>(&'a Picture<'a>);

impl Pixels for Merged<'_> {
    type Value = [f32; 4];

    #[inline(always)]
    fn at(&self, i: usize) -> [f32; 4] {
        self.0.merged(i)
    }
}

/// The filtered samples of a scale.
struct Filtered<'a> {
    picture: &'a Picture<'a>,
    level: usize,
    scale: &'a Scale,
}

impl Pixels for Filtered<'_> {
    type Value = [f32; 4];

    #[inline(always)]
    fn at(&self, i: usize) -> [f32; 4] {
        // At the finest scale, only the pixel itself reads this.
        if self.level == 0 && self.picture.pixels[i].alpha <= 0.0 {
            return [0.0; 4];
        }
        filter(self.scale, i, self.picture.kernel(self.level, i))
    }
}

/// The picture.
struct Composed<'a> {
    picture: &'a Picture<'a>,
    scales: &'a [Scale],
}

impl Pixels for Composed<'_> {
    type Value = [f32; 3];

    #[inline(always)]
    fn at(&self, i: usize) -> [f32; 3] {
        let pixel = &self.picture.pixels[i];
        let value = if pixel.alpha > 0.0 { self.picture.compose(i, &self.picture.mix(i, self.scales)) } else { pixel.background };
        value.map(|v| v.clamp(0.0, MAX_RADIANCE))
    }
}

/// [`Picture::propagate`], compiled for the processor.
struct Backward<'a> {
    picture: &'a Picture<'a>,
    scales: &'a [Scale],
    slopes: &'a [[f32; 3]],
}

impl NullaryFnOnce for Backward<'_> {
    type Output = (Vec<f32>, Vec<f32>);

    #[inline(always)]
    fn call(self) -> Self::Output {
        self.picture.propagate(self.scales, self.slopes)
    }
}

/// Softmax. The result is 0 if every logit is minus infinity.
#[inline(always)]
fn softmax<const N: usize>(logits: [f32; N]) -> [f32; N] {
    let most = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if most == f32::NEG_INFINITY {
        return [0.0; N];
    }
    let weights = exp(logits.map(|v| v - most));
    let total: f32 = weights.iter().sum();
    weights.map(|v| v / total)
}

/// Exponentials of at most 16 numbers. Minus infinity gives 0.
#[inline(always)]
fn exp<const N: usize>(of: [f32; N]) -> [f32; N] {
    let mut values = [0.0; 16];
    values[..N].copy_from_slice(&of);
    exp_each(&mut values);
    std::array::from_fn(|i| if of[i] == f32::NEG_INFINITY { 0.0 } else { values[i] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn random_pixel(rng: &mut Pcg64Mcg, groups: Groups) -> PixelInputs {
        let mut rgb = || std::array::from_fn(|_| rng.random_range(0.05..1.0));
        let mut pixel = PixelInputs { background: rgb(), tint: rgb(), reflected: rgb(), ..PixelInputs::default() };
        pixel.terms = std::array::from_fn(|_| rgb());
        pixel.keys = std::array::from_fn(|_| rgb());
        pixel.trust = [f32::NEG_INFINITY; KEYS];
        let traced = |rng: &mut Pcg64Mcg| {
            let coverage: f32 = if rng.random_bool(0.2) { 0.0 } else { rng.random_range(0.2..1.0) };
            [0, 1, 2, 3].map(|c| if c == 3 { coverage } else { coverage * rng.random_range(0.0..3.0f32) })
        };
        pixel.own = traced(rng);
        pixel.others = std::array::from_fn(|_| traced(rng));
        pixel.alpha = if rng.random_bool(0.1) { 0.0 } else { rng.random_range(0.3..1.0) };
        pixel.denoised = groups.denoised.then(|| std::array::from_fn(|_| rng.random_range(0.05..1.0)));
        if groups.keys {
            pixel.trust = [0.2, if rng.random_bool(0.5) { -0.3 } else { f32::NEG_INFINITY }];
        }
        pixel
    }

    /// Derivatives agree with finite differences for every combination of groups.
    #[test]
    fn derivatives_agree_with_differences() {
        let (width, height) = (8, 8);
        for bits in 0..32 {
            let [deferred, keys, samples, neighbours, denoised] = [0, 1, 2, 3, 4].map(|bit| bits >> bit & 1 == 1);
            if (neighbours || denoised) && !samples {
                continue;
            }
            let groups = Groups { deferred, keys, samples, neighbours, denoised };
            let mut rng = Pcg64Mcg::seed_from_u64(bits);
            let pixels: Vec<PixelInputs> = (0..width * height).map(|_| random_pixel(&mut rng, groups)).collect();
            let mut random = |count: usize| -> Vec<f32> { (0..count).map(|_| rng.random_range(-1.0..1.0)).collect() };
            let fine_outputs = random(width * height / 4 * fine(groups));
            let coarse_outputs = random(if samples { width * height / 16 * KERNEL } else { 0 });
            let slopes: Vec<[f32; 3]> = random(3 * width * height).chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
            let loss = |fine: &[f32], coarse: &[f32]| -> f64 {
                let (drawn, _) = Picture { width, height, pixels: &pixels, groups, fine, coarse }.draw();
                drawn.iter().zip(&slopes).flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c] * b[c]))).sum()
            };
            let picture = Picture { width, height, pixels: &pixels, groups, fine: &fine_outputs, coarse: &coarse_outputs };
            let (_, tape) = picture.draw();
            let (d_fine, d_coarse) = picture.backward(&tape, &slopes);
            let step = 1e-2;
            let mut worst: f64 = 0.0;
            for (which, values, slopes) in [(0, &fine_outputs, &d_fine), (1, &coarse_outputs, &d_coarse)] {
                for i in (0..values.len()).step_by(7) {
                    let at = |delta: f32| {
                        let mut moved = values.clone();
                        moved[i] += delta;
                        if which == 0 { loss(&moved, &coarse_outputs) } else { loss(&fine_outputs, &moved) }
                    };
                    let expected = (at(step) - at(-step)) / f64::from(2.0 * step);
                    let error = (expected - f64::from(slopes[i])).abs();
                    // A clamp between the two points is rare, and would show as a large error.
                    assert!(error < 3e-3 + 0.02 * expected.abs(), "{groups:?} {which} {i}: {} and {expected}", slopes[i]);
                    worst = worst.max(expected.abs());
                }
            }
            assert!(worst > 1e-2, "{groups:?}: the picture does not depend on the outputs");
        }
    }

    /// Outputs of 0 give the best input: mostly the picture of another denoiser, else samples, else keyframes, else deferred
    /// shading.
    #[test]
    fn an_untrained_network_returns_its_best_input() {
        let one = PixelInputs {
            alpha: 1.0,
            tint: [1.0; 3],
            terms: [[0.1, 0.2, 0.3]; TERMS],
            keys: [[0.7; 3]; KEYS],
            trust: [0.0; KEYS],
            own: [2.0, 2.0, 2.0, 1.0],
            ..PixelInputs::default()
        };
        let pixels = vec![one; 64];
        let with_picture = vec![PixelInputs { denoised: Some([0.9; 3]), ..one }; 64];
        let draw = |groups: Groups| {
            let pixels = if groups.denoised { &with_picture } else { &pixels };
            let fine_outputs = vec![0.0; 16 * fine(groups)];
            let coarse = vec![0.0; if groups.samples { 4 * KERNEL } else { 0 }];
            let (drawn, _) = Picture { width: 8, height: 8, pixels, groups, fine: &fine_outputs, coarse: &coarse }.draw();
            drawn[27]
        };
        let deferred = Groups { deferred: true, ..Groups::default() };
        let mut bare = pixels[0];
        bare.trust = [f32::NEG_INFINITY; KEYS];
        let samples = Groups { samples: true, ..Groups::default() };
        assert!((draw(samples)[0] - 2.0).abs() < 0.2);
        // The denoised picture of 0.9 weighs exp(3) times as much as the samples of 2.
        assert!((draw(Groups { denoised: true, ..samples })[0] - 0.9).abs() < 0.1);
        assert!((draw(Groups { keys: true, ..deferred })[0] - 0.7).abs() < 0.05);
        let bare = vec![bare; 64];
        let fine_outputs = vec![0.0; 16 * fine(deferred)];
        let (drawn, _) =
            Picture { width: 8, height: 8, pixels: &bare, groups: deferred, fine: &fine_outputs, coarse: &[] }.draw();
        assert_eq!(drawn[9].map(|v| (v * 1e5).round()), [40000.0, 80000.0, 120_000.0]);
    }
}
