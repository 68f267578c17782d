//! Convolution over space and time, attention, and what happens to pixels and tokens in between, for the CPU: implicit matrix products on
//! channels-last pictures, without an im2col buffer, and single passes over rows.
//!
//! All work is a small tile of outputs kept in registers ([`tile`]), filled from lists of input pixels and packed weights
//! ([`gather`], [`gradient`]); a clip's taps over time are further sources of the same sum, so that no frame is copied. It exists in AVX-512, in AVX2 and, as their portable twin, in plain Rust; all three return the same bits, for
//! any number of threads. [`crate::ops`] chooses between them and [`portable`], the composition of burn's own operations that
//! serves every other device and element type.
//!
//! A fourth, AVX-512 BF16, multiplies factors rounded to bf16 in pairs where that is asked for ([`crate::ops::Products`]); its bits are its own.
//!
//! Weights are packed anew in each call to `[outputs / block][tap][inputs][block]`, with a block of two vectors. The
//! gradient of the input is the same gather over the transposed lattice; that of the weights sums over pixels instead of channels.
//!
//! Convolution 3 x 3, 64 to 64 channels, 128 x 128 pixels, batch of 4, with SiLU, against the composition: 6.7-6.9 times as fast
//! forward and 5.7-5.9 times with all gradients in AVX-512, 3.5 and 3.2 times in AVX2. Two runs of `measure_against_the_composition`
//! in `tests/kernels.rs` (variants alternating in one process, medians of 9, glibc's allocator) on four busy Zen 5 cores; the
//! fused enlargement (16-19 times forward) and stride 2 gain most, small deep layers and point-wise products least (3 times).
//! Channel normalisation with SiLU, which burn composes of ten passes on one thread: 21-24 times forward, 6 times with gradients. On 2048
//! tokens of 320 channels: root mean square 3 and 2.3 times, modulated normalisation 4.7 and 2.4, gates 2.3 and 1.2, rotary places 46 and
//! 35, GELU 23 and 16 (of 1280 channels). Convolution over time, 64 channels, 62 x 64 pixels: 4 frames 5.4 and 6.2 times, stills 13 and 15.
pub mod options;
pub mod portable;

mod attention;
mod buffer;
mod convolve;
mod extension;
mod gather;
mod gradient;
mod norm;
mod rows;
mod taps;
mod tile;
mod tokens;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use extension::{attention, channel_norm, conv, conv_over_time, decode, rms_norm};
pub(crate) use tokens::{gate, gelu, modulate, turn};

use self::tile::Tile as _;
use burn::backend::DispatchDevice;
use burn::tensor::{DType, Device};
use std::sync::atomic::{AtomicU8, Ordering};

/// An implementation of the kernels that this processor can run.
#[derive(Clone, Copy, Debug)]
enum Kernel {
    #[cfg(target_arch = "x86_64")]
    Avx512(x86::Avx512),
    #[cfg(target_arch = "x86_64")]
    Avx2(x86::Avx2),
    Scalar,
}

/// Names of the implementations, to force one in a test or a measurement.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Choice {
    /// The best that the processor has.
    Automatic,
    /// [`portable`].
    Composed,
    /// Plain Rust.
    Scalar,
    /// AVX2 with fused multiply-add.
    Avx2,
    /// AVX-512.
    Avx512,
}

static FORCED: AtomicU8 = AtomicU8::new(Choice::Automatic as u8);

/// Makes the whole process use one implementation; `false` (and no change) if the processor lacks it.
#[doc(hidden)]
pub fn force(choice: Choice) -> bool {
    let available = match choice {
        Choice::Avx2 => avx2().is_some(),
        Choice::Avx512 => avx512().is_some(),
        _ => true,
    };
    if available {
        FORCED.store(choice as u8, Ordering::Relaxed);
    }
    available
}

impl Kernel {
    /// The implementation in use; `None` for [`portable`].
    fn active() -> Option<Self> {
        let forced = FORCED.load(Ordering::Relaxed);
        match forced {
            _ if forced == Choice::Composed as u8 => None,
            _ if forced == Choice::Scalar as u8 => Some(Self::Scalar),
            _ if forced == Choice::Avx2 as u8 => avx2(),
            _ if forced == Choice::Avx512 as u8 => avx512(),
            // Only there is the fused multiply-add of the plain version an instruction.
            _ => avx512().or_else(avx2).or(cfg!(target_arch = "aarch64").then_some(Self::Scalar)),
        }
    }
}

/// Replaces each value, clamped to -87..=87, by its exponential, within 2 ulp; fastest where there are multiples of 16.
pub(crate) fn exp(values: &mut [f32]) {
    extension::with_tile!(tile => tile.exp(values));
}

/// Replaces each value, a normal number above 0, by its natural logarithm; fastest where there are multiples of 16.
pub(crate) fn ln(values: &mut [f32]) {
    extension::with_tile!(tile => tile.ln(values));
}

/// The tile of pairs in bf16, where the processor has the instructions and no other kernel is forced.
#[cfg(target_arch = "x86_64")]
fn bf16() -> Option<x86::Avx512Bf16> {
    static FOUND: std::sync::OnceLock<Option<x86::Avx512Bf16>> = std::sync::OnceLock::new();
    let wanted = matches!(Kernel::active(), Some(Kernel::Avx512(_)));
    (*FOUND.get_or_init(x86::Avx512Bf16::detect)).filter(|_| wanted)
}

#[cfg(target_arch = "x86_64")]
fn avx512() -> Option<Kernel> {
    static FOUND: std::sync::OnceLock<Option<x86::Avx512>> = std::sync::OnceLock::new();
    FOUND.get_or_init(x86::Avx512::detect).map(Kernel::Avx512)
}

#[cfg(target_arch = "x86_64")]
fn avx2() -> Option<Kernel> {
    static FOUND: std::sync::OnceLock<Option<x86::Avx2>> = std::sync::OnceLock::new();
    FOUND.get_or_init(x86::Avx2::detect).map(Kernel::Avx2)
}

#[cfg(not(target_arch = "x86_64"))]
fn avx512() -> Option<Kernel> {
    None
}

#[cfg(not(target_arch = "x86_64"))]
fn avx2() -> Option<Kernel> {
    None
}

/// Whether the kernels can take tensors of these element types on this device.
pub(crate) fn fits(device: &Device, types: &[DType]) -> bool {
    let on_cpu = match device.as_dispatch() {
        DispatchDevice::Flex(_) => true,
        DispatchDevice::Autodiff(inner) => matches!(**inner, DispatchDevice::Flex(_)),
        #[allow(unreachable_patterns)] // Other devices exist only with their cargo features.
        _ => false,
    };
    on_cpu && types.iter().all(|t| *t == DType::F32) && Kernel::active().is_some()
}
