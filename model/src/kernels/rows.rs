//! What happens to tokens between matrix products, each in one pass over the rows in place of several of burn's on one thread.
use super::buffer;
use super::norm::sum;
use super::tile::Tile;
use rayon::prelude::*;

/// Values a task works on, about: what a core's first cache holds.
const TASK: usize = 4096;

/// Rows `[n, channels]` of which as many follow one another as share the same parameters.
#[derive(Clone, Copy, Debug)]
pub struct Groups {
    /// Values of a row.
    pub channels: usize,
    /// Rows that follow one another with the same parameters.
    pub rows: usize,
}

impl Groups {
    /// `values` floats whose parameters are `parameters` floats.
    pub fn of(values: usize, parameters: usize, channels: usize) -> Self {
        Self { channels, rows: values / parameters.max(1) }
    }

    /// Rows of a task: never of two groups.
    fn task(self) -> usize {
        let most = (TASK / self.channels).clamp(1, self.rows.max(1));
        (1..=most).rev().find(|rows| self.rows.is_multiple_of(*rows)).unwrap_or(1)
    }
}

/// `factor xhat + shift` with factor and shift of each group, where xhat is x or, with `eps`, x less its row's mean, divided by
/// `sqrt(variance + eps)`.
#[derive(Clone, Copy, Debug)]
pub struct Modulate<'a> {
    /// Rows.
    pub x: &'a [f32],
    /// `[groups, channels]`.
    pub factor: &'a [f32],
    /// How rows share factors and shifts.
    pub groups: Groups,
    /// With normalisation.
    pub eps: Option<f32>,
}

impl Modulate<'_> {
    /// What is subtracted from a row, and what it is multiplied by then.
    fn statistics(&self, row: &[f32]) -> (f32, f32) {
        let Some(eps) = self.eps else { return (0.0, 1.0) };
        let count = row.len() as f32;
        let mean = sum(row, row, |x, _| x) / count;
        let variance = sum(row, row, |x, _| (x - mean) * (x - mean)) / count;
        (mean, 1.0 / (variance + eps).sqrt())
    }

    /// As many values as `x` has.
    pub fn forward(&self, shift: &[f32]) -> Vec<f32> {
        let Groups { channels, rows } = self.groups;
        let task = self.groups.task() * channels;
        buffer::fill(
            self.x.len(),
            task,
            || (),
            |(), i, y| {
                let group = i * task / (rows * channels) * channels;
                let (factor, shift) = (&self.factor[group..][..channels], &shift[group..][..channels]);
                for (x, y) in self.x[i * task..][..y.len()].chunks_exact(channels).zip(y.chunks_exact_mut(channels)) {
                    let (mean, scale) = self.statistics(x);
                    for (((y, x), factor), shift) in y.iter_mut().zip(x).zip(factor).zip(shift) {
                        *y = (x - mean) * scale * factor + shift;
                    }
                }
            },
        )
    }

    /// Gradients of x, factor and shift.
    pub fn backward(&self, gradient: &[f32]) -> [Vec<f32>; 3] {
        let Groups { channels, rows } = self.groups;
        let task = self.groups.task() * channels;
        let (mut dx, mut dfactor, mut dshift) =
            (vec![0.0; self.x.len()], vec![0.0; self.factor.len()], vec![0.0; self.factor.len()]);
        let parts: Vec<(Vec<f32>, Vec<f32>)> = dx
            .par_chunks_mut(task)
            .enumerate()
            .map(|(i, dx)| {
                let factor = &self.factor[i * task / (rows * channels) * channels..][..channels];
                let (mut dfactor, mut dshift) = (vec![0.0; channels], vec![0.0; channels]);
                let places = (i * task..i * task + dx.len()).step_by(channels);
                for (at, dx) in places.zip(dx.chunks_exact_mut(channels)) {
                    let (x, gradient) = (&self.x[at..][..channels], &gradient[at..][..channels]);
                    let (mean, scale) = self.statistics(x);
                    let values = x.iter().zip(gradient).zip(factor).zip(&mut *dx).zip(dfactor.iter_mut().zip(&mut dshift));
                    for ((((x, g), factor), dx), (dfactor, dshift)) in values {
                        *dfactor += g * (x - mean) * scale;
                        *dshift += g;
                        *dx = g * factor * scale;
                    }
                    if self.eps.is_some() {
                        // What moves or stretches the whole row changes nothing.
                        let count = channels as f32;
                        let mid = sum(dx, dx, |d, _| d) / count;
                        let along = sum(dx, x, |d, x| d * (x - mean)) * scale * scale / count;
                        for (d, x) in dx.iter_mut().zip(x) {
                            *d -= mid + (x - mean) * along;
                        }
                    }
                }
                (dfactor, dshift)
            })
            .collect();
        for (i, (factor, shift)) in parts.into_iter().enumerate() {
            let group = i * task / (rows * channels) * channels;
            add(&mut dfactor[group..][..channels], &factor);
            add(&mut dshift[group..][..channels], &shift);
        }
        [dx, dfactor, dshift]
    }
}

/// `x + y gate` with a gate of each group.
pub fn gate(x: &[f32], y: &[f32], gate: &[f32], groups: Groups) -> Vec<f32> {
    let task = groups.task() * groups.channels;
    buffer::fill(
        x.len(),
        task,
        || (),
        |(), i, out| {
            let gate = &gate[i * task / (groups.rows * groups.channels) * groups.channels..][..groups.channels];
            let at = i * task..i * task + out.len();
            let rows = out.chunks_exact_mut(groups.channels).zip(x[at.clone()].chunks_exact(groups.channels));
            for ((out, x), y) in rows.zip(y[at].chunks_exact(groups.channels)) {
                for (((out, x), y), gate) in out.iter_mut().zip(x).zip(y).zip(gate) {
                    *out = x + y * gate;
                }
            }
        },
    )
}

/// Gradients of y and of the gate of [`gate`]; that of x is the gradient itself.
pub fn gate_gradient(y: &[f32], gate: &[f32], gradient: &[f32], groups: Groups) -> [Vec<f32>; 2] {
    // The product by a factor, without a shift.
    let product = Modulate { x: y, factor: gate, groups, eps: None };
    let [dy, dgate, _] = product.backward(gradient);
    [dy, dgate]
}

/// Turns pairs of neighbouring channels of each head: `(a cos - b sin, a sin + b cos)`, with `[tokens, pairs of a head]` cosines
/// and sines, the same for every head and every item; the other way round if `back`.
pub fn turn(x: &[f32], cos: &[f32], sin: &[f32], channels: usize, pairs: usize, back: bool) -> Vec<f32> {
    let tokens = cos.len() / pairs.max(1);
    let sign = if back { -1.0 } else { 1.0 };
    let task = (TASK / channels).max(1) * channels;
    buffer::fill(
        x.len(),
        task,
        || (),
        |(), i, y| {
            let first = i * task / channels;
            let rows = x[i * task..][..y.len()].chunks_exact(channels).zip(y.chunks_exact_mut(channels));
            for (token, (x, y)) in (first..).zip(rows) {
                let at = token % tokens * pairs;
                for (x, y) in x.chunks_exact(2 * pairs).zip(y.chunks_exact_mut(2 * pairs)) {
                    let turns = cos[at..][..pairs].iter().zip(&sin[at..][..pairs]);
                    for ((x, y), (cos, sin)) in x.as_chunks::<2>().0.iter().zip(y.as_chunks_mut::<2>().0).zip(turns) {
                        let sin = sign * sin;
                        *y = [x[0] * cos - x[1] * sin, x[0] * sin + x[1] * cos];
                    }
                }
            }
        },
    )
}

/// GELU by the hyperbolic tangent, of each value.
pub fn gelu<T: Tile>(tile: T, x: &[f32]) -> Vec<f32> {
    buffer::fill(x.len(), TASK, || (), |(), i, y| tile.gelu(&x[i * TASK..][..y.len()], y))
}

/// Gradient of x of [`gelu`].
pub fn gelu_gradient<T: Tile>(tile: T, x: &[f32], gradient: &[f32]) -> Vec<f32> {
    buffer::fill(
        x.len(),
        TASK,
        || (),
        |(), i, d| {
            let at = i * TASK..i * TASK + d.len();
            tile.gelu_gradient(&x[at.clone()], &gradient[at], d);
        },
    )
}

fn add(sums: &mut [f32], values: &[f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}
