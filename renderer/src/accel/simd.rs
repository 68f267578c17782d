//! Eight numbers at a time: AVX2 and AVX-512 where the processor has them, pairs of `glam::Vec4` everywhere.
//!
//! All unsafe code of the trees is here. Every operation is rounded as IEEE 754 says and none but [`Lanes::mul_add`] is fused,
//! which only tests of boxes use that no hit depends on, so all levels find the same bits; `tests` compares them.

use glam::Vec4;
use std::sync::OnceLock;

/// Lanes of a vector: children of a node, triangles of a leaf.
pub(super) const WIDTH: usize = 8;
/// Rays of a packet.
pub(super) const PACKET: usize = 16;

/// Instructions that ray queries use; a value exists only where the processor has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level(Kind);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// What every processor has.
    pub const PORTABLE: Self = Self(Kind::Portable);

    /// Levels of this processor, slowest first.
    pub fn available() -> &'static [Self] {
        static FOUND: OnceLock<Vec<Level>> = OnceLock::new();
        FOUND.get_or_init(|| {
            #[allow(unused_mut)]
            let mut found = vec![Self::PORTABLE];
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt")
                && is_x86_feature_detected!("popcnt")
            {
                found.push(Self(Kind::Avx2));
                if is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512bw")
                {
                    found.push(Self(Kind::Avx512));
                }
            }
            found
        })
    }

    /// The fastest level of this processor, or what the environment variable `RENDERFLOW_SIMD` names (`portable`, `avx2`,
    /// `avx512`) if the processor has it. Read once.
    pub fn best() -> Self {
        static BEST: OnceLock<Level> = OnceLock::new();
        *BEST.get_or_init(|| {
            let wanted = std::env::var("RENDERFLOW_SIMD").unwrap_or_default();
            let available = Self::available();
            available
                .iter()
                .chain(available.last())
                .find(|l| l.name() == wanted)
                .or(available.last())
                .copied()
                .unwrap_or(Self::PORTABLE)
        })
    }

    /// `portable`, `avx2` or `avx512`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Kind::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
        }
    }
}

/// Code that is compiled once a [`Level`]. `run` must be `#[inline(always)]`, and all it calls that has [`Lanes`] in it: vectors
/// do not cross function borders in registers otherwise.
pub(super) trait Kernel {
    type Output;
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Runs `kernel` with the instructions of `level`.
#[inline(always)]
pub(super) fn run<K: Kernel>(level: Level, kernel: K) -> K::Output {
    match level.0 {
        Kind::Portable => portable(kernel),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a `Level` with this kind is made by `Level::available` alone, which has found the features.
        Kind::Avx2 => unsafe { x86::avx2(kernel) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Kind::Avx512 => unsafe { x86::avx512(kernel) },
    }
}

#[inline(never)]
fn portable<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Portable>()
}

/// A vector of `f32`. Comparisons give one bit per lane, which is 0 where either side is NaN; `min` and `max` give the right side
/// then.
pub(super) trait Numbers: Copy {
    fn splat(v: f32) -> Self;
    fn add(self, other: Self) -> Self;
    fn sub(self, other: Self) -> Self;
    fn mul(self, other: Self) -> Self;
    fn div(self, other: Self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn le(self, other: Self) -> u32;
    fn gt(self, other: Self) -> u32;
}

/// Eight numbers, with a type that holds twice the number.
pub(super) trait Lanes: Numbers {
    type Sixteen: Sixteen;
    /// Brings an item that will be wanted soon to the processor; does nothing where there is none, or no such instruction.
    #[inline(always)]
    fn prefetch<T>(_: &[T], _: usize) {}
    /// `self * by + add`, rounded once or twice: levels differ.
    fn mul_add(self, by: Self, add: Self) -> Self;
    fn load(from: &[f32; WIDTH]) -> Self;
    fn store(self) -> [f32; WIDTH];
}

/// Sixteen of them.
pub(super) trait Sixteen: Numbers {
    fn load(from: &[f32; PACKET]) -> Self;
    fn store(self) -> [f32; PACKET];
    /// The lanes of `self` where `mask` has a bit, and the lanes of `other` elsewhere.
    fn select(self, mask: u32, other: Self) -> Self;
}

#[derive(Clone, Copy)]
pub(super) struct Portable([Vec4; 2]);

impl Portable {
    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(Vec4, Vec4) -> Vec4) -> Self {
        Self([f(self.0[0], other.0[0]), f(self.0[1], other.0[1])])
    }

    #[inline(always)]
    fn compare(self, other: Self, f: impl Fn(Vec4, Vec4) -> glam::BVec4A) -> u32 {
        f(self.0[0], other.0[0]).bitmask() | f(self.0[1], other.0[1]).bitmask() << 4
    }
}

impl Numbers for Portable {
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self([Vec4::splat(v); 2])
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
    // Not glam's, which treats NaN as the processor does.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| Vec4::select(a.cmplt(b), a, b))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| Vec4::select(a.cmpgt(b), a, b))
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        self.compare(other, Vec4::cmple)
    }
    #[inline(always)]
    fn gt(self, other: Self) -> u32 {
        self.compare(other, Vec4::cmpgt)
    }
}

impl Lanes for Portable {
    type Sixteen = Pair<Self>;
    #[inline(always)]
    fn mul_add(self, by: Self, add: Self) -> Self {
        self.mul(by).add(add)
    }
    #[inline(always)]
    fn load(&[a, b, c, d, e, f, g, h]: &[f32; WIDTH]) -> Self {
        Self([Vec4::new(a, b, c, d), Vec4::new(e, f, g, h)])
    }
    #[inline(always)]
    fn store(self) -> [f32; WIDTH] {
        let ([a, b, c, d], [e, f, g, h]) = (self.0[0].to_array(), self.0[1].to_array());
        [a, b, c, d, e, f, g, h]
    }
}

/// Sixteen as two eights.
#[derive(Clone, Copy)]
pub(super) struct Pair<L>(L, L);

impl<L: Lanes> Numbers for Pair<L> {
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Self(L::splat(v), L::splat(v))
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0.add(other.0), self.1.add(other.1))
    }
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0.sub(other.0), self.1.sub(other.1))
    }
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0.mul(other.0), self.1.mul(other.1))
    }
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(self.0.div(other.0), self.1.div(other.1))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0), self.1.min(other.1))
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0), self.1.max(other.1))
    }
    #[inline(always)]
    fn le(self, other: Self) -> u32 {
        self.0.le(other.0) | self.1.le(other.1) << WIDTH
    }
    #[inline(always)]
    fn gt(self, other: Self) -> u32 {
        self.0.gt(other.0) | self.1.gt(other.1) << WIDTH
    }
}

impl<L: Lanes> Sixteen for Pair<L> {
    #[inline(always)]
    fn load(from: &[f32; PACKET]) -> Self {
        let (low, high) = from.as_chunks::<WIDTH>().0.split_at(1);
        Self(L::load(&low[0]), L::load(&high[0]))
    }
    #[inline(always)]
    fn store(self) -> [f32; PACKET] {
        let mut all = [0.0; PACKET];
        all[..WIDTH].copy_from_slice(&self.0.store());
        all[WIDTH..].copy_from_slice(&self.1.store());
        all
    }
    #[inline(always)]
    fn select(self, mask: u32, other: Self) -> Self {
        let (own, mut all) = (self.store(), other.store());
        for (lane, value) in own.into_iter().enumerate() {
            if mask >> lane & 1 == 1 {
                all[lane] = value;
            }
        }
        Self::load(&all)
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Kernel, Lanes, Numbers, PACKET, Pair, Sixteen, WIDTH};
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    #[inline]
    pub(super) fn avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Avx2>()
    }

    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
    #[inline]
    pub(super) fn avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Avx512>()
    }

    /// Values exist only inside [`avx2`] and [`avx512`]: nothing else names the types.
    #[derive(Clone, Copy)]
    pub(super) struct Avx2(__m256);
    #[derive(Clone, Copy)]
    pub(super) struct Avx512(__m256);

    /// As [`Avx512`].
    #[derive(Clone, Copy)]
    pub(super) struct Wide(__m512);

    macro_rules! binary {
        ($($name:ident $instruction:ident)*) => {
            $(
                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    // SAFETY: inlined into `avx2` or `avx512`, which enable the instruction.
                    Self(unsafe { $instruction(self.0, other.0) })
                }
            )*
        };
    }

    macro_rules! compare {
        ($($name:ident |$a:ident, $b:ident| $how:expr;)*) => {
            $(
                #[inline(always)]
                fn $name(self, other: Self) -> u32 {
                    let ($a, $b) = (self.0, other.0);
                    // SAFETY: inlined into `avx2` or `avx512`, which enable the instructions.
                    unsafe { $how }
                }
            )*
        };
    }

    macro_rules! eight {
        ($name:ident, $sixteen:ty, $($comparisons:tt)*) => {
            impl Numbers for $name {
                #[inline(always)]
                fn splat(v: f32) -> Self {
                    // SAFETY: inlined into `avx2` or `avx512`, which enable the instruction.
                    Self(unsafe { _mm256_set1_ps(v) })
                }
                binary!(add _mm256_add_ps sub _mm256_sub_ps mul _mm256_mul_ps div _mm256_div_ps min _mm256_min_ps max _mm256_max_ps);
                compare!($($comparisons)*);
            }

            impl Lanes for $name {
                type Sixteen = $sixteen;
                #[inline(always)]
                fn prefetch<T>(items: &[T], index: usize) {
                    let at = items.as_ptr().wrapping_add(index).cast::<i8>();
                    for line in 0..size_of::<T>().div_ceil(64) {
                        // SAFETY: prefetching reads nothing; any address will do.
                        unsafe { _mm_prefetch::<_MM_HINT_T0>(at.wrapping_add(64 * line)) };
                    }
                }
                #[inline(always)]
                fn mul_add(self, by: Self, add: Self) -> Self {
                    // SAFETY: inlined into `avx2` or `avx512`, which enable the instruction.
                    Self(unsafe { _mm256_fmadd_ps(self.0, by.0, add.0) })
                }
                #[inline(always)]
                fn load(from: &[f32; WIDTH]) -> Self {
                    // SAFETY: as above; eight floats may be read at `from`, aligned or not.
                    Self(unsafe { _mm256_loadu_ps(from.as_ptr()) })
                }
                #[inline(always)]
                fn store(self) -> [f32; WIDTH] {
                    let mut to = [0.0; WIDTH];
                    // SAFETY: as above; `to` holds eight floats.
                    unsafe { _mm256_storeu_ps(to.as_mut_ptr(), self.0) };
                    to
                }
            }
        };
    }

    eight!(
        Avx2, Pair<Self>,
        le |a, b| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(a, b)) as u32;
        gt |a, b| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(a, b)) as u32;
    );
    eight!(
        Avx512, Wide,
        le |a, b| _mm256_cmp_ps_mask::<_CMP_LE_OQ>(a, b).into();
        gt |a, b| _mm256_cmp_ps_mask::<_CMP_GT_OQ>(a, b).into();
    );

    impl Numbers for Wide {
        #[inline(always)]
        fn splat(v: f32) -> Self {
            // SAFETY: inlined into `avx512`, which enables the instruction; so below.
            Self(unsafe { _mm512_set1_ps(v) })
        }
        binary!(add _mm512_add_ps sub _mm512_sub_ps mul _mm512_mul_ps div _mm512_div_ps min _mm512_min_ps max _mm512_max_ps);
        compare!(
            le |a, b| _mm512_cmp_ps_mask::<_CMP_LE_OQ>(a, b).into();
            gt |a, b| _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b).into();
        );
    }

    impl Sixteen for Wide {
        #[inline(always)]
        fn load(from: &[f32; PACKET]) -> Self {
            // SAFETY: as above; sixteen floats may be read at `from`, aligned or not.
            Self(unsafe { _mm512_loadu_ps(from.as_ptr()) })
        }
        #[inline(always)]
        fn store(self) -> [f32; PACKET] {
            let mut to = [0.0; PACKET];
            // SAFETY: as above; `to` holds sixteen floats.
            unsafe { _mm512_storeu_ps(to.as_mut_ptr(), self.0) };
            to
        }
        #[inline(always)]
        fn select(self, mask: u32, other: Self) -> Self {
            // SAFETY: see `splat`.
            Self(unsafe { _mm512_mask_blend_ps(mask as u16, other.0, self.0) })
        }
    }
}
