//! Training of the wan networks on the analytic scene: it learns, it resumes exactly, what is frozen stays as it is.

mod common;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use common::checkpoint::edit_configuration;
use common::{clip, encoder, lpips_folder};
use renderflow_model::bridge::{Bridge, Times};
use renderflow_model::data::step_rng;
use renderflow_model::lpips::Backbone;
use renderflow_model::parameters::{self, to_vec};
use renderflow_model::train::{Method, RunConfig, Share};
use renderflow_model::wan::flow::{Flow, FlowConfig, InverseConfig, KeyframeConfig};
use renderflow_model::wan::pictures::Kind;
use renderflow_model::wan::train::latent_batch::{BatchSampler, LatentBatch, Task};
use renderflow_model::wan::train::latents::{ClipLatents, Encoder};
use renderflow_model::wan::train::{BatchConfig, Config, LatentConfig, LogRecord, PixelLoss, Progress, Stage, Summary};
use renderflow_model::wan::weights::Source;
use renderflow_model::wan::{Vae, VaeConfig};
use renderflow_model::{Clip, Error};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const SIZE: usize = 64;

fn config(output: &Path, stage: Stage, steps: u64) -> Config {
    Config {
        stage,
        run: RunConfig {
            output: output.into(),
            steps,
            learning_rate: 4e-3,
            warmup_steps: 10,
            ema_decay: 0.9,
            weight_decay: 0.0,
            log_steps: 1,
            ..RunConfig::default()
        },
        lpips_weights: Some(lpips_folder()),
        batches: vec![BatchConfig { size: SIZE, frames: 5, items: 1, weight: 1.0 }],
        ..Config::default()
    }
}

fn autoencoder() -> Stage {
    Stage::Autoencoder { network: VaeConfig::tiny(), start: None, loss: Default::default() }
}

fn learn(config: &Config, clips: &[Clip]) -> renderflow_model::Result<Summary> {
    common::learn(config, clips, &|_| false)
}

fn train(config: &Config, clips: &[Clip]) -> Summary {
    learn(config, clips).unwrap_or_else(|e| panic!("{e}"))
}

/// Runs until `step` and stops.
fn interrupted(config: &Config, clips: &[Clip], step: u64) -> Summary {
    let stop = |progress: &Progress| matches!(progress, Progress::Step(record) if record.step == step);
    common::learn(config, clips, &stop).unwrap_or_else(|e| panic!("{e}"))
}

fn losses(folder: &Path) -> Vec<(u64, f32)> {
    let text = std::fs::read_to_string(folder.join("log.jsonl")).expect("log");
    let lines = text.lines().map(|line| serde_json::from_str::<LogRecord>(line).expect("record"));
    lines.map(|record| (record.step, record.loss)).collect()
}

/// Trains once whole and once in two parts; both must leave the same bytes.
fn resumes(folder: &Path, stage: impl Fn() -> Stage, clips: &[Clip], change: impl Fn(Config) -> Config) {
    let settings = |name: &str| change(config(&folder.join(name), stage(), 4));
    let whole = train(&settings("whole"), clips);
    let first = interrupted(&settings("parts"), clips, 2);
    assert!(!first.finished && first.steps == 2, "{first:?}");
    let parts = train(&settings("parts"), clips);
    assert!(parts.finished && parts.steps == 4, "{parts:?}");
    assert!(std::fs::read(whole.weights).expect("weights") == std::fs::read(parts.weights).expect("weights"), "weights differ");
    assert_eq!(losses(&folder.join("whole")), losses(&folder.join("parts")));
}

fn latents(autoencoder: &Path) -> LatentConfig {
    LatentConfig {
        autoencoder: autoencoder.into(),
        pixels: PixelLoss { weight: 0.0, lpips: 0.0, ..PixelLoss::default() },
        ..LatentConfig::default()
    }
}

/// An autoencoder that has seen a little: what it is worth does not matter.
fn some_autoencoder(folder: &Path, steps: u64, clips: &[Clip]) -> PathBuf {
    let mut settings = config(&folder.join("autoencoder"), autoencoder(), steps);
    settings.batches = vec![BatchConfig { size: 32, frames: 1, items: 4, weight: 1.0 }];
    settings.run.learning_rate = 1.5e-3;
    train(&settings, clips).weights
}

fn base(autoencoder: &Path) -> Stage {
    Stage::Base { network: Box::new(FlowConfig::tiny()), start: None, latents: latents(autoencoder) }
}

fn keyframes(base: &Path, latents: LatentConfig) -> Stage {
    Stage::Keyframes { base: base.into(), network: KeyframeConfig { lora_rank: 4, ..Default::default() }, gap: 4, latents }
}

fn inverse(base: &Path, latents: LatentConfig) -> Stage {
    let network = InverseConfig { lora_rank: 4, ..Default::default() };
    Stage::Inverse { base: base.into(), network, lpips: 0.0, latent: 1.0, latents }
}

/// With decoded predictions at every second step, and LPIPS where its weights are.
fn decoded(autoencoder: &Path) -> LatentConfig {
    let folder = lpips_folder();
    let there = folder.join(Backbone::Squeeze.file_name()).is_file();
    let pixels = PixelLoss { weight: 1.0, lpips: if there { 1.0 } else { 0.0 }, gradient: 1.0, period: 2, window: 4 };
    LatentConfig { pixels, ..latents(autoencoder) }
}

fn open(path: &Path) -> Flow {
    let source = Source::open(path).expect("weights");
    Flow::read(&source, |config| config, 0, &Device::flex()).expect("a renderer").0
}

/// Latents of clips, made by an untrained autoencoder.
fn encoded(vae: &Vae, clips: &[Clip], stills: bool) -> Vec<Arc<Vec<ClipLatents>>> {
    let encoder = Encoder { stills, pictures: &Kind::ALL, ..encoder(vae, 32) };
    clips.iter().map(|clip| Arc::new(encoder.encode(clip).expect("latents"))).collect()
}

fn batches(items: usize) -> Vec<BatchConfig> {
    vec![BatchConfig { size: 32, frames: 5, items, weight: 0.6 }, BatchConfig { size: 32, frames: 1, items, weight: 0.4 }]
}

#[test]
fn an_autoencoder_learns_and_resumes() {
    let folder = tempfile::tempdir().expect("folder");
    let clips = [clip(5, SIZE)];
    let small = |mut config: Config| {
        config.batches = vec![
            BatchConfig { size: 16, frames: 1, items: 2, weight: 1.0 },
            BatchConfig { size: 8, frames: 5, items: 1, weight: 1.0 },
        ];
        config
    };
    resumes(folder.path(), autoencoder, &clips, small);

    let path = some_autoencoder(folder.path(), 150, &clips);
    let losses = losses(&folder.path().join("autoencoder"));
    let mean = |part: &[(u64, f32)]| part.iter().map(|(_, loss)| loss).sum::<f32>() / part.len() as f32;
    let [before, after] = [mean(&losses[..20]), mean(&losses[130..])];
    assert!(after < 0.8 * before, "{before} at first, {after} at last");

    // The statistics it was saved with make its latents standard.
    let (vae, provenance) = Vae::open(&path, &VaeConfig::wan(), &Device::flex()).expect("autoencoder");
    assert_eq!(provenance.steps, 150);
    assert!(vae.config().latents_std.iter().all(|s| *s > 0.0 && *s != 1.0), "{:?}", vae.config().latents_std);
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for clip in encoded(&vae, &clips, true) {
        for frame in 0..5 {
            for kind in Kind::ALL {
                let mut values = Vec::new();
                let window = renderflow_model::wan::train::clip_pictures::Window { top: 0, left: 0, height: 4, width: 4 };
                clip[0].read(frame, 1, kind, window, &mut values);
                sum += values.iter().sum::<f32>();
                squares += values.iter().map(|v| v * v).sum::<f32>();
                count += values.len() as f32;
            }
        }
    }
    let (mean, deviation) = (sum / count, (squares / count).sqrt());
    assert!(mean.abs() < 0.7 && (0.4..2.0).contains(&deviation), "mean {mean}, deviation {deviation}");
}

/// The checkpoint of a program that kept the options of the optimiser in an object of their own, and did not name its method.
#[test]
fn checkpoints_of_older_programs_are_resumed() {
    let folder = tempfile::tempdir().expect("folder");
    let clips = [clip(5, SIZE)];
    let settings = |name: &str| Config {
        batches: vec![BatchConfig { size: 16, frames: 1, items: 2, weight: 1.0 }],
        ..config(&folder.path().join(name), autoencoder(), 4)
    };
    let whole = train(&settings("whole"), &clips);
    interrupted(&settings("parts"), &clips, 2);
    edit_configuration(&folder.path().join("parts"), |config| {
        assert_eq!(config.remove("optimizer"), Some("adamw".into()));
        let names = ["learning_rate", "warmup_steps", "decay", "weight_decay", "clip_norm", "ema_decay"];
        let options = names.map(|name| (name.to_owned(), config.remove(name).expect(name)));
        config.insert("optimizer".into(), serde_json::Map::from_iter(options).into());
    });
    let parts = train(&settings("parts"), &clips);
    assert!(std::fs::read(whole.weights).expect("weights") == std::fs::read(parts.weights).expect("weights"));
    // Another method would read other moments.
    let muon = |settings: Config| Config { run: RunConfig { optimizer: Method::Muon, ..settings.run }, ..settings };
    let error = learn(&muon(settings("parts")), &clips).expect_err("another method");
    assert!(matches!(error, Error::Config { option: "optimizer", .. }), "{error}");
}

#[test]
fn every_stage_resumes() {
    let folder = tempfile::tempdir().expect("folder");
    let clips = [clip(5, SIZE), clip(6, SIZE)];
    let vae = some_autoencoder(folder.path(), 3, &clips);
    let small = |name: &str| {
        let latents = folder.path().join(name);
        move |config: Config| Config {
            batches: batches(2),
            latents_folder: Some(latents.clone()),
            // One clip at a time in memory.
            cache_mib: 0,
            rotate_steps: 1,
            ..config
        }
    };
    let first = folder.path().join("base");
    let with = |latents: LatentConfig| Stage::Base { network: Box::new(FlowConfig::tiny()), start: None, latents };
    resumes(&first, || with(decoded(&vae)), &clips, small("latents"));
    let base = first.join("whole/weights.safetensors");
    let recomputed = || LatentConfig { recompute: true, ..decoded(&vae) };
    resumes(&folder.path().join("keys"), || keyframes(&base, recomputed()), &clips, small("latents"));
    resumes(&folder.path().join("back"), || inverse(&base, recomputed()), &clips, small("others"));

    // Latents that were kept are those that are made.
    let fresh = Config { latents_folder: None, ..small("latents")(config(&folder.path().join("fresh"), with(decoded(&vae)), 4)) };
    assert!(std::fs::read(train(&fresh, &clips).weights).expect("weights") == std::fs::read(&base).expect("weights"));
    let kept = std::fs::read_dir(folder.path().join("latents")).expect("folder").map(|e| e.expect("file").path());
    let kept: Vec<PathBuf> = kept.collect();
    assert_eq!(kept.len(), 2, "{kept:?}");
    kept.iter().for_each(|path| std::fs::write(path, b"not latents").expect("written"));
    let broken = small("latents")(config(&folder.path().join("broken"), with(decoded(&vae)), 4));
    let error = learn(&broken, &clips).expect_err("broken latents");
    assert!(kept.iter().any(|path| error.to_string().contains(&path.display().to_string())), "{error}");
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let clips = [clip(5, SIZE)];
    let runs = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let folder = folder.path().join(threads.to_string());
        pool.install(|| {
            let vae = some_autoencoder(&folder, 2, &clips);
            let stage = Stage::Base { network: Box::new(FlowConfig::tiny()), start: None, latents: decoded(&vae) };
            let base = train(&Config { batches: batches(2), ..config(&folder.join("base"), stage, 3) }, &clips).weights;
            [vae, base].map(|path| std::fs::read(path).expect("weights"))
        })
    });
    assert!(runs[0][0] == runs[1][0], "the autoencoder differs");
    // The renderer's file names its sources, which are two folders: values are compared.
    let values = |threads: &str| {
        let flow = open(&folder.path().join(threads).join("base/weights.safetensors"));
        parameters::export(&flow).into_iter().map(|p| (p.name, p.values)).collect::<Vec<_>>()
    };
    assert!(values("1") == values("3"), "the renderer differs");
}

/// The renderer's prediction for fixed inputs, and the inverse adapter's nothing: bits.
fn prediction(flow: &Flow) -> Vec<u32> {
    let device = Device::flex();
    let waves = |shape: [usize; 5], seed: f32| {
        let values: Vec<f32> = (0..shape.iter().product()).map(|i| (i as f32 * 0.7391 + seed).sin()).collect();
        Tensor::<5>::from_data(TensorData::new(values, shape), &device)
    };
    let channels = flow.config().attribute_channels();
    let conditions = renderflow_model::wan::flow::Conditions {
        attributes: waves([1, channels, 2, 4, 4], 0.2),
        environment: waves([1, 4, 2, 4, 4], 0.3),
        keyframes: Vec::new(),
    };
    let velocity = flow.velocity(waves([1, 4, 2, 4, 4], 0.1), &[0.25], &conditions).expect("fits");
    to_vec(velocity).into_iter().map(f32::to_bits).collect()
}

#[test]
fn adapters_leave_the_renderer_as_it_is() {
    let folder = tempfile::tempdir().expect("folder");
    let clips = [clip(5, SIZE)];
    let vae = some_autoencoder(folder.path(), 3, &clips);
    let small = |name: &str, stage| Config { batches: batches(2), ..config(&folder.path().join(name), stage, 6) };
    let first = train(&small("base", base(&vae)), &clips).weights;
    let before = prediction(&open(&first));
    assert!(before != prediction(&Flow::new(open(&first).config(), 1, &Device::flex()).expect("network")), "it has learned");

    let keyed = train(&small("keys", keyframes(&first, latents(&vae))), &clips).weights;
    let flow = open(&keyed);
    assert!(flow.keyframes.is_some() && prediction(&flow) == before);
    let both = train(&small("back", inverse(&keyed, latents(&vae))), &clips).weights;
    let flow = open(&both);
    assert!(flow.inverse.is_some() && flow.keyframes.is_some() && prediction(&flow) == before);
    // What was to be learned has moved, every tensor of it; what was not has not.
    let values = |flow: &Flow| parameters::export(flow).into_iter().map(|p| (p.name, p.values)).collect::<Vec<_>>();
    let drawn = Flow::new(flow.config(), 1, &Device::flex()).expect("network");
    for ((name, trained), (_, start)) in values(&flow).into_iter().zip(values(&drawn)) {
        // Heads of intrinsics no batch asked for, and prompts in reserve, have nothing to learn from.
        let optional = name.contains("heads") || name.contains("prompt");
        assert!(trained != start || optional, "{name} did not move");
    }
    let keyed: Vec<_> = values(&open(&keyed)).into_iter().filter(|(name, _)| !name.starts_with("inverse")).collect();
    let both: Vec<_> = values(&flow).into_iter().filter(|(name, _)| !name.starts_with("inverse")).collect();
    assert!(keyed == both, "a frozen parameter has changed");
}

/// A renderer whose outputs are not zero, all of it learning.
fn lively(config: &FlowConfig, device: &Device) -> Flow {
    let flow = Flow::new(config, 3, device).expect("network");
    let values: Vec<Vec<f32>> = parameters::export(&flow)
        .into_iter()
        .map(|p| p.values.iter().enumerate().map(|(i, v)| v + 0.05 * (i as f32 * 0.7391 + 0.3).sin()).collect())
        .collect();
    parameters::import(flow, &values.iter().map(Vec::as_slice).collect::<Vec<_>>(), device)
}

#[test]
fn recomputed_gradients_are_the_plain_ones() {
    use renderflow_model::train::runner::Objective;
    use renderflow_model::wan::train::flow::FlowObjective;

    let device = Device::flex().autodiff();
    let network =
        FlowConfig { dit: renderflow_model::wan::DitConfig { layers: 3, ..FlowConfig::tiny().dit }, ..FlowConfig::tiny() }
            .with_keyframes(KeyframeConfig { lora_rank: 4, ..Default::default() })
            .with_inverse(InverseConfig { lora_rank: 4, ..Default::default() });
    let vae = Vae::new(&network.vae, 5, &device).expect("autoencoder").no_grad();
    let clips = encoded(&vae.valid(), &[clip(6, SIZE)], true);
    let settings = decoded(Path::new("unused"));
    let objective = |recompute| FlowObjective {
        vae: vae.clone(),
        pixels: settings.pixels,
        latent: 1.0,
        albedo_lpips: 0.0,
        lpips: None,
        recompute,
    };
    let flow = lively(&network, &device);
    for (task, group) in [
        (Task::Render { gap: None }, None),
        (Task::Render { gap: Some(4) }, Some(renderflow_model::wan::flow::Group::Keyframes)),
        (Task::Render { gap: Some(4) }, None),
        (Task::Invert, Some(renderflow_model::wan::flow::Group::Inverse)),
        (Task::Invert, None),
    ] {
        let flow = match group {
            Some(group) => flow.clone().learn_only(group),
            None => flow.clone(),
        };
        let sampler = BatchSampler { network: &network, latents: &settings, batches: &batches(2), task, share: Share::WHOLE };
        for step in 0..3 {
            let batch = sampler.draw(&clips, step, &mut step_rng(7, step)).expect("batch");
            let plain = objective(false).step(&flow, batch.clone(), &device).expect("gradients");
            let again = objective(true).step(&flow, batch, &device).expect("gradients");
            assert_eq!((plain.total, &plain.terms), (again.total, &again.terms));
            assert_eq!(plain.gradients.len(), again.gradients.len());
            let (mut worst, mut equal, mut count) = (0.0f32, 0, 0);
            let [plain, again] = [plain, again].map(|step| parameters::read_gradients(step.gradients).expect("values"));
            for (a, b) in plain.iter().zip(&again) {
                let zeros = |g: &Option<Vec<f32>>, n: usize| g.clone().unwrap_or_else(|| vec![0.0; n]);
                let n = a.as_ref().or(b.as_ref()).map_or(0, Vec::len);
                let (a, b) = (zeros(a, n), zeros(b, n));
                let scale = a.iter().fold(1e-12f32, |m, v| m.max(v.abs()));
                worst = a.iter().zip(&b).fold(worst, |m, (a, b)| m.max((a - b).abs() / scale));
                equal += usize::from(a == b);
                count += 1;
            }
            println!("{task:?} {group:?} step {step}: {equal} of {count} tensors to the bit, largest difference {worst:.1e}");
            assert!(worst <= 1e-5, "{worst}");
            assert!(plain.iter().flatten().any(|g| g.iter().any(|v| *v != 0.0)));
        }
    }
}

#[test]
fn batches_depend_on_seed_and_step_only() {
    let network = FlowConfig::tiny();
    let vae = Vae::new(&network.vae, 5, &Device::flex()).expect("autoencoder");
    let clips = encoded(&vae, &[clip(6, SIZE), clip(9, SIZE)], true);
    let table = [0.5, 0.0, 0.25, 0.25];
    let settings =
        LatentConfig { bridge: Bridge { times: Times::Four(table), ..Bridge::default() }, ..decoded(Path::new("unused")) };
    let kinds = batches(3);
    let sampler = BatchSampler {
        network: &network,
        latents: &settings,
        batches: &kinds,
        task: Task::Render { gap: Some(4) },
        share: Share::WHOLE,
    };
    let draw = |seed, step| sampler.draw(&clips, step, &mut step_rng(seed, step)).expect("batch");
    let all: Vec<LatentBatch> = (0..60).map(|step| draw(1, step)).collect();
    // In another order, and by other threads.
    for (step, batch) in all.iter().enumerate().rev() {
        assert!(&draw(1, step as u64) == batch, "step {step}");
    }
    assert!(all.windows(2).all(|pair| pair[0] != pair[1]) && draw(2, 0) != all[0]);
    let times: Vec<f32> = all.iter().flat_map(|batch| batch.times.clone()).collect();
    assert!(times.contains(&0.0) && times.contains(&0.5) && times.contains(&0.75) && !times.contains(&0.25), "{times:?}");
    assert!(all.iter().any(|batch| batch.shape[2] == 2) && all.iter().any(|batch| batch.shape[2] == 1));
    for (step, batch) in all.iter().enumerate() {
        assert_eq!(batch.truth.is_some(), step % 2 == 0);
        let [items, z, f, h, w] = batch.shape;
        assert_eq!(batch.attributes.len(), items * network.attribute_channels() * f * h * w);
        assert!(!batch.keyframes.is_empty());
        for (latent, time) in &batch.keyframes {
            assert_eq!(latent.len(), items * z * h * w);
            assert!((-0.75..=1.0).contains(time), "{time}");
        }
        let [state, velocity] = [&batch.z_t, &batch.velocity];
        assert!(state.iter().chain(velocity).chain(&batch.attributes).all(|v| v.is_finite()));
    }
    // The network's answer leads to the truth: at any time, z_t + (1 - t) v is the latent of the picture.
    let batch = &all[0];
    let truth = to_vec(vae.encode_normalised(Tensor::zeros([1, 3, 1, 8, 8], &Device::flex())).expect("grey"));
    assert_eq!(truth.len(), 4);
    let item = batch.z_t.len() / batch.shape[0];
    let ends: Vec<f32> = (0..batch.z_t.len()).map(|i| batch.z_t[i] + (1.0 - batch.times[i / item]) * batch.velocity[i]).collect();
    let straight = LatentConfig { bridge: Bridge { sigma: 0.0, ..settings.bridge }, ..settings.clone() };
    let same = BatchSampler { latents: &straight, ..sampler }.draw(&clips, 0, &mut step_rng(1, 0)).expect("batch");
    let ends_without_noise: Vec<f32> =
        (0..same.z_t.len()).map(|i| same.z_t[i] + (1.0 - same.times[i / item]) * same.velocity[i]).collect();
    let difference = ends.iter().zip(&ends_without_noise).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    assert!(difference < 1e-5, "{difference}");
}

#[test]
fn unusable_settings_and_data_are_named() {
    let folder = tempfile::tempdir().expect("folder");
    let clips = [clip(2, SIZE)];
    let vae = some_autoencoder(folder.path(), 1, &clips);
    let fails = |config: &Config, clips: &[Clip]| learn(config, clips).expect_err("not usable").to_string();
    let good = config(&folder.path().join("runs"), base(&vae), 1);
    let kinds = |size, frames| vec![BatchConfig { size, frames, items: 1, weight: 1.0 }];
    for (option, config) in [
        ("batches.size", Config { batches: kinds(40, 1), ..good.clone() }),
        ("batches.frames", Config { batches: kinds(32, 3), ..good.clone() }),
        ("batches", Config { batches: Vec::new(), ..good.clone() }),
        ("steps", Config { run: RunConfig { steps: 0, ..good.run.clone() }, ..good.clone() }),
        ("stage.latents.autoencoder", Config { stage: base(Path::new("")), ..good.clone() }),
        (
            "bridge.sigma",
            Config {
                stage: Stage::Base {
                    network: Box::new(FlowConfig::tiny()),
                    start: None,
                    latents: LatentConfig { bridge: Bridge { sigma: -1.0, ..Bridge::default() }, ..latents(&vae) },
                },
                ..good.clone()
            },
        ),
        (
            "stage.network",
            Config {
                stage: Stage::Base {
                    network: Box::new(FlowConfig::tiny().with_keyframes(KeyframeConfig::default())),
                    start: None,
                    latents: latents(&vae),
                },
                ..good.clone()
            },
        ),
    ] {
        let error = fails(&config, &clips);
        assert!(error.starts_with(&format!("{option}: ")), "{option}: {error}");
    }
    let error = fails(&good, &[clip(3, SIZE)]);
    assert!(error.contains("no 5 frames in a row"), "{error}");
    let error = fails(&Config { batches: kinds(96, 1), ..good.clone() }, &clips);
    assert!(error.contains("analytic: frames of 64x64 are smaller than the 96 pixels of a batch"), "{error}");
    let missing = Config { stage: base(&folder.path().join("nothing.safetensors")), ..good.clone() };
    assert!(fails(&missing, &clips).contains("nothing.safetensors: cannot read"));
    let error = fails(&Config { stage: keyframes(&vae, latents(&vae)), ..good.clone() }, &clips);
    assert!(error.contains("holds another network than the renderer"), "{error}");
    let still = Config { batches: kinds(32, 1), ..good };
    train(&still, &clips);
    let other = Config { run: RunConfig { seed: 9, ..still.run.clone() }, ..still };
    let error = learn(&other, &clips).expect_err("another seed");
    assert!(matches!(error, Error::Config { option: "seed", .. }), "{error}");
}

/// PSNR of two batches of latents as decoded pictures.
fn psnr(vae: &Vae, a: Tensor<5>, b: Tensor<5>) -> f32 {
    let pictures = |z| to_vec(vae.decode_normalised(z).expect("pictures"));
    decibels(&pictures(a), &pictures(b))
}

/// PSNR of values of -1..=1.
fn decibels(a: &[f32], b: &[f32]) -> f32 {
    let square = a.iter().zip(b).map(|(a, b)| f64::from((a - b) / 2.0).powi(2)).sum::<f64>() / a.len() as f64;
    (-10.0 * square.max(1e-12).log10()) as f32
}

/// PSNR, dB, of `wan-tiny` on one clip of five frames: the albedo, the first prediction and that after training beside the
/// autoencoder's own round trip of the truth; the last beside the truth itself.
fn learn_one_clip(folder: &Path, clip: &Clip, vae: &Path, steps: u64) -> [f32; 4] {
    let clips = [clip.clone()];
    let pictures = Vae::open(vae, &VaeConfig::tiny(), &Device::flex()).expect("autoencoder").0.config().clone();
    let z = pictures.z_dim;
    let mut network = FlowConfig { vae: pictures, ..FlowConfig::tiny() };
    (network.dit.in_channels, network.dit.out_channels) = (z, z);
    let stage = || Stage::Base {
        network: Box::new(network.clone()),
        start: None,
        latents: LatentConfig { reference_probability: 0.0, ..latents(vae) },
    };
    let score = |path: &Path| {
        let (vae, _) = Vae::open(vae, &VaeConfig::tiny(), &Device::flex()).expect("autoencoder");
        let encoder = Encoder { stills: false, references: false, ..encoder(&vae, SIZE) };
        let latents = vec![Arc::new(encoder.encode(&clips[0]).expect("latents"))];
        let start = LatentConfig {
            bridge: Bridge { sigma: 0.0, times: Times::Four([1.0, 0.0, 0.0, 0.0]) },
            pixels: PixelLoss { weight: 0.0, ..PixelLoss::default() },
            reference_probability: 0.0,
            ..LatentConfig::default()
        };
        let flow = open(path);
        let kinds = [BatchConfig { size: SIZE, frames: 5, items: 1, weight: 1.0 }];
        let sampler = BatchSampler {
            network: flow.config(),
            latents: &start,
            batches: &kinds,
            task: Task::Render { gap: None },
            share: Share::WHOLE,
        };
        let batch = sampler.draw(&latents, 0, &mut step_rng(0, 0)).expect("batch");
        let tensor = |values: &[f32], channels: usize| {
            let [b, _, f, h, w] = batch.shape;
            Tensor::<5>::from_data(TensorData::new(values.to_vec(), [b, channels, f, h, w]), &Device::flex())
        };
        let conditions = renderflow_model::wan::flow::Conditions {
            attributes: tensor(&batch.attributes, flow.config().attribute_channels()),
            environment: tensor(&batch.environment, z),
            keyframes: Vec::new(),
        };
        let albedo = tensor(&batch.z_t, z);
        let truth = albedo.clone() + tensor(&batch.velocity, z);
        let velocity = flow.velocity(albedo.clone(), &[0.0], &conditions).expect("fits");
        let made = albedo.clone() + velocity;
        let shown = to_vec(vae.decode_normalised(made.clone()).expect("pictures"));
        let pictures = renderflow_model::wan::train::clip_pictures::ClipPictures::new(clip, None, SIZE, 16).expect("pictures");
        let pictures = pictures.clip(0, 5, Kind::Target, pictures.whole());
        [psnr(&vae, albedo, truth.clone()), psnr(&vae, made, truth), decibels(&shown, &pictures)]
    };
    let [albedo, early, _] = score(&train(&config(&folder.join("early"), stage(), 1), &clips).weights);
    let settings = config(&folder.join("base"), stage(), steps);
    let settings = Config { run: RunConfig { log_steps: 100, ..settings.run.clone() }, ..settings };
    let [_, late, seen] = score(&train(&settings, &clips).weights);
    println!("albedo {albedo:.1} dB, after one step {early:.1} dB, after {steps} {late:.1} dB; {seen:.1} dB from the truth");
    assert!(late > albedo.max(early) + 20.0, "little learned: {albedo}, {early} and {late} dB");
    [albedo, early, late, seen]
}

#[test]
fn one_clip_is_learned_to_35_db() {
    let folder = tempfile::tempdir().expect("folder");
    let clip = clip(5, SIZE);
    let vae = some_autoencoder(folder.path(), 300, std::slice::from_ref(&clip));
    let [.., late, _] = learn_one_clip(folder.path(), &clip, &vae, 1200);
    assert!(late > 35.0, "{late} dB");
}
