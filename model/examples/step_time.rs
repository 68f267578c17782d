//! Times a training step and inference of the default network on this machine: `cargo run --release -p renderflow-model --example step_time`.

use burn::tensor::{Device, Tensor, TensorData};
use half::f16;
use rand::RngExt;
use renderflow_model::bridge::{Bridge, Times};
use renderflow_model::config::NetworkConfig;
use renderflow_model::data::{Batch, StoredFrame, step_rng};
use renderflow_model::features::STORED;
use renderflow_model::network::Network;
use renderflow_model::parameters;
use renderflow_model::tokens::{TOKEN_FEATURES, TOKENS};
use renderflow_model::train::loss::LossWeights;
use renderflow_model::train::optimizer::{Method, Optimizer, StepSettings};
use renderflow_model::train::stage::{BaseStage, Objective};
use std::time::Instant;

fn main() {
    let config = NetworkConfig::default();
    let device = Device::flex().autodiff();
    let mut rng = step_rng(1, 0);
    let pixels = (0..256 * 256 * STORED).map(|_| f16::from_f32(rng.random::<f32>())).collect();
    let tokens = (0..TOKENS * TOKEN_FEATURES).map(|_| rng.random::<f32>()).collect();
    let frame = StoredFrame { width: 256, height: 256, pixels, tokens, keys: None };
    let network = Network::new(&config, 1, &device).expect("the default configuration is valid");
    let mut model = network.base;
    let mut optimizer = Optimizer::new(parameters::export(&model));
    let count: usize = optimizer.slots.iter().map(|slot| slot.first.len()).sum();
    println!("{count} parameters");

    let stage = BaseStage { config: config.clone() };
    let settings =
        StepSettings { method: Method::AdamW, learning_rate: 1e-4, weight_decay: 0.01, clip_norm: 1.0, ema_decay: 0.999 };
    let mut seconds: Vec<[f64; 3]> = Vec::new();
    for step in 0..12 {
        let start = Instant::now();
        let bridge = Bridge { times: Times::Four([0.7, 0.1, 0.1, 0.1]), ..Bridge::default() };
        let batch = Batch::draw(&config, &[&frame], 128, 8, bridge, &mut step_rng(1, step));
        let drawn = start.elapsed().as_secs_f64();
        let (_, mut gradients) = stage.gradients(&model, batch, LossWeights::default(), &device);
        let backward = start.elapsed().as_secs_f64();
        let collected = parameters::gradients(&model, &mut gradients);
        optimizer.step(&collected, settings).expect("finite gradients");
        model = parameters::import(model, &optimizer.values(), &device);
        seconds.push([drawn, backward - drawn, start.elapsed().as_secs_f64() - backward]);
    }
    let median = |part: usize| {
        let mut values: Vec<f64> = seconds[2..].iter().map(|s| 1e3 * s[part]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    println!(
        "step, 8 crops of 128x128 (medians of 10): batch {:.0} ms (overlapped in training), forward and backward {:.0} ms, optimiser {:.0} ms",
        median(0),
        median(1),
        median(2)
    );

    let plain = Device::flex();
    let network = Network::new(&config, 1, &plain).expect("the default configuration is valid");
    for size in [128, 256, 512] {
        let x = vec![0.1f32; size * size * config.pixel_channels()];
        let tensor =
            || Tensor::<4>::from_data(TensorData::new(x.clone(), [1, size / 2, size / 2, 4 * config.pixel_channels()]), &plain);
        let tokens = Tensor::<3>::zeros([1, TOKENS, TOKEN_FEATURES], &plain);
        let time = Tensor::<3>::zeros([1, 1, 1], &plain);
        let mut best = f64::INFINITY;
        for _ in 0..5 {
            let input = tensor();
            let start = Instant::now();
            parameters::to_vec(network.heads(input, tokens.clone(), time.clone()));
            best = best.min(start.elapsed().as_secs_f64());
        }
        println!("network forward {size}x{size}: {:.0} ms (best of 5)", 1e3 * best);
    }
}
