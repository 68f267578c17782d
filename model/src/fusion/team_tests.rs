//! Several processes train the fusion network as one does.

use super::record::{KEYS, NEIGHBOURS, PARTS, PICTURES};
use super::training::{self, Config, Source};
use super::{FusionConfig, Record};
use crate::Result;
use crate::device::NetworkDevice;
use crate::train::config::{Gradients, RunConfig};
use crate::train::runner::RunContext;
use crate::train::sequences::Crop;
use crate::train::team::tests::{apart, folder, log, together};
use half::f16;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::sync::atomic::AtomicBool;

/// Frames of noise.
struct Noise;

impl Source for Noise {
    fn make(&self, i: u64) -> Result<Vec<Record<f16>>> {
        let mut rng = Pcg64Mcg::seed_from_u64(i);
        let mut record = Record::<f32>::new(32, 32);
        record.pixels.iter_mut().for_each(|v| *v = rng.random_range(0.1..1.0));
        record.deferred = true;
        record.distances = [Some(-3.0); KEYS];
        record.parts = [2; PARTS];
        record.neighbours = [2; NEIGHBOURS];
        record.denoised = [true; PICTURES];
        Ok(vec![record.to_half()])
    }

    fn identity(&self) -> String {
        "noise".into()
    }
}

#[test]
fn two_processes_train_the_network_that_reads_samples_as_one_does() {
    let run = |processes: usize, gradients: Gradients| {
        let folder = folder();
        let config = Config {
            network: FusionConfig { widths: [16; 4], ..FusionConfig::default() },
            run: RunConfig {
                output: folder.path().into(),
                steps: 6,
                warmup_steps: 2,
                checkpoint_steps: 3,
                log_steps: 1,
                gradients,
                ..Config::default().run
            },
            crops: vec![Crop { size: 16, batch: 8, from: 0.0 }],
            first: 2,
            rotate_steps: 2,
            window: 3,
            products: crate::ops::Products::F32,
            ..Config::default()
        };
        let outcomes = together(processes, |team| {
            let context = RunContext { device: &NetworkDevice::cpu(), progress: &|_| (), cancel: &AtomicBool::new(false), team };
            training::run(&config, &Noise, None, &[], context)
        });
        outcomes.into_iter().for_each(|outcome| assert_eq!(outcome.expect("a run").steps, 6));
        log(folder.path())
    };
    let alone = run(1, Gradients::F32);
    let (pair, half) = (apart(&alone, &run(2, Gradients::F32)), apart(&alone, &run(2, Gradients::F16)));
    assert!(pair < 1e-3 && half < 1e-2, "{pair} {half}");
}
