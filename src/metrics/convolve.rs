//! Symmetric kernels along rows and columns, where SSIM and FLIP spend their time.

use std::ops::{Add, AddAssign, Mul, Sub};

/// A number of a picture plane.
pub trait Number: Copy + Default + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + AddAssign {}
impl<T: Copy + Default + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + AddAssign> Number for T {}

/// One half of a kernel, from its centre outwards. The other half mirrors it (`Even`), or mirrors it with the opposite sign
/// (`Odd`, with 0 at the centre).
#[derive(Clone, Debug)]
pub enum Taps<T> {
    /// `k(-i) = k(i)`.
    Even(Vec<T>),
    /// `k(-i) = -k(i)`; the sum is of `k(i) * v(x + i)`.
    Odd(Vec<T>),
}

impl<T> Taps<T> {
    /// Reach of the kernel in pixels.
    pub fn radius(&self) -> usize {
        match self {
            Self::Even(taps) | Self::Odd(taps) => taps.len().saturating_sub(1),
        }
    }
}

/// `sum[x] += sum over i of k(i) * line(i)[x]`, where `line(i)` are the values at distance `i`.
pub fn accumulate<'a, T: Number + 'a>(taps: &Taps<T>, line: impl Fn(isize) -> &'a [T], sum: &mut [T]) {
    match taps {
        Taps::Even(taps) => {
            for (i, &k) in (0..).zip(taps) {
                if i == 0 {
                    sum.iter_mut().zip(line(0)).for_each(|(s, &v)| *s += k * v);
                } else {
                    sum.iter_mut().zip(line(-i)).zip(line(i)).for_each(|((s, &a), &b)| *s += k * (a + b));
                }
            }
        }
        Taps::Odd(taps) => {
            for (i, &k) in (0..).zip(taps).skip(1) {
                sum.iter_mut().zip(line(-i)).zip(line(i)).for_each(|((s, &a), &b)| *s += k * (b - a));
            }
        }
    }
}

/// A row with its ends repeated `radius` times, for kernels that reach outside of the picture.
pub fn pad<T: Number>(row: &[T], radius: usize, padded: &mut Vec<T>) {
    padded.clear();
    let (Some(&first), Some(&last)) = (row.first(), row.last()) else { return };
    padded.resize(radius, first);
    padded.extend_from_slice(row);
    padded.resize(row.len() + 2 * radius, last);
}

/// Applies the kernel along each row of a plane `width` wide; the border repeats.
pub fn rows<T: Number>(plane: &[T], width: usize, taps: &Taps<T>) -> Vec<T> {
    let mut out = vec![T::default(); plane.len()];
    let (radius, mut padded) = (taps.radius(), Vec::new());
    for (row, out) in plane.chunks(width.max(1)).zip(out.chunks_mut(width.max(1))) {
        pad(row, radius, &mut padded);
        accumulate(taps, |i| &padded[radius.wrapping_add_signed(i)..], out);
    }
    out
}

/// Applies the kernel along each column of a plane `width` wide, and adds the result to `out`; the border repeats.
pub fn add_columns<T: Number>(plane: &[T], width: usize, taps: &Taps<T>, out: &mut [T]) {
    let height = plane.len() / width.max(1);
    for (y, out) in out.chunks_mut(width.max(1)).enumerate() {
        let line = |i: isize| {
            let y = y.saturating_add_signed(i).min(height - 1);
            &plane[y * width..(y + 1) * width]
        };
        accumulate(taps, line, out);
    }
}

/// As [`add_columns`], starting from 0.
pub fn columns<T: Number>(plane: &[T], width: usize, taps: &Taps<T>) -> Vec<T> {
    let mut out = vec![T::default(); plane.len()];
    add_columns(plane, width, taps, &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_to_the_sum_by_definition() {
        let kernels = [(Taps::Even(vec![0.5, 0.25, -0.75]), 1.0), (Taps::Odd(vec![0.0, 0.25, -0.75, 0.5]), -1.0)];
        for (width, height) in [(1, 1), (1, 5), (7, 1), (5, 4)] {
            let plane: Vec<f64> = (0..width * height).map(|i| ((i * 37 + 11) % 16) as f64).collect();
            for (taps, sign) in &kernels {
                let (Taps::Even(half) | Taps::Odd(half)) = taps;
                let kernel = |i: isize| half[i.unsigned_abs()] * if i < 0 { *sign } else { 1.0 };
                let at = |x: isize, y: isize| {
                    plane[y.clamp(0, height as isize - 1) as usize * width + x.clamp(0, width as isize - 1) as usize]
                };
                let r = taps.radius() as isize;
                let (by_row, by_column) = (rows(&plane, width, taps), columns(&plane, width, taps));
                for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
                    let (px, py) = (x as isize, y as isize);
                    let row: f64 = (-r..=r).map(|i| kernel(i) * at(px + i, py)).sum();
                    let column: f64 = (-r..=r).map(|i| kernel(i) * at(px, py + i)).sum();
                    assert_eq!([by_row[y * width + x], by_column[y * width + x]], [row, column], "{width}x{height} ({x}, {y})");
                }
            }
        }
    }
}
