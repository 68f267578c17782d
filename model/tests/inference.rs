//! What inference promises before any training: the start picture, the environment behind it, the same bits every time.

mod common;

use burn::tensor::Device;
use common::{clip, tiny};
use renderflow_frame::ibl::{self, IblTables};
use renderflow_frame::image::Rgb;
use renderflow_model::config::{KeyframeConfig, NetworkConfig, Start};
use renderflow_model::network::Network;
use renderflow_model::parameters::{export, import};
use renderflow_model::weights::WeightsHeader;
use renderflow_model::{Clip, Error, Keyframe, NeuralRenderer, PreparedKeyframe};

/// A renderer whose parameters have all been moved away from their initial values.
fn disturbed(config: &NetworkConfig) -> NeuralRenderer {
    let device = Device::flex();
    let network = Network::new(config, 7, &device).unwrap();
    let parameters = export(&network);
    let values: Vec<Vec<f32>> = parameters
        .iter()
        .map(|p| p.values.iter().enumerate().map(|(i, v)| v + 0.01 * ((i * 37 % 101) as f32 / 50.0 - 1.0)).collect())
        .collect();
    let values: Vec<&[f32]> = values.iter().map(Vec::as_slice).collect();
    let header = WeightsHeader { network: config.clone(), steps: 0, keyframe_steps: 0, seed: 7 };
    NeuralRenderer::new(import(network, &values, &device), header, device)
}

fn render(renderer: &NeuralRenderer, clip: &Clip, i: usize, keys: &[Keyframe]) -> Rgb {
    let tables = IblTables::new(&clip.environment);
    renderer.render(&clip.frames[i], &clip.cameras[i], &clip.environment, &tables, clip.exposure, keys).unwrap()
}

#[test]
fn an_untrained_network_renders_the_split_sum() {
    // 72 is no multiple of 32: padding is covered too.
    let clip = clip(1, 72);
    let tables = IblTables::new(&clip.environment);
    let shading = ibl::shade(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables);
    let out = render(&NeuralRenderer::untrained(&tiny(), 3).unwrap(), &clip, 0, &[]);
    let mut covered = 0;
    for (i, (a, b)) in out.pixels.iter().zip(&shading.image.pixels).enumerate() {
        covered += usize::from(clip.frames[0].alpha.pixels[i] > 0.0);
        for c in 0..3 {
            assert!((a[c] - b[c]).abs() <= 1e-6 * b[c].max(1.0), "pixel {i} channel {c}: {} instead of {}", a[c], b[c]);
        }
    }
    assert!(covered > 1000, "{covered} covered pixels");
}

#[test]
fn other_starts_begin_at_their_picture() {
    let clip = clip(1, 64);
    let tables = IblTables::new(&clip.environment);
    let shading = ibl::shade(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables);
    for start in [Start::Albedo, Start::AlbedoIrradiance] {
        let out = render(&NeuralRenderer::untrained(&NetworkConfig { start, ..tiny() }, 3).unwrap(), &clip, 0, &[]);
        for (i, value) in out.pixels.iter().enumerate().filter(|(i, _)| clip.frames[0].alpha.pixels[*i] > 0.0) {
            for (c, value) in value.iter().enumerate() {
                let light = if start == Start::Albedo { 1.0 / clip.exposure } else { shading.irradiance.pixels[i][c] };
                let expected = shading.surfaces.albedo.pixels[i][c] * light;
                assert!(
                    (value - expected).abs() <= 2e-6 * expected.max(1.0),
                    "{start:?} pixel {i}: {} instead of {expected}",
                    value
                );
            }
        }
    }
}

#[test]
fn the_background_is_the_environment_whatever_the_weights() {
    let clip = clip(1, 64);
    let tables = IblTables::new(&clip.environment);
    let shading = ibl::shade(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables);
    for start in [Start::Ibl, Start::Albedo] {
        let out = render(&disturbed(&NetworkConfig { start, ..tiny() }), &clip, 0, &[]);
        let mut seen = 0;
        for (i, value) in out.pixels.iter().enumerate().filter(|(i, _)| clip.frames[0].alpha.pixels[*i] == 0.0) {
            for (value, expected) in value.iter().zip(shading.surfaces.background.pixels[i]) {
                assert!((value - expected).abs() <= 3e-7 * expected, "pixel {i}: {} instead of {expected}", value);
            }
            seen += 1;
        }
        assert!(seen > 100);
        assert!(out.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
    }
}

#[test]
fn without_keyframes_a_keyframe_stage_changes_no_bit() {
    let clip = clip(1, 64);
    let with_stage = NetworkConfig { keyframes: Some(KeyframeConfig { widths: [16, 16, 16] }), ..tiny() };
    let (plain, keyed) = (disturbed(&tiny()), disturbed(&with_stage));
    assert!(keyed.accepts_keyframes() && !plain.accepts_keyframes());
    assert_eq!(render(&plain, &clip, 0, &[]), render(&keyed, &clip, 0, &[]));
}

#[test]
fn threads_and_repetition_change_no_bit() {
    let clip = clip(3, 96);
    let config = NetworkConfig { keyframes: Some(KeyframeConfig { widths: [16, 16, 16] }), ..tiny() };
    let renderer = disturbed(&config);
    let tables = IblTables::new(&clip.environment);
    let key = PreparedKeyframe::new(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables, clip.exposure).unwrap();
    let picture = || render(&renderer, &clip, 1, &[Keyframe { prepared: &key, distance: -1.0, movement: Default::default() }]);
    let first = picture();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(first, pool.install(picture), "{threads} threads");
    }
    assert_ne!(first, render(&renderer, &clip, 1, &[]), "the keyframe has no effect");
}

#[test]
fn an_untrained_keyframe_stage_shows_the_carried_truth() {
    let clip = clip(5, 96);
    let config = NetworkConfig { keyframes: Some(KeyframeConfig::default()), ..tiny() };
    let renderer = NeuralRenderer::untrained(&config, 3).unwrap();
    let tables = IblTables::new(&clip.environment);
    let keys: Vec<PreparedKeyframe> = [0, 4]
        .map(|k| PreparedKeyframe::new(&clip.frames[k], &clip.cameras[k], &clip.environment, &tables, clip.exposure).unwrap())
        .into();
    let seen = |i: usize| {
        [0, 1].map(|k| Keyframe { prepared: &keys[k], distance: 4.0 * k as f32 - i as f32, movement: Default::default() })
    };
    let truth = |i: usize| clip.frames[i].beauty.as_ref().unwrap();
    assert_eq!(&render(&renderer, &clip, 4, &seen(4)), truth(4), "a keyframe is returned as it is");
    let psnr = |picture: &Rgb| common::psnr(picture, truth(2), &clip.frames[2], clip.exposure);
    let (start, carried) = (psnr(&render(&renderer, &clip, 2, &[])), psnr(&render(&renderer, &clip, 2, &seen(2))));
    assert!(carried > start + 6.0, "start {start:.1} dB, with keyframes {carried:.1} dB");
}

#[test]
fn several_euler_steps_stay_close_to_one_before_training() {
    let clip = clip(1, 64);
    let tables = IblTables::new(&clip.environment);
    let renderer = NeuralRenderer::untrained(&tiny(), 3).unwrap();
    let run = |steps| {
        renderer.render_steps(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables, clip.exposure, &[], steps).unwrap()
    };
    // Every step predicts the start picture, so the path does not move.
    assert_eq!(run(1), run(4));
}

#[test]
fn keyframes_for_weights_without_a_stage_are_an_error() {
    let clip = clip(2, 64);
    let tables = IblTables::new(&clip.environment);
    let key = PreparedKeyframe::new(&clip.frames[0], &clip.cameras[0], &clip.environment, &tables, clip.exposure).unwrap();
    let renderer = NeuralRenderer::untrained(&tiny(), 3).unwrap();
    let keys = [Keyframe { prepared: &key, distance: -1.0, movement: Default::default() }];
    let result = renderer.render(&clip.frames[1], &clip.cameras[1], &clip.environment, &tables, clip.exposure, &keys);
    assert!(matches!(result, Err(Error::Config { option: "keyframes", .. })), "{result:?}");
    let result = renderer.render(&clip.frames[1], &clip.cameras[1], &clip.environment, &tables, f32::NAN, &[]);
    assert!(matches!(result, Err(Error::Config { option: "exposure", .. })), "{result:?}");
}
