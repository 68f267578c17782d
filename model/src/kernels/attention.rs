//! Scaled dot-product attention and its gradient. Scores exist only for a block of queries at a time.
use super::buffer;
use super::tile::{Output, Start, Term, Tile};
use rayon::prelude::*;
use std::ops::Range;

/// Sizes of one attention.
#[derive(Clone, Copy, Debug)]
pub struct Attention {
    /// Pictures.
    pub batch: usize,
    /// Tokens that ask.
    pub queries: usize,
    /// Tokens that are asked.
    pub keys: usize,
    /// Floats of a token; each head has an equal share.
    pub channels: usize,
    /// Heads.
    pub heads: usize,
}

/// Most queries whose scores are held at once.
const BLOCK: usize = 32;
const ZERO: [f32; 64] = [0.0; 64];

impl Attention {
    /// Floats of a token in one head.
    fn width(&self) -> usize {
        self.channels / self.heads
    }

    fn scale(&self) -> f32 {
        1.0 / (self.width() as f32).sqrt()
    }

    /// The part of `x` `[batch, tokens, channels]` from the first float of one head of one picture on.
    fn head<'a>(&self, x: &'a [f32], tokens: usize, index: usize) -> &'a [f32] {
        let (picture, head) = (index / self.heads, index % self.heads);
        &x[picture * tokens * self.channels + head * self.width()..]
    }

    /// One head of one picture as `[tokens, width]`, times `scale`, with zeros to whole vectors behind each token.
    fn rows<T: Tile>(&self, _: T, x: &[f32], tokens: usize, index: usize, scale: f32) -> Vec<f32> {
        let (width, wide) = (self.width(), self.width().next_multiple_of(T::LANES));
        let mut packed = vec![0.0; tokens * wide];
        let head = self.head(x, tokens, index);
        for (to, from) in packed.chunks_exact_mut(wide).zip(head.chunks(self.channels)) {
            to.iter_mut().zip(&from[..width]).for_each(|(to, from)| *to = from * scale);
        }
        packed
    }

    /// One head of one picture as `[block of tokens][width][tokens in a block]`, times `scale`, zero beyond the last token.
    fn columns<T: Tile>(&self, _: T, x: &[f32], tokens: usize, index: usize, scale: f32) -> Vec<f32> {
        let (width, wide) = (self.width(), 2 * T::LANES);
        let mut packed = vec![0.0; tokens.next_multiple_of(wide) * width];
        let head = self.head(x, tokens, index);
        for (token, from) in head.chunks(self.channels).take(tokens).enumerate() {
            let block = &mut packed[token / wide * wide * width..];
            for (c, &from) in from[..width].iter().enumerate() {
                block[c * wide + token % wide] = from * scale;
            }
        }
        packed
    }

    /// `a` times a matrix packed by `columns`: to `out` `[rows, width of out]`, of which the first `self.keys` columns are set.
    fn times_columns<T: Tile>(&self, tile: T, a: &[f32], a_row: usize, rows: usize, packed: &[f32], out: &mut [f32]) {
        let (k, wide, row) = (self.width(), 2 * T::LANES, self.keys.next_multiple_of(2 * T::LANES));
        for (i, b) in packed.chunks_exact(k * wide).enumerate() {
            for r in (0..rows).step_by(T::ROWS) {
                let term = Term { a: &a[r * a_row..], a_row, a_step: 1, b, b_step: wide, k };
                let out = Output { values: &mut out[r * row + i * wide..], row, columns: wide };
                tile.tile(T::ROWS.min(rows - r), 2, &[term], Start::Row(&ZERO), out);
            }
        }
    }

    /// The attention of `q` `[batch, queries, channels]` to `k` and `v` `[batch, keys, channels]`.
    pub fn forward<T: Tile>(&self, tile: T, q: &[f32], k: &[f32], v: &[f32]) -> Vec<f32> {
        let Self { batch, queries, keys, channels, heads } = *self;
        let packed: Vec<(Vec<f32>, Vec<f32>)> = (0..batch * heads)
            .into_par_iter()
            .map(|i| (self.columns(tile, k, keys, i, self.scale()), self.rows(tile, v, keys, i, 1.0)))
            .collect();
        let (width, row) = (self.width(), keys.next_multiple_of(2 * T::LANES));
        let block = (batch * queries / 16).clamp(1, BLOCK);
        buffer::fill(batch * queries * channels, block * channels, Vec::new, |scores, chunk, values| {
            let tokens = chunk * block..chunk * block + values.len() / channels;
            // A chunk may end one picture and begin the next.
            for (picture, tokens) in
                by_picture(tokens.clone(), queries).map(|(p, t)| (p, t.start - tokens.start..t.end - tokens.start))
            {
                let asked = &q[(chunk * block + tokens.start) * channels..];
                for head in 0..heads {
                    let (columns, rows) = &packed[picture * heads + head];
                    scores.resize(block * row, 0.0);
                    self.times_columns(tile, &asked[head * width..], channels, tokens.len(), columns, scores);
                    let sums: Vec<f32> =
                        scores.chunks_exact_mut(row).take(tokens.len()).map(|s| tile.exp_and_sum(&mut s[..keys])).collect();
                    let values = &mut values[tokens.start * channels + head * width..];
                    weigh(tile, scores, row, 1, (tokens.len(), keys), rows, (Start::Row(&ZERO), width), values, channels);
                    for (token, sum) in values.chunks_mut(channels).zip(sums) {
                        let inverse = 1.0 / sum;
                        token[..width].iter_mut().for_each(|v| *v *= inverse);
                    }
                }
            }
        })
    }

    /// Gradients of q, k and v, given that of the output.
    pub fn backward<T: Tile>(&self, tile: T, q: &[f32], k: &[f32], v: &[f32], gradient: &[f32]) -> [Vec<f32>; 3] {
        let found: Vec<[Vec<f32>; 3]> =
            (0..self.batch * self.heads).into_par_iter().map(|i| self.head_backward(tile, q, k, v, gradient, i)).collect();
        let wide = self.width().next_multiple_of(T::LANES);
        [(0, self.queries), (1, self.keys), (2, self.keys)].map(|(which, tokens)| {
            let length = self.batch * tokens * self.channels;
            buffer::fill(
                length,
                self.channels,
                || (),
                |(), token, values| {
                    for (head, values) in values.chunks_exact_mut(self.width()).enumerate() {
                        let from = &found[token / tokens * self.heads + head][which][token % tokens * wide..];
                        values.copy_from_slice(&from[..self.width()]);
                    }
                },
            )
        })
    }

    /// One head of one picture: gradients `[tokens, whole vectors]`.
    ///
    /// With P = softmax(S), S = scale q k^T and O = P v: dv = P^T dO, dP = dO v^T, dS = P (dP - sum(P dP)), dq = scale dS k,
    /// dk = scale dS^T q.
    fn head_backward<T: Tile>(&self, tile: T, q: &[f32], k: &[f32], v: &[f32], gradient: &[f32], index: usize) -> [Vec<f32>; 3] {
        let Self { queries, keys, channels, .. } = *self;
        let (wide, row) = (self.width().next_multiple_of(T::LANES), keys.next_multiple_of(2 * T::LANES));
        let (k_columns, v_columns) = (self.columns(tile, k, keys, index, self.scale()), self.columns(tile, v, keys, index, 1.0));
        let (k_rows, q_rows) = (self.rows(tile, k, keys, index, self.scale()), self.rows(tile, q, queries, index, self.scale()));
        let gradient_rows = self.rows(tile, gradient, queries, index, 1.0);
        let (q, gradient) = (self.head(q, queries, index), self.head(gradient, queries, index));
        let (mut dq, mut dk, mut dv) = (vec![0.0; queries * wide], vec![0.0; keys * wide], vec![0.0; keys * wide]);
        let (mut p, mut ds) = (vec![0.0; BLOCK * row], vec![0.0; BLOCK * row]);
        for first in (0..queries).step_by(BLOCK) {
            let count = BLOCK.min(queries - first);
            self.times_columns(tile, &q[first * channels..], channels, count, &k_columns, &mut p);
            self.times_columns(tile, &gradient[first * channels..], channels, count, &v_columns, &mut ds);
            for (p, ds) in p.chunks_exact_mut(row).zip(ds.chunks_exact_mut(row)).take(count) {
                let (p, ds) = (&mut p[..keys], &mut ds[..keys]);
                let inverse = 1.0 / tile.exp_and_sum(p);
                p.iter_mut().for_each(|p| *p *= inverse);
                let mean: f32 = p.iter().zip(ds.iter()).map(|(p, d)| p * d).sum();
                ds.iter_mut().zip(p).for_each(|(d, p)| *d = *p * (*d - mean));
            }
            let whole = (Start::Row(&ZERO[..]), wide);
            weigh(tile, &ds, row, 1, (count, keys), &k_rows, whole, &mut dq[first * wide..], wide);
            let more = (Start::Output, wide);
            weigh(tile, &ds, 1, row, (keys, count), &q_rows[first * wide..], more, &mut dk, wide);
            weigh(tile, &p, 1, row, (keys, count), &gradient_rows[first * wide..], more, &mut dv, wide);
        }
        [dq, dk, dv]
    }
}

/// `a` `[rows, k]` times `b` `[k, whole vectors]`: to the first `columns` of each row of `out`.
#[allow(clippy::too_many_arguments)] // Two strided matrices and an output.
fn weigh<T: Tile>(
    tile: T,
    a: &[f32],
    a_row: usize,
    a_step: usize,
    (rows, k): (usize, usize),
    b: &[f32],
    (start, columns): (Start, usize),
    out: &mut [f32],
    row: usize,
) {
    let b_step = columns.next_multiple_of(T::LANES);
    for r in (0..rows).step_by(T::ROWS) {
        for c in (0..columns).step_by(2 * T::LANES) {
            let columns = (2 * T::LANES).min(columns - c);
            let term = Term { a: &a[r * a_row..], a_row, a_step, b: &b[c..], b_step, k };
            let out = Output { values: &mut out[r * row + c..], row, columns };
            tile.tile(T::ROWS.min(rows - r), columns.div_ceil(T::LANES), &[term], start, out);
        }
    }
}

/// Cuts a range of tokens, counted through the batch, where a picture ends.
fn by_picture(tokens: Range<usize>, per_picture: usize) -> impl Iterator<Item = (usize, Range<usize>)> {
    let pictures = tokens.start / per_picture..tokens.end.div_ceil(per_picture);
    pictures.map(move |p| (p, tokens.start.max(p * per_picture)..tokens.end.min((p + 1) * per_picture)))
}
