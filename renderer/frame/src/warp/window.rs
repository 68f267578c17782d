//! Sums over square windows of a picture.

use rayon::prelude::*;

/// Sums of a pixel or of a window.
#[derive(Clone, Copy)]
pub(super) struct Sums<const N: usize>(pub [f64; N]);

impl<const N: usize> Default for Sums<N> {
    fn default() -> Self {
        Self([0.0; N])
    }
}

impl<const N: usize> Sums<N> {
    fn plus(self, other: Self, sign: f64) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + sign * other.0[k]))
    }

    /// The sum `of`, divided by the sum `over`, which counts pixels.
    pub fn mean(self, of: usize, over: usize) -> f64 {
        self.0[of] / self.0[over].max(1.0)
    }
}

/// Sums over all pixels above and to the left, with a row and a column of zeros in front (Crow 1984).
pub(super) struct Table<const N: usize> {
    width: usize,
    height: usize,
    sums: Vec<Sums<N>>,
}

impl<const N: usize> Table<N> {
    pub fn new(width: usize, height: usize, of: impl Fn(usize) -> Sums<N> + Sync) -> Self {
        let stride = width + 1;
        let mut sums = vec![Sums::default(); stride * (height + 1)];
        // Along each row, then from row to row.
        sums.par_chunks_mut(stride).skip(1).enumerate().for_each(|(y, row)| {
            for x in 0..width {
                row[x + 1] = row[x].plus(of(y * width + x), 1.0);
            }
        });
        for i in stride..sums.len() {
            sums[i] = sums[i].plus(sums[i - stride], 1.0);
        }
        Self { width, height, sums }
    }

    /// The sums over the pixels that lie up to `reach` columns and rows from pixel `i`.
    pub fn around(&self, i: usize, reach: usize) -> Sums<N> {
        let (x, y) = (i % self.width, i / self.width);
        let (right, below) = ((x + reach + 1).min(self.width), (y + reach + 1).min(self.height));
        let at = |x: usize, y: usize| self.sums[y * (self.width + 1) + x];
        let (left, above) = (x.saturating_sub(reach), y.saturating_sub(reach));
        at(right, below).plus(at(left, below), -1.0).plus(at(right, above), -1.0).plus(at(left, above), 1.0)
    }

    /// The same, over the smallest window in which the sum `counted` of pixels is at least the share `least` of all; its reach
    /// begins with `reach` and grows until the window covers the picture.
    pub fn enough(&self, i: usize, mut reach: usize, (counted, least): (usize, f64)) -> Sums<N> {
        loop {
            let sums = self.around(i, reach);
            let side = (2 * reach + 1) as f64;
            if sums.0[counted] >= least * side * side || reach >= self.width.max(self.height) {
                return sums;
            }
            reach = 2 * reach + 1;
        }
    }
}
