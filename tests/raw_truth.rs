//! Truth before it was denoised: what pictures are compared with, and what networks learn from.

mod common;

use common::{renderflow, succeed};
use renderflow::dataset::learning::{Planned, Recipe};
use renderflow::dataset::plan::Plan;
use renderflow::evaluate::results::{Results, Score};
use renderflow::util::cancel::Cancel;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, exr};
use renderflow_model::fusion::record::at;
use renderflow_renderer::denoise::Denoiser;
use std::path::{Path, PathBuf};

/// A plan of one test sequence of five frames that are not denoised.
fn plan(folder: &Path, seed: &str, side: u32) -> PathBuf {
    let path = folder.join("plan.json");
    let arguments = ["dataset", "plan", "--seed", seed, "--split", "test", "--sequences", "1", "--frames", "5", "--spp", "4"];
    let side = side.to_string();
    let others = ["--resolution", &side, "--keyframe-gap", "4", "--denoise", "none", "--out", path.to_str().unwrap()];
    succeed(&[&arguments[..], &others].concat());
    path
}

/// Scores without their seconds.
fn scores(results: &str) -> Vec<Score> {
    let results = Results::read(Path::new(results)).unwrap();
    let scores = results.sequences.into_iter().flat_map(|sequence| sequence.scores);
    scores.map(|score| Score { seconds: None, ..score }).collect()
}

/// The truth is kept as it was traced beside what OIDN makes of it, under every light. On average both are as bright, and the
/// former changes more from pixel to pixel.
#[test]
fn truth_is_kept_as_it_was_traced_too() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, cancel) = (Plan::read(&plan(folder.path(), "4", 32)).unwrap(), Cancel::default());
    let recipe = Recipe { bare: 1.0, bare_spp: 4, frames: 1, relit: 1, deferred: false, ..Recipe::default() };
    for record in Planned::new(&plan, [0, 1], recipe, &cancel).records(0).unwrap() {
        let of = |from: usize| -> Vec<f32> { record.pixels.chunks_exact(at::COUNT).map(|pixel| pixel[from].ln_1p()).collect() };
        let (clean, raw) = (of(at::TRUTH), of(at::RAW_TRUTH));
        if Denoiser::new().is_err() {
            assert!(clean == raw);
            continue;
        }
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let change = |values: &[f32]| values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f32>();
        assert!((mean(&clean) / mean(&raw) - 1.0).abs() < 0.1, "{} and {}", mean(&clean), mean(&raw));
        assert!(change(&raw) > 1.1 * change(&clean), "{} and {}", change(&raw), change(&clean));
    }
}

/// Beside the raw truth, pictures have the scores that they have where nothing was denoised. A truth that was denoised and kept
/// nothing else is refused, and so is a folder with scores of the other truth.
#[test]
fn the_truth_may_be_the_one_before_it_was_denoised() {
    let folder = tempfile::tempdir().unwrap();
    let plan = plan(folder.path(), "9", 48);
    let place = folder.path().join("data");
    succeed(&["dataset", "render", "--plan", plan.to_str().unwrap(), "--out", place.to_str().unwrap()]);
    let data = place.join("test/seq-000000");
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let run = |out: &str, options: &[&str]| {
        let from = ["evaluate", "--data", data.to_str().unwrap(), "--methods", "ibl", "--pictures-kept", "0", "--out"];
        renderflow(&[&from[..], &[&path(out)], options].concat())
    };
    assert!(run("plain", &[]).status.success());
    let plain = scores(&path("plain"));
    // No record, so that frames may change.
    std::fs::remove_file(data.join("sequence.json")).unwrap();
    let change = |change: &dyn Fn(&mut Frame)| {
        for number in 0..5 {
            let file = data.join(format!("frame.{number:04}.exr"));
            let mut frame = exr::read(&file).unwrap();
            change(&mut frame);
            exr::write(&file, &frame).unwrap();
        }
    };
    change(&|frame| {
        let grey = Rgb::filled(frame.width, frame.height, [0.25; 3]);
        frame.raw = frame.beauty.replace(grey);
        frame.info.denoiser = Some("a test".into());
    });
    for (out, options) in [("denoised", &[][..]), ("raw", &["--raw-truth"])] {
        let output = run(out, options);
        assert!(output.status.success(), "{}", common::stderr(&output));
    }
    let [denoised, raw] = ["denoised", "raw"].map(|out| scores(&path(out)));
    assert_eq!(raw, plain);
    assert!(denoised.iter().zip(&plain).all(|(grey, plain)| grey.values["psnr"] != plain.values["psnr"]));
    let mixed = run("denoised", &["--raw-truth"]);
    assert!(common::stderr(&mixed).contains("other methods or settings"), "{}", common::stderr(&mixed));
    change(&|frame| frame.raw = None);
    let refused = run("lost", &["--raw-truth"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(common::stderr(&refused).contains("frame 0: does not hold its truth before"), "{}", common::stderr(&refused));
}

/// A run that learns from denoised truth does not go on where OIDN is not found.
#[test]
fn a_run_keeps_its_denoiser() {
    if Denoiser::new().is_err() {
        return println!("skipped: OIDN is not found");
    }
    let folder = tempfile::tempdir().unwrap();
    let [options, plan, run] = ["options.json", "learnt.json", "run"].map(|name| folder.path().join(name));
    let [options, plan, run] = [&options, &plan, &run].map(|path| path.to_str().unwrap());
    let sizes = ["--sequences", "2", "--frames", "3", "--resolution", "32", "--spp", "1", "--seed", "2"];
    succeed(&[&["dataset", "plan", "--denoise", "none", "--out", plan][..], &sizes].concat());
    let train = |steps: u64, without: bool| {
        common::write_training(Path::new(options), steps);
        let mut program = std::process::Command::new(env!("CARGO_BIN_EXE_renderflow"));
        program.args(["train", "--config", options, "--plan", plan, "--out", run]);
        if without {
            program.env("RENDERFLOW_OIDN", folder.path().join("absent"));
        }
        program.output().unwrap()
    };
    let began = train(1, false);
    assert!(began.status.success(), "{}", common::stderr(&began));
    let refused = train(2, true);
    assert_eq!(refused.status.code(), Some(1));
    assert!(common::stderr(&refused).contains("is not what the run in"), "{}", common::stderr(&refused));
    let goes_on = train(2, false);
    assert!(goes_on.status.success(), "{}", common::stderr(&goes_on));
}
