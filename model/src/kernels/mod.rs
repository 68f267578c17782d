//! CPU kernels for convolution over space and time, for attention, and for the operations on pixels and tokens between them.
//! Convolutions are implicit matrix products on channels-last pictures, without an im2col buffer. The other operations are single
//! passes over rows.
//!
//! Every matrix product computes small tiles of outputs in registers (`tile`) from lists of input pixels and packed weights
//! (`gather`, `gradient`). Taps over time are further sources of the same sum, so that no frame is copied. There are three
//! implementations of a tile: AVX-512, AVX2, and portable Rust. All three return the same bits for any number of threads.
//! [`crate::ops`] chooses between the kernels and [`portable`], which composes burn's own operations for every other device and
//! element type.
//!
//! Two more implementations, AVX-512 BF16 and AMX, multiply factors that are rounded to bf16 ([`options::Products`]). Their bits
//! differ.
//!
//! Each call packs the weights to `[outputs / block][tap][inputs][block]`, with a block of two vectors. The gradient of the input
//! is the same gather over the transposed lattice. The gradient of the weights sums over pixels instead of channels.
//!
//! `docs/measurements/model-kernels.md` compares the speed of kernels and compositions.

pub mod options;
pub mod portable;

#[cfg(target_arch = "x86_64")]
mod amx;
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
pub(crate) use tile::{exp_each, ln_each};
pub(crate) use tokens::{gate, gelu, modulate, turn};

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
    /// AVX-512, without AMX.
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

/// The tile of pairs in bf16, where the processor has the instructions and no other kernel is forced.
#[cfg(target_arch = "x86_64")]
fn bf16() -> Option<x86::Avx512Bf16> {
    static FOUND: std::sync::OnceLock<Option<x86::Avx512Bf16>> = std::sync::OnceLock::new();
    let wanted = matches!(Kernel::active(), Some(Kernel::Avx512(_)));
    (*FOUND.get_or_init(x86::Avx512Bf16::detect)).filter(|_| wanted)
}

/// The tile of the matrix unit, likewise.
#[cfg(target_arch = "x86_64")]
fn amx() -> Option<amx::AmxBf16> {
    static FOUND: std::sync::OnceLock<Option<amx::AmxBf16>> = std::sync::OnceLock::new();
    let wanted = FORCED.load(Ordering::Relaxed) == Choice::Automatic as u8;
    (*FOUND.get_or_init(amx::AmxBf16::detect)).filter(|_| wanted)
}

/// The instructions by which [`options::Products::Bf16`] multiplies on this processor; `None` where it multiplies in 32-bit
/// floats.
pub fn bf16_instructions() -> Option<&'static str> {
    #[cfg(target_arch = "x86_64")]
    return amx().map(|_| "AMX").or_else(|| bf16().map(|_| "AVX-512 BF16"));
    #[cfg(not(target_arch = "x86_64"))]
    None
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

/// Whether this device is the processor.
fn is_cpu(device: &Device) -> bool {
    match device.as_dispatch() {
        DispatchDevice::Flex(_) => true,
        DispatchDevice::Autodiff(inner) => matches!(**inner, DispatchDevice::Flex(_)),
        #[allow(unreachable_patterns)] // Other devices exist only with their cargo features.
        _ => false,
    }
}

/// Whether the kernels can take tensors of these element types on this device.
pub(crate) fn fits(device: &Device, types: &[DType]) -> bool {
    is_cpu(device) && types.iter().all(|t| *t == DType::F32) && Kernel::active().is_some()
}
