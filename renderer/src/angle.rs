//! Sines and angles by polynomials: the system's functions are calls that save all registers around them, and their last bits
//! differ from one system to the next.

use std::f32::consts::{FRAC_1_PI, TAU};

/// Sine and cosine of `turns` full turns, within 1.2e-7 of the exact values for -1e5..=1e5 (reduced exactly), else NaN or any
/// pair within -1.01..=1.01.
#[inline(always)]
pub(crate) fn sin_cos_turns(turns: f32) -> (f32, f32) {
    /// Adding and taking it off again rounds to integers, and the last bits of the sum are the integer's.
    const ROUND: f32 = 1.5 * (1 << 23) as f32;
    let shifted = 4.0 * turns + ROUND;
    let quarters = shifted.to_bits();
    let (sin, cos) = sin_cos_eighth(TAU * (turns - 0.25 * (shifted - ROUND)));
    // The quarter turn exchanges them and turns signs, without branches: which quarter it is cannot be foreseen.
    let exchange = (quarters & 1).wrapping_neg();
    let (s, c) = (sin.to_bits(), cos.to_bits());
    let difference = (s ^ c) & exchange;
    let sign = |quarters: u32| (quarters & 2) << 30;
    (f32::from_bits(s ^ difference ^ sign(quarters)), f32::from_bits(c ^ difference ^ sign(quarters.wrapping_add(1))))
}

/// Angle from an axis over pi, 0..=1, of a unit direction with the cosine `y` to the axis, where `2 q = 1 - |y|`, 0..=1; within
/// 1.5e-7 of the exact value and, towards `q = 0`, of its size.
#[inline(always)]
pub(crate) fn polar(q: f32, y: f32) -> f32 {
    /// `asin(sqrt(q)) / sqrt(q)` on 0..=1/2, interpolated at Chebyshev's nodes.
    const COEFFICIENTS: [f32; 8] =
        [1.0, 0.166_669_55, 0.074_881_144, 0.046_480_85, 0.016_731_389, 0.075_539_75, -0.090_086_22, 0.109_673_98];
    let series = COEFFICIENTS.iter().rev().fold(0.0, |sum, c| sum * q + c);
    let angle = 2.0 * FRAC_1_PI * q.sqrt() * series;
    let beyond = if y < 0.0 { 1.0 } else { 0.0 };
    beyond + (1.0 - 2.0 * beyond) * angle
}

/// Sine and cosine of an angle up to an eighth of a turn either way, radians, within 1.2e-7 (Cephes by Moshier, `sinf`, `cosf`).
#[inline(always)]
pub(crate) fn sin_cos_eighth(x: f32) -> (f32, f32) {
    let x2 = x * x;
    let sin = x + x * x2 * (-1.666_665_5e-1 + x2 * (8.332_161e-3 + x2 * -1.951_529_6e-4));
    let cos = 1.0 - 0.5 * x2 + x2 * x2 * (4.166_664_6e-2 + x2 * (-1.388_731_6e-3 + x2 * 2.443_315_7e-5));
    (sin, cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_agree_with_the_exact_functions() {
        let mut worst = 0.0f64;
        for i in -400_000..=400_000 {
            for turns in [i as f32 / 100_000.0, i as f32 * 0.25, i as f32 * 0.013] {
                let exact = (f64::from(turns).rem_euclid(1.0) * std::f64::consts::TAU).sin_cos();
                let (sin, cos) = sin_cos_turns(turns);
                worst = worst.max((f64::from(sin) - exact.0).abs()).max((f64::from(cos) - exact.1).abs());
            }
        }
        println!("worst {worst:.2e}");
        assert!(worst < 1.2e-7, "{worst}");
        assert_eq!((sin_cos_turns(0.0), sin_cos_turns(0.5)), ((0.0, 1.0), (-0.0, -1.0)));
    }

    #[test]
    fn polar_angles_agree_with_the_exact_function() {
        let mut worst = 0.0f64;
        for i in 0..=1_000_000 {
            let angle = f64::from(i) / 1_000_000.0 * std::f64::consts::PI;
            let near = angle.min(std::f64::consts::PI - angle);
            let q = (0.5 * near).sin().powi(2) as f32;
            let found = f64::from(polar(q, angle.cos() as f32));
            worst = worst.max((found - angle * std::f64::consts::FRAC_1_PI).abs());
        }
        println!("worst {worst:.2e}");
        assert!(worst < 1.5e-7, "{worst}");
        assert_eq!((polar(0.0, 1.0), polar(0.0, -1.0)), (0.0, 1.0));
        assert!((f64::from(polar(1e-20, 1.0)) / (2e-10 * std::f64::consts::FRAC_1_PI) - 1.0).abs() < 4e-7);
    }
}
