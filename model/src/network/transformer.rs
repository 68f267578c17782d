//! Transformer block at 1/16 of the resolution: self-attention with rotary positions, cross-attention to the environment, perceptron.

use super::init::Init;
use super::layers::{Dense, Modulation, Norm};
use crate::config::NetworkConfig;
use crate::ops;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

/// One block; `c` = token width.
#[derive(Module, Debug)]
pub struct Block {
    /// Before self-attention.
    pub norm_self: Norm,
    /// Environment and time into the self-attention branch.
    pub modulate_self: Modulation,
    /// Queries, keys and values of self-attention, `[c, 3 c]`.
    pub qkv: Dense,
    /// Out of self-attention.
    pub out_self: Dense,
    /// Before cross-attention.
    pub norm_cross: Norm,
    /// Queries of cross-attention.
    pub query: Dense,
    /// Keys and values of the environment, `[c, 2 c]`.
    pub key_value: Dense,
    /// Out of cross-attention.
    pub out_cross: Dense,
    /// Before the perceptron.
    pub norm_mlp: Norm,
    /// Environment and time into the perceptron.
    pub modulate_mlp: Modulation,
    /// First layer, with SiLU.
    pub up: Dense,
    /// Second layer.
    pub down: Dense,
    #[module(skip)]
    heads: usize,
}

impl Block {
    /// The residual branches start small.
    pub fn new(init: &mut Init, config: &NetworkConfig) -> Self {
        let (c, hidden) = (config.token_width, config.token_width * config.mlp_ratio);
        // 1 / sqrt 2 undoes He's factor where no SiLU follows.
        const PLAIN: f32 = std::f32::consts::FRAC_1_SQRT_2;
        Self {
            norm_self: Norm::new(init, c),
            modulate_self: Modulation::new(init, config.condition_width, c),
            qkv: Dense::new(init, c, 3 * c, PLAIN),
            out_self: Dense::new(init, c, c, 0.3),
            norm_cross: Norm::new(init, c),
            query: Dense::new(init, c, c, PLAIN),
            key_value: Dense::new(init, c, 2 * c, PLAIN),
            out_cross: Dense::new(init, c, c, 0.3),
            norm_mlp: Norm::new(init, c),
            modulate_mlp: Modulation::new(init, config.condition_width, c),
            up: Dense::new(init, c, hidden, 1.0),
            down: Dense::new(init, hidden, c, 0.3),
            heads: config.heads,
        }
    }

    /// `x` `[b, n, c]`, `environment` `[b, m, c]`, `condition` `[b, 1, condition]`.
    pub fn forward(&self, x: Tensor<3>, rotary: &Rotary, environment: Tensor<3>, condition: Tensor<3>) -> Tensor<3> {
        let c = x.dims()[2];
        let y = self.modulate_self.sequence(self.norm_self.forward(x.clone()), condition.clone());
        let qkv = self.qkv.forward(y, false);
        let q = rotary.turn(qkv.clone().narrow(2, 0, c), self.heads);
        let k = rotary.turn(qkv.clone().narrow(2, c, c), self.heads);
        let y = ops::attention(q, k, qkv.narrow(2, 2 * c, c), self.heads);
        let x = x + self.out_self.forward(y, false);

        let q = self.query.forward(self.norm_cross.forward(x.clone()), false);
        let kv = self.key_value.forward(environment, false);
        let y = ops::attention(q, kv.clone().narrow(2, 0, c), kv.narrow(2, c, c), self.heads);
        let x = x + self.out_cross.forward(y, false);

        let y = self.modulate_mlp.sequence(self.norm_mlp.forward(x.clone()), condition);
        x + self.down.forward(self.up.forward(y, true), false)
    }
}

/// Rotary positions on a grid (Su et al. 2021, half of the pairs by column, half by row): attention sees offsets only, so a
/// network trained on crops runs on pictures of any size.
pub struct Rotary {
    /// `[1, n, 1, 1, half a head]`.
    cos: Tensor<5>,
    /// Same shape.
    sin: Tensor<5>,
}

impl Rotary {
    /// Positions of a `rows x columns` grid for heads of `head` channels (a multiple of 4).
    pub fn new(rows: usize, columns: usize, head: usize, device: &Device) -> Self {
        let pairs = head / 2;
        let per_axis = pairs / 2;
        let mut angles = Vec::with_capacity(rows * columns * pairs);
        for i in 0..rows * columns {
            for position in [i % columns, i / columns] {
                // From 1 rad a token down to 1/32 rad, in equal ratios.
                let steps = (per_axis.max(2) - 1) as f32;
                angles.extend((0..per_axis).map(|j| position as f32 * 32f32.powf(-(j as f32) / steps)));
            }
        }
        let shape = [1, rows * columns, 1, 1, pairs];
        let tensor = |f: fn(f32) -> f32| {
            Tensor::from_data(TensorData::new(angles.iter().map(|&a| f(a)).collect::<Vec<_>>(), shape), device)
        };
        Self { cos: tensor(f32::cos), sin: tensor(f32::sin) }
    }

    /// Turns queries or keys `[b, n, c]`.
    fn turn(&self, x: Tensor<3>, heads: usize) -> Tensor<3> {
        let [b, n, c] = x.dims();
        let pairs = x.reshape([b, n, heads, 2, c / heads / 2]);
        let (a, b_) = (pairs.clone().narrow(3, 0, 1), pairs.narrow(3, 1, 1));
        let first = a.clone() * self.cos.clone() - b_.clone() * self.sin.clone();
        let second = a * self.sin.clone() + b_ * self.cos.clone();
        Tensor::cat(vec![first, second], 3).reshape([b, n, c])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::to_vec;

    #[test]
    fn rotary_products_depend_on_offsets_only() {
        let device = Device::flex();
        let (rows, columns, c, heads) = (4, 6, 16, 2);
        let n = rows * columns;
        let rotary = Rotary::new(rows, columns, c / heads, &device);
        // The same vector everywhere, turned by its position.
        let same = |seed: usize| {
            let row: Vec<f32> = (0..c).map(|i| ((i * 7 + seed * 13) % 11) as f32 / 11.0 - 0.4).collect();
            Tensor::<3>::from_data(TensorData::new(row.repeat(n), [1, n, c]), &device)
        };
        let (q, k) = (to_vec(rotary.turn(same(1), heads)), to_vec(rotary.turn(same(2), heads)));
        let product = |a: usize, b: usize| (0..c / heads).map(|i| q[a * c + i] * k[b * c + i]).sum::<f32>();
        let at = |row: usize, column: usize| row * columns + column;
        for (row, column) in [(0, 0), (1, 2), (2, 3)] {
            let moved = product(at(row, column), at(row + 1, column + 2));
            assert!((moved - product(at(0, 0), at(1, 2))).abs() < 1e-5, "offset (1, 2) from ({row}, {column})");
        }
        let origin = |row: usize, column: usize| product(at(0, 0), at(row, column));
        assert!((origin(1, 2) - origin(0, 2)).abs() > 1e-3, "rows are told apart");
        assert!((origin(1, 2) - origin(1, 0)).abs() > 1e-3, "columns are told apart");
    }
}
