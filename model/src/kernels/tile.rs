//! The one inner product everything here is made of: a small tile of outputs kept in registers over a list of sums.
//!
//! Each output is one chain of fused multiply-adds in the order of the terms, whatever the vector width, so all
//! implementations of [`Tile`] return the same bits.

use std::borrow::Cow;

/// One sum of a tile: `out[i][j] += sum over k of a[i * a_row + k * a_step] * b[k * b_step + j]`.
#[derive(Clone, Copy, Debug)]
pub struct Term<'a> {
    /// Scalars, one for each row and `k`.
    pub a: &'a [f32],
    /// Distance in `a` from one row of the tile to the next.
    pub a_row: usize,
    /// Distance in `a` from one `k` to the next.
    pub a_step: usize,
    /// Vectors, one for each `k`, each as long as the tile is wide.
    pub b: &'a [f32],
    /// Distance in `b` from one `k` to the next.
    pub b_step: usize,
    /// Number of products summed.
    pub k: usize,
}

impl Term<'_> {
    /// Checks that a tile of `rows` by `width` stays inside `a` and `b`.
    ///
    /// # Panics
    /// When it does not.
    #[inline(always)]
    pub fn check(&self, rows: usize, width: usize) {
        assert!(self.k > 0 && self.a.len() > (rows - 1) * self.a_row + (self.k - 1) * self.a_step, "term reads beyond a");
        assert!(self.b.len() >= (self.k - 1) * self.b_step + width, "term reads beyond b");
    }
}

/// What a tile's sums start from.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// The same vector for every row, as long as the tile is wide.
    Row(&'a [f32]),
    /// What is in the output already; then `columns` must be the whole width.
    Output,
}

/// Where a tile goes: row `i` to `values[i * row..][..columns]`.
#[derive(Debug)]
pub struct Output<'a> {
    /// Memory from the tile's first element on.
    pub values: &'a mut [f32],
    /// Distance from one row of the tile to the next.
    pub row: usize,
    /// Columns to write: more than the width of one vector less, at most the tile's width.
    pub columns: usize,
}

impl Output<'_> {
    /// Checks that a tile of `rows` by `width` fits.
    ///
    /// # Panics
    /// When it does not.
    #[inline(always)]
    pub fn check(&self, rows: usize, width: usize, start: Start) {
        assert!(self.columns <= width && self.values.len() >= (rows - 1) * self.row + self.columns, "tile leaves its output");
        match start {
            Start::Row(bias) => assert!(bias.len() >= width, "bias is shorter than the tile"),
            Start::Output => assert!(self.columns == width, "only whole tiles accumulate"),
        }
    }
}

/// An implementation of the inner product for one instruction set. A value of the type is proof that the processor has it.
pub trait Tile: Copy + Send + Sync {
    /// Floats in a vector.
    const LANES: usize;
    /// Most rows of a tile.
    const ROWS: usize;
    /// Factors in each of the 32-bit cells that [`Self::tile`] multiplies: one float, or two neighbours in bf16 whose products
    /// are summed.
    const FACTORS: usize = 1;

    /// Cells that are multiplied together. Terms have `a_step` 1 if it is more than 1, and zeros in `b` up to a multiple of it.
    const DEPTH: usize = 1;

    /// Cells of factors that follow one another.
    fn cells(self, values: &[f32]) -> Cow<'_, [f32]> {
        Cow::Borrowed(values)
    }

    /// Cells of two factors each, the first from `first` and the second from `second`; all slices are of one length. Only with
    /// two factors a cell.
    fn pair(self, first: &[f32], second: &[f32], cells: &mut [f32]) {
        let _ = (first, second, cells);
        unreachable!("cells of one factor are not made of two");
    }

    /// Computes a tile of `rows` (1 to `ROWS`) by `vectors * LANES` (`vectors` 1 or 2).
    ///
    /// # Panics
    /// When a term or the output is too short.
    fn tile(self, rows: usize, vectors: usize, terms: &[Term], start: Start, out: Output);

    /// `y = z * sigmoid(z)` for slices of equal length.
    fn silu(self, z: &[f32], y: &mut [f32]);

    /// `d = g * silu'(z)` for slices of equal length.
    fn silu_gradient(self, z: &[f32], g: &[f32], d: &mut [f32]);

    /// `y = x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2` for slices of equal length.
    fn gelu(self, x: &[f32], y: &mut [f32]);

    /// `d = g * gelu'(x)` for slices of equal length.
    fn gelu_gradient(self, x: &[f32], g: &[f32], d: &mut [f32]);

    /// Replaces `s` by `exp(s - max(s))` and returns its sum.
    fn exp_and_sum(self, s: &mut [f32]) -> f32;
}

/// The portable twin of the vector implementations, without `unsafe`. It is the one for processors whose fused
/// multiply-add belongs to the base instruction set (64-bit Arm); elsewhere it is correct but slow.
#[derive(Clone, Copy, Debug)]
pub struct Scalar;

impl Scalar {
    #[inline(always)]
    fn rows<const ROWS: usize, const WIDTH: usize>(terms: &[Term], start: Start, out: Output) {
        out.check(ROWS, WIDTH, start);
        let mut sums = [[0.0_f32; WIDTH]; ROWS];
        for (i, sums) in sums.iter_mut().enumerate() {
            sums.copy_from_slice(match start {
                Start::Row(bias) => &bias[..WIDTH],
                Start::Output => &out.values[i * out.row..][..WIDTH],
            });
        }
        for term in terms {
            term.check(ROWS, WIDTH);
            for k in 0..term.k {
                let b = &term.b[k * term.b_step..][..WIDTH];
                for (i, sums) in sums.iter_mut().enumerate() {
                    let a = term.a[i * term.a_row + k * term.a_step];
                    for (sum, &b) in sums.iter_mut().zip(b) {
                        *sum = a.mul_add(b, *sum);
                    }
                }
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            out.values[i * out.row..][..out.columns].copy_from_slice(&sums[..out.columns]);
        }
    }
}

impl Tile for Scalar {
    const LANES: usize = 8;
    const ROWS: usize = 4;

    fn tile(self, rows: usize, vectors: usize, terms: &[Term], start: Start, out: Output) {
        match (rows, vectors) {
            (4, 2) => Self::rows::<4, 16>(terms, start, out),
            (3, 2) => Self::rows::<3, 16>(terms, start, out),
            (2, 2) => Self::rows::<2, 16>(terms, start, out),
            (1, 2) => Self::rows::<1, 16>(terms, start, out),
            (4, 1) => Self::rows::<4, 8>(terms, start, out),
            (3, 1) => Self::rows::<3, 8>(terms, start, out),
            (2, 1) => Self::rows::<2, 8>(terms, start, out),
            (1, 1) => Self::rows::<1, 8>(terms, start, out),
            _ => unreachable!("no tile of {rows} rows and {vectors} vectors"),
        }
    }

    fn silu(self, z: &[f32], y: &mut [f32]) {
        silu(z, y);
    }

    fn silu_gradient(self, z: &[f32], g: &[f32], d: &mut [f32]) {
        silu_gradient(z, g, d);
    }

    fn gelu(self, x: &[f32], y: &mut [f32]) {
        gelu(x, y);
    }

    fn gelu_gradient(self, x: &[f32], g: &[f32], d: &mut [f32]) {
        gelu_gradient(x, g, d);
    }

    fn exp_and_sum(self, s: &mut [f32]) -> f32 {
        exp_and_sum(s)
    }
}

/// `exp(x)` for x in -87..=87 within 2 ulp: the polynomial of Cephes' `expf`, without branches so that it vectorises.
#[inline(always)]
fn exp(x: f32) -> f32 {
    // Adding 1.5 * 2^23 rounds to an integer and leaves it in the low bits of the mantissa.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    // ln 2 in two parts, so that x - n ln 2 stays exact.
    let r = n.mul_add(2.121_944_4e-4, n.mul_add(-355.0 / 512.0, x));
    let p = 1.987_569_1e-4_f32
        .mul_add(r, 1.398_2e-3)
        .mul_add(r, 8.333_452e-3)
        .mul_add(r, 4.166_579_6e-2)
        .mul_add(r, 1.666_666_5e-1)
        .mul_add(r, 0.5);
    let p = (p * r).mul_add(r, r) + 1.0;
    f32::from_bits((shifted.to_bits() << 23).wrapping_add(p.to_bits()))
}

/// `ln(x)` of a normal number above 0 within 2 ulp of the larger of 1 and the result: the polynomial of Cephes' `logf`, without
/// branches.
#[inline(always)]
fn ln(x: f32) -> f32 {
    // The mantissa is brought to sqrt(1/2)..sqrt(2).
    const MIDDLE: u32 = 0x3f35_04f3;
    let bits = x.to_bits().wrapping_sub(MIDDLE);
    let exponent = (bits as i32 >> 23) as f32;
    let r = f32::from_bits((bits & 0x007f_ffff).wrapping_add(MIDDLE)) - 1.0;
    let p = 7.037_683_6e-2_f32
        .mul_add(r, -1.151_461e-1)
        .mul_add(r, 1.167_699_9e-1)
        .mul_add(r, -1.242_014_1e-1)
        .mul_add(r, 1.424_932_3e-1)
        .mul_add(r, -1.666_805_8e-1)
        .mul_add(r, 2.000_071_5e-1)
        .mul_add(r, -2.499_999_4e-1)
        .mul_add(r, 3.333_333e-1);
    let square = r * r;
    let small = exponent.mul_add(-2.121_944_4e-4, p * r * square);
    exponent.mul_add(355.0 / 512.0, r + square.mul_add(-0.5, small))
}

/// The low half of the result is `v` in bf16, rounded to the nearest, ties to even.
#[inline(always)]
fn bf16(v: f32) -> u32 {
    let bits = v.to_bits();
    bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16
}

/// The cell of two factors in bf16, the first in the low half.
#[inline(always)]
pub(super) fn paired(first: f32, second: f32) -> f32 {
    f32::from_bits(bf16(first) | bf16(second) << 16)
}

#[inline(always)]
pub(super) fn pair(first: &[f32], second: &[f32], cells: &mut [f32]) {
    for ((cell, first), second) in cells.iter_mut().zip(first).zip(second) {
        *cell = paired(*first, *second);
    }
}

#[inline(always)]
pub(super) fn pair_neighbours(values: &[f32], cells: &mut [f32]) {
    for (cell, [first, second]) in cells.iter_mut().zip(values.as_chunks::<2>().0) {
        *cell = paired(*first, *second);
    }
}

#[inline(always)]
fn sigmoid(z: f32) -> f32 {
    1.0 / (1.0 + exp((-z).clamp(-87.0, 87.0)))
}

/// The loops below are inlined into functions compiled for each instruction set, where they vectorise.
#[inline(always)]
pub(super) fn silu(z: &[f32], y: &mut [f32]) {
    for (y, &z) in y.iter_mut().zip(z) {
        *y = z * sigmoid(z);
    }
}

#[inline(always)]
pub(super) fn silu_gradient(z: &[f32], g: &[f32], d: &mut [f32]) {
    for ((d, &z), &g) in d.iter_mut().zip(z).zip(g) {
        let s = sigmoid(z);
        *d = g * s * (z * (1.0 - s) + 1.0);
    }
}

/// Twice the argument of GELU's hyperbolic tangent is `x (LINEAR + CUBIC x^2)`; `(1 + tanh u) / 2` is the sigmoid of `2 u`.
const LINEAR: f32 = 2.0 * std::f32::consts::FRAC_2_SQRT_PI * std::f32::consts::FRAC_1_SQRT_2;
const CUBIC: f32 = 0.044_715 * LINEAR;

#[inline(always)]
pub(super) fn gelu(x: &[f32], y: &mut [f32]) {
    for (y, &x) in y.iter_mut().zip(x) {
        *y = x * sigmoid(x * (LINEAR + CUBIC * x * x));
    }
}

#[inline(always)]
pub(super) fn gelu_gradient(x: &[f32], g: &[f32], d: &mut [f32]) {
    for ((d, &x), &g) in d.iter_mut().zip(x).zip(g) {
        let s = sigmoid(x * (LINEAR + CUBIC * x * x));
        *d = g * s * (1.0 + x * (1.0 - s) * (LINEAR + 3.0 * CUBIC * x * x));
    }
}

/// Replaces each value, clamped to -87..=87, by its exponential, within 2 ulp. It must be inlined into code that is compiled for
/// processors with a fused multiply-add, such as that of `pulp::Arch`. Elsewhere each value takes many calls.
#[inline(always)]
pub(crate) fn exp_each(s: &mut [f32]) {
    for v in s {
        *v = exp(v.clamp(-87.0, 87.0));
    }
}

/// Replaces each value, a normal number above 0, by its natural logarithm, likewise.
#[inline(always)]
pub(crate) fn ln_each(s: &mut [f32]) {
    for v in s {
        *v = ln(*v);
    }
}

#[inline(always)]
pub(super) fn exp_and_sum(s: &mut [f32]) -> f32 {
    // Sixteen running values: a fixed order of summation that still vectorises.
    let mut highest = [f32::NEG_INFINITY; 16];
    let (chunks, rest) = s.as_chunks::<16>();
    for chunk in chunks {
        for (h, &v) in highest.iter_mut().zip(chunk) {
            *h = if v > *h { v } else { *h };
        }
    }
    let highest = highest.iter().chain(rest).fold(f32::NEG_INFINITY, |m, &v| m.max(v));
    let mut sums = [0.0_f32; 16];
    let (chunks, rest) = s.as_chunks_mut::<16>();
    for chunk in chunks {
        for (sum, v) in sums.iter_mut().zip(chunk) {
            *v = exp((*v - highest).max(-87.0));
            *sum += *v;
        }
    }
    for (sum, v) in sums.iter_mut().zip(rest) {
        *v = exp((*v - highest).max(-87.0));
        *sum += *v;
    }
    sums.iter().sum()
}
