//! Training on the analytic scene: it learns, it resumes exactly, every parameter takes part.

mod common;

use burn::tensor::{Device, Tensor};
use common::{clip, psnr, tiny};
use renderflow_frame::ibl::IblTables;
use renderflow_model::config::KeyframeConfig;
use renderflow_model::train::optimizer::{Method, Optimizer, StepSettings};
use renderflow_model::train::{Config, CropConfig, Progress, Stage, run};
use renderflow_model::weights::Precision;
use renderflow_model::{Error, Keyframe, NeuralRenderer, PreparedKeyframe, parameters, weights};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

fn config(output: &Path, steps: u64) -> Config {
    Config {
        network: tiny(),
        output: output.into(),
        steps,
        crops: vec![CropConfig { size: 64, batch: 2, weight: 1.0 }],
        learning_rate: 3e-3,
        warmup_steps: 10,
        ema_decay: 0.95,
        log_steps: 1,
        precision: Precision::F32,
        ..Config::default()
    }
}

fn train(config: &Config, clip: &renderflow_model::Clip) -> renderflow_model::train::Summary {
    run(config, &vec![clip.clone()], &|_| (), &AtomicBool::new(false)).unwrap()
}

#[test]
fn both_stages_overfit_one_clip() {
    let folder = tempfile::tempdir().unwrap();
    let clip = clip(5, 64);
    let tables = IblTables::new(&clip.environment);
    let truth = clip.frames[2].beauty.as_ref().unwrap();
    let score = |renderer: &NeuralRenderer, keys: &[Keyframe]| {
        let picture =
            renderer.render(&clip.frames[2], &clip.cameras[2], &clip.environment, &tables, clip.exposure, keys).unwrap();
        psnr(&picture, truth, &clip.frames[2], clip.exposure)
    };
    let before = score(&NeuralRenderer::untrained(&tiny(), 1).unwrap(), &[]);

    let base = config(&folder.path().join("base"), 80);
    let summary = train(&base, &clip);
    assert!(summary.finished && summary.steps == 80, "{summary:?}");
    let trained = NeuralRenderer::load(&summary.weights).unwrap();
    let after = score(&trained, &[]);
    assert!(after > before + 6.0, "base: {before:.1} dB before, {after:.1} dB after");

    let stage = Stage::Keyframes { base: summary.weights.clone(), network: KeyframeConfig { widths: [16, 16, 16] } };
    let keyed = train(&Config { stage, ..config(&folder.path().join("keys"), 40) }, &clip);
    let renderer = NeuralRenderer::load(&keyed.weights).unwrap();
    let keys: Vec<PreparedKeyframe> = [0, 4]
        .map(|k| PreparedKeyframe::new(&clip.frames[k], &clip.cameras[k], &clip.environment, &tables, clip.exposure).unwrap())
        .into();
    let keys = [0, 1].map(|k| Keyframe { prepared: &keys[k], distance: 4.0 * k as f32 - 2.0, movement: Default::default() });
    let with_keys = score(&renderer, &keys);
    assert!(with_keys > after + 1.0, "base {after:.1} dB, with keyframes {with_keys:.1} dB");
    // The frozen base is untouched, to the bit.
    assert_eq!(score(&renderer, &[]), after);
    assert_eq!((renderer.header().steps, renderer.header().keyframe_steps), (80, 40));
    println!("start {before:.1} dB, base {after:.1} dB, keyframes {with_keys:.1} dB");
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    let clip = clip(2, 64);
    let whole = train(&config(&folder.path().join("whole"), 6), &clip);

    let parts = config(&folder.path().join("parts"), 6);
    let cancel = AtomicBool::new(false);
    let stop_after_three = |progress: &Progress| {
        if matches!(progress, Progress::Step(record) if record.step == 3) {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    let first = run(&parts, &vec![clip.clone()], &stop_after_three, &cancel).unwrap();
    assert!(!first.finished && first.steps == 3, "{first:?}");
    let second = train(&parts, &clip);
    assert!(second.finished && second.steps == 6);

    let read = |path: &Path| std::fs::read(path).unwrap();
    assert!(read(&whole.weights) == read(&second.weights), "weights differ");
    let losses = |name: &str| -> Vec<(u64, f32)> {
        let text = std::fs::read_to_string(folder.path().join(name).join("log.jsonl")).unwrap();
        let lines = text.lines().map(|line| serde_json::from_str::<renderflow_model::train::log::Record>(line).unwrap());
        lines.map(|record| (record.step, record.loss)).collect()
    };
    assert_eq!(losses("whole"), losses("parts"));
    assert_eq!(losses("whole").len(), 6);
}

#[test]
fn a_cache_too_small_for_all_clips_gives_the_same_batches_when_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let clips = vec![clip(1, 64), clip(2, 64), clip(3, 64)];
    let settings = |name: &str| Config { cache_mib: 0, rotate_steps: 2, ..config(&folder.path().join(name), 6) };
    let whole = run(&settings("whole"), &clips, &|_| (), &AtomicBool::new(false)).unwrap();
    let cancel = AtomicBool::new(false);
    let stop = |progress: &Progress| {
        if matches!(progress, Progress::Step(record) if record.step == 3) {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    run(&settings("parts"), &clips, &stop, &cancel).unwrap();
    let parts = run(&settings("parts"), &clips, &|_| (), &AtomicBool::new(false)).unwrap();
    assert!(std::fs::read(whole.weights).unwrap() == std::fs::read(parts.weights).unwrap());
}

#[test]
fn every_parameter_learns() {
    let folder = tempfile::tempdir().unwrap();
    let clip = clip(1, 64);
    let config = Config { weight_decay: 0.0, ema_decay: 0.0, ..config(folder.path(), 4) };
    let before =
        parameters::export(&renderflow_model::network::Network::new(&config.network, config.seed, &Device::flex()).unwrap());
    let summary = train(&config, &clip);
    let after = parameters::export(&weights::load(&summary.weights, &Device::flex()).unwrap().0);
    for (before, after) in before.iter().zip(&after) {
        assert_eq!(before.name, after.name);
        assert!(before.values != after.values, "{} did not move in four steps", before.name);
    }
}

#[test]
fn the_optimiser_is_adamw() {
    use burn::module::Param;
    use burn::optim::{AdamWConfig, GradientsParams};

    let device = Device::flex().autodiff();
    let start = [[0.5f32, -1.0, 2.0], [0.1, 0.0, -0.3]];
    let settings =
        StepSettings { method: Method::AdamW, learning_rate: 0.05, weight_decay: 0.1, clip_norm: f32::INFINITY, ema_decay: 0.9 };
    let mut theirs = Param::from_tensor(Tensor::<2>::from_data(start, &device));
    let mut reference = AdamWConfig::new().with_beta_2(0.99).with_epsilon(1e-8).with_weight_decay(0.1).init();
    let mut ours = Optimizer::new(parameters::export(&theirs));
    for step in 0..5 {
        // The gradient of sum(w^3) / 3 + step * sum(w).
        let w = theirs.val();
        let loss = w.clone().powi_scalar(3).sum().div_scalar(3.0) + w.sum().mul_scalar(step as f32);
        let gradient: Vec<f32> = ours.slots[0].parameter.values.iter().map(|w| w * w + step as f32).collect();
        let grads = GradientsParams::from_grads(loss.backward(), &theirs);
        theirs = reference.step(0.05, theirs, grads);
        ours.step(&[Some(gradient)], settings).unwrap();
        let expected = parameters::export(&theirs);
        for (a, b) in ours.slots[0].parameter.values.iter().zip(&expected[0].values) {
            assert!((a - b).abs() < 1e-5, "step {step}: {a} instead of {b}");
        }
    }
    // Clipping scales the whole gradient.
    let mut clipped = Optimizer::new(parameters::export(&theirs));
    let norm = clipped.step(&[Some(vec![3.0, 0.0, 0.0, 4.0, 0.0, 0.0])], StepSettings { clip_norm: 1.0, ..settings }).unwrap();
    assert_eq!(norm, 5.0);
    assert!((clipped.slots[0].first[0] - 0.06).abs() < 1e-7 && (clipped.slots[0].first[3] - 0.08).abs() < 1e-7);
    // A gradient that is not finite changes nothing and is named.
    let before = clipped.clone();
    assert!(clipped.step(&[Some(vec![f32::NAN; 6])], settings).is_err());
    assert_eq!(before, clipped);
}

#[test]
fn unusable_settings_and_data_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let good = clip(1, 64);
    let quiet =
        |config: &Config, clips: &Vec<renderflow_model::Clip>| run(config, clips, &|_| (), &AtomicBool::new(false)).unwrap_err();
    let base = config(folder.path(), 2);

    let error =
        quiet(&Config { crops: vec![CropConfig { size: 40, batch: 1, weight: 1.0 }], ..base.clone() }, &vec![good.clone()]);
    assert!(matches!(error, Error::Config { option: "crops.size", .. }), "{error}");
    let error =
        quiet(&Config { crops: vec![CropConfig { size: 96, batch: 1, weight: 1.0 }], ..base.clone() }, &vec![good.clone()]);
    assert!(error.to_string().contains("64x64 are smaller than the crop of 96"), "{error}");
    let error = quiet(&base, &vec![]);
    assert!(error.to_string().contains("no clips"), "{error}");
    let mut broken = good.clone();
    broken.frames[0].beauty = None;
    let error = quiet(&base, &vec![broken]);
    assert!(error.to_string().contains("analytic: frame 0 has no beauty"), "{error}");

    train(&base, &good);
    let error = quiet(&Config { seed: 9, ..base.clone() }, &vec![good]);
    assert!(matches!(error, Error::Config { option: "seed", .. }), "{error}");
}
