//! Random draws for scene parameters. Results are rounded to what a scene file shows, so that files stay short and
//! small differences between mathematical libraries disappear.

use rand::RngExt;
use rand_pcg::Pcg64;

/// Draws on the generator of a [`crate::seed::Seed`].
pub(crate) trait Draw: Sized {
    /// Uniform in `low..high`, rounded.
    fn between(&mut self, low: f32, high: f32) -> f32;
    /// Uniform in the logarithm, `low..high`, both > 0, rounded.
    fn log(&mut self, low: f32, high: f32) -> f32;
    /// A whole number in `0..limit`.
    fn below(&mut self, limit: u32) -> u32;
    /// True with this probability.
    fn chance(&mut self, probability: f64) -> bool;
    /// Index drawn with the given weights.
    fn weighted(&mut self, weights: &[f64]) -> usize;

    /// Four digits after the point, or four significant ones below 0.1.
    fn tidy(value: f32) -> f32;
    /// Linear colour of a hue in degrees, saturation and value 0..=1, taken as linear light.
    fn hsv(hue: f32, saturation: f32, value: f32) -> [f32; 3];
}

impl Draw for Pcg64 {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        let u: f64 = self.random();
        Self::tidy((f64::from(low) + (f64::from(high) - f64::from(low)) * u) as f32)
    }

    fn log(&mut self, low: f32, high: f32) -> f32 {
        let u: f64 = self.random();
        let (low, high) = (f64::from(low), f64::from(high));
        Self::tidy((low * (u * (high / low).ln()).exp()) as f32)
    }

    fn below(&mut self, limit: u32) -> u32 {
        self.random_range(0..limit)
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.random::<f64>() < probability
    }

    fn weighted(&mut self, weights: &[f64]) -> usize {
        let mut left = self.random::<f64>() * weights.iter().sum::<f64>();
        for (index, weight) in weights.iter().enumerate() {
            left -= weight;
            if left < 0.0 {
                return index;
            }
        }
        weights.len() - 1
    }

    fn tidy(value: f32) -> f32 {
        let scale = if value.abs() < 0.1 { 1e6 } else { 1e4 };
        ((f64::from(value) * scale).round() / scale) as f32
    }

    fn hsv(hue: f32, saturation: f32, value: f32) -> [f32; 3] {
        [5.0, 3.0, 1.0].map(|n| {
            let k = (n + hue / 60.0).rem_euclid(6.0);
            Self::tidy(value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0))
        })
    }
}
