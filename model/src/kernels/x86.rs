//! The inner product in AVX-512 (of floats, and of pairs in bf16) and AVX2.
use super::buffer;
use super::tile::{self, Output, Start, Term, Tile};
use std::arch::x86_64::*;
use std::borrow::Cow;

macro_rules! instruction_set {
    ($name:ident, $doc:literal, $features:literal, [$($feature:tt),+], $vector:ty, $lanes:literal, $rows:literal, [$($row:literal),+],
     $load:ident, $store:ident, $splat:ident, $fma:ident, {$($cells:item)*}) => {
        #[doc = $doc]
        #[derive(Clone, Copy, Debug)]
        pub struct $name(());

        impl $name {
            /// `Some` if this processor has the instructions.
            pub fn detect() -> Option<Self> {
                ($(is_x86_feature_detected!($feature))&&+).then_some(Self(()))
            }

            #[target_feature(enable = $features)]
            fn rows<const ROWS: usize, const VECTORS: usize>(terms: &[Term], start: Start, out: Output) {
                out.check(ROWS, VECTORS * $lanes, start);
                let mut sums: [[$vector; VECTORS]; ROWS] = [[$splat(0.0); VECTORS]; ROWS];
                for (i, sums) in sums.iter_mut().enumerate() {
                    for (v, sum) in sums.iter_mut().enumerate() {
                        let from = match start {
                            Start::Row(bias) => bias.as_ptr(),
                            // Within the slice: `check` has shown that row i lies in it.
                            Start::Output => out.values[i * out.row..].as_ptr(),
                        };
                        // SAFETY: `check` has shown that VECTORS * LANES floats follow, from the start of the bias or of the row.
                        *sum = unsafe { $load(from.add(v * $lanes)) };
                    }
                }
                for term in terms {
                    term.check(ROWS, VECTORS * $lanes);
                    let (mut a, mut b) = (term.a.as_ptr(), term.b.as_ptr());
                    for k in 0..term.k {
                        let mut vectors = [$splat(0.0); VECTORS];
                        for (v, vector) in vectors.iter_mut().enumerate() {
                            // SAFETY: `b` stands at k * b_step with k < term.k; `check` has shown that
                            // (term.k - 1) * b_step + VECTORS * LANES floats exist.
                            *vector = unsafe { $load(b.add(v * $lanes)) };
                        }
                        for (i, sums) in sums.iter_mut().enumerate() {
                            // SAFETY: `a` stands at k * a_step with k < term.k and i < ROWS; `check` has shown that the
                            // element at (ROWS - 1) * a_row + (term.k - 1) * a_step exists.
                            let x = $splat(unsafe { *a.add(i * term.a_row) });
                            for (sum, vector) in sums.iter_mut().zip(vectors) {
                                *sum = $fma(x, vector, *sum);
                            }
                        }
                        if k + 1 < term.k {
                            // SAFETY: the next k is below term.k, so both pointers stay inside their slices (as above).
                            (a, b) = unsafe { (a.add(term.a_step), b.add(term.b_step)) };
                        }
                    }
                }
                for (i, sums) in sums.iter().enumerate() {
                    let row = &mut out.values[i * out.row..][..out.columns];
                    if out.columns == VECTORS * $lanes {
                        for (v, sum) in sums.iter().enumerate() {
                            // SAFETY: `row` has VECTORS * LANES floats and v < VECTORS.
                            unsafe { $store(row.as_mut_ptr().add(v * $lanes), *sum) };
                        }
                    } else {
                        let mut whole = [[0.0_f32; $lanes]; VECTORS];
                        for (sum, whole) in sums.iter().zip(&mut whole) {
                            // SAFETY: `whole` has LANES floats.
                            unsafe { $store(whole.as_mut_ptr(), *sum) };
                        }
                        row.copy_from_slice(&whole.as_flattened()[..out.columns]);
                    }
                }
            }

            #[target_feature(enable = $features)]
            fn vector_silu(z: &[f32], y: &mut [f32]) {
                tile::silu(z, y);
            }

            #[target_feature(enable = $features)]
            fn vector_silu_gradient(z: &[f32], g: &[f32], d: &mut [f32]) {
                tile::silu_gradient(z, g, d);
            }

            #[target_feature(enable = $features)]
            fn vector_gelu(x: &[f32], y: &mut [f32]) {
                tile::gelu(x, y);
            }

            #[target_feature(enable = $features)]
            fn vector_gelu_gradient(x: &[f32], g: &[f32], d: &mut [f32]) {
                tile::gelu_gradient(x, g, d);
            }

            #[target_feature(enable = $features)]
            fn vector_exp_and_sum(s: &mut [f32]) -> f32 {
                tile::exp_and_sum(s)
            }
        }

        impl Tile for $name {
            const LANES: usize = $lanes;
            const ROWS: usize = $rows;
            $($cells)*

            #[inline]
            fn tile(self, rows: usize, vectors: usize, terms: &[Term], start: Start, out: Output) {
                // SAFETY (each call): a value of this type exists only after `detect` has found the instructions.
                match (rows, vectors) {
                    $(($row, 2) => unsafe { Self::rows::<$row, 2>(terms, start, out) },
                    ($row, 1) => unsafe { Self::rows::<$row, 1>(terms, start, out) },)+
                    _ => unreachable!("no tile of {rows} rows and {vectors} vectors"),
                }
            }

            fn silu(self, z: &[f32], y: &mut [f32]) {
                // SAFETY: as in `tile`.
                unsafe { Self::vector_silu(z, y) }
            }

            fn silu_gradient(self, z: &[f32], g: &[f32], d: &mut [f32]) {
                // SAFETY: as in `tile`.
                unsafe { Self::vector_silu_gradient(z, g, d) }
            }

            fn gelu(self, x: &[f32], y: &mut [f32]) {
                // SAFETY: as in `tile`.
                unsafe { Self::vector_gelu(x, y) }
            }

            fn gelu_gradient(self, x: &[f32], g: &[f32], d: &mut [f32]) {
                // SAFETY: as in `tile`.
                unsafe { Self::vector_gelu_gradient(x, g, d) }
            }

            fn exp_and_sum(self, s: &mut [f32]) -> f32 {
                // SAFETY: as in `tile`.
                unsafe { Self::vector_exp_and_sum(s) }
            }
        }
    };
}

instruction_set!(
    Avx512,
    "Sixteen floats at a time.",
    "avx512f,avx512dq,avx512bw,avx512vl,fma",
    ["avx512f", "avx512dq", "avx512bw", "avx512vl", "fma"],
    __m512,
    16,
    8,
    [8, 7, 6, 5, 4, 3, 2, 1],
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_set1_ps,
    _mm512_fmadd_ps,
    {}
);
instruction_set!(
    Avx2,
    "Eight floats at a time.",
    "avx2,fma",
    ["avx2", "fma"],
    __m256,
    8,
    6,
    [6, 5, 4, 3, 2, 1],
    _mm256_loadu_ps,
    _mm256_storeu_ps,
    _mm256_set1_ps,
    _mm256_fmadd_ps,
    {}
);
instruction_set!(
    Avx512Bf16,
    "Sixteen cells of two factors in bf16 at a time, with sums in f32.",
    "avx512f,avx512dq,avx512bw,avx512vl,avx512bf16,fma",
    ["avx512f", "avx512dq", "avx512bw", "avx512vl", "avx512bf16", "fma"],
    __m512,
    16,
    8,
    [8, 7, 6, 5, 4, 3, 2, 1],
    _mm512_loadu_ps,
    _mm512_storeu_ps,
    _mm512_set1_ps,
    dot_pairs,
    {
        const FACTORS: usize = 2;

        fn cells(self, values: &[f32]) -> Cow<'_, [f32]> {
            const CHUNK: usize = 1 << 13;
            let write = |(): &mut (), i: usize, cells: &mut [f32]| {
                // SAFETY: a value of this type exists only after `detect` has found the instructions.
                unsafe { pair_neighbours(&values[2 * i * CHUNK..][..2 * cells.len()], cells) }
            };
            Cow::Owned(buffer::fill(values.len() / 2, CHUNK, || (), write))
        }

        fn pair(self, first: &[f32], second: &[f32], cells: &mut [f32]) {
            // SAFETY: as in `cells`.
            unsafe { pair(first, second, cells) }
        }
    }
);

/// `sum` plus the sum of the two products of each cell.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
fn dot_pairs(a: __m512, b: __m512, sum: __m512) -> __m512 {
    // SAFETY: both types are 512 bits without a meaning of their own.
    let [a, b] = unsafe { [std::mem::transmute::<__m512, __m512bh>(a), std::mem::transmute::<__m512, __m512bh>(b)] };
    _mm512_dpbf16_ps(sum, a, b)
}

#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
fn pair_neighbours(values: &[f32], cells: &mut [f32]) {
    tile::pair_neighbours(values, cells);
}

#[target_feature(enable = "avx512f,avx512dq,avx512bw,avx512vl")]
fn pair(first: &[f32], second: &[f32], cells: &mut [f32]) {
    tile::pair(first, second, cells);
}
