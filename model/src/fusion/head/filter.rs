//! The filters of the head: kernels of 5 x 5 weights that the network predicts for each pixel, on samples of three scales.

use crate::kernels::exp_each;

/// Number of weights of a kernel.
pub const KERNEL: usize = SIDE * SIDE;
const SIDE: usize = 5;
const REACH: usize = 2;
/// [`KERNEL`] rounded up to whole vectors.
const PADDED: usize = KERNEL.next_multiple_of(16);
/// Coverage up to here counts as none.
pub const NOTHING: f32 = 1e-6;
/// Logit of the centre of a kernel before training.
const MIDDLE: f32 = 2.0;

/// Numbers of a pixel: all light, coverage, and from [`INDIRECT`] on the part of the light that is indirect; a whole vector.
pub const LANES: usize = 8;
/// Where the indirect light stands among them; 0 where it is not known.
pub const INDIRECT: usize = 4;

/// The samples at one scale, before and after filtering.
#[derive(Clone, Debug, Default)]
pub struct Scale {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples divided by the reflectance, times coverage; coverage; the indirect part, as the samples.
    pub merged: Vec<[f32; LANES]>,
    /// The filtered quotients, and the weighted coverage that they were divided by.
    pub filtered: Vec<[f32; LANES]>,
}

/// The four pixels of the next finer scale (of `fine_width` columns) that pixel `i` of a scale of `width` columns covers.
pub fn four(i: usize, width: usize, fine_width: usize) -> [usize; 4] {
    let at = 2 * (i / width) * fine_width + 2 * (i % width);
    [at, at + 1, at + fine_width, at + fine_width + 1]
}

/// Mean of the four finer pixels that pixel `i` of a scale of `width` columns covers.
pub fn quarter(finer: &Scale, i: usize, width: usize) -> [f32; LANES] {
    let under = four(i, width, finer.width).map(|at| finer.merged[at]);
    std::array::from_fn(|c| 0.25 * (under[0][c] + under[1][c] + under[2][c] + under[3][c]))
}

/// Bilinear taps in a scale for pixel `i` of the full picture, which has `width` columns.
#[inline(always)]
pub fn taps(i: usize, width: usize, scale: &Scale) -> [(usize, f32); 4] {
    if scale.width == width {
        return [(i, 1.0), (i, 0.0), (i, 0.0), (i, 0.0)];
    }
    let step = (width / scale.width) as f32;
    let along = |position: usize, count: usize| {
        let at = ((position as f32 + 0.5) / step - 0.5).clamp(0.0, (count - 1) as f32);
        let first = (at as usize).min(count - 1);
        (first, (first + 1).min(count - 1), at - first as f32)
    };
    let (x, right, s) = along(i % width, scale.width);
    let (y, below, t) = along(i / width, scale.height);
    [
        (y * scale.width + x, (1.0 - s) * (1.0 - t)),
        (y * scale.width + right, s * (1.0 - t)),
        (below * scale.width + x, (1.0 - s) * t),
        (below * scale.width + right, s * t),
    ]
}

/// The rows of a kernel around pixel `i` that lie in the picture: first tap, first pixel, and number of pixels.
#[inline(always)]
fn rows(scale: &Scale, i: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    let (x, y) = (i % scale.width, i / scale.width);
    let (left, top) = (x.saturating_sub(REACH), y.saturating_sub(REACH));
    let (right, bottom) = ((x + REACH + 1).min(scale.width), (y + REACH + 1).min(scale.height));
    let width = scale.width;
    (top..bottom).map(move |row| ((row + REACH - y) * SIDE + left + REACH - x, row * width + left, right - left))
}

/// The weights of a kernel, scaled so that the largest is 1.
#[inline(always)]
fn weights(kernel: &[f32]) -> [f32; PADDED] {
    let mut weights = [f32::NEG_INFINITY; PADDED];
    weights[..KERNEL].copy_from_slice(&kernel[..KERNEL]);
    weights[KERNEL / 2] += MIDDLE;
    // Sixteen running values, so that the loop vectorises.
    let mut highest = [f32::NEG_INFINITY; 16];
    for chunk in weights.as_chunks::<16>().0 {
        highest.iter_mut().zip(chunk).for_each(|(most, &v)| *most = if v > *most { v } else { *most });
    }
    let most = highest.into_iter().fold(f32::NEG_INFINITY, |most, v| if v > most { v } else { most });
    weights.iter_mut().for_each(|v| *v -= most);
    exp_each(&mut weights);
    weights
}

/// The quotients of the weighted sums around pixel `i`, and the weighted coverage that they were divided by.
#[inline(always)]
pub fn filter(scale: &Scale, i: usize, kernel: &[f32]) -> [f32; LANES] {
    let weights = weights(kernel);
    // A sum for each row, so that none waits for another.
    let mut sums = [[0.0; LANES]; SIDE];
    for (sum, (tap, at, count)) in sums.iter_mut().zip(rows(scale, i)) {
        for (weight, there) in weights[tap..tap + count].iter().zip(&scale.merged[at..at + count]) {
            (0..LANES).for_each(|c| sum[c] += weight * there[c]);
        }
    }
    let sum: [f32; LANES] = std::array::from_fn(|c| sums.iter().map(|sum| sum[c]).sum());
    if sum[3] > NOTHING { std::array::from_fn(|c| if c == 3 { sum[3] } else { sum[c] / sum[3] }) } else { [0.0; LANES] }
}

/// Propagates `d`, the derivative with respect to the filtered pixel `i`, to its kernel and to the samples around it.
#[inline(always)]
pub fn unfilter(scale: &Scale, i: usize, kernel: &[f32], d: [f32; LANES], out: &mut [f32], into: &mut [[f32; LANES]]) {
    let filtered = scale.filtered[i];
    if filtered[3] <= NOTHING {
        return;
    }
    let weights = weights(kernel);
    // The coverage has no derivative of its own.
    let mean: f32 = (0..LANES).filter(|c| *c != 3).map(|c| d[c] * filtered[c]).sum();
    let along: [f32; LANES] = std::array::from_fn(|c| if c == 3 { -mean } else { d[c] });
    for (tap, at, count) in rows(scale, i) {
        let taps = weights[tap..tap + count].iter().zip(&mut out[tap..tap + count]);
        for ((weight, out), (there, into)) in taps.zip(scale.merged[at..at + count].iter().zip(&mut into[at..at + count])) {
            let weight = weight / filtered[3];
            let mut sum = 0.0;
            for c in 0..LANES {
                sum += along[c] * there[c];
                into[c] += weight * along[c];
            }
            *out += weight * sum;
        }
    }
}
