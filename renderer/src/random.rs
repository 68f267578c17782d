//! Random numbers for checks.

use glam::DVec3;

/// Random numbers: PCG-XSH-RR (O'Neill 2014), independent of the samplers under test.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The stream of `seed`.
    pub fn new(seed: u64) -> Self {
        let mut random = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        random.bits();
        random
    }

    /// 32 random bits.
    pub fn bits(&mut self) -> u32 {
        let old = self.0;
        self.0 = old.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((((old >> 18) ^ old) >> 27) as u32).rotate_right((old >> 59) as u32)
    }

    /// In 0..1, a multiple of 2^-24.
    #[allow(clippy::should_implement_trait)] // Endless: the `Option` of an iterator would only be in the way.
    pub fn next(&mut self) -> f32 {
        (self.bits() >> 8) as f32 / 16_777_216.0
    }

    /// A whole number below `n`, `n` > 0.
    pub fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.bits()) * u64::from(n)) >> 32) as u32
    }

    /// A direction, every one equally likely.
    pub fn direction(&mut self) -> DVec3 {
        let z = 2.0 * f64::from(self.next()) - 1.0;
        let (sin, cos) = (std::f64::consts::TAU * f64::from(self.next())).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(r * cos, r * sin, z)
    }
}
