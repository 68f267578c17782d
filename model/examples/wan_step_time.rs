//! Times training steps of the wan networks on this machine: `cargo run --release -p renderflow-model --example wan_step_time`.
//! With the argument `renderer`, steps of the small renderer instead of autoencoders.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use rand::RngExt;
use renderflow_model::data::step_rng;
use renderflow_model::parameters;
use renderflow_model::train::runner::Learner;
use renderflow_model::wan::flow::FlowConfig;
use renderflow_model::wan::names::Named;
use renderflow_model::wan::train::PixelLoss;
use renderflow_model::wan::train::autoencoder::{AutoencoderLearner, PictureBatch};
use renderflow_model::wan::train::batch::LatentBatch;
use renderflow_model::wan::train::renderer::FlowLearner;
use renderflow_model::wan::{Probe, Vae, VaeConfig};
use std::time::Instant;

/// Seconds of the fastest of `count` runs after one to warm up.
fn best(count: usize, mut run: impl FnMut()) -> f64 {
    run();
    let time = |run: &mut dyn FnMut()| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64()
    };
    (0..count).map(|_| time(&mut run)).fold(f64::INFINITY, f64::min)
}

fn noise(count: usize) -> Vec<f32> {
    let mut rng = step_rng(1, count as u64);
    (0..count).map(|_| 2.0 * rng.random::<f32>() - 1.0).collect()
}

fn autoencoders() {
    let device = Device::flex().autodiff();
    println!("{:>26} {:>9} | 256x256: encode  decode | step of 8 128x128  of 1 clip of 5", "base, decoder, blocks, z", "params");
    for (base_dim, decoder_base_dim, num_res_blocks, z_dim) in
        [(16, 16, 1, 16), (16, 24, 1, 16), (24, 24, 1, 16), (32, 32, 1, 16), (16, 24, 2, 16)]
    {
        let statistics = (vec![0.0; z_dim], vec![1.0; z_dim]);
        let config = VaeConfig {
            base_dim,
            decoder_base_dim,
            num_res_blocks,
            z_dim,
            latents_mean: statistics.0,
            latents_std: statistics.1,
            ..VaeConfig::wan()
        };
        let vae = Vae::new(&config, 1, &device).expect("a valid configuration");
        let plain = vae.valid();
        let picture = Tensor::<5>::zeros([1, 3, 1, 256, 256], &Device::flex());
        let latent = plain.encode(picture.clone()).expect("fits");
        let encode = best(3, || drop(parameters::to_vec(plain.encode(picture.clone()).expect("fits"))));
        let decode = best(3, || drop(parameters::to_vec(plain.decode(latent.clone(), &mut Probe::idle()).expect("fits"))));
        let learner = AutoencoderLearner { loss: Default::default(), lpips: None };
        let step = |items: usize, frames: usize, latents: usize| {
            best(2, || {
                let batch = PictureBatch {
                    shape: [items, frames, 128, 128],
                    pictures: noise(items * 3 * frames * 128 * 128),
                    noise: noise(items * z_dim * latents * 16 * 16),
                };
                learner.learn(&vae, 0, batch, &device).expect("gradients");
            })
        };
        let (stills, clip) = (step(8, 1, 1), step(1, 5, 2));
        let name = format!("{base_dim}, {decoder_base_dim}, {num_res_blocks}, {z_dim}");
        let (encode, decode) = (1e3 * encode, 1e3 * decode);
        println!(
            "{name:>26} {:>9} | {encode:>12.0} ms {decode:>4.0} ms | {:>13.0} ms {:>13.0} ms",
            vae.count(),
            1e3 * stills,
            1e3 * clip
        );
    }
}

fn renderer() {
    let device = Device::flex().autodiff();
    let config = FlowConfig::small();
    let flow = renderflow_model::wan::flow::Flow::new(&config, 1, &device).expect("a valid configuration");
    println!("{} parameters", flow.count());
    for (items, frames, side) in [(8, 1, 16), (8, 1, 32), (2, 2, 32)] {
        let shape = [items, config.vae.z_dim, frames, side, side];
        let values = items * frames * side * side;
        let batch = LatentBatch {
            shape,
            z_t: noise(values * config.vae.z_dim),
            velocity: noise(values * config.vae.z_dim),
            times: vec![0.0; items],
            attributes: noise(values * config.attribute_channels()),
            environment: noise(values * config.vae.z_dim),
            ..LatentBatch::default()
        };
        for recompute in [false, true] {
            let vae = Vae::new(&config.vae, 1, &device).expect("a valid configuration");
            let pixels = PixelLoss { weight: 0.0, ..PixelLoss::default() };
            let learner = FlowLearner { vae, pixels, latent: 1.0, albedo_lpips: 0.0, lpips: None, recompute };
            let seconds = best(2, || drop(learner.learn(&flow, 0, batch.clone(), &device).expect("gradients")));
            println!("{items} items of {frames} latent frames of {side}x{side}, recomputed {recompute}: {:.0} ms", 1e3 * seconds);
        }
    }
}

fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("renderer") => renderer(),
        _ => autoencoders(),
    }
}
