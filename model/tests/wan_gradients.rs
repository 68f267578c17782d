//! Gradients of the wan networks against finite differences, tensor by tensor.

mod wan;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use renderflow_model::parameters::{self, to_vec};
use renderflow_model::wan::weights::{Header, LoadOptions, Network, Precision, Provenance, Source, load, save};
use renderflow_model::wan::{DitConfig, DitInput, Probe, Vace, VaceConfig, Vae, VaeConfig};

/// Values of about one without a pattern.
fn waves(count: usize, seed: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * 0.7391 + seed).sin() + (i as f32 * 0.137 * seed).cos()).collect()
}

fn tensor<const D: usize>(shape: [usize; D], seed: f32, device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(waves(shape.iter().product(), seed), shape), device)
}

/// A number that depends on every value of `x`.
fn weighed<const D: usize>(x: Tensor<D>) -> Tensor<1> {
    let weights = tensor(x.dims(), 0.31, &x.device());
    (x * weights).mean()
}

/// Compares the slope along one direction in each tensor.
fn compare<M: Module>(network: M, device: &Device, loss: impl Fn(&M) -> Tensor<1>) {
    let mut found = loss(&network).backward();
    let gradients = parameters::gradients(&network, &mut found);
    let start = parameters::export(&network);
    let at = |which: usize, values: &[f32]| {
        let all: Vec<&[f32]> =
            start.iter().enumerate().map(|(i, p)| if i == which { values } else { p.values.as_slice() }).collect();
        f64::from(to_vec(loss(&parameters::import(network.clone(), &all, device)).without_autodiff())[0])
    };
    // Differences of a loss of about one are known to about 1e-6 / step.
    let mut worst = 0.0f64;
    for (i, (parameter, gradient)) in start.iter().zip(&gradients).enumerate() {
        let gradient = gradient.as_ref().unwrap_or_else(|| panic!("{} has no gradient", parameter.name));
        assert!(gradient.iter().all(|g| g.is_finite()), "{}", parameter.name);
        let length = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        assert!(length > 0.0, "{} has no influence", parameter.name);
        // Along the gradient, where the slope is largest, with a little of everything else.
        let direction: Vec<f32> =
            gradient.iter().zip(waves(gradient.len(), 0.77)).map(|(g, w)| g / length as f32 + 0.02 * w).collect();
        let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
        let moved = |step: f32| parameter.values.iter().zip(&direction).map(|(v, d)| v + step * d).collect::<Vec<_>>();
        let step = 1e-2;
        let difference = (at(i, &moved(step)) - at(i, &moved(-step))) / (2.0 * f64::from(step));
        let error = (difference - slope).abs() / (slope.abs() + 2e-3);
        worst = worst.max(error);
        assert!(error < 0.03, "{}: slope {slope:.3e}, by differences {difference:.3e}", parameter.name);
    }
    println!("{} tensors, largest relative error {worst:.1e}", start.len());
}

#[test]
fn gradients_of_transformer_and_context_path() {
    let device = Device::flex().autodiff();
    let config = VaceConfig { dit: DitConfig { layers: 2, ..DitConfig::tiny() }, ..VaceConfig::tiny() };
    let mut vace = Vace::new(&config, 5, &device).expect("network");
    // Layers that begin at zero pass no gradient on.
    let matrix = |from, to, seed| burn::module::Param::from_tensor(tensor([from, to], seed, &device).mul_scalar(0.1));
    vace.dit.head.weight = matrix(32, 16, 0.1);
    for (i, block) in vace.blocks.iter_mut().enumerate() {
        block.proj_out.weight = matrix(32, 32, 0.2 + i as f32);
        block.proj_in.iter_mut().for_each(|dense| dense.weight = matrix(32, 32, 0.4));
    }
    compare(vace, &device, |vace| {
        let input = DitInput {
            latents: tensor([2, 4, 2, 4, 4], 0.1, &device),
            times: vec![700.0, 100.0],
            text: Some(tensor([2, 3, 24], 0.2, &device)),
        };
        weighed(vace.forward(input, tensor([2, 24, 1, 4, 4], 0.3, &device), None, &mut Probe::idle()).expect("runs"))
    });
}

#[test]
fn gradients_of_the_autoencoder() {
    let device = Device::flex().autodiff();
    let config = VaeConfig { num_res_blocks: 1, base_dim: 4, decoder_base_dim: 4, ..VaeConfig::tiny() };
    let vae = Vae::new(&config, 5, &device).expect("network");
    compare(vae, &device, |vae| {
        let moments = vae.moments(tensor([1, 3, 9, 8, 8], 0.1, &device), &mut Probe::idle()).expect("encodes");
        let pictures = vae.decode(tensor([1, 4, 3, 1, 1], 0.2, &device), &mut Probe::idle()).expect("decodes");
        weighed(moments) + weighed(pictures)
    });
}

/// Weights that were read can be trained, on a picture of nothing but mid-grey too.
#[test]
fn weights_that_were_read_have_gradients() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("vae.safetensors");
    let (config, device) = (VaeConfig::tiny(), Device::flex().autodiff());
    let header = Header { network: Network::WanVae(config.clone()), provenance: Provenance::default() };
    let drawn = Vae::new(&config, 5, &Device::flex()).expect("network");
    save(&path, &drawn, &header, Precision::F32, Default::default()).expect("saves");
    let empty = Vae::new(&config, 0, &device).expect("network");
    let (vae, _) = load(empty, &Source::open(&path).expect("opens"), LoadOptions::default()).expect("fits");
    let moments = vae.moments(Tensor::zeros([1, 3, 5, 8, 8], &device), &mut Probe::idle()).expect("encodes");
    let mut found = weighed(moments).backward();
    let gradients = parameters::gradients(&vae.encoder, &mut found);
    for (parameter, gradient) in parameters::export(&vae.encoder).iter().zip(gradients) {
        let gradient = gradient.unwrap_or_else(|| panic!("{} has no gradient", parameter.name));
        assert!(gradient.iter().all(|g| g.is_finite()), "{}", parameter.name);
    }
}
