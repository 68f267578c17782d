//! Sequences that are made while a network trains on them.

mod common;

use common::succeed;
use renderflow::dataset::learning::{Kept, Planned, Recipe};
use renderflow::dataset::plan::Plan;
use renderflow::util::cancel::Cancel;
use renderflow_model::fusion::Record;
use renderflow_model::fusion::record::{ALL_BEFORE, AROUND, at};
use renderflow_renderer::denoise::Denoiser;
use std::num::NonZeroU64;
use std::path::Path;

/// A plan of four sequences of 18 frames of 16 x 16 pixels, made in `folder`.
fn tiny_plan(folder: &Path) -> Plan {
    let file = folder.join("plan.json");
    let sizes = ["--seed", "4", "--sequences", "4", "--frames", "18", "--resolution", "16", "--spp", "1"];
    succeed(&[&["dataset", "plan", "--denoise", "none", "-o", file.to_str().unwrap()][..], &sizes].concat());
    Plan::read(&file).unwrap()
}

#[test]
fn sequences_are_bare_or_full_small_or_large_and_may_be_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, cancel) = (tiny_plan(folder.path()), Cancel::default());
    let quick = Recipe { truth_spp: 2, bare_spp: 1, key_spp: 4, frames: 1, samples: Some([1; 4]), ..Recipe::default() };
    let records = |i: u64, bare: f64, skip: u64| -> Vec<Record<f32>> {
        let recipe = Recipe { bare, skip, ..quick.clone() };
        Planned::new(&plan, [0, 3], recipe, &cancel).records(i).unwrap()
    };
    let groups = |records: &[Record<f32>]| records.iter().map(Record::groups).collect::<Vec<_>>();

    // Two keyframes, then a frame between them.
    let (bare, full) = (groups(&records(1, 1.0, 0)), groups(&records(1, 0.0, 0)));
    assert_eq!((bare.len(), full.len()), (3, 3));
    assert!(bare.iter().chain(&full).all(|groups| groups.deferred), "every record is shaded");
    assert!(bare.iter().all(|groups| !groups.samples && !groups.denoised && !groups.keys), "{bare:?}");
    assert!(full[2].keys && full[2].samples && full[2].neighbours, "{full:?}");

    // A bare sequence may have keyframes, which have more samples. Nothing else about it changes.
    let keyed = Recipe { bare: 1.0, keyed: 1.0, ..quick.clone() };
    let keyed = Planned::new(&plan, [0, 3], keyed, &cancel).records(1).unwrap();
    let found = groups(&keyed);
    assert!(found[2].keys && !found[2].samples && !found[2].denoised && !found[0].keys, "{found:?}");
    let truth = |record: &Record<f32>| -> Vec<f32> {
        record.pixels.chunks_exact(at::COUNT).flat_map(|pixel| pixel[at::TRUTH..].to_vec()).collect()
    };
    let same: Vec<bool> = keyed.iter().zip(&records(1, 1.0, 0)).map(|(keyed, bare)| truth(keyed) == truth(bare)).collect();
    assert_eq!(same, [false, false, true]);

    // Keyframes of sequences with samples have their own number, too.
    let more = Recipe { key_spp: 8, ..quick.clone() };
    let more = Planned::new(&plan, [0, 3], more, &cancel).records(1).unwrap();
    let same: Vec<bool> = more.iter().zip(&records(1, 0.0, 0)).map(|(more, full)| truth(more) == truth(full)).collect();
    assert_eq!(same, [false, false, true]);

    // A single one has samples of its own frames alone, and its keyframes are left out. Nothing else about its frames changes.
    let single = Recipe { single: 1.0, ..quick.clone() };
    let single = Planned::new(&plan, [0, 3], single, &cancel).records(1).unwrap();
    let found = groups(&single);
    assert_eq!(found.len(), 1);
    assert!(found[0].samples && !found[0].keys && !found[0].neighbours, "{found:?}");
    let whole = &records(1, 0.0, 0)[2];
    assert_eq!(single[0].denoised[..AROUND], whole.denoised[..AROUND]);
    for (single, whole) in single[0].pixels.chunks_exact(at::COUNT).zip(whole.pixels.chunks_exact(at::COUNT)) {
        for same in [0..at::KEYS, at::SAMPLES..at::NEARBY, at::DENOISED..at::DENOISED + 3 * AROUND, at::TRUTH..at::COUNT] {
            assert_eq!(single[same.clone()], whole[same]);
        }
    }

    // So has one of a plan without frames between keyframes.
    for frames in [1, 2] {
        let plan = Plan { frames, ..plan.clone() };
        let of = |single: f64| {
            let recipe = Recipe { single, ..quick.clone() };
            groups(&Planned::new(&plan, [0, 3], recipe, &cancel).records(1).unwrap())
        };
        let (single, whole) = (of(1.0), of(0.0));
        assert!(single.len() == 1 && single[0].samples && !single[0].keys, "{single:?}");
        assert!(whole.iter().all(|groups| !groups.samples), "{whole:?}");
    }

    // Samples that are spread: half to four times the number of each part, in all parts of more than one sample; OIDN's pictures
    // and the G-buffer follow.
    let spread = |adaptive: f64, samples: [u32; 4]| {
        let recipe = Recipe { adaptive, single: 1.0, samples: Some(samples), ..quick.clone() };
        Planned::new(&plan, [0, 3], recipe, &cancel).records(1).unwrap().remove(0)
    };
    for samples in [[8, 1, 2, 4], [4, 2, 1, 8]] {
        let (even, record) = (spread(0.0, samples), spread(1.0, samples));
        assert_eq!((even.parts, record.parts, even.spread.len()), (samples, samples, 0));
        assert_eq!(record.spread.len(), 256);
        assert!(record.spread.iter().all(|spread| [0.5, 1.0, 2.0, 4.0].contains(spread)), "{:?}", record.spread);
        assert!(record.spread.iter().any(|spread| *spread != 1.0));
        for (part, spp) in samples.into_iter().enumerate() {
            let values = at::SAMPLES + 4 * part..at::SAMPLES + 4 * part + 4;
            let same =
                |at: usize| even.pixels[at * at::COUNT..][values.clone()] == record.pixels[at * at::COUNT..][values.clone()];
            // Their divisors depend on the G-buffer.
            assert!((0..256).all(same) == (spp == 1) || samples[0] == 8, "{samples:?}: {spp} samples");
        }
        let guides = |record: &Record<f32>| record.pixels.chunks_exact(at::COUNT).map(|p| p[at::ALBEDO]).collect::<Vec<_>>();
        assert_eq!(guides(&even) == guides(&record), samples[0] < 8, "{samples:?}");
    }

    // Some of many sequences are bare, the same ones each time.
    let kinds = || (0..8).map(|i| groups(&records(i, 0.5, 0))[2].samples).collect::<Vec<_>>();
    let found = kinds();
    assert!(found.contains(&true) && found.contains(&false), "{found:?}");
    assert_eq!(found, kinds());

    // So are some of half the size.
    let sides = |small: f64, full: bool| {
        let recipe = Recipe { small, bare: if full { 0.0 } else { 1.0 }, ..quick.clone() };
        let planned = Planned::new(&plan, [0, 3], recipe, &cancel);
        let side = |i: u64| {
            let records = planned.records(i).unwrap();
            assert!(records.iter().all(|record| record.width == record.height && record.width == records[0].width));
            records[0].width
        };
        (0..if full { 1 } else { 8 }).map(side).collect::<Vec<_>>()
    };
    let mixed = sides(0.5, false);
    assert!(mixed.contains(&16) && mixed.contains(&8), "{mixed:?}");
    assert_eq!(mixed, sides(0.5, false));
    assert_eq!((sides(0.0, true), sides(1.0, true)), (vec![16], vec![8]));

    // The first sequence after two that are passed over is the third.
    let (passed, third) = (records(0, 1.0, 2), records(2, 1.0, 0));
    assert!(passed.iter().zip(&third).all(|(a, b)| a.pixels == b.pixels));
    assert!(passed[2].pixels != records(0, 1.0, 0)[2].pixels);

    // After two sequences, the first one comes again; and what was kept serves a run that passes others over.
    let kept = folder.path().join("kept");
    let run = |skip: u64| Recipe { bare: 1.0, skip, count: NonZeroU64::new(2), ..quick.clone() };
    let of = |skip: u64, i: u64| {
        let planned = Planned::new(&plan, [0, 3], run(skip), &cancel);
        Kept::new(&planned, &kept).unwrap().records(i).unwrap()
    };
    assert!(of(0, 0)[2].pixels == of(0, 2)[2].pixels && of(0, 0)[2].pixels != of(0, 1)[2].pixels);
    assert!(of(1, 0)[2].pixels == of(0, 1)[2].pixels);
    assert_eq!(common::files(&kept).len(), 2);
}

/// OIDN's pictures with the samples of frames before are nearer to the truth than its pictures of the frame's own samples, and
/// those with frames after as well are nearer still.
#[test]
fn frames_around_bring_pictures_nearer_to_the_truth() {
    if Denoiser::new().is_err() {
        return println!("skipped: OIDN is not found");
    }
    let folder = tempfile::tempdir().unwrap();
    let (plan, cancel) = (tiny_plan(folder.path()), Cancel::default());
    let recipe = Recipe { truth_spp: 64, frames: 2, samples: Some([1; 4]), ..Recipe::default() };
    let planned = Planned::new(&plan, [0, 3], recipe, &cancel);
    let mut errors = [0.0; 3];
    for i in 0..3 {
        for record in &planned.records(i).unwrap()[2..] {
            assert!([0, AROUND, ALL_BEFORE].iter().all(|place| record.denoised[*place]));
            for pixel in record.pixels.chunks_exact(at::COUNT) {
                // Denoised surfaces may be negative where the background is bright.
                let curve = |from: usize| [0, 1, 2].map(|c| pixel[from + c].max(0.0).ln_1p());
                let truth = curve(at::TRUTH);
                for (error, place) in errors.iter_mut().zip([AROUND, ALL_BEFORE, 0]) {
                    let drawn = curve(at::DENOISED + 3 * place);
                    *error += (0..3).map(|c| (drawn[c] - truth[c]).powi(2)).sum::<f32>();
                }
            }
        }
    }
    assert!(errors.is_sorted_by(|a, b| a < b), "{errors:?}");
}

/// A bare sequence under other lights: the surfaces stay, and everything that light makes changes. Its own light comes first.
#[test]
fn sequences_may_be_shown_under_other_lights() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, cancel) = (tiny_plan(folder.path()), Cancel::default());
    let quick = Recipe { truth_spp: 2, bare_spp: 64, key_spp: 64, frames: 1, samples: Some([1; 4]), ..Recipe::default() };
    let records = |bare: f64, relit: u32| {
        let recipe = Recipe { bare, keyed: 1.0, relit, ..quick.clone() };
        Planned::new(&plan, [0, 3], recipe, &cancel).records(1).unwrap()
    };
    let (own, all) = (records(1.0, 0), records(1.0, 1));
    assert_eq!((own.len(), all.len()), (3, 6));
    assert!(own.iter().zip(&all).all(|(a, b)| a.pixels == b.pixels), "the scene's own light comes first");
    let of = |record: &Record<f32>, from: usize, to: usize| -> Vec<f32> {
        record.pixels.chunks_exact(at::COUNT).flat_map(|pixel| pixel[from..to].to_vec()).collect()
    };
    for (i, record) in all.iter().enumerate().skip(3) {
        let same = &all[i % 3];
        assert_eq!(record.groups(), same.groups());
        assert!(of(record, 0, at::BACKGROUND) == of(same, 0, at::BACKGROUND), "surfaces change");
        for (from, to) in [(at::TERMS, at::SKY), (at::SKY, at::OPEN), (at::TRUTH, at::RAW_TRUTH), (at::RAW_TRUTH, at::COUNT)] {
            assert!(of(record, from, to) != of(same, from, to), "{i}: {from}..{to} stays");
        }
        // Deferred shading follows the truth from light to light.
        let sum = |from: usize, to: usize| of(record, from, to).iter().map(|&v| f64::from(v)).sum::<f64>();
        let ratio = sum(at::TERMS, at::SKY) / sum(at::TRUTH, at::RAW_TRUTH);
        assert!(ratio > 0.5 && ratio < 2.0, "{i}: {ratio}");
    }
    assert_eq!(records(0.0, 1).len(), 3, "sequences with samples have their own light alone");
}

/// Frames that are not shaded show the same surfaces and have the same truth.
#[test]
fn sequences_may_do_without_deferred_shading() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, cancel) = (tiny_plan(folder.path()), Cancel::default());
    let records = |deferred: bool| {
        let recipe = Recipe { bare: 1.0, bare_spp: 2, frames: 1, relit: 1, deferred, ..Recipe::default() };
        Planned::new(&plan, [0, 3], recipe, &cancel).records(1).unwrap()
    };
    let (with, without) = (records(true), records(false));
    assert_eq!((with.len(), without.len()), (6, 6));
    for (with, without) in with.iter().zip(&without) {
        assert!(with.groups().deferred && !without.groups().deferred);
        for (a, b) in with.pixels.chunks_exact(at::COUNT).zip(without.pixels.chunks_exact(at::COUNT)) {
            assert!(a[..at::LIT] == b[..at::LIT] && a[at::TRUTH..] == b[at::TRUTH..]);
            assert!(b[at::LIT..at::TRUTH].iter().all(|v| *v == 0.0));
        }
    }
}
