//! Bridge matching in the latents of an autoencoder (RenderFlow, section "Latent-Space Bridge-Matching Training"), and the
//! logarithmic curve in which networks read radiance.

use crate::kernels::ln_each;
use crate::{Error, Result};
use pulp::{Arch, NullaryFnOnce};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Noise of the Brownian bridge, in units of z.
pub const SIGMA: f32 = 0.005;
/// Times at which a network is trained.
pub const TIMES: [f32; 4] = [0.0, 0.25, 0.5, 0.75];
/// Largest exposed radiance, the limit of half floats. Brighter values are clamped to it.
pub const MAX_RADIANCE: f32 = 65504.0;

/// `1 / ln 9`, the scale of [`log_curves`].
const SCALE: f32 = 0.455_119_6;

/// Clamps to the range of the curve and of half floats. NaN becomes 0.
#[inline(always)]
fn representable(x: f32) -> f32 {
    if x.is_nan() { 0.0 } else { x.clamp(0.0, MAX_RADIANCE) }
}

/// Replaces every exposed radiance x by `log1p(8 x) / log1p(8)`, within 1e-6: 0 at 0, and 1 at 1. Values are clamped to
/// 0..=65504, and NaN becomes 0. It is fastest for a multiple of 16 values.
pub(crate) fn log_curves(values: &mut [f32]) {
    Arch::new().dispatch(LogCurves(values));
}

/// [`log_curves`], to be inlined into code that is compiled for the processor.
#[inline(always)]
pub(crate) fn log_curve_each(values: &mut [f32]) {
    values.iter_mut().for_each(|v| *v = 8.0f32.mul_add(representable(*v), 1.0));
    ln_each(values);
    values.iter_mut().for_each(|v| *v *= SCALE);
}

/// [`log_curve_each`], compiled for the processor.
struct LogCurves<'a>(&'a mut [f32]);

impl NullaryFnOnce for LogCurves<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        log_curve_each(self.0);
    }
}

/// Derivative of the sRGB transfer function at x > 0.
pub fn srgb_slope(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * x.powf(1.0 / 2.4 - 1.0) }
}

/// The distribution of times in training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Times {
    /// The four [`TIMES`] with these probabilities, which need not sum to 1. The factor `1 / (1 - t)` is at most 4.
    Four([f32; 4]),
    /// Uniform from 0 to [`LAST_TIME`].
    Uniform,
}

impl Default for Times {
    /// The four [`TIMES`] with equal probabilities (LBM, Chadebec et al. 2025).
    fn default() -> Self {
        Self::Four([0.25; 4])
    }
}

/// Latest time of [`Times::Uniform`]. At time 1 the velocity of a noisy bridge would be 0 / 0; at this time its noise is 32
/// sigma.
pub const LAST_TIME: f32 = 0.999;

impl Times {
    /// Draws a time.
    pub fn draw(self, rng: &mut Pcg64Mcg) -> f32 {
        let probabilities = match self {
            Self::Uniform => return LAST_TIME * rng.random::<f32>(),
            Self::Four(probabilities) => probabilities,
        };
        let total: f32 = probabilities.iter().sum();
        let mut u = rng.random::<f32>() * total;
        let mut drawn = 0.0;
        for (&time, &probability) in TIMES.iter().zip(&probabilities) {
            if probability <= 0.0 {
                continue;
            }
            drawn = time;
            u -= probability;
            if u < 0.0 {
                break;
            }
        }
        drawn
    }

    /// Whether probabilities are at least 0 and not all 0.
    pub fn is_valid(self) -> bool {
        match self {
            Self::Uniform => true,
            Self::Four(probabilities) => {
                probabilities.iter().all(|p| *p >= 0.0 && p.is_finite()) && probabilities.iter().sum::<f32>() > 0.0
            }
        }
    }
}

/// The path between start `z_0` (t = 0) and end `z_1` (t = 1) on which a network is trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Bridge {
    /// Noise of the Brownian bridge in units of z, 0..=1. With 0, the path is straight, as for an ordinary differential equation.
    pub sigma: f32,
    /// The distribution of times in training.
    pub times: Times,
}

impl Default for Bridge {
    fn default() -> Self {
        Self { sigma: SIGMA, times: Times::default() }
    }
}

impl Bridge {
    /// Checks both options.
    ///
    /// # Errors
    /// [`Error::Config`] naming the option.
    pub fn validate(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.sigma) {
            return Err(Error::config("bridge.sigma", format!("{} is outside 0..=1", self.sigma)));
        }
        if !self.times.is_valid() {
            return Err(Error::config("bridge.times", "probabilities must be at least 0, and not all 0"));
        }
        Ok(())
    }

    /// `z_t = (1 - t) z_0 + t z_1 + sigma sqrt(t (1 - t)) noise`, for one value and standard normal noise.
    pub fn interpolate(self, z0: f32, z1: f32, t: f32, noise: f32) -> f32 {
        (1.0 - t) * z0 + t * z1 + self.sigma * (t * (1.0 - t)).sqrt() * noise
    }
}

/// Velocity `(z1_hat - z_t) / (1 - t)` towards an end point. With the true end point, it is the target of training.
pub fn velocity(z1_hat: f32, z_t: f32, t: f32) -> f32 {
    (z1_hat - z_t) / (1.0 - t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::step_rng;

    #[test]
    fn the_curve_agrees_with_its_formula() {
        let mut rng = step_rng(9, 0);
        let mut values: Vec<f32> = (0..1000).map(|_| rng.random_range(-12.0f32..12.0).exp2()).collect();
        values.extend([0.0, -0.0, -1.0, 1e-38, 1e-6, 1.0, 65504.0, 1e30, f32::INFINITY, f32::NAN]);
        let expected: Vec<f32> = values.iter().map(|v| (8.0 * representable(*v)).ln_1p() * SCALE).collect();
        log_curves(&mut values);
        for (found, expected) in values.iter().zip(&expected) {
            assert!((found - expected).abs() <= 1e-6 * expected.max(1.0), "{found} and {expected}");
        }
    }

    #[test]
    fn times_follow_their_table() {
        let mut rng = step_rng(3, 0);
        let table = Times::Four([0.5, 0.0, 3.0, 1.5]);
        let mut counts = [0; 4];
        for _ in 0..20_000 {
            let t = table.draw(&mut rng);
            counts[TIMES.iter().position(|time| *time == t).expect("one of the four")] += 1;
        }
        for (count, share) in counts.iter().zip([0.1, 0.0, 0.6, 0.3]) {
            let expected = 20_000.0 * share;
            // Five standard deviations of a binomial count.
            assert!((f64::from(*count) - expected).abs() <= 5.0 * (expected * (1.0 - share)).sqrt(), "{counts:?}");
        }
        let uniform: Vec<f32> = (0..20_000).map(|_| Times::Uniform.draw(&mut rng)).collect();
        assert!(uniform.iter().all(|t| (0.0..=LAST_TIME).contains(t)));
        let mean = uniform.iter().sum::<f32>() / 20_000.0;
        assert!((mean - 0.4995).abs() < 5.0 * 0.2887 / 20_000f32.sqrt(), "{mean}");
    }

    #[test]
    fn a_bridge_without_noise_is_straight() {
        let straight = Bridge { sigma: 0.0, ..Bridge::default() };
        for t in [0.0, 0.25, 0.6, LAST_TIME] {
            let z_t = straight.interpolate(-0.4, 0.8, t, 3.0);
            assert!((velocity(0.8, z_t, t) - 1.2).abs() < 1e-3, "{t}");
        }
        assert!(Bridge { sigma: f32::NAN, ..straight }.validate().is_err());
        assert!(Bridge { times: Times::Four([0.0; 4]), ..straight }.validate().is_err());
        assert!(Bridge { times: Times::Four([1.0, f32::NAN, 0.0, 0.0]), ..straight }.validate().is_err());
        assert!(straight.validate().is_ok());
    }
}
