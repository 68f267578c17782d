//! Bridges that begin with something else than the albedo: noise, the albedo under the light without shadows, deferred shading.

mod common;

use burn::tensor::Device;
use common::sequence::{Memory, SIDE};
use common::{clip, encoder, learn, lpips_folder};
use renderflow_frame::{DepthBounds, color, ibl};
use renderflow_model::Clip;
use renderflow_model::bridge::{Bridge, Times};
use renderflow_model::data::step_rng;
use renderflow_model::device::NetworkDevice;
use renderflow_model::renderer::{Options, Renderer};
use renderflow_model::train::{RunConfig, Share};
use renderflow_model::wan::flow::{Flow, FlowConfig, InverseConfig};
use renderflow_model::wan::pictures::{BridgeStart, EnvironmentView, Kind, Pictures};
use renderflow_model::wan::train::clip_pictures::Window;
use renderflow_model::wan::train::latent_batch::{BatchSampler, LatentBatch, Task};
use renderflow_model::wan::train::latents::{ClipLatents, Encoder};
use renderflow_model::wan::train::{BatchConfig, Config, LatentConfig, PixelLoss, Stage};
use renderflow_model::wan::video::WanRenderer;
use renderflow_model::wan::weights::{Header, Network, Precision, Provenance, save};
use renderflow_model::wan::{Vae, names::Naming};
use std::sync::Arc;

const SIZE: usize = 32;

fn network(start: BridgeStart) -> FlowConfig {
    FlowConfig { bridge_start: start, ..FlowConfig::tiny() }
}

fn autoencoder() -> Vae {
    Vae::new(&FlowConfig::tiny().vae, 5, &Device::flex()).expect("autoencoder")
}

fn latents(vae: &Vae, start: BridgeStart) -> Vec<Arc<Vec<ClipLatents>>> {
    let encoder = Encoder { start, pictures: &[Kind::Target, Kind::Albedo], ..encoder(vae, SIZE) };
    vec![Arc::new(encoder.encode(&shaded(6, SIZE)).expect("latents"))]
}

/// A clip whose frames come with the split sum at twice its brightness in the place of deferred shading.
fn shaded(frames: usize, size: usize) -> Clip {
    let mut clip = clip(frames, size);
    clip.shaded = clip.frames.iter().map(|frame| ibl::shade(frame, &clip.light).image.map(|p| p.map(|v| 2.0 * v))).collect();
    clip
}

fn settings() -> LatentConfig {
    LatentConfig {
        bridge: Bridge { sigma: 0.0, times: Times::Uniform },
        pixels: PixelLoss { weight: 0.0, ..PixelLoss::default() },
        ..LatentConfig::default()
    }
}

fn drawn(vae: &Vae, start: BridgeStart, step: u64, settings: &LatentConfig) -> LatentBatch {
    let network = network(start);
    let batches = [BatchConfig { size: SIZE, frames: 5, items: 3, weight: 1.0 }];
    let sampler = BatchSampler {
        network: &network,
        latents: settings,
        batches: &batches,
        task: Task::Render { gap: None },
        share: Share::WHOLE,
    };
    sampler.draw(&latents(vae, start), step, &mut step_rng(7, step)).expect("batch")
}

/// The values of each item where its bridge begins and where it ends.
fn ends(batch: &LatentBatch) -> [Vec<f32>; 2] {
    let item = batch.z_t.len() / batch.shape[0];
    let along = |share: &dyn Fn(f32) -> f32| -> Vec<f32> {
        (0..batch.z_t.len()).map(|i| batch.z_t[i] + share(batch.times[i / item]) * batch.velocity[i]).collect()
    };
    [along(&|t| -t), along(&|t| 1.0 - t)]
}

/// Noise at one end, the truth at the other, and the albedo among the conditions.
#[test]
fn a_bridge_from_noise_ends_at_the_truth_and_knows_the_albedo() {
    let vae = autoencoder();
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for step in 0..20 {
        let [noisy, plain] = [BridgeStart::Noise, BridgeStart::Albedo].map(|start| drawn(&vae, start, step, &settings()));
        let ([noise, truth], [albedo, same]) = (ends(&noisy), ends(&plain));
        let far = truth.iter().zip(&same).fold(0.0f32, |worst, (a, b)| worst.max((a - b).abs()));
        // At the latest time the way back is a thousand times as long as the way ahead.
        assert!(far < 1e-3, "step {step}: {far}");
        for value in noise {
            (sum, squares, count) = (sum + f64::from(value), squares + f64::from(value).powi(2), count + 1.0);
        }
        // Items one after the other: the same conditions, then the latents of the albedo.
        let items = noisy.shape[0];
        let [with, without] = [&noisy, &plain].map(|batch| batch.attributes.len() / items);
        let each = albedo.len() / items;
        assert_eq!(with, without + each);
        for item in 0..items {
            let attributes = &noisy.attributes[item * with..][..with];
            assert_eq!(attributes[..without], plain.attributes[item * without..][..without]);
            let far = attributes[without..].iter().zip(&albedo[item * each..]).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
            assert!(far < 1e-3, "{far}");
        }
    }
    let (mean, variance) = (sum / count, squares / count - (sum / count).powi(2));
    assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "mean {mean}, variance {variance} of {count} numbers");
}

#[test]
fn pictures_from_noise_follow_the_seed() {
    let config = network(BridgeStart::Noise);
    let device = Device::flex();
    let (flow, vae) = (Flow::new(&config, 3, &device).expect("network"), Vae::new(&config.vae, 4, &device).expect("network"));
    let header = Header { network: Network::WanFlow(config.clone()), provenance: Provenance::default() };
    let renderer = WanRenderer::new(flow, vae, header, device).expect("renderer");
    let sequence = Memory::new(7, &[]);
    let made = |options: Options| {
        let mut session = renderer.begin(&sequence, options).expect("begins");
        let mut made = Vec::new();
        for index in 0..sequence.len() {
            made.extend(session.push(sequence.view(index)).expect("renders"));
        }
        made.extend(session.finish().expect("ends"));
        made
    };
    for stills in [false, true] {
        let options = Options { steps: 3, stills, ..Options::default() };
        let [first, again, other] = [1, 1, 2].map(|seed| made(Options { seed, ..options }));
        assert_eq!(first.len(), 7);
        assert!(first == again, "the same seed makes other pictures");
        assert!(first.iter().zip(&other).all(|(a, b)| a.linear != b.linear), "another seed makes the same picture");
    }
}

/// Display values of albedo times irradiance, against the tables of the split sum.
#[test]
fn a_lit_start_shows_albedo_under_the_unshadowed_light() {
    let clip = clip(1, SIZE);
    let frame = &clip.frames[0];
    let view = EnvironmentView::new(&clip.light.environment, 4, 2);
    let made = || Pictures::new(frame, &clip.light, &view, DepthBounds::of(&clip.frames)).expect("pictures");
    let (plain, lit) = (made(), made().starting(BridgeStart::Lit, frame, &clip.light, None).expect("lit"));
    let shading = ibl::shade(frame, &clip.light);
    let (pixels, mut seen) = (SIZE * SIZE, 0);
    for i in 0..pixels {
        let found = [0, 1, 2].map(|c| lit.albedo[c * pixels + i]);
        if !frame.depth.pixels[i].is_finite() {
            assert_eq!(found, [0, 1, 2].map(|c| plain.albedo[c * pixels + i]));
            continue;
        }
        seen += 1;
        let (albedo, light) = (frame.albedo.pixels[i], shading.irradiance.pixels[i]);
        let expected = color::display([0, 1, 2].map(|c| albedo[c] * light[c]), clip.light.exposure()).map(|v| 2.0 * v - 1.0);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "pixel {i}: {found:?} and {expected:?}");
    }
    assert!(seen > 100 && plain.albedo != lit.albedo);
    // Everything else stays.
    assert_eq!(Pictures { albedo: Vec::new(), ..plain }, Pictures { albedo: Vec::new(), ..lit });
    // The encoder shows it too.
    let vae = autoencoder();
    let [lit, plain] = [BridgeStart::Lit, BridgeStart::Albedo].map(|start| {
        let still = LatentConfig { bridge: Bridge { sigma: 0.0, times: Times::Four([1.0, 0.0, 0.0, 0.0]) }, ..settings() };
        drawn(&vae, start, 0, &still).z_t
    });
    assert!(lit != plain);
}

/// Before it has learnt anything, a network that begins with deferred shading returns it, whatever its autoencoder loses.
#[test]
fn a_bridge_from_deferred_shading_begins_there() {
    let config = network(BridgeStart::Deferred);
    let device = Device::flex();
    let (flow, vae) = (Flow::new(&config, 3, &device).expect("network"), Vae::new(&config.vae, 4, &device).expect("network"));
    let header = Header { network: Network::WanFlow(config.clone()), provenance: Provenance::default() };
    let renderer = WanRenderer::new(flow, vae, header, device).expect("renderer");
    assert!(renderer.about().shaded);
    let mut sequence = Memory::new(7, &[]);
    let begun = |sequence: &Memory, stills: bool| {
        let mut session = renderer.begin(sequence, Options { stills, ..Options::default() }).expect("begins");
        let mut made = Vec::new();
        for index in 0..sequence.len() {
            made.extend(session.push(sequence.view(index)).map_err(|error| error.to_string())?);
        }
        made.extend(session.finish().map_err(|error| error.to_string())?);
        Ok::<_, String>(made)
    };
    let said = begun(&sequence, false).expect_err("no shading");
    assert!(said.contains("begin with deferred shading"), "{said}");
    sequence.clip.shaded = shaded(7, SIDE).shaded;
    let exposure = sequence.clip.light.exposure();
    for stills in [false, true] {
        let made = begun(&sequence, stills).expect("renders");
        assert_eq!(made.len(), 7);
        for (index, made) in made.iter().enumerate() {
            let expected = &sequence.clip.shaded[index];
            for i in (0..SIDE * SIDE).filter(|&i| sequence.clip.frames[index].alpha.pixels[i] > 0.0) {
                let [a, b] = [made.linear.pixels[i], expected.pixels[i]].map(|p| color::display(p, exposure));
                assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4), "frame {index}, pixel {i}: {a:?} and {b:?}");
            }
        }
    }
    // Pictures of another size are refused.
    sequence.clip.shaded = shaded(7, SIDE + 1).shaded;
    assert!(begun(&sequence, true).is_err() && sequence.clip.check().is_err());
}

/// Steps that decode know where the bridge begins: its pictures, and latents that decode to them.
#[test]
fn decoding_steps_know_the_start_that_is_coded_as_change() {
    let vae = autoencoder();
    let settings = LatentConfig { pixels: PixelLoss { period: 1, window: 2, ..PixelLoss::default() }, ..settings() };
    let mut inside = 0;
    for step in 0..8 {
        let mut batch = drawn(&vae, BridgeStart::Deferred, step, &settings);
        let truth = batch.truth.take().expect("a step that decodes");
        let start = truth.start.expect("a start");
        assert_eq!(start.pictures.len(), truth.pictures.len());
        assert_eq!(start.latents.len(), batch.shape[..3].iter().product::<usize>() * 4);
        assert!(start.pictures != truth.pictures);
        inside += usize::from(truth.top > 0 && truth.left > 0);
        // The window of latents is the one of the pictures: the bridge begins with these latents.
        let [begin, _] = ends(&batch);
        let [rows, columns] = [batch.shape[3], batch.shape[4]];
        for (i, value) in start.latents.iter().enumerate() {
            let (plane, y, x) = (i / 4, i / 2 % 2, i % 2);
            let at = plane * rows * columns + (truth.top + y) * columns + truth.left + x;
            let far = (begin[at] - value).abs();
            assert!(far < 2e-3 * (1.0 + value.abs()), "step {step}, {i}: {} and {value}", begin[at]);
        }
    }
    assert!(inside > 0, "no window lies inside the picture");
    assert!(drawn(&vae, BridgeStart::Lit, 3, &settings).truth.expect("a step that decodes").start.is_none());
}

/// A step of each kind learns, and the weights say what their bridge begins with.
#[test]
fn weights_keep_the_start_of_their_bridge() {
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("vae.safetensors");
    let vae = autoencoder();
    let header = Header { network: Network::WanVae(vae.config().clone()), provenance: Provenance::default() };
    save(&file, &vae, &header, Precision::F32, Naming::Diffusers).expect("saved");
    for start in [BridgeStart::Noise, BridgeStart::Lit, BridgeStart::Deferred, BridgeStart::Albedo] {
        let stage = Stage::Base {
            network: Box::new(network(start)),
            start: None,
            latents: LatentConfig {
                autoencoder: file.clone(),
                pixels: PixelLoss { lpips: 0.0, period: 1, window: 2, ..PixelLoss::default() },
                ..settings()
            },
        };
        let config = Config {
            stage,
            run: RunConfig { output: folder.path().join(format!("{start:?}")), steps: 2, ..RunConfig::default() },
            lpips_weights: Some(lpips_folder()),
            batches: vec![BatchConfig { size: SIZE, frames: 1, items: 1, weight: 1.0 }],
            ..Config::default()
        };
        let summary = learn(&config, &[shaded(2, SIZE)], &|_| false).expect("trains");
        let renderer = WanRenderer::load(&summary.weights, Some(&file), &NetworkDevice::cpu()).expect("renderer");
        assert_eq!(renderer.config().bridge_start, start);
        let text = serde_json::to_string(renderer.config()).expect("JSON");
        // Files of the paper's network stay as they were.
        assert_eq!(text.contains("bridge_start"), start != BridgeStart::Albedo, "{text}");
        check_inverse(start);
    }
}

/// The inverse adapter turns the bridge from the albedo around, and no other.
fn check_inverse(start: BridgeStart) {
    let config = network(start).with_inverse(InverseConfig::default());
    let made = Flow::new(&config, 1, &Device::flex()).map(drop).map_err(|error| error.to_string());
    match start {
        BridgeStart::Albedo => assert_eq!(made, Ok(())),
        _ => assert!(made.expect_err("refused").contains("bridge_start")),
    }
}

/// A bridge that begins with carried keyframes is shown those keyframes, and no others.
#[test]
fn carried_keyframes_are_the_ones_that_are_shown() {
    let vae = autoencoder();
    let gap = 4;
    let shown = |start: BridgeStart| {
        let encoder = Encoder { start, ..encoder(&vae, SIZE) };
        let clips = vec![Arc::new(encoder.encode(&shaded(9, SIZE)).expect("latents"))];
        let (network, settings) = (network(start), settings());
        let batches = [BatchConfig { size: SIZE, frames: 1, items: 2, weight: 1.0 }];
        let task = Task::Render { gap: Some(gap) };
        let sampler = BatchSampler { network: &network, latents: &settings, batches: &batches, task, share: Share::WHOLE };
        let side = SIZE / network.vae.spatial_factor();
        let frames: Vec<Vec<f32>> = (0..9)
            .map(|frame| {
                let mut latents = Vec::new();
                clips[0][0].read(frame, 1, Kind::Target, Window { top: 0, left: 0, height: side, width: side }, &mut latents);
                latents
            })
            .collect();
        let mut numbers: Vec<usize> = Vec::new();
        for step in 0..24 {
            let batch = sampler.draw(&clips, step, &mut step_rng(7, step)).expect("batch");
            assert!(!batch.keyframes.is_empty());
            for (latents, _) in &batch.keyframes {
                let items = latents.chunks_exact(frames[0].len());
                numbers.extend(items.map(|item| frames.iter().position(|frame| frame == item).expect("a frame of the clip")));
            }
        }
        numbers.sort_unstable();
        numbers.dedup();
        numbers
    };
    assert_eq!(shown(BridgeStart::Deferred), [0, 4, 8]);
    assert!(shown(BridgeStart::Albedo).len() > 5);
}
