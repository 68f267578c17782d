//! Ordinary code, compiled once more for processors with AVX2.
//!
//! A binary for every x86-64 must do with SSE2. The shading of a path is compiled a second time for what processors since 2013
//! have: instructions with three operands, rounding, fused multiply-add where the code asks for it (a call otherwise), vectors of
//! eight. Rust never contracts or reorders floating-point operations, so that both give the same bits.

#[cfg(target_arch = "x86_64")]
use crate::accel::Level;

/// Something to run. `run` must be `#[inline(always)]`, and all it calls that should be compiled for the same processor inlined.
pub(crate) trait Work {
    type Output;
    fn run(self) -> Self::Output;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn avx2<W: Work>(work: W) -> W::Output {
    work.run()
}

/// Runs `work` as compiled for this processor.
#[inline]
#[allow(unsafe_code)]
pub(crate) fn run<W: Work>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    if Level::best() != Level::PORTABLE {
        // SAFETY: every other level exists only where the processor has the features that the function was compiled for.
        return unsafe { avx2(work) };
    }
    portable(work)
}

#[inline(never)]
fn portable<W: Work>(work: W) -> W::Output {
    work.run()
}
