//! The inner product in AMX: the matrix unit of Intel's server processors since 2023 multiplies 16 x 32 by 32 x 16 factors in
//! bf16 with one instruction.
//!
//! Rust has no stable intrinsics for AMX, so that the instructions are written as assembly. Rust code never keeps a value in the
//! registers of the matrix unit, and so nothing has to be said about them. Linux grants a process the use of these registers when
//! it asks for it.
//!
//! Registers are filled whole. Where a pixel has fewer cells, those of the next pixels follow, and meet zeros. So a value that is
//! not finite can reach pixels to the left that do not see it.
use super::tile::{Output, Start, Term, Tile};
use super::x86::Avx512Bf16;
use std::arch::asm;
use std::arch::x86_64::{__cpuid, __cpuid_count};
use std::borrow::Cow;

/// Rows of a register, and cells of two factors in each of its rows.
const SIDE: usize = 16;

/// Tiles of at most 32 x 32 outputs, with factors in bf16 and sums in f32. The order of the sums is the processor's own, so that
/// the last bits differ from [`Avx512Bf16`].
#[derive(Clone, Copy, Debug)]
pub struct AmxBf16 {
    /// For everything else.
    vectors: Avx512Bf16,
}

/// What `ldtilecfg` reads: the shape of each register.
#[repr(C, align(64))]
struct Shapes {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    /// Bytes of a row.
    bytes: [u16; 16],
    rows: [u8; 16],
}

impl Shapes {
    /// Registers 0 to 3 hold sums: two columns of registers for the first `rows[0]` rows, then two for the next `rows[1]`.
    /// Registers 4 and 5 hold the factors of these rows. Registers 6 and 7 hold the factors of both columns.
    fn new(rows: [usize; 2]) -> Self {
        let mut shapes = Self { palette: 1, start_row: 0, reserved: [0; 14], bytes: [0; 16], rows: [0; 16] };
        let [first, second] = rows;
        for (register, rows) in [first, first, second, second, first, second, SIDE, SIDE].into_iter().enumerate() {
            if rows > 0 {
                (shapes.bytes[register], shapes.rows[register]) = (4 * SIDE as u16, rows as u8);
            }
        }
        shapes
    }
}

/// Loads a register from rows that are `stride` floats apart.
macro_rules! load {
    ($register:literal, $at:expr, $stride:expr) => {
        asm!(concat!("tileloadd tmm", $register, ", [{at} + {stride}*1]"), at = in(reg) $at, stride = in(reg) 4 * $stride,
            options(nostack, preserves_flags, readonly))
    };
}

/// Stores a register to rows that are `stride` floats apart.
macro_rules! store {
    ($register:literal, $at:expr, $stride:expr) => {
        asm!(concat!("tilestored [{at} + {stride}*1], tmm", $register), at = in(reg) $at, stride = in(reg) 4 * $stride,
            options(nostack, preserves_flags))
    };
}

/// Loads or stores the registers of sums, from or to rows at `$at` that are `$stride` floats apart.
macro_rules! sums {
    ($what:ident, $at:expr, $stride:expr, $wide:expr, $tall:expr) => {
        $what!(0, $at, $stride);
        if $wide {
            $what!(1, $at.add(SIDE), $stride);
        }
        if $tall {
            $what!(2, $at.add(SIDE * $stride), $stride);
        }
        if $wide && $tall {
            $what!(3, $at.add(SIDE * $stride + SIDE), $stride);
        }
    };
}

/// Adds the product of two registers to a third one.
macro_rules! multiply {
    ($sum:literal, $a:literal, $b:literal) => {
        asm!(concat!("tdpbf16ps tmm", $sum, ", tmm", $a, ", tmm", $b), options(nostack, preserves_flags, nomem))
    };
}

impl AmxBf16 {
    /// `Some` if this processor has the instructions and the system lets this process use them.
    pub fn detect() -> Option<Self> {
        let vectors = Avx512Bf16::detect()?;
        (has_instructions() && permitted()).then_some(Self { vectors })
    }

    /// A tile of `rows` rows, of two columns of registers if `WIDE`, and with a second row of registers if `TALL`. Sums begin
    /// with the rows at `from`, which are `from_stride` floats apart, and end at `to`.
    ///
    /// # Safety
    /// The processor has the instructions. Every term has `rows` rows of whole multiples of [`SIDE`] cells in `a`, and as many
    /// rows of `b`. There are `rows` rows, each as wide as the tile, at `from` and at `to`.
    unsafe fn sum<const WIDE: bool, const TALL: bool>(
        rows: usize,
        terms: &[Term],
        (from, from_stride): (*const f32, usize),
        (to, to_stride): (*mut f32, usize),
    ) {
        let shapes = Shapes::new([rows.min(SIDE), rows.saturating_sub(SIDE)]);
        // SAFETY: the caller vouches for the instructions and for all memory. Registers are loaded and stored in the shapes that
        // are set first, so that a register touches the rows that exist and no others.
        unsafe {
            asm!("ldtilecfg [{}]", in(reg) &raw const shapes, options(nostack, preserves_flags, readonly));
            sums!(load, from, from_stride, WIDE, TALL);
            for term in terms {
                for k in (0..term.k).step_by(SIDE) {
                    let (a, b) = (term.a.as_ptr().add(k), term.b.as_ptr().add(k * term.b_step));
                    load!(4, a, term.a_row);
                    load!(6, b, term.b_step);
                    multiply!(0, 4, 6);
                    if WIDE {
                        load!(7, b.add(SIDE), term.b_step);
                        multiply!(1, 4, 7);
                    }
                    if TALL {
                        load!(5, a.add(SIDE * term.a_row), term.a_row);
                        multiply!(2, 5, 6);
                        if WIDE {
                            multiply!(3, 5, 7);
                        }
                    }
                }
            }
            sums!(store, to, to_stride, WIDE, TALL);
            // The system need not keep registers that are not in use.
            asm!("tilerelease", options(nostack, preserves_flags, nomem));
        }
    }
}

impl Tile for AmxBf16 {
    const LANES: usize = SIDE;
    const ROWS: usize = 2 * SIDE;
    const FACTORS: usize = 2;
    const DEPTH: usize = SIDE;

    fn cells(self, values: &[f32]) -> Cow<'_, [f32]> {
        self.vectors.cells(values)
    }

    fn pair(self, first: &[f32], second: &[f32], cells: &mut [f32]) {
        self.vectors.pair(first, second, cells);
    }

    fn tile(self, rows: usize, vectors: usize, terms: &[Term], start: Start, out: Output) {
        assert!((1..=Self::ROWS).contains(&rows) && (1..=2).contains(&vectors), "no tile of {rows} rows and {vectors} vectors");
        let width = vectors * SIDE;
        out.check(rows, width, start);
        // Rows of `a` that end with the memory are copied, because registers are filled whole. What follows the cells of a row
        // does not matter: there are zeros in `b`.
        let mut copies: Vec<(usize, Vec<f32>)> = Vec::new();
        for (i, term) in terms.iter().enumerate() {
            let whole = term.k.next_multiple_of(SIDE);
            term.check(rows, width);
            assert!(term.a_step == 1 && term.b.len() >= (whole - 1) * term.b_step + width, "term without zeros after its cells");
            if term.a.len() < (rows - 1) * term.a_row + whole {
                let mut copy = vec![0.0; rows * whole];
                for (row, cells) in copy.chunks_exact_mut(whole).enumerate() {
                    cells[..term.k].copy_from_slice(&term.a[row * term.a_row..][..term.k]);
                }
                copies.push((i, copy));
            }
        }
        let copied: Vec<Term>;
        let terms = if copies.is_empty() {
            terms
        } else {
            let mut all = terms.to_vec();
            for (i, copy) in &copies {
                (all[*i].a, all[*i].a_row) = (copy, all[*i].k.next_multiple_of(SIDE));
            }
            copied = all;
            &copied
        };
        // Where not all columns are written, the tile goes through memory of its own.
        let mut whole = if out.columns < width { Some([0.0_f32; 4 * SIDE * SIDE]) } else { None };
        let from = match start {
            Start::Row(bias) => (bias.as_ptr(), 0),
            Start::Output => (out.values.as_ptr(), out.row),
        };
        let to = match &mut whole {
            Some(whole) => (whole.as_mut_ptr(), width),
            None => (out.values.as_mut_ptr(), out.row),
        };
        // SAFETY: a value of this type exists only after `detect` has found the instructions. `check` and the loop above have
        // shown that all rows exist.
        unsafe {
            match (vectors == 2, rows > SIDE) {
                (false, false) => Self::sum::<false, false>(rows, terms, from, to),
                (false, true) => Self::sum::<false, true>(rows, terms, from, to),
                (true, false) => Self::sum::<true, false>(rows, terms, from, to),
                (true, true) => Self::sum::<true, true>(rows, terms, from, to),
            }
        }
        if let Some(whole) = whole {
            for (row, whole) in whole.chunks_exact(width).take(rows).enumerate() {
                out.values[row * out.row..][..out.columns].copy_from_slice(&whole[..out.columns]);
            }
        }
    }

    fn silu(self, z: &[f32], y: &mut [f32]) {
        self.vectors.silu(z, y);
    }

    fn silu_gradient(self, z: &[f32], g: &[f32], d: &mut [f32]) {
        self.vectors.silu_gradient(z, g, d);
    }

    fn gelu(self, x: &[f32], y: &mut [f32]) {
        self.vectors.gelu(x, y);
    }

    fn gelu_gradient(self, x: &[f32], g: &[f32], d: &mut [f32]) {
        self.vectors.gelu_gradient(x, g, d);
    }

    fn exp_and_sum(self, s: &mut [f32]) -> f32 {
        self.vectors.exp_and_sum(s)
    }
}

/// Whether the processor has the matrix unit and multiplies in bf16.
fn has_instructions() -> bool {
    const BF16: u32 = 1 << 22;
    const TILE: u32 = 1 << 24;
    __cpuid(0).eax >= 7 && {
        let found = __cpuid_count(7, 0).edx;
        found & (BF16 | TILE) == BF16 | TILE
    }
}

/// Asks the system for the use of the registers, for all threads of this process.
fn permitted() -> bool {
    #[cfg(target_os = "linux")]
    {
        /// `arch_prctl`, its request for a part of the processor's state, and the number of the state of the matrix unit.
        const CALL: i64 = 158;
        const REQUEST: u64 = 0x1023;
        const TILE_DATA: u64 = 18;
        let answer: i64;
        // SAFETY: the call changes nothing but the permission. Linux keeps all registers but these three.
        unsafe {
            asm!("syscall", inlateout("rax") CALL => answer, in("rdi") REQUEST, in("rsi") TILE_DATA, out("rcx") _, out("r11") _,
                options(nostack));
        }
        answer == 0
    }
    #[cfg(not(target_os = "linux"))]
    false
}
