//! Rotary position embeddings in time, height and width (Su et al. 2021; three axes as in Wan).

use crate::ops;
use crate::wan::activations;
use crate::wan::config::DitConfig;
use burn::tensor::{Device, Tensor, TensorData};

/// The angles by which queries and keys are rotated, for a list of token positions.
///
/// Of the d channels of a head, height and width rotate `2 (d / 6)` each, and time the rest, in the order time, height, width.
/// Pair j of an axis with `a` channels is rotated by `position theta^(-2 j / a)`. Positions are real numbers.
#[derive(Clone, Debug)]
pub struct Rope {
    /// `[n, pairs]`.
    cos: Tensor<2>,
    /// Same shape.
    sin: Tensor<2>,
}

impl Rope {
    /// Angles for tokens at `places` (time, row, column), in units of tokens.
    pub fn new(config: &DitConfig, places: &[[f64; 3]], device: &Device) -> Self {
        let space = 2 * (config.head_dim / 6);
        let axes = [config.head_dim - 2 * space, space, space];
        let frequencies: Vec<(usize, f64)> = axes
            .iter()
            .enumerate()
            .flat_map(|(axis, &a)| (0..a / 2).map(move |j| (axis, config.rope_theta.powf(-2.0 * j as f64 / a as f64))))
            .collect();
        let shape = [places.len(), frequencies.len()];
        let table = |f: fn(f64) -> f64| {
            let turn = |place: &[f64; 3]| frequencies.iter().map(move |&(axis, w)| f(place[axis] * w) as f32).collect::<Vec<_>>();
            Tensor::from_data(TensorData::new(places.iter().flat_map(turn).collect::<Vec<f32>>(), shape), device)
        };
        Self { cos: table(f64::cos), sin: table(f64::sin) }
    }

    /// Angles for a grid of frames, rows and columns of tokens. Frame i has the time `first + i step`.
    pub fn grid(config: &DitConfig, [frames, rows, columns]: [usize; 3], first: f64, step: f64, device: &Device) -> Self {
        let mut places = Vec::with_capacity(frames * rows * columns);
        for frame in 0..frames {
            let time = first + frame as f64 * step;
            places.extend((0..rows * columns).map(|i| [time, (i / columns) as f64, (i % columns) as f64]));
        }
        Self::new(config, &places, device)
    }

    /// Rotates queries or keys `[b, n, c]`. Channels 2 i and 2 i + 1 of a head are a pair.
    pub fn rotate(&self, x: Tensor<3>) -> Tensor<3> {
        ops::turn(x, self.cos.clone(), self.sin.clone())
    }

    /// Reports the tables in diffusers' form, with each value twice, `[1, n, 1, head_dim]`.
    pub(super) fn report(&self) {
        for (name, table) in [("rope_cos", &self.cos), ("rope_sin", &self.sin)] {
            activations::report(name, || {
                let [n, pairs] = table.dims();
                table.clone().reshape([1, n, 1, pairs, 1]).expand([1, n, 1, pairs, 2]).reshape([1, n, 1, 2 * pairs])
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::to_vec;

    /// Products of turned tokens depend on the difference of their places only, whole or not, before or after the first.
    #[test]
    fn only_offsets_count() {
        let (config, device) = (DitConfig { heads: 1, ..DitConfig::tiny() }, Device::flex());
        let row: Vec<f32> = (0..config.head_dim).map(|i| (i * 7 % 5) as f32 - 1.7).collect();
        let product = |a: [f64; 3], b: [f64; 3]| {
            let x = Tensor::<3>::from_data(TensorData::new(row.repeat(2), [1, 2, config.head_dim]), &device);
            let y = to_vec(Rope::new(&config, &[a, b], &device).rotate(x));
            y[..config.head_dim].iter().zip(&y[config.head_dim..]).map(|(a, b)| f64::from(a * b)).sum::<f64>()
        };
        let origin = product([0.0; 3], [3.25, 2.0, -1.0]);
        let moved = product([-4.25, 5.0, 9.5], [-1.0, 7.0, 8.5]);
        assert!((origin - moved).abs() < 1e-4, "{origin} against {moved}");
        for other in [[3.0, 2.0, -1.0], [3.25, 1.0, -1.0], [3.25, 2.0, 1.5], [2.0, 3.25, -1.0]] {
            assert!((origin - product([0.0; 3], other)).abs() > 1e-2, "{other:?} is told apart");
        }
    }
}
