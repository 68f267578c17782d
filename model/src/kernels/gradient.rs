//! Gradients of a convolution with respect to its weights and bias.
//!
//! Only the size of the problem decides how work is divided, and partial sums are added in a fixed order. The result therefore
//! does not depend on the number of threads.
use super::buffer;
use super::gather::{Size, Source};
use super::taps::inside;
use super::tile::{Output, Start, Term, Tile};
use rayon::prelude::*;

/// Input channels of one task.
const CHANNELS: usize = 32;
/// Pixels whose inputs and gradients stay in the first two cache levels while all their products are formed.
const PIXELS: usize = 192;
/// Bytes of input and gradient that one core's cache holds.
const CACHE: usize = 1 << 20;

/// The part of a row that one term sums over.
#[derive(Clone, Copy)]
struct Segment {
    /// First float in the source.
    a: usize,
    /// First float in the gradient.
    b: usize,
    pixels: usize,
}

/// One pair of row and column taps.
#[derive(Clone, Copy)]
struct Tap {
    /// Remainders of the output's row and column.
    py: usize,
    px: usize,
    /// Offsets of the source's row and column.
    dy: isize,
    dx: isize,
}

/// The gradient with respect to the weights of a convolution.
pub struct WeightGradient<'a> {
    /// `[kernel, kernel, inputs, outputs]`.
    pub values: &'a mut [f32],
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// Input channels.
    pub inputs: usize,
}

/// Adds the part of the gradient that the channels of `source` have. `gradient` is the gradient with respect to the sums, of size
/// `out`.
pub fn weights<T: Tile>(tile: T, source: &Source, gradient: &[f32], out: Size, into: WeightGradient) {
    let WeightGradient { values: dw, kernel, inputs } = into;
    let (channels, outputs) = (source.size.channels, out.channels);
    if source.size.len() == 0 || out.len() == 0 {
        return;
    }
    let wide = outputs.next_multiple_of(T::LANES);
    let padded: Vec<f32>;
    let gradient = if wide == outputs {
        gradient
    } else {
        padded = buffer::fill(
            out.len() / outputs * wide,
            256 * wide,
            || (),
            |(), i, values| {
                for (to, from) in values.chunks_exact_mut(wide).zip(gradient[i * 256 * outputs..].chunks_exact(outputs)) {
                    to[..outputs].copy_from_slice(from);
                }
            },
        );
        &padded
    };

    let spread = source.lattice.spread;
    let pairs = (T::FACTORS == 2).then(|| Pairs::new(tile, source, gradient, out, wide));
    // Each pair of row and column taps: lattice remainders, offsets, and the kernel elements that its sum belongs to.
    let mut taps = vec![];
    for py in 0..spread {
        for px in 0..spread {
            for &(dy, rows) in source.lattice.taps[py] {
                for &(dx, columns) in source.lattice.taps[px] {
                    let kernel: Vec<usize> = rows.iter().flat_map(|r| columns.iter().map(move |c| r * kernel + c)).collect();
                    taps.push((py, px, dy, dx, kernel));
                }
            }
        }
    }
    let lattice_rows = out.batch * out.height.div_ceil(spread);
    let tasks = taps.len() * channels.div_ceil(CHANNELS);
    let data = source.size.len() + out.len();
    let chunks = chunk_count(tasks, 4 * taps.len() * channels * outputs, 4 * data, lattice_rows);

    // [chunk][tap][channel][output]
    let mut partial = vec![0.0_f32; chunks * taps.len() * channels * wide];
    partial.par_chunks_mut(channels * wide).enumerate().for_each(|(i, sums)| {
        let (chunk, (py, px, dy, dx, _)) = (i / taps.len(), &taps[i % taps.len()]);
        let rows = chunk * lattice_rows / chunks..(chunk + 1) * lattice_rows / chunks;
        let tap = Tap { py: *py, px: *px, dy: *dy, dx: *dx };
        let segments = match &pairs {
            Some(pairs) => pairs.list_segments(source, out, wide, rows, tap),
            None => list_segments(source, out, wide, rows, tap),
        };
        let pixels = match &pairs {
            Some(pairs) => PixelSum {
                values: pairs.x(*dx),
                gradient: &pairs.gradient[*px],
                channel: pairs.steps[0],
                pixel: pairs.steps[1],
                gradient_pixel: wide,
                segments: &segments,
            },
            None => PixelSum {
                values: source.values,
                gradient,
                channel: 1,
                pixel: source.lattice.step * channels,
                gradient_pixel: spread * wide,
                segments: &segments,
            },
        };
        sums.par_chunks_mut(CHANNELS * wide).enumerate().for_each(|(block, sums)| {
            accumulate(tile, &pixels, block * CHANNELS, wide, sums);
        });
    });

    dw.par_chunks_mut(outputs).enumerate().for_each(|(i, row)| {
        let (element, channel) = (i / inputs, i % inputs);
        let Some(channel) = channel.checked_sub(source.first).filter(|c| *c < channels) else { return };
        for chunk in 0..chunks {
            for (t, (.., elements)) in taps.iter().enumerate() {
                if elements.contains(&element) {
                    let from = &partial[((chunk * taps.len() + t) * channels + channel) * wide..];
                    row.iter_mut().zip(from).for_each(|(to, from)| *to += from);
                }
            }
        }
    });
}

/// Number of chunks of rows for the sum over pixels. The data of a chunk fits a cache, there are enough tasks for many cores, and
/// the partial sums take at most 32 MiB.
fn chunk_count(tasks_per_chunk: usize, bytes_per_chunk: usize, data: usize, rows: usize) -> usize {
    let wanted = (data / CACHE).max(32_usize.div_ceil(tasks_per_chunk));
    wanted.min((32 << 20) / bytes_per_chunk.max(1)).clamp(1, 64).min(rows)
}

/// The stretches of pixels, of at most [`PIXELS`], that lattice rows `rows` give to one tap.
fn list_segments(
    source: &Source,
    out: Size,
    wide: usize,
    rows: std::ops::Range<usize>,
    Tap { py, px, dy, dx }: Tap,
) -> Vec<Segment> {
    let mut segments = vec![];
    let (spread, step) = (source.lattice.spread, source.lattice.step);
    let per_picture = out.height.div_ceil(spread);
    if px >= out.width {
        return segments;
    }
    let columns = inside((out.width - px).div_ceil(spread), source.size.width, step, dx);
    for row in rows {
        let (picture, r) = (row / per_picture, row % per_picture);
        let (y, sy) = (r * spread + py, (r * step) as isize + dy);
        if y >= out.height || sy < 0 || sy >= source.size.height as isize {
            continue;
        }
        let Some(read) = source.frames.picture(picture) else { continue };
        for c in columns.clone().step_by(PIXELS) {
            let x = ((c * step) as isize + dx) as usize;
            let a = ((read * source.size.height + sy as usize) * source.size.width + x) * source.size.channels;
            let b = ((picture * out.height + y) * out.width + c * spread + px) * wide;
            segments.push(Segment { a, b, pixels: PIXELS.min(columns.end - c) });
        }
    }
    segments
}

/// Cells of two pixels each: those whose products with the gradient are summed under one tap.
struct Pairs {
    /// Cells of a row.
    columns: usize,
    /// Distance in `x` from one channel to the next, and from one cell to the next.
    steps: [usize; 2],
    /// For each offset of columns, `[pictures, rows, cells, channels]` of the source, or `[pictures, rows, channels, cells]` for
    /// a tile that multiplies several cells together.
    x: Vec<(isize, Vec<f32>)>,
    /// For each remainder of columns, `[pictures, rows, cells, wide]` of the gradient.
    gradient: Vec<Vec<f32>>,
}

impl Pairs {
    fn new<T: Tile>(tile: T, source: &Source, gradient: &[f32], out: Size, wide: usize) -> Self {
        let (spread, step, size) = (source.lattice.spread, source.lattice.step, source.size);
        let columns = out.width.div_ceil(spread).div_ceil(2).next_multiple_of(T::DEPTH);
        // Pixel `place` of a row of `width`, or zeros beyond its ends.
        let none = vec![0.0; size.channels.max(wide)];
        let cells = |values: &[f32], width: usize, channels: usize, place: &(dyn Fn(usize) -> isize + Sync)| {
            let rows = values.len() / (width * channels);
            buffer::fill(
                rows * columns * channels,
                columns * channels,
                || (),
                |(), row, cells| {
                    let row = &values[row * width * channels..][..width * channels];
                    let pixel = |column: usize| match usize::try_from(place(column)) {
                        Ok(x) if x < width => &row[x * channels..][..channels],
                        _ => &none[..channels],
                    };
                    for (j, cells) in cells.chunks_exact_mut(channels).enumerate() {
                        tile.pair(pixel(2 * j), pixel(2 * j + 1), cells);
                    }
                },
            )
        };
        let mut offsets: Vec<isize> =
            source.lattice.taps[..spread].iter().flat_map(|taps| taps.iter().map(|tap| tap.0)).collect();
        offsets.sort_unstable();
        offsets.dedup();
        let of_offset = |dx: isize| {
            let place = move |column: usize| (column * step) as isize + dx;
            let x = cells(source.values, size.width, size.channels, &place);
            (dx, if T::DEPTH > 1 { transposed(&x, columns, size.channels) } else { x })
        };
        let of_remainder = |px: usize| cells(gradient, out.width, wide, &move |column: usize| (column * spread + px) as isize);
        Self {
            columns,
            steps: if T::DEPTH > 1 { [columns, 1] } else { [1, size.channels] },
            x: offsets.into_iter().map(of_offset).collect(),
            gradient: (0..spread).map(of_remainder).collect(),
        }
    }

    /// Cells of the source under the taps of offset `dx`.
    fn x(&self, dx: isize) -> &[f32] {
        self.x.iter().find(|(offset, _)| *offset == dx).map_or(&[], |(_, cells)| cells)
    }

    /// As [`list_segments`], in cells.
    fn list_segments(&self, source: &Source, out: Size, wide: usize, rows: std::ops::Range<usize>, tap: Tap) -> Vec<Segment> {
        let (spread, step) = (source.lattice.spread, source.lattice.step);
        let per_picture = out.height.div_ceil(spread);
        let mut segments = vec![];
        for row in rows {
            let (picture, r) = (row / per_picture, row % per_picture);
            let (y, sy) = (r * spread + tap.py, (r * step) as isize + tap.dy);
            if y >= out.height || sy < 0 || sy >= source.size.height as isize {
                continue;
            }
            for c in (0..self.columns).step_by(PIXELS) {
                let line = picture * source.size.height + sy as usize;
                let a = line * self.columns * source.size.channels + c * self.steps[1];
                let b = ((picture * out.height + y) * self.columns + c) * wide;
                segments.push(Segment { a, b, pixels: PIXELS.min(self.columns - c) });
            }
        }
        segments
    }
}

/// Each picture row of `[rows, cells, channels]` as `[channels, cells]`.
fn transposed(x: &[f32], cells: usize, channels: usize) -> Vec<f32> {
    buffer::fill(
        x.len(),
        cells * channels,
        || (),
        |(), row, values| {
            let row = &x[row * cells * channels..][..cells * channels];
            for (channel, values) in values.chunks_exact_mut(cells).enumerate() {
                for (value, cell) in values.iter_mut().zip(row.chunks_exact(channels)) {
                    *value = cell[channel];
                }
            }
        },
    )
}

/// A sum of products over pixels, or over cells of pixels.
#[derive(Clone, Copy)]
struct PixelSum<'a> {
    values: &'a [f32],
    gradient: &'a [f32],
    /// Distance in `values` from one channel to the next.
    channel: usize,
    /// Distance in `values` from one pixel to the next.
    pixel: usize,
    /// Distance in `gradient` from one pixel to the next.
    gradient_pixel: usize,
    segments: &'a [Segment],
}

/// Adds the products of values and gradient to `sums` `[channels, wide]`, whose first row is channel `first`.
fn accumulate<T: Tile>(tile: T, pixels: &PixelSum, first: usize, wide: usize, sums: &mut [f32]) {
    let PixelSum { values, gradient, channel, pixel, gradient_pixel, segments } = *pixels;
    let channels = sums.len() / wide;
    let mut terms: Vec<Term> = Vec::with_capacity(PIXELS);
    let mut rest = segments;
    while !rest.is_empty() {
        let mut pixels = 0;
        let count = rest.iter().take_while(|s| (pixels == 0 || pixels + s.pixels <= PIXELS, pixels += s.pixels).0).count();
        let (group, later) = rest.split_at(count);
        rest = later;
        for n in (0..wide).step_by(2 * T::LANES) {
            let columns = (2 * T::LANES).min(wide - n);
            for c in (0..channels).step_by(T::ROWS) {
                terms.clear();
                terms.extend(group.iter().map(|s| Term {
                    a: &values[s.a + (first + c) * channel..],
                    a_row: channel,
                    a_step: pixel,
                    b: &gradient[s.b + n..],
                    b_step: gradient_pixel,
                    k: s.pixels,
                }));
                let out = Output { values: &mut sums[c * wide + n..], row: wide, columns };
                tile.tile(T::ROWS.min(channels - c), columns / T::LANES, &terms, Start::Output, out);
            }
        }
    }
}

/// Gradient with respect to the bias: the sum over pixels.
pub fn bias(gradient: &[f32], channels: usize) -> Vec<f32> {
    const CHUNK: usize = 1024;
    let mut total = vec![0.0; channels];
    if channels == 0 {
        return total;
    }
    let partial: Vec<Vec<f32>> = gradient
        .par_chunks(CHUNK * channels)
        .map(|pixels| {
            let mut sums = vec![0.0_f32; channels];
            for pixel in pixels.chunks_exact(channels) {
                sums.iter_mut().zip(pixel).for_each(|(s, g)| *s += g);
            }
            sums
        })
        .collect();
    for sums in partial {
        total.iter_mut().zip(sums).for_each(|(t, s)| *t += s);
    }
    total
}

/// Gradient with respect to the sums, from that with respect to their SiLU.
pub fn before_silu<T: Tile>(tile: T, sums: &[f32], gradient: &[f32]) -> Vec<f32> {
    const CHUNK: usize = 1 << 14;
    buffer::fill(
        gradient.len(),
        CHUNK,
        || (),
        |(), i, values| {
            let range = i * CHUNK..i * CHUNK + values.len();
            tile.silu_gradient(&sums[range.clone()], &gradient[range], values);
        },
    )
}
