//! Convolution as a gather: every output pixel sums input pixels times weights, tile by tile, without an im2col buffer.
use super::buffer;
use super::taps::Lattice;
use super::tile::{Output, Start, Term, Tile};
use rayon::prelude::*;

/// Size of a batch of channels-last pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pictures.
    pub batch: usize,
    /// Rows of each.
    pub height: usize,
    /// Columns of each.
    pub width: usize,
    /// Floats in a pixel.
    pub channels: usize,
}

impl Size {
    /// The size in cells of `factors` channels each.
    pub fn cells(self, factors: usize) -> Self {
        Self { channels: self.channels / factors, ..self }
    }

    /// Floats in all.
    pub fn len(&self) -> usize {
        self.batch * self.height * self.width * self.channels
    }
}

/// The picture of a source that belongs to a picture of the output, for frames of clips.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frames {
    /// Frames of a clip of the output.
    pub out: usize,
    /// Frames of a clip of the source.
    pub source: usize,
    /// Output frame i reads source frame `(i step + offset) / every`, where that is a whole number of 0..source.
    pub step: usize,
    /// See `step`.
    pub offset: isize,
    /// See `step`.
    pub every: usize,
}

impl Frames {
    /// Single pictures.
    pub const SINGLE: Self = Self { out: 1, source: 1, step: 1, offset: 0, every: 1 };

    /// The picture of the source for picture `index` of the output, both counted through the batch, or `None` if there is none.
    pub fn picture(self, index: usize) -> Option<usize> {
        let (clip, frame) = (index / self.out, index % self.out);
        let at = usize::try_from((frame * self.step) as isize + self.offset).ok()?;
        let frame = at / self.every;
        (at.is_multiple_of(self.every) && frame < self.source).then_some(clip * self.source + frame)
    }

    /// Whether any frame of the output reads the source.
    pub fn meet(self) -> bool {
        (0..self.out).any(|frame| self.picture(frame).is_some())
    }
}

/// A source of a convolution. Its channels are cells of the tile that reads it ([`Tile::FACTORS`]).
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Cells of the pictures.
    pub values: &'a [f32],
    /// Size in cells.
    pub size: Size,
    /// The pixels that an output pixel reads.
    pub lattice: Lattice,
    /// The pictures that an output picture reads.
    pub frames: Frames,
    /// Input channel of the weights, in cells, for the first channel of the source.
    pub first: usize,
    /// Channel of the weights for the first channel of the output.
    pub onto: usize,
}

/// Convolution weights `[kernel, kernel, inputs, outputs]`.
#[derive(Clone, Copy, Debug)]
pub struct Weights<'a> {
    /// Values.
    pub values: &'a [f32],
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Whether the gather runs from outputs to inputs, for a gradient.
    pub transposed: bool,
}

impl Weights<'_> {
    /// Sums of the weights of the kernel elements `taps`, of which there is at least one, from channel `from` of the source to
    /// channel `to` of the output and to those after it.
    fn sum(&self, taps: &[usize], from: usize, to: usize, sums: &mut [f32]) {
        let Self { values, inputs, outputs, .. } = *self;
        for (n, tap) in taps.iter().enumerate() {
            if self.transposed {
                let column = values[(tap * inputs + to) * outputs + from..].iter().step_by(outputs);
                add(n == 0, sums, column);
            } else {
                add(n == 0, sums, &values[(tap * inputs + from) * outputs + to..][..sums.len()]);
            }
        }
    }
}

/// Adds `values` to `sums`, or begins the sums with them.
#[inline(always)]
fn add<'a>(begin: bool, sums: &mut [f32], values: impl IntoIterator<Item = &'a f32>) {
    let pairs = sums.iter_mut().zip(values);
    if begin { pairs.for_each(|(sum, value)| *sum = *value) } else { pairs.for_each(|(sum, value)| *sum += value) }
}

/// The last operation on an output pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// Nothing.
    Plain,
    /// SiLU in place.
    Silu,
    /// SiLU to a second output. The first output keeps the sums for the gradient.
    SiluAndSums,
}

/// One pair of row and column taps of one source.
struct PackedTerm {
    source: usize,
    dy: isize,
    dx: isize,
    /// Place of its weights in a block.
    start: usize,
}

/// Weights of the output pixels with one pair of lattice remainders, `[block][term][channel][block width]`, with zeros after the
/// last output and up to a multiple of [`Tile::DEPTH`] channels.
struct Packed {
    terms: Vec<PackedTerm>,
    block: usize,
    values: Vec<f32>,
}

fn pack<T: Tile>(tile: T, sources: &[Source], weights: Weights, outputs: usize, wide: usize, py: usize, px: usize) -> Packed {
    let (mut terms, mut summed, mut block) = (vec![], vec![], 0);
    for (index, source) in sources.iter().enumerate() {
        for &(dy, rows) in source.lattice.taps[py] {
            for &(dx, columns) in source.lattice.taps[px] {
                terms.push(PackedTerm { source: index, dy, dx, start: block });
                let list: Vec<usize> = rows.iter().flat_map(|r| columns.iter().map(move |c| r * weights.kernel + c)).collect();
                summed.push(list);
                block += source.size.channels.next_multiple_of(T::DEPTH) * wide;
            }
        }
    }
    let mut values = vec![0.0; outputs.div_ceil(wide) * block];
    if block > 0 {
        values.par_chunks_mut(block).enumerate().for_each(|(i, values)| {
            let columns = wide.min(outputs - i * wide);
            // The weights of one input channel for these outputs, for each factor of a cell.
            let mut sums = vec![0.0; T::FACTORS * columns];
            for (term, list) in terms.iter().zip(&summed) {
                let source = &sources[term.source];
                let first = source.onto + i * wide;
                for (k, row) in values[term.start..][..source.size.channels * wide].chunks_exact_mut(wide).enumerate() {
                    for (factor, sums) in sums.chunks_exact_mut(columns).enumerate() {
                        let from = (source.first + k) * T::FACTORS + factor;
                        weights.sum(list, from, first, sums);
                    }
                    match sums.split_at(columns) {
                        (sums, []) => row[..columns].copy_from_slice(sums),
                        (first, second) => tile.pair(first, second, &mut row[..columns]),
                    }
                }
            }
        });
    }
    Packed { terms, block, values }
}

/// A tile of output pixels in one row, and the pieces of input that it reads.
struct Block {
    /// Index of the packed weights.
    pass: usize,
    /// Index of the first pixel in the chunk of output rows.
    pixel: usize,
    rows: usize,
    pieces: std::ops::Range<usize>,
}

/// The input of one term of a tile.
struct Piece {
    term: usize,
    start: usize,
    /// Whether it is a copy, because it reaches beyond the edge of the picture.
    copied: bool,
}

/// Buffers that a worker reuses for every chunk.
#[derive(Default)]
struct Plan {
    blocks: Vec<Block>,
    pieces: Vec<Piece>,
    /// Pixels of the blocks at the left and right edges, with zeros for those outside.
    edges: Vec<f32>,
}

/// The inputs for the layout of tiles.
struct Job<'a> {
    sources: &'a [Source<'a>],
    packed: &'a [Packed],
    /// Size of the output.
    out: Size,
    /// Most pixels of a tile.
    most: usize,
}

impl Plan {
    /// Lays out the tiles of row `row` of the output (counted through the batch), which is the `nth` row of the chunk.
    fn add_row(&mut self, job: &Job, row: usize, nth: usize) {
        let Job { sources, packed, out, most } = *job;
        let (picture, y) = (row / out.height, row % out.height);
        let spread = sources[0].lattice.spread;
        let (r, py) = (y / spread, y % spread);
        for px in 0..spread.min(out.width) {
            let pass = py * spread + px;
            let columns = (out.width - px).div_ceil(spread);
            for c in (0..columns).step_by(most) {
                let rows = most.min(columns - c);
                let first = self.pieces.len();
                for (index, term) in packed[pass].terms.iter().enumerate() {
                    let Source { size, lattice: Lattice { step, .. }, values, frames, .. } = sources[term.source];
                    let Some(picture) = frames.picture(picture) else { continue };
                    let sy = (r * step) as isize + term.dy;
                    if sy < 0 || sy >= size.height as isize {
                        continue;
                    }
                    let line = (picture * size.height + sy as usize) * size.width;
                    let x = (c * step) as isize + term.dx;
                    let last = x + ((rows - 1) * step) as isize;
                    if x >= 0 && last < size.width as isize {
                        self.pieces.push(Piece { term: index, start: (line + x as usize) * size.channels, copied: false });
                        continue;
                    }
                    self.pieces.push(Piece { term: index, start: self.edges.len(), copied: true });
                    for i in 0..rows {
                        let x = x + (i * step) as isize;
                        if x >= 0 && x < size.width as isize {
                            self.edges.extend_from_slice(&values[(line + x as usize) * size.channels..][..size.channels]);
                        } else {
                            self.edges.resize(self.edges.len() + size.channels, 0.0);
                        }
                    }
                }
                let pixel = nth * out.width + c * spread + px;
                self.blocks.push(Block { pass, pixel, rows, pieces: first..self.pieces.len() });
            }
        }
    }
}

/// Sums `sources` into pictures of size `out`. There is at least one source, and all sources have the same spread. Returns the
/// output, and the activated output for [`Finish::SiluAndSums`].
pub fn gather<T: Tile>(
    tile: T,
    sources: &[Source],
    weights: Weights,
    out: Size,
    bias: &[f32],
    finish: Finish,
) -> (Vec<f32>, Option<Vec<f32>>) {
    let (n, wide, spread) = (out.channels, 2 * T::LANES, sources[0].lattice.spread);
    let packed: Vec<Packed> =
        (0..spread * spread).map(|p| pack(tile, sources, weights, n, wide, p / spread, p % spread)).collect();
    let mut padded_bias = vec![0.0; n.next_multiple_of(wide)];
    padded_bias[..bias.len()].copy_from_slice(bias);

    // The rows of a chunk share each block of weights while it is in cache. Small pictures still have at least 16 chunks.
    let rows = out.batch * out.height;
    let per_chunk = (128 / out.width.max(1)).clamp(1, (rows / 16).max(1));
    let chunk_length = per_chunk * out.width * n;

    let job = Job { sources, packed: &packed, out, most: T::ROWS };
    let compute = |plan: &mut Plan, chunk: usize, values: &mut [f32]| {
        plan.blocks.clear();
        plan.pieces.clear();
        plan.edges.clear();
        let begin = chunk * per_chunk;
        for (nth, row) in (begin..rows.min(begin + per_chunk)).enumerate() {
            plan.add_row(&job, row, nth);
        }
        let mut terms: Vec<Term> = Vec::with_capacity(16);
        for (at, bias) in padded_bias.chunks_exact(wide).enumerate() {
            let columns = wide.min(n - at * wide);
            for block in &plan.blocks {
                let Packed { terms: all, block: length, values: weights } = &packed[block.pass];
                terms.clear();
                terms.extend(plan.pieces[block.pieces.clone()].iter().map(|piece| {
                    let term = &all[piece.term];
                    let source = &sources[term.source];
                    let k = source.size.channels;
                    let (memory, a_row) =
                        if piece.copied { (&plan.edges[..], k) } else { (source.values, source.lattice.step * k) };
                    let b = &weights[at * length + term.start..][..k.next_multiple_of(T::DEPTH) * wide];
                    Term { a: &memory[piece.start..], a_row, a_step: 1, b, b_step: wide, k }
                }));
                let out = Output { values: &mut values[block.pixel * n + at * wide..], row: spread * n, columns };
                tile.tile(block.rows, columns.div_ceil(T::LANES), &terms, Start::Row(bias), out);
            }
        }
    };
    match finish {
        Finish::Plain => (buffer::fill(out.len(), chunk_length, Plan::default, compute), None),
        Finish::Silu => {
            let state = || (Plan::default(), Vec::new());
            let activated = |(plan, sums): &mut (Plan, Vec<f32>), chunk: usize, values: &mut [f32]| {
                sums.resize(values.len(), 0.0);
                compute(plan, chunk, sums);
                tile.silu(sums, values);
            };
            (buffer::fill(out.len(), chunk_length, state, activated), None)
        }
        Finish::SiluAndSums => {
            let (sums, activated) = buffer::fill_two(out.len(), chunk_length, Plan::default, |plan, chunk, sums, activated| {
                compute(plan, chunk, sums);
                tile.silu(sums, activated);
            });
            (sums, Some(activated))
        }
    }
}
