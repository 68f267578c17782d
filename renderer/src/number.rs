//! Numbers in other forms, without calls of the system and without branches.

/// The integer at or below `x`, which is 0 or more and below 2^31; 0 for NaN and below 0. `as usize` knows the whole range of 64
/// bits, which takes three times the instructions.
#[inline(always)]
pub(crate) fn whole(x: f32) -> usize {
    (x as i32).max(0) as usize
}

/// Binary logarithm of `x` >= 0, within 2e-7 or two roundings; between -127 and -126 for 0 and all numbers below 2^-126, 128 for
/// infinity, NaN for NaN.
#[inline(always)]
pub(crate) fn log2(x: f32) -> f32 {
    /// The root of 1/2.
    const HALF: u32 = 0x3f35_04f3;
    const ONE: u32 = 1.0_f32.to_bits();
    // A number from the root of 1/2 to the root of 2 times a power of two.
    let shifted = x.to_bits().wrapping_add(ONE - HALF);
    let power = (shifted >> 23) as i32 - 127;
    let near_one = f32::from_bits((shifted & 0x007f_ffff) + HALF);
    // log2(m) = 2 / ln 2 artanh(s), s = (m - 1) / (m + 1), which is at most .172; the next term is below 4e-8.
    let s = (near_one - 1.0) / (near_one + 1.0);
    let s2 = s * s;
    let series = s * (2.885_39 + s2 * (0.961_796_7 + s2 * (0.577_078_03 + s2 * 0.412_198_6)));
    if x.is_nan() { x } else { power as f32 + series }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_are_those_of_the_language() {
        for x in [0.0, -0.0, 0.5, 0.999_999_9, 1.0, 7.99, 16_777_216.0, 1e9, f32::NAN, -1.0, -1e30] {
            assert_eq!(whole(x), x as usize, "{x}");
        }
    }

    #[test]
    fn logarithms_agree_with_the_exact_function() {
        let mut worst = 0.0_f64;
        for power in -126..128 {
            for step in 0..4000 {
                let x = (1.0 + step as f32 / 4000.0) * (power as f32).exp2();
                let exact = f64::from(x).log2();
                let error = (f64::from(log2(x)) - exact).abs();
                worst = worst.max(error / (1.0 + 0.6 * exact.abs()));
            }
        }
        println!("worst {worst:.2e}");
        assert!(worst < 2e-7, "{worst}");
        assert_eq!((log2(1.0), log2(2.0), log2(0.125), log2(f32::INFINITY)), (0.0, 1.0, -3.0, 128.0));
        assert!(log2(0.0) <= -127.0 && log2(1e-44) <= -126.0 && log2(f32::NAN).is_nan());
    }
}
