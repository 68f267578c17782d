//! Weights that do not exist yet: each is drawn, from its own stream of one seed, when it is first used. A network whose weights
//! are read from a file, or only counted, never draws them.

use burn::module::{Param, ParamId};
use burn::tensor::{Device, Shape, Tensor, TensorData};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Values drawn from one stream of random numbers; whatever the number of threads, a weight is the same.
const CHUNK: usize = 1 << 16;
/// Distances of the seeds of streams: odd, with bits everywhere (the first is the golden ratio).
const BETWEEN_WEIGHTS: u64 = 0x9E37_79B9_7F4A_7C15;
const BETWEEN_CHUNKS: u64 = 0xD1B5_4A32_D192_ED03;

/// How a weight begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// The same value everywhere.
    Constant(f32),
    /// Normal values of this standard deviation.
    Normal(f32),
}

/// Makes the weights of a network, in the order of construction.
#[derive(Debug)]
pub struct Init<'a> {
    seed: u64,
    made: u64,
    device: &'a Device,
}

impl<'a> Init<'a> {
    /// Weights on `device` from `seed`.
    pub fn new(seed: u64, device: &'a Device) -> Self {
        Self { seed, made: 0, device }
    }

    /// A weight that begins with `start`.
    pub fn weight<const D: usize>(&mut self, shape: [usize; D], start: Start) -> Param<Tensor<D>> {
        self.made += 1;
        let seed = self.seed.wrapping_add(self.made.wrapping_mul(BETWEEN_WEIGHTS));
        let draw = move |device: &Device, require_grad: bool| {
            let count = shape.iter().product();
            let values = match start {
                Start::Constant(value) => vec![value; count],
                Start::Normal(std) => {
                    let mut values = vec![0.0; count];
                    values.par_chunks_mut(CHUNK).enumerate().for_each(|(i, chunk)| {
                        let mut rng = Pcg64Mcg::seed_from_u64(seed.wrapping_add((i as u64).wrapping_mul(BETWEEN_CHUNKS)));
                        chunk.iter_mut().for_each(|value| *value = std * crate::network::init::normal(&mut rng));
                    });
                    values
                }
            };
            let tensor = Tensor::<D>::from_data(TensorData::new(values, shape), device);
            if require_grad { tensor.require_grad() } else { tensor }
        };
        Param::uninitialized(ParamId::new(), draw, self.device.clone(), true, Shape::from(shape))
    }

    /// A matrix `[from, to]` that keeps the variance between the two directions (Glorot and Bengio 2010).
    pub fn matrix(&mut self, from: usize, to: usize) -> Param<Tensor<2>> {
        self.weight([from, to], Start::Normal((2.0 / (from + to) as f32).sqrt()))
    }

    /// Offsets of a convolution over `inputs` values, of the variance that PyTorch draws them with. Not zeros: a grey picture (0) would
    /// have features of exactly zero, and there the slope of the autoencoder's normalisation is 1e12.
    pub fn offsets(&mut self, inputs: usize, to: usize) -> Param<Tensor<1>> {
        self.weight([to], Start::Normal((3.0 * inputs as f32).powf(-0.5)))
    }

    /// A vector of zeros.
    pub fn zeros(&mut self, width: usize) -> Param<Tensor<1>> {
        self.weight([width], Start::Constant(0.0))
    }
}
