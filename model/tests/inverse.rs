//! The inverse network: it learns, a run that was stopped resumes exactly, and buffers are finite for any picture.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use half::f16;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use renderflow_frame::image::Rgb;
use renderflow_model::device::NetworkDevice;
use renderflow_model::fusion::Record;
use renderflow_model::fusion::record::at;
use renderflow_model::fusion::training::Source;
use renderflow_model::inverse::batch::{Augmentation, Batch};
use renderflow_model::inverse::example::Example;
use renderflow_model::inverse::find::LONGEST;
use renderflow_model::inverse::training::{self, Config, InverseObjective, validate};
use renderflow_model::inverse::{Inverse, InverseConfig, InverseNet};
use renderflow_model::ops::Products;
use renderflow_model::parameters;
use renderflow_model::train::runner::{Objective, Progress, RunContext, Summary, Validation};
use renderflow_model::train::sequences::Crop;
use renderflow_model::train::{RunConfig, Team};
use renderflow_model::weights::Precision;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

const SMALL: [usize; 6] = [16; 6];

/// Frames of a bowl whose blue and yellow tiles are lit from the left.
struct Toy;

fn toy(seed: u64) -> Record<f32> {
    let (width, height) = (96, 80);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut record = Record::new(width, height);
    let (side, light) = (rng.random_range(6..14), rng.random_range(0.6..1.0));
    for i in 0..width * height {
        let out = &mut record.pixels[i * at::COUNT..][..at::COUNT];
        let (x, y) = (i % width, i / width);
        out[at::ALPHA] = if y < 8 { 0.0 } else { 1.0 };
        let even = (x / side + y / side).is_multiple_of(2);
        let albedo = if even { [0.2, 0.3, 0.7] } else { [0.7, 0.6, 0.1] };
        let v = glam::Vec3::new(0.6 - 1.2 * x as f32 / width as f32, 0.3, 0.7).normalize();
        for c in 0..3 {
            out[at::ALBEDO + c] = albedo[c];
            out[at::NORMAL + c] = v[c];
            out[at::TRUTH + c] = albedo[c] * light * (0.5 + 0.5 * v.x);
        }
        out[at::DEPTH] = 0.5 - y as f32 / height as f32;
        out[at::MATERIAL] = if even { 0.2 } else { 0.8 };
        out[at::MATERIAL + 1] = if even { 0.0 } else { 1.0 };
        out[at::MATERIAL + 2] = 0.5;
    }
    record
}

impl Source for Toy {
    fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        Ok(vec![toy(2 * i).to_half(), toy(2 * i + 1).to_half()])
    }

    fn identity(&self) -> String {
        "toy".into()
    }
}

fn config(output: &Path, steps: u64) -> Config {
    Config {
        network: InverseConfig { widths: SMALL },
        run: RunConfig {
            output: output.into(),
            steps,
            learning_rate: 3e-3,
            warmup_steps: 5,
            ema_decay: 0.9,
            checkpoint_steps: 1000,
            log_steps: 1,
            ..Config::default().run
        },
        crops: vec![Crop { size: 64, batch: 2, from: 0.0 }],
        first: 4,
        rotate_steps: 5,
        window: 6,
        ..Config::default()
    }
}

/// Trains, and stops after the step `stop`.
fn learn(config: &Config, validation: &[Example], stop: u64) -> Summary {
    let cancel = AtomicBool::new(false);
    let progress = |progress: &Progress| {
        if let Progress::Step(record) = progress
            && record.step >= stop
        {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    let context = RunContext { device: &NetworkDevice::cpu(), progress: &progress, cancel: &cancel, team: &Team::alone() };
    training::run(config, &Toy, None, validation, context).unwrap()
}

#[test]
fn every_buffer_is_learned() {
    let folder = tempfile::tempdir().unwrap();
    let held_out = [toy(1000), toy(1001)].map(|record| Example::of(&record.to_half()));
    let config = config(folder.path(), 500);
    let before = validate(&Inverse::untrained(&config.network, 1).unwrap(), &held_out).unwrap();
    let summary = learn(&config, &held_out, u64::MAX);
    assert!(summary.finished && summary.steps == 500);
    let after = validate(&Inverse::load(&summary.weights).unwrap(), &held_out).unwrap();
    assert!(after.psnr["albedo"] > before.psnr["albedo"] + 3.0, "{before:?} {after:?}");
    assert_eq!(after.others.len(), 4);
    for (name, error) in &after.others {
        assert!(*error < 0.7 * before.others[name], "{name}: {} before, {error} after", before.others[name]);
    }
    // Each validation is a line.
    let lines = std::fs::read_to_string(folder.path().join("validation.jsonl")).unwrap();
    let last: Validation = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
    assert_eq!((last.step, last.others.len()), (500, 4));
}

/// An untrained network says that all surfaces face the camera.
#[test]
fn a_normal_that_is_not_known_is_no_right_one() {
    let network = Inverse::untrained(&InverseConfig { widths: SMALL }, 1).unwrap();
    let angle = |known: fn(usize) -> bool| {
        let mut record = toy(3);
        for (i, pixel) in record.pixels.chunks_exact_mut(at::COUNT).enumerate() {
            let normal = if known(i) { [0.6, 0.0, 0.8] } else { [0.0; 3] };
            pixel[at::NORMAL..at::NORMAL + 3].copy_from_slice(&normal);
        }
        validate(&network, &[Example::of(&record.to_half())]).unwrap().others["normals, degrees"]
    };
    let expected = 0.8_f32.acos().to_degrees();
    for angle in [angle(|_| true), angle(|i| i % 2 == 0)] {
        assert!((angle - expected).abs() < 0.1, "{angle} and not {expected}");
    }
    assert_eq!(angle(|_| false), 0.0);
}

/// A run that was stopped resumes to the same bytes, although the sequences in its window are made again.
#[test]
fn stopped_runs_resume_exactly() {
    let weights = |stops: &[u64]| {
        let folder = tempfile::tempdir().unwrap();
        let config = config(folder.path(), 20);
        for stop in stops.iter().copied().chain([u64::MAX]) {
            let summary = learn(&config, &[], stop);
            assert_eq!(summary.finished, stop == u64::MAX);
        }
        std::fs::read(folder.path().join("weights.safetensors")).unwrap()
    };
    let whole = weights(&[]);
    assert!(whole == weights(&[7]));
    assert!(whole == weights(&[3, 14]));
}

/// A network of random weights, also in the last layer, which is 0 in an untrained one.
fn random() -> Inverse {
    let untrained = Inverse::untrained(&InverseConfig { widths: SMALL }, 7).unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let mut parameters = untrained.parameters();
    for parameter in &mut parameters {
        parameter.values.iter_mut().for_each(|v| *v += rng.random_range(-0.1..0.1));
    }
    Inverse::with_parameters(untrained.header().clone(), &parameters).unwrap()
}

/// The derivative of the loss along a random direction in the space of all weights, against the difference of two losses.
#[test]
fn gradients_agree_with_differences() {
    let device = Device::flex().autodiff();
    let objective = InverseObjective { products: Products::F32, ..InverseObjective::default() };
    let network = random();
    let examples = [Example::of(&toy(3).to_half()), Example::of(&toy(4).to_half())];
    let batch = || {
        let parts = examples.each_ref().map(|example| Batch::of(example, [16, 8], [64, 64], &Augmentation::NONE));
        let mut batch = Batch { items: 2, width: 64, height: 64, ..Batch::default() };
        for part in parts {
            batch.input.extend(part.input);
            batch.display.extend(part.display);
            batch.targets.extend(part.targets);
        }
        batch
    };
    let values: Vec<Vec<f32>> = network.parameters().into_iter().map(|parameter| parameter.values).collect();
    let model = |values: &[Vec<f32>]| {
        let model = InverseNet::new(&network.header().inverse, 0, &device).unwrap();
        parameters::import(model, &values.iter().map(Vec::as_slice).collect::<Vec<_>>(), &device)
    };
    let found = parameters::read_gradients(objective.step(&model(&values), batch(), &device).unwrap().gradients).unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    for _ in 0..4 {
        let along: Vec<Vec<f32>> =
            values.iter().map(|values| values.iter().map(|_| rng.random_range(-1.0..1.0)).collect()).collect();
        let slope: f64 = along
            .iter()
            .zip(&found)
            .flat_map(|(along, gradient)| along.iter().zip(gradient.as_ref().expect("every parameter has a part")))
            .map(|(a, b)| f64::from(a * b))
            .sum();
        let at = |step: f32| {
            let moved: Vec<Vec<f32>> =
                values.iter().zip(&along).map(|(v, a)| v.iter().zip(a).map(|(v, a)| v + step * a).collect()).collect();
            f64::from(objective.step(&model(&moved), batch(), &device).unwrap().total)
        };
        let step = 5e-4;
        let expected = (at(step) - at(-step)) / f64::from(2.0 * step);
        assert!((slope - expected).abs() < 0.02 * slope.abs().max(0.1), "{slope} and {expected}");
    }
}

#[test]
fn any_picture_gives_finite_buffers() {
    let network = random();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -5.0, 1e30, 0.0, 1.0, 1e-40] {
        for (width, height) in [(24, 18), (1, 1), (3, 40), (130, 2)] {
            for mixed in [[value; 3], [value, 0.5, 0.5]] {
                let found = network.find(&Rgb::filled(width, height, mixed)).unwrap();
                let within = |picture: &Rgb| picture.pixels.iter().flatten().all(|v| (0.0..=1.0).contains(v));
                assert!(within(&found.albedo) && within(&found.material), "{mixed:?} at {width} x {height}");
                assert!(found.depth.pixels.len() == width * height && found.depth.pixels.iter().all(|v| v.is_finite()));
                assert!(found.normal.pixels.iter().flatten().all(|v| v.is_finite() && v.abs() <= 1.0));
            }
        }
    }
    assert!(network.find(&Rgb { width: 0, height: 5, pixels: Vec::new() }).is_err());
}

/// A picture that is read at half its size: what the network says about it is interpolated, and applied to all of its pixels.
#[test]
fn large_pictures_are_read_reduced() {
    let network = random();
    let [width, height] = [LONGEST, LONGEST / 4];
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    let small = Rgb::from_fn(width, height, |_, _| [(); 3].map(|()| rng.random_range(0.0..1.0)));
    // Every pixel four times, so that the mean of four is what the smaller picture has.
    let large = Rgb::from_fn(2 * width, 2 * height, |x, y| *small.at(x / 2, y / 2));
    let (found, alone) = (network.find(&large).unwrap(), network.find(&small).unwrap());
    assert_eq!((found.albedo.width, found.depth.height), (2 * width, 2 * height));
    for y in 1..height {
        for x in 1..width {
            let near = |dx: usize, dy: usize| *alone.depth.at(x - dx, y - dy);
            let expected = (9.0 * near(0, 0) + 3.0 * (near(1, 0) + near(0, 1)) + near(1, 1)) / 16.0;
            let found = *found.depth.at(2 * x, 2 * y);
            assert!((found - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{x} {y}: {found} and {expected}");
        }
    }
    // The albedo keeps what the network did not read. Without training it is `sigmoid(logit(v))`, whose margins are .02.
    let untrained = Inverse::untrained(&InverseConfig { widths: SMALL }, 7).unwrap();
    let fine = Rgb::from_fn(2 * LONGEST, 40, |x, y| if (x + y) % 2 == 0 { [0.2, 0.5, 0.7] } else { [0.6, 0.3, 0.0] });
    let found = untrained.find(&fine).unwrap().albedo;
    for (found, shown) in found.pixels.iter().flatten().zip(fine.pixels.iter().flatten()) {
        assert!((found - (shown + 0.02) / 1.04).abs() < 1e-5, "{found} where the picture has {shown}");
    }
}

#[test]
fn threads_do_not_show() {
    let network = random();
    let picture = Rgb::from_fn(150, 70, |x, y| [(x % 7) as f32 / 7.0, (y % 5) as f32 / 5.0, 0.3]);
    let find = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| network.find(&picture).unwrap())
    };
    let one = find(1);
    assert!(one == find(2) && one == find(5));
}

#[test]
fn weights_files_come_back_and_hostile_ones_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let network = random();
    let write = |precision| network.save(&path, precision).unwrap();
    write(Precision::F32);
    assert!(Inverse::recognises(&path) && !renderflow_model::fusion::Fusion::recognises(&path));
    let picture = Rgb::from_fn(64, 64, |x, y| [x as f32 / 64.0, y as f32 / 64.0, 0.3]);
    assert!(Inverse::load(&path).unwrap().find(&picture).unwrap() == network.find(&picture).unwrap());
    write(Precision::F16);
    let (half, whole) = (Inverse::load(&path).unwrap().find(&picture).unwrap(), network.find(&picture).unwrap());
    let worst = half.albedo.pixels.iter().flatten().zip(whole.albedo.pixels.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(worst.fold(0.0, f32::max) < 0.02);

    // A header that asks for more than the file has is refused before anything is made.
    let bytes = std::fs::read(&path).unwrap();
    let widths = b"[16,16,16,16,16,16]";
    let at = bytes.windows(widths.len()).position(|part| part == widths).expect("the widths stand in the header");
    let mut larger = bytes.clone();
    larger[at..at + 19].copy_from_slice(b"[96,96,96,96,96,96]");
    std::fs::write(&path, &larger).unwrap();
    let error = Inverse::load(&path).unwrap_err().to_string();
    assert!(error.contains("values"), "{error}");
    for length in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(Inverse::load(&path).is_err(), "{length} bytes");
    }
    assert!(!Inverse::recognises(&folder.path().join("nothing")));
}

#[test]
fn the_number_of_values_is_that_of_the_parameters() {
    for config in [InverseConfig::default(), InverseConfig { widths: [16, 32, 48, 64, 80, 96] }] {
        let network = InverseNet::new(&config, 1, &Device::flex()).unwrap();
        assert_eq!(network.num_params(), config.values());
        let input = Tensor::from_data(TensorData::new(vec![0.3_f32; 32 * 32 * 20], [1, 32, 32, 20]), &Device::flex());
        assert_eq!(network.forward(Products::F32, input).dims(), [1, 32, 32, 44]);
    }
}
