//! Derivatives of the head, and what it gives before training.

use super::super::record::PATHS;
use super::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn random_pixel(rng: &mut Pcg64Mcg, groups: Groups) -> PixelInputs {
    let mut rgb = || std::array::from_fn(|_| rng.random_range(0.05..1.0));
    let mut pixel = PixelInputs { background: rgb(), tint: rgb(), reflected: rgb(), ..PixelInputs::default() };
    pixel.terms = std::array::from_fn(|_| rgb());
    pixel.keys = std::array::from_fn(|_| rgb());
    pixel.trust = [f32::NEG_INFINITY; KEYS];
    let traced = |rng: &mut Pcg64Mcg| {
        let coverage: f32 = if rng.random_bool(0.2) { 0.0 } else { rng.random_range(0.2..1.0) };
        [0, 1, 2, 3].map(|c| if c == 3 { coverage } else { coverage * rng.random_range(0.0..3.0f32) })
    };
    pixel.own = traced(rng);
    if groups.paths {
        (0..3).for_each(|c| pixel.paths[c] = pixel.own[c] * rng.random_range(0.0..1.2f32));
    }
    pixel.others = std::array::from_fn(|_| traced(rng));
    if groups.paths && groups.neighbours {
        let indirect = pixel.others.map(|other| [0, 1, 2].map(|c| other[c] * rng.random_range(0.0..1.2f32)));
        pixel.others_indirect = indirect;
    }
    pixel.alpha = if rng.random_bool(0.1) { 0.0 } else { rng.random_range(0.3..1.0) };
    pixel.denoised = groups.denoised.then(|| std::array::from_fn(|_| rng.random_range(0.05..1.0)));
    if groups.keys {
        pixel.trust = [0.2, if rng.random_bool(0.5) { -0.3 } else { f32::NEG_INFINITY }];
    }
    pixel
}

/// Derivatives agree with finite differences for every combination of groups.
#[test]
fn derivatives_agree_with_differences() {
    let (width, height) = (8, 8);
    for bits in 0..64 {
        let [deferred, keys, samples, neighbours, denoised, paths] = [0, 1, 2, 3, 4, 5].map(|bit| bits >> bit & 1 == 1);
        if (neighbours || denoised || paths) && !samples {
            continue;
        }
        let groups = Groups { deferred, keys, samples, neighbours, denoised, paths };
        let mut rng = Pcg64Mcg::seed_from_u64(bits);
        let pixels: Vec<PixelInputs> = (0..width * height).map(|_| random_pixel(&mut rng, groups)).collect();
        let mut random = |count: usize| -> Vec<f32> { (0..count).map(|_| rng.random_range(-1.0..1.0)).collect() };
        let fine_outputs = random(width * height / 4 * fine(groups));
        let coarse_outputs = random(if samples { width * height / 16 * KERNEL } else { 0 });
        let slopes: Vec<[f32; 3]> = random(3 * width * height).chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let loss = |fine: &[f32], coarse: &[f32]| -> f64 {
            let (drawn, _) = Picture { width, height, pixels: &pixels, groups, fine, coarse }.draw();
            drawn.iter().zip(&slopes).flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c] * b[c]))).sum()
        };
        let picture = Picture { width, height, pixels: &pixels, groups, fine: &fine_outputs, coarse: &coarse_outputs };
        let (_, tape) = picture.draw();
        let (d_fine, d_coarse) = picture.backward(&tape, &slopes);
        let step = 1e-2;
        let mut worst: f64 = 0.0;
        for (which, values, slopes) in [(0, &fine_outputs, &d_fine), (1, &coarse_outputs, &d_coarse)] {
            for i in (0..values.len()).step_by(7) {
                let at = |delta: f32| {
                    let mut moved = values.clone();
                    moved[i] += delta;
                    if which == 0 { loss(&moved, &coarse_outputs) } else { loss(&fine_outputs, &moved) }
                };
                let expected = (at(step) - at(-step)) / f64::from(2.0 * step);
                let error = (expected - f64::from(slopes[i])).abs();
                // A clamp between the two points is rare, and would show as a large error.
                assert!(error < 3e-3 + 0.02 * expected.abs(), "{groups:?} {which} {i}: {} and {expected}", slopes[i]);
                worst = worst.max(expected.abs());
            }
        }
        assert!(worst > 1e-2, "{groups:?}: the picture does not depend on the outputs");
    }
}

/// Indirect light that weighs nothing at the scales with samples is not lost, and derivatives know it.
#[test]
fn indirect_light_does_not_vanish() {
    let groups = Groups { samples: true, paths: true, ..Groups::default() };
    let (width, height) = (16, 16);
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let mut pixels: Vec<PixelInputs> = (0..width * height).map(|_| random_pixel(&mut rng, groups)).collect();
    // Only the left half has samples, so the finest scale has none around a pixel farther to the right.
    for (i, pixel) in pixels.iter_mut().enumerate().filter(|(i, _)| i % width >= 8) {
        (pixel.own, pixel.alpha) = ([0.0; 4], if i % 2 == 0 { 1.0 } else { 0.9 });
    }
    let outputs = fine(groups);
    let mut fine_outputs: Vec<f32> = (0..width * height / 4 * outputs).map(|_| rng.random_range(-1.0..1.0)).collect();
    for block in fine_outputs.chunks_exact_mut(outputs) {
        // Indirect light comes from the finest scale alone.
        block[outputs - 4 * SPLIT..].chunks_exact_mut(SPLIT).for_each(|split| split[0] = 40.0);
    }
    let coarse = vec![0.1; width * height / 16 * KERNEL];
    let draw = |fine: &[f32], pixels: &[PixelInputs]| Picture { width, height, pixels, groups, fine, coarse: &coarse }.draw();
    let at = 8 * width + 11;
    let (drawn, tape) = draw(&fine_outputs, &pixels);
    let untold: Vec<PixelInputs> = pixels.iter().map(|pixel| PixelInputs { paths: [0.0; PATHS], ..*pixel }).collect();
    let expected = draw(&fine_outputs, &untold).0[at];
    assert!((0..3).all(|c| (drawn[at][c] - expected[c]).abs() < 1e-5), "{:?} and {expected:?}", drawn[at]);
    assert_ne!(drawn[8 * width + 3], draw(&fine_outputs, &untold).0[8 * width + 3]);

    let mut slopes = vec![[0.0; 3]; width * height];
    slopes[at] = [1.0, -0.5, 2.0];
    let picture = Picture { width, height, pixels: &pixels, groups, fine: &fine_outputs, coarse: &coarse };
    let (found, _) = picture.backward(&tape, &slopes);
    let loss = |drawn: [f32; 3]| f64::from(drawn[0] - 0.5 * drawn[1] + 2.0 * drawn[2]);
    let first = picture.traced_at(at) + KERNEL;
    for output in (first..first + SCALES).chain(picture.split_at(at)..picture.split_at(at) + SPLIT) {
        let moved = |by: f32| {
            let mut moved = fine_outputs.clone();
            moved[output] += by;
            loss(draw(&moved, &pixels).0[at])
        };
        let expected = (moved(1e-2) - moved(-1e-2)) / 2e-2;
        assert!(
            (expected - f64::from(found[output])).abs() < 3e-3 + 0.02 * expected.abs(),
            "{output}: {} and {expected}",
            found[output]
        );
    }
}

/// Outputs of 0 give the best input: mostly the picture of another denoiser, else samples, else keyframes, else deferred
/// shading.
#[test]
fn an_untrained_network_returns_its_best_input() {
    let one = PixelInputs {
        alpha: 1.0,
        tint: [1.0; 3],
        terms: [[0.1, 0.2, 0.3]; TERMS],
        keys: [[0.7; 3]; KEYS],
        trust: [0.0; KEYS],
        own: [2.0, 2.0, 2.0, 1.0],
        ..PixelInputs::default()
    };
    let pixels = vec![one; 64];
    let with_picture = vec![PixelInputs { denoised: Some([0.9; 3]), ..one }; 64];
    let draw = |groups: Groups| {
        let pixels = if groups.denoised { &with_picture } else { &pixels };
        let fine_outputs = vec![0.0; 16 * fine(groups)];
        let coarse = vec![0.0; if groups.samples { 4 * KERNEL } else { 0 }];
        let (drawn, _) = Picture { width: 8, height: 8, pixels, groups, fine: &fine_outputs, coarse: &coarse }.draw();
        drawn[27]
    };
    let deferred = Groups { deferred: true, ..Groups::default() };
    let mut bare = pixels[0];
    bare.trust = [f32::NEG_INFINITY; KEYS];
    let samples = Groups { samples: true, ..Groups::default() };
    assert!((draw(samples)[0] - 2.0).abs() < 0.2);
    // The denoised picture of 0.9 weighs exp(3) times as much as the samples of 2.
    assert!((draw(Groups { denoised: true, ..samples })[0] - 0.9).abs() < 0.1);
    assert!((draw(Groups { keys: true, ..deferred })[0] - 0.7).abs() < 0.05);
    let bare = vec![bare; 64];
    let fine_outputs = vec![0.0; 16 * fine(deferred)];
    let (drawn, _) = Picture { width: 8, height: 8, pixels: &bare, groups: deferred, fine: &fine_outputs, coarse: &[] }.draw();
    assert_eq!(drawn[9].map(|v| (v * 1e5).round()), [40000.0, 80000.0, 120_000.0]);
}
