//! Scaled dot-product attention and its gradient. Scores exist only for a block of queries at a time.
use super::buffer;
use super::tile::{Output, Start, Term, Tile};
use rayon::prelude::*;
use std::ops::Range;

/// The size of an attention.
#[derive(Clone, Copy, Debug)]
pub struct Attention {
    /// Number of items.
    pub batch: usize,
    /// Number of query tokens.
    pub queries: usize,
    /// Number of key tokens.
    pub keys: usize,
    /// Floats in a token. Heads have equal shares.
    pub channels: usize,
    /// Number of heads.
    pub heads: usize,
}

/// The inputs of an attention, `[batch, tokens, channels]` each.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// Queries.
    pub q: &'a [f32],
    /// Keys.
    pub k: &'a [f32],
    /// Values.
    pub v: &'a [f32],
}

/// A matrix whose elements lie at regular distances.
#[derive(Clone, Copy)]
struct Strided<'a> {
    values: &'a [f32],
    /// Floats from one row to the next.
    row: usize,
    /// Floats from one column to the next.
    step: usize,
    rows: usize,
    columns: usize,
}

/// Most queries whose scores are in memory at a time.
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

    /// `x` `[batch, tokens, channels]` from the first float of one head of one item.
    fn head<'a>(&self, x: &'a [f32], tokens: usize, index: usize) -> &'a [f32] {
        let (picture, head) = (index / self.heads, index % self.heads);
        &x[picture * tokens * self.channels + head * self.width()..]
    }

    /// One head of one item as `[tokens, width]`, times `scale`. Tokens are padded with zeros to whole vectors.
    fn rows<T: Tile>(&self, _: T, x: &[f32], tokens: usize, index: usize, scale: f32) -> Vec<f32> {
        let (width, wide) = (self.width(), self.width().next_multiple_of(T::LANES));
        let mut packed = vec![0.0; tokens * wide];
        let head = self.head(x, tokens, index);
        for (to, from) in packed.chunks_exact_mut(wide).zip(head.chunks(self.channels)) {
            to.iter_mut().zip(&from[..width]).for_each(|(to, from)| *to = from * scale);
        }
        packed
    }

    /// One head of one item as `[block of tokens][width][tokens in a block]`, times `scale`, with zeros after the last token.
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

    /// The first `rows` tokens of one head in `a`, times a matrix packed by [`Self::columns`]. Sets the first `self.keys` columns
    /// of each row of `out`.
    fn times_columns<T: Tile>(&self, tile: T, a: &[f32], rows: usize, packed: &[f32], out: &mut [f32]) {
        let (k, wide, row) = (self.width(), 2 * T::LANES, self.keys.next_multiple_of(2 * T::LANES));
        for (i, b) in packed.chunks_exact(k * wide).enumerate() {
            for r in (0..rows).step_by(T::ROWS) {
                let term = Term { a: &a[r * self.channels..], a_row: self.channels, a_step: 1, b, b_step: wide, k };
                let out = Output { values: &mut out[r * row + i * wide..], row, columns: wide };
                tile.tile(T::ROWS.min(rows - r), 2, &[term], Start::Row(&ZERO), out);
            }
        }
    }

    /// The attention of the queries to the keys and values, `[batch, queries, channels]`.
    pub fn forward<T: Tile>(&self, tile: T, Inputs { q, k, v }: Inputs) -> Vec<f32> {
        let Self { batch, queries, keys, channels, heads } = *self;
        let packed: Vec<(Vec<f32>, Vec<f32>)> = (0..batch * heads)
            .into_par_iter()
            .map(|i| (self.columns(tile, k, keys, i, self.scale()), self.rows(tile, v, keys, i, 1.0)))
            .collect();
        let (width, row) = (self.width(), keys.next_multiple_of(2 * T::LANES));
        let block = (batch * queries / 16).clamp(1, BLOCK);
        buffer::fill(batch * queries * channels, block * channels, Vec::new, |scores, chunk, values| {
            let tokens = chunk * block..chunk * block + values.len() / channels;
            // A chunk may hold the end of one item and the beginning of the next.
            for (picture, tokens) in
                by_picture(tokens.clone(), queries).map(|(p, t)| (p, t.start - tokens.start..t.end - tokens.start))
            {
                let asked = &q[(chunk * block + tokens.start) * channels..];
                for head in 0..heads {
                    let (columns, rows) = &packed[picture * heads + head];
                    scores.resize(block * row, 0.0);
                    self.times_columns(tile, &asked[head * width..], tokens.len(), columns, scores);
                    let sums: Vec<f32> =
                        scores.chunks_exact_mut(row).take(tokens.len()).map(|s| tile.exp_and_sum(&mut s[..keys])).collect();
                    let values = &mut values[tokens.start * channels + head * width..];
                    let scores = Strided { values: scores, row, step: 1, rows: tokens.len(), columns: keys };
                    weigh(tile, scores, rows, Start::Row(&ZERO), Output { values, row: channels, columns: width });
                    for (token, sum) in values.chunks_mut(channels).zip(sums) {
                        let inverse = 1.0 / sum;
                        token[..width].iter_mut().for_each(|v| *v *= inverse);
                    }
                }
            }
        })
    }

    /// Gradients with respect to q, k and v, given the gradient with respect to the output.
    pub fn backward<T: Tile>(&self, tile: T, inputs: Inputs, gradient: &[f32]) -> [Vec<f32>; 3] {
        let found: Vec<[Vec<f32>; 3]> =
            (0..self.batch * self.heads).into_par_iter().map(|i| self.head_backward(tile, inputs, gradient, i)).collect();
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

    /// The gradients of one head of one item, `[tokens, whole vectors]`.
    ///
    /// With P = softmax(S), S = scale q k^T and O = P v: dv = P^T dO, dP = dO v^T, dS = P (dP - sum(P dP)), dq = scale dS k,
    /// dk = scale dS^T q.
    fn head_backward<T: Tile>(&self, tile: T, inputs: Inputs, gradient: &[f32], index: usize) -> [Vec<f32>; 3] {
        let Inputs { q, k, v } = inputs;
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
            self.times_columns(tile, &q[first * channels..], count, &k_columns, &mut p);
            self.times_columns(tile, &gradient[first * channels..], count, &v_columns, &mut ds);
            for (p, ds) in p.chunks_exact_mut(row).zip(ds.chunks_exact_mut(row)).take(count) {
                let (p, ds) = (&mut p[..keys], &mut ds[..keys]);
                let inverse = 1.0 / tile.exp_and_sum(p);
                p.iter_mut().for_each(|p| *p *= inverse);
                let mean: f32 = p.iter().zip(ds.iter()).map(|(p, d)| p * d).sum();
                ds.iter_mut().zip(p).for_each(|(d, p)| *d = *p * (*d - mean));
            }
            let by_query = Strided { values: &ds, row, step: 1, rows: count, columns: keys };
            let out = Output { values: &mut dq[first * wide..], row: wide, columns: wide };
            weigh(tile, by_query, &k_rows, Start::Row(&ZERO), out);
            let by_key = |values| Strided { values, row: 1, step: row, rows: keys, columns: count };
            let out = Output { values: &mut dk, row: wide, columns: wide };
            weigh(tile, by_key(&ds), &q_rows[first * wide..], Start::Output, out);
            let out = Output { values: &mut dv, row: wide, columns: wide };
            weigh(tile, by_key(&p), &gradient_rows[first * wide..], Start::Output, out);
        }
        [dq, dk, dv]
    }
}

/// `a` times `b`, whose rows are padded to whole vectors. Sets, or adds to, the columns of `out`.
fn weigh<T: Tile>(tile: T, a: Strided, b: &[f32], start: Start, out: Output) {
    let Output { values, row, columns } = out;
    let b_step = columns.next_multiple_of(T::LANES);
    for r in (0..a.rows).step_by(T::ROWS) {
        for c in (0..columns).step_by(2 * T::LANES) {
            let columns = (2 * T::LANES).min(columns - c);
            let term = Term { a: &a.values[r * a.row..], a_row: a.row, a_step: a.step, b: &b[c..], b_step, k: a.columns };
            let out = Output { values: &mut values[r * row + c..], row, columns };
            tile.tile(T::ROWS.min(a.rows - r), columns.div_ceil(T::LANES), &[term], start, out);
        }
    }
}

/// Splits a range of tokens, counted through the batch, by item.
fn by_picture(tokens: Range<usize>, per_picture: usize) -> impl Iterator<Item = (usize, Range<usize>)> {
    let pictures = tokens.start / per_picture..tokens.end.div_ceil(per_picture);
    pictures.map(move |p| (p, tokens.start.max(p * per_picture)..tokens.end.min((p + 1) * per_picture)))
}
