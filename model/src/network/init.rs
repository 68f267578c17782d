//! Initial values of parameters. They are drawn from one seeded generator in the order of construction, so that a seed determines
//! the network.

use burn::module::Param;
use burn::tensor::{Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Draws initial parameters.
pub struct Init<'a> {
    rng: Pcg64Mcg,
    device: &'a Device,
}

impl<'a> Init<'a> {
    /// Begins with `seed`; parameters are made on `device`.
    pub fn new(seed: u64, device: &'a Device) -> Self {
        Self { rng: Pcg64Mcg::seed_from_u64(seed), device }
    }

    /// Normal values with standard deviation `std`.
    pub fn normal<const D: usize>(&mut self, shape: [usize; D], std: f32) -> Param<Tensor<D>> {
        let values: Vec<f32> = (0..shape.iter().product()).map(|_| std * normal(&mut self.rng)).collect();
        Param::from_data(TensorData::new(values, shape), self.device)
    }

    /// The same value everywhere.
    pub fn constant<const D: usize>(&self, shape: [usize; D], value: f32) -> Param<Tensor<D>> {
        Param::from_data(TensorData::new(vec![value; shape.iter().product()], shape), self.device)
    }
}

/// Draws a standard normal number (Box and Muller 1958).
pub fn normal(rng: &mut Pcg64Mcg) -> f32 {
    // 1 - u is in (0, 1], so the logarithm is finite.
    let (u, v): (f32, f32) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}
