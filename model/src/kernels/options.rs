//! Variants of a convolution.

use serde::{Deserialize, Serialize};

/// Where a convolution puts its output pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stride {
    /// As many pixels out as in.
    One,
    /// Every second pixel, starting with the first: `ceil(height / 2)` by `ceil(width / 2)`.
    Two,
    /// Every second pixel, of windows of 3 x 3 that begin at the first: `height / 2` by `width / 2`, rounded down. What a window has
    /// beyond the picture, on the right and below, is zero.
    Half,
    /// The picture is enlarged two-fold (each pixel becomes 2 x 2 equal ones) and then convolved.
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

/// How a convolution multiplies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Products {
    /// Floats of 32 bits.
    #[default]
    F32,
    /// Factors are rounded to bf16 (8 bits of mantissa) and products summed in f32, forwards and backwards, where the processor has
    /// instructions for that (AVX-512 BF16) and the numbers of channels are even; otherwise as [`Self::F32`].
    Bf16,
}
