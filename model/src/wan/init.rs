//! Initial weights that are made late: each weight is drawn when it is first used, from a random stream of its own. A network
//! whose weights are read from a file, or only counted, never draws them.

use burn::module::{Param, ParamId};
use burn::tensor::{Device, Shape, Tensor, TensorData};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Number of values that are drawn from one random stream. Weights are the same for any number of threads.
const CHUNK: usize = 1 << 16;
/// Distances between the seeds of streams. They are odd numbers with well spread bits (the first is the golden ratio).
const BETWEEN_WEIGHTS: u64 = 0x9E37_79B9_7F4A_7C15;
const BETWEEN_CHUNKS: u64 = 0xD1B5_4A32_D192_ED03;

/// The distribution of an initial weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// The same value for all.
    Constant(f32),
    /// Normal values with this standard deviation.
    Normal(f32),
}

/// Makes the weights of a network in the order of construction.
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

    /// A weight with the distribution `start`.
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

    /// A matrix `[from, to]` with Glorot initialisation (Glorot and Bengio 2010).
    pub fn matrix(&mut self, from: usize, to: usize) -> Param<Tensor<2>> {
        self.weight([from, to], Start::Normal((2.0 / (from + to) as f32).sqrt()))
    }

    /// Biases of a convolution over `inputs` values, with the variance of PyTorch's initialisation. They are not zeros: the
    /// features of a grey picture (0) would be exactly zero, where the slope of the autoencoder's normalisation is 1e12.
    pub fn offsets(&mut self, inputs: usize, to: usize) -> Param<Tensor<1>> {
        self.weight([to], Start::Normal((3.0 * inputs as f32).powf(-0.5)))
    }

    /// A vector of zeros.
    pub fn zeros(&mut self, width: usize) -> Param<Tensor<1>> {
        self.weight([width], Start::Constant(0.0))
    }
}
