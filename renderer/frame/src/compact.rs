//! Compact frame files (`.rff`) for training. They hold the channels that a network reads, each in the fewest bytes that keep a
//! stated precision.
//!
//! # Layout
//! | bytes | what |
//! |---|---|
//! | 4 | signature `93 52 46 46` (`\x93RFF`) |
//! | 4 | version, little endian: 1 |
//! | 4 | size of the stored header in bytes, little endian |
//! | 4 | size of the decompressed header in bytes, little endian |
//! | | header: JSON, one zstd frame |
//! | | one zstd frame for each layer, without gaps; offsets are counted from the end of the header |
//!
//! Zstd frames carry a checksum, so a changed byte is an error rather than a different picture. The header holds `width`,
//! `height`, `info` (the same as the attributes of the OpenEXR form, [`crate::FrameInfo`]), `conventions`
//! ([`crate::channel::conventions`]), `left_out` (layers that the frame had but the file lacks) and `layers`: `name`,
//! `components`, `encoding`, `delta`, `offset`, `bytes`, `precision` and, where the encoding needs them, `lowest` and `step`.
//!
//! A block decompresses to byte planes: for each sample of a pixel the lowest bytes of all pixels, row by row, then the next
//! bytes. With `delta` the stored numbers are differences from the pixel above, modulo their size; the first row is stored
//! unchanged. In numpy:
//!
//! ```text
//! planes = numpy.frombuffer(zstd.decompress(block), "u1").reshape(samples, itemsize, height, width)
//! numbers = numpy.moveaxis(planes, 1, -1).copy().view(f"<u{itemsize}")[..., 0]
//! if layer["delta"]: numbers = numpy.cumsum(numbers, axis=1, dtype=numbers.dtype)
//! ```
//!
//! # Encodings
//! | encoding | samples x bytes | value | error against the frame |
//! |---|---|---|---|
//! | `half` | components x 2 | half float | of rounding to half: 2^-11 relative; none against the OpenEXR form |
//! | `float` | components x 4 | float | none |
//! | `unit8` | components x 1 | n / 255 | 1/510 |
//! | `srgb8` | components x 1 | [`crate::color::srgb_to_linear`] of n / 255 | 1/510 after the sRGB curve; at most 0.0045 linear |
//! | `octahedral12` | 2 x 2 | x, y = (n - 2048) / 2047 on the octahedron (Meyer 2010), unit length; 0, 0 = miss | 0.04 degrees |
//! | `depth16` | 1 x 2 | float whose bits are `lowest + (n - 1) step`; 0 = miss (+inf) | relative, in the header: never above 2^-13 |
//! | `u8`, `u16`, `u32` | 1 x 1, 2, 4 | unsigned integer | none |
//!
//! `depth16` counts in the bits of floats, which grow like the logarithm between powers of two. Decoding is exact integer
//! arithmetic and the same on every machine. Depths that span more than 1 : 65536 do not fit into 16 bits and are stored as
//! `float`.

mod decode;
mod encode;
mod header;
mod planes;

pub use decode::{decode, decode_layers, info, read};
pub use encode::{Loss, encode, encode_with, write};
pub use header::layer_name;

/// Ending of compact frame files.
pub const EXTENSION: &str = "rff";

/// First bytes of every compact frame file.
pub const SIGNATURE: [u8; 4] = *b"\x93RFF";

/// Version of the layout above.
const VERSION: u32 = 1;

/// Signature, version and two lengths.
const START: usize = 16;

/// Largest relative error of `depth16`. Where the error would be larger, depth is stored as `float`.
pub const DEPTH_ERROR: f32 = 1.0 / 8192.0;

/// Which layers a file keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Keep {
    /// What training reads: beauty, alpha, albedo, normal, depth, material, what is seen through, irradiance, motion both ways,
    /// ids.
    #[default]
    Training,
    /// Every layer the frame has: raw, variance, samples, light groups, guides and distance as well.
    All,
}
