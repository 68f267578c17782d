//! Memory of a training step of the small renderer, with and without recomputed activations. Linux, on demand:
//! `cargo test --release -p renderflow-model --test wan_train_memory -- --ignored --nocapture`.
#![cfg(target_os = "linux")]

use burn::module::Module;
use burn::tensor::Device;
use renderflow_model::train::runner::Learner;
use renderflow_model::wan::Vae;
use renderflow_model::wan::flow::{Flow, FlowConfig};
use renderflow_model::wan::train::PixelLoss;
use renderflow_model::wan::train::batch::LatentBatch;
use renderflow_model::wan::train::renderer::FlowLearner;
use std::time::Instant;

/// A line of the process's status, MiB.
fn status(key: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").expect("status");
    let line = text.lines().find(|line| line.starts_with(key)).expect("known key");
    line.split_whitespace().nth(1).and_then(|v| v.parse::<f64>().ok()).expect("number") / 1024.0
}

/// Most memory in use during `run` beyond that before it, MiB, and seconds.
fn peak(run: impl FnOnce()) -> (f64, f64) {
    let before = status("VmRSS");
    // Forgets the highest mark so far.
    std::fs::write("/proc/self/clear_refs", "5").expect("writable");
    let start = Instant::now();
    run();
    (status("VmHWM") - before, start.elapsed().as_secs_f64())
}

#[test]
#[ignore]
fn recomputation_saves_memory() {
    let device = Device::flex().autodiff();
    let config = FlowConfig::small();
    let flow = Flow::new(&config, 1, &device).expect("a valid configuration");
    let waves = |count: usize| (0..count).map(|i| (i as f32 * 0.7391).sin()).collect::<Vec<f32>>();
    for (items, frames, side) in [(1, 2, 32), (4, 2, 32), (1, 2, 64)] {
        let values = items * frames * side * side;
        let batch = LatentBatch {
            shape: [items, config.vae.z_dim, frames, side, side],
            z_t: waves(values * config.vae.z_dim),
            velocity: waves(values * config.vae.z_dim),
            times: vec![0.0; items],
            attributes: waves(values * config.attribute_channels()),
            environment: waves(values * config.vae.z_dim),
            ..LatentBatch::default()
        };
        let learner = |recompute| FlowLearner {
            vae: Vae::new(&config.vae, 1, &device).expect("a valid configuration").no_grad(),
            pixels: PixelLoss { weight: 0.0, ..PixelLoss::default() },
            latent: 1.0,
            albedo_lpips: 0.0,
            lpips: None,
            recompute,
        };
        let learn = |recompute| drop(learner(recompute).learn(&flow, 0, batch.clone(), &device).expect("gradients"));
        // Weights are made at their first use.
        learn(true);
        let [(again, slow), (plain, fast)] = [true, false].map(|recompute| peak(|| learn(recompute)));
        println!(
            "{items} x {frames} latent frames of {side}x{side}: plain {plain:.0} MiB {fast:.2} s, recomputed {again:.0} MiB {slow:.2} s"
        );
        assert!(again < 0.6 * plain, "{again} against {plain} MiB");
    }
}
