//! Evaluation through the binary: methods on a test set, resumed; anybody's pictures; a set that is made and proved.

mod common;

use common::{fail, renderflow, succeed};
use renderflow::dataset::Shard;
use renderflow::dataset::denoise::Denoise;
use renderflow::dataset::layout::AUDIT;
use renderflow::dataset::plan::Plan;
use renderflow::dataset::testset::{Extent, SET, make_plans};
use renderflow::evaluate::find::find;
use renderflow::evaluate::results::{Results, Score};
use renderflow::util::cancel::Cancel;
use renderflow_frame::{color, exr, frame_file};
use renderflow_model::fusion::{Fusion, FusionConfig};
use renderflow_model::weights::Precision;
use std::path::{Path, PathBuf};

/// A plan of one tiny sequence of five frames, keyframes at both ends.
fn plan(folder: &Path, seed: &str) -> PathBuf {
    let path = folder.join(format!("plan-{seed}.json"));
    let arguments = ["dataset", "plan", "--seed", seed, "--split", "test", "--sequences", "1", "--frames", "5"];
    let size = ["--resolution", "48", "--spp", "4", "--keyframe-gap", "4", "--denoise", "none", "--out", path.to_str().unwrap()];
    succeed(&[&arguments[..], &size].concat());
    // Objects on a ground, and a camera that turns around them.
    let mut plan: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let composition = &mut plan["composition"];
    composition["layouts"] = serde_json::json!({ "ground": 1.0, "room": 0.0, "outdoor": 0.0 });
    composition["cameras"] = serde_json::json!({ "orbit": 1.0, "dolly": 0.0, "handheld": 0.0, "fixed": 0.0 });
    std::fs::write(&path, plan.to_string()).unwrap();
    path
}

/// A set of two classes of a tiny sequence each: `set/near` and `set/far`.
fn set(folder: &Path) -> PathBuf {
    for (class, seed) in [("near", "9"), ("far", "4")] {
        let out = folder.join("sets/tiny").join(class);
        succeed(&["dataset", "render", "--plan", plan(folder, seed).to_str().unwrap(), "--out", out.to_str().unwrap()]);
    }
    folder.join("sets")
}

/// Scores without their seconds.
fn scores(results: &Path) -> Vec<Vec<Score>> {
    let results = Results::read(results).unwrap();
    let without = |scores: Vec<Score>| scores.into_iter().map(|score| Score { seconds: None, ..score }).collect();
    results.sequences.into_iter().map(|sequence| without(sequence.scores)).collect()
}

#[test]
fn methods_are_scored_on_sets_and_classes_and_work_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path());
    let out = folder.path().join("results");
    let run = |out: &Path, methods: &str, threads: &str| {
        let (data, out) = (data.to_str().unwrap(), out.to_str().unwrap());
        renderflow(&["--threads", threads, "evaluate", "--data", data, "--methods", methods, "--out", out])
    };
    let methods = "ibl,deferred,deferred-shadows,warp,neural,neural+keys,pt4";
    let first = run(&out, methods, "2");
    assert!(first.status.success(), "{}", common::stderr(&first));
    let table = String::from_utf8_lossy(&first.stdout).into_owned();
    for row in ["tiny", "IBL (split sum)", "Deferred, no shadows", "warped keyframes + Deferred", "neural + keyframes", "4 spp"] {
        assert!(table.contains(row), "{row} missing in\n{table}");
    }
    let all = scores(&out);
    let names: Vec<String> = Results::read(&out).unwrap().sequences.iter().map(|s| s.about.class.clone()).collect();
    assert_eq!(names, ["far", "near"]);
    for sequence in &all {
        assert_eq!(sequence.len(), 5 * 7);
        for score in sequence {
            let value = |id: &str| score.values.get(id).copied();
            assert_eq!(score.key, score.frame % 4 == 0);
            assert!(value("psnr").is_some_and(|v| v > 5.0) && value("rel_mse").is_some_and(|v| v >= 0.0), "{score:?}");
            assert!(value("ssim").is_some() && value("flip").is_some(), "{score:?}");
            assert_eq!(value("temporal").is_some(), score.frame > 0, "{score:?}");
            assert_eq!(score.spp, (score.method == "pt4").then_some(4));
            // The truth has 4 samples per pixel, too: they must be others.
            assert!(score.method != "pt4" || value("psnr").is_some_and(|v| v < 50.0), "{score:?}");
            // Keyframes are what they are carried to.
            let carried = score.key && matches!(score.method.as_str(), "warp" | "neural+keys");
            assert_eq!(value("psnr") == Some(100.0), carried, "{score:?}");
        }
    }
    // Seconds of other threads do not mix in.
    let mixed = run(&out, methods, "1");
    assert!(!mixed.status.success() && common::stderr(&mixed).contains("2 threads, and these"), "{}", common::stderr(&mixed));
    let about = std::fs::read_to_string(out.join("results.json")).unwrap();
    // As older programs wrote it.
    std::fs::write(out.join("results.json"), about.replace("2 threads", "1 threads")).unwrap();
    // A sequence that is missing is made again, the others are kept; threads change nothing but seconds.
    let kept = out.join("tiny/far/seq-000000.jsonl");
    let before = std::fs::read(&kept).unwrap();
    std::fs::remove_file(out.join("tiny/near/seq-000000.json")).unwrap();
    assert!(run(&out, methods, "1").status.success());
    assert_eq!(scores(&out), all);
    assert_eq!(std::fs::read(&kept).unwrap(), before);
    assert!(Results::read(&out).unwrap().about.machine.ends_with(", 1 thread"));
    // Other methods do not mix in.
    let other = run(&out, "ibl,neural", "1");
    assert!(common::stderr(&other).contains("other methods"), "{}", common::stderr(&other));
    let report = folder.path().join("report");
    succeed(&["report", out.to_str().unwrap(), "--out", report.to_str().unwrap()]);
    assert!(report.join("index.html").is_file() && report.join("tiny-near-seq-000000.html").is_file());
}

#[test]
fn results_of_other_data_are_made_again_and_those_of_other_sequences_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path());
    let out = folder.path().join("results");
    let run = |data: &Path| {
        let [data, out] = [data, &out].map(|path| path.to_str().unwrap());
        let output = renderflow(&["evaluate", "--data", data, "--methods", "ibl", "--out", out]);
        assert!(output.status.success(), "{}", common::stderr(&output));
        common::stderr(&output)
    };
    run(&data);
    let [far, near] = <[Vec<Score>; 2]>::try_from(scores(&out)).unwrap();
    assert_ne!(far, near);
    // Another sequence of the same name, with frames of the same numbers.
    let [from, to] = ["far", "near"].map(|class| data.join("tiny").join(class));
    std::fs::remove_dir_all(&to).unwrap();
    common::copy(&from, &to);
    let kept = out.join("tiny/far/seq-000000.jsonl");
    let before = std::fs::read(&kept).unwrap();
    run(&data);
    assert_eq!(scores(&out), [far.clone(), far.clone()]);
    assert_eq!(std::fs::read(&kept).unwrap(), before, "it was made again");
    // One frame is another one, and no record says so.
    for name in ["sequence.json", "frame.0001.exr"] {
        std::fs::remove_file(to.join("test/seq-000000").join(name)).unwrap();
    }
    std::fs::copy(to.join("test/seq-000000/frame.0002.exr"), to.join("test/seq-000000/frame.0001.exr")).unwrap();
    run(&data);
    let [first, second] = <[Vec<Score>; 2]>::try_from(scores(&out)).unwrap();
    assert!(first == far && second != far);
    // A part of the data: what is there of the rest stays, and no table counts it, until all is asked for again.
    let said = run(&data.join("tiny/near"));
    assert!(said.contains("2 of the results are of sequences or data"), "{said}");
    assert_eq!(scores(&out), std::slice::from_ref(&second));
    run(&data);
    assert_eq!(scores(&out), [first, second]);
    assert_eq!(std::fs::read(&kept).unwrap(), before, "it was made again");
    // Results from before: nobody knows of what data they are.
    for (name, key) in [("results.json", "sequences"), ("tiny/far/seq-000000.json", "data")] {
        let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join(name)).unwrap()).unwrap();
        value.as_object_mut().unwrap().remove(key).unwrap();
        std::fs::write(out.join(name), value.to_string()).unwrap();
    }
    assert_eq!(scores(&out).len(), 3);
    run(&data);
    assert!(std::fs::read(&kept).unwrap() != before && scores(&out)[0] == far);
}

#[test]
fn weights_with_the_same_header_and_other_values_do_not_mix() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path()).join("tiny/near");
    let [one, other, out] = ["one.safetensors", "other.safetensors", "results"].map(|name| folder.path().join(name));
    Fusion::untrained(&FusionConfig::default(), 0).unwrap().save(&one, Precision::F16).unwrap();
    let mut bytes = std::fs::read(&one).unwrap();
    let last = bytes.len() - 2;
    bytes[last] ^= 1;
    std::fs::write(&other, bytes).unwrap();
    let run = |weights: &Path| {
        let [data, out, weights] = [data.as_path(), out.as_path(), weights].map(|path| path.to_str().unwrap());
        let methods = ["evaluate", "--data", data, "--methods", "neural", "--every", "5"];
        renderflow(&[&methods[..], &["--weights", weights, "--out", out]].concat())
    };
    assert!(run(&one).status.success());
    let refused = run(&other);
    assert!(common::stderr(&refused).contains("other methods or settings"), "{}", common::stderr(&refused));
    let about = Results::read(&out).unwrap().about;
    let named = about.settings.iter().find(|(name, _)| name == "network, BLAKE3").map(|(_, hash)| hash.as_str());
    assert_eq!(named, Some(blake3::hash(&std::fs::read(&one).unwrap()).to_hex().as_str()));
}

/// An untrained network draws deferred shading, so keyframes carried over its picture are those carried over deferred shading.
#[test]
fn keyframes_are_carried_over_the_picture_of_the_network() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path()).join("tiny/near/test");
    let (weights, out) = (folder.path().join("untrained.safetensors"), folder.path().join("results"));
    Fusion::untrained(&FusionConfig::default(), 0).unwrap().save(&weights, Precision::F16).unwrap();
    let [data, weights, results] = [&data, &weights, &out].map(|path| path.to_str().unwrap());
    let rows = "deferred,neural,warp,neural+keys";
    succeed(&["evaluate", "--data", data, "--methods", rows, "--weights", weights, "--out", results]);
    let scores = scores(&out).concat();
    let psnr = |method: &str| -> Vec<f64> {
        let own = scores.iter().filter(|score| score.method == method && !score.key);
        own.map(|score| score.values["psnr"]).collect()
    };
    for [plain, drawn] in [["deferred", "neural"], ["warp", "neural+keys"]] {
        let (plain, drawn) = (psnr(plain), psnr(drawn));
        assert_eq!(plain.len(), 3);
        assert!(plain.iter().zip(&drawn).all(|(a, b)| (a - b).abs() < 1e-4), "{plain:?} {drawn:?}");
    }
    assert!(psnr("warp").iter().zip(psnr("deferred")).all(|(carried, plain)| *carried > plain + 0.01));
}

/// What `infer` writes is what is evaluated, whatever the threads and however often it is stopped.
#[test]
fn the_network_renders_sequences_from_their_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path()).join("tiny/near");
    let sequence = data.join("test/seq-000000");
    let run = |out: &str, threads: &str, more: &[&str]| {
        let (data, out) = (data.join("test"), folder.path().join(out));
        let common = ["--threads", threads, "infer", "--data", data.to_str().unwrap(), "--out", out.to_str().unwrap()];
        renderflow(&[&common[..], more].concat())
    };
    let picture = |folder: &Path, frame: usize| exr::read(&folder.join(format!("frame.{frame:04}.exr"))).unwrap().beauty.unwrap();
    let forms: [(&str, &[&str]); 4] = [
        ("plain", &[]),
        ("keyed", &["--keyframes"]),
        ("traced", &["--rays", "2"]),
        ("around", &["--rays", "2", "--neighbours", "around", "--keyframes"]),
    ];
    for (out, more) in forms {
        let output = run(out, "2", more);
        assert!(output.status.success(), "{}", common::stderr(&output));
        let made = folder.path().join(out).join("seq-000000");
        for frame in 0..5 {
            let linear = picture(&made, frame);
            assert!(linear.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{out} {frame}");
            // A keyframe is its truth.
            let carried = frame % 4 == 0 && more.contains(&"--keyframes");
            assert_eq!(linear == picture(&sequence, frame), carried, "{out} {frame}");
        }
    }
    // It goes on where it was stopped, and the pictures do not depend on where that was.
    let around = folder.path().join("around/seq-000000/frame.0002.exr");
    let before = std::fs::read(&around).unwrap();
    std::fs::remove_file(&around).unwrap();
    assert!(run("around", "1", forms[3].1).status.success());
    assert!(std::fs::read(&around).unwrap() == before);
    // So do other weights inside the program.
    let (record, inside) = (folder.path().join("plain/infer.json"), "/model/weights/fusion.safetensors");
    let weights = std::fs::read(format!("{}{inside}", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let (told, digest) = (std::fs::read_to_string(&record).unwrap(), blake3::hash(&weights).to_hex().to_string());
    assert!(told.contains(&digest), "{told}");
    std::fs::write(&record, told.replace(&digest, &blake3::hash(b"other").to_hex())).unwrap();
    assert!(common::stderr(&run("plain", "1", &[])).contains("other weights or options"));
    std::fs::write(&record, told).unwrap();
    // Another number of samples makes other pictures.
    assert!(common::stderr(&run("traced", "1", &["--rays", "3"])).contains("other weights or options"));
    assert!(common::stderr(&run("none", "1", &["--stills"])).contains("--stills: is for"));
    // So does another frame in the same place.
    let (first, kept) = (sequence.join("frame.0001.exr"), folder.path().join("kept.exr"));
    std::fs::rename(&first, &kept).unwrap();
    std::fs::copy(sequence.join("frame.0002.exr"), &first).unwrap();
    assert!(common::stderr(&run("plain", "1", &[])).contains("pictures of another seq-000000"));
    std::fs::rename(&kept, &first).unwrap();
    assert!(run("plain", "1", &[]).status.success());
    std::fs::remove_file(sequence.join("scene.json")).unwrap();
    assert!(common::stderr(&run("none", "1", &[])).contains("has no scene.json"));
    assert!(!folder.path().join("none").exists());
}

#[test]
fn path_tracing_gets_the_seconds_of_another_method() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path());
    let out = folder.path().join("results");
    let (data, out_name) = (data.join("tiny/near"), out.to_str().unwrap());
    if renderflow_renderer::denoise::Denoiser::new().is_err() {
        return println!("skipped: OIDN is not found");
    }
    let clean = "equal-pt64";
    succeed(&["evaluate", "--data", data.to_str().unwrap(), "--methods", clean, "--out", out_name]);
    let results = Results::read(&out).unwrap();
    // The dataset itself: its split is no class.
    let about = &results.sequences[0].about;
    assert_eq!((about.set.as_str(), about.class.as_str()), ("near", "ground"));
    let equal: Vec<&Score> = results.sequences[0].scores.iter().filter(|score| score.method == clean).collect();
    assert_eq!(equal.len(), 5);
    assert!(equal.iter().all(|score| score.spp.is_some_and(|spp| (1..=65536).contains(&spp))), "{equal:?}");
}

#[test]
fn neighbours_samples_help_and_budgets_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path()).join("tiny/near");
    if renderflow_renderer::denoise::Denoiser::new().is_err() {
        return println!("skipped: OIDN is not found");
    }
    let run = |out: &str, threads: &str, more: &[&str]| -> (Results, String) {
        let out = folder.path().join(out);
        let methods = "warp,pt2+oidn,pt2+oidn+gbuffer,pt2+oidn+around,pt2+oidn+before,pt2+oidn+gbuffer+around,\
                       pt2+adaptive+oidn+gbuffer+around,pt2+adaptive+neural+around,pt8+adaptive+oidn+neural";
        let data = ["--threads", threads, "evaluate", "--data", data.to_str().unwrap(), "--methods", methods];
        let text = succeed(&[&data[..], &["--out", out.to_str().unwrap()], more].concat());
        (Results::read(&out).unwrap(), text)
    };
    let (all, table) = run("all", "2", &["--budgets", ".3"]);
    let scores = &all.sequences[0].scores;
    let values = |scores: &[Score], method: &str, frame: usize| -> Score {
        scores.iter().find(|score| score.method == method && score.frame == frame).unwrap().clone()
    };
    let psnr = |method: &str, frame: usize| values(scores, method, frame).values["psnr"];
    // Four frames' samples beside its own, or two; the first frame has none before.
    assert!(psnr("pt2+oidn+around", 2) > psnr("pt2+oidn", 2) && psnr("pt2+oidn+before", 2) > psnr("pt2+oidn", 2));
    assert_eq!(psnr("pt2+oidn+before", 0), psnr("pt2+oidn", 0));
    assert!((0..5).all(|frame| psnr("pt2+oidn+gbuffer", frame) != psnr("pt2+oidn", frame)), "guides of other rays");
    assert_ne!(psnr("pt2+adaptive+oidn+gbuffer+around", 2), psnr("pt2+oidn+gbuffer+around", 2));
    // Counts give the same pictures whichever frames are evaluated, on any threads.
    let (some, _) = run("some", "1", &["--every", "3"]);
    assert_eq!(some.sequences[0].about.frames, [0, 1, 3, 4]);
    for score in
        some.sequences[0].scores.iter().filter(|score| score.method.starts_with("pt2") || score.method.starts_with("pt8"))
    {
        let mut expected = values(scores, &score.method, score.frame).values;
        // Of frame 3 the frame before is not evaluated.
        expected.retain(|metric, _| score.values.contains_key(metric));
        assert_eq!(score.values, expected, "{} of frame {}", score.method, score.frame);
        assert_eq!(score.spp, Some(if score.method.starts_with("pt2") { 2 } else { 8 }));
    }
    // The seconds are those of 256 x 256 pixels: 48 x 48 get a 28th of them, which is hardly a sample and a denoiser.
    let budget: Vec<&Score> = scores.iter().filter(|score| score.method.starts_with("pt-300ms+")).collect();
    assert_eq!(budget.len(), 5 * 8);
    assert!(budget.iter().all(|score| score.spp.is_some_and(|spp| (1..=4096).contains(&spp))), "{budget:?}");
    // Frames 0 and 4 are keyframes.
    let about = &all.sequences[0].about;
    assert_eq!(about.keyframe_gap, Some(4.0));
    assert_eq!(about.truth_share(), about.truth.keyframe_seconds.map(|seconds| seconds / 4.0));
    assert!(about.truth.keyframe_seconds.is_some_and(|seconds| seconds > 0.0));
    for row in ["s/frame with truth", "2 spp + OIDN, guided by a G-buffer", "path traced + OIDN fast, frames before in 0.3 s ("] {
        assert!(table.contains(row), "{row} missing in\n{table}");
    }
}

/// Truth of `set`'s near class as PNG (16 bits) named by `name`, in `out`.
fn write_pngs(sequence: &Path, out: &Path, name: impl Fn(usize) -> String) {
    std::fs::create_dir_all(out).unwrap();
    let folder = renderflow::dataset::Sequence::open(sequence).unwrap();
    for number in 0..folder.len() {
        let frame = folder.frame(number).unwrap();
        let values = frame.beauty.unwrap().pixels.into_iter().flat_map(|p| color::display(p, folder.exposure()));
        let values: Vec<u16> = values.map(|v| (v * 65535.0 + 0.5) as u16).collect();
        let picture = image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(48, 48, values).unwrap();
        picture.save(out.join(name(number))).unwrap();
    }
}

#[test]
fn anybodys_pictures_are_compared_by_name_or_number() {
    let folder = tempfile::tempdir().unwrap();
    let truth = set(folder.path()).join("tiny/near");
    let sequence = truth.join("test/seq-000000");
    let results = folder.path().join("results");
    let compare = |pictures: &Path, truth: &Path, more: &[&str]| {
        let arguments = ["evaluate", pictures.to_str().unwrap(), truth.to_str().unwrap(), "--out", results.to_str().unwrap()];
        // Every comparison has a folder of its own.
        let _ = std::fs::remove_dir_all(&results);
        renderflow(&[&arguments[..], more].concat())
    };
    let values = |id: &str| -> Vec<f64> {
        let scores = scores(&results);
        scores[0].iter().filter_map(|score| score.values.get(id).copied()).collect()
    };
    // By number, in the root, in 16 bits: all but equal.
    let pictures = folder.path().join("mine");
    write_pngs(&sequence, &pictures, |number| format!("out_{number:02}.png"));
    let found = compare(&pictures, &truth, &["--label", "my renderer"]);
    assert!(found.status.success(), "{}", common::stderr(&found));
    assert!(String::from_utf8_lossy(&found.stdout).contains("my renderer"));
    assert!(values("psnr").len() == 5 && values("psnr").iter().all(|v| *v > 90.0), "{:?}", values("psnr"));
    assert!(values("temporal").iter().all(|v| *v < 0.05) && values("temporal").len() == 4);
    assert!(values("rel_mse").is_empty(), "PNG holds no radiance");
    // One too few, and one too many of a number.
    std::fs::remove_file(pictures.join("out_03.png")).unwrap();
    let missing = common::stderr(&compare(&pictures, &truth, &[]));
    assert!(missing.contains("no picture for 1 of the truths") && missing.contains("frame.0003"), "{missing}");
    assert!(compare(&pictures, &truth, &["--partial"]).status.success());
    assert_eq!(values("psnr").len(), 4);
    std::fs::copy(pictures.join("out_02.png"), pictures.join("also_2.png")).unwrap();
    let twice = common::stderr(&compare(&pictures, &truth, &["--partial"]));
    assert!(twice.contains("both end in 2"), "{twice}");
    // Radiance, by name, in the sequence's folder: equal, relative error included.
    let exact = folder.path().join("exact/seq-000000");
    std::fs::create_dir_all(&exact).unwrap();
    for number in 0..5 {
        let file = format!("frame.{number:04}.exr");
        let mut frame = frame_file::read(&sequence.join(&file)).unwrap();
        frame.raw = None;
        exr::write(&exact.join(&file), &frame).unwrap();
    }
    let exact_root = folder.path().join("exact");
    assert!(compare(&exact_root, &truth, &[]).status.success());
    assert!(values("psnr_full") == [100.0; 5] && values("rel_mse") == [0.0; 5]);
    // A dataset says its own exposure.
    let other = compare(&exact_root, &truth, &["--exposure", "2"]);
    assert!(!results.exists() && common::stderr(&other).contains("leave out --exposure"), "{}", common::stderr(&other));
    // A picture in two forms: radiance is compared, and it is said.
    for number in 0..5 {
        image::RgbImage::new(48, 48).save(exact.join(format!("frame.{number:04}.png"))).unwrap();
    }
    let both = compare(&exact_root, &truth, &[]);
    assert!(common::stderr(&both).contains("5 pictures in several forms"), "{}", common::stderr(&both));
    assert!(values("psnr_full") == [100.0; 5] && values("rel_mse") == [0.0; 5]);
    // Also where they are matched by number, and where both sides are plain folders.
    let numbered = folder.path().join("numbered");
    std::fs::create_dir_all(&numbered).unwrap();
    for number in 0..5 {
        for ending in ["exr", "png"] {
            std::fs::copy(exact.join(format!("frame.{number:04}.{ending}")), numbered.join(format!("out_{number}.{ending}")))
                .unwrap();
        }
    }
    assert!(compare(&numbered, &truth, &[]).status.success());
    assert!(values("rel_mse") == [0.0; 5]);
    assert!(compare(&numbered, &exact, &[]).status.success());
    assert!(values("psnr_full") == [100.0; 5] && values("rel_mse") == [0.0; 5]);
    // Which say none, so it can be given.
    assert!(compare(&numbered, &exact, &["--exposure", "2"]).status.success());
    assert_eq!(Results::read(&results).unwrap().sequences[0].about.exposure, 2.0);
    // Plain pictures against plain pictures.
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    write_pngs(&sequence, &a, |number| format!("{number}.png"));
    write_pngs(&sequence, &b, |number| format!("view{}.png", (number + 1) % 5));
    assert!(compare(&a, &b, &[]).status.success());
    assert!(values("psnr").is_empty() && values("psnr_full").iter().all(|v| *v < 60.0));
    // Sizes must agree, and something must fit.
    let small = image::RgbImage::new(8, 8);
    small.save(a.join("2.png")).unwrap();
    let sizes = common::stderr(&compare(&a, &b, &[]));
    assert!(sizes.contains("2.png") && sizes.contains("8 x 8"), "{sizes}");
    let empty = folder.path().join("empty");
    std::fs::create_dir_all(&empty).unwrap();
    assert!(common::stderr(&compare(&empty, &truth, &[])).contains("none of its 0 pictures"));
    assert!(common::stderr(&compare(&a, &empty, &[])).contains("neither sequences nor pictures"));
}

/// Each class of a test set has a sequence of the same name.
#[test]
fn pictures_of_one_of_several_sequences_are_refused_without_its_class() {
    let folder = tempfile::tempdir().unwrap();
    let sets = set(folder.path());
    let (mine, out) = (folder.path().join("mine"), folder.path().join("out"));
    let frames = |class: &str, to: &Path| {
        let sequence = sets.join("tiny").join(class).join("test/seq-000000");
        std::fs::create_dir_all(to).unwrap();
        for number in 0..5 {
            let name = format!("frame.{number:04}.exr");
            std::fs::copy(sequence.join(&name), to.join(&name)).unwrap();
        }
    };
    let paths = [mine.to_str().unwrap(), sets.to_str().unwrap(), out.to_str().unwrap()];
    let compare = ["evaluate", paths[0], paths[1], "--out", paths[2]];
    frames("near", &mine.join("seq-000000"));
    let said = fail(&compare);
    assert!(said.contains("several sequences of the truth have this name"), "{said}");
    std::fs::remove_dir_all(&mine).unwrap();
    for class in ["near", "far"] {
        frames(class, &mine.join(class).join("seq-000000"));
    }
    succeed(&compare);
    let all = scores(&out);
    assert!(all.len() == 2 && all.iter().flatten().all(|score| score.values["psnr"] == 100.0), "{all:?}");

    // More pictures than an earlier run kept are made.
    let results = folder.path().join("results");
    let kept = |count: &str| {
        let from = ["evaluate", "--data", paths[1], "--methods", "ibl", "--every", "4", "--pictures-kept", count];
        succeed(&[&from[..], &["--out", results.to_str().unwrap()]].concat());
        common::files(&results).iter().filter(|(name, _)| name.ends_with(".png")).count()
    };
    assert_eq!(kept("0"), 0);
    assert!(kept("1") > 0);
}

#[test]
fn pictures_that_a_comparison_did_not_see_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let [mine, truth, out] = ["mine", "truth", "results"].map(|name| folder.path().join(name));
    for (root, value) in [(&mine, 100), (&truth, 120)] {
        for name in ["x", "y"] {
            std::fs::create_dir_all(root.join(name)).unwrap();
            image::RgbImage::from_pixel(16, 16, image::Rgb([value; 3])).save(root.join(name).join("1.png")).unwrap();
        }
    }
    let run = || succeed(&["evaluate", mine.to_str().unwrap(), truth.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    assert!(run().contains("truth: 2 sequences, 2 frames"));
    std::fs::remove_dir_all(truth.join("y")).unwrap();
    let table = run();
    assert!(table.contains("truth: 1 sequence, 1 frame"), "{table}");
    assert!(out.join("truth/pictures/y.json").is_file());
}

#[test]
fn two_folders_or_a_data_set_but_not_both() {
    for option in [["--weights", "x"], ["--device", "cpu"], ["--max-bounces", "3"], ["--methods", "ibl"], ["--every", "2"]] {
        let output = renderflow(&[&["evaluate", "a", "b", "--out", "x"][..], &option].concat());
        assert_eq!(output.status.code(), Some(2), "{option:?}: {}", common::stderr(&output));
    }
    for arguments in
        [&["evaluate", "--out", "x"][..], &["evaluate", "a", "--out", "x"], &["evaluate", "a", "b", "--data", "c", "--out", "x"]]
    {
        assert_eq!(renderflow(arguments).status.code(), Some(2), "{arguments:?}");
    }
    for (budgets, code) in [("0", 1), ("-1", 1), ("0.0005", 1), ("many", 2), (".1,nan", 1)] {
        let found = renderflow(&["evaluate", "--data", ".", &format!("--budgets={budgets}"), "--out", "x"]);
        assert_eq!(found.status.code(), Some(code), "{budgets}");
        assert!(common::stderr(&found).contains("--budgets"), "{}", common::stderr(&found));
    }
    let error = fail(&["evaluate", "--data", ".", "--methods", "ibl,magic", "--out", "x"]);
    assert!(error.contains("magic"), "{error}");
}

#[test]
fn a_sequence_without_frames_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data = set(folder.path());
    let path = data.join("tiny/near/test/seq-000000/transforms.json");
    let mut transforms: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    transforms["frames"] = serde_json::json!([]);
    transforms["object_transforms"] = serde_json::json!({});
    transforms["keyframes"] = serde_json::json!([]);
    std::fs::write(&path, transforms.to_string()).unwrap();
    let out = folder.path().join("results");
    let error = fail(&["evaluate", "--data", data.to_str().unwrap(), "--methods", "ibl", "--out", out.to_str().unwrap()]);
    assert!(error.contains("near/test/seq-000000") && error.contains("has no frames"), "{error}");
}

#[test]
fn a_set_is_made_audited_and_proved() {
    let folder = tempfile::tempdir().unwrap();
    let plans: Vec<(&str, Plan)> = [("near", "3"), ("far", "4")]
        .into_iter()
        .map(|(class, seed)| (class, Plan::read(&plan(folder.path(), seed)).unwrap()))
        .collect();
    assert_eq!(plans[0].1.render.denoise, Denoise::None);
    let out = folder.path().join("sets");
    let idle = Cancel::default();
    let all = Extent { shard: Shard { index: 1, count: 1 }, every: 1, audited: 64 };
    let made = make_plans("tiny", &plans, &out, all, &idle).unwrap().unwrap();
    let root = out.join("tiny");
    let text = succeed(&["testset", "verify", root.to_str().unwrap()]);
    assert!(text.contains(&made.blake3), "{text}");
    // 4 samples without a denoiser are far from 64, which are far from perfect.
    let audit: serde_json::Value =
        serde_json::from_slice(&std::fs::read(root.join("near/test/seq-000000").join(AUDIT)).unwrap()).unwrap();
    let value = |key: &str| audit[key].as_f64().unwrap();
    assert!(value("error") > 10.0 && value("error") < value("longer") && value("error") == value("raw"), "{audit}");
    // Made again: nothing changes.
    let before = std::fs::read(root.join(SET)).unwrap();
    assert_eq!(make_plans("tiny", &plans, &out, all, &idle).unwrap().unwrap(), made);
    assert_eq!(std::fs::read(root.join(SET)).unwrap(), before);
    // The set, a class of it and a sequence of that are called what they are called in a folder of sets.
    for inside in ["", "tiny", "tiny/far", "tiny/far/test", "tiny/far/test/seq-000000"] {
        let found: Vec<_> = find(&out.join(inside)).unwrap().into_iter().map(|place| [place.set, place.class]).collect();
        let expected = if inside.len() > 4 { &[["tiny", "far"]][..] } else { &[["tiny", "far"], ["tiny", "near"]] };
        assert_eq!(found, expected, "{inside}");
    }
    // Half of it by another shard: not finished.
    let other = folder.path().join("half");
    let half = Extent { shard: Shard { index: 2, count: 2 }, audited: 0, ..all };
    assert!(make_plans("tiny", &plans, &other, half, &idle).unwrap().is_none());
    // What an evaluation of two frames in ten reads, and the frame that is audited; then the rest.
    let some = folder.path().join("some");
    assert!(make_plans("tiny", &plans, &some, Extent { every: 10, ..all }, &idle).unwrap().is_none());
    let sequence = some.join("tiny/near/test/seq-000000");
    let there = [0, 1, 2, 3, 4].map(|number| sequence.join(format!("frame.{number:04}.exr")).is_file());
    assert_eq!(there, [true, true, true, false, true]);
    let out_of_some = folder.path().join("results-of-some");
    let (data, results) = (some.to_str().unwrap(), out_of_some.to_str().unwrap());
    succeed(&["evaluate", "--data", data, "--methods", "warp", "--every", "10", "--out", results]);
    assert_eq!(scores(&out_of_some).iter().map(Vec::len).collect::<Vec<_>>(), [2, 2]);
    assert_eq!(make_plans("tiny", &plans, &some, all, &idle).unwrap().unwrap(), made);
    // A set that says something else than what is there.
    std::fs::write(root.join(SET), String::from_utf8(before.clone()).unwrap().replace(&made.blake3, &"0".repeat(64))).unwrap();
    let error = fail(&["testset", "verify", root.to_str().unwrap()]);
    assert!(error.contains("does not say what is there"), "{error}");
    std::fs::write(root.join(SET), before).unwrap();
    // A frame that was changed is found.
    let frame = root.join("far/test/seq-000000/frame.0001.exr");
    let mut bytes = std::fs::read(&frame).unwrap();
    let last = bytes.len() - 9;
    bytes[last] ^= 1;
    std::fs::write(&frame, bytes).unwrap();
    let error = fail(&["testset", "verify", root.to_str().unwrap()]);
    assert!(error.contains("frame.0001.exr"), "{error}");
}
