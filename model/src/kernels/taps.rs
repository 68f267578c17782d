//! Which input pixels and which weights an output pixel is made of, along one axis.
use super::options::Stride;

/// One input pixel of a lattice: `offset` from the lattice's own place, times the sum of these kernel rows (or columns).
pub type AxisTap = (isize, &'static [usize]);

/// Output pixel `spread * r + p`, for each `p` below `spread`, reads input pixels `step * r + offset` for each tap of `taps[p]`.
/// The same holds along the other axis.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    /// Distance of output pixels with the same taps.
    pub spread: usize,
    /// Distance of the input pixels of two such neighbours.
    pub step: usize,
    /// Taps of each `p`; with a spread of 1 only the first is used.
    pub taps: [&'static [AxisTap]; 2],
}

const NONE: &[AxisTap] = &[];
const POINT: &[AxisTap] = &[(0, &[0])];
const THREE: &[AxisTap] = &[(-1, &[0]), (0, &[1]), (1, &[2])];
const AHEAD: &[AxisTap] = &[(0, &[0]), (1, &[1]), (2, &[2])];

impl Lattice {
    /// Taps of the output of a convolution.
    ///
    /// After enlarging two-fold, a kernel of three rows meets only two different input rows, so two of its rows are summed first:
    /// 4/9 of the products.
    pub fn forward(kernel: usize, stride: Stride) -> Self {
        let (spread, step, taps): (_, _, [&[AxisTap]; 2]) = match (stride, kernel) {
            (Stride::One, 1) => (1, 1, [POINT, NONE]),
            (Stride::One, _) => (1, 1, [THREE, NONE]),
            (Stride::Two, 1) => (1, 2, [POINT, NONE]),
            (Stride::Two, _) => (1, 2, [THREE, NONE]),
            (Stride::Half, _) => (1, 2, [AHEAD, NONE]),
            (Stride::Up, 1) => (2, 1, [POINT, POINT]),
            (Stride::Up, _) => (2, 1, [&[(-1, &[0]), (0, &[1, 2])], &[(0, &[0, 1]), (1, &[2])]]),
        };
        Self { spread, step, taps }
    }

    /// Taps of the gradient with respect to the input: its pixels read the gradient of the output through the same weights.
    pub fn backward(kernel: usize, stride: Stride) -> Self {
        let (spread, step, taps): (_, _, [&[AxisTap]; 2]) = match (stride, kernel) {
            (Stride::One, 1) => (1, 1, [POINT, NONE]),
            (Stride::One, _) => (1, 1, [&[(-1, &[2]), (0, &[1]), (1, &[0])], NONE]),
            (Stride::Two, 1) => (2, 1, [POINT, NONE]),
            (Stride::Two, _) => (2, 1, [&[(0, &[1])], &[(0, &[2]), (1, &[0])]]),
            (Stride::Half, _) => (2, 1, [&[(-1, &[2]), (0, &[0])], &[(0, &[1])]]),
            (Stride::Up, 1) => (1, 2, [&[(0, &[0]), (1, &[0])], NONE]),
            (Stride::Up, _) => (1, 2, [&[(-1, &[2]), (0, &[1, 2]), (1, &[0, 1]), (2, &[0])], NONE]),
        };
        Self { spread, step, taps }
    }

    /// Taps of a 3 x 3 convolution of a full-size input, written for the lattice of one that is enlarged two-fold,
    /// so that the two can be summed in one go.
    pub fn beside_up() -> Self {
        Self { spread: 2, step: 2, taps: [THREE, AHEAD] }
    }
}

/// The lattice positions below `count` whose input pixel `step * r + offset` lies inside `size` pixels.
pub fn inside(count: usize, size: usize, step: usize, offset: isize) -> std::ops::Range<usize> {
    let first = (-offset).max(0) as usize;
    // Largest r with step * r + offset <= size - 1.
    let room = size as isize - offset;
    let end = if room <= 0 { 0 } else { (room as usize).div_ceil(step) };
    first.div_ceil(step).min(count)..end.min(count).max(first.div_ceil(step).min(count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inside_is_what_a_search_finds() {
        for (count, size, step) in [(0, 1, 1), (1, 1, 1), (5, 5, 1), (3, 5, 2), (4, 3, 1), (2, 9, 2), (7, 4, 2)] {
            for offset in -3..=3_isize {
                let found: Vec<usize> =
                    (0..count).filter(|r| (0..size as isize).contains(&((r * step) as isize + offset))).collect();
                assert_eq!(inside(count, size, step, offset).collect::<Vec<_>>(), found, "{count} {size} {step} {offset}");
            }
        }
    }

    /// The gradient's lattice must hold exactly the (output, input, weight) triples of the convolution.
    #[test]
    fn backward_lattices_transpose_forward_ones() {
        let triples = |lattice: Lattice, count: usize, size: usize| {
            let mut all = vec![];
            for place in 0..count {
                for &(offset, weights) in lattice.taps[place % lattice.spread] {
                    let other = (lattice.step * (place / lattice.spread)) as isize + offset;
                    if (0..size as isize).contains(&other) {
                        all.extend(weights.iter().map(|&w| (place, other as usize, w)));
                    }
                }
            }
            all.sort_unstable();
            all
        };
        for kernel in [1, 3] {
            for stride in [Stride::One, Stride::Two, Stride::Half, Stride::Up] {
                for size in 1..8 {
                    if (kernel, stride) == (1, Stride::Half) {
                        continue;
                    }
                    let forward = triples(Lattice::forward(kernel, stride), stride.output(size), size);
                    let mut backward = triples(Lattice::backward(kernel, stride), size, stride.output(size));
                    for (a, b, _) in &mut backward {
                        std::mem::swap(a, b);
                    }
                    backward.sort_unstable();
                    assert_eq!(forward, backward, "{kernel} {stride:?} {size}");
                }
            }
        }
    }
}
