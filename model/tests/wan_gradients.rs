//! Gradients of the wan networks against finite differences, tensor by tensor.

mod wan;

use burn::tensor::{Device, Tensor};
use renderflow_model::parameters;
use renderflow_model::wan::weights::{Header, LoadOptions, Network, Precision, Provenance, Source, load, save};
use renderflow_model::wan::{DitConfig, DitInput, Vace, VaceConfig, Vae, VaeConfig};
use wan::gradients::{compare, tensor, weighed};

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
        weighed(vace.forward(input, tensor([2, 24, 1, 4, 4], 0.3, &device), None).expect("runs"))
    });
}

#[test]
fn gradients_of_the_autoencoder() {
    let device = Device::flex().autodiff();
    let config = VaeConfig { num_res_blocks: 1, base_dim: 4, decoder_base_dim: 4, ..VaeConfig::tiny() };
    let vae = Vae::new(&config, 5, &device).expect("network");
    compare(vae, &device, |vae| {
        let moments = vae.moments(tensor([1, 3, 9, 8, 8], 0.1, &device)).expect("encodes");
        let pictures = vae.decode(tensor([1, 4, 3, 1, 1], 0.2, &device)).expect("decodes");
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
    let moments = vae.moments(Tensor::zeros([1, 3, 5, 8, 8], &device)).expect("encodes");
    let mut found = weighed(moments).backward();
    let gradients = parameters::gradients(&vae.encoder, &mut found).expect("gradients");
    for (parameter, gradient) in parameters::export(&vae.encoder).iter().zip(gradients) {
        let gradient = gradient.unwrap_or_else(|| panic!("{} has no gradient", parameter.name));
        assert!(gradient.iter().all(|g| g.is_finite()), "{}", parameter.name);
    }
}
