//! Memory of a training step of the small renderer, with and without recomputed activations. Linux, on demand:
//! `cargo test --release -p renderflow-model --test wan_train_memory -- --ignored --nocapture`.
#![cfg(target_os = "linux")]

use burn::tensor::Device;
use renderflow_model::train::runner::Objective;
use renderflow_model::wan::Vae;
use renderflow_model::wan::flow::{Flow, FlowConfig, Group};
use renderflow_model::wan::train::PixelLoss;
use renderflow_model::wan::train::flow::FlowObjective;
use renderflow_model::wan::train::latent_batch::LatentBatch;
use std::time::Instant;

/// Items, latent frames, latent rows and columns.
const SIZES: [[usize; 3]; 3] = [[1, 2, 32], [4, 2, 32], [1, 2, 64]];
/// Tells a process of its own which size, and whether to recompute.
const CASE: &str = "RENDERFLOW_MEMORY_CASE";

/// A line of the process's status, MiB.
fn status(key: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").expect("status");
    let line = text.lines().find(|line| line.starts_with(key)).expect("known key");
    line.split_whitespace().nth(1).and_then(|v| v.parse::<f64>().ok()).expect("number") / 1024.0
}

/// One step, in a process that has done nothing else: prints its seconds and the most memory beyond that of the weights, MiB.
fn measure(case: &str) {
    let (index, recompute) = case.split_once(' ').expect("two parts");
    let [items, frames, side] = SIZES[index.parse::<usize>().expect("index")];
    let recompute = recompute == "true";
    let device = Device::flex().autodiff();
    let config = FlowConfig::small();
    // Weights are made at their first use.
    let flow = Flow::new(&config, 1, &device).expect("a valid configuration").learn_only(Group::Base);
    let waves = |count: usize| (0..count).map(|i| (i as f32 * 0.7391).sin()).collect::<Vec<f32>>();
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
    let objective = FlowObjective {
        vae: Vae::new(&config.vae, 1, &device).expect("a valid configuration"),
        pixels: PixelLoss { weight: 0.0, ..PixelLoss::default() },
        latent: 1.0,
        albedo_lpips: 0.0,
        lpips: None,
        recompute,
    };
    let before = status("VmRSS");
    let start = Instant::now();
    objective.step(&flow, batch, &device).expect("gradients");
    println!("measured {} {}", status("VmHWM") - before, start.elapsed().as_secs_f64());
}

#[test]
#[ignore = "a minute: every case in a process of its own"]
fn recomputation_saves_memory() {
    if let Ok(case) = std::env::var(CASE) {
        return measure(&case);
    }
    let program = std::env::current_exe().expect("this test");
    for (index, [items, frames, side]) in SIZES.into_iter().enumerate() {
        let [(plain, fast), (again, slow)] = [false, true].map(|recompute| {
            let mut child = std::process::Command::new(&program);
            child.args(["recomputation_saves_memory", "--exact", "--ignored", "--nocapture"]);
            let output = child.env(CASE, format!("{index} {recompute}")).output().expect("runs");
            let text = String::from_utf8_lossy(&output.stdout).into_owned();
            let line =
                text.lines().find_map(|line| line.split_once("measured ")).unwrap_or_else(|| panic!("{text}")).1.to_string();
            let mut numbers = line.split(' ').map(|n| n.parse::<f64>().expect("number"));
            (numbers.next().expect("memory"), numbers.next().expect("seconds"))
        });
        println!(
            "{items} x {frames} latent frames of {side}x{side}: plain {plain:.0} MiB {fast:.2} s, recomputed {again:.0} MiB {slow:.2} s"
        );
        assert!(again < 0.6 * plain, "{again} against {plain} MiB");
    }
}
