//! The fusion network: it learns, a run that was stopped resumes exactly, and pictures are finite for any input.

mod common;

use common::checkpoint::edit_configuration;
use half::f16;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use renderflow_frame::ibl;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::terms::ShadingTerms;
use renderflow_frame::tracks::Movement;
use renderflow_frame::warp::{Keyframe, Neighbour};
use renderflow_frame::{Camera, Environment, Frame, Light};
use renderflow_model::device::NetworkDevice;
use renderflow_model::fusion::batch::TIERS;
use renderflow_model::fusion::fill::{Nearby, Paths, Samples};
use renderflow_model::fusion::record::{KEYS, NEIGHBOURS, PARTS, PATHS, PixelInputs, Selection, at, tint};
use renderflow_model::fusion::render::Header;
use renderflow_model::fusion::training::{self, Config, Crop, Source, validate};
use renderflow_model::fusion::{Fusion, FusionConfig, Record};
use renderflow_model::kernels;
use renderflow_model::ops::Products;
use renderflow_model::parameters::Parameter;
use renderflow_model::train::runner::{Progress, RunContext, Summary, Validation};
use renderflow_model::train::{RunConfig, Team};
use renderflow_model::weights::Precision;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

const SMALL: [usize; 4] = [16, 16, 16, 16];

/// Frames whose truth is known: samples scatter about it, deferred shading is too dark, keyframes are too bright.
struct Toy;

fn toy(seed: u64) -> Record<f32> {
    let (width, height) = (64, 48);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut record = Record::new(width, height);
    let wave: f32 = rng.random_range(0.05..0.2);
    for i in 0..width * height {
        let out = &mut record.pixels[i * at::COUNT..][..at::COUNT];
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        out[at::ALPHA] = if y < 4.0 { 0.0 } else { 1.0 };
        for c in 0..3 {
            let albedo = if (x as usize / 8 + y as usize / 8).is_multiple_of(2) { 0.7 } else { 0.3 };
            let light = 0.5 + 0.3 * (wave * (x + y)).sin() + 0.05 * c as f32;
            let truth = light * tint([albedo; 3], out)[c];
            (out[at::ALBEDO + c], out[at::TRUTH + c]) = (albedo, truth);
            out[at::RAW_TRUTH + c] = truth;
            (out[at::NORMAL + c], out[at::BACKGROUND + c]) = (0.57, 0.2);
            out[at::TERMS + c] = 0.6 * truth;
            for k in 0..KEYS {
                out[at::KEYS + 4 * k + c] = 1.2 * truth;
            }
            for part in 0..PARTS {
                out[at::SAMPLES + 4 * part + c] = light * rng.random_range(0.2..1.8);
                (0..3).for_each(|k| out[at::PATHS + PATHS * part + 3 * k + c] = light * [0.3, 0.1, 0.5][k]);
            }
            for n in 0..NEIGHBOURS {
                out[at::NEARBY + 4 * n + c] = light * rng.random_range(0.2..1.8);
                out[at::NEARBY_INDIRECT + 3 * n + c] = 0.3 * light;
            }
        }
        for from in [at::KEYS, at::SAMPLES, at::NEARBY] {
            (0..4).for_each(|k| out[from + 4 * k % 8 + 3] = 1.0);
        }
        for k in 0..PARTS {
            out[at::SAMPLES + 4 * k + 3] = 1.0;
            out[at::NEARBY + 4 * k + 3] = 1.0;
        }
    }
    record.deferred = true;
    record.distances = [Some(-4.0), Some(12.0)];
    record.parts = [1; PARTS];
    record.neighbours = [2; NEIGHBOURS];
    record.paths = true;
    record
}

impl Source for Toy {
    fn make(&self, i: u64) -> renderflow_model::Result<Vec<Record<f16>>> {
        Ok(vec![toy(i).to_half()])
    }

    fn identity(&self) -> String {
        "toy".into()
    }
}

fn config(output: &Path, steps: u64) -> Config {
    Config {
        network: FusionConfig { widths: SMALL, ..FusionConfig::default() },
        run: RunConfig {
            output: output.into(),
            steps,
            learning_rate: 2e-3,
            warmup_steps: 5,
            ema_decay: 0.9,
            checkpoint_steps: 1000,
            log_steps: 1,
            ..Config::default().run
        },
        crops: vec![Crop { size: 32, batch: 2, from: 0.0 }],
        first: 4,
        rotate_steps: 5,
        window: 6,
        ..Config::default()
    }
}

/// Trains on a device, and stops after the step `stop`.
fn learn(config: &Config, validation: &[Record<f16>], device: &NetworkDevice, stop: u64) -> Summary {
    learn_from(config, None, validation, device, stop)
}

/// As [`learn`], beginning with the weights `start`.
fn learn_from(config: &Config, start: Option<&Fusion>, validation: &[Record<f16>], device: &NetworkDevice, stop: u64) -> Summary {
    let cancel = AtomicBool::new(false);
    let progress = |progress: &Progress| {
        if let Progress::Step(record) = progress
            && record.step >= stop
        {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    training::run(
        config,
        &Toy,
        start,
        validation,
        RunContext { device, progress: &progress, cancel: &cancel, team: &Team::alone() },
    )
    .unwrap()
}

#[test]
fn every_tier_learns() {
    let folder = tempfile::tempdir().unwrap();
    let held_out = [toy(1000).to_half(), toy(1001).to_half()];
    let config = Config { tiers: TIERS.map(|tier| tier.name.to_owned()).into(), ..config(folder.path(), 150) };
    let before = validate(&Fusion::untrained(&config.network, 1).unwrap(), &held_out, &TIERS).unwrap();
    let summary = learn(&config, &held_out, &NetworkDevice::cpu(), u64::MAX);
    assert!(summary.finished && summary.steps == 150);
    let after = validate(&Fusion::load(&summary.weights).unwrap(), &held_out, &TIERS).unwrap();
    assert_eq!(before.len(), after.len());
    // The inputs of other tiers are not validated.
    let first = validate(&Fusion::load(&summary.weights).unwrap(), &held_out, &TIERS[..1]).unwrap();
    assert_eq!(first.into_iter().collect::<Vec<_>>(), [(TIERS[0].name.to_owned(), after[TIERS[0].name])]);
    for (name, psnr) in &after {
        let gain = psnr - before[name];
        assert!(gain > 0.5, "{name}: {} before, {psnr} after", before[name]);
    }
    // Each validation is a line.
    let lines = std::fs::read_to_string(folder.path().join("validation.jsonl")).unwrap();
    let last: Validation = serde_json::from_str(lines.lines().last().unwrap()).unwrap();
    assert_eq!((last.step, last.psnr.len()), (150, after.len()));
}

/// A run that was stopped resumes to the same bytes, although the sequences in its window are made again.
#[test]
fn stopped_runs_resume_exactly() {
    let weights = |stops: &[u64], older: bool| {
        let folder = tempfile::tempdir().unwrap();
        let config = config(folder.path(), 24);
        for stop in stops.iter().copied().chain([u64::MAX]) {
            let summary = learn(&config, &[], &NetworkDevice::cpu(), stop);
            assert_eq!(summary.finished, stop == u64::MAX);
            if older && !summary.finished {
                edit_configuration(folder.path(), |config| assert_eq!(config.remove("decay"), Some("cosine".into())));
            }
        }
        std::fs::read(folder.path().join("weights.safetensors")).unwrap()
    };
    let whole = weights(&[], false);
    assert!(whole == weights(&[9], false));
    assert!(whole == weights(&[3, 17], false));
    // The checkpoint of a program that had one decay and did not name it.
    assert!(whole == weights(&[9], true));
}

/// A device other than the processor: OpenGL, which is software where there is no GPU.
#[cfg(feature = "vulkan")]
fn other_device() -> Option<NetworkDevice> {
    let opened = NetworkDevice::open("opengl".parse().expect("a choice"));
    opened.inspect_err(|error| println!("skipped: {error}")).ok()
}

/// Largest difference of two lists.
#[cfg(feature = "vulkan")]
fn apart(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[cfg(feature = "vulkan")]
#[test]
fn other_devices_render_the_same_picture() {
    let Some(device) = other_device() else { return };
    let record = toy(5);
    let fusion = Fusion::shipped().unwrap().with_products(Products::F32);
    let expected = fusion.render(&record).unwrap();
    let found = fusion.to(&device).unwrap().render(&record).unwrap();
    let difference = apart(found.as_flattened(), expected.as_flattened());
    println!("{device}: pictures differ by {difference}");
    assert!(difference < 1e-4, "{difference}");
}

/// A run that is stopped on one device goes on with another.
#[cfg(feature = "vulkan")]
#[test]
fn checkpoints_move_between_devices() {
    let Some(device) = other_device() else { return };
    let cpu = NetworkDevice::cpu();
    let weights = |stretches: &[(&NetworkDevice, u64)]| {
        let folder = tempfile::tempdir().unwrap();
        let config = Config { products: Products::F32, ..config(folder.path(), 6) };
        let mut last = None;
        for (device, stop) in stretches {
            let summary = learn(&config, &[], device, *stop);
            assert_eq!(summary.finished, *stop == u64::MAX);
            last = summary.last;
        }
        let weights = Fusion::load(&folder.path().join("weights.safetensors")).unwrap();
        let values: Vec<f32> = weights.parameters().into_iter().flat_map(|parameter| parameter.values).collect();
        (values, last.unwrap().loss)
    };
    let (expected, loss) = weights(&[(&cpu, u64::MAX)]);
    let (moved, other) = weights(&[(&cpu, 2), (&device, 4), (&cpu, u64::MAX)]);
    let (whole, third) = weights(&[(&device, u64::MAX)]);
    let differences = [apart(&moved, &expected), apart(&whole, &expected)];
    println!("{device}: weights differ by {differences:?}, losses are {loss}, {other} and {third}");
    // Weights are stored in half precision: they are at most 1, where its steps are 2^-11.
    assert!(differences.iter().all(|difference| *difference < 2e-3), "{differences:?}");
    assert!((loss - other).abs() < 1e-3 * loss && (loss - third).abs() < 1e-3 * loss, "{loss}, {other}, {third}");
}

/// A frame of a plane that fills its lower half.
fn frame(camera: &Camera) -> Frame {
    let (width, height) = (camera.width, camera.height);
    let covered = |y: usize| 2 * y >= height;
    let rgb = |inside: [f32; 3]| Rgb::from_fn(width, height, |_, y| if covered(y) { inside } else { [0.0; 3] });
    let mut frame = Frame {
        width,
        height,
        alpha: Image::from_fn(width, height, |_, y| f32::from(u8::from(covered(y)))),
        albedo: rgb([0.6, 0.4, 0.3]),
        normal: rgb([0.0, 1.0, 0.0]),
        depth: Image::from_fn(width, height, |_, y| if covered(y) { 2.0 } else { f32::INFINITY }),
        material: rgb([0.4, 0.0, 0.5]),
        object_id: Image::from_fn(width, height, |_, y| u32::from(covered(y))),
        material_id: Image::filled(width, height, 1),
        guide_albedo: Some(rgb([0.6, 0.4, 0.3])),
        guide_normal: Some(rgb([0.0, 1.0, 0.0])),
        ..Frame::default()
    };
    frame.info.camera = *camera;
    frame
}

fn camera(width: usize, height: usize) -> Camera {
    Camera::look_at(glam::Vec3A::new(0.0, 1.0, 3.0), glam::Vec3A::ZERO, glam::Vec3A::Y, 0.8, width, height)
}

/// A record with everything of a frame whose samples and truth are `value`.
fn filled(width: usize, height: usize, value: [f32; 3]) -> Record<f32> {
    let camera = camera(width, height);
    let frame = frame(&camera);
    let light = Light::new(Environment::constant([0.5; 3]));
    let shaded = ibl::shade(&frame, &light);
    let product = |i: usize| std::array::from_fn(|c| shaded.diffuse.pixels[i][c] * shaded.irradiance.pixels[i][c]);
    let terms = ShadingTerms {
        ambient_diffuse: Rgb { width, height, pixels: (0..width * height).map(product).collect() },
        ambient_specular: shaded.specular.clone(),
        irradiance: shaded.irradiance.clone(),
        ..ShadingTerms::default()
    };
    let exposure = light.exposure();
    let raw = Rgb::filled(width, height, value);
    let background = shaded.surfaces.background.clone();
    let albedo = frame.guide_albedo.clone().unwrap();
    let samples =
        Samples { raw: &raw, alpha: &frame.alpha, albedo: &albedo, background: &background, spp: 2, counts: None, paths: None };
    let mut record = Record::of(&frame, &shaded.surfaces, exposure);
    record.add_deferred(&terms, exposure);
    let key = Keyframe { frame: frame.clone(), truth: raw.clone(), start: Some(shaded.image.clone()) };
    let seen = Neighbour { key: &key, distance: -3.0, movement: Movement::default() };
    record.add_keys([Some(seen), None], &frame, &shaded.image, exposure);
    record.add_part(0, &samples, exposure);
    let source = Image::from_fn(width, height, |x, y| Some((y * width + x) as u32));
    record.add_neighbours(2, &[Nearby { samples, source: &source, share: None }], exposure);
    record
}

/// A network of random weights, also in the last layers, which are 0 in an untrained one.
fn random() -> Fusion {
    random_of(true)
}

/// As [`random`], with or without a U-Net of its own for frames without samples.
fn random_of(separate: bool) -> Fusion {
    let untrained = Fusion::untrained(&FusionConfig { widths: SMALL, separate, ..FusionConfig::default() }, 7).unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let mut parameters = untrained.parameters();
    for parameter in &mut parameters {
        parameter.values.iter_mut().for_each(|v| *v += rng.random_range(-0.1..0.1));
    }
    Fusion::with_parameters(untrained.header().clone(), &parameters).unwrap()
}

/// Under light that is the same from everywhere the split sum is what samples are divided by, whatever the surface.
#[test]
fn samples_over_the_tint_are_the_light() {
    let camera = camera(24, 18);
    let mut frame = frame(&camera);
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    frame.material.pixels.iter_mut().for_each(|m| *m = [rng.random(), rng.random(), rng.random()]);
    let albedo = frame.guide_albedo.as_mut().unwrap();
    albedo.pixels.iter_mut().for_each(|rgb| *rgb = [rng.random(), rng.random(), rng.random()]);
    let shading = ibl::shade(&frame, &Light::new(Environment::constant([1.0; 3])));
    let record = Record::of(&frame, &shading.surfaces, 1.0);
    let mut compared = 0;
    for (i, stored) in record.pixels.chunks_exact(at::COUNT).enumerate() {
        if stored[at::ALPHA] == 1.0 {
            let found = tint([stored[at::ALBEDO], stored[at::ALBEDO + 1], stored[at::ALBEDO + 2]], stored);
            for (shaded, tint) in shading.image.pixels[i].iter().zip(found) {
                assert!(*shaded < tint && *shaded > tint - 0.021, "{shaded} and {tint} at pixel {i}");
            }
            compared += 1;
        }
    }
    assert!(compared > 100);
}

/// Indirect light of neighbours counts as far as their samples do. Where some neighbours do not tell theirs, the record knows
/// none.
#[test]
fn neighbours_bring_their_indirect_light() {
    let (width, height, value) = (16, 12, [0.4, 0.8, 0.2]);
    let frame = frame(&camera(width, height));
    let shaded = ibl::shade(&frame, &Light::new(Environment::constant([0.5; 3])));
    let [raw, quarter] = [1.0, 0.25].map(|share| Rgb::filled(width, height, value.map(|v| share * v)));
    let (background, albedo) = (&Rgb::filled(width, height, [0.0; 3]), frame.guide_albedo.as_ref().unwrap());
    let paths = Paths { indirect: &quarter, hidden: &quarter, variance: &quarter };
    let told = Samples { raw: &raw, alpha: &frame.alpha, albedo, background, spp: 2, counts: None, paths: Some(paths) };
    let source = Image::from_fn(width, height, |x, y| Some((y * width + x) as u32));
    let share = Image::filled(width, height, 0.5);
    let mut record = Record::of(&frame, &shaded.surfaces, 1.0);
    record.add_part(0, &told, 1.0);
    record.add_neighbours(2, &[Nearby { samples: told, source: &source, share: Some(&share) }], 1.0);
    assert!(record.groups().paths);
    let selection = Selection::all(&record);
    let mut covered = 0;
    for stored in record.pixels.chunks_exact(at::COUNT).filter(|stored| stored[at::ALPHA] > 0.0) {
        covered += 1;
        let (all, indirect) = (&stored[at::NEARBY + 8..], &stored[at::NEARBY_INDIRECT + 6..]);
        let pixel = PixelInputs::new(stored, &selection, 1.0);
        for c in 0..3 {
            assert!((indirect[c] - 0.25 * all[c]).abs() < 1e-5 && all[c] > 0.0, "{} of {}", indirect[c], all[c]);
            assert_eq!(pixel.others_indirect[2][c], 2.0 * indirect[c]);
        }
        assert_eq!(pixel.others_indirect[0], [0.0; 3]);
    }
    assert!(covered > 20, "{covered}");
    let untold = Samples { paths: None, ..told };
    record.add_neighbours(0, &[Nearby { samples: untold, source: &source, share: None }], 1.0);
    assert!(record.groups().neighbours && !record.groups().paths);
    let untold = Selection::all(&record);
    assert!(
        record
            .pixels
            .chunks_exact(at::COUNT)
            .all(|s| PixelInputs::new(s, &untold, 1.0).others_indirect == [[0.0; 3]; NEIGHBOURS])
    );
}

#[test]
fn any_input_gives_a_finite_picture() {
    let network = random();
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -5.0, 1e30, 0.0, 1e-40] {
        for (width, height) in [(24, 18), (1, 1), (3, 40), (17, 2)] {
            for mixed in [[value; 3], [value, 0.5, 0.5]] {
                let drawn = network.render(&filled(width, height, mixed)).unwrap();
                assert_eq!(drawn.len(), width * height);
                assert!(drawn.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{mixed:?} at {width} x {height}");
            }
        }
    }
    assert!(network.render(&Record::new(0, 5)).is_err());
    // Nothing but the environment is drawn where nothing is covered.
    let record = filled(24, 18, [0.3; 3]);
    let drawn = network.render(&record).unwrap();
    let background = &record.pixels[at::BACKGROUND..at::BACKGROUND + 3];
    assert_eq!(drawn[0].as_slice(), background);
}

#[test]
fn threads_do_not_show() {
    let network = random();
    let record = toy(3);
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| network.render(&record).unwrap())
    };
    let one = draw(1);
    assert!(one == draw(2) && one == draw(5));
}

/// Absent groups are as if their weights did not exist.
#[test]
fn what_is_not_given_has_no_part() {
    let network = random();
    let mut record = filled(24, 18, [0.3; 3]);
    let everything = network.render(&record).unwrap();
    (record.parts, record.neighbours) = ([0; PARTS], [0; NEIGHBOURS]);
    let without = network.render(&record).unwrap();
    assert!(everything != without);
    let mut noise = Pcg64Mcg::seed_from_u64(1);
    for stored in record.pixels.chunks_exact_mut(at::COUNT) {
        stored[at::SAMPLES..at::TRUTH].iter_mut().for_each(|v| *v = noise.random());
    }
    assert!(without == network.render(&record).unwrap());
}

/// Weights of one U-Net may be the start of both. Then each learns from its own frames alone.
#[test]
fn one_network_becomes_two() {
    let (joint, folder) = (random_of(false), tempfile::tempdir().unwrap());
    let both = FusionConfig { widths: SMALL, ..FusionConfig::default() };
    let apart = joint.fitted(&both).unwrap();
    assert_eq!((apart.header().fusion.clone(), both.values()), (both.clone(), count(&apart)));
    assert_eq!(FusionConfig { separate: false, ..both.clone() }.values(), count(&joint));
    let traced = toy(3);
    let plain = Record { parts: [0; PARTS], neighbours: [0; NEIGHBOURS], ..traced.clone() };
    for record in [&traced, &plain] {
        assert!(joint.render(record).unwrap() == apart.render(record).unwrap());
    }
    let error = apart.fitted(&FusionConfig { separate: false, ..both.clone() }).unwrap_err().to_string();
    assert!(error.contains("another network"), "{error}");

    let config = Config { tiers: vec!["deferred".into(), "deferred+keys".into()], ..config(folder.path(), 3) };
    let summary = learn_from(&config, Some(&joint), &[], &NetworkDevice::cpu(), u64::MAX);
    let learned = Fusion::load(&summary.weights).unwrap();
    let halved = folder.path().join("halved.safetensors");
    apart.save(&halved, Precision::F16).unwrap();
    let before = Fusion::load(&halved).unwrap();
    assert!(before.render(&traced).unwrap() == learned.render(&traced).unwrap());
    assert!(before.render(&plain).unwrap() != learned.render(&plain).unwrap());
}

/// Weights of a small network may be the start of a larger one. It gives the same pictures, and all that is added learns.
#[test]
fn a_network_grows() {
    let larger = |plain_widths| {
        let all = FusionConfig::default();
        FusionConfig { widths: [32, 16, 48, 32], refines: [1, 3, 2, 2], plain_widths, ..all }
    };
    let traced = toy(3);
    let plain = Record { parts: [0; PARTS], neighbours: [0; NEIGHBOURS], ..traced.clone() };
    for (separate, plain_widths) in [(true, Some(SMALL)), (true, None), (false, Some([16, 32, 16, 48]))] {
        let (small, config) = (random_of(separate), larger(plain_widths));
        let large = small.fitted(&config).unwrap();
        assert_eq!(count(&large), config.values());
        for record in [&traced, &plain] {
            let (before, after) = (small.render(record).unwrap(), large.render(record).unwrap());
            let far =
                |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs() / (1.0 + b[c].abs())).fold(0.0, f32::max);
            let farthest = before.iter().zip(&after).map(far).fold(0.0, f32::max);
            assert!(farthest < 1e-4, "{farthest}");
        }
        let error = large.fitted(&small.header().fusion).unwrap_err().to_string();
        assert!(error.contains("another network"), "{error}");
        let fewer = FusionConfig { refines: [1, 2, 2, 2], ..config };
        assert!(large.fitted(&fewer).is_err());
    }

    let folder = tempfile::tempdir().unwrap();
    let run = Config { network: larger(Some(SMALL)), ..config(folder.path(), 4) };
    let small = random();
    let summary = learn_from(&run, Some(&small), &[], &NetworkDevice::cpu(), u64::MAX);
    let (before, after) =
        (small.fitted(&run.network).unwrap().parameters(), Fusion::load(&summary.weights).unwrap().parameters());
    for name in ["down.1.more.1.weight", "up.0.more.0.weight", "enter.1.weight", "fine.weight"] {
        let of = |parameters: &[Parameter]| {
            parameters.iter().find(|found| found.name == format!("sampled.{name}")).unwrap().values.clone()
        };
        let (before, after) = (of(&before), of(&after));
        let (zeros, left) = before
            .iter()
            .zip(&after)
            .filter(|(v, _)| **v == 0.0)
            .fold((0, 0), |(zeros, left), (_, v)| (zeros + 1, left + usize::from(*v == 0.0)));
        assert!(zeros > 100 && 4 * left < 3 * zeros, "{name}: {left} of {zeros}");
    }
}

/// Weights that do not say that they read what samples are made of do not. They may be the start of a network that learns to.
#[test]
fn a_network_learns_to_read_what_samples_are_made_of() {
    let all = FusionConfig { widths: SMALL, ..FusionConfig::default() };
    let old = FusionConfig { paths: false, ..all.clone() };
    let described = r#"{"fusion":{"widths":[16,16,16,16]},"steps":3,"seed":1}"#;
    assert_eq!(serde_json::from_str::<Header>(described).unwrap().fusion, old);
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let untrained = Fusion::untrained(&old, 7).unwrap();
    let mut parameters = untrained.parameters();
    parameters.iter_mut().for_each(|parameter| parameter.values.iter_mut().for_each(|v| *v += rng.random_range(-0.1..0.1)));
    let before = Fusion::with_parameters(untrained.header().clone(), &parameters).unwrap();
    let (told, untold) = (toy(3), Record { paths: false, ..toy(3) });
    let larger = before.fitted(&all).unwrap();
    let picture = before.render(&untold).unwrap();
    assert!(picture == before.render(&told).unwrap());
    let same = |other: Vec<[f32; 3]>| {
        other.as_flattened().iter().zip(picture.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-4 * (1.0 + b.abs()))
    };
    assert!([&told, &untold].into_iter().all(|record| same(larger.render(record).unwrap())));
    assert!(larger.fitted(&old).is_err());

    let folder = tempfile::tempdir().unwrap();
    let run = |paths| {
        let name = if paths { "told" } else { "untold" };
        let network = FusionConfig { paths, ..all.clone() };
        Config { network, tiers: vec!["rays".into()], ..config(&folder.path().join(name), 4) }
    };
    let learned = [true, false].map(|paths| {
        Fusion::load(&learn_from(&run(paths), Some(&before), &[], &NetworkDevice::cpu(), u64::MAX).weights).unwrap()
    });
    let [reads, does_not] = learned.map(|network| {
        !same(network.render(&told).unwrap()) && { network.render(&told).unwrap() != network.render(&untold).unwrap() }
    });
    assert!(reads && !does_not);
}

/// Number of values in the parameters of a network.
fn count(network: &Fusion) -> usize {
    network.parameters().iter().map(|parameter| parameter.values.len()).sum()
}

/// Products in bf16 change the picture much less than the network's own error, in every combination of inputs.
#[test]
fn products_in_bf16_hardly_change_the_picture() {
    let record = toy(7);
    let [exact, rounded] = [Products::F32, Products::Bf16].map(|products| Fusion::shipped().unwrap().with_products(products));
    for tier in TIERS {
        let selection = Selection { groups: tier.groups, ..Selection::all(&record) };
        let [a, b] = [&exact, &rounded].map(|network| network.draw(&record, &selection).unwrap());
        let squares = a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b) * (a - b));
        let error = (squares.sum::<f32>() / (3 * a.len()) as f32).sqrt();
        println!("{}: {error}", tier.name);
        assert!(error < 2e-3, "{}: {error}", tier.name);
    }
    // The processor rounds by default where it has the instructions.
    let usual = Fusion::shipped().unwrap().render(&record).unwrap();
    assert!(usual == rounded.render(&record).unwrap());
    let same = usual == exact.render(&record).unwrap();
    assert!(same == kernels::bf16_instructions().is_none());
    let choice = "cpu:f32".parse().expect("a choice");
    let chosen = Fusion::shipped().unwrap().to(&NetworkDevice::open(choice).unwrap()).unwrap();
    assert!(chosen.render(&record).unwrap() == exact.render(&record).unwrap());
}

#[test]
fn weights_files_come_back_and_hostile_ones_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let network = random();
    let write = |precision| network.save(&path, precision).unwrap();
    write(Precision::F32);
    assert!(Fusion::recognises(&path));
    let record = toy(2);
    assert!(Fusion::load(&path).unwrap().render(&record).unwrap() == network.render(&record).unwrap());
    write(Precision::F16);
    let exactly = |network: Fusion| network.with_products(Products::F32).render(&record).unwrap();
    let (half, whole) = (exactly(Fusion::load(&path).unwrap()), exactly(network));
    let worst = half.iter().flatten().zip(whole.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(worst.fold(0.0, f32::max) < 0.02);

    // A header that asks for more than the file has is refused before anything is made.
    let bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(13).position(|part| part == b"[16,16,16,16]").expect("the widths stand in the header");
    let mut larger = bytes.clone();
    larger[at..at + 13].copy_from_slice(b"[96,96,96,96]");
    std::fs::write(&path, &larger).unwrap();
    let error = Fusion::load(&path).unwrap_err().to_string();
    assert!(error.contains("values"), "{error}");
    for length in [0, 7, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(Fusion::load(&path).is_err(), "{length} bytes");
    }
    assert!(!Fusion::recognises(&folder.path().join("nothing")));
}
