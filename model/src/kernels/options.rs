//! Variants of a convolution.

use serde::{Deserialize, Serialize};

/// The positions of a convolution's output pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stride {
    /// One output pixel for each input pixel.
    One,
    /// Every second pixel, starting with the first: `ceil(height / 2)` by `ceil(width / 2)`.
    Two,
    /// Every second pixel, with windows of 3 x 3 pixels that begin at the output pixel: `height / 2` by `width / 2`, rounded
    /// down. Pixels beyond the right and bottom edges are zero.
    Half,
    /// The picture is doubled in size (each pixel becomes 2 x 2 equal pixels) and then convolved.
    Up,
}

impl Stride {
    /// Height (or width) of the output for a height (or width) of the input.
    pub fn output(self, size: usize) -> usize {
        match self {
            Self::One => size,
            Self::Two => size.div_ceil(2),
            Self::Half => size / 2,
            Self::Up => 2 * size,
        }
    }
}

/// The precision of a convolution's products.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Products {
    /// 32-bit floats.
    #[default]
    F32,
    /// Factors are rounded to bf16 (8 bits of mantissa) and products are summed in f32, forwards and backwards. On the
    /// processor, this needs AVX-512 BF16 and even numbers of channels, and AMX is used where it is there. A GPU that computes in
    /// bf16 rounds the sums too. Elsewhere, it is the same as [`Self::F32`].
    Bf16,
}
