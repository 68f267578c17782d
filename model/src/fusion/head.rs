//! The head: it computes the picture from the outputs of the network, and the derivative of a loss with respect to the outputs
//! from its derivative with respect to the picture.
//!
//! The head has no parameters and needs few operations per pixel, so it runs fused on the host. Let `M` be the samples of the
//! frame and its neighbours, blended with predicted weights: radiance divided by the reflectance, times coverage, and coverage.
//! For each scale `l` of 1, 2 and 4 pixels, the samples are filtered by
//!
//! `F_l(x) = sum_j exp(k_l(x, j)) M_l(x + j) / sum_j exp(k_l(x, j)) coverage_l(x + j)`, with j over 5 x 5 pixels.
//!
//! Pixels that see no surface therefore have no influence. The three scales are enlarged bilinearly and blended. Where it is
//! known which part of the samples is indirect light, that part is filtered with the same kernels, and the scales have weights of
//! their own for it: it has more of the noise, and fewer edges.
//!
//! The candidates are these filtered samples, the specular reflection of the environment, the picture of another denoiser, the
//! warped keyframes, and the sum of the terms of deferred shading, each times `exp(g)`. They are mixed with softmax weights. Then
//! a share of the specular reflection and a residual times the reflectance are added, and the environment is put behind the
//! surface. The specular reflection is a candidate because kernels blur reflections, and the split sum does not.

mod filter;

pub use filter::KERNEL;

use super::record::{Groups, KEYS, NEIGHBOURS, PixelInputs, TERMS};
use crate::bridge::MAX_RADIANCE;
use crate::kernels::exp_each;
use filter::{INDIRECT, LANES, NOTHING, Scale, filter, four, quarter, taps, unfilter};
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
/// Number of outputs per pixel that knowing the indirect light adds.
const SPLIT: usize = SCALES;

/// Largest absolute logarithm of a factor.
const MOST: f32 = 4.0;
/// Logits of samples and of keyframes before training. The logit of deferred shading is 0.
const TRUST: [f32; 2] = [5.0, 3.0];
/// Logit of the denoised picture before training.
const TRUST_DENOISED: f32 = 8.0;
/// Logit of the finest scale before training.
const FINEST: f32 = 1.0;

/// Number of outputs at half size for these groups: four pixels, and with samples the kernel of scale 2. Those that `paths` adds
/// come last.
pub fn fine(groups: Groups) -> usize {
    let traced = if groups.samples { 4 * TRACED + KERNEL } else { 0 };
    let split = if groups.paths { 4 * SPLIT } else { 0 };
    4 * BASE + traced + if groups.neighbours { 4 * MERGE } else { 0 } + split
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
    /// With respect to the filtered samples of each scale; see [`Scale::filtered`].
    filtered: Vec<Vec<[f32; LANES]>>,
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
    /// The same for indirect light, where it is known.
    indirect: [f32; SCALES],
}

/// Samples, and the part of them that is indirect light; 0 where it is not known.
#[inline(always)]
fn lanes(samples: &[f32; 4], indirect: &[f32; 3]) -> [f32; LANES] {
    let mut lanes = [0.0; LANES];
    lanes[..4].copy_from_slice(samples);
    (0..3).for_each(|c| lanes[INDIRECT + c] = indirect[c].min(samples[c]));
    lanes
}

/// The samples of neighbour `n` of a pixel, as [`Picture::own`].
#[inline(always)]
fn other(pixel: &PixelInputs, n: usize) -> [f32; LANES] {
    lanes(&pixel.others[n], &pixel.others_indirect[n])
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

    #[inline(always)]
    fn split_at(&self, i: usize) -> usize {
        let (block, sub) = self.place(i);
        (block + 1) * fine(self.groups) - 4 * SPLIT + sub * SPLIT
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

    /// The frame's own samples at pixel `i`, and the part of them that is indirect light.
    #[inline(always)]
    fn own(&self, i: usize) -> [f32; LANES] {
        let pixel = &self.pixels[i];
        let [r, g, b, ..] = pixel.paths;
        lanes(&pixel.own, &[r, g, b])
    }

    #[inline(always)]
    fn merged(&self, i: usize) -> [f32; LANES] {
        let (pixel, weights) = (&self.pixels[i], self.merging(i));
        let mut sum = self.own(i).map(|v| v * weights[0]);
        for (n, weight) in weights[1..].iter().enumerate() {
            for (sum, value) in sum.iter_mut().zip(other(pixel, n)) {
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
            indirect: [0.0; SCALES],
        };
        if self.groups.samples {
            let outputs = &self.fine[self.traced_at(i) + KERNEL..][..SCALES + 3];
            let logits_of_scales = [outputs[0] + FINEST, outputs[1], outputs[2]];
            mix.scales = softmax(logits_of_scales);
            if self.groups.paths {
                let more = &self.fine[self.split_at(i)..][..SPLIT];
                mix.indirect = softmax(std::array::from_fn(|scale| logits_of_scales[scale] + more[scale]));
            }
            mix.candidates[MIRRORED] = pixel.reflected;
            mix.weights[MIRRORED] = outputs[SCALES];
            mix.shine = outputs[SCALES + 1];
            if let Some(denoised) = pixel.denoised {
                mix.candidates[DENOISED] = denoised;
                mix.weights[DENOISED] = outputs[SCALES + 2] + TRUST_DENOISED;
            }
            if let Some(filtered) = self.filtered(i, &mix, scales).0.joined() {
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

    /// The blended filtered samples at pixel `i`, divided by the reflectance, and the weights of the scales for direct and for
    /// indirect light. Both are the same where indirect light would else vanish, because it weighs nothing at the scales that
    /// have samples.
    #[inline(always)]
    fn filtered(&self, i: usize, mix: &Mix, scales: &[Scale]) -> (Blended, [[f32; SCALES]; 2]) {
        let shares = [mix.scales, mix.indirect];
        let blended = self.blended(i, shares, scales);
        if self.groups.paths && blended.weights[1] <= NOTHING && blended.weights[0] > NOTHING {
            return (self.blended(i, [mix.scales; 2], scales), [mix.scales; 2]);
        }
        (blended, shares)
    }

    /// The same for given weights of the scales.
    #[inline(always)]
    fn blended(&self, i: usize, shares: [[f32; SCALES]; 2], scales: &[Scale]) -> Blended {
        let mut blended = Blended::default();
        for (level, scale) in scales.iter().enumerate() {
            for (at, weight) in taps(i, self.width, scale) {
                let there = scale.filtered[at];
                // A pixel without samples has no influence.
                let weight = weight * f32::from(u8::from(there[3] > NOTHING));
                let [direct, indirect] = shares.map(|shares| shares[level] * weight);
                for c in 0..3 {
                    blended.direct[c] += direct * (there[c] - there[INDIRECT + c]);
                    blended.indirect[c] += indirect * there[INDIRECT + c];
                }
                blended.weights[0] += direct;
                blended.weights[1] += indirect;
            }
        }
        for (part, weight) in [&mut blended.direct, &mut blended.indirect].into_iter().zip(blended.weights) {
            *part = if weight > NOTHING { part.map(|v| v / weight) } else { [0.0; 3] };
        }
        blended
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
            filtered: scales.iter().map(|scale| vec![[0.0; LANES]; scale.merged.len()]).collect(),
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
            let mut merged: Vec<[f32; LANES]> = Vec::new();
            for level in (0..SCALES).rev() {
                let scale = &scales[level];
                let mut into = vec![[0.0; LANES]; scale.merged.len()];
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
                        (0..LANES).for_each(|c| into[at][c] += 0.25 * d[c]);
                    }
                }
                merged = into;
            }
            if self.groups.neighbours {
                for (i, d) in merged.iter().enumerate() {
                    let (pixel, weights) = (&self.pixels[i], self.merging(i));
                    let dot = |v: &[f32]| v.iter().zip(d).map(|(v, d)| v * d).sum::<f32>();
                    let along: [f32; MERGE] =
                        std::array::from_fn(|n| if n == 0 { dot(&self.own(i)) } else { dot(&other(pixel, n - 1)) });
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
        let (blended, shares) = self.filtered(i, mix, scales);
        if blended.joined().is_none() {
            return;
        }
        let over = blended.weights.map(|weight| if weight > NOTHING { 1.0 / weight } else { 0.0 });
        // For direct and for indirect light.
        let mut along = [[0.0; SCALES]; 2];
        for (level, scale) in scales.iter().enumerate() {
            for (at, weight) in taps(i, self.width, scale) {
                let there = scale.filtered[at];
                if there[3] <= NOTHING {
                    continue;
                }
                let [direct, indirect] = over.map(|over| over * weight);
                let into = &mut found.filtered[level][at];
                for c in 0..3 {
                    along[0][level] += direct * d[c] * (there[c] - there[INDIRECT + c] - blended.direct[c]);
                    along[1][level] += indirect * d[c] * (there[INDIRECT + c] - blended.indirect[c]);
                    into[c] += shares[0][level] * direct * d[c];
                    into[INDIRECT + c] += (shares[1][level] * indirect - shares[0][level] * direct) * d[c];
                }
            }
        }
        let of_logits = |along: [f32; SCALES], weights: [f32; SCALES]| -> [f32; SCALES] {
            let mean: f32 = along.iter().zip(weights).map(|(v, w)| v * w).sum();
            std::array::from_fn(|level| weights[level] * (along[level] - mean))
        };
        let [direct, indirect] = [0, 1].map(|part| of_logits(along[part], shares[part]));
        let at = self.traced_at(i) + KERNEL;
        for level in 0..SCALES {
            // The logits for indirect light are sums with those for the rest.
            found.fine[at + level] = direct[level] + indirect[level];
        }
        if self.groups.paths && shares[1] == mix.indirect {
            found.fine[self.split_at(i)..][..SPLIT].copy_from_slice(&indirect);
        }
    }
}

/// The blended filtered samples of a pixel, divided by the reflectance: direct light, or all of it where the indirect part is not
/// known, and indirect light.
#[derive(Default)]
struct Blended {
    direct: [f32; 3],
    indirect: [f32; 3],
    /// The sums of weights of both.
    weights: [f32; 2],
}

impl Blended {
    /// All light; `None` without samples.
    #[inline(always)]
    fn joined(&self) -> Option<[f32; 3]> {
        (self.weights[0] > NOTHING).then(|| std::array::from_fn(|c| self.direct[c] + self.indirect[c]))
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
    type Value = [f32; LANES];

    #[inline(always)]
    fn at(&self, i: usize) -> [f32; LANES] {
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
    type Value = [f32; LANES];

    #[inline(always)]
    fn at(&self, i: usize) -> [f32; LANES] {
        // At the finest scale, only the pixel itself reads this.
        if self.level == 0 && self.picture.pixels[i].alpha <= 0.0 {
            return [0.0; LANES];
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
mod tests;
