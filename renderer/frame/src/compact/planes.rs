//! Numbers of a picture as byte planes, optionally as differences from the pixel above.

/// Unsigned integers in 1, 2 or 4 bytes.
pub(super) trait Number: Copy + Default + Ord {
    /// Bytes.
    const BYTES: usize;
    /// `self - other`, modulo the size.
    fn minus(self, other: Self) -> Self;
    /// Appends byte plane `byte` of `numbers`.
    fn split(numbers: &[Self], byte: usize, planes: &mut Vec<u8>);
    /// Adds the numbers whose byte planes are `planes` (one slice a byte, each as long as `row`) to those of `row`.
    fn add(row: &mut [Self], planes: [&[u8]; 4]);
}

macro_rules! number {
    ($type:ty, $bytes:literal, |$a:ident, $b:ident, $c:ident, $d:ident| $join:expr) => {
        impl Number for $type {
            const BYTES: usize = $bytes;

            fn minus(self, other: Self) -> Self {
                self.wrapping_sub(other)
            }

            fn split(numbers: &[Self], byte: usize, planes: &mut Vec<u8>) {
                planes.extend(numbers.iter().map(|n| (n >> (8 * byte)) as u8));
            }

            fn add(row: &mut [Self], planes: [&[u8]; 4]) {
                // Unused planes repeat the first one: slices of one length let the loop vectorise.
                let [a, b, c, d] = planes.map(|plane| &plane[..row.len()]);
                for (i, number) in row.iter_mut().enumerate() {
                    let ($a, $b, $c, $d) = (Self::from(a[i]), Self::from(b[i]), Self::from(c[i]), Self::from(d[i]));
                    *number = number.wrapping_add($join);
                }
            }
        }
    };
}

number!(u8, 1, |a, _b, _c, _d| a);
number!(u16, 2, |a, b, _c, _d| a | b << 8);
number!(u32, 4, |a, b, c, d| a | b << 8 | c << 16 | d << 24);

/// Byte planes of `samples`, each `width` wide: the form that [`Rows`] reads.
pub(super) fn split<N: Number>(samples: &[Vec<N>], width: usize, delta: bool) -> Vec<u8> {
    let mut planes = Vec::with_capacity(samples.iter().map(|s| s.len() * N::BYTES).sum());
    for numbers in samples {
        let differences: Vec<N>;
        let numbers = if delta {
            let above = std::iter::repeat_n(N::default(), width).chain(numbers.iter().copied());
            differences = numbers.iter().zip(above).map(|(&n, above)| n.minus(above)).collect();
            &differences
        } else {
            numbers
        };
        (0..N::BYTES).for_each(|byte| N::split(numbers, byte, &mut planes));
    }
    planes
}

/// Returns the numbers of one sample row by row, from the top.
pub(super) struct Rows<'a, N> {
    planes: [&'a [u8]; 4],
    delta: bool,
    row: Vec<N>,
}

impl<'a, N: Number> Rows<'a, N> {
    /// Rows of sample `sample` of pictures of `width * height` pixels.
    pub fn new(raw: &'a [u8], sample: usize, width: usize, height: usize, delta: bool) -> Self {
        let pixels = width * height;
        let plane = |byte: usize| {
            let start = (sample * N::BYTES + byte % N::BYTES) * pixels;
            &raw[start..start + pixels]
        };
        Self { planes: [0, 1, 2, 3].map(plane), delta, row: vec![N::default(); width] }
    }

    /// The next row; it is called once for each row.
    pub fn next(&mut self) -> &[N] {
        if !self.delta {
            self.row.fill(N::default());
        }
        let width = self.row.len();
        let rows = self.planes.map(|plane| plane.split_at(width));
        N::add(&mut self.row, rows.map(|(row, _)| row));
        self.planes = rows.map(|(_, rest)| rest);
        &self.row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        fn round<N: Number + std::fmt::Debug>(number: impl Fn(u32) -> N) {
            let (width, height) = (19, 5);
            let samples: Vec<Vec<N>> = (0..3u32)
                .map(|s| (0..width * height).map(|i| number((s + 7 * i as u32).wrapping_mul(2_654_435_761))).collect())
                .collect();
            for delta in [false, true] {
                let raw = split(&samples, width, delta);
                assert_eq!(raw.len(), 3 * width * height * N::BYTES);
                for (sample, numbers) in samples.iter().enumerate() {
                    let mut rows = Rows::<N>::new(&raw, sample, width, height, delta);
                    numbers.chunks(width).for_each(|row| assert_eq!(rows.next(), row));
                }
            }
        }
        round(|v| v as u8);
        round(|v| v as u16);
        round(|v| v);
    }
}
